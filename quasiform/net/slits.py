"""Slits: open lines along which a blank is cut, so that both edges part. Lengths mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..checks import InputError
from ..tools.mending import position

FloatArray = np.ndarray
TINY = 1e-6  # of the blank's size: what is nearer touches


def as_lines(slits: Sequence[FloatArray]) -> Any:
    """All slits as one shapely geometry, divided where they cross or touch each other."""
    import shapely
    from scipy.spatial import cKDTree

    if not slits:
        return shapely.MultiLineString()
    lines, given = [shapely.LineString(line) for line in slits], np.vstack(slits)
    grid = 1e-3 * TINY * float(np.ptp(given, axis=0).max())
    divided = shapely.union_all(lines, grid_size=grid)

    def as_given(points: FloatArray) -> FloatArray:
        """Points without the rounding to the grid."""
        off, nearest = cKDTree(given).query(points)
        return np.where(off[:, None] <= 2 * grid, given[nearest], points)

    return shapely.transform(divided, as_given)


def joined(segments: FloatArray) -> list[FloatArray]:
    """Lines (k, 2) of segments (n, 2, 2) that meet in their ends."""
    import shapely

    merged = shapely.line_merge(shapely.multilinestrings(shapely.linestrings(segments)))
    return [shapely.get_coordinates(line) for line in shapely.get_parts(merged)]


def check_slits(outline: Any, slits: Sequence[FloatArray]) -> None:
    """Refuse (InputError) slits outside of an outline or along it, and those that divide it."""
    import shapely

    tiny = TINY * np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).max()
    inner = outline.buffer(-tiny)
    for k, line in enumerate(slits, 1):
        at = f"slit {k} near {position(shapely.LineString(line).centroid.coords[0])}"
        if shapely.LineString(line).intersection(inner).length <= tiny:
            raise InputError(f"{at} does not lie inside the outline")
        beside = outline.boundary.buffer(tiny)
        if shapely.LineString(line).intersection(beside).length > 1000 * tiny:
            raise InputError(f"{at} runs along the outline")
        parts = shapely.get_parts(outline.difference(as_lines(slits[:k]).buffer(tiny)))
        if sum(part.area > tiny**2 for part in parts) > 1:
            raise InputError(f"{at} divides the blank")


def mirror_slits(slits: Sequence[FloatArray], axis: int, near: float) -> bool:
    """Whether slits have a mirror plane x = 0 (axis 0) or y = 0, and none lies on it."""
    import shapely

    if not slits:
        return True
    lines, flip = as_lines(slits), np.where(np.arange(2) == axis, -1.0, 1.0)
    image = shapely.transform(lines, lambda p: p * flip)
    far = 2 * np.abs(lines.bounds).max()
    strip = np.where(np.arange(2) == axis, near, far)
    on_plane = lines.intersection(shapely.box(*-strip, *strip)).length
    return lines.buffer(near).covers(image) and on_plane <= 100 * near * len(slits)


def met(
    rings: list[FloatArray], slits: Sequence[FloatArray], near: float
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Rings of an outline and its holes, and what of slits lies inside, with common points.

    Where slits meet the rings within `near`, the rings have a vertex; where slits meet, they end.
    """
    import shapely

    if not slits:
        return rings, []
    rings, polygon = list(rings), shapely.Polygon(rings[0], rings[1:])
    inside = shapely.line_merge(as_lines(slits).intersection(polygon))
    parts = [part for part in shapely.get_parts(inside) if part.length > near]
    lines = [shapely.get_coordinates(part) for part in parts if part.geom_type == "LineString"]
    for line, end in ((line, end) for line in lines for end in (0, -1)):
        loops = [shapely.LineString(np.vstack([ring, ring[:1]])) for ring in rings]
        point = shapely.Point(line[end])
        k = int(np.argmin([loop.distance(point) for loop in loops]))
        if loops[k].distance(point) > near:
            continue
        along = loops[k].project(point)
        sides = np.linalg.norm(np.diff(loops[k].coords, axis=0), axis=1)
        at = min(int(np.searchsorted(np.cumsum(sides), along)), len(sides) - 1)
        nearest = np.array(loops[k].interpolate(along).coords[0])
        off = np.linalg.norm(rings[k] - nearest, axis=1)
        if off.min() < TINY * near:
            line[end] = rings[k][off.argmin()]
        else:
            line[end] = nearest
            rings[k] = np.insert(rings[k], at + 1, nearest, axis=0)
    return rings, lines
