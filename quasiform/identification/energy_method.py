"""Energy method: the shear stress S12 from forces, without a formula for the law.

The power balance (`specimen`) is linear in S12. The paper solves it by recursion from γ/2 to γ
(Eq. 10), which passes the noise at each angle on to twice that angle. Here the same equation is
solved for all rows and tests at once: S12 is a cubic spline in I6 = sin γ that increases from zero
and fits the forces by least squares with signs (scipy's `nnls`) and a penalty on its curvature, the
total variation of the second derivative relative to the stress. It keeps a sharp onset of locking
sharp (Mammen, van de Geer, Annals of Statistics 25 (1997) 387). Generalised cross-validation with
the safety factor of Kim, Gu (J. R. Statist. Soc. B 66 (2004) 337) gives its weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy as sp  # its parts load when they are used

from ..checks import InputError
from ..fabric import TabulatedLaw

FloatArray = np.ndarray
SAFETY = 1.4  # factor on the degrees of freedom in the cross-validation
PENALTIES = 0.01**2 * np.logspace(1, -7, 17)  # for forces with errors of about 1 %


@dataclass(frozen=True)
class Forces:
    """Forces of one test and the shares of its zones in them, force = Σ shares S12(sin angles)."""

    force: FloatArray  # (n,) measured, N (or N/mm where the shares are per length)
    sigma: FloatArray  # (n,) its standard deviation
    shares: FloatArray  # (m, n) of the zones, mm²
    angles: FloatArray  # (m, n) shear angles of the zones, radians; the first is the largest

    def predicted(self, law: Any) -> FloatArray:
        """(n,) forces under a shear law."""
        return (self.shares * law.stress(np.sin(self.angles))).sum(0)

    def residual(self, unknowns: Any, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) over `sigma` and derivatives (n, k) by the values of `fit.Unknowns`."""
        J = unknowns.slopes(p, self.predicted) / self.sigma[:, None]
        return (self.predicted(unknowns.law(p)) - self.force) / self.sigma, J


@dataclass(frozen=True)
class StressCurve:
    """S12 as a spline of I6, with its uncertainty."""

    spline: sp.interpolate.BSpline  # S12(I6), MPa, increasing from zero
    covariance: FloatArray  # (k, k) of the coefficients of the spline, MPa²
    low: float  # smallest and largest tested shear angle, degrees
    high: float
    misfit: float = np.nan  # root mean square of the relative deviation of the forces

    def stress(self, I6: FloatArray) -> FloatArray:
        """S12 in MPa; same shape as `I6`. Not a number beyond the tests."""
        return np.sign(I6) * self.spline(np.abs(I6))

    def deviation(self, I6: FloatArray) -> FloatArray:
        """Standard deviation of S12, MPa; (n,) like `I6`."""
        B = self.spline.design_matrix(np.abs(I6), self.spline.t, 3).toarray()
        return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", B, self.covariance, B), 0.0))

    def law(self) -> TabulatedLaw:
        """The curve as a shear law, with one row of the table for each knot."""
        I6 = np.unique(self.spline.t)
        I6[-1] *= 1 - 1e-12
        S12 = self.spline(I6)
        S12[0] = 0.0
        rising = np.append(True, np.diff(np.maximum.accumulate(S12)) > 1e-9 * S12.max())
        return TabulatedLaw(tuple(I6[rising].tolist()), tuple(S12[rising].tolist()))


def relative_misfit(tests: Sequence[Forces], law: Any) -> float:
    """Root mean square of the relative deviation of the measured forces from those of a law."""
    off = np.concatenate([test.force / test.predicted(law) - 1 for test in tests])
    return float(np.sqrt(np.mean(off**2)))


