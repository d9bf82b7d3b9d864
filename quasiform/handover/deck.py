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
from ..energy.weight import GRAVITY, SheetWeight, ToolWeight
from ..fabric import Fabric, TabulatedLaw, ThreeStageLaw
from ..model import Model
from ..result.summary import package_version
from ..tools.shapes import Tool
from .inp import DENSITY
from .keywords import fill
from .tool_surface import fine_enough, from_scene_file, sampled

FloatArray = np.ndarray
Notices = list[str]
SPEED = 1000.0  # mm/s, mean of the punch
SETTLE = 0.02  # s, for the holder to come to rest
MARGIN = 10.0  # mm of tool around the sheet
OFF = 0.1  # of the thickness: how far triangles may be off a tool in closed form
SOFT = 0.01  # shear modulus of the shells over that of the fabric at rest
NOT_RUN = (
    "the deck is not run: its syntax is checked only; mass scaling and the time are yours "
    "to choose, watch the kinetic energy"
)
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
    path = Path(path)
    check_number("speed", speed)
    check_number("spacing", 1.0 if spacing is None else spacing)
    if path.exists() and not force:
        raise InputError(f"{path} exists already: choose another name, or replace it with --force")
    bends = any(isinstance(term, Bending) for term in model.terms)
    notices = ["membranes alone: the model has no bending"] * (not bends)
    places = model.sheet.positions(model.x0)
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    nodes, labels = 1 + np.arange(len(places)), 1 + np.arange(len(model.sheet.blank.triangles))
    offset = 10 ** len(str(max(nodes[-1], labels[-1])))
    material = _material(model, bends, notices)
    tools = _tools(model, places, spacing, (offset, offset * (1 + bends)), notices)
    end = model.prescribed(model.travel)[0] - model.x0  # over the whole travel, mm
    travel = np.where(model.fixed & (np.abs(end) > 1e-12), end, 0.0)
    supports = _supports(model, travel, bends, notices)
    motions = _motions(model, travel, tools, notices)
    driven = model.travel if any(rigid.tool.motion == "driven" for rigid in tools) else 0.0
    time = max(float(np.abs(travel[model.sheet.dofs]).max()), driven, 1.0) / speed
    settling = [("the holder comes to rest", SETTLE)] * any(rigid.free for rigid in tools)
    unknown = [term for term in model.terms if not isinstance(term, KNOWN)]
    names = [getattr(term, "name", type(term).__name__) for term in unknown]
    notices = [NOT_RUN, *notices, *(f"not in the deck: {name}" for name in names)]
    words = [f"Fabric {model.sheet.fabric.name}. Units N, mm, s, t, MPa.", *notices]
    words += [f"{entry}: {why}" for entry, why in model.description]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fill(
            "deck.inp",
            path,
            version=package_version(),
            **{"model": model, "words": words, "bends": bends, "nodes": nodes, "places": places},
            **{"membranes": labels, "shells": labels + offset, "tools": tools},
            **{"supports": supports, "motions": motions, "settle": SETTLE, "time": time},
            **{"steps": [*settling, ("travel", time)], "gravity": 1e6 * GRAVITY},
            heavy=any(isinstance(term, SheetWeight) for term in model.terms),
            **material,
        )
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
    return tuple(notices)


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


def _material(model: Model, bends: bool, notices: list[str]) -> dict[str, Any]:
    """Values of the sections and materials."""
    fabric, t0 = model.sheet.fabric, model.sheet.fabric.thickness
    density = DENSITY * fabric.areal_weight / t0 / (1 + bends)
    if not density:
        notices.append("the fabric has no areal weight: an explicit run needs a density")
    # the bending stiffness of a homogeneous shell is E t³/12
    E = [12 * B / t0**3 for B in (fabric.bending_warp, fabric.bending_weft)]
    law = fabric.shear
    G = SOFT * (law.S12[1] / law.I6[1] if isinstance(law, TabulatedLaw) else law.C_ini)
    fibre = min(fabric.warp.C_ini, fabric.weft.C_ini) * 4
    if bends:
        notices += [
            f"the shells bend by E = 12 B/t0³ (warp {E[0]:.4g}, weft {E[1]:.4g} MPa), which adds "
            f"{100 * max(E) / fibre:.2g} % to the fibres' tension stiffness; their two axes stay "
            "at right angles, which the sheared fibres do not",
            f"the shells' shear moduli are {SOFT:g} of the fabric's at rest (assumed): the fabric "
            "has no stiffness against twisting",
            "membranes and shells have half the mass each",
        ]
    if bends and fabric.in_plane_bending and model.sheet.dim == 3:
        words = f"({fabric.in_plane_bending:g} of the bending stiffness)"
        words = f"in-plane bending of the fibres {words}, which shells of this kind do not have"
        notices.append(f"not in the deck: {words}")
    return {
        "t0": t0,
        "density": density,
        "axes": (*model.sheet.blank.warp, 0.0, *model.sheet.blank.weft, 0.0),
        "constants": [f"{value:.9g}" for value in constants(fabric)],
        "lamina": (*E, 0.0, G, G, G),
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
    reference: int  # label of its reference node
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
    model: Model, places: FloatArray, spacing: float | None, last: tuple[int, int], notices: Notices
) -> list[_Rigid]:
    """Tools of the model, labelled after the last node and the last element."""
    found: dict[str, _Rigid] = {}
    last_node, last_element = last
    for contact in model.contacts:
        tool, dof = contact.tool, int(contact.tool_dofs[0])
        if tool.name in found:
            continue
        vertices, triangles = _triangles(model, places, contact, spacing, notices)
        plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in tool.name).upper()
        name = f"T_{plain}"[:60]
        while name in {rigid.name for rigid in found.values()}:
            name += "_2"
        mass = tool.mass or tool.force / (1e3 * GRAVITY)
        if tool.motion == "free" and not tool.mass:
            words = f"{mass:.3g} kg, which weigh as much, stand in"
            notices.append(f"the {tool.name} has a force and no mass: {words}")
        weights = (term for term in model.terms if isinstance(term, ToolWeight))
        found[tool.name] = _Rigid(
            *(tool, dof, name, contact.origin(model.x0), vertices, triangles),
            reference=last_node + 1,
            elements=last_element + 1 + np.arange(len(triangles)),
            load=sum(float(term.force) for term in weights if term.dofs[0, 0] == dof),
            mass=1e-3 * mass * model.share,
        )
        last_node += 1 + len(vertices)
        last_element += len(triangles) + found[tool.name].free
    words = "may not tilt in the deck: its moments of inertia are not known"
    notices += [f"the {rigid.tool.name} {words}" for rigid in found.values() if rigid.tool.tilts]
    return list(found.values())


