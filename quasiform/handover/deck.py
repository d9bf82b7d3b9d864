"""An Abaqus/Explicit deck of a scene, for an explicit run of one's own beside the implicit one.

Units N, mm, s, t, MPa. The sheet is membranes (M3D3, a user material, which is the fabric's law)
and shells (S3, bending) on the same nodes; tools are rigid triangles (R3D3) with a reference node;
contact is a penalty with the fabric's compaction stiffness and Coulomb friction. The holder comes
to rest in a first step, the punch travels in a second one by a smooth step.

The order of the constants of the user material is written into the deck (`CONSTANTS`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..checks import InputError, check_number
from ..energy.bending import Bending
from ..energy.contact import Contact
from ..energy.friction import Friction
from ..energy.membrane import Membrane
from ..energy.weight import GRAVITY, SheetWeight, ToolWeight
from ..fabric import Fabric, TabulatedLaw, ThreeStageLaw
from ..model import Scene
from ..result.summary import package_version
from ..tools.shapes import Tool
from .inp import DENSITY, comment, listed, rows, write
from .tool_surface import fine_enough, from_scene_file, sampled

FloatArray = np.ndarray
SPEED = 1000.0  # mm/s, mean of the punch
SETTLE = 0.02  # s, for the holder to come to rest
MARGIN = 10.0  # mm of tool around the sheet
OFF = 0.1  # of the thickness: how far triangles may be off a tool in closed form
SOFT = 0.01  # shear modulus of the shells over that of the fabric at rest
CARRIED = (Membrane, Bending, Contact, Friction, SheetWeight, ToolWeight)
CONSTANTS = (
    "Constants of the user material FABRIC (a VUMAT of your own), MPa. With the deformation "
    "gradient F, the flat fibres a0 (local 1), b0 (local 2): I4 = a0.C.a0, I6 = a0.C.b0, "
    "I8 = b0.C.b0, W = W4(I4) + W6(I6) + W8(I8) per flat volume.",
    "S = 2 W4' a0xa0 + W6' (a0xb0 + b0xa0) + 2 W8' b0xb0 (second Piola-Kirchhoff).",
    "W' = sgn(I - I0) [C_ini min(x, I_t) + (C_mid y + dS_mid)(1 - exp(-c y)) + C_lo z z] with "
    "x = |I - I0|, I_t = S_ini/C_ini, c = C_ini/dS_mid, y = max(x - I_t, 0), z = max(x - I_lo, 0); "
    "I0 = 1 for I4 and I8, 0 for I6. S_ini = 0 stands for the linear law W' = C_ini (I - I0).",
    " 1- 6  C_ini, S_ini, C_mid, dS_mid, C_lo, I_lo of the warp, W4",
    " 7-12  the same of the weft, W8",
    "13     points of the table of the shear law, 0 for none",
    "14-19  without a table: the six constants of the shear law, W6",
    "14-    with one: I6, W6' of each of its points",
)


@dataclass
class _Deck:
    """A deck in the making: lines, what is known about labels, notices."""

    scene: Scene
    spacing: float | None
    speed: float
    lines: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    next_node: int = 0
    next_element: int = 0


def abaqus_deck(
    scene: Scene,
    path: str | Path,
    *,
    speed: float = SPEED,
    spacing: float | None = None,
    force: bool = False,
) -> tuple[str, ...]:
    """Write an Abaqus/Explicit input file of a scene; nothing is solved.

    The deck holds what the scene models: a quarter where that has two mirror planes, with symmetry
    conditions (build the scene with `symmetry="none"` for the whole). It needs a VUMAT of your own
    for the user material FABRIC; the order of its constants stands in the deck.

    Parameters
    ----------
    scene : Scene
    path : path
        .inp
    speed : float
        Mean speed of the punch, mm/s.
    spacing : float, optional
        Of the triangles of tools in closed form, mm; if not given, what keeps them within a tenth
        of the thickness, at most the size of the mesh.
    force : bool
        Whether to replace an existing file.

    Returns
    -------
    notices : tuple of str
        What is not in the deck, and what was assumed; also at its beginning.

    Raises
    ------
    InputError
        For bad numbers, or a file that cannot be written.
    """
    path = Path(path)
    check_number("speed", speed)
    if spacing is not None:
        check_number("spacing", spacing)
    if path.exists() and not force:
        raise InputError(f"{path} exists already: choose another name, or replace it with --force")
    deck = _Deck(scene, spacing, speed)
    _sheet(deck)
    _material(deck)
    tools = _tools(deck)
    _supports(deck)
    _contact(deck, tools)
    _steps(deck, tools)
    for term in scene.terms:
        if not isinstance(term, CARRIED):
            deck.notices.append(f"not carried: {getattr(term, 'name', type(term).__name__)}")
    notices = (
        "the deck is not run: its syntax is checked only; mass scaling and the time are yours "
        "to choose, watch the kinetic energy",
        *deck.notices,
    )
    head = ["*HEADING", f"{scene.name}, quasiform {package_version()}"]
    words = [f"Fabric {scene.fabric.name}. Units N, mm, s, t, MPa.", *notices, *CONSTANTS]
    words += [f"{entry}: {why}" for entry, why in scene.model]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, _ascii([*head, *comment(words), *deck.lines]))
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
    return notices


def _ascii(lines: list[str]) -> Iterator[str]:
    return (line.encode("ascii", "replace").decode() for line in lines)


def _name(text: str) -> str:
    """Label of Abaqus: letters, digits, underscores."""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in text).upper()
    return f"T_{plain}"[:60]


# The sheet


def _sheet(deck: _Deck) -> None:
    scene = deck.scene
    blank = scene.blank
    places = scene.positions(scene.x0)
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    nodes = 1 + np.arange(len(places))
    membranes = 1 + np.arange(len(blank.triangles))
    deck.next_node = deck.next_element = 10 ** len(str(max(nodes[-1], membranes[-1])))
    corners = nodes[blank.triangles]
    out = deck.lines
    out += ["*NODE, NSET=SHEET", *rows(nodes, places)]
    out += ["*ELEMENT, TYPE=M3D3, ELSET=MEMBRANES", *_cells(membranes, corners)]
    if _bends(scene):
        shells = membranes + deck.next_element
        deck.next_element *= 2
        out += ["*ELEMENT, TYPE=S3, ELSET=SHELLS", *_cells(shells, corners)]
    else:
        deck.notices.append("membranes alone: the scene has no bending")


def _cells(labels: np.ndarray, corners: np.ndarray) -> Iterator[str]:
    return (", ".join(map(str, [e, *c])) for e, c in zip(labels, corners.tolist(), strict=True))


def _bends(scene: Scene) -> bool:
    return any(isinstance(term, Bending) for term in scene.terms)


def constants(fabric: Fabric) -> list[float]:
    """Constants of the user material, in the order of `CONSTANTS`."""

    def six(law: ThreeStageLaw) -> list[float]:
        if law.linear:
            return [law.C_ini, *[0.0] * 5]
        return [law.C_ini, law.S_ini, law.C_mid, law.dS_mid, law.C_lo, law.I_lo]

    found = [*six(fabric.warp), *six(fabric.weft)]
    if isinstance(fabric.shear, TabulatedLaw):
        points = zip(fabric.shear.I6, fabric.shear.S12, strict=True)
        return [*found, float(len(fabric.shear.I6)), *(v for point in points for v in point)]
    return [*found, 0.0, *six(fabric.shear)]


def _material(deck: _Deck) -> None:
    scene, out = deck.scene, deck.lines
    fabric, blank = scene.fabric, scene.blank
    bends = _bends(scene)
    density = DENSITY * fabric.areal_weight / fabric.thickness / (1 + bends)
    if not density:
        deck.notices.append("the fabric has no areal weight: an explicit run needs a density")
    t0 = fabric.thickness
    axes = ", ".join(f"{v:.9g}" for v in (*blank.warp, 0.0, *blank.weft, 0.0))
    out += ["*ORIENTATION, NAME=FLAT_FIBRES, SYSTEM=RECTANGULAR", axes, "3, 0."]
    out += [
        "*MEMBRANE SECTION, ELSET=MEMBRANES, MATERIAL=FABRIC, ORIENTATION=FLAT_FIBRES",
        f"{t0:.9g}",
    ]
    values = constants(fabric)
    out += ["*MATERIAL, NAME=FABRIC", "*DENSITY", f"{density:.6g},"]
    out += [f"*USER MATERIAL, CONSTANTS={len(values)}"]
    words = [f"{v:.9g}" for v in values]
    out += [", ".join(words[i : i + 8]) for i in range(0, len(words), 8)]
    if not bends:
        return
    # the bending stiffness of a homogeneous shell is E t³/12
    E = [12 * B / t0**3 for B in (fabric.bending_warp, fabric.bending_weft)]
    law = fabric.shear
    G = law.S12[1] / law.I6[1] if isinstance(law, TabulatedLaw) else law.C_ini
    out += [
        "*SHELL SECTION, ELSET=SHELLS, MATERIAL=BENDING, ORIENTATION=FLAT_FIBRES, "
        "SECTION INTEGRATION=GAUSS",
        f"{t0:.9g}, 3",
        "*MATERIAL, NAME=BENDING",
        "*DENSITY",
        f"{density:.6g},",
        "*ELASTIC, TYPE=LAMINA",
        ", ".join(f"{v:.6g}" for v in (*E, 0.0, SOFT * G, SOFT * G, SOFT * G)),
    ]
    fibre = min(fabric.warp.C_ini, fabric.weft.C_ini) * 4
    deck.notices += [
        f"the shells bend by E = 12 B/t0³ (warp {E[0]:.4g}, weft {E[1]:.4g} MPa), which adds "
        f"{100 * max(E) / fibre:.2g} % to the fibres' tension stiffness; their two axes stay at "
        "right angles, which the sheared fibres do not",
        f"the shells' shear moduli are {SOFT:g} of the fabric's at rest (assumed): the fabric has "
        "no stiffness against twisting",
        "membranes and shells have half the mass each",
    ]
    if fabric.in_plane_bending and scene.dim == 3:
        deck.notices.append(
            f"not carried: in-plane bending of the fibres ({fabric.in_plane_bending:g} of the "
            "bending stiffness), which shells of this kind do not have"
        )


# Tools


@dataclass(frozen=True)
class _Rigid:
    """A tool in the deck."""

    tool: Tool
    dof: int
    name: str
    node: int


def _tools(deck: _Deck) -> list[_Rigid]:
    scene, out = deck.scene, deck.lines
    found: dict[str, _Rigid] = {}
    for contact in scene.contacts:
        tool, dof = contact.tool, int(contact.tool_dofs[0])
        if tool.name in found:
            continue
        origin = contact.origin(scene.x0)
        vertices, triangles = _triangles(deck, contact, origin)
        first_node, first = deck.next_node + 1, deck.next_element + 1
        name = _name(tool.name)
        while name in {rigid.name for rigid in found.values()}:
            name += "_2"
        nodes = first_node + 1 + np.arange(len(vertices))
        elements = first + np.arange(len(triangles))
        out += [f"*NODE, NSET={name}_REF", *rows([first_node], origin[None])]
        out += [f"*NODE, NSET={name}_NODES", *rows(nodes, vertices + origin)]
        out += [f"*ELEMENT, TYPE=R3D3, ELSET={name}", *_cells(elements, nodes[triangles])]
        out += [f"*RIGID BODY, REF NODE={first_node}, ELSET={name}"]
        deck.next_node, deck.next_element = int(nodes[-1]), int(elements[-1])
        if tool.motion == "free":
            mass = tool.mass or tool.force / (1e3 * GRAVITY)
            if not tool.mass:
                deck.notices.append(
                    f"the {tool.name} has a force and no mass: {mass:.3g} kg, which weigh as much, "
                    "stand in"
                )
            deck.next_element += 1
            out += [f"*ELEMENT, TYPE=MASS, ELSET={name}_MASS"]
            out += [f"{deck.next_element}, {first_node}"]
            out += [f"*MASS, ELSET={name}_MASS", f"{1e-3 * mass * scene.share:.9g}"]
        found[tool.name] = _Rigid(tool, dof, name, first_node)
    return list(found.values())


def _triangles(deck: _Deck, contact: Contact, origin: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Triangles of a tool in its own frame."""
    scene, tool = deck.scene, contact.tool
    given = from_scene_file(tool, scene.parameters, scene.turn)
    if given is not None:
        deck.notices.append(f"the {tool.name} has the {len(given[1])} triangles of its file")
        return given
    places = scene.positions(scene.x0)
    deep = scene.travel if scene.travel_name == "travel_mm" else np.ptp(places, axis=0).max()
    low = places.min(0) - origin - [MARGIN, MARGIN, MARGIN + deep]
    high = places.max(0) - origin + [MARGIN, MARGIN, MARGIN + deep]
    box = getattr(tool.shape, "box", None)
    if box is not None:
        low, high = np.maximum(low, box[0] - MARGIN), np.minimum(high, box[1] + MARGIN)
    wanted = deck.spacing or min(
        scene.blank.size, fine_enough(tool.shape, OFF * scene.fabric.thickness)
    )
    vertices, triangles, spacing, off = sampled(tool.shape, low, high, wanted)
    coarser = f", not {wanted:.3g} as wanted," if spacing > wanted * (1 + 1e-9) else ""
    deck.notices.append(
        f"the {tool.name} is {len(triangles)} triangles about {spacing:.3g} mm wide{coarser} "
        f"sampled from its distance, at most {off:.2g} mm off"
    )
    return vertices, triangles


