"""Bending stiffness from Peirce's cantilever test: a strip droops from a clamp by its own weight.

An inextensible strip of length L (mm), weight w per area (N/mm²) and bending stiffness B per width
(N mm; B11 of strips along the warp, B22 along the weft) leaves the clamp horizontally and takes the
shape of the heavy elastica (`theory.heavy_elastica`), which depends on

    k = w L³/B

alone. Every function finds k from what was measured, and returns B = w L³/k.

Peirce's own formula [1]_ for the bending length c, from the angle θ of the chord from the edge of
the clamp to the tip, is an approximation of the same curve::

    B = w c³,   c = L [cos(θ/2)/(8 tan θ)]^(1/3)

It lies above the exact B by 1.3 % at 20°, 5.7 % at 41.5° and 14 % at 60°. The rule of testers with
a slope of 41.5°, c = L/2, is not that formula but nearly exact: k = 8 instead of 8.0042.

References
----------
.. [1] F. T. Peirce, The "handle" of cloth as a measurable quantity, J. Text. Inst. 21 (1930) T377.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, least_squares

from ..checks import InputError, check_number
from ..energy.weight import GRAVITY
from ..theory import heavy_elastica, heavy_elastica_shape

FloatArray = np.ndarray

K_RANGE = (1e-3, 1e4)  # beyond: flat within 0.02 % of the length, or hanging at 89 degrees
STATIONS = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Stiffness:
    """Bending stiffness per width of one family of fibres.

    Parameters
    ----------
    value, standard_error : float
        B and its standard error, N mm; the error is nan where there is only one number.
    classical : float
        B by Peirce's formula, N mm.
    misfit : float
        Root mean square distance of the measured points from the exact curve, mm; nan where an
        angle alone was measured.
    """

    value: float
    standard_error: float
    classical: float
    misfit: float


def from_overhang(
    length: FloatArray | float,
    angle: FloatArray | float = 41.5,
    areal_weight: float | None = None,
    classical: bool = False,
) -> FloatArray | float:
    """Bending stiffness from the overhang at which the chord to the tip hangs at an angle.

    Parameters
    ----------
    length : float or (...) array
        Overhang L, mm; of one strip or of repeats.
    angle : float or (...) array
        Angle of the chord from the edge of the clamp to the tip below the horizontal, degrees.
    areal_weight : float
        g/m²; there is no default.
    classical : bool
        By Peirce's formula instead of the exact curve.

    Returns
    -------
    float or (...) array
        B, N mm.

    Raises
    ------
    InputError
        For lengths or a weight that are not positive and angles outside (0, 90).

    Examples
    --------
    >>> round(from_overhang(165.0, 41.5, 600.0), 3)
    3.303
    """
    L, angle = _together(length=length, angle=angle)
    w = _weight(areal_weight)
    _check_positive("length", L)
    outside = angle[~((angle > 0) & (angle < 90))]
    if outside.size:
        raise InputError(f"angle must lie between 0 and 90 degrees, got {outside[0]:g}")
    if classical:
        k = 8 * np.tan(np.radians(angle)) / np.cos(np.radians(angle) / 2)
    else:
        k = np.reshape([_load_of_chord(float(each)) for each in angle.ravel()], angle.shape)
    B = w * L**3 / k
    return B if B.ndim else float(B)


def from_repeats(
    length: FloatArray | float,
    angle: FloatArray | float = 41.5,
    areal_weight: float | None = None,
) -> Stiffness:
    """Mean and standard error of `from_overhang` over repeats; same arguments."""
    exact = np.atleast_1d(from_overhang(length, angle, areal_weight))
    classical = from_overhang(length, angle, areal_weight, classical=True)
    return Stiffness(*_mean(exact), float(np.mean(classical)), np.nan)


def from_tip(
    x: FloatArray | float,
    drop: FloatArray | float,
    length: FloatArray | float,
    areal_weight: float,
) -> Stiffness:
    """Bending stiffness from the position of the tip: the k whose tip is nearest.

    Parameters
    ----------
    x, drop : float or (n,) array
        Reach and drop of the tip from the edge of the clamp, mm; of one strip or of repeats.
    length : float or (n,) array
        Free length L, mm.
    areal_weight : float
        g/m².

    Returns
    -------
    Stiffness
        Mean over the repeats and its standard error; the misfit is the distance of the tips.

    Raises
    ------
    InputError
        For numbers out of range, arrays that do not match, and a tip beyond the strip's length.
    """
    x, drop, L = (np.atleast_1d(each) for each in _together(x=x, drop=drop, length=length))
    w = _weight(areal_weight)
    _check_positive("length", L)
    _check_positive("x", x)
    _check_positive("drop", drop)
    _check_reach("tip", x, drop, L)
    fits = [_fit(lambda k, tip=tip: _tip(k) - tip) for tip in np.c_[x / L, drop / L]]
    k = np.array([fit[0] for fit in fits])
    misfit = L * [np.linalg.norm(fit[1]) for fit in fits]
    return Stiffness(
        *_mean(w * L**3 / k),
        float(np.mean(_classical(x, drop, L, w))),
        float(np.sqrt(np.mean(misfit**2))),
    )


def from_profile(x: FloatArray, drop: FloatArray, areal_weight: float, length: float) -> Stiffness:
    """Bending stiffness from a measured profile, by least squares of the normal distances.

    The points need not reach the tip. The standard error takes the distances for independent
    noise of one size; a misfit above the precision of the measurement says that the strip was
    curled, the clamp tilted or the stiffness not one number.

    Parameters
    ----------
    x, drop : (n,) arrays
        Points along the strip from the edge of the clamp, mm; n >= 3, in any order.
    areal_weight : float
        g/m².
    length : float
        Free length L of the whole strip, mm.

    Returns
    -------
    Stiffness
        `classical` is Peirce's formula with the tip of the fitted curve.

    Raises
    ------
    InputError
        For numbers out of range, arrays that do not match, points beyond the strip's length, and
        points from which no stiffness follows.
    """
    x, drop = _together(x=x, drop=drop)
    w = _weight(areal_weight)
    L = float(check_number("length", length))
    if x.ndim != 1 or len(x) < 3:
        raise InputError(f"a profile needs at least 3 points, got {x.size if x.ndim else 1}")
    _check_reach("point farthest out", x, drop, L)
    points = np.stack([x, drop], axis=1) / L
    k, distances, slope = _fit(lambda k: _normal_distances(k, points))
    B = w * L**3 / k
    squares = distances @ distances
    deviation = np.sqrt(squares / (len(x) - 1) / (slope @ slope))  # of log k, hence relative
    classical = float(_classical(*_tip(k), L, w))
    return Stiffness(B, float(B * deviation), classical, float(L * np.sqrt(squares / len(x))))


@lru_cache(maxsize=256)
def _load_of_chord(angle: float) -> float:
    """The k at which the chord to the tip hangs at `angle` (degrees)."""
    if angle > 89.5:
        raise InputError(
            f"at an angle of {angle:g} degrees the strip hangs straight down: shorten the overhang"
        )

    def excess(log_k: float) -> float:
        x, drop = _tip(float(np.exp(log_k)))
        return np.arctan2(drop, x) - np.radians(angle)

    # 8 tan θ where the strip is nearly straight, 2 tan² θ where it nearly hangs
    tangent = np.tan(np.radians(angle))
    low, high = np.log(4 * tangent), np.log(16 * tangent + 4 * tangent**2)
    return float(np.exp(brentq(excess, low, high, xtol=1e-12)))


@lru_cache(maxsize=256)
def _tip(k: float) -> FloatArray:
    """Tip (x, drop) of the elastica over L."""
    return np.array(heavy_elastica(k)[:2])


def _fit(distances: Callable[[float], FloatArray]) -> tuple[float, FloatArray, FloatArray]:
    """Least squares in log k: k, the distances over L there and their slopes by log k."""
    tried = np.geomspace(*K_RANGE, 15).tolist()
    start = min(tried, key=lambda k: np.sum(np.square(distances(k))))
    fit = least_squares(
        lambda log_k: distances(float(np.exp(log_k[0]))),
        [np.log(start)],
        bounds=tuple(np.log([0.5 * K_RANGE[0], 2 * K_RANGE[1]])),
        jac="3-point",
        diff_step=1e-4,
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-14,
    )
    k = float(np.exp(fit.x[0]))
    if not K_RANGE[0] <= k <= K_RANGE[1]:
        how, remedy = ("does not droop", "longer") if k < 1 else ("hangs straight down", "shorter")
        raise InputError(
            f"no bending stiffness follows, the strip {how}: measure a {remedy} overhang"
        )
    return k, fit.fun, fit.jac[:, 0]


def _normal_distances(k: float, points: FloatArray) -> FloatArray:
    """(n,) signed distances of (n, 2) points from the elastica, all over L.

    Beyond an end of the curve the distance is that from its tangent.
    """
    curve = _curve(k)
    tangent, turn = curve.derivative(), curve.derivative(2)
    offset = points[:, None] - curve(STATIONS)
    nearest = STATIONS[np.argmin((offset**2).sum(-1), axis=1)]
    s, step = nearest, STATIONS[1]
    for _ in range(4):  # Newton's method for (p - c)·c' = 0, within the two segments next to it
        offset, t = points - curve(s), tangent(s)
        slope = (t * t).sum(1) - (offset * turn(s)).sum(1)
        s = s + (offset * t).sum(1) / np.maximum(slope, 0.1)
        s = np.clip(s, np.maximum(nearest - step, 0), np.minimum(nearest + step, 1))
    offset, t = points - curve(s), tangent(s)
    return (offset[:, 1] * t[:, 0] - offset[:, 0] * t[:, 1]) / np.linalg.norm(t, axis=1)


@lru_cache(maxsize=64)
def _curve(k: float) -> CubicSpline:
    """The elastica (x, drop) over L as a function of the station s."""
    return CubicSpline(STATIONS, np.stack(heavy_elastica_shape(k, STATIONS), axis=1))


def _classical(x: FloatArray, drop: FloatArray, L: FloatArray, w: float) -> FloatArray:
    """B by Peirce's formula with the chord to the tip."""
    return w * L**3 * np.cos(np.arctan2(drop, x) / 2) * x / (8 * drop)


