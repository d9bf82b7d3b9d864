"""Dead loads: the weight of the sheet, and of a tool that rests on it."""

from __future__ import annotations

import numpy as np

from ..unknowns import FloatArray, Sheet
from .term import Term

GRAVITY = 9.81e-3  # N/g


class SheetWeight(Term):
    """Weight of the sheet: E = q Σ w_i z_i with the load factor q as a degree of freedom.

    Raising q from 0 to 1 as the driven degree of freedom applies the weight in increments: `load`,
    N/mm² at q = 1, with the number of q in x.
    """

    name = "weight of the sheet"
    quadratic = True

    def __init__(self, sheet: Sheet, load: float, factor_dof: int) -> None:
        height = sheet.dofs[:, 2]
        self.dofs = np.column_stack([height, np.full_like(height, factor_dof)])
        self.force = load * sheet.blank.node_areas

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        z, q = x[self.dofs].T
        return self.force * q * z

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        z, q = x[self.dofs].T
        return self.force[:, None] * np.column_stack([q, z])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """Only the mixed derivative by z and q, which is not a stiffness."""
        H = np.zeros((len(self.force), 2, 2))
        H[:, 0, 1] = H[:, 1, 0] = self.force
        return H


class ToolWeight(Term):
    """Weight P, N, of a floating tool and what else presses it down: E = P z."""

    quadratic = True

    def __init__(self, load: float, dof: int, name: str = "weight of the blank holder") -> None:
        self.name, self.dofs, self.force = name, np.array([[dof]]), load

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return self.force * x[self.dofs[0]]

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return np.array([[self.force]])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        return np.zeros((1, 1, 1))
