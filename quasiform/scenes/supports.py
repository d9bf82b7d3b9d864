"""Supports and grippers of a scene, and what keeps a sheet in place without friction."""

from __future__ import annotations

import numpy as np
import shapely

from ..checks import InputError
from ..energy.gripper import Grip
from ..energy.term import Term
from ..model import Model
from ..unknowns import Sheet
from .scene_file import SceneFile
from .scene_parts import OUTWARDS

NEAR = 0.25  # of the blank's width: how near a gripper is to the side that it pulls


def fix_supports(model: Model, file: SceneFile, outline: shapely.Polygon) -> np.ndarray | None:
    """Prescribe supported nodes; (n_nodes,) bool array of those that are clamped, or None."""
    sheet = model.sheet
    clamped = np.zeros(len(sheet.blank.nodes), dtype=bool)
    for i, support in enumerate(file.supports, 1):
        nodes = support.where.nodes(sheet.blank.nodes, outline.bounds)
        if not nodes.any():
            raise InputError(f"[supports {i}] no node of the blank lies there")
        for axis, letter in enumerate("xyz"):
            if letter in support.fix:
                model.fixed[sheet.dofs[:, axis]] |= nodes
        clamped |= nodes & support.clamp
    return clamped if clamped.any() else None


def grips(model: Model, file: SceneFile, outline: shapely.Polygon) -> list[Term]:
    """The grippers' pulls, shared by the length of the gripped edge, or by area."""
    sheet = model.sheet
    blank, positions = sheet.blank, sheet.positions(model.x0)
    pulls: list[Term] = []
    for i, gripper in enumerate(file.grippers, 1):
        at = np.flatnonzero(gripper.where.nodes(blank.nodes, outline.bounds))
        if not len(at):
            raise InputError(f"[grippers {i}] no node of the blank lies there")
        rim = blank.mesh.facets[:, blank.mesh.boundary_facets()].T
        rim = rim[np.isin(rim, at).all(1)] if gripper.where.side else rim[:0]
        part = blank.node_areas
        if len(rim):
            length = np.linalg.norm(np.diff(blank.nodes[rim], axis=1)[:, 0], axis=1)
            part = np.bincount(rim.ravel(), np.repeat(length, 2), minlength=len(blank.nodes))
        pull = gripper.direction or _outwards(blank.nodes[at], outline.bounds)
        if pull is None:
            words = "direction missing: it is not at a side of the blank"
            raise InputError(f"[grippers {i}] {words}")
        shares, direction = part[at] / part[at].sum(), np.array([*pull, 0.0])
        pulls.append(
            Grip(sheet, at, shares, positions[at], direction, gripper.tension, gripper.stiffness)
        )
    return pulls


def _outwards(
    points: np.ndarray, bounds: tuple[float, float, float, float]
) -> tuple[float, float] | None:
    """Direction away from the nearest side of the blank's bounding box; None if none is near."""
    (x0, y0), (x1, y1), (x, y) = bounds[:2], bounds[2:], points.mean(0)
    far = {"+x": x1 - x, "-x": x - x0, "+y": y1 - y, "-y": y - y0}
    side = min(far, key=far.get)
    return OUTWARDS[side] if far[side] < NEAR * min(x1 - x0, y1 - y0) else None


def keep_middle(model: Model, sheet: Sheet, file: SceneFile) -> None:
    """Without friction the middle of a sheet keeps its place in the plane, and a node its side.

    That node lies on the x axis, or as near to it as the net allows: it then moves along x, however
    the fibres run, and the sheet does not turn.
    """
    fixed, blank = model.fixed, sheet.blank
    if file.supports or file.grippers or len(blank.mirror) == 2:
        return
    middle = np.linalg.norm(blank.nodes, axis=1).argmin()
    for axis, plane in enumerate("xy"):
        if plane not in blank.mirror:
            fixed[sheet.dofs[middle, axis]] = True
    if not blank.mirror:
        x, y = np.abs(blank.nodes - blank.nodes[middle]).T
        aside = np.where((x > 3 * blank.size) & (x < 12 * blank.size), y / np.maximum(x, 1e-9), 1)
        far = np.lexsort([x, aside.round(6)])[0]
        fixed[sheet.dofs[far, 1]] = True
    why = "no friction keeps it in place"
    model.description.append((f"middle of the {sheet.name} fixed in the plane", why))
