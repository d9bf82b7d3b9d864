"""Bending stiffness from Peirce's cantilever test: a strip bends from a clamp by its own weight.

An inextensible strip of length L (mm), weight w per area (N/mm²) and bending stiffness B per width
(N mm; B11 of strips along the warp, B22 along the weft) leaves the clamp horizontally. Its shape,
the heavy elastica (`theory.heavy_elastica`), depends on k = w L³/B alone. Every function finds k
from the measurement and returns B = w L³/k. Peirce (J. Text. Inst. 21 (1930) T377) approximates the
same curve, for the angle θ of the chord from the edge of the clamp to the tip, by::

    B = w c³,   c = L [cos(θ/2)/(8 tan θ)]^(1/3)

It is above the exact B by 1.3 % at 20°, 5.7 % at 41.5° and 14 % at 60°. The rule of testers with a
slope of 41.5°, c = L/2, is not that formula but nearly exact: k = 8 instead of 8.0042.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy as sp  # its parts load when they are used

from ..checks import InputError, check_number
from ..energy.weight import GRAVITY
from ..theory import heavy_elastica_shape

FloatArray = np.ndarray
Numbers = FloatArray | float
K_RANGE = (1e-3, 1e4)  # beyond: flat within 0.02 % of the length, or hanging at 89 degrees
STATIONS = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Stiffness:
    """Bending stiffness per width of one family of fibres."""

    value: float  # B, N mm
    standard_error: float  # of B, N mm; nan for a single number
    classical: float  # B by Peirce's formula, N mm
    misfit: float  # root mean square distance of the points from the curve, mm; nan for an angle


def from_overhang(
    length: Numbers,
    angle: Numbers = 41.5,
    areal_weight: float | None = None,
    classical: bool = False,
) -> Numbers:
    """Bending stiffness B, N mm, from the overhang at which the chord to the tip has an angle.

    Overhang (mm) and angle from the clamp's edge to the tip below the horizontal (degrees) are
    (...) arrays or numbers, the weight is in g/m². `classical`: by Peirce's formula.

    >>> round(from_overhang(165.0, 41.5, 600.0), 3)
    3.303
    """
    L, angle = _arrays("length", length=length, angle=angle)
    w = _weight(areal_weight)
    for wrong in angle[(angle <= 0) | (angle >= 90)][:1]:
        raise InputError(f"angle must lie between 0 and 90 degrees, got {wrong:g}")
    k = _peirce(np.radians(angle)) if classical else np.vectorize(_load_of_chord)(angle)
    B = w * L**3 / k
    return B if B.ndim else float(B)


def from_repeats(
    length: Numbers, angle: Numbers = 41.5, areal_weight: float | None = None
) -> Stiffness:
    """Mean and standard error of `from_overhang` over repeats; same arguments."""
    exact = np.atleast_1d(from_overhang(length, angle, areal_weight))
    classical = from_overhang(length, angle, areal_weight, classical=True)
    return Stiffness(*_mean(exact), float(np.mean(classical)), np.nan)


def from_tip(x: Numbers, drop: Numbers, length: Numbers, areal_weight: float) -> Stiffness:
    """Bending stiffness from the position of the tip: the k whose tip is nearest.

    Reach and drop of the tip from the edge of the clamp and the free length L (mm) are (n,) arrays
    of repeats or single numbers, the weight is in g/m².
    """
    arrays = _arrays("length", "x", "drop", x=x, drop=drop, length=length)
    (x, drop, L), w = map(np.atleast_1d, arrays), _weight(areal_weight)
    _check_reach("tip", x, drop, L)
    fits = [_fit(lambda k, tip=tip: _curve(k)(1.0) - tip) for tip in np.c_[x / L, drop / L]]
    k, misfit = np.array([(k, np.linalg.norm(distance)) for k, distance, _ in fits]).T
    classical, rms = w * L**3 / _peirce(np.arctan2(drop, x)), np.sqrt(np.mean((L * misfit) ** 2))
    return Stiffness(*_mean(w * L**3 / k), float(np.mean(classical)), float(rms))


def from_profile(x: FloatArray, drop: FloatArray, areal_weight: float, length: float) -> Stiffness:
    """Bending stiffness from a measured profile, by least squares of the normal distances.

    Points along the strip are (n,) arrays of their distances from the edge of the clamp (mm), n >=
    3, in any order; they need not reach the tip. The weight is in g/m², the free length L of the
    whole strip in mm. The standard error assumes independent noise of one size. A misfit above the
    precision of the measurement means that the strip was curled, the clamp was tilted or the
    stiffness is not one number. `classical` is that of the fitted curve.
    """
    x, drop = _arrays(x=x, drop=drop)
    w, L = _weight(areal_weight), float(check_number("length", length))
    if x.ndim != 1 or len(x) < 3:
        raise InputError(f"a profile needs at least 3 points, got {x.size if x.ndim else 1}")
    _check_reach("point farthest out", x, drop, L)
    points = np.stack([x, drop], axis=1) / L
    k, distances, slope = _fit(lambda k: _normal_distances(k, points))
    B, squares = w * L**3 / k, distances @ distances
    deviation = np.sqrt(squares / (len(x) - 1) / (slope @ slope))  # of log k, hence relative
    classical, rms = w * L**3 / _peirce(_chord(k)), L * np.sqrt(squares / len(x))
    return Stiffness(B, float(B * deviation), float(classical), float(rms))


def _peirce(angle: FloatArray) -> FloatArray:
    """The k of Peirce's formula for an angle of the chord, radians."""
    return 8 * np.tan(angle) / np.cos(angle / 2)


