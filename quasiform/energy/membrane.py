"""Membrane energy: E = Σ t0 A [W4(I4) + W6(I6) + W8(I8)] over the triangles (Schäfer, Eqs. 7-9).

One quadrature point in each P1 triangle. With f_a = F a0 and f_b = F b0 the gradient of I4, I6, I8
is linear in the positions, so with S = [[2 W4', W6'], [W6', 2 W8']] (second Piola-Kirchhoff stress)

    Hessian = Σ W_k'' ∇I_k ∇I_k' + S ⊗ 1,

and the only indefinite part is S. The convex variant clamps its eigenvalues at zero, which is a
closed form for a 2 x 2 matrix.
"""

from __future__ import annotations

import numpy as np

from ..blank import Blank
from ..material import Fabric, shear_angle

FloatArray = np.ndarray


class Membrane:
    """Tension of both fibre families and shear of a blank, in the plane (d = 2) or in space.

    Parameters
    ----------
    blank : Blank
    fabric : Fabric
    dim : int
        Position components a node, 2 or 3.
    """

    name = "membrane"

    def __init__(self, blank: Blank, fabric: Fabric, dim: int) -> None:
        self.fabric = fabric
        self.dim = dim
        nodes = np.ascontiguousarray(blank.basis.element_dofs.T)
        self.dofs = (dim * nodes[:, :, None] + np.arange(dim)).reshape(len(nodes), -1)
        grad = np.stack([phi[0].grad[:, :, 0] for phi in blank.basis.basis])  # (3, 2, n)
        # derivatives of the three shape functions along warp and weft, (n_triangles, 2, 3)
        self.g = np.einsum("fc,icn->nfi", np.stack([blank.warp, blank.weft]), grad)
        self.volume = fabric.thickness * blank.areas

    def fibres(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, dim) deformed fibre vectors F a0 and F b0."""
        return self.g @ x[self.dofs].reshape(-1, 3, self.dim)

    def invariants(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """I4, I6, I8 of each triangle."""
        f = self.fibres(x)
        return (f[:, 0] ** 2).sum(1), (f[:, 0] * f[:, 1]).sum(1), (f[:, 1] ** 2).sum(1)

    def shear_angle(self, x: FloatArray) -> FloatArray:
        """(n_triangles,) signed shear angle, radians."""
        return shear_angle(*self.invariants(x))

    def normals(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 1 or 3) normal times area ratio; in the plane the determinant of F."""
        return self.cross(self.fibres(x))

    def cross(self, f: FloatArray) -> FloatArray:
        """(n, 1 or 3) products of fibre vectors (n, 2, dim)."""
        product = np.cross(*_in_space(f[:, 0], f[:, 1]))
        return product if self.dim == 3 else product[:, 2:]

    def energy(self, x: FloatArray) -> FloatArray:
        """Energy of each triangle, mJ."""
        I4, I6, I8 = self.invariants(x)
        fabric = self.fabric
        W = fabric.warp.energy(I4, 1.0) + fabric.weft.energy(I8, 1.0) + fabric.shear.energy(I6)
        return self.volume * W

    def stress(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, 2) second Piola-Kirchhoff stress in fibre axes, MPa."""
        I4, I6, I8 = self.invariants(x)
        S12 = self.fabric.shear.stress(I6)
        S11 = 2.0 * self.fabric.warp.stress(I4, 1.0)
        S22 = 2.0 * self.fabric.weft.stress(I8, 1.0)
        return np.stack([S11, S12, S12, S22], axis=-1).reshape(-1, 2, 2)

    def gradient(self, x: FloatArray) -> FloatArray:
        """Nodal forces of each triangle, N."""
        S = self.volume[:, None, None] * self.stress(x)
        forces = self.g.transpose(0, 2, 1) @ (S @ self.fibres(x))
        return forces.reshape(len(forces), -1)

    def hessian(self, x: FloatArray, convex: bool) -> FloatArray:
        """Stiffness of each triangle, N/mm; positive semi-definite with `convex`."""
        n, dim = len(self.g), self.dim
        f = self.fibres(x)
        I4, I6, I8 = (f[:, 0] ** 2).sum(1), (f[:, 0] * f[:, 1]).sum(1), (f[:, 1] ** 2).sum(1)
        ga, gb = self.g[:, 0, :, None], self.g[:, 1, :, None]
        fa, fb = f[:, 0, None, :], f[:, 1, None, :]
        dI = np.stack([2 * ga * fa, ga * fb + gb * fa, 2 * gb * fb], axis=1).reshape(n, 3, -1)
        W2 = np.stack(
            [
                self.fabric.warp.stiffness(I4, 1.0),
                self.fabric.shear.stiffness(I6),
                self.fabric.weft.stiffness(I8, 1.0),
            ],
            axis=1,
        )
        S = self.stress(x)
        S = clamp(S) if convex else S
        H = dI.transpose(0, 2, 1) @ ((self.volume[:, None] * W2)[:, :, None] * dI)
        geometric = self.g.transpose(0, 2, 1) @ (self.volume[:, None, None] * S) @ self.g
        blocks = H.reshape(n, 3, dim, 3, dim)
        for c in range(dim):
            blocks[:, :, c, :, c] += geometric
        return H


def clamp(S: FloatArray) -> FloatArray:
    """Nearest positive semi-definite matrices to symmetric (n, 2, 2) ones, in closed form."""
    mean = 0.5 * (S[:, 0, 0] + S[:, 1, 1])
    spread = np.hypot(0.5 * (S[:, 0, 0] - S[:, 1, 1]), S[:, 0, 1])
    high, low = np.maximum(mean + spread, 0.0), np.maximum(mean - spread, 0.0)
    # S = mean 1 + spread D with D² = 1: clamped S = (high + low)/2 1 + (high - low)/2 D
    factor = np.where(spread > 0, 0.5 * (high - low) / np.where(spread > 0, spread, 1.0), 0.0)
    eye = np.eye(2)
    return factor[:, None, None] * (S - mean[:, None, None] * eye) + (
        0.5 * (high + low)[:, None, None] * eye
    )


def _in_space(*vectors: FloatArray) -> list[FloatArray]:
    return [np.pad(v, ((0, 0), (0, 3 - v.shape[1]))) for v in vectors]
