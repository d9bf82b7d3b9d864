"""Bending energy of the fibre lines: E = Σ A/2 (B11 κ11² + B22 κ22²), decoupled from the membrane.

At a node with neighbours - and + on a fibre line the position has the second difference

    k = [(x₊ - x)/l₊ - (x - x₋)/l₋] / h,   h = (l₋ + l₊)/2,

and κ = n·k with the unit normal n = (u x v)/|u x v| of the line tangents u (warp) and v (weft).
The derivatives are by the reference arc lengths, so κ follows the fibres at any shear, without
rotation degrees of freedom, Poisson's effect or twist. The in-plane part of k is resisted with the
fraction r of the stiffness: B/2 [(1 - r)(n·k)² + r |k|²]. It is an exact potential: n is a function
of the same five nodes and is differentiated with the rest. With r = 1 it is quadratic, and no
normal is needed; so it is in a sheet that is held flat, where r B/2 |k|² is all of it.

A clamp or a mirror plane supplies the missing neighbour and counts for the half of the stencil's
area that lies in the model: k = 2 (x₁ - x₀ - l t)/l² at a clamp with the direction t. A free end
has no stencil: its curvature is the natural condition zero.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from skfem import Basis, ElementLineP1

from ..net.blank import Blank
from ..unknowns import FloatArray, IntArray, Sheet
from .term import Term

NEIGHBOURS = 9  # of the fit on any mesh, at most; five are needed


class Bending(Term):
    """Bending of warp and weft lines, five nodes a stencil: (centre, warp -, +, weft -, +).

    Lines that end at a `clamped` (n_nodes,) bool node keep their flat direction.
    """

    def __init__(self, sheet: Sheet, clamped: np.ndarray | None = None) -> None:
        self.sheet, blank = sheet, sheet.blank
        n = len(blank.nodes)
        rows = np.zeros((n, 4, 5, 3))  # k_warp, k_weft, u, v as combinations of the five nodes
        constant = np.zeros((n, 4, 3))
        nodes = np.repeat(np.arange(n)[:, None], 5, axis=1)
        half_lengths = np.zeros((n, 2))
        for f, family in enumerate(("warp", "weft")):
            beside, grad = _neighbours(blank, family)
            present = beside >= 0
            slopes, fixed = np.zeros((2, n, 5, 3)), np.zeros((2, n, 3))
            for side, sign in ((0, -1.0), (1, 1.0)):  # of the segments before and after the node
                column = 1 + 2 * f + side
                nodes[:, column] = np.where(present[side], beside[side], np.arange(n))
                slopes[side, :, column] = sign * grad[side][:, None]
                slopes[side, :, 0] = -slopes[side, :, column]
            length = np.where(present, 1.0 / np.where(present, grad, 1.0), 0.0)
            half_lengths[:, f] = 0.5 * length.sum(0)
            along = np.append(blank.warp if family == "warp" else blank.weft, 0.0)
            known = present.copy()
            for axis, plane in enumerate("xy"):
                if plane not in blank.mirror or abs(along[axis]) < 1 - 1e-8:
                    continue
                on_plane = np.abs(blank.nodes[:, axis]) < 1e-9
                # slope of the mirrored segment, walked in the same direction
                mirror = np.where(np.arange(3) == axis, 1.0, -1.0)
                for side in (0, 1):
                    at = on_plane & present[1 - side] & ~present[side]
                    slopes[side, at] = slopes[1 - side, at] * mirror
                    length[side, at] = length[1 - side, at]
                    known[side, at] = True
            if clamped is not None:
                for side in (0, 1):
                    at = clamped & known[1 - side] & ~known[side]
                    slopes[side, at] = 0.0
                    fixed[side, at] = along
                    length[side, at] = 0.0  # the slopes are half a segment apart
                    known[side, at] = True
            both = known.all(0)
            h = np.where(both, 0.5 * length.sum(0), 1.0)
            rows[both, f] = ((slopes[1] - slopes[0]) / h[:, None, None])[both]
            constant[both, f] = ((fixed[1] - fixed[0]) / h[:, None])[both]
            count = np.maximum(known.sum(0), 1)
            rows[:, 2 + f] = (slopes * known[:, :, None, None]).sum(0) / count[:, None, None]
            constant[:, 2 + f] = fixed.sum(0) / count[:, None]
        bent = (np.abs(rows[:, :2]).sum((1, 2, 3)) > 0) & half_lengths.all(1)
        areas = half_lengths[bent].prod(1)
        self._set(nodes[bent], rows[bent], constant[bent], areas)

    def _set(
        self, nodes: IntArray, rows: FloatArray, constant: FloatArray, areas: FloatArray
    ) -> None:
        """Keep stencils of nodes (m, k), and of k_warp, k_weft, u, v as rows (m, 4, k, 3)."""
        (m, k), dim = nodes.shape, self.sheet.dim
        self.constant, rows = constant[..., :dim], rows[..., :dim]
        each = rows[:, :, None] * np.eye(dim)[None, None, :, None, :]
        self.operator = each.reshape(m, 4 * dim, dim * k)
        sheet, self.nodes, fabric = self.sheet, nodes, self.sheet.fabric
        self.name = sheet.named("bending")
        self.dofs = sheet.dofs[nodes].reshape(m, dim * k)
        self.stiffness = areas[:, None] * [fabric.bending_warp, fabric.bending_weft]
        self.in_plane = fabric.in_plane_bending
        if dim == 2:
            self.stiffness, self.in_plane = self.in_plane * self.stiffness, 1
        self.quadratic = self.in_plane == 1

    def curvature(self, x: FloatArray) -> FloatArray:
        """(n_stencils, 2) curvatures κ11 of the warp and κ22 of the weft, 1/mm."""
        k, _, _, n, _ = self._frame(x)
        return np.einsum("sfc,sc->sf", k, n)

    @property
    def _to_k(self) -> FloatArray:
        """(n_stencils, 2 dim, n_local) k of warp and weft from the local unknowns."""
        return self.operator[:, : 2 * self.sheet.dim]

    def _second_differences(self, x: FloatArray) -> FloatArray:
        """(n_stencils, 2, dim) k of warp and weft."""
        k = (self._to_k @ x[self.dofs][:, :, None]).reshape(-1, 2, self.sheet.dim)
        return k + self.constant[:, :2]

    def _frame(self, x: FloatArray) -> tuple[FloatArray, ...]:
        y = (self.operator @ x[self.dofs][:, :, None])[:, :, 0].reshape(-1, 4, 3) + self.constant
        k, u, v = y[:, :2], y[:, 2], y[:, 3]
        m = np.cross(u, v)
        length = np.linalg.norm(m, axis=1)
        return k, u, v, m / length[:, None], length

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        r = self.in_plane
        if r == 1:
            k = self._second_differences(x)
            return 0.5 * np.einsum("sf,sfc,sfc->s", self.stiffness, k, k)
        k, _, _, n, _ = self._frame(x)
        kappa = np.einsum("sfc,sc->sf", k, n)
        return 0.5 * (self.stiffness * ((1 - r) * kappa**2 + r * (k**2).sum(-1))).sum(1)

    def by_in_plane(self, x: FloatArray) -> float:
        """Derivative of the energy by r, mJ."""
        k, _, _, n, _ = self._frame(x)
        in_plane = (k**2).sum(-1) - np.einsum("sfc,sc->sf", k, n) ** 2
        return float(0.5 * (self.stiffness * in_plane).sum())

    def _first_derivative(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """κ, its gradient by (k_warp, k_weft, u, v) and what the second derivative needs."""
        k, u, v, n, length = self._frame(x)
        kappa = np.einsum("sfc,sc->sf", k, n)
        q = (k - kappa[..., None] * n[:, None]) / length[:, None, None]  # derivative by u x v
        d = np.zeros((len(k), 2, 4, 3))
        d[:, 0, 0] = d[:, 1, 1] = n
        d[:, :, 2] = np.cross(v[:, None], q)
        d[:, :, 3] = np.cross(q, u[:, None])
        return k, u, v, n, length, kappa, q, d

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        r = self.in_plane
        if r == 1:
            force = self.stiffness[..., None] * self._second_differences(x)
            return (force.reshape(len(force), 1, -1) @ self._to_k)[:, 0]
        k, *_, kappa, _, d = self._first_derivative(x)
        force = np.einsum("sf,sfrc->src", (1 - r) * self.stiffness * kappa, d)
        force[:, :2] += r * self.stiffness[..., None] * k
        return (force.reshape(-1, 1, 12) @ self.operator)[:, 0]

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` without the part with the second derivative of κ (Gauss-Newton)."""
        r = self.in_plane
        if r == 1:
            K, each = self._to_k, np.repeat(self.stiffness, self.sheet.dim, axis=1)
            return K.transpose(0, 2, 1) @ (each[..., None] * K)
        _, u, v, n, length, kappa, q, d = self._first_derivative(x)
        count = len(u)
        weight = (1 - r) * self.stiffness
        flat = d.reshape(count, 2, 12)
        H = flat.transpose(0, 2, 1) @ (weight[..., None] * flat)
        diagonal = np.zeros((count, 12))
        diagonal[:, :6] = np.repeat(r * self.stiffness, 3, axis=1)
        H[:, np.arange(12), np.arange(12)] += diagonal
        if not convex:
            # derivative of m = u x v: δm = -[v]x δu + [u]x δv
            M = np.concatenate([-_skew(v), _skew(u)], axis=2)
            P = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
            w = weight * kappa
            for f in (0, 1):
                mixed = w[:, f, None, None] * (P @ M)
                H[:, 3 * f : 3 * f + 3, 6:] += mixed
                H[:, 6:, 3 * f : 3 * f + 3] += mixed.transpose(0, 2, 1)
            Q = np.einsum("sf,sfc->sc", w, q)  # Σ w q
            nQ = n[:, :, None] * Q[:, None, :]
            mm = -(nQ + nQ.transpose(0, 2, 1) + (w * kappa).sum(1)[:, None, None] * P)
            H[:, 6:, 6:] += M.transpose(0, 2, 1) @ (mm / length[:, None, None]) @ M
            H[:, 6:9, 9:] -= _skew(Q)
            H[:, 9:, 6:9] += _skew(Q)
        return self.operator.transpose(0, 2, 1) @ H @ self.operator


