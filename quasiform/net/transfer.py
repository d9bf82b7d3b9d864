"""Values on one flat mesh, interpolated to another."""

from __future__ import annotations

import numpy as np

FloatArray = np.ndarray


def interpolated(places: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation between scattered places; beyond them, the nearest value.

    Parameters
    ----------
    places : (n, 2) array, mm
    values : (n, ...) array
    at : (m, 2) array, mm

    Returns
    -------
    (m, ...) array
    """
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    found = LinearNDInterpolator(places, values)(at)
    outside = np.isnan(found).reshape(len(at), -1).any(1)
    found[outside] = NearestNDInterpolator(places, values)(at[outside])
    return found


def smoothly(places: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic interpolation (Clough and Tocher); beyond the places, by radial basis functions.

    Parameters and result as in `interpolated`, with values (n, k).
    """
    from scipy.interpolate import CloughTocher2DInterpolator, RBFInterpolator

    found = CloughTocher2DInterpolator(places, values)(at)
    outside = np.isnan(found).any(1)  # a finer outline bulges beyond the coarser polygon
    if outside.any():
        found[outside] = RBFInterpolator(places, values, neighbors=20, degree=1)(at[outside])
    return found
