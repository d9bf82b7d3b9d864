"""Fit of the six parameters of the three-stage law (Schäfer et al., Eq. 9) to forces.

The forces of all tests are compared with the power balance, or with finite elements (`inverse`),
under the law, every row weighted with its standard deviation. scipy's bounded least squares gives
the intervals too; Nelder-Mead is the algorithm of the paper. The third stage is fitted only where
the tests show one; otherwise its onset and stiffness are kept as given (`keep`) or left out. A
parameter whose interval reaches zero is reported as not identified.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy as sp  # its parts load when they are used

from ..checks import InputError, check_keys, check_number
from ..fabric import Slip, ThreeStageLaw
from .energy_method import Forces, StressCurve, relative_misfit

FloatArray = np.ndarray
NAMES = ("C_ini", "S_ini", "C_mid", "dS_mid", "C_lo", "I_lo")
LOCKING = ("C_lo", "I_lo")
LONGEST = 0.2  # strain I6 at the end of the first stage
UNSEEN = 1e-8  # of the largest singular value; about the round-off of the differences
ROUND_OFF = 1e-5  # share of an unseen direction in a parameter that is no part of it
ALGORITHMS = ("least-squares", "nelder-mead")


@dataclass(frozen=True)
class Parameter:
    """A parameter with its 95 % confidence interval; `high` is infinite where nothing bounds it."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    state: str  # fitted, kept, not identified, or not tested: a third stage beyond the tests


@dataclass(frozen=True)
class Fit:
    """A law with its parameters."""

    law: ThreeStageLaw
    parameters: tuple[Parameter, ...]
    misfit: float  # root mean square of the relative deviation of the forces
    slip: Slip | None = None
    notices: tuple[str, ...] = ()

    @property
    def stages(self) -> tuple[float, float]:
        """Shear angles at which the first stage ends and the third begins, degrees."""
        I6 = np.minimum([self.law.S_ini / self.law.C_ini, self.law.I_lo], 1.0)
        return tuple(np.degrees(np.arcsin(I6)).tolist())


class Unknowns:
    """The fitted parameters (`free`) as numbers of order one, with bounds that keep the law valid.

    The first stage is described by the strain I^t = S_ini/C_ini at its end. I_lo is always larger.
    """

    def __init__(self, start: ThreeStageLaw, free: Sequence[str]) -> None:
        self.free = [name for name in NAMES if name in free]
        self.values = {name: getattr(start, name) for name in NAMES}
        strain, least = start.S_ini / start.C_ini, 1e-3 * start.C_ini
        if "S_ini" in self.free:
            self.values["S_ini"] = strain
        limits = {
            "C_ini": (1e-3 if "S_ini" in self.free else strain / LONGEST, 1e3),
            "S_ini": (1e-4 / strain, LONGEST / strain),
            "C_mid": (0.0, 1e4),
            "dS_mid": (1e-3, 1e3),
            "C_lo": (0.0, 1e6),
            "I_lo": ((LONGEST + 0.01) / start.I_lo, 1.0 / start.I_lo),
        }
        values = np.array([self.values[name] for name in self.free])
        slope = np.array([name in ("C_mid", "C_lo") for name in self.free])  # may be zero
        self.scale = np.where(slope, np.maximum(values, least), values)
        self.bounds = np.array([limits[name] for name in self.free]).T
        self.start = np.clip(values / self.scale, *(self.bounds + np.array([[1e-9], [-1e-9]])))

    def law(self, p: FloatArray) -> ThreeStageLaw:
        """The law of (k,) numbers."""
        values = self.values | dict(zip(self.free, (p * self.scale).tolist(), strict=True))
        if "S_ini" in self.free:
            values["S_ini"] *= values["C_ini"]
        return ThreeStageLaw(**values)

    def slopes(self, p: FloatArray, of: Callable[[ThreeStageLaw], FloatArray]) -> FloatArray:
        """Derivatives (..., k) of a function (...) of the law, by central differences."""
        columns = []
        for step in np.diag(1e-6 * np.maximum(np.abs(p), 1e-3)):
            above, below = p + step, np.maximum(p - step, self.bounds[0])
            rise = of(self.law(above)) - of(self.law(below))
            columns.append(rise / (above - below)[step > 0])
        return np.stack(columns, axis=-1)

    def residuals(self, tests: Sequence[Forces], p: FloatArray) -> Sequence[FloatArray]:
        """Residuals (n,) of all tests over their standard deviations, and derivatives (n, k)."""
        parts = zip(*(test.residual(self, p) for test in tests), strict=True)
        return [np.concatenate(part) for part in parts]


