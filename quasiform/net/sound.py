"""Checks of a user's own flat mesh: every place of the blank lies in one element, in one piece."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..checks import InputError
from ..tools.mending import MERGED, edges_of, position
from .blank import Blank

FloatArray = np.ndarray
IntArray = np.ndarray


def check_elements(nodes: FloatArray, corners: IntArray, labels: IntArray) -> None:
    """Refuse elements without area, crossed or concave quadrilaterals, and elements there twice.

    Of elements on nodes (n, 2), the corners (m, 4) are -1 beyond the last one.
    """
    order = np.sort(corners, axis=1)
    _, first, index = np.unique(order, axis=0, return_index=True, return_inverse=True)
    twice = first[index.reshape(-1)] != np.arange(len(corners))
    flat, crossed = np.zeros(len(corners), dtype=bool), np.zeros(len(corners), dtype=bool)
    count = (corners >= 0).sum(1)
    for n in (3, 4):
        ring = nodes[corners[count == n, :n]]
        out, into = np.roll(ring, -1, axis=1) - ring, ring - np.roll(ring, 1, axis=1)
        turn = into[..., 0] * out[..., 1] - into[..., 1] * out[..., 0]
        least = 1e-6 * (out**2).sum((1, 2))
        flat[count == n] = np.abs(turn).max(1, initial=0.0) <= least
        crossed[count == n] = (turn * np.sign(turn.sum(1))[:, None] <= least[:, None]).any(1)
    for wrong, what in (
        (twice, "is there twice"),
        (flat, "has no area"),
        (crossed, "is crossed or concave: split it, or put its nodes in the order around it"),
    ):
        if wrong.any():
            k = int(wrong.argmax())
            middle = position(nodes[corners[k][corners[k] >= 0]].mean(0))
            what += f", also as element {labels[first[index.reshape(-1)[k]]]}" * bool(twice[k])
            raise InputError(f"element {labels[k]} near {middle} mm {what}")


def check_one_piece(blank: Blank) -> None:
    """Refuse elements that overlap, nodes on the sides of elements, and several pieces."""
    import shapely

    edges, shared, turns = edges_of(blank.triangles)
    wrong = (shared > 2) | ((shared == 2) & (turns != 0))
    if wrong.any():
        at = position(blank.nodes[edges[wrong][0]].mean(0))
        raise InputError(f"elements overlap at the edge near {at} mm")
    rim = edges[shared == 1]
    tree = shapely.STRtree(shapely.points(blank.nodes[ends := np.unique(rim)]))
    near = MERGED * float(np.linalg.norm(np.ptp(blank.nodes, axis=0)))
    edge, node = tree.query(shapely.linestrings(blank.nodes[rim]), "dwithin", near)
    hanging = (rim[edge] != ends[node][:, None]).all(1)
    if hanging.any():
        at = position(blank.nodes[ends[node[hanging.argmax()]]])
        words = f"{len(np.unique(node[hanging]))} nodes lie on the side of an element"
        raise InputError(f"{words}, one at {at} mm: elements must share their corners")
    beside = blank.mesh.f2t[:, blank.mesh.f2t[1] >= 0]
    links = coo_array((np.ones(beside.shape[1]), beside), shape=2 * (len(blank.triangles),))
    count, part = connected_components(links, directed=False)
    if count > 1:
        bounds = [blank.nodes[blank.triangles[part == k]].reshape(-1, 2) for k in (0, 1)]
        one, other = (f"{position(p.min(0))} to {position(p.max(0))} mm" for p in bounds)
        overlap = _area_of(blank) < (1 - 1e-6) * blank.areas.sum()
        how = "that overlap" if overlap else "that share no edges"
        raise InputError(f"the mesh is in {count} pieces {how}: from {one}, and from {other}")
    outer, *holes = (blank.nodes[loop] for loop in blank.outline)
    outline = shapely.Polygon(outer, holes)
    if not outline.is_valid or outline.area < (1 - 1e-6) * blank.areas.sum():
        raise InputError(f"the mesh overlaps itself: {shapely.is_valid_reason(outline)}")


def _area_of(blank: Blank) -> float:
    """Area that the triangles cover, mm²."""
    import shapely

    return float(shapely.union_all(shapely.polygons(blank.nodes[blank.triangles])).area)
