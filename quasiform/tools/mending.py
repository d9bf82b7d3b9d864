"""Repair of a surface of triangles: what CAD exports and scans leave behind.

Nothing moves by more than `MERGED` times the diagonal, but a filled hole is spanned by flat
triangles. A surface without defects stays as it is.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..checks import InputError, optional

FloatArray = np.ndarray

LARGEST = 1e12  # of a coordinate, in any unit of a file
MERGED = 1e-5  # of the surface's diagonal: nearer vertices are one, flatter triangles are slivers
PINHOLE = 0.05  # a rim that encloses less than this share of the surface is a hole
FILLED = 8, 0.01  # most edges of a hole that is filled, and most of the surface it encloses
ROUNDS = 10  # of turning edges, for slivers side by side


def merged(vertices: FloatArray, triangles: np.ndarray) -> tuple[FloatArray, np.ndarray, list[str]]:
    """Merge vertices nearer than `MERGED`, drop triangles that lose a side and unused vertices.

    Returns the vertices, the triangles and what was done beside the merging of equal vertices.
    """
    check_numbers(vertices, triangles)
    vertices, index = np.unique(vertices, axis=0, return_inverse=True)
    middle, same, apart = together(vertices, MERGED * np.linalg.norm(np.ptp(vertices, axis=0)))
    triangles = same[index.reshape(-1)[triangles]]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(1)
    if not whole.any():
        raise InputError("no triangle has an area")
    repairs = []
    if one := len(vertices) - len(middle):
        count = _count(one, "vertex", "vertices")
        repairs.append(f"{count} up to {apart:.1g} mm from another merged with it")
    if not whole.all():
        repairs.append(f"{_count((~whole).sum(), 'triangle')} without area removed")
    used, triangles = np.unique(triangles[whole], return_inverse=True)
    return middle[used], triangles.reshape(-1, 3).astype(np.int64), repairs


def together(points: FloatArray, distance: float) -> tuple[FloatArray, np.ndarray, float]:
    """Bring points (n, d) nearer than a distance together.

    Returns the middles (m, d) of the groups, the group (n,) of each point and the largest distance
    of a pair.
    """
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    near = coo_array((np.ones(len(pairs)), pairs.T), shape=2 * (len(points),))
    group = connected_components(near, directed=False)[1]
    share = np.bincount(group)
    middle = np.stack([np.bincount(group, x) / share for x in points.T], axis=1)
    return middle, group, np.linalg.norm(np.subtract(*points[pairs.T]), axis=1).max(initial=0.0)


def without_defects(vertices: FloatArray, triangles: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Repair a merged surface, in this order.

    Double triangles are removed, triangles are turned alike (the larger area stays; outwards if
    closed), small holes are filled, and slivers are merged with their neighbours by turning their
    longest edge. Returns the triangles and what was done.
    """
    repairs = []
    single = _without_doubles(triangles)
    if len(single) == 0:
        raise InputError("every triangle is there twice, with its two sides")
    if doubles := len(triangles) - len(single):
        repairs.append(f"{_count(doubles, 'double triangle')} removed")
    triangles = single
    _, count, turns = edges_of(triangles)
    if ((count == 2) & (turns != 0)).any():
        alike = oriented(vertices, triangles)
        repairs.append(f"{_count((alike != triangles).any(1).sum(), 'triangle')} turned round")
        triangles = alike
    area = np.linalg.norm(normals_of(vertices[triangles]), axis=1).sum()
    holes = [ring for ring in holes_of(vertices, triangles) if len(ring) <= FILLED[0]]
    if small := [ring for ring in holes if _enclosed(vertices[ring]) < FILLED[1] * area]:
        fans = [[rim[0], b, a] for rim in small for a, b in pairwise(rim[1:])]
        triangles = np.vstack([triangles, fans])
        edges, at = max(map(len, small)), position(vertices[small[0]].mean(0))
        one, some = f"a hole of {edges} edges", f"{len(small)} holes of up to {edges} edges, one"
        repairs.append(f"{one if len(small) == 1 else some} around {at} mm of the file filled")
    least = MERGED * np.linalg.norm(np.ptp(vertices, axis=0))
    triangles, slivers = without_slivers(vertices, triangles, least)
    if slivers:
        repairs.append(f"{_count(slivers, 'sliver')} removed")
    return triangles, repairs


def _without_doubles(triangles: np.ndarray) -> np.ndarray:
    """One of triangles on the same vertices, none where as many face one way as the other."""
    a, b, c = triangles.T
    sense = np.sign(b - a) * np.sign(c - b) * np.sign(c - a)  # of the order beside that by number
    index = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    excess = np.bincount(index, sense)[index]
    kept = np.flatnonzero(sense * excess > 0)  # of those that face the way of most
    return triangles[np.sort(kept[np.unique(index[kept], return_index=True)[1]])]


