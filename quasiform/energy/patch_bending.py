"""Bending on a mesh without fibre lines: curvatures from a quadratic fit around each node.

The position near a node, as a function of the flat coordinates a along the warp and b along the
weft, is fitted to the neighbours by weighted least squares,

    x ≈ x_0 + u a + v b + k_warp a²/2 + k_ab a b + k_weft b²/2,

which is exact for quadratic forms on any mesh. Energy, normal and derivatives are those of the
fibre lines (`bending`); twist k_ab costs nothing there either.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from ..unknowns import Sheet
from .bending import Bending

NEIGHBOURS = 9  # at most; five are needed


class PatchBending(Bending):
    """Bending of warp and weft at every node of a sheet in space, on any mesh."""

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
