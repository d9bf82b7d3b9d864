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
has no stencil: its curvature is the natural condition zero. Where a slit along a fibre line ends,
the line parts into the two edges of the slit: each has a stencil there, with half of the area.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from skfem import Basis, ElementLineP1

from ..net.blank import Blank
from ..unknowns import FloatArray, IntArray, Sheet
from .term import Term, frozen, same

NEIGHBOURS = 9  # of the fit on any mesh, at most; five are needed


class Bending(Term):
    """Bending of warp and weft lines, five nodes a stencil: (centre, warp -, +, weft -, +).

    Lines that end at a `clamped` (n_nodes,) bool node, or enter a clamped part, keep their flat
    direction there.
    """

    def __init__(self, sheet: Sheet, clamped: np.ndarray | None = None) -> None:
        self.sheet, blank = sheet, sheet.blank
        centre, neighbours, slope, share = _stencils(blank)
        n = len(centre)
        rows = np.zeros((n, 4, 5, 3))  # k_warp, k_weft, u, v as combinations of the five nodes
        constant = np.zeros((n, 4, 3))
        nodes = np.repeat(centre[:, None], 5, axis=1)
        half_lengths = np.zeros((n, 2))
        held = None if clamped is None else clamped[centre]
        for f, family in enumerate(("warp", "weft")):
            beside, grad = neighbours[f], slope[f]
            present = beside >= 0
            slopes, fixed = np.zeros((2, n, 5, 3)), np.zeros((2, n, 3))
            for side, sign in ((0, -1.0), (1, 1.0)):  # of the segments before and after the node
                column = 1 + 2 * f + side
                nodes[:, column] = np.where(present[side], beside[side], centre)
                slopes[side, :, column] = sign * grad[side][:, None]
                slopes[side, :, 0] = -slopes[side, :, column]
            length = np.where(present, 1.0 / np.where(present, grad, 1.0), 0.0)
            rigid = present & False if clamped is None else present & held & clamped[beside]
            rigid &= (present & ~rigid)[::-1]  # one side of the rim of a clamped part
            half_lengths[:, f] = 0.5 * np.where(rigid, 0.0, length).sum(0)
            along = np.append(blank.warp if family == "warp" else blank.weft, 0.0)
            known = present.copy()
            for axis, plane in enumerate("xy"):
                if plane not in blank.mirror or abs(along[axis]) < 1 - 1e-8:
                    continue
                on_plane = np.abs(blank.nodes[centre, axis]) < 1e-9
                # slope of the mirrored segment, walked in the same direction
                mirror = np.where(np.arange(3) == axis, 1.0, -1.0)
                for side in (0, 1):
                    at = on_plane & present[1 - side] & ~present[side]
                    slopes[side, at] = slopes[1 - side, at] * mirror
                    length[side, at] = length[1 - side, at]
                    known[side, at] = True
            if clamped is not None:
                for side in (0, 1):
                    at = held & known[1 - side] & (rigid[side] | ~known[side])
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
        areas = half_lengths[bent].prod(1) * share[bent]
        self._set(nodes[bent], rows[bent], constant[bent], areas)

    def _set(
        self, nodes: IntArray, rows: FloatArray, constant: FloatArray, areas: FloatArray
    ) -> None:
        """Keep stencils of nodes (m, k), and of k_warp, k_weft, u, v as rows (m, 4, k, 3)."""
        (m, k), dim = nodes.shape, self.sheet.dim
        self.constant = np.ascontiguousarray(constant[..., :dim])
        self.rows = np.ascontiguousarray(rows[..., :dim])
        each = self.rows[:, :, None] * np.eye(dim)[None, None, :, None, :]
        self.operator = each.reshape(m, 4 * dim, dim * k)
        # the two of the four rows that take a node, or -1: all do
        taking = (self.rows != 0).any((0, 3)).T
        two = np.argsort(~taking, axis=1, kind="stable")[:, :2]
        self.takers = np.where(taking.sum(1)[:, None] > 2, -1, two)
        sheet, self.nodes, fabric = self.sheet, nodes, self.sheet.fabric
        self.name = sheet.named("bending")
        self.dofs = sheet.dofs[nodes].reshape(m, dim * k)
        self.stiffness = areas[:, None] * [fabric.bending_warp, fabric.bending_weft]
        self.in_plane = float(fabric.in_plane_bending)
        if dim == 2:
            self.stiffness, self.in_plane = self.in_plane * self.stiffness, 1
        self.quadratic = self.in_plane == 1
        self._last: tuple[FloatArray, tuple[FloatArray, ...]] | None = None

    def curvature(self, x: FloatArray) -> FloatArray:
        """(n_stencils, 2) curvatures κ11 of the warp and κ22 of the weft, 1/mm."""
        return self.at(x)[1]

    def _combined(self, x: FloatArray, count: int) -> FloatArray:
        """(n_stencils, count, dim) the first of k_warp, k_weft, u, v."""
        if self.kernels:
            return self.kernels.combine(self.rows, self.constant, self.dofs, x, count)
        dim = self.sheet.dim
        y = (self.operator[:, : count * dim] @ x[self.dofs][:, :, None]).reshape(-1, count, dim)
        return y + self.constant[:, :count]

    def _nodal(self, forces: FloatArray) -> FloatArray:
        """(n_stencils, n_local) forces from those on the first of k_warp, k_weft, u, v."""
        if self.kernels:
            return self.kernels.spread(self.rows, forces)
        forces = forces.reshape(len(forces), 1, -1)
        return (forces @ self.operator[:, : forces.shape[2]])[:, 0]

    def at(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """(n_stencils, 4, 3) k_warp, k_weft, u and v, κ, n and |u x v|; kept for the last x."""
        if self._last is None or not same(self._last[0], x):
            y = self._combined(x, 4)
            frame = self.kernels.bending_curvature if self.kernels else _curvature
            self._last = frozen(x), (y, *frame(y))
        return self._last[1]

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        r = self.in_plane
        if r == 1:
            k = self._combined(x, 2)
            return 0.5 * np.einsum("sf,sfc,sfc->s", self.stiffness, k, k)
        y, kappa, _, _ = self.at(x)
        if self.kernels:
            return self.kernels.bending_energy(y, kappa, self.stiffness, r)
        square = (y[:, :2] ** 2).sum(-1)
        return 0.5 * (self.stiffness * ((1 - r) * kappa**2 + r * square)).sum(1)

    def by_in_plane(self, x: FloatArray) -> float:
        """Derivative of the energy by r, mJ."""
        y, kappa, _, _ = self.at(x)
        return float(0.5 * (self.stiffness * ((y[:, :2] ** 2).sum(-1) - kappa**2)).sum())

    def slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of κ by u x v (n_stencils, 2, 3) and by k_warp, k_weft, u, v (.., 4, 3)."""
        y, kappa, n, length = self.at(x)
        q = (y[:, :2] - kappa[..., None] * n[:, None]) / length[:, None, None]
        d = np.zeros((len(y), 2, 4, 3))
        d[:, 0, 0] = d[:, 1, 1] = n
        d[:, :, 2] = _cross(y[:, None, 3], q)
        d[:, :, 3] = _cross(q, y[:, None, 2])
        return q, d

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        r = self.in_plane
        if r == 1:
            return self._nodal(self.stiffness[..., None] * self._combined(x, 2))
        y, kappa = self.at(x)[:2]
        if self.kernels:
            return self._nodal(self.kernels.bending_forces(*self.at(x), self.stiffness, r))
        force = np.einsum("sf,sfrc->src", (1 - r) * self.stiffness * kappa, self.slopes(x)[1])
        force[:, :2] += r * self.stiffness[..., None] * y[:, :2]
        return self._nodal(force)

    def _compiled(self, x: FloatArray, convex: bool, *where: FloatArray) -> None:
        """Compute stiffnesses, and put them where `compiled.bending_stiffness` does."""
        given = self.stiffness, self.in_plane, convex, self.rows, self.takers
        self.kernels.bending_stiffness(*self.at(x), *given, *where)

    def add_hessian(
        self, values: FloatArray, x: FloatArray, state: None, convex: bool, slots: IntArray
    ) -> None:
        if self.kernels and self.in_plane != 1:
            self._compiled(x, convex, self.kernels.NONE[0], values, slots)
        else:
            super().add_hessian(values, x, state, convex, slots)

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` without the part with the second derivative of κ (Gauss-Newton)."""
        r, dim = self.in_plane, self.sheet.dim
        if r == 1:
            K, each = self.operator[:, : 2 * dim], np.repeat(self.stiffness, dim, axis=1)
            return K.transpose(0, 2, 1) @ (each[..., None] * K)
        if self.kernels:
            H = np.empty((len(self.dofs), *self.dofs.shape[1:] * 2))
            self._compiled(x, convex, H, *self.kernels.NONE[1:])
            return H
        (y, kappa, n, length), (q, d) = self.at(x), self.slopes(x)
        count = len(y)
        weight = (1 - r) * self.stiffness
        flat = d.reshape(count, 2, 12)
        H = flat.transpose(0, 2, 1) @ (weight[..., None] * flat)
        diagonal = np.zeros((count, 12))
        diagonal[:, :6] = np.repeat(r * self.stiffness, 3, axis=1)
        H[:, np.arange(12), np.arange(12)] += diagonal
        if not convex:
            H += second_derivative(weight * kappa, y, kappa, n, length, q)
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


def second_derivative(
    w: FloatArray,
    y: FloatArray,
    kappa: FloatArray,
    n: FloatArray,
    length: FloatArray,
    q: FloatArray,
) -> FloatArray:
    """(m, 12, 12) second derivative of Σ w κ by k_warp, k_weft, u, v, with weights w (m, 2).

    From what `Bending.at` and `Bending.slopes` return.
    """
    u, v, H = y[:, 2], y[:, 3], np.zeros((len(y), 12, 12))
    # derivative of m = u x v: δm = -[v]x δu + [u]x δv, and of κ by it
    M = np.concatenate([-skew(v), skew(u)], axis=2)
    P = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
    for f in (0, 1):
        mixed = w[:, f, None, None] * (P @ M)
        H[:, 3 * f : 3 * f + 3, 6:] = mixed
        H[:, 6:, 3 * f : 3 * f + 3] = mixed.transpose(0, 2, 1)
    Q = np.einsum("sf,sfc->sc", w, q)
    nQ = n[:, :, None] * Q[:, None, :]
    mm = -(nQ + nQ.transpose(0, 2, 1) + (w * kappa).sum(1)[:, None, None] * P)
    H[:, 6:, 6:] = M.transpose(0, 2, 1) @ (mm / length[:, None, None]) @ M
    H[:, 6:9, 9:] -= skew(Q)
    H[:, 9:, 6:9] += skew(Q)
    return H


def _stencils(blank: Blank) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Centres (n,) of stencils and, for warp and weft, the nodes before and after on their lines.

    The latter are (2, 2, n), -1: none, as is 1/l of those segments. The last are shares (n,) of the
    areas: below 1 for a node at the end of a slit, where a line has two segments on one side.
    """
    n, forks = len(blank.nodes), list[tuple]()
    beside, grad = np.full((2, 2, n), -1), np.zeros((2, 2, n))
    for f, family in enumerate(("warp", "weft")):
        line = blank.fibre_lines(family)
        basis = Basis(line, ElementLineP1(), quadrature=(np.array([[0.5]]), np.array([1.0])))
        slope = basis.basis[1][0].grad[0, :, 0]  # of the second node's shape function: 1/l
        first, second = basis.element_dofs
        for side, (at, other) in enumerate(((second, first), (first, second))):
            beside[f, side, at], grad[f, side, at] = other, slope
            more = np.flatnonzero(beside[f, side, at] != other)
            forks += [(f, side, at[k], other[k], slope[k]) for k in more]
    centre = np.array([*range(n), *(fork[2] for fork in forks)])
    beside, grad = beside[..., centre], grad[..., centre]
    for k, (f, side, _, other, slope) in enumerate(forks, n):
        beside[f, side, k], grad[f, side, k] = other, slope
    return centre, beside, grad, 1.0 / np.bincount(centre)[centre]


def _curvature(y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvatures (m, 2), normals (m, 3) and |u x v| (m,) from k_warp, k_weft, u, v (m, 4, 3)."""
    normal = _cross(y[:, 2], y[:, 3])
    length = np.sqrt((normal**2).sum(1))
    normal /= length[:, None]
    return (y[:, :2] * normal[:, None]).sum(2), normal, length


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(..., 3) products of vectors; np.cross takes longer to begin than to multiply."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def skew(w: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices [w]x with [w]x a = w x a."""
    S = np.zeros((len(w), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    return S - S.transpose(0, 2, 1)
