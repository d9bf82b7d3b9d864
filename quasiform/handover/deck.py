"""An Abaqus/Explicit deck of a scene, for an explicit run of one's own beside the implicit one.

Units N, mm, s, t, MPa. The sheet is membranes (M3D3, a user material, which is the fabric's law)
and shells (S3, bending) on the same nodes; tools are rigid triangles (R3D3) with a reference node;
contact is a penalty with the fabric's compaction stiffness and Coulomb friction. The holder comes
to rest in a first step, the punch travels in a second one by a smooth step.

The order of the constants of the user material is written into the deck (`CONSTANTS`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
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
from .inp import DENSITY
from .keywords import comment, elements, in_lines, numbers, rows, write
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


@dataclass(frozen=True)
class _Rigid:
    """A tool in the deck."""

    tool: Tool
    dof: int
    name: str
    node: int


@dataclass
class _Deck:
    """A deck in the making: lines, the last labels that are taken, notices."""

    scene: Scene
    spacing: float | None
    speed: float
    lines: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    last_node: int = 0
    last_element: int = 0

    def add(self, *lines: str) -> None:
        """Add lines."""
        self.lines += lines

    def note(self, words: str) -> None:
        """Add a notice."""
        self.notices.append(words)

    @cached_property
    def bends(self) -> bool:
        """Whether there are shells."""
        return any(isinstance(term, Bending) for term in self.scene.terms)

    @cached_property
    def places(self) -> FloatArray:
        """(n_nodes, 3) places of the sheet at the start, mm."""
        places = self.scene.positions(self.scene.x0)
        return np.pad(places, ((0, 0), (0, 3 - places.shape[1])))

    @cached_property
    def travel(self) -> FloatArray:
        """Prescribed motion of all unknowns over the whole travel, mm."""
        scene = self.scene
        end = scene.prescribed(scene.travel)[0] - scene.x0
        return np.where(scene.fixed & (np.abs(end) > 1e-12), end, 0.0)

    @property
    def moved(self) -> FloatArray:
        """(n_nodes, dim) that of the nodes."""
        return self.travel[: self.scene.n_nodal].reshape(-1, self.scene.dim)


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
            deck.note(f"not carried: {getattr(term, 'name', type(term).__name__)}")
    notices = (
        "the deck is not run: its syntax is checked only; mass scaling and the time are yours "
        "to choose, watch the kinetic energy",
        *deck.notices,
    )
    words = [f"Fabric {scene.fabric.name}. Units N, mm, s, t, MPa.", *notices, *CONSTANTS]
    words += [f"{entry}: {why}" for entry, why in scene.model]
    head = ["*HEADING", f"{scene.name}, quasiform {package_version()}", *comment(words)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, [*head, *deck.lines])
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
    return notices


def _sheet(deck: _Deck) -> None:
    triangles = deck.scene.blank.triangles
    nodes, labels = 1 + np.arange(len(deck.places)), 1 + np.arange(len(triangles))
    deck.last_node = deck.last_element = 10 ** len(str(max(nodes[-1], labels[-1])))
    deck.add("*NODE, NSET=SHEET", *rows(nodes, deck.places))
    deck.add("*ELEMENT, TYPE=M3D3, ELSET=MEMBRANES", *elements(labels, nodes[triangles]))
    if not deck.bends:
        deck.note("membranes alone: the scene has no bending")
        return
    labels += deck.last_element
    deck.last_element *= 2
    deck.add("*ELEMENT, TYPE=S3, ELSET=SHELLS", *elements(labels, nodes[triangles]))


def constants(fabric: Fabric) -> list[float]:
    """Constants of the user material, in the order of `CONSTANTS`."""

    def six(law: ThreeStageLaw) -> list[float]:
        if law.linear:
            return [law.C_ini, *[0.0] * 5]
        return [law.C_ini, law.S_ini, law.C_mid, law.dS_mid, law.C_lo, law.I_lo]

    found, shear = [*six(fabric.warp), *six(fabric.weft)], fabric.shear
    if isinstance(shear, TabulatedLaw):
        points = np.column_stack([shear.I6, shear.S12]).ravel()
        return [*found, float(len(shear.I6)), *points.tolist()]
    return [*found, 0.0, *six(shear)]


def _material(deck: _Deck) -> None:
    fabric, blank = deck.scene.fabric, deck.scene.blank
    t0 = fabric.thickness
    density = DENSITY * fabric.areal_weight / t0 / (1 + deck.bends)
    if not density:
        deck.note("the fabric has no areal weight: an explicit run needs a density")
    values = [f"{v:.9g}" for v in constants(fabric)]
    deck.add(
        "*ORIENTATION, NAME=FLAT_FIBRES, SYSTEM=RECTANGULAR",
        numbers((*blank.warp, 0.0, *blank.weft, 0.0)),
        "3, 0.",
        "*MEMBRANE SECTION, ELSET=MEMBRANES, MATERIAL=FABRIC, ORIENTATION=FLAT_FIBRES",
        f"{t0:.9g}",
        "*MATERIAL, NAME=FABRIC",
        "*DENSITY",
        f"{density:.6g},",
        f"*USER MATERIAL, CONSTANTS={len(values)}",
        *in_lines(values, 8),
    )
    if not deck.bends:
        return
    # the bending stiffness of a homogeneous shell is E t³/12
    E = [12 * B / t0**3 for B in (fabric.bending_warp, fabric.bending_weft)]
    law = fabric.shear
    G = SOFT * (law.S12[1] / law.I6[1] if isinstance(law, TabulatedLaw) else law.C_ini)
    deck.add(
        "*SHELL SECTION, ELSET=SHELLS, MATERIAL=BENDING, ORIENTATION=FLAT_FIBRES, "
        "SECTION INTEGRATION=GAUSS",
        f"{t0:.9g}, 3",
        "*MATERIAL, NAME=BENDING",
        "*DENSITY",
        f"{density:.6g},",
        "*ELASTIC, TYPE=LAMINA",
        numbers((*E, 0.0, G, G, G), 6),
    )
    fibre = min(fabric.warp.C_ini, fabric.weft.C_ini) * 4
    deck.notices += [
        f"the shells bend by E = 12 B/t0³ (warp {E[0]:.4g}, weft {E[1]:.4g} MPa), which adds "
        f"{100 * max(E) / fibre:.2g} % to the fibres' tension stiffness; their two axes stay at "
        "right angles, which the sheared fibres do not",
        f"the shells' shear moduli are {SOFT:g} of the fabric's at rest (assumed): the fabric has "
        "no stiffness against twisting",
        "membranes and shells have half the mass each",
    ]
    if fabric.in_plane_bending and deck.scene.dim == 3:
        deck.note(
            f"not carried: in-plane bending of the fibres ({fabric.in_plane_bending:g} of the "
            "bending stiffness), which shells of this kind do not have"
        )


def _tools(deck: _Deck) -> list[_Rigid]:
    scene = deck.scene
    found: dict[str, _Rigid] = {}
    for contact in scene.contacts:
        tool = contact.tool
        if tool.name in found:
            continue
        origin = contact.origin(scene.x0)
        vertices, triangles = _triangles(deck, contact, origin)
        plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in tool.name).upper()
        name = f"T_{plain}"[:60]
        while name in {rigid.name for rigid in found.values()}:
            name += "_2"
        reference = deck.last_node + 1
        nodes = reference + 1 + np.arange(len(vertices))
        labels = deck.last_element + 1 + np.arange(len(triangles))
        deck.add(f"*NODE, NSET={name}_REF", *rows([reference], origin[None]))
        deck.add(f"*NODE, NSET={name}_NODES", *rows(nodes, vertices + origin))
        deck.add(f"*ELEMENT, TYPE=R3D3, ELSET={name}", *elements(labels, nodes[triangles]))
        deck.add(f"*RIGID BODY, REF NODE={reference}, ELSET={name}")
        deck.last_node, deck.last_element = int(nodes[-1]), int(labels[-1])
        if tool.motion == "free":
            mass = tool.mass or tool.force / (1e3 * GRAVITY)
            if not tool.mass:
                deck.note(
                    f"the {tool.name} has a force and no mass: {mass:.3g} kg, which weigh as much, "
                    "stand in"
                )
            deck.last_element += 1
            deck.add(f"*ELEMENT, TYPE=MASS, ELSET={name}_MASS")
            deck.add(f"{deck.last_element}, {reference}")
            deck.add(f"*MASS, ELSET={name}_MASS", f"{1e-3 * mass * scene.share:.9g}")
        found[tool.name] = _Rigid(tool, int(contact.tool_dofs[0]), name, reference)
    return list(found.values())


def _triangles(deck: _Deck, contact: Contact, origin: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Triangles of a tool in its own frame."""
    scene, tool = deck.scene, contact.tool
    given = from_scene_file(tool, scene.parameters, scene.turn)
    if given is not None:
        deck.note(f"the {tool.name} has the {len(given[1])} triangles of its file")
        return given
    deep = scene.travel if scene.travel_name == "travel_mm" else np.ptp(deck.places, axis=0).max()
    margin = np.array([MARGIN, MARGIN, MARGIN + deep])
    low, high = deck.places.min(0) - origin - margin, deck.places.max(0) - origin + margin
    box = getattr(tool.shape, "box", None)
    if box is not None:
        low, high = np.maximum(low, box[0] - MARGIN), np.minimum(high, box[1] + MARGIN)
    fine = fine_enough(tool.shape, OFF * scene.fabric.thickness)
    wanted = deck.spacing or min(scene.blank.size, fine)
    vertices, triangles, spacing, off = sampled(tool.shape, low, high, wanted)
    coarser = f", not {wanted:.3g} as wanted," if spacing > wanted * (1 + 1e-9) else ""
    deck.note(
        f"the {tool.name} is {len(triangles)} triangles about {spacing:.3g} mm wide{coarser} "
        f"sampled from its distance, at most {off:.2g} mm off"
    )
    return vertices, triangles