@lru_cache(maxsize=256)
def _load_of_chord(angle: float) -> float:
    """The k at which the chord to the tip has an angle, degrees."""
    if angle > 89.5:
        words = f"at an angle of {angle:g} degrees the strip hangs straight down"
        raise InputError(f"{words}: shorten the overhang")
    # 8 tan θ where the strip is nearly straight, 2 tan² θ where it nearly hangs
    theta, tangent = np.radians(angle), np.tan(np.radians(angle))
    range_ = np.log([4 * tangent, 16 * tangent + 4 * tangent**2])
    log_k = sp.optimize.brentq(lambda p: _chord(np.exp(p)) - theta, *range_, xtol=1e-12)
    return float(np.exp(log_k))


def _chord(k: float) -> float:
    """Angle of the chord to the tip, radians."""
    x, drop = _curve(k)(1.0)
    return np.arctan2(drop, x)


@lru_cache(maxsize=256)
def _curve(k: float) -> sp.interpolate.CubicSpline:
    """The elastica (x, drop) over L as a function of the station s."""
    return sp.interpolate.CubicSpline(STATIONS, np.transpose(heavy_elastica_shape(k, STATIONS)))


def _fit(distances: Callable[[float], FloatArray]) -> tuple[float, FloatArray, FloatArray]:
    """Least squares in log k: k, the distances over L there and their slopes by log k."""
    start = min(np.geomspace(*K_RANGE, 15).tolist(), key=lambda k: np.sum(distances(k) ** 2))
    bounds = tuple(np.log([0.5 * K_RANGE[0], 2 * K_RANGE[1]]))
    settings = {"diff_step": 1e-4, "xtol": 1e-12, "ftol": 1e-14, "gtol": 1e-14}
    fit = sp.optimize.least_squares(
        lambda p: distances(float(np.exp(p[0]))), [np.log(start)], "3-point", bounds, **settings
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
    squares = ((points[:, None] - curve(STATIONS)) ** 2).sum(-1)
    s = nearest = STATIONS[np.argmin(squares, axis=1)]
    low, high = np.maximum(nearest - STATIONS[1], 0), np.minimum(nearest + STATIONS[1], 1)
    for _ in range(4):  # Newton's method for (p - c)·c' = 0, within the two segments next to it
        offset, t = points - curve(s), tangent(s)
        slope = (t * t).sum(1) - (offset * turn(s)).sum(1)
        s = np.clip(s + (offset * t).sum(1) / np.maximum(slope, 0.1), low, high)
    offset, t = points - curve(s), tangent(s)
    return (offset[:, 1] * t[:, 0] - offset[:, 0] * t[:, 1]) / np.linalg.norm(t, axis=1)


def _mean(values: FloatArray) -> tuple[float, float]:
    """Mean and its standard error, nan for one value."""
    n = len(values)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(n)) if n > 1 else np.nan


def _weight(areal_weight: Any) -> float:
    """Weight per area, N/mm²."""
    return 1e-6 * GRAVITY * float(check_number("areal_weight", areal_weight))


def _arrays(*positive: str, **given: Any) -> list[FloatArray]:
    """Arrays of finite numbers of one shape; each is given in that shape or as one number."""
    arrays = {}
    for name, values in given.items():
        try:
            arrays[name] = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{name} must be numbers, got {values!r}") from None
        if not arrays[name].size or not np.isfinite(arrays[name]).all():
            raise InputError(f"{name} must be finite numbers, got {values!r}")
    if len({array.shape for array in arrays.values()} - {()}) > 1:
        counts = " and ".join(f"{array.size} of {name}" for name, array in arrays.items())
        raise InputError(f"the arrays do not match: {counts}")
    for name in positive:
        check_number(name, float(arrays[name].min()))
    return [np.array(array) for array in np.broadcast_arrays(*arrays.values())]


def _check_reach(what: str, x: FloatArray, drop: FloatArray, L: FloatArray | float) -> None:
    """Refuse points farther from the clamp than the strip is long, by more than 2 %."""
    reach = np.hypot(x, drop)
    worst = np.argmax(reach / L)
    if (reach / L)[worst] > 1.02:
        words = f"the {what} lies {reach[worst]:.4g} mm from the clamp"
        raise InputError(f"{words}, further than the strip is long")
