"""CalculiX on the open-die hemisphere: wedges of equivalent thickness.

A square sheet of 300 mm, fibres along x and y and a linear shear law, is pressed upwards by a
sphere from below. It starts flat at z = 0, the top of the sphere 0.55 mm below. u_z = 0 where |x|
or |y| is 120 mm or more in the flat sheet: the edge of this square support has nodes on it on every
mesh, so it is the same for all. A quarter is modelled. Penalty 10 MPa/mm.

The wedges C3D6 are of the kind that CalculiX makes of S3 shells, with orthotropic constants. The
thickness t = √(12 B/(E t0)), with E and G raised by t0/t, keeps the tension stiffness E t0 =
4016 N/mm, the shear stiffness G t0 = 0.335 N/mm and the bending stiffness B = 3.4 N mm. The
transverse shear moduli G13 = G23 have no counterpart in quasiform, whose fibre lines bend without
transverse shear; here they are a multiple of G12. Too low, and the sheet stays too soft under
refinement, as it is sheared where it should bend (with G13 = G12 over lengths of about
√(B/(G13 t)) = 3.2 mm). Too high, and a coarse mesh is too stiff: a linear wedge of side h locks by
about G13 t h²/12. So only limits under refinement can be compared, with a high G13.

The outer face touches the sphere, so the mid-surface comes to rest at the radius of the sphere plus
t/2. The sheet of quasiform is t0 thick; its ball is smaller, so that its mid-surface comes to the
same radius. Its tools move downwards, so its scene is upside down. `in_plane_bending` is 0: in
their plane the wedges have the membrane stiffness alone and no fibres that bend on their own.

The nodes of the sphere are all prescribed: it adds no unknowns to CalculiX. Both codes have the
same triangles, and the shear angle is computed in the same way, from the positions of the nodes.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .contest import OURS, Answer, Contender, Problem

FloatArray = np.ndarray
SIDE, GAP, RING = 300.0, 0.55, 120.0  # mm
PENALTY, STICK = 10.0, 0.1  # MPa/mm
B, E_T0, G_T0 = 3.4, 4016.0, 0.334 * 1.004  # N mm, N/mm, N/mm
THICKNESS = np.sqrt(12 * B / E_T0)  # mm
COARSEST = 10.0  # mm, of the path of quasiform
QUARTER = 4  # by which forces of the modelled quarter are multiplied


@dataclass(frozen=True)
class Press:
    """Radius of the sphere and its travel, mm; friction; G13 as a multiple of G12."""

    radius: float = 40.0
    travel: float = 30.0
    friction: float = 0.3
    transverse: float = 10.0


LARGER = Press(50.0, 40.0, 0.157, 3.0)


SIZES = (5.0, 2.5)  # mm, 961 and 3721 nodes
CONTROLS = {"to 7.5 mm": (0.05, 0.25), "to 30 mm": (0.1, 1.0)}
FORCES = (2.25, 3.75)  # N, 25 % about the limit: a check of the times, for the force see README


def missing() -> str:
    return "" if shutil.which("ccx") else "ccx (Debian package calculix-ccx) is not on the PATH"


def problems(folder: Path) -> list[Problem]:
    """Both codes on two meshes, with their automatic increments up to a largest one."""
    found = []
    for size in SIZES:
        blank = sheet(size)
        mesh, contenders = written(blank, folder), []
        for setting, (first, largest) in CONTROLS.items():
            ours = {"size": size, "increment": Press().travel * largest}
            theirs = {"mesh": mesh, "first": first, "largest": largest}
            contenders += [
                Contender(OURS, setting, "quasiform", ours),
                Contender("CalculiX", setting, "calculix", theirs),
            ]
        levels = {"size": size, "increment": Press().travel, "levels": True}
        contenders += [
            Contender(OURS, "automatic", "quasiform", {"size": size}),
            Contender(OURS, "path on 10 mm", "quasiform", levels),
        ]
        name = f"open-die hemisphere, {len(blank.nodes)} nodes"
        found.append(Problem(name, "calculix_hemisphere", tuple(contenders), *FORCES))
    return found


# CalculiX


def sheet(size: float):
    """Return the quarter blank of both codes."""
    import quasiform as qf

    return qf.rectangle(SIDE, SIDE, size, through=((0.0, 0.0), (RING, RING)), mirror=("x", "y"))


def written(blank, folder: Path) -> str:
    """Write the mesh of a blank for `calculix`, which does not import quasiform; its file."""
    mesh = folder / f"sheet_{len(blank.nodes)}.npz"
    np.savez(mesh, nodes=blank.nodes, triangles=blank.triangles)
    return str(mesh)


def held(nodes: FloatArray) -> np.ndarray:
    """(n,) bool: nodes (n, 2) on and beyond the square ring."""
    return np.abs(nodes).max(1) > RING - 1e-6


def deck(
    nodes: FloatArray,
    triangles: np.ndarray,
    first: float,
    largest: float,
    press: Press,
    facets: int = 24,
) -> str:
    """Input deck of the quarter.

    Parameters
    ----------
    nodes, triangles : (n, 2) and (m, 3) arrays
        Of the flat sheet.
    first, largest : float
        First and largest increment as parts of the travel.
    press : Press
    facets : int
        Faces of the sphere along its side.
    """
    E, G13 = E_T0 / THICKNESS, press.transverse * G_T0 / THICKNESS
    return "\n".join(
        [
            *_mesh(nodes, triangles, *_sphere(facets, press.radius)),
            "*ORIENTATION, NAME=FIBRES, SYSTEM=RECTANGULAR",
            "1., 0., 0., 0., 1., 0.",
            "*MATERIAL, NAME=FABRIC",
            "*ELASTIC, TYPE=ENGINEERING CONSTANTS",
            f"{E}, {E}, {E}, 0., 0., 0., {G_T0 / THICKNESS}, {G13}",
            f"{G13}, 0.",
            "*MATERIAL, NAME=RIGID",
            "*ELASTIC",
            "1000., 0.",
            "*SOLID SECTION, ELSET=SHEET, MATERIAL=FABRIC, ORIENTATION=FIBRES",
            "*SOLID SECTION, ELSET=SPHERE, MATERIAL=RIGID",
            "*SURFACE, NAME=UNDERSIDE",
            "SHEET, S1",
            "*SURFACE, NAME=BALL",
            "SPHERE, S2",
            "*SURFACE INTERACTION, NAME=TOUCH",
            "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
            f"{PENALTY}",
            *(["*FRICTION", f"{press.friction}, {STICK}"] if press.friction else []),
            "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE",
            "UNDERSIDE, BALL",
            "*BOUNDARY",
            "RING, 3, 3",
            "MIDDLEX, 1, 1",
            "MIDDLEY, 2, 2",
            "SPHERE, 1, 2",
            "*STEP, NLGEOM, INC=10000",
            "*STATIC",
            f"{first}, 1., 1e-6, {largest}",
            "*BOUNDARY",
            f"SPHERE, 3, 3, {press.travel}",
            "*NODE FILE, FREQUENCY=10000",
            "U",
            "*NODE PRINT, NSET=SPHERE, TOTALS=ONLY",
            "RF",
            "*END STEP",
            "",
        ]
    )


def _mesh(
    nodes: FloatArray, triangles: np.ndarray, sphere: FloatArray, blocks: np.ndarray
) -> list[str]:
    """Nodes, elements and node sets: the underside of the sheet, its upper side, the sphere."""
    n = len(nodes)
    layers = np.vstack([np.insert(nodes, 2, z * THICKNESS / 2, axis=1) for z in (-1, 1)])
    wedges = np.hstack([triangles, triangles + n]) + 1
    sets = {"RING": held(nodes), "MIDDLEX": nodes[:, 0] < 1e-6, "MIDDLEY": nodes[:, 1] < 1e-6}
    lines = [
        "*NODE, NSET=SHEET",
        *_numbered(layers, 1),
        "*NODE, NSET=SPHERE",
        *_numbered(sphere, 2 * n + 1),
        "*ELEMENT, TYPE=C3D6, ELSET=SHEET",
        *_numbered(wedges, 1),
        "*ELEMENT, TYPE=C3D8, ELSET=SPHERE",
        *_numbered(blocks + 2 * n + 1, len(triangles) + 1),
    ]
    for name, among in sets.items():
        chosen = np.flatnonzero(np.tile(among, 2)) + 1
        lines += [f"*NSET, NSET={name}", *(str(i) for i in chosen)]
    return lines


def _numbered(rows: np.ndarray, first: int) -> list[str]:
    return [f"{i}, {', '.join(str(v) for v in row)}" for i, row in enumerate(rows.tolist(), first)]


def _sphere(facets: int, radius: float) -> tuple[FloatArray, np.ndarray]:
    """Nodes (n, 3) and C3D8 blocks (m, 8) of a quarter of a cap, their faces 2 outside."""
    angle = np.radians(np.linspace(-6, 54, facets + 1))
    a, b = (t.ravel() for t in np.meshgrid(np.tan(angle), np.tan(angle), indexing="ij"))
    ray = np.stack([a, b, np.ones_like(a)], axis=1)
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    centre = np.array([0.0, 0.0, -GAP - radius])
    number = np.arange(len(ray)).reshape(facets + 1, -1)
    face = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], -1)
    face = face.reshape(-1, 4)
    nodes = np.vstack([centre + (radius - 4.0) * ray, centre + radius * ray])
    return nodes, np.hstack([face, face + len(ray)])


def calculix(
    mesh: str,
    first: float,
    largest: float,
    press: dict | None = None,
    facets: int = 24,
    keep: str = "",
) -> Answer:
    """Write the deck, run ccx on all processors and read its results; `press` as of `Press`."""
    given = Press(**press or {})
    data = np.load(mesh)
    nodes, triangles = data["nodes"], data["triangles"]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(keep or temporary)
        (folder / "sheet.inp").write_text(deck(nodes, triangles, first, largest, given, facets))
        threads = {"OMP_NUM_THREADS": str(os.cpu_count())}
        clock = time.perf_counter()
        done = subprocess.run(
            ["ccx", "sheet"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | threads,
        )
        seconds = time.perf_counter() - clock
        (folder / "log").write_text(done.stdout)
        steps = [line.split() for line in (folder / "sheet.sta").read_text().splitlines()[2:]]
        reached = float(steps[-1][-2]) if steps else 0.0
        if done.returncode or reached < 1 - 1e-9:
            error = re.search(r"\*ERROR.*(?:\n.*)?", done.stdout)
            reason = " ".join(error[0].split()) if error else "stopped"
            return Answer(failed=f"at {reached * given.travel:.3g} mm: {reason}", solve_s=seconds)
        forces = re.findall(r"total force.*\n\s*\n\s*(.+)", (folder / "sheet.dat").read_text())
        force = QUARTER * abs(float(forces[-1].split()[2]))
        u = displacements((folder / "sheet.frd").read_text(), len(nodes))
    x = np.pad(nodes, ((0, 0), (0, 1))) + u
    return Answer(
        force,
        largest_shear(nodes, triangles, x),
        seconds,
        len(steps),
        sum(int(step[3]) for step in steps),
        {"draw-in, mm": draw_in(nodes, x)},
    )


def displacements(frd: str, n: int) -> FloatArray:
    """(n, 3) last displacements of the middle of the sheet, whose layers are nodes 1 to 2n."""
    block = frd[frd.rindex(" -4  DISP") :]
    u = np.zeros((2 * n, 3))
    for line in block.splitlines():
        if line.startswith(" -1") and (i := int(line[3:13])) <= 2 * n:
            u[i - 1] = [float(line[13 + 12 * k : 25 + 12 * k]) for k in range(3)]
        if line.startswith(" -3"):
            break
    return u.reshape(2, n, 3).mean(0)


# Measures, the same for both codes


def largest_shear(nodes: FloatArray, triangles: np.ndarray, x: FloatArray) -> float:
    """Largest deviation of x and y fibres of a triangle from the right angle, degrees."""
    flat = nodes[triangles[:, 1:]] - nodes[triangles[:, :1]]
    edges = x[triangles[:, 1:]] - x[triangles[:, :1]]
    fibres = np.linalg.solve(flat, edges)  # (m, 2, 3): images of the unit vectors along x and y
    a, b = fibres[:, 0], fibres[:, 1]
    sine = (a * b).sum(1) / np.sqrt((a * a).sum(1) * (b * b).sum(1))
    return float(np.degrees(np.arcsin(np.abs(sine).max())))


def draw_in(nodes: FloatArray, x: FloatArray) -> float:
    """Mean inward motion of the middles of two edges, mm."""
    middle = [np.linalg.norm(nodes - m, axis=1).argmin() for m in np.eye(2) * SIDE / 2]
    return float(np.mean([nodes[i, axis] - x[i, axis] for axis, i in enumerate(middle)]))


# quasiform


def scene(size: float, press: Press = Press()):
    """Build the scene by hand, upside down: the ball comes from above."""
    from quasiform.recipe import built

    return built(_model, size, press=press)


def _model(size: float, press: Press, like: object = None):
    import quasiform as qf
    from quasiform.energy.bending import Bending
    from quasiform.energy.contact import Contact
    from quasiform.energy.friction import Friction
    from quasiform.energy.membrane import Membrane
    from quasiform.tools.shapes import ball
    from quasiform.unknowns import Unknowns

    blank = sheet(size)
    fabric = qf.Fabric(
        name="linear",
        shear=qf.ThreeStageLaw(C_ini=0.334),
        bending_warp=B,
        bending_weft=B,
        friction=press.friction,
        compaction=PENALTY,
        in_plane_bending=0.0,
    )
    n = len(blank.nodes)
    radius = press.radius + THICKNESS / 2 - fabric.thickness / 2
    rest = press.radius + THICKNESS / 2  # at contact: before it there is no force to compare with
    tool = qf.Tool("punch", ball(radius), height=rest, motion="driven", friction=press.friction)
    x0 = np.append(np.column_stack([blank.nodes, np.zeros(n)]).ravel(), rest)
    fixed = np.zeros(3 * n + 1, dtype=bool)
    fixed[2 : 3 * n : 3] = held(blank.nodes)
    fixed[: 3 * n : 3] = blank.nodes[:, 0] < 1e-6
    fixed[1 : 3 * n : 3] = blank.nodes[:, 1] < 1e-6
    fixed[3 * n] = True
    drive = np.zeros(3 * n + 1)
    drive[-1] = -1.0
    cloth = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    contact = Contact(cloth, tool, unknowns.add("punch", 1).dofs)
    return qf.Model(
        name="open-die-hemisphere",
        unknowns=unknowns,
        sheets=[cloth],
        terms=[Membrane(cloth), Bending(cloth), contact, Friction(contact)],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=press.travel - GAP + THICKNESS / 2,
        increment=5.0,
        rows=5.0,
        travel_name="travel_mm",
        share=1 / QUARTER,
        parameters={"size": size},
        coarsest=COARSEST,
    )


def quasiform(
    size: float,
    increment: float | None = None,
    levels: bool = False,
    press: dict | None = None,
) -> Answer:
    """Quasiform with equal or automatic increments; with `levels` the path on the coarsest mesh."""
    import quasiform as qf

    made = scene(size, Press(**press or {}))
    if levels:
        result = qf.refine(made, increment=increment)
    else:
        result = qf.solve(made, increment=increment, estimate=False)
    if result.status != "completed":
        return Answer(failed=result.reason)
    x = made.sheet.positions(result.states[-1].x)
    blank = made.sheet.blank
    return Answer(
        abs(float(result.force)),
        largest_shear(blank.nodes, blank.triangles, x),
        result.wall_s,
        result.increments,
        result.linear_solves,
        {"draw-in, mm": draw_in(blank.nodes, x)},
    )