def _supports(deck: _Deck) -> None:
    """Symmetry, and what the scene prescribes of the nodes and never moves."""
    scene, blank = deck.scene, deck.scene.blank
    nodes = 1 + np.arange(len(blank.nodes))
    fixed = scene.fixed[: scene.n_nodal].reshape(-1, scene.dim).copy()
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            on, name = np.abs(blank.nodes[:, axis]) < 1e-9, plane.upper()
            fixed[on, axis] = False
            deck.add(f"*NSET, NSET=MIRROR_{name}", *in_lines(nodes[on]))
            deck.add("*BOUNDARY", f"MIRROR_{name}, {name}SYMM")
    if blank.mirror:
        deck.note(
            f"{scene.share:g} of the whole is modelled: multiply forces by {1 / scene.share:g}"
        )
    if scene.turn:
        deck.note(f"the deck is in the model's axes, turned by {scene.turn:g}° from the scene's")
    for axis, held in enumerate((fixed & (deck.moved == 0)).T, 1):
        if held.any():
            deck.add(f"*NSET, NSET=HELD_{axis}", *in_lines(nodes[held]))
            deck.add("*BOUNDARY", f"HELD_{axis}, {axis}, {axis}")
    if scene.dim == 2:
        deck.add("*BOUNDARY", "SHEET, 3, 3")
    if deck.bends and fixed.any():
        deck.note("supports hold places only: a clamp's rotations are not carried")


