"""CalculiX on the open-die hemisphere: shells of equivalent thickness.

A square sheet of 300 mm, fibres along x and y and a linear shear law, is pressed 40 mm upwards by a
sphere of radius 50 mm from below. It starts flat at z = 0, the top of the sphere 0.55 mm below.
u_z = 0 where the flat radius exceeds 110 mm, u_x = u_y = 0 at the centre and u_y = 0 at the middle
of an edge. Penalty 10 MPa/mm, friction 0.157.

CalculiX has S3 shells with orthotropic constants. The thickness t = √(12 B/(E t0)), with E and G
raised by t0/t, keeps the tension stiffness E t0 = 4016 N/mm, the shear stiffness
G t0 = 0.335 N/mm and the bending stiffness B = 3.4 N mm. Its outer face touches the sphere, so the
mid-surface comes to rest at the radius 50 mm + t/2. The sheet of quasiform is t0 thick; its ball is
smaller, so that its mid-surface comes to the same radius. Its tools move downwards, so its scene is
upside down.

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
from pathlib import Path

import numpy as np

from .contest import OURS, Answer, Contender, Problem

FloatArray = np.ndarray
SIDE, RADIUS, TRAVEL, GAP, RING = 300.0, 50.0, 40.0, 0.55, 110.0  # mm
PENALTY, FRICTION, STICK = 10.0, 0.157, 0.1  # MPa/mm, -, MPa/mm
B, E_T0, G_T0 = 3.4, 4016.0, 0.334 * 1.004  # N mm, N/mm, N/mm
THICKNESS = np.sqrt(12 * B / E_T0)  # mm


SIZES = (10.0, 5.0)  # mm, 961 and 3721 nodes
CONTROLS = {"to 10 mm": (0.05, 0.25), "to 20 mm": (0.05, 0.5), "to 40 mm": (0.1, 1.0)}
FORCES = (11.0, 14.0)  # N; the width is explained in the README


def missing() -> str:
    return "" if shutil.which("ccx") else "ccx (Debian package calculix-ccx) is not on the PATH"


def problems(folder: Path) -> list[Problem]:
    """Both codes on two meshes, with their automatic increments up to a largest one."""
    import quasiform as qf

    found = []
    for size in SIZES:
        blank = qf.rectangle(SIDE, SIDE, size, through=((0.0, 0.0),))
        mesh = folder / f"sheet_{size:g}.npz"
        np.savez(mesh, nodes=blank.nodes, triangles=blank.triangles)
        contenders = []
        for setting, (first, largest) in CONTROLS.items():
            if size < SIZES[0] and setting == "to 20 mm":
                continue  # takes minutes, and is between two other settings
            given = {"mesh": str(mesh), "first": first, "largest": largest}
            contenders += [
                Contender(
                    OURS, setting, "quasiform", {"size": size, "increment": TRAVEL * largest}
                ),
                Contender("CalculiX", setting, "calculix", given),
            ]
        contenders.append(Contender(OURS, "automatic", "quasiform", {"size": size}))
        if size < SIZES[0]:  # the path on the coarser mesh, the end on this one
            levels = {"size": size, "increment": TRAVEL, "levels": True}
            contenders.append(Contender(OURS, "continuation", "quasiform", levels))
        found.append(
            Problem(
                f"open-die hemisphere, {len(blank.nodes)} nodes",
                "calculix_hemisphere",
                tuple(contenders),
                *FORCES,
            )
        )
    return found


# CalculiX


def deck(
    nodes: FloatArray,
    triangles: np.ndarray,
    first: float,
    largest: float,
    facets: int = 24,
    contact: str = "SURFACE TO SURFACE",
    controls: str = "",
) -> str:
    """Input deck of the whole problem.

    Parameters
    ----------
    nodes, triangles : (n, 2) and (m, 3) arrays
        Of the flat sheet.
    first, largest : float
        First and largest increment as parts of the travel.
    facets : int
        Faces of the sphere along its side.
    contact : str
        Type of the contact, as CalculiX names it.
    controls : str
        Further lines in the step.
    """
    sphere, blocks = _sphere(facets)
    n = len(nodes)
    radius = np.linalg.norm(nodes, axis=1)
    side = np.abs(nodes - [nodes[:, 0].max(), 0.0]).sum(1).argmin()
    E, G = E_T0 / THICKNESS, G_T0 / THICKNESS
    sheet = np.column_stack([nodes, np.zeros(n)])
    return "\n".join(
        [
            "*NODE, NSET=SHEET",
            *_numbered(sheet, 1),
            "*NODE, NSET=SPHERE",
            *_numbered(sphere, n + 1),
            "*ELEMENT, TYPE=S3, ELSET=SHEET",
            *_numbered(triangles + 1, 1),
            "*ELEMENT, TYPE=C3D8, ELSET=SPHERE",
            *_numbered(blocks + n + 1, len(triangles) + 1),
            "*NSET, NSET=RING",
            *(str(i + 1) for i in np.flatnonzero(radius > RING)),
            "*ORIENTATION, NAME=FIBRES, SYSTEM=RECTANGULAR",
            "1., 0., 0., 0., 1., 0.",
            "*MATERIAL, NAME=FABRIC",
            "*ELASTIC, TYPE=ENGINEERING CONSTANTS",
            f"{E}, {E}, {E}, 0., 0., 0., {G}, {G}",
            f"{G}, 0.",
            "*MATERIAL, NAME=RIGID",
            "*ELASTIC",
            "1000., 0.",
            "*SHELL SECTION, ELSET=SHEET, MATERIAL=FABRIC, ORIENTATION=FIBRES",
            f"{THICKNESS}",
            "*SOLID SECTION, ELSET=SPHERE, MATERIAL=RIGID",
            "*SURFACE, NAME=UNDERSIDE",
            "SHEET, SNEG",
            "*SURFACE, NAME=BALL",
            "SPHERE, S2",
            "*SURFACE INTERACTION, NAME=TOUCH",
            "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
            f"{PENALTY}",
            "*FRICTION",
            f"{FRICTION}, {STICK}",
            f"*CONTACT PAIR, INTERACTION=TOUCH, TYPE={contact}",
            "UNDERSIDE, BALL",
            "*BOUNDARY",
            "RING, 3, 3",
            f"{radius.argmin() + 1}, 1, 2",
            f"{side + 1}, 2, 2",
            "SPHERE, 1, 2",
            "*STEP, NLGEOM, INC=10000",
            "*STATIC",
            f"{first}, 1., 1e-6, {largest}",
            controls,
            "*BOUNDARY",
            f"SPHERE, 3, 3, {TRAVEL}",
            "*NODE FILE, OUTPUT=2D, FREQUENCY=10000",
            "U",
            "*NODE PRINT, NSET=SPHERE, TOTALS=ONLY",
            "RF",
            "*END STEP",
            "",
        ]
    ).replace("\n\n", "\n")


def _numbered(rows: np.ndarray, first: int) -> list[str]:
    return [f"{i}, {', '.join(str(v) for v in row)}" for i, row in enumerate(rows.tolist(), first)]


def _sphere(facets: int) -> tuple[FloatArray, np.ndarray]:
    """Nodes (n, 3) and C3D8 blocks (m, 8) of a cap, its faces 2 outside, to 60° from the pole."""
    angle = np.radians(np.linspace(-60, 60, facets + 1))
    a, b = (t.ravel() for t in np.meshgrid(np.tan(angle), np.tan(angle), indexing="ij"))
    ray = np.stack([a, b, np.ones_like(a)], axis=1)
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    centre = np.array([0.0, 0.0, -GAP - RADIUS])
    number = np.arange(len(ray)).reshape(facets + 1, -1)
    face = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], -1)
    face = face.reshape(-1, 4)
    nodes = np.vstack([centre + (RADIUS - 4.0) * ray, centre + RADIUS * ray])
    return nodes, np.hstack([face, face + len(ray)])


def calculix(
    mesh: str,
    first: float,
    largest: float,
    facets: int = 24,
    contact: str = "SURFACE TO SURFACE",
    controls: str = "",
    keep: str = "",
) -> Answer:
    """Write the deck, run ccx on all processors and read its results."""
    data = np.load(mesh)
    nodes, triangles = data["nodes"], data["triangles"]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(keep or temporary)
        text = deck(nodes, triangles, first, largest, facets, contact, controls)
        (folder / "sheet.inp").write_text(text)
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
        travel = float(steps[-1][-2]) if steps else 0.0
        if done.returncode or travel < 1 - 1e-9:
            error = re.search(r"\*ERROR.*(?:\n.*)?", done.stdout)
            reason = " ".join(error[0].split()) if error else "stopped"
            return Answer(failed=f"at {travel * TRAVEL:.3g} mm: {reason}", solve_s=seconds)
        forces = re.findall(r"total force.*\n\s*\n\s*(.+)", (folder / "sheet.dat").read_text())
        force = abs(float(forces[-1].split()[2]))
        u = displacements((folder / "sheet.frd").read_text(), len(nodes))
    x = np.column_stack([nodes, np.zeros(len(nodes))]) + u
    return Answer(
        force,
        largest_shear(nodes, triangles, x),
        seconds,
        len(steps),
        sum(int(step[3]) for step in steps),
        {"draw-in, mm": draw_in(nodes, x)},
    )


def displacements(frd: str, n: int) -> FloatArray:
    """(n, 3) last displacements of the first n nodes."""
    block = frd[frd.rindex(" -4  DISP") :]
    u = np.zeros((n, 3))
    for line in block.splitlines():
        if line.startswith(" -1") and (i := int(line[3:13])) <= n:
            u[i - 1] = [float(line[13 + 12 * k : 25 + 12 * k]) for k in range(3)]
        if line.startswith(" -3"):
            break
    return u


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
    """Mean inward motion of the middles of the four edges, mm."""
    inward = []
    for axis in (0, 1):
        for sign in (1.0, -1.0):
            middle = np.zeros(2)
            middle[axis] = sign * SIDE / 2
            i = np.linalg.norm(nodes - middle, axis=1).argmin()
            inward.append(sign * (nodes[i, axis] - x[i, axis]))
    return float(np.mean(inward))


# quasiform


def scene(size: float):
    """Build the scene by hand, upside down: the ball comes from above."""
    from quasiform.recipe import built

    return built(_model, size)


def _model(size: float, like: object = None):
    import quasiform as qf
    from quasiform.energy.bending import Bending
    from quasiform.energy.contact import Contact
    from quasiform.energy.friction import Friction
    from quasiform.energy.membrane import Membrane
    from quasiform.tools.shapes import ball
    from quasiform.unknowns import Unknowns

    blank = qf.rectangle(SIDE, SIDE, size, through=((0.0, 0.0),))
    fabric = qf.Fabric(
        name="linear",
        shear=qf.ThreeStageLaw(C_ini=0.334),
        bending_warp=B,
        bending_weft=B,
        friction=FRICTION,
        compaction=PENALTY,
        in_plane_bending=0.0,
    )
    n = len(blank.nodes)
    radius = RADIUS + THICKNESS / 2 - fabric.thickness / 2
    rest = RADIUS + THICKNESS / 2  # at contact: before it there is no force to compare with
    tool = qf.Tool("punch", ball(radius), height=rest, motion="driven", friction=FRICTION)
    x0 = np.append(np.column_stack([blank.nodes, np.zeros(n)]).ravel(), rest)
    fixed = np.zeros(3 * n + 1, dtype=bool)
    flat = np.linalg.norm(blank.nodes, axis=1)
    fixed[2 : 3 * n : 3] = flat > RING
    centre = flat.argmin()
    side = np.abs(blank.nodes - [SIDE / 2, 0.0]).sum(1).argmin()
    fixed[[3 * centre, 3 * centre + 1, 3 * side + 1, 3 * n]] = True
    drive = np.zeros(3 * n + 1)
    drive[-1] = -1.0
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    contact = Contact(sheet, tool, unknowns.add("punch", 1).dofs)
    return qf.Model(
        name="open-die-hemisphere",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), Bending(sheet), contact, Friction(contact)],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=TRAVEL - GAP + THICKNESS / 2,
        increment=5.0,
        rows=5.0,
        travel_name="travel_mm",
        parameters={"size": size},
        coarsest=SIZES[0],
    )


def quasiform(size: float, increment: float | None = None, levels: bool = False) -> Answer:
    """Quasiform with equal or automatic increments; with `levels` the path on the coarsest mesh."""
    import quasiform as qf

    made = scene(size)
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
