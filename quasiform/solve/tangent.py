"""The tangent: exact where it is positive definite, the nearby convex one where it is not.

The convex tangent alone is too stiff: it then serves as preconditioner of conjugate gradients on
the exact one, which end at the first direction of negative curvature [1]_. So does every factor in
the steps after it: another one is made only where a few iterations with it are not enough.
Factorisations are counted: the unit in which work is measured.

References
----------
.. [1] T. Steihaug, SIAM J. Numer. Anal. 20 (1983) 626-637.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from scipy.sparse import csr_array

from ..potential import Memory, Potential
from ..unknowns import FloatArray
from .linear import Pardiso, SingularMatrixError, SuperLU, linear_solver

KEPT = 8  # further factorisations of the convex tangent before the exact one is tried again
FORCING = 0.1  # residual of the conjugate gradients relative to the first, in their own norm
MOST = 30  # of their iterations
MOST_WITH_OLD = 10  # of them with the factor of an earlier step
FEW = 2500  # unknowns up to which each step is factorised: that takes no longer


class Tangent:
    """The tangent of a potential, with the linear solver of that name.

    `places` (n_free, 2) of the free unknowns are flat, mm; nan without one. `held` as in `linear`.
    """

    def __init__(
        self, potential: Potential, places: FloatArray, linear: str, convex: str, held: bool = False
    ) -> None:
        self.potential, self.convex = potential, convex
        self._given = linear, places, held
        self.solver = self._solver()
        self.counts: Counter[str] = Counter()  # factorisations by purpose
        self.convex_taken = self._kept = 0
        self._purpose = ""
        self._factored: tuple[FloatArray, bool, int] | None = None

    def _solver(self) -> Pardiso | SuperLU:
        self._definite = False  # whether the present factor is that of a positive definite matrix
        linear, places, held = self._given
        return linear_solver(linear, self.potential.pattern, places, held)

    @property
    def factorisations(self) -> int:
        return self.counts.total()

    @contextmanager
    def counted_as(self, purpose: str) -> Iterator[None]:
        """Count the factorisations meanwhile under a purpose; the outermost one counts."""
        outer = self._purpose
        self._purpose = outer or purpose
        try:
            yield
        finally:
            self._purpose = outer

    def refuse(self, before: Counter[str]) -> None:
        """Count what was done since `before` as that of refused increments."""
        refused = self.counts - before
        self.counts = before + Counter({"refused": refused.total()})

    def follow(self, memory: Memory) -> None:
        """Take over changed states, and analyse the pattern anew where it has grown."""
        if self.potential.follow(memory):
            self.solver = self._solver()
        self._factored = None

    def factored_at(self, x: FloatArray) -> bool:
        """Whether the last factor is that of the exact tangent at x."""
        known = self._factored
        return known is not None and not known[1] and np.array_equal(known[0], x)

    def forget(self) -> None:
        """The last factor is of no use any more."""
        self._factored = None

    def restart(self) -> None:
        """Begin another solve: the exact tangent is tried first."""
        self._factored, self._kept = None, 0

    def take(self, potential: Potential) -> None:
        """Take another potential, and analyse its pattern if that is another one."""
        old, new = self.potential.pattern, potential.pattern
        same = np.array_equal(old.indptr, new.indptr) and np.array_equal(old.indices, new.indices)
        self.potential, self._factored = potential, None
        if not same:
            self.solver = self._solver()

    def factor(
        self, x: FloatArray, memory: Memory, convex: bool, **given: FloatArray | None
    ) -> tuple[int, FloatArray]:
        """Factorise a tangent; number of negative pivots, and its product with a motion.

        Given are the `motion`, and a foreseen `stress`, which takes the place of that at x. The
        factor of an accepted state, made for its certificate, serves the next prediction too.
        """
        known = self._factored if given.get("stress") is None else None
        same = known is not None and known[1] == convex and np.array_equal(known[0], x)
        if same and given.get("motion") is None:
            return known[2], np.zeros(self.potential.pattern.shape[0])
        values, load = self.potential.hessian(x, memory, convex, **given)
        if not same:
            self._factor(x, convex, values)
        return self._factored[2], load

    def _factor(self, x: FloatArray, convex: bool, values: FloatArray) -> int:
        self._factored, self._definite = None, False
        self.counts[(self._purpose or "check") + ", convex" * convex] += 1
        negative = self.solver.factor(values)
        self._factored, self._definite = (x.copy(), convex, negative), convex or not negative
        return negative

    def factor_definite(self, x: FloatArray, memory: Memory, motion: FloatArray) -> FloatArray:
        """Factorise the exact tangent if it is positive definite, else the convex one.

        Its product with a motion. With `convex` "never", the exact one whatever it is.
        """
        if self.convex != "always":
            try:
                negative, load = self.factor(x, memory, False, motion=motion)
                if self.convex == "never" or not negative:
                    return load
            except SingularMatrixError:
                if self.convex == "never":
                    raise
        self.convex_taken += self.convex == "on demand"
        return self.factor(x, memory, True, motion=motion)[1]

    def step(
        self, x: FloatArray, memory: Memory, g: FloatArray, stress: FloatArray | None = None
    ) -> FloatArray:
        """Newton's step (n_free,) from x, against the free part g of the gradient.

        The last factor serves as long as a few iterations with it are enough. Then the exact
        tangent is factorised or, where it is not positive definite, the convex one, there and the
        next times. With `convex` "never" the exact one is taken whatever it is.
        """
        if self.convex == "always":
            self.factor(x, memory, True, stress=stress)
            return -self.solve(g)
        exact = self.potential.hessian(x, memory, False, stress=stress)[0]
        reuse = self._definite and stress is None and len(g) > FEW
        if reuse and self.convex != "never":
            d, enough = self._truncated(exact, g, MOST_WITH_OLD)
            if enough:
                return d
        if not self._kept:
            try:
                if not self._factor(x, False, exact) or self.convex == "never":
                    return -self.solve(g)
            except SingularMatrixError:
                if self.convex == "never":
                    raise
            self.convex_taken += 1
            self._kept = KEPT + 1
        self._kept -= 1
        self._factor(x, True, self.potential.hessian(x, memory, True, stress=stress)[0])
        return self._truncated(exact, g, MOST)[0]

    def _truncated(self, values: FloatArray, g: FloatArray, most: int) -> tuple[FloatArray, bool]:
        """Conjugate gradients on a tangent of these values, preconditioned by the present factor.

        Towards its step from the gradient g; up to the first direction of negative curvature. The
        step, and whether it is of use: close enough, or ended by that direction after the first.
        """
        pattern = self.potential.pattern
        upper = csr_array((values, pattern.indices, pattern.indptr), shape=pattern.shape)
        diagonal = upper.diagonal()
        d, r = np.zeros_like(g), -g
        z = self.solve(r)
        p, now = z, r @ z
        enough = FORCING**2 * now
        for i in range(most):
            product = upper @ p + upper.T @ p - diagonal * p
            curvature = p @ product
            if curvature <= 1e-8 * now:
                return (d, True) if i else (z, False)
            length = now / curvature
            d, r = d + length * p, r - length * product
            z = self.solve(r)
            before, now = now, r @ z
            if now < enough:
                return d, True
            p = z + (now / before) * p
        return d, False

    def solve(self, b: FloatArray) -> FloatArray:
        return self.solver.solve(b)
