"""Values on a flat mesh: interpolated to the places (m, 2) of another, mm; percentiles by area."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .blank import Blank

FloatArray = np.ndarray
NEAR = 2.0  # spacings from a slit: where values are taken from one side of it


def interpolated(places: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation of values (n, ...); beyond the places, the nearest value."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    found = LinearNDInterpolator(places, values)(at)
    outside = np.isnan(found).reshape(len(at), -1).any(1)
    found[outside] = NearestNDInterpolator(places, values)(at[outside])
    return found


def smoothly(places: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic interpolation (Clough and Tocher) of values (n, k); beyond, radial basis functions."""
    from scipy.interpolate import CloughTocher2DInterpolator, RBFInterpolator

    found = CloughTocher2DInterpolator(places, values)(at)
    outside = np.isnan(found).any(1)  # a finer outline bulges beyond the coarser polygon
    if outside.any():
        found[outside] = RBFInterpolator(places, values, neighbors=20, degree=1)(at[outside])
    return found


def beside_slits(source: Blank, values: FloatArray, target: Blank) -> tuple[np.ndarray, FloatArray]:
    """Nodes of a blank near slits, and values (n, ...) of another's nodes there, on the same side.

    They are linear on the triangle that holds the middle of the area around the node.
    """
    from scipy.spatial import cKDTree

    ends = source.nodes[source.doubled]
    if not len(ends):
        return np.empty(0, dtype=int), values[:0]
    aside = target.nodes
    for _ in range(2):  # farther than the slits of the two meshes are apart
        around = np.zeros_like(aside)
        share = target.areas[:, None] / 3.0 * aside[target.triangles].mean(1)
        np.add.at(around, target.triangles, share[:, None])
        aside = around / target.node_areas[:, None]
    near = np.flatnonzero(cKDTree(ends).query(target.nodes)[0] < NEAR * source.size)
    _, candidates = cKDTree(source.centroids).query(aside[near], min(12, len(source.triangles)))
    shares = [
        _shares(source.nodes[source.triangles[candidates]], points[near])
        for points in (aside, target.nodes)
    ]
    best = shares[0].min(-1).argmax(1)[:, None]
    corners = source.triangles[np.take_along_axis(candidates, best, axis=1)[:, 0]]
    weights = np.take_along_axis(shares[1], best[..., None], axis=1)[:, 0]
    return near, np.einsum("nk,nk...->n...", weights, values[corners])


def _shares(corners: FloatArray, points: FloatArray) -> FloatArray:
    """(n, m, 3) shares of the corners (n, m, 3, 2) of triangles at points (n, 2)."""
    a, b = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    c = points[:, None] - corners[:, :, 0]
    cross = [u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0] for u, v in ((a, b), (c, b), (a, c))]
    of_a, of_b = cross[1] / cross[0], cross[2] / cross[0]
    return np.stack([1.0 - of_a - of_b, of_a, of_b], axis=-1)


def percentile(values: FloatArray, areas: FloatArray, share: float) -> float:
    """Value below which `share` of the area lies.

    Examples
    --------
    >>> percentile(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 8.0]), 0.5)
    2.0
    """
    order = np.argsort(values)
    below = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])
