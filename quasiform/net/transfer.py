"""Values on a flat mesh: interpolated to the places (m, 2) of another, mm; percentiles by area."""

from __future__ import annotations

import numpy as np

FloatArray = np.ndarray


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
