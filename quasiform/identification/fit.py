"""Fit of the six parameters of the three-stage law (Schäfer et al., Eq. 9) to forces.

The forces of all tests are compared with the power balance under the law, each row weighed with its
standard deviation, so that nothing is smoothed before it is fitted. Two ways: bounded least squares
(scipy's `least_squares`), which gives intervals, and Nelder-Mead as in the paper.

Stage three is fitted only where the tests show one: else its onset and stiffness are kept as asked
(`keep`), or left out. A parameter whose interval reaches zero, or further than it is itself, is
called not identified.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares, minimize
from scipy.special import stdtrit

from ..checks import InputError, check_keys, check_number
from ..fabric import ThreeStageLaw
from .energy_method import Forces, StressCurve

FloatArray = np.ndarray
NAMES = ("C_ini", "S_ini", "C_mid", "dS_mid", "C_lo", "I_lo")
UNITS = dict.fromkeys(NAMES, "MPa") | {"I_lo": "1"}
LOCKING = ("C_lo", "I_lo")
LONGEST = 0.2  # strain I6 at the end of the first stage
ALGORITHMS = ("least-squares", "nelder-mead")


@dataclass(frozen=True)
class Parameter:
    """One parameter of the law with its interval of 95 % confidence.

    `state` is "fitted", "kept", "not identified" or "not tested" (stage three, where the tests end
    before it).
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    state: str


@dataclass(frozen=True)
class Fit:
    """A law with its parameters.

    Parameters
    ----------
    law : ThreeStageLaw
    parameters : tuple of Parameter
    stages : tuple of two floats
        Shear angles at which the first stage ends and the third begins, degrees.
    misfit : float
        Root mean square of the relative deviation of the forces.
    """

    law: ThreeStageLaw
    parameters: tuple[Parameter, ...]
    stages: tuple[float, float]
    misfit: float


class Unknowns:
    """The fitted parameters as numbers of order one, with bounds that keep the law a law.

    The first stage is described by the strain I^t = S_ini/C_ini at its end, below which I_lo never
    comes.

    Parameters
    ----------
    start : ThreeStageLaw
    free : sequence of str
        Names of the parameters that are fitted; the others stay.
    """

    def __init__(self, start: ThreeStageLaw, free: Sequence[str]) -> None:
        self.free = [name for name in NAMES if name in free]
        self.values = {name: getattr(start, name) for name in NAMES}
        strain = start.S_ini / start.C_ini
        if "S_ini" in self.free:
            self.values["S_ini"] = strain
        least = {"C_mid": 1e-3 * start.C_ini, "C_lo": 1e-3 * start.C_ini}
        self.scale = np.array([max(self.values[name], least.get(name, 0.0)) for name in self.free])
        stiffest = 1e-3 if "S_ini" in self.free else strain / LONGEST
        limits = {
            "C_ini": (stiffest, 1e3),
            "S_ini": (1e-4 / strain, LONGEST / strain),
            "C_mid": (0.0, 1e4),
            "dS_mid": (1e-3, 1e3),
            "C_lo": (0.0, 1e6),
            "I_lo": ((LONGEST + 0.01) / start.I_lo, 1.0 / start.I_lo),
        }
        self.bounds = np.array([limits[name] for name in self.free]).T
        inside = self.bounds + 1e-9 * np.array([[1.0], [-1.0]])
        values = np.array([self.values[name] for name in self.free])
        self.start = np.clip(values / self.scale, *inside)

    def law(self, p: FloatArray) -> ThreeStageLaw:
        """The law of (k,) numbers."""
        values = self.values | dict(zip(self.free, (p * self.scale).tolist(), strict=True))
        if "S_ini" in self.free:
            values["S_ini"] *= values["C_ini"]
        return ThreeStageLaw(**values)

    def slopes(self, p: FloatArray, of: Callable[[ThreeStageLaw], FloatArray]) -> FloatArray:
        """Derivatives (..., k) of something (...) that a law gives, by central differences."""
        columns = []
        for i in range(len(p)):
            h = 1e-6 * max(abs(p[i]), 1e-3)
            above, below = p.copy(), p.copy()
            above[i], below[i] = p[i] + h, max(p[i] - h, self.bounds[0, i])
            rise = of(self.law(above)) - of(self.law(below))
            columns.append(rise / (above[i] - below[i]))
        return np.stack(columns, axis=-1)


