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

from ..blank import Blank
from ..material import Fabric
from .membrane import Membrane, clamp

FloatArray = np.ndarray


class PairedMembrane(Membrane):
    """Tension and shear of a blank with `pairs`, six nodes a stencil (three twice if alone).

    Parameters
    ----------
    blank : Blank
    fabric : Fabric
    dim : int
        Position components a node, 2 or 3.
    """

    def __init__(self, blank: Blank, fabric: Fabric, dim: int) -> None:
        super().__init__(blank, fabric, dim)
        self.triangle_dofs = self.dofs
        pairs = blank.pairs
        self.pairs = pairs
        self.dofs = self.triangle_dofs[pairs].reshape(len(pairs), -1)
        alone = pairs[:, 0] == pairs[:, 1]
        self.parts = np.where(alone[:, None], 0.5, 1.0) * self.volume[pairs]  # V_t
        self.whole = self.parts.sum(1)
        # fibre derivatives by the six nodes: of each triangle (n, 2, 2, 6), and their mean
        self.g_each = np.zeros((len(pairs), 2, 2, 6))
        self.g_each[:, 0, :, :3], self.g_each[:, 1, :, 3:] = self.g[pairs].transpose(1, 0, 2, 3)
        share = self.parts / self.whole[:, None]
        self.g_mean = np.einsum("nt,ntfl->nfl", share, self.g_each)
        self.pair_of = np.empty(len(self.triangle_dofs), dtype=int)
        self.pair_of[pairs] = np.arange(len(pairs))[:, None]

    def fibres(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, dim) mean fibre vectors of the pair of each triangle."""
        return self._mean(x)[self.pair_of]

    def _mean(self, x: FloatArray) -> FloatArray:
        return self.g_mean @ x[self.dofs].reshape(-1, 6, self.dim)

    def _each(self, x: FloatArray) -> FloatArray:
        """(n_pairs, 2, 2, dim) fibre vectors of the two triangles."""
        return self.g_each @ x[self.dofs].reshape(-1, 1, 6, self.dim)

    def normals(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 1 or 3) normal times area ratio of each triangle by itself."""
        f = self.g @ x[self.triangle_dofs].reshape(-1, 3, self.dim)
        return self.cross(f)

    def energy(self, x: FloatArray) -> FloatArray:
        """Energy of each pair, mJ."""
        f, each = self._mean(x), self._each(x)
        I4, I8 = (f[:, 0] ** 2).sum(1), (f[:, 1] ** 2).sum(1)
        I6 = (each[:, :, 0] * each[:, :, 1]).sum(2)
        fabric = self.fabric
        tension = fabric.warp.energy(I4, 1.0) + fabric.weft.energy(I8, 1.0)
        return self.whole * tension + (self.parts * fabric.shear.energy(I6)).sum(1)

    def _stresses(
        self, x: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Mean and own fibre vectors, and S11, S22 (n,), S12 (n, 2) of the pairs, MPa."""
        f, each = self._mean(x), self._each(x)
        S11 = 2.0 * self.fabric.warp.stress((f[:, 0] ** 2).sum(1), 1.0)
        S22 = 2.0 * self.fabric.weft.stress((f[:, 1] ** 2).sum(1), 1.0)
        S12 = self.fabric.shear.stress((each[:, :, 0] * each[:, :, 1]).sum(2))
        return f, each, S11, S22, S12

    def gradient(self, x: FloatArray) -> FloatArray:
        """(n_pairs, 6 dim) nodal forces, N."""
        f, each, S11, S22, S12 = self._stresses(x)
        pull = np.stack([S11, S22], axis=1)[:, :, None] * self.whole[:, None, None] * f
        forces = self.g_mean.transpose(0, 2, 1) @ pull
        shear = (self.parts * S12)[:, :, None, None] * each[:, :, ::-1]
        forces += (self.g_each.transpose(0, 1, 3, 2) @ shear).sum(1)
        return forces.reshape(len(forces), -1)

    def hessian(self, x: FloatArray, convex: bool) -> FloatArray:
        """(n_pairs, 6 dim, 6 dim) stiffness, N/mm; positive semi-definite with `convex`."""
        f, each, S11, S22, S12 = self._stresses(x)
        fabric, n, dim = self.fabric, len(f), self.dim
        I4, I8 = (f[:, 0] ** 2).sum(1), (f[:, 1] ** 2).sum(1)
        I6 = (each[:, :, 0] * each[:, :, 1]).sum(2)
        dI = np.empty((n, 4, 6, dim))
        dI[:, 0] = 2.0 * self.g_mean[:, 0, :, None] * f[:, 0, None]
        dI[:, 1] = 2.0 * self.g_mean[:, 1, :, None] * f[:, 1, None]
        dI[:, 2:] = self.g_each[:, :, 0, :, None] * each[:, :, 1, None]
        dI[:, 2:] += self.g_each[:, :, 1, :, None] * each[:, :, 0, None]
        dI = dI.reshape(n, 4, -1)
        W2 = np.column_stack(
            [
                self.whole * fabric.warp.stiffness(I4, 1.0),
                self.whole * fabric.weft.stiffness(I8, 1.0),
                self.parts * fabric.shear.stiffness(I6),
            ]
        )
        H = dI.transpose(0, 2, 1) @ (W2[:, :, None] * dI)
        zero = np.zeros_like(S11)
        tension = np.stack([S11, zero, zero, S22], axis=-1).reshape(-1, 2, 2)
        shear = np.stack([0 * S12, S12, S12, 0 * S12], axis=-1).reshape(n, 2, 2, 2)
        if convex:
            tension = clamp(tension)
            shear = clamp(shear.reshape(-1, 2, 2)).reshape(shear.shape)
        geometric = self.g_mean.transpose(0, 2, 1) @ (
            self.whole[:, None, None] * tension @ self.g_mean
        )
        each_part = self.parts[:, :, None, None] * shear @ self.g_each
        geometric += (self.g_each.transpose(0, 1, 3, 2) @ each_part).sum(1)
        blocks = H.reshape(n, 6, dim, 6, dim)
        for c in range(dim):
            blocks[:, :, c, :, c] += geometric
        return H


def membrane_of(blank: Blank, fabric: Fabric, dim: int) -> Membrane:
    """Return the membrane energy that fits the mesh of a blank."""
    return (Membrane if blank.pairs is None else PairedMembrane)(blank, fabric, dim)
