"""Supports and grippers of a scene, and what keeps a sheet in place without friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..checks import InputError
from ..energy.gripper import Grip
from ..energy.plies import PlyFriction
from ..energy.term import Term
from ..model import Model
from ..net.blank import Blank
from ..unknowns import FloatArray, Sheet
from .scene_parts import OUTWARDS, Gripper, SceneFile, Support
from .stack import Layer, outline_of

Bounds = tuple[float, float, float, float]
NEAR = 0.25  # of the blank's width: how near a gripper is to the side that it pulls


@dataclass(frozen=True, eq=False)
class Held:
    """A sheet that a support or a gripper holds."""

    sheet: Sheet
    nodes: np.ndarray  # their numbers
    measure: float  # of its plies that are held: length of the edge, mm, or area, mm²


def _held(
    model: Model, layers: Sequence[Layer], edge: Support | Gripper, entry: str
) -> tuple[list[Held], Bounds]:
    """What a support or a gripper holds, and the bounds of the plies among which it was sought.

    InputError for a ply that is not in the scene, and for one that lies there without a node.
    """
    known = sum(len(layer.plies) for layer in layers)
    if max(edge.plies or (0,)) > known:
        got = list(edge.plies)
        raise InputError(f"[{entry}] plies = {got}: the scene has {known or 'no'} [[plies]]")
    picked = [set(layer.plies).intersection(edge.plies or layer.plies) for layer in layers]
    sought = [k for k, plies in enumerate(picked) if plies or not known]
    bounds = outline_of([layers[k] for k in sought]).bounds
    held: list[Held] = []
    for k in sought:
        nodes = np.flatnonzero(edge.where.nodes(model.sheets[k].blank.nodes, bounds))
        measure = edge.where.measure(layers[k].outline, bounds)
        if len(nodes):
            held.append(Held(model.sheets[k], nodes, max(len(picked[k]), 1) * measure))
        elif known and (edge.plies or measure):
            raise InputError(f"[{entry}] no node of ply {min(picked[k])} lies there")
    if not held:
        raise InputError(f"[{entry}] no node of the blank lies there")
    if len(layers) > 1:
        names = " and ".join(found.sheet.name for found in held)
        model.description.append((f"held by [{entry}]", names))
    return held, bounds


def fix_supports(model: Model, file: SceneFile, layers: Sequence[Layer]) -> dict[str, np.ndarray]:
    """Prescribe supported nodes; by name of each sheet that has some, which are clamped (n,)."""
    clamped: dict[str, np.ndarray] = {}
    for i, support in enumerate(file.supports, 1):
        for found in _held(model, layers, support, f"supports {i}")[0]:
            sheet, nodes = found.sheet, found.nodes
            for axis, letter in enumerate("xyz"):
                if letter in support.fix:
                    model.fixed[sheet.dofs[nodes, axis]] = True
            clamped.setdefault(sheet.name, np.zeros(len(sheet.dofs), dtype=bool))
            clamped[sheet.name][nodes] |= support.clamp
    return clamped


def grips(model: Model, file: SceneFile, layers: Sequence[Layer]) -> list[Grip]:
    """The grippers' pulls, one for each sheet that a gripper holds.

    Each ply and mm of its edge (or mm² of its area) bears as much.
    """
    pulls: list[Grip] = []
    for i, gripper in enumerate(file.grippers, 1):
        held, bounds = _held(model, layers, gripper, f"grippers {i}")
        places = np.vstack([found.sheet.blank.nodes[found.nodes] for found in held])
        pull = gripper.direction or _outwards(places, bounds)
        if pull is None:
            words = "direction missing: it is not at a side of the blank"
            raise InputError(f"[grippers {i}] {words}")
        given = np.array([*pull, 0.0]), gripper.tension, gripper.stiffness
        total = sum(found.measure for found in held)
        for found in held:
            sheet, at = found.sheet, found.nodes
            share = found.measure / total if total else 1.0 / len(held)
            shares = share * _shares(sheet.blank, at, bool(gripper.where.side))
            pulls.append(Grip(sheet, at, shares, sheet.positions(model.x0)[at], *given))
    return pulls


def _shares(blank: Blank, at: np.ndarray, at_a_side: bool) -> FloatArray:
    """Shares of nodes, which sum to 1: by the length of the gripped edge, or by area."""
    rim = blank.mesh.facets[:, blank.mesh.boundary_facets()].T
    rim = rim[np.isin(rim, at).all(1)] if at_a_side else rim[:0]
    part = blank.node_areas
    if len(rim):
        length = np.linalg.norm(np.diff(blank.nodes[rim], axis=1)[:, 0], axis=1)
        part = np.bincount(rim.ravel(), np.repeat(length, 2), minlength=len(blank.nodes))
    return part[at] / part[at].sum()


def _outwards(points: np.ndarray, bounds: Bounds) -> tuple[float, float] | None:
    """Direction away from the nearest side of the blank's bounding box; None if none is near."""
    (x0, y0), (x1, y1), (x, y) = bounds[:2], bounds[2:], points.mean(0)
    far = {"+x": x1 - x, "-x": x - x0, "+y": y1 - y, "-y": y - y0}
    side = min(far, key=far.get)
    return OUTWARDS[side] if far[side] < NEAR * min(x1 - x0, y1 - y0) else None