def _triangles(
    model: Model, places: FloatArray, contact: Contact, spacing: float | None, notices: Notices
) -> tuple[FloatArray, np.ndarray]:
    """Triangles of a tool in its own frame."""
    tool, origin = contact.tool, contact.origin(model.x0)
    given = from_scene_file(tool, model.parameters, model.sheet.turn)
    if given is not None:
        notices.append(f"the {tool.name} has the {len(given[1])} triangles of its file")
        return given
    deep = model.travel if model.travel_name == "travel_mm" else np.ptp(places, axis=0).max()
    margin = np.array([MARGIN, MARGIN, MARGIN + deep])
    low, high = places.min(0) - origin - margin, places.max(0) - origin + margin
    box = getattr(tool.shape, "box", None)
    if box is not None:
        low, high = np.maximum(low, box[0] - MARGIN), np.minimum(high, box[1] + MARGIN)
    fine = fine_enough(tool.shape, OFF * model.sheet.fabric.thickness)
    wanted = spacing or min(model.sheet.blank.size, fine)
    vertices, triangles, taken, off = sampled(tool.shape, low, high, wanted)
    coarser = f", not {wanted:.3g} as wanted," if taken > wanted * (1 + 1e-9) else ""
    notices.append(
        f"the {tool.name} is {len(triangles)} triangles about {taken:.3g} mm wide{coarser} "
        f"sampled from its distance, at most {off:.2g} mm off"
    )
    return vertices, triangles


def _supports(
    model: Model, travel: FloatArray, bends: bool, notices: Notices
) -> list[tuple[str, np.ndarray, str]]:
    """Sets of nodes that symmetry or the model holds: name, nodes, what is fixed."""
    blank, found = model.sheet.blank, []
    nodes = 1 + np.arange(len(blank.nodes))
    fixed = model.fixed[model.sheet.dofs]
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            on = np.abs(blank.nodes[:, axis]) < 1e-9
            fixed[on, axis] = False
            found.append((f"MIRROR_{plane.upper()}", nodes[on], f"{plane.upper()}SYMM"))
    share, turn = model.share, model.sheet.turn
    if blank.mirror:
        notices.append(f"{share:g} of the whole is modelled: multiply forces by {1 / share:g}")
    if turn:
        notices.append(f"the deck is in the model's axes, turned by {turn:g}° from the user's")
    for axis, held in enumerate((fixed & (travel[model.sheet.dofs] == 0)).T, 1):
        if held.any():
            found.append((f"HELD_{axis}", nodes[held], f"{axis}, {axis}"))
    if bends and fixed.any():
        notices.append("supports hold places only: a clamp's rotations are not in the deck")
    return found


def _motions(
    model: Model, travel: FloatArray, tools: list[_Rigid], notices: list[str]
) -> list[tuple[str, int, float]]:
    """Motion of driven tools and of prescribed nodes: node or set, axis, mm."""
    if callable(model.drive):
        notices.append("prescribed nodes go straight to their end, not along their path")
    driven = [rigid for rigid in tools if rigid.tool.motion == "driven"]
    moved = travel[model.sheet.dofs]
    return [
        *((f"{rigid.name}_REF", 3, travel[rigid.dof]) for rigid in driven),
        *((str(node + 1), axis + 1, moved[node, axis]) for node, axis in np.argwhere(moved)),
    ]
