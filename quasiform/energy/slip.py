"""Rovings that slip: the two layers of the fabric as their mean surface x and their slip d.

The warp layer lies at x + d/2, the weft layer at x - d/2 (two layers of elements with slip between
them, after [1]_). With f_a = (F + ∇d/2) a0 and f_b = (F - ∇d/2) b0, linear in the unknowns,

    E = Σ t0 A [W4(|f_a|²) + W6(f_a·f_b) + W8(|f_b|²)]                  SlippingMembrane, triangles
      + Σ A D(|d - p|)                                                   SlipResistance, nodes
      + Σ A G/2 |∇d|²                                                    SlipWidth, triangles
      + Σ A k_n/2 (n·d)², n = F a0 x F b0                                 Together, triangles

    D(r) = K r²/2 for r ≤ τ/K,  τ r - τ²/(2K) beyond

p is the permanent slip. It turns with the fibres, of which it is kept in components, and moves when
an increment is committed; this dissipates τ |Δp| per area. In space k_n keeps the layers on each
other. G = K w²/4 gives slip the width w of a roving: without it a line that ends at the corner of a
grip slips by an amount that depends on the mesh.

References
----------
.. [1] S. Bel, N. Hamila, P. Boisse, F. Dumont, Composites A 43 (2012) 2269-2277.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ..net.transfer import interpolated
from ..unknowns import Field, FloatArray, Sheet
from .bending import Bending, skew
from .membrane import Membrane, along_fibres, dot
from .term import Quadratic, Standing, Term, frozen, same

TOGETHER = 0.01  # k_n, of the compaction: it parts layers by about 0.1 mm
AT_LIMIT = 1e-6  # of τ/K: how near to it slip counts as sliding
ENDLESS = 1e99  # MPa: the resistance of rovings that only slip elastically


class SlippingMembrane(Membrane):
    """Membrane of two layers with the field of their slip; six numbers a component a triangle."""

    def __init__(self, sheet: Sheet, slip: Field) -> None:
        super().__init__(sheet)
        nodes = sheet.blank.basis.element_dofs.T
        self._places, self._slips = self.dofs, slip.dofs[nodes].reshape(len(nodes), -1)
        self.dofs = np.ascontiguousarray(np.hstack([self._places, self._slips]))
        self.slip = slip
        self.layer, half = self._g, 0.5 * self._g * np.array([1.0, -1.0])[:, None, None]
        self._g = np.ascontiguousarray(np.concatenate([self.layer, half], axis=1))
        self.g = self._g.transpose(2, 0, 1)

    def across(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) E22 of the warp layer and E11 of the weft layer: gaps between rovings where > 0.

        So image correlation sees the strain across the rovings on the two faces.
        """
        F, D = (along_fibres(self.layer, x[dofs.T]) for dofs in (self._places, self._slips))
        a, b = F[1] + 0.5 * D[1], F[0] - 0.5 * D[0]
        return 0.5 * (dot(a, a) - 1.0), 0.5 * (dot(b, b) - 1.0)


@dataclass(frozen=True, eq=False)
class Slipped:
    """What the nodes remember of their slip."""

    parts: FloatArray  # (n, 2) permanent slip in components along warp and weft, mm
    p: FloatArray  # (n, dim) the same as a vector
    normal: FloatArray  # (n, dim) of the sheet; zero in the plane
    lost: FloatArray  # (n,) dissipated so far, mJ


