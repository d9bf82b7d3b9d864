"""An Abaqus/Explicit deck of a model, for an explicit run of one's own beside the implicit one.

Units N, mm, s, t, MPa. The sheet is membranes (M3D3, a user material, which is the fabric's law)
and shells (S3, bending) on the same nodes; tools are rigid triangles (R3D3) with a reference node;
contact is a penalty with the fabric's compaction stiffness and Coulomb friction. The holder comes
to rest in a first step, the punch travels in a second one by a smooth step.

The order of the constants of the user material stands in the deck (`templates/deck.inp`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError, check_number
from ..energy.bending import Bending
from ..energy.contact import Contact
from ..energy.friction import Friction
from ..energy.membrane import Membrane
from ..energy.weight import GRAVITY, SheetWeight, ToolWeight, load_of
from ..fabric import Fabric, TabulatedLaw, ThreeStageLaw
from ..model import Model
from ..result.files import writing_to
from ..result.summary import package_version
from ..tools.shapes import Tool
from .inp import DENSITY
from .keywords import fill, render
from .tool_surface import fine_enough, from_file, sampled

FloatArray = np.ndarray
SPEED = 1000.0  # mm/s, mean of the punch
SETTLE = 0.02  # s, for the holder to come to rest
MARGIN = 10.0  # mm of tool around the sheet
OFF = 0.1  # of the thickness: how far triangles may be off a tool in closed form
SOFT = 0.01  # shear modulus of the shells over that of the fabric at rest
KNOWN = (Membrane, Bending, Contact, Friction, SheetWeight, ToolWeight)


def abaqus_deck(
    model: Model,
    path: str | Path,
    *,
    speed: float = SPEED,
    spacing: float | None = None,
    force: bool = False,
) -> tuple[str, ...]:
    """Write an Abaqus/Explicit input file of a model; nothing is solved.

    The deck holds what the model models: a quarter where that has two mirror planes, with symmetry
    conditions (build the model with `symmetry="none"` for the whole). It needs a VUMAT of your own
    for the user material FABRIC; the order of its constants stands in the deck.

    Parameters
    ----------
    model : Model
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
    if len(model.sheets) > 1:
        raise InputError("a deck of several plies is not possible")
    if model.strokes:
        raise InputError("a deck of tools with a stroke is not possible")
    path, blank = Path(path), model.sheet.blank
    check_number("speed", speed)
    check_number("spacing", 1.0 if spacing is None else spacing)
    if path.exists() and not force:
        raise InputError(f"{path} exists already: choose another name, or replace it with --force")
    bends = any(isinstance(term, Bending) and term.sheet.dim == 3 for term in model.terms)
    places = model.sheet.positions(model.x0)
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    nodes, labels = 1 + np.arange(len(places)), 1 + np.arange(len(blank.triangles))
    offset = 10 ** len(str(max(nodes[-1], labels[-1])))
    tools = _tools(model, places, spacing, (offset, offset * (1 + bends)))
    supports, motions, clamped, longest = _driven(model, nodes, tools)
    time = max(longest, 1.0) / speed
    settling = [("the holder comes to rest", SETTLE)] * any(rigid.free for rigid in tools)
    others = [term for term in model.terms if not isinstance(term, KNOWN)]
    values = {"model": model, "bends": bends, "tools": tools, **_material(model, bends)}
    notices = render(
        "deck_notices.txt",
        **{"clamped": bends and clamped, "soft": SOFT, **values},
        unknown=[getattr(term, "name", type(term).__name__) for term in others],
    ).splitlines()
    words = [f"Fabric {model.sheet.fabric.name}. Units N, mm, s, t, MPa.", *notices]
    values |= {"words": [*words, *(f"{entry}: {why}" for entry, why in model.description)]}
    values |= {"nodes": nodes, "places": places, "membranes": labels, "shells": labels + offset}
    values |= {"supports": supports, "motions": motions, "settle": SETTLE, "time": time}
    values |= {"steps": [*settling, ("travel", time)], "gravity": 1e6 * GRAVITY}
    values["heavy"] = any(isinstance(term, SheetWeight) for term in model.terms)
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        fill("deck.inp", path, version=package_version(), **values)
    return tuple(notices)


def _driven(
    model: Model, nodes: np.ndarray, tools: list[_Rigid]
) -> tuple[list[tuple[str, np.ndarray, str]], list[tuple[str, int, float]], bool, float]:
    """Supports (set, nodes, what is fixed), motions (node, axis, mm), and two facts of them.

    Whether any node is held beside mirror planes, and the longest way, mm.
    """
    blank = model.sheet.blank
    end = model.prescribed(model.travel)[0] - model.x0  # over the whole travel, mm
    travel = np.where(model.fixed & (np.abs(end) > 1e-12), end, 0.0)
    moved, fixed = travel[model.sheet.dofs], model.fixed[model.sheet.dofs]
    supports = []
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            on = np.abs(blank.nodes[:, axis]) < 1e-9
            fixed[on, axis] = False
            supports.append((f"MIRROR_{plane.upper()}", nodes[on], f"{plane.upper()}SYMM"))
    for axis, held in enumerate((fixed & (moved == 0)).T, 1):
        if held.any():
            supports.append((f"HELD_{axis}", nodes[held], f"{axis}, {axis}"))
    driven = [rigid for rigid in tools if rigid.tool.motion == "driven"]
    motions = [(f"{rigid.name}_REF", 3, travel[rigid.dof]) for rigid in driven]
    motions += [(str(k + 1), axis + 1, moved[k, axis]) for k, axis in np.argwhere(moved)]
    longest = max(float(np.abs(moved).max()), model.travel if driven else 0.0)
    return supports, motions, bool(fixed.any()), longest