def energy_method(tests: Sequence[Forces]) -> StressCurve:
    """S12 from the forces of one or several tests; InputError if no positive stress fits them."""
    full = np.sort(np.concatenate([np.sin(test.angles[0]) for test in tests]))
    breaks = full[-1] * (1 + 1e-9) * np.linspace(0.0, 1.0, 101) ** 1.5  # the first stage is short
    for _ in range(4):
        spline, covariance = _Problem(tests, breaks).smoothest()
        # halve the intervals in which the stress deviates from its chord by more than about 1 %
        middle, h = 0.5 * (breaks[1:] + breaks[:-1]), np.diff(breaks)
        bend = np.abs(spline.derivative(2)(middle)) * h**2 / np.maximum(spline(middle), 1e-300)
        spacing = np.interp(middle, full[1:], np.diff(full))
        split = (bend > 0.03) & (middle > full[0]) & (h > spacing)
        if not split.any():
            break
        breaks = np.sort(np.concatenate([breaks, middle[split]]))
    low, high = (np.degrees(f([f(test.angles[0]) for test in tests])) for f in (np.min, np.max))
    curve = StressCurve(spline, covariance, float(low), float(high))
    return replace(curve, misfit=relative_misfit(tests, curve))


class _Problem:
    """Penalised least squares for the steps d >= 0 of the coefficients c = cumulate d."""

    def __init__(self, tests: Sequence[Forces], breaks: FloatArray) -> None:
        self.t = np.pad(breaks, 3, mode="edge")
        n = len(self.t) - 4
        self.cumulate = np.tril(np.ones((n, n)))[:, 1:]  # the first coefficient is 0

        def design(x: FloatArray) -> FloatArray:
            return sp.interpolate.BSpline.design_matrix(x, self.t, 3).toarray() @ self.cumulate

        A = [
            sum(
                share[:, None] * design(np.sin(angle))
                for share, angle in zip(test.shares, test.angles, strict=True)
            )
            for test in tests
        ]
        weight = 1.0 / np.concatenate([test.sigma for test in tests])
        y = weight * np.concatenate([test.force for test in tests])
        unit = np.linalg.norm(y) / np.sqrt(len(y))
        self.y, self.A = y / unit, weight[:, None] * np.concatenate(A) / unit
        self.noise = 1.0 / unit**2  # variance by the measured deviations
        self.widths, middle = np.diff(breaks), 0.5 * (breaks[1:] + breaks[:-1])
        self.middle = design(middle)
        self.third = sp.interpolate.BSpline(self.t, self.cumulate, 3).derivative(3)(middle)

    def smoothest(self) -> tuple[sp.interpolate.BSpline, FloatArray]:
        """Spline with the penalty that predicts best, and the covariance of its coefficients."""
        n, best = len(self.y), (np.inf, None, None)
        d = self._solve(1e-3 * np.sqrt(self.widths))
        for penalty in PENALTIES:
            for _ in range(8):  # the total variation by reweighted least squares
                S = self.middle @ d
                if not S.max() > 0:
                    raise InputError("no shear stress follows from these forces")
                scale = np.maximum(S, 0.02 * S.max())
                bend = np.abs(self.third @ d) / scale
                weight = np.sqrt(penalty * self.widths / (bend + 0.01 * bend.mean())) / scale
                d = self._solve(weight)
            free = d > 0
            normal = self.A[:, free].T @ self.A[:, free]
            bent = weight[:, None] * self.third[:, free]
            inverse = np.linalg.pinv(normal + bent.T @ bent, hermitian=True)
            freedom = float(np.trace(inverse @ normal))
            squares = float(((self.A @ d - self.y) ** 2).sum())
            spare = n - SAFETY * freedom
            score = squares / spare**2 if spare > 0 else np.inf
            if best[1] is None or score < best[0]:
                C = self.cumulate[:, free]
                variance = max(squares / max(n - freedom, 1.0), self.noise)
                best = score, self.cumulate @ d, C @ (inverse * variance) @ C.T
        return sp.interpolate.BSpline(self.t, best[1], 3, extrapolate=False), best[2]

    def _solve(self, weight: FloatArray) -> FloatArray:
        rows = np.vstack([self.A, weight[:, None] * self.third])
        y = np.pad(self.y, (0, len(weight)))
        return sp.optimize.nnls(rows, y, maxiter=50 * len(self.t))[0]