Trial = tuple[Unknowns, Any]  # with the OptimizeResult of the fit


def fit(
    tests: Sequence[Forces],
    curve: StressCurve,
    keep: Mapping[str, float] | None = None,
    algorithm: str = "least-squares",
) -> Fit:
    """Fit the three-stage law by the power balance, from the curve of the energy method.

    Parameters in `keep`, such as onset and stiffness of locking, are not fitted.
    """
    keep = check_kept(keep)
    if algorithm not in ALGORITHMS:
        raise InputError(f"unknown algorithm '{algorithm}': expected {' or '.join(ALGORITHMS)}")
    if len(keep) == len(NAMES):
        law = ThreeStageLaw(**keep)
        parameters = tuple(_parameter(name, keep[name], 0.0, "kept") for name in NAMES)
        return Fit(law, parameters, relative_misfit(tests, law))
    top, trials = float(np.sin(np.radians(curve.high))), []
    for law in _starts(curve, keep):
        tested = NAMES if law.I_lo < top else NAMES[:4]
        free = [name for name in tested if name not in keep]
        trials.append(search(tests, Unknowns(law, free)))
    unknowns, found = choose(trials)
    if algorithm == "nelder-mead":
        found = _nelder_mead(tests, unknowns)
    return report(tests, unknowns, found, keep)


def check_kept(keep: Mapping[str, float] | None) -> dict[str, float]:
    """Return the kept parameters; InputError for an unknown name or a value out of range."""
    keep = dict(keep or {})
    check_keys(keep, NAMES, "keep")
    for name, value in keep.items():
        check_number(f"keep {name}", value, zero_allowed=name in ("C_mid", "C_lo"))
    return keep


def search(tests: Sequence[Forces], unknowns: Unknowns, tolerance: float = 1e-10) -> Trial:
    """Bounded least squares of the residuals of all tests, or models of tests."""

    @lru_cache(maxsize=1)
    def both(point: bytes) -> Sequence[FloatArray]:
        return unknowns.residuals(tests, np.frombuffer(point))

    if not np.isfinite(both(unknowns.start.tobytes())[0]).all():
        raise InputError("a test finds no equilibrium under the law of the power balance")
    return unknowns, sp.optimize.least_squares(
        lambda p: both(p.tobytes())[0],
        unknowns.start,
        lambda p: both(p.tobytes())[1],
        unknowns.bounds,
        x_scale="jac",
        max_nfev=200,
        **dict.fromkeys(("xtol", "ftol", "gtol"), tolerance),
    )


def choose(trials: Sequence[Trial]) -> Trial:
    """Best of several fits, by Bayes' criterion: each parameter of a third stage has a cost.

    Of equal ones, that which started nearest: Nelder-Mead starts there again.
    """
    n = len(trials[0][1].fun)
    noise = max(min(2 * found.cost for _, found in trials) / n, 1e-300)

    def score(trial: Trial) -> tuple[float, float]:
        unknowns, found = trial
        price = len(set(unknowns.free) & set(LOCKING)) * np.log(n)
        distance = np.linalg.norm(found.x - unknowns.start)
        return round(2 * found.cost / noise + price, 6), float(distance)

    return min(trials, key=score)


