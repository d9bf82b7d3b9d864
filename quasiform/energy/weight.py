"""Loads: the weight of the sheet, that of a tool that rests on it, and a force on the tool."""

from __future__ import annotations

import numpy as np

from ..tools.shapes import Tool
from ..unknowns import FloatArray, Sheet
from .term import Term

GRAVITY = 9.81e-3  # N/g


def load_of(tool: Tool) -> float:
    """Weight of a tool and the force on it at the start of the travel, N."""
    return 1e3 * GRAVITY * tool.mass + float(tool.forces[0, 1])


class SheetWeight(Term):
    """Weight of the sheet: E = q Σ w_i z_i with the load factor q as a degree of freedom.

    Raising q from 0 to 1 as the driven degree of freedom applies the weight in increments: `load`,
    N/mm² at q = 1, with the number of q in x.
    """

    name = "weight of the sheet"
    quadratic = load = True

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

    quadratic = load = True

    def __init__(self, load: float, dof: int, name: str = "weight of the blank holder") -> None:
        self.name, self.dofs, self.force = name, np.array([[dof]]), load

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return self.force * x[self.dofs[0]]

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return np.array([[self.force]])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        return np.zeros((1, 1, 1))


class ToolForce(Term):
    """Force q, N, on a floating tool that changes over the travel: E = q (z - z0).

    q is a prescribed unknown; z0, mm, is the height from which its work is counted.
    """

    quadratic = load = True

    def __init__(self, dof: int, force_dof: int, start: float, name: str) -> None:
        self.name, self.dofs, self.start = name, np.array([[dof, force_dof]]), start

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        z, q = x[self.dofs].T
        return q * (z - self.start)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        z, q = x[self.dofs].T
        return np.column_stack([q, z - self.start])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """Only the mixed derivative, as for the weight of the sheet."""
        return np.array([[[0.0, 1.0], [1.0, 0.0]]])
