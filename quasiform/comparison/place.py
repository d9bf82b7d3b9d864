"""Bring a reference into the place of a result: unfold a part, shift and turn the whole.

Unfolding mirrors a half or a quarter at x = 0 and y = 0; the sign of γ changes with each mirror.

The rigid motion (shift in the plane and along z, turn about z) makes the sum of squares of the
distances of the reference's outline from the result's, seen along z, and of its points from the
result's surface as small as possible: iterated closest points [1]_ by Gauss-Newton, from a start
every 15 degrees. The turn is found by the outlines where both are known. Of turns that fit equally
well, as for a square sheet, the smallest is taken.

References
----------
.. [1] P. J. Besl, N. D. McKay, IEEE Trans. Pattern Anal. Mach. Intell. 14 (1992) 239-256.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError
from ..net.blank import rotation
from ..result.sheet import FormedSheet
from .mapping import ANGLE, SLIPS, closest, spacing

if TYPE_CHECKING:
    import shapely

FloatArray = np.ndarray
ON_PLANE = 1e-3  # of the spacing of the points
STARTS = 24
TRIED = 8  # of the starts, the best ones
MOST = 300  # points of each sort that are fitted
SCALE = np.array([1.0, 1.0, 1.0, 0.01])  # mm, and the turn that moves an edge as far
AS_GOOD = 1.05  # fits within this factor (and 0.01 mm) are equal


def rim(sheet: FormedSheet) -> shapely.LineString | None:
    """Outer outline of the formed sheet seen along z, mm; without its holes."""
    import shapely

    if sheet.contour is not None:
        return shapely.LineString(sheet.contour)
    if not len(sheet.triangles) or sheet.points is None:
        return None
    return shapely.LineString(sheet.outline[0][:, :2])


def unfolded(sheet: FormedSheet, mirror: tuple[str, ...], signed: bool) -> FormedSheet:
    """Mirror a part of a sheet at the planes x = 0, y = 0, where γ is zero if it is `signed`."""
    for plane in mirror:
        axis = "xy".index(plane)
        sheet = _mirrored(sheet, axis, signed) if sheet.contour is None else _doubled(sheet, axis)
    return sheet


def _mirrored(sheet: FormedSheet, axis: int, signed: bool) -> FormedSheet:
    along, slack = sheet.rest[:, axis], ON_PLANE * spacing(sheet)
    _check_side(along, slack, axis)
    on = np.abs(along) <= slack
    number = np.where(on, np.arange(len(along)), len(along) - 1 + np.cumsum(~on))
    sign, meshed = -1.0 if signed else 1.0, len(sheet.triangles) > 0

    def both(values: FloatArray | None) -> FloatArray | None:
        if values is None:
            return None
        flip = np.where(np.arange(values.shape[1]) == axis, -1.0, 1.0)
        return np.vstack([values, values[~on] * flip])

    def angle(values: FloatArray) -> FloatArray:
        own = np.where(on, 0.0, values) if signed and meshed else values
        return np.append(own, sign * values[~on])

    slid = {k: v for k, v in sheet.point_fields.items() if k in SLIPS.values()}
    at_points = {name: np.append(values, values[~on]) for name, values in slid.items()}
    if ANGLE in sheet.point_fields:
        at_points[ANGLE] = angle(sheet.point_fields[ANGLE])
    return FormedSheet(
        both(sheet.points),
        np.vstack([sheet.triangles, number[sheet.triangles][:, ::-1]]),
        both(sheet.flat),
        at_points,
        {name: np.append(v, sign * v) for name, v in sheet.cell_fields.items() if name == ANGLE},
        *(sheet.name, sheet.travel),
    )


def _doubled(sheet: FormedSheet, axis: int) -> FormedSheet:
    """Mirror a contour; what of it runs along the plane is no outline and is left out."""
    import shapely

    near = 1e-3 * np.ptp(sheet.contour, axis=0).max()
    _check_side(sheet.contour[:, axis], near, axis)
    plane = shapely.LineString(np.outer([-1e6, 1e6], np.eye(2)[1 - axis])).buffer(near)
    line = shapely.line_merge(rim(sheet).difference(plane))
    points = shapely.get_coordinates(line)
    ends = np.abs(points[[0, -1], axis]) <= 2 * near
    if line.geom_type != "LineString" or not ends.any():
        name = "xy"[axis]
        raise InputError(f"mirror {name}: the contour does not end at {name} = 0")
    points = points if ends[1] else points[::-1]
    flip = np.where(np.arange(2) == axis, -1.0, 1.0)
    last = points[:1] if ends.all() else points[:0]
    return replace(sheet, contour=np.vstack([points, (points * flip)[::-1], last]))


def _check_side(along: FloatArray, slack: float, axis: int) -> None:
    if along.min() < -slack and along.max() > slack:
        plane = "xy"[axis]
        raise InputError(
            f"mirror {plane}: the reference lies on both sides of {plane} = 0 "
            f"({along.min():.4g} to {along.max():.4g} mm)"
        )


def aligned(sheet: FormedSheet, result: FormedSheet, turning: bool) -> tuple[FormedSheet, str]:
    """Move a reference to where it fits the result best; the motion and what is left as text."""
    import shapely

    own, line = rim(sheet), rim(result)
    edge = body = None
    if own is not None and line is not None:
        at = np.linspace(0.0, 1.0, MOST, endpoint=False)
        edge = shapely.get_coordinates(shapely.line_interpolate_point(own, at, normalized=True))
    if sheet.points is not None and result.points is not None and len(result.triangles):
        body = sheet.points[:: max(1, len(sheet.points) // MOST)]
    if edge is None and body is None:
        raise InputError("nothing to align by: the reference has no formed points and no outline")
    plan = edge if edge is not None else body[:, :2]
    goal = shapely.get_coordinates(line) if edge is not None else result.points[:, :2]
    middle, aim = (0.5 * (p.min(0) + p.max(0)) for p in (plan, goal))
    rise = 0.0 if body is None else float(np.max(result.points[:, 2]) - np.max(body[:, 2]))

    def moved(points: FloatArray, motion: FloatArray) -> FloatArray:
        """Turn points about their middle and shift them."""
        xy = (points[:, :2] - middle) @ rotation(np.degrees(motion[3])).T + aim + motion[:2]
        return np.column_stack([xy, points[:, 2:] + rise + motion[2]])

    def off(motion: FloatArray, with_body: bool) -> FloatArray:
        """Distances of outline and surface at a motion: shift in x, y, z (mm), and turn (rad)."""
        parts = []
        if edge is not None:
            p = moved(edge, motion)
            along = shapely.line_locate_point(line, shapely.points(p))
            parts.append(p - shapely.get_coordinates(shapely.line_interpolate_point(line, along)))
        if with_body:
            p = moved(body, motion)
            parts.append(p - closest(p, result)[2])
        return np.concatenate([part.ravel() / np.sqrt(len(part)) for part in parts])

    turns = np.radians(360.0 / STARTS * (np.arange(STARTS) - STARTS // 2)) if turning else [0.0]
    rms, motion, several = _best(lambda motion: off(motion, edge is None), turns, edge is None)
    if edge is not None and body is not None:
        free = np.array([True, True, True, turning])
        rms, motion = _fitted(lambda motion: off(motion, True), motion, free)
    shift = moved(np.zeros((1, 2 if body is None else 3)), motion)[0]
    words = f"turned by {np.degrees(motion[3]):.3g}° about z and shifted by "
    words += f"({', '.join(f'{v:.3g}' for v in shift)}) mm, leaving {rms:.3g} mm (root mean square)"
    words += "; other turns fit as well, the smallest was taken" * several
    given = {name: getattr(sheet, name) for name in ("points", "flat", "contour")}
    placed = {name: moved(p, motion) for name, p in given.items() if p is not None}
    return replace(sheet, **placed), words


Off = Callable[[FloatArray], FloatArray]


def _best(off: Off, turns: FloatArray, lifted: bool) -> tuple[float, FloatArray, bool]:
    """Best fit from any of the turns: distance, motion, and whether other turns fit as well."""
    starts = [np.array([0.0, 0.0, 0.0, turn]) for turn in turns]
    starts.sort(key=lambda start: float((off(start) ** 2).sum()))
    free = np.array([True, True, lifted, len(turns) > 1])
    found = [_fitted(off, start, free) for start in starts[:TRIED]]
    least = min(rms for rms, _ in found)
    equal = [fit for fit in found if fit[0] <= AS_GOOD * least + 0.01]
    rms, motion = min(equal, key=lambda fit: (round(abs(fit[1][3]), 3), fit[0]))
    return rms, motion, len({round(abs(float(fit[1][3])), 2) for fit in equal}) > 1


def _fitted(off: Off, start: FloatArray, free: np.ndarray) -> tuple[float, FloatArray]:
    """Root mean square of the distances at their least near a motion, and the motion there."""
    from scipy.optimize import least_squares

    def motion_of(q: FloatArray) -> FloatArray:
        motion = start.copy()
        motion[free] = q
        return motion

    best = least_squares(lambda q: off(motion_of(q)), start[free], x_scale=SCALE[free], xtol=1e-9)
    motion = motion_of(best.x)
    motion[3] = (motion[3] + np.pi) % (2 * np.pi) - np.pi
    return float(np.sqrt(2 * best.cost)), motion
