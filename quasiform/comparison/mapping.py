"""Carry a field from one mesh to the points of another.

Where both sheets know their flat coordinates, a point is found by its material place, X: linear
interpolation on the Delaunay triangulation of the flat points. Else by the closest point of the
formed surface (libigl), linear on its triangle. A point farther from the other sheet than `within`
is not compared.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from ..checks import InputError
from ..tools.surface_file import optional
from .sheet import Sheet

FloatArray = np.ndarray
WAYS = {"flat": "by flat coordinates", "formed": "by the closest point of the formed surface"}


def way(by: str, one: Sheet, other: Sheet) -> str:
    """How two sheets are matched: "flat" or "formed".

    Raises
    ------
    InputError
        If they cannot be matched in the way asked for, or in any.
    """
    can = {
        "flat": one.flat is not None and other.flat is not None,
        "formed": one.points is not None and other.points is not None,
    }
    if by == "auto":
        by = next((name for name, possible in can.items() if possible), "")
        if not by:
            raise InputError(
                "one sheet has flat coordinates only, the other formed ones only: they cannot be "
                "matched"
            )
    elif not can[by]:
        raise InputError(f"not both sheets have {by} coordinates: they cannot be matched by them")
    return by


def carried(
    source: Sheet, target: Sheet, by: str, within: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Shear angle of one sheet at the points of another.

    Parameters
    ----------
    source, target : Sheet
    by : "flat" or "formed"
    within : float, optional
        mm; the spacing of the source's points if not given.

    Returns
    -------
    gamma : (n_target,) array
        Degrees; nan where there is no point of the source within reach.
    distance : (n_target,) array
        mm, from the source: of the nearest point (flat), of its surface (formed).
    """
    reach = source.spacing if within is None else within
    if by == "flat":
        known = np.isfinite(source.gamma)
        X, values = source.flat[known], source.gamma[known]
        distance, _ = cKDTree(X).query(target.flat)
        gamma = LinearNDInterpolator(X, values)(target.flat)
        outside = np.isnan(gamma)
        gamma[outside] = NearestNDInterpolator(X, values)(target.flat[outside])
        # inside a mesh, a point is no farther from a node than the nodes are from each other
        gamma[distance > max(reach, source.spacing)] = np.nan
        return gamma, distance
    if source.triangles is None:
        raise InputError("closest points need triangles")
    gamma, distance = on_surface(source.gamma, source, target.points)
    gamma[distance > reach] = np.nan
    return gamma, distance


def on_surface(
    values: FloatArray, sheet: Sheet, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values (n_nodes, ...) of a sheet at its closest points to (n, 3) points; the distances."""
    distance, corners, nearest = closest(points, sheet)
    places = [np.ascontiguousarray(p) for p in sheet.points[corners].transpose(1, 0, 2)]
    shares = _igl().barycentric_coordinates(nearest, *places)
    return np.einsum("nk,nk...->n...", shares, values[corners]), distance


def closest(points: FloatArray, sheet: Sheet) -> tuple[FloatArray, np.ndarray, FloatArray]:
    """Closest points of a formed surface: distance (n,), corners (n, 3) and place (n, 3)."""
    squared, triangle, nearest = _igl().point_mesh_squared_distance(
        np.ascontiguousarray(points, dtype=float),
        np.ascontiguousarray(sheet.points, dtype=float),
        np.ascontiguousarray(sheet.triangles, dtype=np.int64),
    )
    return np.sqrt(squared), sheet.triangles[triangle], nearest


def _igl() -> ModuleType:
    return optional("igl", "surface", "closest points on a formed surface need libigl")
