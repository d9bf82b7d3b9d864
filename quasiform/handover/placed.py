"""A structural mesh that lies elsewhere than the formed part: placed, filled, and put back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..checks import InputError
from ..comparison.place import aligned
from ..meshes.shells import Shells, counted
from ..result.record import Record
from ..result.sheet import FormedSheet
from .fibres import Fibres, carry

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


def carry_placed(
    record: Record, target: Shells, place: tuple[FloatArray, FloatArray, str], within: float | None
) -> Fibres:
    """Fibres of a mesh that is moved onto the part by `place` (origin, angles, align)."""
    from scipy.spatial.transform import Rotation

    origin, angles, align = place
    turn = Rotation.from_euler("xyz", angles, degrees=True)
    points, words = turn.apply(target.points - origin), ""
    if align != "none":
        there = FormedSheet(points, target.split()[0])
        moved, words = aligned(there, record.sheet, align == "rigid")
        middles = points - points.mean(0), moved.points - moved.points.mean(0)
        turn, points = Rotation.align_vectors(*middles[::-1])[0] * turn, moved.points
    fibres = carry(record, replace(target, points=points), within)
    notices = [f"the mesh was {words} to find its fibres"] * bool(words)
    notices += [f"left out of the mesh: {counted(target.left_out)}"] * bool(target.left_out)
    back = {axis: turn.inv().apply(getattr(fibres, axis)) for axis in ("warp", "weft")}
    return replace(fibres, target=target, **back, notices=(*fibres.notices, *notices))