Trial = tuple[list[str], Unknowns, OptimizeResult]  # the late parameters, the unknowns, the fit


def fit(
    tests: Sequence[Forces],
    curve: StressCurve,
    keep: Mapping[str, float] | None = None,
    algorithm: str = "least-squares",
) -> Fit:
    """Fit the three-stage law.

    Parameters
    ----------
    tests : sequence of Forces
    curve : StressCurve
        Result of the energy method, where the fit starts.
    keep : mapping, optional
        Parameters that are kept at these values, such as the onset and stiffness of locking.
    algorithm : "least-squares" or "nelder-mead"

    Raises
    ------
    InputError
        For unknown names or values out of range.
    """
    keep = check_kept(keep)
    if algorithm not in ALGORITHMS:
        raise InputError(f"unknown algorithm '{algorithm}': expected {' or '.join(ALGORITHMS)}")
    top = float(np.sin(np.radians(curve.high)))

    def residual(law: ThreeStageLaw) -> FloatArray:
        return np.concatenate([(test.predicted(law) - test.force) / test.sigma for test in tests])

    if len(keep) == len(NAMES):
        return whole(ThreeStageLaw(**keep), tests)
    early = [name for name in NAMES[:4] if name not in keep]
    late = [name for name in LOCKING if name not in keep]
    trials = []
    for law in stages(curve, keep):
        with_late = late if law.I_lo < top else []
        unknowns = Unknowns(law, [*early, *with_late])
        trials.append((with_late, unknowns, search(unknowns, *_by_balance(residual, unknowns))))
    _, unknowns, found = choose(trials)
    if algorithm == "nelder-mead":
        found = _nelder_mead(unknowns, residual)
    law = unknowns.law(found.x)
    relative = misfit_of([test.predicted(law) for test in tests], tests)
    return report(law, unknowns, found, keep, top, relative)


def whole(law: ThreeStageLaw, tests: Sequence[Forces]) -> Fit:
    """Return a law that is kept as a whole with its misfit."""
    kept = [
        Parameter(n, getattr(law, n), getattr(law, n), getattr(law, n), UNITS[n], "kept")
        for n in NAMES
    ]
    relative = misfit_of([test.predicted(law) for test in tests], tests)
    return Fit(law, tuple(kept), _ends(law), relative)


def _ends(law: ThreeStageLaw) -> tuple[float, float]:
    """Shear angles where the first stage ends and the third begins, degrees."""
    first, third = np.degrees(np.arcsin(np.minimum([law.S_ini / law.C_ini, law.I_lo], 1.0)))
    return float(first), float(third)


def check_kept(keep: Mapping[str, float] | None) -> dict[str, float]:
    """Return the kept parameters; InputError for an unknown name or a value out of range."""
    keep = dict(keep or {})
    check_keys(keep, NAMES, "keep")
    for name, value in keep.items():
        check_number(f"keep {name}", value, zero_allowed=name in ("C_mid", "C_lo"))
    return keep


def _by_balance(residual: Callable, unknowns: Unknowns) -> tuple[Callable, Callable]:
    """Residuals and their derivatives as functions of the unknowns."""
    return lambda p: residual(unknowns.law(p)), lambda p: unknowns.slopes(p, residual)


def search(
    unknowns: Unknowns, residual: Callable, jacobian: Callable, tolerance: float = 1e-10
) -> OptimizeResult:
    """Bounded least squares from the start of the unknowns."""
    return least_squares(
        residual,
        unknowns.start,
        jacobian,
        bounds=unknowns.bounds,
        x_scale="jac",
        xtol=tolerance,
        ftol=tolerance,
        gtol=tolerance,
        max_nfev=200,
    )


def choose(trials: Sequence[Trial]) -> Trial:
    """Best of several fits; a third stage has to earn its parameters (Bayes' criterion)."""
    n = len(trials[0][2].fun)
    noise = max(min(2 * found.cost for *_, found in trials) / n, 1e-300)
    return min(trials, key=lambda trial: 2 * trial[2].cost / noise + len(trial[0]) * np.log(n))


