"""The tangent: exact where it is positive definite, the nearby convex one where it is not.

Factorisations are counted: the unit in which work is measured.
"""

from __future__ import annotations

import time

import numpy as np

from ..potential import Memory, Potential
from .linear import SingularMatrixError, linear_solver

FloatArray = np.ndarray
LEAST_SHARE = 1 / 64  # of the convex tangent, while a sheet slides off a saddle


class Tangent:
    """The tangent of a potential, with its linear solver.

    Parameters
    ----------
    potential : Potential
    places : (n_free, 2) array
        Flat place of each free unknown, mm; nan without one.
    linear : str
        Name of the linear solver.
    convex : "on demand", "always" or "never"
        When the convex tangent takes the place of the exact one.
    """

    def __init__(self, potential: Potential, places: FloatArray, linear: str, convex: str) -> None:
        self.potential, self.convex = potential, convex
        self._places, self._linear = places, linear
        self.solver = linear_solver(linear, potential.pattern, places)
        self.factorisations = 0
        self.seconds = 0.0
        self.convex_taken = 0
        self._factored: tuple[FloatArray, float, int] | None = None
        self._share = 1 / 4

    @property
    def inertia(self) -> bool:
        """Whether the solver knows the number of negative pivots."""
        return self.solver.inertia

    def of(self, potential: Potential) -> None:
        """Take another potential of the same pattern."""
        self.potential, self._factored = potential, None

    def follow(self, memory: Memory) -> None:
        """Take over changed states, and analyse the pattern anew where it has grown."""
        if self.potential.follow(memory):
            self.solver = linear_solver(self._linear, self.potential.pattern, self._places)
        self._factored = None

    def forget(self) -> None:
        """The last factor is not that of any state's tangent."""
        self._factored = None

    def factor(
        self,
        x: FloatArray,
        memory: Memory,
        convex: float,
        motion: FloatArray | None = None,
        stress: FloatArray | None = None,
    ) -> tuple[int, FloatArray]:
        """Factorise a tangent; number of negative pivots, and its product with a motion.

        The factor of an accepted state, made for its certificate, serves the next prediction too.

        Parameters
        ----------
        x : (n_dofs,) array
        memory : tuple
        convex : float
            Share of the convex tangent in it, the rest is the exact one.
        motion : (n_dofs,) array, optional
        stress : array, optional
            A foreseen stress, which takes the place of that at x.

        Raises
        ------
        SingularMatrixError
        """
        values, load = self.potential.hessian(x, memory, convex == 1, motion, stress)
        if 0 < convex < 1:
            values += convex * (self.potential.hessian(x, memory, True)[0] - values)
        known = self._factored if stress is None else None
        if known is None or known[1] != convex or not np.array_equal(known[0], x):
            self._factored = None
            self.factorisations += 1
            clock = time.perf_counter()
            try:
                self._factored = x.copy(), convex, self.solver.factor(values)
            finally:
                self.seconds += time.perf_counter() - clock
        return self._factored[2], load

    def factor_definite(
        self,
        x: FloatArray,
        memory: Memory,
        motion: FloatArray | None = None,
        stress: FloatArray | None = None,
        sliding: bool = False,
    ) -> tuple[bool, FloatArray]:
        """Factorise the exact tangent if it is positive definite, else the convex one.

        With `convex` "never", the exact one whatever it is. While a sheet is `sliding` off a saddle
        the convex tangent is much too stiff: the smallest share of it that does is taken.

        Returns
        -------
        exact : bool
        load : (n_free,) array
        """
        if self.convex == "never":
            return True, self.factor(x, memory, 0.0, motion, stress)[1]
        if self.convex == "on demand" and self.inertia:
            if (load := self._if_definite(x, memory, 0.0, motion, stress)) is not None:
                return True, load
            self.convex_taken += 1
            share = self._share
            while sliding and stress is None and share < 1:
                if (load := self._if_definite(x, memory, share, motion)) is not None:
                    self._share = max(share / 4, LEAST_SHARE)
                    return False, load
                share *= 4
            self._share = 1 / 4
        return False, self.factor(x, memory, 1.0, motion, stress)[1]

    def _if_definite(
        self, x: FloatArray, memory: Memory, share: float, *more: FloatArray | None
    ) -> FloatArray | None:
        """Product with the motion if the tangent is positive definite."""
        try:
            negative, load = self.factor(x, memory, share, *more)
        except SingularMatrixError:
            return None
        return None if negative else load

    def solve(self, b: FloatArray) -> FloatArray:
        """Solve with the last factor.

        Raises
        ------
        SingularMatrixError
        """
        clock = time.perf_counter()
        try:
            return self.solver.solve(b)
        finally:
            self.seconds += time.perf_counter() - clock
