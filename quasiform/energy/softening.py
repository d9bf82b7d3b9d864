"""Softening of the bending: E = Σ A [W(κ) - B κ²/2] with a measured moment W'(κ) = M(κ).

It is what `Bending`, with the stiffness B of the flat fabric, stores too much where the fabric has
a `moment_warp` or `moment_weft`: fibres slide in a bent fabric. The curvatures are those of
`Bending`, on its stencils. The in-plane part keeps B.
"""

from __future__ import annotations

import numpy as np

from ..unknowns import FloatArray
from .bending import Bending, second_derivative
from .term import Term


class Softening(Term):
    """What a `Bending` stores too much by a fabric whose moment is not proportional to κ."""

    def __init__(self, bending: Bending) -> None:
        self.bending, self.sheet, self.dofs = bending, bending.sheet, bending.dofs
        fabric = self.sheet.fabric
        self.name = bending.sheet.named("softening of the bending")
        self.linear = np.array([fabric.bending_warp, fabric.bending_weft])
        self.areas = bending.stiffness.max(1) / self.linear.max()
        curves = fabric.moment_warp, fabric.moment_weft
        self.laws = [curve and curve.law for curve in curves]

    def _beyond(self, kappa: FloatArray, quantity: str) -> FloatArray:
        """(n_stencils, 2) `quantity` of the curves less that of B, times A."""
        found = np.zeros_like(kappa)
        for f, law in enumerate(self.laws):
            if law is not None:
                k, B = kappa[:, f], self.linear[f]
                linear = {"energy": 0.5 * B * k**2, "stress": B * k, "stiffness": B}[quantity]
                found[:, f] = getattr(law, quantity)(k) - linear
        return found * self.areas[:, None]

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return self._beyond(self.bending.curvature(x), "energy").sum(1)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        stress = self._beyond(self.bending.curvature(x), "stress")
        force = np.einsum("sf,sfrc->src", stress, self.bending.slopes(x)[1])
        return (force.reshape(len(force), 1, -1) @ self.bending.operator)[:, 0]

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` zero: a fabric that softens is stiffest where it is flat."""
        if convex:
            return np.zeros((len(self.dofs), *self.dofs.shape[1:] * 2))
        (y, kappa, n, length), (q, d) = self.bending.at(x), self.bending.slopes(x)
        flat = d.reshape(len(d), 2, -1)
        H = flat.transpose(0, 2, 1) @ (self._beyond(kappa, "stiffness")[..., None] * flat)
        H += second_derivative(self._beyond(kappa, "stress"), y, kappa, n, length, q)
        return self.bending.operator.transpose(0, 2, 1) @ H @ self.bending.operator


def bending_terms(bending: Bending) -> list[Term]:
    """The bending of a sheet in space, and its softening where the fabric's moments have one."""
    fabric = bending.sheet.fabric
    curved = fabric.moment_warp is not None or fabric.moment_weft is not None
    return [bending, Softening(bending)] if curved else [bending]