def _contact(deck: _Deck, tools: list[_Rigid]) -> None:
    if tools:
        deck.add("*SURFACE, TYPE=ELEMENT, NAME=SHEET_FACES")
        deck.add("SHELLS," if deck.bends else "MEMBRANES,")
    for rigid in tools:
        deck.add(
            f"*SURFACE, TYPE=ELEMENT, NAME={rigid.name}_FACES",
            f"{rigid.name}, SPOS",
            f"*SURFACE INTERACTION, NAME={rigid.name}_TOUCH",
            "*FRICTION",
            f"{rigid.tool.friction:.9g},",
            "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
            f"{deck.scene.fabric.compaction:.9g},",
        )


def _steps(deck: _Deck, tools: list[_Rigid]) -> None:
    driven = [rigid for rigid in tools if rigid.tool.motion == "driven"]
    free = [rigid for rigid in tools if rigid.tool.motion == "free"]
    far = max(float(np.abs(deck.moved).max()), deck.scene.travel if driven else 0.0)
    time = max(far, 1.0) / deck.speed
    for name, end in (("SETTLING", SETTLE), ("TRAVEL", time)):
        deck.add(f"*AMPLITUDE, NAME={name}, DEFINITION=SMOOTH STEP", f"0., 0., {end:.9g}, 1.")
    for rigid in tools:
        held = ("1, 2", "4, 6") if rigid in free else ("1, 6",)
        deck.add("*BOUNDARY", *(f"{rigid.name}_REF, {dofs}" for dofs in held))
        if rigid.tool.tilts:
            deck.note(
                f"the {rigid.tool.name} may not tilt in the deck: its moments of inertia are not "
                "known"
            )
    first = _first_step(deck, tools, free)
    last = _driven(deck, driven)
    steps = [("travel", time, [*([] if free else first), *last])]
    if free:
        steps.insert(0, ("the holder comes to rest", SETTLE, first))
    for number, (words, duration, lines) in enumerate(steps, 1):
        deck.add(f"*STEP, NAME=STEP_{number}, NLGEOM=YES", words)
        deck.add("*DYNAMIC, EXPLICIT", f", {duration:.9g}", *lines, *_output(tools), "*END STEP")