def constants(fabric: Fabric) -> list[float]:
    """Constants of the user material, in the order written in the deck."""

    def six(law: ThreeStageLaw) -> list[float]:
        if law.linear:
            return [law.C_ini, *[0.0] * 5]
        return [law.C_ini, law.S_ini, law.C_mid, law.dS_mid, law.C_lo, law.I_lo]

    found, shear = [*six(fabric.warp), *six(fabric.weft)], fabric.shear
    if isinstance(shear, TabulatedLaw):
        points = np.column_stack([shear.I6, shear.S12]).ravel()
        return [*found, float(len(shear.I6)), *points.tolist()]
    return [*found, 0.0, *six(shear)]


def _material(model: Model, bends: bool) -> dict[str, Any]:
    """Values of the sections and materials."""
    fabric, t0 = model.sheet.fabric, model.sheet.fabric.thickness
    # the bending stiffness of a homogeneous shell is E t³/12
    E = [12 * B / t0**3 for B in (fabric.bending_warp, fabric.bending_weft)]
    law = fabric.shear
    G = SOFT * (law.S12[1] / law.I6[1] if isinstance(law, TabulatedLaw) else law.C_ini)
    return {
        "t0": t0,
        "density": DENSITY * fabric.areal_weight / t0 / (1 + bends),
        "axes": (*model.sheet.blank.warp, 0.0, *model.sheet.blank.weft, 0.0),
        "constants": [f"{value:.9g}" for value in constants(fabric)],
        "lamina": (*E, 0.0, G, G, G),
        "added": max(E) / (4 * min(fabric.warp.C_ini, fabric.weft.C_ini)),
    }


@dataclass(frozen=True, eq=False)
class _Rigid:
    """A tool in the deck."""

    tool: Tool
    dof: int
    name: str
    origin: FloatArray
    vertices: FloatArray
    triangles: np.ndarray
    sampled: tuple[float, ...]  # spacing as wanted and as taken, and how far off; empty: a file's
    reference: int  # label of its node
    elements: np.ndarray
    load: float
    mass: float

    @property
    def free(self) -> bool:
        return self.tool.motion == "free"

    @property
    def nodes(self) -> np.ndarray:
        return self.reference + 1 + np.arange(len(self.vertices))


def _tools(
    model: Model, places: FloatArray, spacing: float | None, last: tuple[int, int]
) -> list[_Rigid]:
    """Tools of the model, labelled after the last node and the last element."""
    found: dict[str, _Rigid] = {}
    last_node, last_element = last
    for contact in model.contacts:
        tool, dof = contact.tool, int(contact.tool_dofs[0])
        if tool.name in found:
            continue
        surface = _triangles(model, places, contact, spacing)
        plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in tool.name).upper()
        name = f"T_{plain}"[:60]
        while name in {rigid.name for rigid in found.values()}:
            name += "_2"
        rigid = found[tool.name] = _Rigid(
            *(tool, dof, name, contact.origin(model.x0), *surface),
            reference=last_node + 1,
            elements=last_element + 1 + np.arange(len(surface[1])),
            load=load_of(tool) * model.share * (tool.motion == "free"),
            mass=1e-3 * (tool.mass or load_of(tool) / (1e3 * GRAVITY)) * model.share,
        )
        last_node += 1 + len(rigid.vertices)
        last_element += len(rigid.triangles) + rigid.free
    return list(found.values())


def _triangles(
    model: Model, places: FloatArray, contact: Contact, spacing: float | None
) -> tuple[FloatArray, np.ndarray, tuple[float, ...]]:
    """Vertices and triangles of a tool in its own frame, and how it was sampled (`_Rigid`)."""
    tool, origin = contact.tool, contact.origin(model.x0)
    given = from_file(tool, model)
    if given is not None:
        return *given, ()
    deep = model.travel if model.travel_name == "travel_mm" else np.ptp(places, axis=0).max()
    margin = np.array([MARGIN, MARGIN, MARGIN + deep])
    low, high = places.min(0) - origin - margin, places.max(0) - origin + margin
    box = getattr(tool.shape, "box", None)
    if box is not None:
        low, high = np.maximum(low, box[0] - MARGIN), np.minimum(high, box[1] + MARGIN)
    fine = fine_enough(tool.shape, OFF * model.sheet.fabric.thickness)
    wanted = spacing or min(model.sheet.blank.size, fine)
    vertices, triangles, *taken = sampled(tool.shape, low, high, wanted)
    return vertices, triangles, (wanted, *taken)
