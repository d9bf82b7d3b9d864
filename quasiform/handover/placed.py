"""A structural mesh that lies elsewhere than the formed part: placed, filled, and put back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError
from ..comparison.place import aligned
from ..meshes.shells import Shells, counted
from ..result.record import Record
from ..result.sheet import FormedSheet
from .fibres import Fibres, carry

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FloatArray = np.ndarray


def three(name: str, values: Sequence[float]) -> FloatArray:
    """Return (3,) numbers, or refuse them by name."""
    try:
        found = np.array([*map(float, values)])
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise InputError(f"{name} must be three numbers, got {values!r}")
    return found


@dataclass(frozen=True, eq=False)
class Placed:
    """A structural mesh: its elements as they are, and moved onto the formed part."""

    own: Shells
    moved: Shells
    turn: Rotation
    words: str  # how it was moved to fit the part; empty if it was not


def placed(
    record: Record, target: Shells, origin: FloatArray, angles: FloatArray, align: str
) -> Placed:
    """Move a mesh onto the part."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", angles, degrees=True)
    points, words = turn.apply(target.points - origin), ""
    if align != "none":
        there = FormedSheet(points, target.split()[0])
        moved, words = aligned(there, record.sheet, align == "rigid")
        middles = points - points.mean(0), moved.points - moved.points.mean(0)
        turn, points = Rotation.align_vectors(*middles[::-1])[0] * turn, moved.points
    return Placed(target, replace(target, points=points), turn, words)


def carry_placed(record: Record, mesh: Placed, within: float | None) -> Fibres:
    """Fibres of a mesh that was moved onto the part, in its own place."""
    fibres, target, words = carry(record, mesh.moved, within), mesh.own, mesh.words
    notices = [f"the mesh was {words} to find its fibres"] * bool(words)
    notices += [f"left out of the mesh: {counted(target.left_out)}"] * bool(target.left_out)
    back = {axis: mesh.turn.inv().apply(getattr(fibres, axis)) for axis in ("warp", "weft")}
    return replace(fibres, target=target, **back, notices=(*fibres.notices, *notices))
