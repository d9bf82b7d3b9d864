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
What a state was evaluated for is kept for the last two: where an iteration is, and where it tries.
"""

from __future__ import annotations

from dataclasses import astuple
from functools import cache

import numpy as np

from ..fabric import TabulatedLaw, ThreeStageLaw, shear_angle
from ..unknowns import FloatArray, IntArray, Sheet
from .term import Term, frozen, same


class Membrane(Term):
    """Tension of both fibre families and shear of a sheet, in the plane (d = 2) or in space."""

    foresees = True

    def __init__(self, sheet: Sheet) -> None:
        blank, self.sheet, self.fabric = sheet.blank, sheet, sheet.fabric
        self.name = sheet.named("membrane")
        nodes = blank.basis.element_dofs
        self.dofs = np.ascontiguousarray(sheet.dofs[nodes.T].reshape(nodes.shape[1], -1))
        grad = np.stack([phi[0].grad[:, :, 0] for phi in blank.basis.basis])  # (3, 2, n)
        # derivatives of the three shape functions along warp and weft, (n_triangles, 2, 3)
        g = np.einsum("fc,icn->fin", np.stack([blank.warp, blank.weft]), grad)
        self._g = np.ascontiguousarray(g)
        self.g = self._g.transpose(2, 0, 1)
        self.volume = sheet.fabric.thickness * blank.areas
        self._last: list[tuple[FloatArray, tuple[FloatArray, ...]]] = []

    def _at(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """What `_evaluate` returns, kept for the last two x."""
        for i, (known, found) in enumerate(self._last):
            if same(known, x):
                if i:
                    self._last.reverse()
                return found
        self._last = [(frozen(x), self._evaluate(x)), *self._last[:1]]
        return self._last[0][1]

    def _evaluate(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """Fibre vectors (2, dim, n), I4, I6, I8, W (n,), S (2, 2, n) and W4'', W6'', W8''."""
        f, fabric = self._fibre_vectors(x), self.fabric
        if self.kernels:
            I4, I6, I8 = self.kernels.invariants(f)
        else:
            I4, I6, I8 = dot(f[0], f[0]), dot(f[0], f[1]), dot(f[1], f[1])
        W4, S4, C4 = self._response(fabric.warp, I4, 1.0)
        W6, S6, C6 = self._response(fabric.shear, I6, 0.0)
        W8, S8, C8 = self._response(fabric.weft, I8, 1.0)
        S = np.array([[2.0 * S4, S6], [S6, 2.0 * S8]])
        return f, I4, I6, I8, W4 + W8 + W6, S, np.array([C4, C6, C8])

    def _response(
        self, law: ThreeStageLaw | TabulatedLaw, I: FloatArray, I0: float
    ) -> tuple[FloatArray, ...]:
        """W, dW/dI and d²W/dI² (n,) of a law, MPa."""
        if self.kernels and isinstance(law, ThreeStageLaw):
            return self.kernels.three_stages(I, I0, *_stages(law))
        return law.energy(I, I0), law.stress(I, I0), law.stiffness(I, I0)

    def _fibre_vectors(self, x: FloatArray) -> FloatArray:
        """(2, dim, n_triangles) fibre vectors, also of a motion."""
        if self.kernels:
            return self.kernels.fibre_vectors(self._g, self.dofs, x)
        return along_fibres(self._g, x[self.dofs.T])

    def _forces(self, g: FloatArray, S: FloatArray, f: FloatArray) -> FloatArray:
        """(n, k dim) nodal forces, see `nodal_forces`."""
        return (self.kernels.nodal_forces if self.kernels else nodal_forces)(g, S, f)

    def _stiffness(self, g: FloatArray, f: FloatArray, S: FloatArray, W: FloatArray) -> FloatArray:
        """(n, k dim, k dim) nodal stiffness, see `second_derivative`."""
        if not self.kernels:
            return nodal_stiffness(g, second_derivative(f, S, *W))
        H = np.empty((g.shape[2], *[g.shape[1] * f.shape[1]] * 2))
        self.kernels.membrane_stiffness(g, f, S, W, H, *self.kernels.NONE[1:])
        return H

    def add_hessian(
        self,
        values: FloatArray,
        x: FloatArray,
        state: None,
        convex: bool,
        slots: IntArray,
        stress: FloatArray | None = None,
    ) -> None:
        if self.kernels and self.sheet.blank.pairs is None:
            given = self._stress_and_stiffness(x, convex, stress)
            none = self.kernels.NONE[0]
            self.kernels.membrane_stiffness(self._g, *given, none, values, slots)
        else:
            super().add_hessian(values, x, state, convex, slots, stress=stress)

    def fibres(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, dim) deformed fibre vectors F a0 and F b0."""
        return self._at(x)[0].transpose(2, 0, 1)

    def invariants(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """I4, I6, I8 of each triangle."""
        return self._at(x)[1:4]

    def shear_angle(self, x: FloatArray) -> FloatArray:
        """(n_triangles,) signed shear angle, radians."""
        return shear_angle(*self.invariants(x))

    def largest_shear_angle(self, x: FloatArray) -> float:
        """Largest |γ|, degrees."""
        return float(np.degrees(np.abs(self.shear_angle(x)).max()))

    def normals(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 1 or 3) normal times area ratio; in the plane the determinant of F."""
        return cross(*self._at(x)[0]).T

    def turned_over(self, x: FloatArray, trial: FloatArray) -> bool:
        """Whether a triangle is turned over between two states."""
        if self.kernels and self.sheet.blank.pairs is None:
            return self.kernels.turned_over(self._at(x)[0], self._at(trial)[0])
        return bool(((self.normals(x) * self.normals(trial)).sum(1) <= 0).any())

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return self.volume * self._at(x)[4]

    def stress(self, x: FloatArray) -> FloatArray:
        """(n_triangles, 2, 2) second Piola-Kirchhoff stress in fibre axes, MPa."""
        return self._at(x)[5].transpose(2, 0, 1)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        f, *_, S, _ = self._at(x)
        return self._forces(self._g, self.volume * S, f)

    def foreseen_stress(self, x: FloatArray, dx: FloatArray) -> FloatArray:
        """(2, 2, n_triangles) stress that the linearisation at x foresees after a step, MPa."""
        f, *_, S, (W4, W6, W8) = self._at(x)
        df, S = self._fibre_vectors(dx), S.copy()
        S[0, 0] += 4.0 * W4 * dot(f[0], df[0])
        S[1, 1] += 4.0 * W8 * dot(f[1], df[1])
        S[0, 1] += W6 * (dot(f[0], df[1]) + dot(f[1], df[0]))
        S[1, 0] = S[0, 1]
        return S

    def hessian(
        self, x: FloatArray, state: None, convex: bool, stress: FloatArray | None = None
    ) -> FloatArray:
        return self._stiffness(self._g, *self._stress_and_stiffness(x, convex, stress))

    def _stress_and_stiffness(
        self, x: FloatArray, convex: bool, stress: FloatArray | None
    ) -> tuple[FloatArray, ...]:
        """Fibre vectors; S (2, 2, n) and W4'', W6'', W8'' (3, n), times the volume."""
        f, *_, S, W = self._at(x)
        S = S if stress is None else stress
        return f, self.volume * (clamp(S) if convex else S), self.volume * W


class PairedMembrane(Membrane):
    """Tension and shear on a mesh that does not follow the fibres: strains shared by pairs.

    A P1 triangle with no leg on a fibre locks: each has two nearly inextensible fibre directions,
    and there are twice as many triangles as nodes. In pairs that share their fibre strains there is
    one constraint for each degree of freedom, as in the fabric's own net. With the triangles'
    volumes V_t and the mean fibre vectors of a pair, f = Σ V_t F_t a0 / V,

        E = V [W4(|f_a|²) + W8(|f_b|²)] + Σ V_t W6((F_t a0)·(F_t b0)),

    so shear is still seen by every triangle. Six nodes a stencil (three twice if alone).
    """

    def __init__(self, sheet: Sheet) -> None:
        super().__init__(sheet)
        pairs = sheet.blank.pairs
        self.pairs = pairs
        self.dofs = np.hstack([self.dofs[pairs[:, t]] for t in (0, 1)])
        alone = pairs[:, 0] == pairs[:, 1]
        self.parts = np.where(alone, 0.5, 1.0) * self.volume[pairs].T  # V_t, (2, n_pairs)
        self.whole = self.parts.sum(0)
        # fibre derivatives of each triangle by its three nodes, and their mean by all six
        self.g_each = [np.ascontiguousarray(self._g[:, :, pairs[:, t]]) for t in (0, 1)]
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
        forces = self._forces(self.g_mean, self.whole * tension, f)
        own = [self._forces(self.g_each[t], self.parts[t] * shear[t], each[t]) for t in (0, 1)]
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
        V = self.whole
        H = self._stiffness(self.g_mean, f, V * tension, V * np.stack([W4, none, W8]))
        for t, own in enumerate(np.split(np.arange(H.shape[1]), 2)):
            given = self.parts[t] * shear[t], np.stack([none, W6[t], none])
            H[:, own[:, None], own] += self._stiffness(self.g_each[t], each[t], *given)
        return H


def membrane_of(sheet: Sheet) -> Membrane:
    """Return the membrane energy that fits the mesh of a sheet."""
    return (Membrane if sheet.blank.pairs is None else PairedMembrane)(sheet)


@cache
def _stages(law: ThreeStageLaw) -> tuple[float, ...]:
    """Numbers of a law; infinite those that a linear one has not."""
    return tuple(np.inf if value is None else float(value) for value in astuple(law))


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) products of vectors (dim, n)."""
    return (a * b).sum(0)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(1 or 3, n) products of vectors (dim, n) in the plane or in space."""
    if len(a) == 3:
        (a0, a1, a2), (b0, b1, b2) = a, b
        return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
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