# Supports and contact


def _supports(deck: _Deck) -> None:
    """Symmetry, and what the scene prescribes of the nodes and never moves."""
    scene, out = deck.scene, deck.lines
    blank, dim = scene.blank, scene.dim
    nodes = 1 + np.arange(len(blank.nodes))
    fixed = scene.fixed[: scene.n_nodal].reshape(-1, dim).copy()
    moved = _moved(scene) != 0
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            on = np.abs(blank.nodes[:, axis]) < 1e-9
            fixed[on, axis] = False
            out += [f"*NSET, NSET=MIRROR_{plane.upper()}", *listed(nodes[on])]
            out += ["*BOUNDARY", f"MIRROR_{plane.upper()}, {plane.upper()}SYMM"]
    if blank.mirror:
        deck.notices.append(
            f"{scene.share:g} of the whole is modelled: multiply forces by {1 / scene.share:g}"
        )
    if scene.turn:
        deck.notices.append(
            f"the deck is in the model's axes, turned by {scene.turn:g}° from the scene's"
        )
    for axis in range(dim):
        held = fixed[:, axis] & ~moved[:, axis]
        if held.any():
            out += [f"*NSET, NSET=HELD_{axis + 1}", *listed(nodes[held])]
            out += ["*BOUNDARY", f"HELD_{axis + 1}, {axis + 1}, {axis + 1}"]
    if dim == 2:
        out += ["*BOUNDARY", "SHEET, 3, 3"]
    if any(isinstance(term, Bending) for term in scene.terms) and fixed.any():
        deck.notices.append("supports hold places only: a clamp's rotations are not carried")


