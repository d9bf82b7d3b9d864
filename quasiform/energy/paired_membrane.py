"""Membrane energy on a mesh that does not follow the fibres: fibre strains shared by pairs.

A P1 triangle with no leg on a fibre locks: each has two nearly inextensible fibre directions, and
there are twice as many triangles as nodes. In pairs that share their fibre strains there is one
constraint for each degree of freedom, as in the fabric's own net. With the triangles' volumes V_t
and the mean fibre vectors of a pair, f = Σ V_t F_t a0 / V,

    E = V [W4(|f_a|²) + W8(|f_b|²)] + Σ V_t W6((F_t a0)·(F_t b0)),

so shear is still seen by every triangle.
"""

from __future__ import annotations

import numpy as np

from ..unknowns import FloatArray, Sheet
from .membrane import (
    Membrane,
    along_fibres,
    clamp,
    cross,
    dot,
    nodal_forces,
    nodal_stiffness,
    second_derivative,
)


class PairedMembrane(Membrane):
    """Tension and shear of a blank with `pairs`, six nodes a stencil (three twice if alone)."""

    def __init__(self, sheet: Sheet) -> None:
        super().__init__(sheet)
        pairs = sheet.blank.pairs
        self.pairs = pairs
        self.dofs = np.hstack([self.dofs[pairs[:, t]] for t in (0, 1)])
        alone = pairs[:, 0] == pairs[:, 1]
        self.parts = np.where(alone, 0.5, 1.0) * self.volume[pairs].T  # V_t, (2, n_pairs)
        self.whole = self.parts.sum(0)
        # fibre derivatives of each triangle by its three nodes, and their mean by all six
        self.g_each = [self._g[:, :, pairs[:, t]] for t in (0, 1)]
        share = self.parts / self.whole
        self.g_mean = np.concatenate([share[t] * self.g_each[t] for t in (0, 1)], axis=1)
        self.pair_of = np.empty(len(self.g), dtype=int)
        self.pair_of[pairs] = np.arange(len(pairs))[:, None]

    def _evaluate(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """Fibre vectors, mean (2, dim, n_pairs) and own (2, 2, dim, n_pairs); I4, both I6, I8."""
        f = along_fibres(self.g_mean, x[self.dofs.T])
        places = np.split(x[self.dofs.T], 2)
        each = np.stack([along_fibres(g, y) for g, y in zip(self.g_each, places, strict=True)])
        return f, each, dot(f[0], f[0]), np.stack([dot(*own) for own in each]), dot(f[1], f[1])

    def fibres(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, dim) mean fibre vectors of the pair of each triangle."""
        return self._at(x)[0].transpose(2, 0, 1)[self.pair_of]

    def invariants(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """I4, I6, I8 of the mean fibre vectors of each triangle's pair."""
        f, _, I4, _, I8 = self._at(x)
        return I4[self.pair_of], dot(*f)[self.pair_of], I8[self.pair_of]

    def normals(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 1 or 3) normal times area ratio of each triangle by itself."""
        each = self._at(x)[1]
        normals = np.empty((len(self.pair_of), 1 if self.sheet.dim == 2 else 3))
        for own, triangles in zip(each, self.pairs.T, strict=True):
            normals[triangles] = cross(*own).T
        return normals

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        _, _, I4, I6, I8 = self._at(x)
        fabric = self.fabric
        tension = fabric.warp.energy(I4, 1.0) + fabric.weft.energy(I8, 1.0)
        return self.whole * tension + (self.parts * fabric.shear.energy(I6)).sum(0)

    def _stresses(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Stress of the mean fibre vectors (2, 2, n), S12 = 0, and own S12 (2, 2, 2, n), MPa."""
        _, _, I4, I6, I8 = self._at(x)
        tension, shear = np.zeros((2, 2, len(I4))), np.zeros((2, 2, 2, len(I4)))
        tension[0, 0] = 2.0 * self.fabric.warp.stress(I4, 1.0)
        tension[1, 1] = 2.0 * self.fabric.weft.stress(I8, 1.0)
        shear[:, 0, 1] = shear[:, 1, 0] = self.fabric.shear.stress(I6)
        return tension, shear

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        f, each = self._at(x)[:2]
        tension, shear = self._stresses(x)
        forces = nodal_forces(self.g_mean, self.whole * tension, f)
        own = [nodal_forces(self.g_each[t], self.parts[t] * shear[t], each[t]) for t in (0, 1)]
        return forces + np.hstack(own)

    def foreseen_stress(self, x: FloatArray, dx: FloatArray) -> FloatArray:
        """(2, 2, n_pairs) tension that the linearisation at x foresees after a step, MPa."""
        f, _, I4, _, I8 = self._at(x)
        df, tension = along_fibres(self.g_mean, dx[self.dofs.T]), self._stresses(x)[0]
        tension[0, 0] += 4.0 * self.fabric.warp.stiffness(I4, 1.0) * dot(f[0], df[0])
        tension[1, 1] += 4.0 * self.fabric.weft.stiffness(I8, 1.0) * dot(f[1], df[1])
        return tension

    def hessian(
        self, x: FloatArray, state: None, convex: bool, stress: FloatArray | None = None
    ) -> FloatArray:
        f, each, I4, I6, I8 = self._at(x)
        tension, shear = self._stresses(x)
        tension = tension if stress is None else stress
        if convex:
            tension, shear = clamp(tension), np.stack([clamp(S) for S in shear])
        fabric, none = self.fabric, np.zeros_like(I4)
        W4, W8 = fabric.warp.stiffness(I4, 1.0), fabric.weft.stiffness(I8, 1.0)
        W6 = self.parts * fabric.shear.stiffness(I6)
        K = second_derivative(f, self.whole * tension, self.whole * W4, none, self.whole * W8)
        H = nodal_stiffness(self.g_mean, K)
        for t, own in enumerate(np.split(np.arange(H.shape[1]), 2)):
            K = second_derivative(each[t], self.parts[t] * shear[t], none, W6[t], none)
            H[:, own[:, None], own] += nodal_stiffness(self.g_each[t], K)
        return H


def membrane_of(sheet: Sheet) -> Membrane:
    """Return the membrane energy that fits the mesh of a sheet."""
    return (Membrane if sheet.blank.pairs is None else PairedMembrane)(sheet)
