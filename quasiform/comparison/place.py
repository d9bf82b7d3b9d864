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

from dataclasses import replace

import numpy as np
import shapely
from scipy.optimize import least_squares

from ..checks import InputError
from ..net.blank import rotation
from .mapping import closest
from .sheet import Sheet

FloatArray = np.ndarray
ON_PLANE = 1e-3  # of the spacing of the points
STARTS = 24
MOST = 300  # points of each sort that are fitted
SCALE = np.array([1.0, 1.0, 1.0, 0.01])  # mm, and the turn that moves an edge as far
AS_GOOD = 1.05  # fits within this factor (and 0.01 mm) are equal


def unfolded(sheet: Sheet, mirror: tuple[str, ...], signed: bool) -> Sheet:
    """Mirror a part of a sheet into the whole.

    Parameters
    ----------
    sheet : Sheet
        On one side of the planes.
    mirror : tuple of "x" and "y"
        Planes x = 0, y = 0.
    signed : bool
        Whether γ has its sign; at the planes it is then zero.

    Raises
    ------
    InputError
        If the sheet lies on both sides of a plane.
    """
    for plane in mirror:
        axis = "xy".index(plane)
        sheet = _mirrored(sheet, axis, signed) if sheet.contour is None else _doubled(sheet, axis)
    return sheet


def _mirrored(sheet: Sheet, axis: int, signed: bool) -> Sheet:
    where = sheet.places if sheet.flat is None else sheet.flat
    along = where[:, axis]
    on = np.abs(along) <= ON_PLANE * sheet.spacing
    _check_side(along, ON_PLANE * sheet.spacing, axis)
    off = np.flatnonzero(~on)
    number = np.arange(len(where))
    number[off] = len(where) + np.arange(len(off))

    def both(values: FloatArray | None) -> FloatArray | None:
        if values is None:
            return None
        flip = np.ones(values.shape[1])
        flip[axis] = -1.0
        return np.vstack([values, values[off] * flip])

    gamma = sheet.gamma
    if gamma is not None:
        own = np.where(on, 0.0, gamma) if signed and sheet.triangles is not None else gamma
        gamma = np.append(own, (-1.0 if signed else 1.0) * gamma[off])
    triangles = sheet.triangles
    if triangles is not None:
        triangles = np.vstack([triangles, number[triangles][:, ::-1]])
    by_triangle = sheet.by_triangle
    if by_triangle is not None:
        by_triangle = np.append(by_triangle, (-1.0 if signed else 1.0) * by_triangle)
    return Sheet(both(sheet.points), both(sheet.flat), triangles, gamma, by_triangle=by_triangle)


def _doubled(sheet: Sheet, axis: int) -> Sheet:
    """Mirror a contour; what of it runs along the plane is no outline and is left out."""
    points = shapely.get_coordinates(sheet.contour)
    size = np.ptp(points, axis=0).max()
    near, far = 1e-3 * size, 2 * np.abs(points).max()
    _check_side(points[:, axis], near, axis)
    side = 1.0 if points[:, axis].max() > near else -1.0
    low, high = np.full(2, -far), np.full(2, far)
    (low if side > 0 else high)[axis] = side * near
    line = shapely.line_merge(sheet.contour.intersection(shapely.box(*low, *high)))
    points = shapely.get_coordinates(line)
    ends = np.abs(points[[0, -1], axis]) <= 2 * near
    if line.geom_type != "LineString" or not ends.any():
        plane = "xy"[axis]
        raise InputError(f"mirror {plane}: the contour does not end at {plane} = 0")
    points = points if ends[1] else points[::-1]
    flip = np.ones(2)
    flip[axis] = -1.0
    line = np.vstack([points, (points * flip)[::-1], points[:1] if ends.all() else points[:0]])
    return replace(sheet, contour=shapely.LineString(line))


def _check_side(along: FloatArray, slack: float, axis: int) -> None:
    if along.min() < -slack and along.max() > slack:
        plane = "xy"[axis]
        raise InputError(
            f"mirror {plane}: the reference lies on both sides of {plane} = 0 "
            f"({along.min():.4g} to {along.max():.4g} mm)"
        )