def _starts(curve: StressCurve, keep: Mapping[str, float]) -> list[ThreeStageLaw]:
    """Laws to start from: plateau and first stage read from the curve, onsets along its range.

    The last one has no third stage within the range.
    """
    low, top = np.sin(np.radians([curve.low, curve.high]))
    x = np.linspace(low, top, 200)
    S, K = curve.stress(x), np.gradient(curve.stress(x), x)
    flat = int(np.argmin(K[:-5]))
    C_ini = max(1.3 * S[0] / x[0], K[0], 1e-9)
    C_mid = max(float(K[flat]), 1e-3 * C_ini)
    dS_mid = max(float(S[flat] - K[flat] * x[flat]), 0.1 * float(S[flat]))
    first = {"C_ini": C_ini, "S_ini": 0.1 * dS_mid, "C_mid": C_mid, "dS_mid": dS_mid}
    onsets, found = [*np.arange(0.25, top, 0.05), max(top, LONGEST + 0.01)], []
    for I_lo in [keep["I_lo"]] if "I_lo" in keep else onsets:
        z = np.maximum(x - I_lo, 0.0)
        excess = S - S[flat] - C_mid * (x - x[flat])
        C_lo = max(float(excess @ z**2 / max((z**4).sum(), 1e-300)), 0.1 * C_ini)
        locking = {"C_lo": C_lo if I_lo < top else 0.0, "I_lo": float(I_lo)}
        values = first | locking | dict(keep)
        if "S_ini" not in keep:
            values["S_ini"] = min(values["S_ini"], LONGEST * values["C_ini"])
        elif "C_ini" not in keep:
            values["C_ini"] = max(values["C_ini"], 1.1 * values["S_ini"] / LONGEST)
        found.append(ThreeStageLaw(**values))
    return found


def report(
    tests: Sequence[Forces], unknowns: Unknowns, found: Any, keep: Mapping[str, float]
) -> Fit:
    """Intervals from the curvature at the minimum, wider where the residuals are correlated."""
    p, J, r = found.x, found.jac, found.fun
    law = unknowns.law(p)
    size = np.linalg.norm(J, axis=0)
    size = np.maximum(size, 1e-12 * size.max())
    _, s, Vt = np.linalg.svd(J / size, full_matrices=False)
    native = unknowns.slopes(p, lambda law: np.array([getattr(law, name) for name in NAMES]))
    share = native / size @ Vt.T  # of each direction in each parameter
    unseen = s < UNSEEN * s[0]  # such a direction does not change the forces
    part = np.abs(share[:, unseen]) > ROUND_OFF * np.linalg.norm(share, axis=1, keepdims=True)
    deviation = np.sqrt(variance(J, r)) * np.linalg.norm(share[:, ~unseen] / s[~unseen], axis=1)
    deviation[part.any(axis=1)] = np.inf
    reach = sp.special.stdtrit(max(len(r) - len(p), 1), 0.975) * deviation
    parameters = []
    for name, half in zip(NAMES, reach.tolist(), strict=True):
        value = float(getattr(law, name))
        if name in keep:
            state, half = "kept", 0.0
        elif name in LOCKING and name not in unknowns.free:
            state, half = "not tested", np.nan
        else:
            state = "fitted" if half < value else "not identified"
        parameters.append(_parameter(name, value, half, state))
    return Fit(law, tuple(parameters), relative_misfit(tests, law))


def variance(J: FloatArray, r: FloatArray) -> float:
    """Variance of residuals (n,) with derivatives (n, k); larger where they are correlated."""
    lag = float(np.clip((r[1:] @ r[:-1]) / max(r @ r, 1e-300), 0.0, 0.95))
    return float(r @ r) / max(len(r) - J.shape[1], 1) * (1 + lag) / (1 - lag)


def _parameter(name: str, value: float, half: float, state: str) -> Parameter:
    unit = "1" if name == "I_lo" else "MPa"
    return Parameter(name, value, max(value - half, 0.0), value + half, unit, state)


def _nelder_mead(tests: Sequence[Forces], unknowns: Unknowns) -> Any:
    """Simplex search as in the paper, repeated from its result until that stays."""

    def cost(p: FloatArray) -> float:
        law = unknowns.law(p)
        off = [(test.predicted(law) - test.force) / test.sigma for test in tests]
        return float((np.concatenate(off) ** 2).sum())

    p, best, within = unknowns.start, np.inf, list(zip(*unknowns.bounds, strict=True))
    settings = {"maxiter": 4000, "maxfev": 4000, "xatol": 1e-10, "fatol": 1e-12, "adaptive": True}
    for _ in range(20):
        found = sp.optimize.minimize(cost, p, method="Nelder-Mead", bounds=within, options=settings)
        p = found.x
        if found.fun > (1 - 1e-6) * best:
            break
        best = found.fun
    found.fun, found.jac = unknowns.residuals(tests, p)
    return found
