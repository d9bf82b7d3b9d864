"""Energy method: forces to the shear stress S12, without a formula for the law.

The power balance (`specimen`) is linear in S12. The paper solves it by recursion from γ/2 to γ
(Eq. 10), which hands the noise of each angle on to the doubled one undamped. Here the same equation
is solved for all rows and tests at once: S12 is a cubic spline in I6 = sin γ, rising from zero,
that balances the forces in the sense of least squares with a price on the bending of its curve. The
price is on the total variation of the second derivative relative to the stress (locally adaptive
regression splines [1]_), which leaves a sharp onset of locking sharp, and is set by generalised
cross-validation with the safety factor of [2]_. The least squares with signs are scipy's `nnls`.

References
----------
.. [1] E. Mammen, S. van de Geer, Annals of Statistics 25 (1997) 387-413.
.. [2] Y.-J. Kim, C. Gu, Journal of the Royal Statistical Society B 66 (2004) 337-356.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import nnls

from ..checks import InputError
from ..fabric import TabulatedLaw

FloatArray = np.ndarray
SAFETY = 1.4  # of the degrees of freedom in the cross-validation
PRICES = np.logspace(1, -7, 17)


@dataclass(frozen=True)
class Forces:
    """Forces of one test with the shares of its zones: what the identification looks at.

    Parameters
    ----------
    force, sigma : (n,) arrays
        Measured, and its standard deviation, N (or N/mm where the shares are per length).
    shares : (m, n) array
        Of the zones, mm²: force = Σ shares S12(sin angles).
    angles : (m, n) array
        Shear angles of the zones, radians; the first is the largest.
    """

    force: FloatArray
    sigma: FloatArray
    shares: FloatArray
    angles: FloatArray

    def predicted(self, law: object) -> FloatArray:
        """(n,) forces under a shear law."""
        return (self.shares * law.stress(np.sin(self.angles))).sum(0)


@dataclass(frozen=True)
class StressCurve:
    """S12 as a spline of I6, with its uncertainty.

    Parameters
    ----------
    spline : BSpline
        S12(I6), MPa, increasing from zero.
    covariance : (k, k) array
        Of the spline's coefficients, MPa².
    low, high : float
        Shear angles between which it was tested, degrees.
    misfit : float
        Root mean square of the relative deviation of the forces.
    """

    spline: BSpline
    covariance: FloatArray
    low: float
    high: float
    misfit: float

    def stress(self, I6: FloatArray) -> FloatArray:
        """S12 in MPa; same shape as `I6`. Not a number beyond the tests."""
        return np.sign(I6) * self.spline(np.abs(I6))

    def deviation(self, I6: FloatArray) -> FloatArray:
        """Standard deviation of S12, MPa; (n,) like `I6`."""
        B = BSpline.design_matrix(np.abs(I6), self.spline.t, 3).toarray()
        return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", B, self.covariance, B), 0.0))

    def law(self) -> TabulatedLaw:
        """The curve as a shear law, with a table as dense as its knots."""
        I6 = np.unique(self.spline.t)
        I6 = np.append(I6[:-1], I6[-1] * (1 - 1e-12))
        S12 = self.spline(I6)
        S12[0] = 0.0
        rising = np.append(True, np.diff(np.maximum.accumulate(S12)) > 1e-9 * S12.max())
        return TabulatedLaw(tuple(I6[rising].tolist()), tuple(S12[rising].tolist()))


def energy_method(tests: Sequence[Forces]) -> StressCurve:
    """S12 from the forces of one or several tests.

    Parameters
    ----------
    tests : sequence of Forces
        With shares as printed by the paper, or those that conserve energy (`specimen`).

    Returns
    -------
    StressCurve
    """
    top = max(float(np.sin(test.angles).max()) for test in tests) * (1 + 1e-9)
    full = np.sort(np.concatenate([np.sin(test.angles[0]) for test in tests]))
    breaks = top * np.linspace(0.0, 1.0, 101) ** 1.5  # the first stage is short
    for _ in range(4):
        problem = _Problem(tests, breaks)
        spline, covariance = problem.smoothest()
        # where the stress bends by more than its hundredth within an interval: halve that
        middle, h = 0.5 * (breaks[1:] + breaks[:-1]), np.diff(breaks)
        bend = np.abs(spline.derivative(2)(middle)) * h**2 / np.maximum(spline(middle), 1e-300)
        spacing = np.interp(middle, full[1:], np.diff(full))
        split = (bend > 0.03) & (middle > full[0]) & (h > spacing)
        if not split.any():
            break
        breaks = np.sort(np.concatenate([breaks, middle[split]]))
    relative = [test.force / problem.forces(i, spline) - 1 for i, test in enumerate(tests)]
    return StressCurve(
        spline,
        covariance,
        float(np.degrees(min(test.angles[0].min() for test in tests))),
        float(np.degrees(max(test.angles[0].max() for test in tests))),
        float(np.sqrt(np.mean(np.concatenate(relative) ** 2))),
    )


class _Problem:
    """Penalised least squares for the steps d >= 0 of the coefficients, c = cumulated d."""

    def __init__(self, tests: Sequence[Forces], breaks: FloatArray) -> None:
        self.t = np.concatenate([[0.0] * 3, breaks, [breaks[-1]] * 3])
        self.n = len(self.t) - 4
        self.cumulate = np.tril(np.ones((self.n, self.n)))[:, 1:]  # the first coefficient is 0
        self.rows = [
            sum(
                share[:, None] * self._design(np.sin(angle))
                for share, angle in zip(test.shares, test.angles, strict=True)
            )
            for test in tests
        ]
        weight = 1.0 / np.concatenate([test.sigma for test in tests])
        self.y = weight * np.concatenate([test.force for test in tests])
        self.A = weight[:, None] * np.concatenate(self.rows) @ self.cumulate
        unit = np.linalg.norm(self.y) / np.sqrt(len(self.y))  # the usual signal is one
        self.A, self.y = self.A / unit, self.y / unit
        self.noise = 1.0 / unit**2  # variance that the records state
        self.widths = np.diff(breaks)
        middle = 0.5 * (breaks[1:] + breaks[:-1])
        third = BSpline(self.t, np.eye(self.n), 3).derivative(3)(middle)
        self.third = third @ self.cumulate
        self.middle = self._design(middle) @ self.cumulate

    def _design(self, x: FloatArray) -> FloatArray:
        return BSpline.design_matrix(x, self.t, 3).toarray()

    def forces(self, test: int, spline: BSpline) -> FloatArray:
        """(n,) forces of a test under a stress curve."""
        return self.rows[test] @ spline.c

    def smoothest(self) -> tuple[BSpline, FloatArray]:
        """Spline with the price of bending that predicts best, and its covariance."""
        n = len(self.y)
        noise = 0.01**2  # the prices are meant for forces good to a hundredth
        best = None
        d = self._solve(1e-3 * np.sqrt(self.widths))
        for price in noise * PRICES:
            for _ in range(8):  # the total variation, by reweighting
                S = self.middle @ d
                if not S.max() > 0:
                    raise InputError("no shear stress follows from these forces")
                scale = np.maximum(S, 0.02 * S.max())
                bend = np.abs(self.third @ d) / scale
                lever = np.sqrt(price * self.widths / (bend + 0.01 * bend.mean())) / scale
                d = self._solve(lever)
            moving = d > 0
            normal = self.A[:, moving].T @ self.A[:, moving]
            bent = lever[:, None] * self.third[:, moving]
            inverse = np.linalg.pinv(normal + bent.T @ bent, hermitian=True)
            freedom = float(np.trace(inverse @ normal))
            left = float(((self.A @ d - self.y) ** 2).sum())
            spare = n - SAFETY * freedom
            score = left / spare**2 if spare > 0 else np.inf
            if best is None or score < best[0]:
                covariance = inverse * max(left / max(n - freedom, 1.0), self.noise)
                best = score, d, moving, covariance
        _, d, moving, covariance = best
        C = self.cumulate[:, moving]
        return BSpline(self.t, self.cumulate @ d, 3, extrapolate=False), C @ covariance @ C.T

    def _solve(self, lever: FloatArray) -> FloatArray:
        rows = np.vstack([self.A, lever[:, None] * self.third])
        return nnls(rows, np.concatenate([self.y, np.zeros(len(lever))]), maxiter=50 * self.n)[0]