def _moved(scene: Scene) -> FloatArray:
    """(n_nodes, dim) prescribed displacement of the nodes over the whole travel, mm."""
    end = scene.prescribed(scene.travel)[0] - scene.x0
    moved = np.where(scene.fixed, end, 0.0)[: scene.n_nodal].reshape(-1, scene.dim)
    return np.where(np.abs(moved) > 1e-12, moved, 0.0)


def _contact(deck: _Deck, tools: list[_Rigid]) -> None:
    out, fabric = deck.lines, deck.scene.fabric
    if not tools:
        return
    out += ["*SURFACE, TYPE=ELEMENT, NAME=SHEET_FACES"]
    out += ["SHELLS," if _bends(deck.scene) else "MEMBRANES,"]
    for rigid in tools:
        out += [f"*SURFACE, TYPE=ELEMENT, NAME={rigid.name}_FACES", f"{rigid.name}, SPOS"]
        out += [f"*SURFACE INTERACTION, NAME={rigid.name}_TOUCH"]
        out += ["*FRICTION", f"{rigid.tool.friction:.9g},"]
        out += ["*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{fabric.compaction:.9g},"]


# Steps


def _steps(deck: _Deck, tools: list[_Rigid]) -> None:
    scene, out = deck.scene, deck.lines
    moved = _moved(scene)
    far = max(
        [float(np.abs(moved).max())]
        + [scene.travel for rigid in tools if rigid.tool.motion == "driven"]
    )
    time = max(far, 1.0) / deck.speed
    free = [rigid for rigid in tools if rigid.tool.motion == "free"]
    weight = next((term for term in scene.terms if isinstance(term, SheetWeight)), None)
    for name, end in (("SETTLING", SETTLE), ("TRAVEL", time)):
        out += [f"*AMPLITUDE, NAME={name}, DEFINITION=SMOOTH STEP", f"0., 0., {end:.9g}, 1."]
    for rigid in tools:
        held = {"fixed": "1, 6", "driven": "1, 6", "free": "1, 2"}[rigid.tool.motion]
        out += ["*BOUNDARY", f"{rigid.name}_REF, {held}"]
        if rigid.tool.motion == "free":
            out += [f"{rigid.name}_REF, 4, 6"]
        if rigid.tool.tilts:
            deck.notices.append(
                f"the {rigid.tool.name} may not tilt in the deck: its moments of inertia are not "
                "known"
            )
    steps = []
    if free:
        steps.append(("the holder comes to rest", SETTLE))
    steps.append(("travel", time))
    for number, (words, duration) in enumerate(steps):
        out += [f"*STEP, NAME=STEP_{number + 1}, NLGEOM=YES", words]
        out += ["*DYNAMIC, EXPLICIT", f", {duration:.9g}"]
        if not number:
            for rigid in tools:
                out += [
                    f"*CONTACT PAIR, INTERACTION={rigid.name}_TOUCH, MECHANICAL CONSTRAINT=PENALTY",
                    f"SHEET_FACES, {rigid.name}_FACES",
                ]
            amplitude = "SETTLING" if free else "TRAVEL"
            for rigid in free:
                load = _load(scene, rigid)
                out += [f"*CLOAD, AMPLITUDE={amplitude}", f"{rigid.name}_REF, 3, {-load:.9g}"]
            if weight is not None:
                out += [f"*DLOAD, AMPLITUDE={amplitude}"]
                g = f"GRAV, {1e6 * GRAVITY:.9g}, 0., 0., -1."
                out += [f"MEMBRANES, {g}"] + ([f"SHELLS, {g}"] if _bends(scene) else [])
        if number == len(steps) - 1:
            _travel(deck, tools, moved)
        out += _output(tools)
        out += ["*END STEP"]