def keep_middles(model: Model, gripped: set[str], between: Sequence[Term]) -> None:
    """Without friction on tools the middle of each sheet keeps its place in the plane.

    But not of those that are held as a rigid body by supports, clamps or mirror planes, or by a
    gripper, or that rub on such a one, directly or by others in between.
    """
    rubbing = [term.contact for term in between if isinstance(term, PlyFriction)]
    pairs = [{c.sheet.name, c.other.name} for c in rubbing]
    kept = gripped | {sheet.name for sheet in model.sheets if _held_motions(model, sheet) == 3}
    while found := [pair for pair in pairs if len(pair & kept) == 1]:
        kept.update(*found)
    for sheet in model.sheets:
        if sheet.name not in kept:
            _keep_middle(model, sheet)


def _held_motions(model: Model, sheet: Sheet) -> int:
    """How many of the three rigid motions of a sheet in its plane are fixed."""
    (X, Y), fixed, one = sheet.blank.nodes.T, model.fixed[sheet.dofs], np.ones(len(sheet.dofs))
    along = np.column_stack([one, 0.0 * one, -Y])[fixed[:, 0]]
    across = np.column_stack([0.0 * one, one, X])[fixed[:, 1]]
    rows = np.vstack([along, across])
    return int(np.linalg.matrix_rank(rows / [1.0, 1.0, np.abs(sheet.blank.nodes).max()]))


def _keep_middle(model: Model, sheet: Sheet) -> None:
    """Keep the middle of a sheet in the plane, and a node to the side, as far as they are free.

    That node lies on the x axis, or as near to it as the net allows: it then moves along x, however
    the fibres run, and the sheet does not turn.
    """
    blank, motions = sheet.blank, _held_motions(model, sheet)
    middle = np.linalg.norm(blank.nodes, axis=1).argmin()
    x, y = np.abs(blank.nodes - blank.nodes[middle]).T
    aside = np.where((x > 3 * blank.size) & (x < 12 * blank.size), y / np.maximum(x, 1e-9), 1)
    far = np.lexsort([x, aside.round(6)])[0]
    for dof in (*sheet.dofs[middle, :2], sheet.dofs[far, 1]):
        before, model.fixed[dof] = model.fixed[dof], True
        held = _held_motions(model, sheet)
        model.fixed[dof], motions = before or held > motions, held
    why = "no friction keeps it in place"
    model.description.append((f"middle of the {sheet.name} fixed in the plane", why))