def oriented(vertices: FloatArray, triangles: np.ndarray) -> np.ndarray:
    """Turn triangles, whose sense may be arbitrary, alike, and outwards if closed."""
    igl = optional("igl", "surface", "a tool from a file needs libigl")
    alike, patch = igl.bfs_orient(triangles)
    corners = vertices[alike]
    area = np.linalg.norm(normals_of(corners), axis=1)
    kept = (alike == triangles).all(1)
    turned = np.bincount(patch, np.where(kept, area, -area))[patch] < 0  # the majority stays
    if (edges_of(triangles)[1] == 2).all():
        turned = np.bincount(patch, np.linalg.det(corners - vertices.mean(0)))[patch] < 0
    return np.where(turned[:, None], alike[:, ::-1], alike)


def rings_of(edges: np.ndarray) -> list[list[int]]:
    """Vertices of the closed rings of directed edges (k, 2), parted where they touch in one."""
    after: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        after.setdefault(a, []).append(b)
    rings = []
    for start in list(after):
        path = {start: None}
        last = start
        while after.get(last):
            there = after[last].pop()
            if there in path:
                ring = list(path)
                ring = ring[ring.index(there) :]
                rings.append(ring)
                for vertex in ring[1:]:
                    del path[vertex]
            path[there] = None
            last = there
    return rings


def without_slivers(
    vertices: FloatArray, triangles: np.ndarray, least: float
) -> tuple[np.ndarray, int]:
    """Turn the longest edge of triangles lower than `least` (mm); how many there were.

    A sliver whose longest edge is on the rim is removed.
    """
    triangles, removed = triangles.copy(), 0
    for _ in range(ROUNDS):
        height, longest = _heights(vertices[triangles])
        slivers = np.flatnonzero(height < least)
        if len(slivers) == 0:
            break
        edges = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
        owner = {edge: k // 3 for k, edge in enumerate(map(tuple, edges.tolist()))}
        touched, dropped = set(), []
        for t in slivers.tolist():
            a, b, m = np.roll(triangles[t], -longest[t]).tolist()
            u = owner.get((b, a), t)
            if touched & {t, u}:
                continue
            if u == t:
                dropped.append(t)
            else:
                c = next(k for k in triangles[u].tolist() if k not in (a, b))
                pair = np.array([[a, c, m], [c, b, m]])
                there = (c, m) in owner or (m, c) in owner
                if c == m or there or _heights(vertices[pair])[0].min() <= height[t]:
                    continue
                triangles[[t, u]] = pair
            touched |= {t, u}
            removed += 1
        if not touched:
            break
        triangles = np.delete(triangles, dropped, axis=0)
    return triangles, removed


def _heights(corners: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Least heights of triangles (m, 3, 3), and which side is the longest."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    return np.linalg.norm(normals_of(corners), axis=1) / sides.max(1), sides.argmax(1)


def check_numbers(vertices: FloatArray, triangles: np.ndarray) -> None:
    """Refuse coordinates that are not finite, and a surface without triangles."""
    if len(triangles) == 0:
        raise InputError("no triangles")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError("a triangle refers to a vertex that is not there")
    wrong = ~(np.abs(vertices) < LARGEST).all(1)
    if wrong.any():
        raise InputError(f"{wrong.sum()} vertices are not finite numbers below {LARGEST:g}")


def edges_of(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (k, 2), how many triangles share each, and the sum of the senses (±1) they run in."""
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    key = ends.min(1) * (ends.max() + 1) + ends.max(1)
    _, first, index, count = np.unique(key, True, True, True)  # where, inverse, counts
    return ends[first], count, np.bincount(index, np.sign(ends[:, 1] - ends[:, 0]))


def normals_of(corners: FloatArray) -> FloatArray:
    """Normals (m, 3) of triangles (m, 3, 3), as long as twice their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def holes_of(vertices: FloatArray, triangles: np.ndarray) -> list[np.ndarray]:
    """Vertices (k,) around each hole of a surface, which may be open at one outer rim."""
    rims = rims_of(vertices, triangles)
    area = np.linalg.norm(normals_of(vertices[triangles]), axis=1).sum()
    pinhole = rims and _enclosed(vertices[rims[0]]) < PINHOLE * area
    return rims if pinhole else rims[1:]


def rims_of(vertices: FloatArray, triangles: np.ndarray) -> list[np.ndarray]:
    """Vertices (k,) of each ring of the rim, in the sense of its triangles, the longest first."""
    edges, count, _ = edges_of(triangles)
    rings = [np.array(ring) for ring in rings_of(edges[count == 1])]
    sides = [vertices[ring] - vertices[np.roll(ring, -1)] for ring in rings]
    order = np.argsort([-np.linalg.norm(side, axis=1).sum() for side in sides], kind="stable")
    return [rings[k] for k in order]


def _enclosed(ring: FloatArray) -> float:
    """Twice the area that a closed ring (k, 3) encloses, mm²."""
    arms = ring - ring.mean(0)
    return float(np.linalg.norm(np.cross(arms, np.roll(arms, -1, axis=0)).sum(0)))


def position(point: FloatArray) -> str:
    """A point (2,) or (3,), mm, as text; a rounding error is no coordinate."""
    return f"({', '.join(f'{x:.4g}' for x in np.round(point, 3) + 0.0)})"


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n} {one if n == 1 else many or one + 's'}"
