"""Softening of the bending: E = Σ A [W(κ) - B κ²/2] with a measured moment W'(κ) = M(κ).

It is what `Bending`, with the stiffness B of the flat fabric, stores too much where the fabric has
a `moment_warp` or `moment_weft`: fibres slide in a bent fabric. The curvatures are those of
`Bending`, on its stencils. The in-plane part keeps B.
"""

from __future__ import annotations

import numpy as np

from ..unknowns import FloatArray
from .bending import Bending
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

    def _at(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """u, v, n (m, 3), |u x v|, κ (m, 2), its slopes by u x v (m, 2, 3) and all (m, 2, 12)."""
        operator, constant = self.bending.operator, self.bending.constant
        y = (operator @ x[self.dofs][:, :, None])[:, :, 0].reshape(-1, 4, 3) + constant
        k, u, v = y[:, :2], y[:, 2], y[:, 3]
        m = np.cross(u, v)
        length = np.linalg.norm(m, axis=1)
        n = m / length[:, None]
        kappa = np.einsum("sfc,sc->sf", k, n)
        q = (k - kappa[..., None] * n[:, None]) / length[:, None, None]
        d = np.zeros((len(k), 2, 4, 3))
        d[:, 0, 0] = d[:, 1, 1] = n
        d[:, :, 2], d[:, :, 3] = np.cross(v[:, None], q), np.cross(q, u[:, None])
        return u, v, n, length, kappa, q, d.reshape(-1, 2, 12)

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return self._beyond(self._at(x)[4], "energy").sum(1)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        *_, kappa, _, d = self._at(x)
        force = np.einsum("sf,sfr->sr", self._beyond(kappa, "stress"), d)
        return (force[:, None] @ self.bending.operator)[:, 0]

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` zero: a fabric that softens is stiffest where it is flat."""
        if convex:
            return np.zeros((len(self.dofs), *self.dofs.shape[1:] * 2))
        u, v, n, length, kappa, q, d = self._at(x)
        H = d.transpose(0, 2, 1) @ (self._beyond(kappa, "stiffness")[..., None] * d)
        # derivative of m = u x v: δm = -[v]x δu + [u]x δv, and of κ by it
        cross = np.concatenate([-_skew(v), _skew(u)], axis=2)
        P = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
        w = self._beyond(kappa, "stress")
        for f in (0, 1):
            mixed = w[:, f, None, None] * (P @ cross)
            H[:, 3 * f : 3 * f + 3, 6:] += mixed
            H[:, 6:, 3 * f : 3 * f + 3] += mixed.transpose(0, 2, 1)
        Q = np.einsum("sf,sfc->sc", w, q)
        nQ = n[:, :, None] * Q[:, None, :]
        mm = -(nQ + nQ.transpose(0, 2, 1) + (w * kappa).sum(1)[:, None, None] * P)
        H[:, 6:, 6:] += cross.transpose(0, 2, 1) @ (mm / length[:, None, None]) @ cross
        H[:, 6:9, 9:] -= _skew(Q)
        H[:, 9:, 6:9] += _skew(Q)
        return self.bending.operator.transpose(0, 2, 1) @ H @ self.bending.operator


def bending_terms(bending: Bending) -> list[Term]:
    """The bending of a sheet in space, and its softening where the fabric's moments have one."""
    fabric = bending.sheet.fabric
    curved = fabric.moment_warp is not None or fabric.moment_weft is not None
    return [bending, Softening(bending)] if curved else [bending]


def _skew(w: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices [w]x with [w]x a = w x a."""
    S = np.zeros((len(w), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    return S - S.transpose(0, 2, 1)