def _mean(values: FloatArray) -> tuple[float, float]:
    """Mean and its standard error, nan for one value."""
    n = len(values)
    error = values.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    return float(values.mean()), float(error)


def _weight(areal_weight: Any) -> float:
    """Weight per area, N/mm²."""
    return 1e-6 * GRAVITY * float(check_number("areal_weight", areal_weight))


def _together(**given: Any) -> list[FloatArray]:
    """Arrays of finite numbers, brought to one shape: each of that shape or one number."""
    arrays = {}
    for name, values in given.items():
        try:
            arrays[name] = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{name} must be numbers, got {values!r}") from None
        if not arrays[name].size or not np.isfinite(arrays[name]).all():
            raise InputError(f"{name} must be finite numbers, got {values!r}")
    shapes = {array.shape for array in arrays.values()} - {()}
    if len(shapes) > 1:
        counts = " and ".join(f"{array.size} of {name}" for name, array in arrays.items())
        raise InputError(f"the arrays do not match: {counts}")
    return [np.array(array) for array in np.broadcast_arrays(*arrays.values())]


def _check_positive(name: str, values: FloatArray) -> None:
    for value in values[values <= 0][:1]:
        check_number(name, float(value))


def _check_reach(what: str, x: FloatArray, drop: FloatArray, L: FloatArray | float) -> None:
    """Refuse points farther from the clamp than the strip is long, by more than 2 %."""
    reach = np.hypot(x, drop)
    worst = np.argmax(reach / L)
    if reach[worst] > 1.02 * np.broadcast_to(L, reach.shape)[worst]:
        raise InputError(
            f"the {what} lies {reach[worst]:.4g} mm from the clamp, further than the strip is long"
        )