def _load(scene: Scene, rigid: _Rigid) -> float:
    """Weight and force of a free tool on the modelled share, N."""
    return float(
        sum(
            term.force
            for term in scene.terms
            if isinstance(term, ToolWeight) and term.dofs[0, 0] == rigid.dof
        )
    )


def _travel(deck: _Deck, tools: list[_Rigid], moved: FloatArray) -> None:
    scene, out = deck.scene, deck.lines
    end = scene.prescribed(scene.travel)[0] - scene.x0
    lines = [
        f"{rigid.name}_REF, 3, 3, {end[rigid.dof]:.9g}"
        for rigid in tools
        if rigid.tool.motion == "driven"
    ]
    lines += [
        f"{node + 1}, {axis + 1}, {axis + 1}, {moved[node, axis]:.9g}"
        for node, axis in np.argwhere(moved)
    ]
    if lines:
        out += ["*BOUNDARY, TYPE=DISPLACEMENT, AMPLITUDE=TRAVEL", *lines]
    if callable(scene.drive):
        deck.notices.append("prescribed nodes go straight to their end, not along their path")


def _output(tools: list[_Rigid]) -> list[str]:
    lines = ["*OUTPUT, FIELD, NUMBER INTERVAL=20", "*NODE OUTPUT", "U, RF"]
    lines += ["*OUTPUT, HISTORY, TIME INTERVAL=0.001"]
    lines += ["*ENERGY OUTPUT", "ALLKE, ALLIE, ALLWK, ALLFD, ETOTAL"]
    for rigid in tools:
        lines += [f"*NODE OUTPUT, NSET={rigid.name}_REF", "U3, RF3"]
    return lines