class SlipResistance(Term):
    """Resistance of stitches and crossings to slip, by nodes."""

    def __init__(self, sheet: Sheet, slip: Field) -> None:
        blank, given = sheet.blank, sheet.fabric.slip
        self.name, self.sheet, self.dofs = sheet.named("slip"), sheet, slip.dofs
        self.area, self.places = blank.node_areas, blank.nodes
        self.K, self.tau = given.stiffness, min(given.resistance, ENDLESS)
        nodes, n = blank.basis.element_dofs.T, len(blank.nodes)
        grad = np.stack([phi[0].grad[:, :, 0] for phi in blank.basis.basis])  # (3, 2, m)
        at = np.repeat(nodes, 3, axis=1).ravel(), np.tile(nodes, 3).ravel()
        self._last: tuple[FloatArray, Slipped, tuple[FloatArray, ...]] | None = None
        self._along, self._symmetric = [], np.ones((2, n, sheet.dim))
        for f, along in enumerate((blank.warp, blank.weft)):
            # F a0 times the area, summed over the triangles around a node
            legs = np.tile(np.einsum("icm,c,m->mi", grad, along, blank.areas), 3).ravel()
            self._along.append(csr_array((legs, at), shape=(n, n)))
            for axis in (axis for axis, plane in enumerate("xy") if plane in blank.mirror):
                # on a mirror plane one family lies across it, the other in it
                across = np.arange(sheet.dim) == axis
                own = across if abs(along[axis]) > 0.5 else ~across
                self._symmetric[f, np.abs(blank.nodes[:, axis]) < 1e-9] *= own

    def _fibres(self, x: FloatArray) -> FloatArray:
        """(2, n, dim) unit vectors of warp and weft at the nodes."""
        y = self.sheet.positions(x)
        f = np.stack([along @ y for along in self._along]) * self._symmetric
        return f / np.linalg.norm(f, axis=2)[:, :, None]

    def initial(self, x: FloatArray) -> Slipped:
        """No permanent slip."""
        n, dim = self.dofs.shape
        return self.refresh(x, Slipped(np.zeros((n, 2)), *np.zeros((2, n, dim)), np.zeros(n)))

    def refresh(self, x: FloatArray, state: Slipped) -> Slipped:
        """Turn the permanent slip with the fibres."""
        return self._turned(self._fibres(x), state)

    def _turned(self, fibres: FloatArray, state: Slipped) -> Slipped:
        normal = state.normal
        if self.sheet.dim == 3:
            normal = np.cross(*fibres)
            normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        return replace(state, p=np.einsum("nf,fnc->nc", state.parts, fibres), normal=normal)

    def commit(self, x: FloatArray, state: Slipped) -> Slipped:
        """Make permanent what has slid beyond the elastic limit, and count what that dissipates."""
        d, r, over = self._at(x, state)
        p, fibres = state.p + (over / np.maximum(r, 1e-300))[:, None] * d, self._fibres(x)
        parts = components(p, fibres)
        lost = state.lost + self.area * self.tau * over
        return self._turned(fibres, replace(state, parts=parts, lost=lost))

    def dissipated(self, before: Slipped, after: Slipped, x: FloatArray) -> float:
        return float((after.lost - before.lost).sum())

    def carried(self, state: Slipped | None, old: Standing | None, new: Standing) -> Slipped:
        start = self.initial(new.x)
        if state is None or old is None:
            return start
        theirs = np.column_stack([state.parts, state.lost / old.term.area])
        own = interpolated(old.term.places, theirs, self.places)
        start = replace(start, parts=own[:, :2], lost=own[:, 2] * self.area)
        return self.refresh(new.x, start)

    def along_fibres(self, x: FloatArray) -> FloatArray:
        """(n, 2) how far the warp and the weft rovings have slid along themselves, mm.

        Each relative to the other family, positive in its own direction.
        """
        return components(x[self.dofs], self._fibres(x)) * [1.0, -1.0]

    def _at(self, x: FloatArray, state: Slipped) -> tuple[FloatArray, ...]:
        """Slip d - p in the sheet (n, dim), its length, and what of that exceeds the limit (n,)."""
        if self._last is None or self._last[1] is not state or not same(self._last[0], x):
            d = x[self.dofs] - state.p
            d -= np.vecdot(state.normal, d)[:, None] * state.normal
            r = np.sqrt(np.vecdot(d, d))
            self._last = frozen(x), state, (d, r, np.maximum(r - self.tau / self.K, 0.0))
        return self._last[2]

    def energy(self, x: FloatArray, state: Slipped) -> FloatArray:
        _, r, over = self._at(x, state)
        return self.area * (0.5 * self.K * (r - over) ** 2 + self.tau * over)

    def gradient(self, x: FloatArray, state: Slipped) -> FloatArray:
        d, r, over = self._at(x, state)
        return (self.area * self.K * (r - over) / np.maximum(r, 1e-300))[:, None] * d

    def hessian(self, x: FloatArray, state: Slipped, convex: bool) -> FloatArray:
        """At the limit, where `commit` leaves what slides, that of sliding on."""
        d, r, _ = self._at(x, state)
        t = d / np.maximum(r, 1e-300)[:, None]
        ring = self.tau / np.maximum(np.maximum(r, self.tau / self.K), 1e-300)  # K up to the limit
        nn = state.normal[:, :, None] * state.normal[:, None]
        H = ring[:, None, None] * (np.eye(d.shape[1]) - nn)
        limit = (1.0 - AT_LIMIT) * self.tau / self.K
        H -= np.where(r > limit, ring, 0.0)[:, None, None] * t[:, :, None] * t[:, None]
        return self.area[:, None, None] * H


class SlipWidth(Quadratic):
    """G/2 |∇d|²: neighbouring rovings slip together."""

    def __init__(self, sheet: Sheet, slip: Field) -> None:
        blank, self.sheet, self.name = sheet.blank, sheet, sheet.named("width of slip")
        nodes, G = blank.basis.element_dofs.T, sheet.fabric.slip.coupling
        self.dofs = slip.dofs[nodes].reshape(len(nodes), -1)
        grad = np.stack([phi[0].grad[:, :, 0] for phi in blank.basis.basis])
        L = G * np.einsum("icm,jcm,m->mij", grad, grad, blank.areas)
        H = np.einsum("mij,cd->micjd", L, np.eye(sheet.dim))
        self.H = np.ascontiguousarray(H.reshape(len(nodes), *[self.dofs.shape[1]] * 2))

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return 0.5 * (x[self.dofs] * self.gradient(x)).sum(1)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return np.einsum("mij,mj->mi", self.H, x[self.dofs])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        return self.H.copy()


