"""Membrane energy: E = Σ t0 A [W4(I4) + W6(I6) + W8(I8)] over the triangles (Schäfer, Eqs. 7-9).

One quadrature point in each P1 triangle. The fibre vectors f_a = F a0 and f_b = F b0 are linear in
the positions, f_p = Σ_i g_pi x_i, and with S = [[2 W4', W6'], [W6', 2 W8']] (second Piola-Kirchhoff
stress) the derivatives by them are

    ∂W/∂f_p = Σ_q S_pq f_q
    ∂²W/∂f_a∂f_a = 4 W4'' f_a f_a' + W6'' f_b f_b' + S_aa 1
    ∂²W/∂f_a∂f_b = W6'' f_b f_a' + S_ab 1                               (and with a and b swapped).

The only indefinite part is S ⊗ 1. The convex variant clamps the eigenvalues of S at zero, which is
a closed form for a 2 x 2 matrix.

Inside, the triangles are the last axis, so that a product of two components is one of long vectors.
"""

from __future__ import annotations

import numpy as np

from ..fabric import shear_angle
from ..unknowns import FloatArray, Sheet
from .term import Term


class Membrane(Term):
    """Tension of both fibre families and shear of a sheet, in the plane (d = 2) or in space."""

    foresees = True

    def __init__(self, sheet: Sheet) -> None:
        blank, self.sheet, self.fabric = sheet.blank, sheet, sheet.fabric
        self.name = sheet.named("membrane")
        nodes = blank.basis.element_dofs
        self.dofs = sheet.dofs.T[:, nodes].swapaxes(0, 1).reshape(-1, nodes.shape[1]).T
        grad = np.stack([phi[0].grad[:, :, 0] for phi in blank.basis.basis])  # (3, 2, n)
        # derivatives of the three shape functions along warp and weft, (n_triangles, 2, 3)
        self._g = np.einsum("fc,icn->fin", np.stack([blank.warp, blank.weft]), grad)
        self.g = self._g.transpose(2, 0, 1)
        self.volume = sheet.fabric.thickness * blank.areas
        self._last: tuple[FloatArray, tuple[FloatArray, ...]] | None = None

    def _at(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """What `_evaluate` returns, kept for the last x."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x.copy(), self._evaluate(x)
        return self._last[1]

    def _evaluate(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """Fibre vectors (2, dim, n_triangles) and I4, I6, I8."""
        f = along_fibres(self._g, x[self.dofs.T])
        return f, dot(f[0], f[0]), dot(f[0], f[1]), dot(f[1], f[1])

    def fibres(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, dim) deformed fibre vectors F a0 and F b0."""
        return self._at(x)[0].transpose(2, 0, 1)

    def invariants(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """I4, I6, I8 of each triangle."""
        return self._at(x)[1:]

    def shear_angle(self, x: FloatArray) -> FloatArray:
        """(n_triangles,) signed shear angle, radians."""
        return shear_angle(*self.invariants(x))

    def largest_shear_angle(self, x: FloatArray) -> float:
        """Largest |γ|, degrees."""
        return float(np.degrees(np.abs(self.shear_angle(x)).max()))

    def normals(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 1 or 3) normal times area ratio; in the plane the determinant of F."""
        return cross(*self._at(x)[0]).T

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        _, I4, I6, I8 = self._at(x)
        fabric = self.fabric
        W = fabric.warp.energy(I4, 1.0) + fabric.weft.energy(I8, 1.0) + fabric.shear.energy(I6)
        return self.volume * W

    def stress(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, 2) second Piola-Kirchhoff stress in fibre axes, MPa."""
        return self._stress(x).transpose(2, 0, 1)

    def _stress(self, x: FloatArray) -> FloatArray:
        I4, I6, I8 = self.invariants(x)
        S = np.empty((2, 2, len(I4)))
        S[0, 0] = 2.0 * self.fabric.warp.stress(I4, 1.0)
        S[0, 1] = S[1, 0] = self.fabric.shear.stress(I6)
        S[1, 1] = 2.0 * self.fabric.weft.stress(I8, 1.0)
        return S

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        S = self.volume * self._stress(x)
        return nodal_forces(self._g, S, self._at(x)[0])

    def foreseen_stress(self, x: FloatArray, dx: FloatArray) -> FloatArray:
        """(2, 2, n_triangles) stress that the linearisation at x foresees after a step, MPa."""
        f, I4, I6, I8 = self._at(x)
        df = along_fibres(self.g.transpose(1, 2, 0), dx[self.dofs.T])
        S, fabric = self._stress(x), self.fabric
        S[0, 0] += 4.0 * fabric.warp.stiffness(I4, 1.0) * dot(f[0], df[0])
        S[1, 1] += 4.0 * fabric.weft.stiffness(I8, 1.0) * dot(f[1], df[1])
        S[0, 1] += fabric.shear.stiffness(I6) * (dot(f[0], df[1]) + dot(f[1], df[0]))
        S[1, 0] = S[0, 1]
        return S

    def hessian(
        self, x: FloatArray, state: None, convex: bool, stress: FloatArray | None = None
    ) -> FloatArray:
        f, I4, I6, I8 = self._at(x)
        fabric, S = self.fabric, self._stress(x) if stress is None else stress
        W4, W8 = fabric.warp.stiffness(I4, 1.0), fabric.weft.stiffness(I8, 1.0)
        W2 = self.volume * np.stack([W4, fabric.shear.stiffness(I6), W8])
        K = second_derivative(f, self.volume * (clamp(S) if convex else S), *W2)
        return nodal_stiffness(self._g, K)


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) products of vectors (dim, n)."""
    return (a * b).sum(0)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(1 or 3, n) products of vectors (dim, n) in the plane or in space."""
    if len(a) == 3:
        return np.cross(a, b, axis=0)
    return a[:1] * b[1:] - a[1:] * b[:1]


def along_fibres(g: FloatArray, x: FloatArray) -> FloatArray:
    """(2, dim, n) vectors f_p = Σ_i g_pi x_i from g (2, k, n) and x (k dim, n)."""
    x = x.reshape(g.shape[1], -1, g.shape[2])
    return sum(g[:, i, None] * x[i] for i in range(len(x)))


def nodal_forces(g: FloatArray, S: FloatArray, f: FloatArray) -> FloatArray:
    """(n, k dim) forces Σ_pq g_pi S_pq f_q from stresses (2, 2, n) and fibre vectors."""
    P = S[:, 0, None] * f[0] + S[:, 1, None] * f[1]
    forces = g[0][:, None] * P[0] + g[1][:, None] * P[1]
    return forces.reshape(-1, forces.shape[-1]).T


def second_derivative(
    f: FloatArray, S: FloatArray, W4: FloatArray, W6: FloatArray, W8: FloatArray
) -> FloatArray:
    """(2, 2, dim, dim, n) second derivatives by the fibre vectors f (2, dim, n).

    From the stress S (2, 2, n) and the stiffnesses W4'', W6'', W8'' (n,), times the volume.
    """
    dim = f.shape[1]
    a, b = f
    aa, bb = a[:, None] * a, b[:, None] * b
    K = np.empty((2, 2, dim, dim, f.shape[2]))
    K[0, 0] = 4 * W4 * aa + W6 * bb
    K[1, 1] = 4 * W8 * bb + W6 * aa
    K[0, 1] = W6 * b[:, None] * a
    K[1, 0] = K[0, 1].swapaxes(0, 1)
    for c in range(dim):
        K[:, :, c, c] += S
    return K


def nodal_stiffness(g: FloatArray, K: FloatArray) -> FloatArray:
    """(n, k dim, k dim) stiffness Σ_pq g_pi K_pq g_qj, of which the upper half is computed."""
    _, k, n = g.shape
    dim = K.shape[2]
    H = np.empty((k, dim, k, dim, n))
    for j in range(k):
        Kg = K[:, 0] * g[0, j] + K[:, 1] * g[1, j]
        for i in range(j + 1):
            H[i, :, j] = g[0, i] * Kg[0] + g[1, i] * Kg[1]
            H[j, :, i] = H[i, :, j].swapaxes(0, 1)
    return H.reshape(k * dim, k * dim, n).transpose(2, 0, 1)


def clamp(S: FloatArray) -> FloatArray:
    """Nearest positive semi-definite matrices to symmetric (2, 2, n) ones, in closed form."""
    mean = 0.5 * (S[0, 0] + S[1, 1])
    spread = np.hypot(0.5 * (S[0, 0] - S[1, 1]), S[0, 1])
    high, low = np.maximum(mean + spread, 0.0), np.maximum(mean - spread, 0.0)
    # S = mean 1 + spread D with D² = 1: clamped S = (high + low)/2 1 + (high - low)/2 D
    factor = np.where(spread > 0, 0.5 * (high - low) / np.where(spread > 0, spread, 1.0), 0.0)
    eye = np.eye(2)[:, :, None]
    return factor * (S - mean * eye) + 0.5 * (high + low) * eye
