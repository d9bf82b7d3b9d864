"""Grippers: E = Σ s_i [K/2 (e·u_i)² - T e·u_i] with the motion u of the gripped nodes.

A gripper pulls with the tension T along the direction e, and yields with the stiffness K; s_i are
the nodes' shares of the gripped edge, which sum to 1 over all sheets that the gripper holds.
"""

from __future__ import annotations

import numpy as np

from ..unknowns import FloatArray, Sheet
from .term import Term


class Grip(Term):
    """A gripper on nodes (m,) of a sheet in space, with T in N when they are at `start` (m, 3).

    T and K, N/mm, are those of the whole gripper: where it holds several sheets, the `shares` (m,)
    of one of them sum to less than 1.
    """

    name = "gripper"
    quadratic = load = True

    def __init__(
        self,
        sheet: Sheet,
        nodes: np.ndarray,
        shares: FloatArray,
        start: FloatArray,
        direction: FloatArray,
        tension: float,
        stiffness: float,
    ) -> None:
        self.sheet, self.dofs = sheet, sheet.dofs[nodes]
        self.start, self.direction = start, direction
        self.tension, self.stiffness = shares * tension, shares * stiffness

    def _motion(self, x: FloatArray) -> FloatArray:
        return (x[self.dofs] - self.start) @ self.direction

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        u = self._motion(x)
        return 0.5 * self.stiffness * u**2 - self.tension * u

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return (self.stiffness * self._motion(x) - self.tension)[:, None] * self.direction

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        return self.stiffness[:, None, None] * np.outer(self.direction, self.direction)