def _first_step(deck: _Deck, tools: list[_Rigid], free: list[_Rigid]) -> list[str]:
    """Contact, and the weights and forces that stay on."""
    lines, amplitude = [], "SETTLING" if free else "TRAVEL"
    for rigid in tools:
        lines += [
            f"*CONTACT PAIR, INTERACTION={rigid.name}_TOUCH, MECHANICAL CONSTRAINT=PENALTY",
            f"SHEET_FACES, {rigid.name}_FACES",
        ]
    weights = [term for term in deck.scene.terms if isinstance(term, ToolWeight)]
    for rigid in free:
        load = sum(float(term.force) for term in weights if term.dofs[0, 0] == rigid.dof)
        lines += [f"*CLOAD, AMPLITUDE={amplitude}", f"{rigid.name}_REF, 3, {-load:.9g}"]
    if any(isinstance(term, SheetWeight) for term in deck.scene.terms):
        g = f"GRAV, {1e6 * GRAVITY:.9g}, 0., 0., -1."
        lines += [f"*DLOAD, AMPLITUDE={amplitude}", f"MEMBRANES, {g}"]
        lines += [f"SHELLS, {g}"] * deck.bends
    return lines


def _driven(deck: _Deck, driven: Iterable[_Rigid]) -> list[str]:
    """Motion of the driven tools and of the prescribed nodes."""
    lines = [f"{rigid.name}_REF, 3, 3, {deck.travel[rigid.dof]:.9g}" for rigid in driven]
    lines += [
        f"{node + 1}, {axis + 1}, {axis + 1}, {deck.moved[node, axis]:.9g}"
        for node, axis in np.argwhere(deck.moved)
    ]
    if callable(deck.scene.drive):
        deck.note("prescribed nodes go straight to their end, not along their path")
    return ["*BOUNDARY, TYPE=DISPLACEMENT, AMPLITUDE=TRAVEL", *lines] if lines else []


def _output(tools: list[_Rigid]) -> list[str]:
    lines = ["*OUTPUT, FIELD, NUMBER INTERVAL=20", "*NODE OUTPUT", "U, RF"]
    lines += ["*OUTPUT, HISTORY, TIME INTERVAL=0.001"]
    lines += ["*ENERGY OUTPUT", "ALLKE, ALLIE, ALLWK, ALLFD, ETOTAL"]
    for rigid in tools:
        lines += [f"*NODE OUTPUT, NSET={rigid.name}_REF", "U3, RF3"]
    return lines
