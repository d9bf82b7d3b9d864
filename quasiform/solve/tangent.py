"""The tangent: exact where it is positive definite, the nearby convex one where it is not.

Factorisations are counted: the unit in which work is measured.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..potential import Memory, Potential
from ..unknowns import FloatArray
from .linear import SingularMatrixError, linear_solver

LEAST_SHARE = 1 / 64  # of the convex tangent, while a sheet slides off a saddle


class Tangent:
    """The tangent of a potential, with the linear solver of that name.

    `places` (n_free, 2) of the free unknowns are flat, mm; nan without one.
    """

    def __init__(self, potential: Potential, places: FloatArray, linear: str, convex: str) -> None:
        self.potential, self.convex = potential, convex
        self._places, self._linear = places, linear
        self.solver = linear_solver(linear, potential.pattern, places)
        self.factorisations = self.convex_taken = 0
        self.share = 1 / 4  # of the convex tangent, to be tried first while a sheet slides
        self._factored: tuple[FloatArray, float, int] | None = None

    def follow(self, memory: Memory) -> None:
        """Take over changed states, and analyse the pattern anew where it has grown."""
        if self.potential.follow(memory):
            self.solver = linear_solver(self._linear, self.potential.pattern, self._places)
        self._factored = None

    def forget(self) -> None:
        """The last factor is of no use any more."""
        self._factored = None

    def take(self, potential: Potential) -> None:
        """Take another potential, and analyse its pattern if that is another one."""
        old, new = self.potential.pattern, potential.pattern
        same = np.array_equal(old.indptr, new.indptr) and np.array_equal(old.indices, new.indices)
        self.potential, self._factored = potential, None
        if not same:
            self.solver = linear_solver(self._linear, new, self._places)

    def factor(
        self, x: FloatArray, memory: Memory, convex: float, **given: FloatArray | None
    ) -> tuple[int, FloatArray]:
        """Factorise a tangent; number of negative pivots, and its product with a motion.

        `convex` is the share of the convex tangent in it, the rest is the exact one. Given are the
        `motion`, and a foreseen `stress`, which takes the place of that at x. The factor of an
        accepted state, made for its certificate, serves the next prediction too.
        """
        values, load = self.potential.hessian(x, memory, convex == 1, **given)
        if 0 < convex < 1:
            values += convex * (self.potential.hessian(x, memory, True)[0] - values)
        known = self._factored if given.get("stress") is None else None
        if known is None or known[1] != convex or not np.array_equal(known[0], x):
            self._factored = None
            self.factorisations += 1
            self._factored = x.copy(), convex, self.solver.factor(values)
        return self._factored[2], load

    def factor_definite(
        self, x: FloatArray, memory: Memory, sliding: bool = False, **given: FloatArray | None
    ) -> tuple[bool, FloatArray]:
        """Factorise the exact tangent if it is positive definite, else the convex one.

        Whether it is the exact one, and its product with the motion. With `convex` "never", the
        exact one whatever it is. While a sheet is `sliding` off a saddle the convex tangent is much
        too stiff: the smallest share of it that does is taken.
        """
        if self.convex == "never":
            return True, self.factor(x, memory, 0.0, **given)[1]
        if self.convex == "on demand":
            if (load := self._if_definite(x, memory, 0.0, **given)) is not None:
                return True, load
            self.convex_taken += 1
            share = self.share
            while sliding and given.get("stress") is None and share < 1:
                if (load := self._if_definite(x, memory, share, **given)) is not None:
                    self.share = max(share / 4, LEAST_SHARE)
                    return False, load
                share *= 4
            self.share = 1 / 4
        return False, self.factor(x, memory, 1.0, **given)[1]

    def _if_definite(self, *args: Any, **given: FloatArray | None) -> FloatArray | None:
        """Product with the motion if the tangent is positive definite."""
        try:
            negative, load = self.factor(*args, **given)
        except SingularMatrixError:
            return None
        return None if negative else load

    def solve(self, b: FloatArray) -> FloatArray:
        return self.solver.solve(b)
