"""Map a field from one sheet to the points of another.

Where both sheets know their flat coordinates, a point is found by its material place, X: linear
interpolation on the Delaunay triangulation of the flat points, near a slit on the triangles of its
side. Else by the closest point of the formed surface (libigl), linear on its triangle. A point
farther from the other sheet than `within` is not compared.
"""

from __future__ import annotations

import numpy as np

from ..checks import InputError, optional
from ..net.blank import Blank
from ..net.transfer import beside_slits, interpolated
from ..result.sheet import FormedSheet
from ..tools.mending import normals_of

FloatArray = np.ndarray
ANGLE = "shear_angle"
SLIPS = {"warp": "slip_warp", "weft": "slip_weft"}
SIDES = ("result", "reference")
IGL = ("igl", "surface", "closest points on a formed surface need libigl")
WAYS = {"flat": "by flat coordinates", "formed": "by the closest point of the formed surface"}


def way(by: str, one: FormedSheet, other: FormedSheet) -> str:
    """How two sheets are matched, "flat" or "formed"; InputError if they cannot be so."""
    known = (("flat", one.flat, other.flat), ("formed", one.points, other.points))
    can = [name for name, a, b in known if a is not None and b is not None]
    if by == "auto" and not can:
        raise InputError(
            "one sheet has flat coordinates only, the other formed ones only: they cannot be "
            "matched"
        )
    if by not in ("auto", *can):
        raise InputError(f"not both sheets have {by} coordinates: they cannot be matched by them")
    return can[0] if by == "auto" else by


def spacing(sheet: FormedSheet) -> float:
    """Median distance of a point to its nearest neighbour on the flat sheet, mm."""
    from scipy.spatial import cKDTree

    if len(sheet.rest) < 2:
        raise InputError("a field needs more than one point")
    return float(np.median(cKDTree(sheet.rest).query(sheet.rest, k=2)[0][:, 1]))


def mapped(
    source: FormedSheet, target: FormedSheet, by: str, within: float | None = None
) -> FloatArray:
    """(n_target,) shear angle of one sheet at the points of another, degrees.

    nan at points farther than `within` (mm; the spacing of the source's points if not given).
    """
    import shapely
    from scipy.spatial import cKDTree

    apart, gamma = spacing(source), source.point_fields[ANGLE]
    reach = apart if within is None else within
    if by == "flat":
        known = np.isfinite(gamma)
        whole = source.triangles[known[source.triangles].all(1)]
        if len(whole):
            tree = shapely.STRtree(shapely.polygons(source.flat[whole]))
            only = {"all_matches": False, "return_distance": True}
            _, distance = tree.query_nearest(shapely.points(target.flat), **only)
        else:
            distance, _ = cKDTree(source.flat[known]).query(target.flat)
            reach = max(reach, apart)
        found = interpolated(source.flat[known], gamma[known], target.flat)
        if len(source.triangles) and len(target.triangles) and target.weights.all():
            flat = (Blank(s.flat, s.triangles, *np.eye(2)) for s in (source, target))
            near, values = beside_slits(next(flat), gamma, next(flat))
            found[near] = values
    elif not len(source.triangles):
        raise InputError("closest points need triangles")
    else:
        found, distance = on_surface(gamma, source, target.points)
    found[distance > reach] = np.nan
    return found


def on_surface(
    values: FloatArray, sheet: FormedSheet, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values (n_nodes, ...) of a sheet at its closest points to (n, 3) points; the distances."""
    distance, corners, nearest = closest(points, sheet)
    places = [np.ascontiguousarray(p) for p in sheet.points[corners].transpose(1, 0, 2)]
    shares = optional(*IGL).barycentric_coordinates(nearest, *places)
    return np.einsum("nk,nk...->n...", shares, values[corners]), distance


def closest(points: FloatArray, sheet: FormedSheet) -> tuple[FloatArray, np.ndarray, FloatArray]:
    """Closest points of a formed surface: distance (n,), corners (n, 3) and place (n, 3)."""
    squared, triangle, nearest = optional(*IGL).point_mesh_squared_distance(
        np.ascontiguousarray(points, dtype=float),
        np.ascontiguousarray(sheet.points, dtype=float),
        np.ascontiguousarray(sheet.triangles, dtype=np.int64),
    )
    return np.sqrt(squared), sheet.triangles[triangle], nearest


def beyond_edge(sheet: FormedSheet, points: FloatArray, aside: float) -> np.ndarray:
    """(n,) bool: points (n, 3) that lie more than `aside` mm outside the rim of a formed sheet."""
    import shapely

    _, corners, nearest = closest(points, sheet)
    flat, _ = on_surface(sheet.flat, sheet, points)
    rim = shapely.MultiLineString([sheet.flat[loop] for loop in sheet.loops])
    at_edge = shapely.distance(shapely.points(flat), rim) < 1e-6 * np.ptp(sheet.flat)
    n = normals_of(sheet.points[corners])
    off = np.linalg.norm(np.cross(points - nearest, n), axis=1) / np.linalg.norm(n, axis=1)
    return at_edge & (off > aside)