def aligned(sheet: Sheet, result: Sheet, turning: bool) -> tuple[Sheet, str]:
    """Move a reference to where it fits the result best.

    Parameters
    ----------
    sheet, result : Sheet
    turning : bool
        Whether it may be turned about z, not only shifted.

    Returns
    -------
    sheet : Sheet
    words : str
        The motion, and what is left of the distances.

    Raises
    ------
    InputError
        If there is nothing to fit.
    """
    outlines = sheet.outline, result.outline
    rim = body = None
    if outlines[0] is not None and outlines[1] is not None:
        at = np.linspace(0.0, 1.0, MOST, endpoint=False)
        rim = shapely.get_coordinates(
            shapely.line_interpolate_point(outlines[0], at, normalized=True)
        )
    if sheet.points is not None and result.points is not None and result.triangles is not None:
        body = sheet.points[:: max(1, len(sheet.points) // MOST)]
    if rim is None and body is None:
        raise InputError("nothing to align by: the reference has no formed points and no outline")
    plan = rim if rim is not None else body[:, :2]
    goal = shapely.get_coordinates(outlines[1]) if rim is not None else result.points[:, :2]
    middle, aim = (0.5 * (p.min(0) + p.max(0)) for p in (plan, goal))
    rise = 0.0 if body is None else float(np.max(result.points[:, 2]) - np.max(body[:, 2]))

    def moved(points: FloatArray, motion: FloatArray) -> FloatArray:
        """Turn (n, 2) points about their middle and shift them."""
        return (points - middle) @ rotation(np.degrees(motion[3])).T + aim + motion[:2]

    def off(motion: FloatArray, sorts: str) -> FloatArray:
        parts = []
        if rim is not None and "rim" in sorts:
            p = moved(rim, motion)
            line = outlines[1]
            along = shapely.line_locate_point(line, shapely.points(p))
            on = shapely.get_coordinates(shapely.line_interpolate_point(line, along))
            parts.append((p - on).ravel() / np.sqrt(len(p)))
        if body is not None and "body" in sorts:
            p = np.column_stack([moved(body[:, :2], motion), body[:, 2] + rise + motion[2]])
            _, _, nearest = closest(p, result)
            parts.append((p - nearest).ravel() / np.sqrt(len(p)))
        return np.concatenate(parts)

    def fitted(start: FloatArray, sorts: str) -> tuple[float, FloatArray]:
        """Root mean square of the distances at their least near a motion, and the motion there."""
        free = np.array([True, True, "body" in sorts and body is not None, turning])

        def motion_of(q: FloatArray) -> FloatArray:
            motion = start.copy()
            motion[free] = q
            return motion

        best = least_squares(
            lambda q: off(motion_of(q), sorts), start[free], x_scale=SCALE[free], xtol=1e-9
        )
        motion = motion_of(best.x)
        motion[3] = (motion[3] + np.pi) % (2 * np.pi) - np.pi
        return float(np.sqrt(2 * best.cost)), motion

    sorts = "rim" if rim is not None else "body"
    angles = np.radians(360.0 / STARTS * (np.arange(STARTS) - STARTS // 2)) if turning else [0.0]
    starts = sorted(
        (np.array([0.0, 0.0, 0.0, angle]) for angle in angles),
        key=lambda start: float((off(start, sorts) ** 2).sum()),
    )
    found = [fitted(start, sorts) for start in starts[:8]]
    least = min(rms for rms, _ in found)
    equal = [fit for fit in found if fit[0] <= AS_GOOD * least + 0.01]
    rms, motion = min(equal, key=lambda fit: (round(abs(fit[1][3]), 3), fit[0]))
    if sorts == "rim" and body is not None:
        rms, motion = fitted(motion, "rim and body")
    turn, shift = float(np.degrees(motion[3])), moved(np.zeros((1, 2)), motion)[0]
    lift = rise + motion[2] if body is not None else 0.0

    def placed(points: FloatArray) -> FloatArray:
        xy = points[:, :2] @ rotation(turn).T + shift
        return xy if points.shape[1] == 2 else np.column_stack([xy, points[:, 2] + lift])

    contour = sheet.contour
    words = (
        f"turned by {turn:.3g}° about z and shifted by ({shift[0]:.3g}, {shift[1]:.3g}"
        + (f", {lift:.3g}) mm" if body is not None else ") mm")
        + f", leaving {rms:.3g} mm (root mean square)"
    )
    others = len({round(abs(float(fit[1][3])), 2) for fit in equal}) > 1
    if others:
        words += "; other turns fit as well, the smallest was taken"
    return replace(
        sheet,
        points=None if sheet.points is None else placed(sheet.points),
        flat=None if sheet.flat is None else placed(sheet.flat),
        contour=None if contour is None else shapely.transform(contour, placed),
    ), words