class Together(Term):
    """k_n/2 (n·d)²: the layers lie on each other. n = F a0 x F b0 turns with the triangle."""

    def __init__(self, membrane: SlippingMembrane) -> None:
        sheet, self.dofs = membrane.sheet, membrane.dofs
        self.name = sheet.named("layers on each other")
        self.g = membrane.layer.transpose(0, 2, 1)  # (2, m, 3)
        both = self.g[0][:, :, None] * self.g[1][:, None]
        self.turn = both - both.transpose(0, 2, 1)
        # ∫ (n·d)² by the values s_i = n·d_i at the corners: A/12 Σ_ij (1 + δ_ij) s_i s_j
        weights = TOGETHER * sheet.fabric.compaction * sheet.blank.areas / 12.0
        self.weights = weights[:, None, None] * (1.0 + np.eye(3))

    def _at(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """F a0, F b0 and n of m triangles, d, s and the derivatives by s at the corners."""
        y, d = np.split(x[self.dofs].reshape(len(self.dofs), 6, 3), 2, axis=1)
        a, b = np.einsum("pmi,mic->pmc", self.g, y)
        n = np.cross(a, b)
        s = np.einsum("mic,mc->mi", d, n)
        return a, b, n, d, s, np.einsum("mij,mj->mi", self.weights, s)

    def _turning(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(m, 3, 9) derivatives of n by the corners."""
        g, h = self.g[:, :, None, :, None]
        return (h * skew(a)[:, :, None] - g * skew(b)[:, :, None]).reshape(len(a), 3, 9)

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        *_, s, c = self._at(x)
        return 0.5 * (s * c).sum(1)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        a, b, n, d, _, c = self._at(x)
        of_x = c[:, None] @ d @ self._turning(a, b)
        return np.hstack([of_x[:, 0], (c[:, :, None] * n[:, None]).reshape(-1, 9)])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` without the second derivatives of s (Gauss-Newton)."""
        a, b, n, d, _, c = self._at(x)
        m, by_x = len(n), self._turning(a, b)
        of_d = (np.eye(3)[:, :, None] * n[:, None, None]).reshape(m, 3, 9)
        J = np.concatenate([d @ by_x, of_d], axis=2)
        H = J.transpose(0, 2, 1) @ self.weights @ J
        if not convex:
            mixed = by_x.transpose(0, 2, 1)[:, :, None] * c[:, None, :, None]
            H[:, :9, 9:] += mixed.reshape(m, 9, 9)
            H[:, 9:, :9] += mixed.reshape(m, 9, 9).transpose(0, 2, 1)
            D = skew((c[:, None] @ d)[:, 0]).transpose(0, 2, 1)
            of_both = self.turn[:, :, None, :, None] * D[:, None, :, None]
            H[:, :9, :9] += of_both.reshape(m, 9, 9)
        return H


class SlipBending(Quadratic):
    """Resistance of the rovings to bending in their plane, which each layer has on its own.

    `Bending` has r B/2 |k|² of the mean surface. With k of x + d/2 for the warp and of x - d/2 for
    the weft it lacks Σ A r B/2 [±k(x)·k(d) + |k(d)|²/4]. The sum of both is semi-definite.
    """

    def __init__(self, bending: Bending, slip: Field) -> None:
        dim, m = bending.sheet.dim, len(bending.dofs)
        self.name = bending.sheet.named("bending of the layers")
        self.dofs = np.hstack([bending.dofs, slip.dofs[bending.nodes].reshape(m, -1)])
        self.K, self.constant = bending.operator[:, : 2 * dim], bending.constant[:, :2]
        self.constant = self.constant.reshape(m, -1)
        self.both = np.repeat(0.5 * bending.in_plane * bending.stiffness * [1.0, -1.0], dim, axis=1)
        self.own = 0.5 * np.abs(self.both)

    def _curvatures(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(m, 2 dim) k of warp and weft lines, of the positions and of the slip."""
        of_x, of_d = (np.einsum("mki,mi->mk", self.K, x[p]) for p in np.split(self.dofs, 2, axis=1))
        return of_x + self.constant, of_d

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        of_x, of_d = self._curvatures(x)
        return (self.both * of_x * of_d + 0.5 * self.own * of_d**2).sum(1)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        of_x, of_d = self._curvatures(x)
        forces = self.both * of_d, self.both * of_x + self.own * of_d
        return np.hstack([np.einsum("mki,mk->mi", self.K, force) for force in forces])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        Kt = self.K.transpose(0, 2, 1)
        both, own = (Kt @ (c[:, :, None] * self.K) for c in (self.both, self.own))
        return np.block([[np.zeros_like(both), both], [both, own]])


def components(v: FloatArray, fibres: FloatArray) -> FloatArray:
    """(n, 2) components of vectors (n, dim) along unit vectors (2, n, dim) in their plane."""
    a, b = fibres
    va, vb, ab = (v * a).sum(1), (v * b).sum(1), (a * b).sum(1)
    return np.stack([va - ab * vb, vb - ab * va], axis=1) / (1.0 - ab**2)[:, None]