def misfit_of(predicted: Sequence[FloatArray], tests: Sequence[Forces]) -> float:
    """Root mean square of the relative deviation of the measured forces."""
    pairs = zip(tests, predicted, strict=True)
    relative = np.concatenate([test.force / force - 1 for test, force in pairs])
    return float(np.sqrt(np.mean(relative**2)))


def stages(curve: StressCurve, keep: Mapping[str, float]) -> list[ThreeStageLaw]:
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
    found = []
    onsets = [*np.arange(0.25, top, 0.05), max(top, LONGEST + 0.01)]
    for I_lo in [keep["I_lo"]] if "I_lo" in keep else onsets:
        late = x > I_lo
        z = x[late] - I_lo
        excess = S[late] - S[flat] - C_mid * (x[late] - x[flat])
        C_lo = max(float(excess @ z**2 / max((z**4).sum(), 1e-300)), 0.1 * C_ini)
        values = {
            "C_ini": C_ini,
            "S_ini": 0.1 * dS_mid,
            "C_mid": C_mid,
            "dS_mid": dS_mid,
            "C_lo": C_lo if I_lo < top else 0.0,
            "I_lo": float(I_lo),
        } | dict(keep)
        if "S_ini" not in keep:
            values["S_ini"] = min(values["S_ini"], LONGEST * values["C_ini"])
        elif "C_ini" not in keep:
            values["C_ini"] = max(values["C_ini"], 1.1 * values["S_ini"] / LONGEST)
        found.append(ThreeStageLaw(**values))
    return found


def report(
    law: ThreeStageLaw,
    unknowns: Unknowns,
    found: OptimizeResult,
    keep: Mapping[str, float],
    top: float,
    misfit: float,
) -> Fit:
    """Intervals from the curvature at the least squares, widened where residuals are correlated."""
    p, J, r = found.x, found.jac, found.fun
    freedom = max(len(r) - len(p), 1)
    variance = float(r @ r) / freedom
    lag = float(np.clip((r[1:] @ r[:-1]) / max(r @ r, 1e-300), 0.0, 0.95))
    variance *= (1 + lag) / (1 - lag)
    # a direction that the tests do not see has no bound
    size = np.linalg.norm(J, axis=0)
    size = np.maximum(size, 1e-12 * size.max())
    _, s, Vt = np.linalg.svd(J / size, full_matrices=False)
    spread = Vt.T / np.where(s > 1e-9 * s[0], s, 1e-30) / size[:, None]
    covariance = variance * spread @ spread.T
    native = unknowns.slopes(p, lambda law: np.array([getattr(law, name) for name in NAMES]))
    deviation = np.sqrt(np.einsum("ij,jk,ik->i", native, covariance, native))
    reach = stdtrit(freedom, 0.975) * deviation
    parameters = []
    for name, half in zip(NAMES, reach.tolist(), strict=True):
        value = float(getattr(law, name))
        if name in keep:
            state, half = "kept", 0.0
        elif name in LOCKING and name not in unknowns.free:
            state, half = "not tested", np.nan
        else:
            state = "fitted" if half < value else "not identified"
        parameters.append(
            Parameter(name, value, max(value - half, 0.0), value + half, UNITS[name], state)
        )
    return Fit(law, tuple(parameters), _ends(law), misfit)


def _nelder_mead(unknowns: Unknowns, residual: Callable) -> OptimizeResult:
    """Simplex search as in the paper, from the stages' start; restarted until it stays."""

    def cost(p: FloatArray) -> float:
        if (p < unknowns.bounds[0]).any() or (p > unknowns.bounds[1]).any():
            return np.inf
        return float((residual(unknowns.law(p)) ** 2).sum())

    p, best = unknowns.start, np.inf
    for _ in range(20):
        found = minimize(
            cost,
            p,
            method="Nelder-Mead",
            options={
                "maxiter": 4000,
                "maxfev": 4000,
                "xatol": 1e-10,
                "fatol": 1e-12,
                "adaptive": True,
            },
        )
        p = found.x
        if found.fun > (1 - 1e-6) * best:
            break
        best = found.fun
    found.fun = residual(unknowns.law(p))
    found.jac = unknowns.slopes(p, residual)
    return found