class PatchBending(Bending):
    """Bending without fibre lines: curvatures from a quadratic fit around each node of any mesh.

    The position near a node, as a function of the flat coordinates a along the warp and b along the
    weft, is fitted to the neighbours by weighted least squares,

        x ≈ x_0 + u a + v b + k_warp a²/2 + k_ab a b + k_weft b²/2,

    which is exact for quadratic forms on any mesh; twist k_ab costs nothing there either.
    """

    def __init__(self, sheet: Sheet) -> None:
        self.sheet, blank = sheet, sheet.blank
        n, edges = len(blank.nodes), blank.mesh.facets
        ones = np.ones(2 * edges.shape[1])
        ring = csr_array((ones, (np.r_[edges[0], edges[1]], np.r_[edges[1], edges[0]])), (n, n))
        second = (ring @ ring + ring).tocsr()
        nodes = np.repeat(np.arange(n)[:, None], NEIGHBOURS + 1, axis=1)
        rows = np.zeros((n, 4, NEIGHBOURS + 1, 3))
        fibre = blank.nodes @ np.column_stack([blank.warp, blank.weft])
        for i in range(n):
            near = ring.indices[ring.indptr[i] : ring.indptr[i + 1]]
            if len(near) < 6:  # at the rim, and where few triangles meet
                near = second.indices[second.indptr[i] : second.indptr[i + 1]]
                near = near[near != i]
            arm = fibre[near] - fibre[i]
            far = np.linalg.norm(arm, axis=1)
            order = np.argsort(far, kind="stable")[:NEIGHBOURS]
            near, (a, b), weight = near[order], arm[order].T, 1.0 / far[order]
            form = np.column_stack([a, b, 0.5 * a**2, a * b, 0.5 * b**2])
            fit = np.linalg.pinv(weight[:, None] * form) * weight
            nodes[i, 1 : 1 + len(near)] = near
            for row, term in enumerate((2, 4, 0, 1)):
                rows[i, row, 1 : 1 + len(near)] = fit[term, :, None]
                rows[i, row, 0] = -fit[term].sum()
        self._set(nodes, rows, np.zeros((n, 4, 3)), blank.node_areas)


def _neighbours(blank: Blank, family: str) -> tuple[IntArray, FloatArray]:
    """(2, n) nodes before and after each on its fibre line (-1: none), 1/l of those segments."""
    line = blank.fibre_lines(family)
    basis = Basis(line, ElementLineP1(), quadrature=(np.array([[0.5]]), np.array([1.0])))
    slope = basis.basis[1][0].grad[0, :, 0]  # of the second node's shape function: 1/l
    first, second = basis.element_dofs
    beside, grad = np.full((2, len(blank.nodes)), -1), np.zeros((2, len(blank.nodes)))
    beside[0, second], beside[1, first] = first, second
    grad[0, second], grad[1, first] = slope, slope
    return beside, grad


def _skew(w: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices [w]x with [w]x a = w x a."""
    S = np.zeros((len(w), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    return S - S.transpose(0, 2, 1)
