"""Cut the net of fibre lines by an outline with holes.

1. The outline is divided where it crosses a line. What comes nearer than a given part of the
   spacing to a line or a node of the net is moved there. Only the outline moves, so legs stay on
   fibres exactly, and no sliver is left beside a line.
2. In each cell only the crossings are kept, and corners that stand off their chord by more.
3. In each cell that the outline crosses, it bounds faces together with the rim of the cell; they
   are found by walking along edges with the face on the left. They are fanned from a point of the
   outline, so that at least one of their right corners keeps its triangle; a fan with too sharp an
   angle is replaced by the triangulation with the largest smallest angle.
4. Slits are open lines that are divided and moved like the outline. Both of their sides bound
   faces, and the nodes on them are doubled at the end.
"""

from __future__ import annotations

import itertools
from functools import cache
from math import atan2, pi

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..checks import InputError

FloatArray = np.ndarray
IntArray = np.ndarray
CROSSED = "the outline crosses itself between fibre lines: choose a smaller size"
TOO_NEAR = "a slit is too near to the outline or another slit: choose a smaller size"
EXACT = 1e-9  # of the area: round-off
FLAT = 2e-3  # radians: sharper triangles are refused beside slits


def cut_net(
    lines: list[FloatArray],
    rings: list[FloatArray],
    near: float,
    sharp: float,
    first: FloatArray,
    slits: list[FloatArray] = [],  # noqa: B006
    open_tips: bool = False,
) -> tuple[FloatArray, IntArray]:
    """Cut the net of lines at the coordinates a and b by rings: nodes (n, 2), triangles (m, 3).

    The outline comes first, counter-clockwise, then holes, clockwise. It moves by up to `near` to
    meet the net. Fans with angles below `sharp` (radians) are replaced by other triangles. The
    diagonals run through the net's node at `first` (2,), unless the outline itself runs along them.
    Slits (k, 2) meet rings and each other only at their ends, which are points of the rings too.
    With `open_tips` the ends of holes and darts that are too narrow become slits.
    """
    import shapely

    # a line more on either side, for corners beyond the outermost
    lines = [
        np.r_[min(line[0], r.min()) - 10 * near, line, max(line[-1], r.max()) + 10 * near]
        for line, r in zip(lines, np.vstack(rings).T, strict=True)
    ]
    a, b = lines
    points, codes, loops, slit = _fitted(rings, slits, lines, near, open_tips)
    kept = shapely.Polygon(rings[0], [rings[k] for k in loops if k > 0])

    # segments of the outline that cross a cell, and nodes of it between those of the net
    rim = np.vstack([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in loops.values()])
    path = np.vstack([rim, slit, slit[:, ::-1]])
    start, end = codes[path[:, 0]], codes[path[:, 1]]
    place = np.where(start % 2 == 1, start, np.where(end % 2 == 1, end, (start + end) // 2))
    crossing = (place % 2 == 1).all(1)
    chains: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for segment, cell in zip(path[crossing].tolist(), place[crossing] // 2, strict=True):
        chains.setdefault(tuple(cell.tolist()), []).append(tuple(segment))
    on_legs: dict[tuple[int, int], list[int]] = {}
    n_net = len(a) * len(b)
    between = np.unique(path[(path[:, 0] >= n_net) & ((start % 2).sum(1) == 1), 0])
    for point, (A, B) in zip(between.tolist(), codes[between].tolist(), strict=True):
        on_legs.setdefault((A, B), []).append(point)
        for cell in ((A // 2, B // 2), ((A - 1) // 2, (B - 1) // 2)):
            chains.setdefault(cell, [])

    centres = [0.5 * (line[1:] + line[:-1]) for line in lines]
    shapely.prepare(kept)
    whole = shapely.contains_xy(kept, *np.meshgrid(*centres, indexing="ij"))
    faces = []
    for (i, j), segments in chains.items():
        if segments or whole[i, j]:
            faces += _faces(_cell_rim(i, j, len(b), on_legs, points), segments, points)
        whole[i, j] = False

    # alternating diagonals: those ending on nodes of the parity of an outline that runs along them
    steps = np.abs(np.diff(codes[rim], axis=1))[:, 0]
    votes = codes[rim[(steps == 2).all(1), 0]].sum(1) // 2 % 2
    parity = sum(int(np.abs(line - c).argmin()) for line, c in zip(lines, first, strict=True))
    parity = votes.mean() > 0.5 if len(votes) > 0.25 * crossing[: len(rim)].sum() else parity % 2
    I, J = np.nonzero(whole)
    ring = np.stack([I * len(b) + J, (I + 1) * len(b) + J], axis=1)
    ring = np.hstack([ring, ring[:, ::-1] + 1])
    even = ((I + J) % 2 == parity)[:, None, None]
    triangles = np.where(even, ring[:, [[0, 1, 2], [2, 3, 0]]], ring[:, [[3, 0, 1], [1, 2, 3]]])
    triangles = np.vstack([triangles.reshape(-1, 3), _triangulated(faces, points, sharp)])
    if len(slit):
        enclosed = _area(points[triangles]), _area(points[rim])
        flat = _smallest_angles(points[triangles]).min() < FLAT
        if flat or abs(enclosed[0] - enclosed[1]) > EXACT * enclosed[1]:
            raise InputError(TOO_NEAR)
        triangles, double = opened(triangles, slit, len(points))
        points = np.vstack([points, points[double]])
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


def _area(polygons: FloatArray) -> float:
    """Area within the edges of polygons (n, k, 2); or (n, 2, 2) of edges, each once."""
    (x, y), (u, v) = polygons.T, np.roll(polygons, -1, axis=1).T
    cross = x * v - y * u
    return 0.5 * float((cross[0] if len(cross) == 2 else cross).sum())


def opened(triangles: IntArray, slit: IntArray, n: int) -> tuple[IntArray, IntArray]:
    """Part triangles (m, 3) on n nodes along edges `slit` (k, 2) between these.

    Returns the triangles with new nodes, numbered from n on, and the node of which each of these
    is the double. Nodes at the inner ends of slits stay single.

    Examples
    --------
    >>> triangles = np.array([[0, 1, 2], [0, 2, 3]])
    >>> opened(triangles, np.array([[0, 2]]), 4)[0].tolist()
    [[0, 1, 2], [4, 5, 3]]
    """
    corners = triangles.ravel()
    # the two corners at each end of an edge that two triangles share belong together
    ahead = np.arange(len(corners)).reshape(-1, 3)
    ends = np.stack([ahead, np.roll(ahead, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.take_along_axis(ends, np.argsort(corners[ends], axis=1), axis=1)
    key, cut = corners[ends] @ [n, 1], np.sort(slit, axis=1) @ [n, 1]
    order = np.argsort(key, kind="stable")
    both = np.flatnonzero((np.diff(key[order]) == 0) & ~np.isin(key[order][1:], cut))
    links = ends[order[both]].ravel(), ends[order[both + 1]].ravel()
    graph = coo_array((np.ones(len(links[0])), links), shape=2 * (len(corners),))
    _, group = connected_components(graph, directed=False)
    node = corners[np.unique(group, return_index=True)[1]]  # of each group
    _, first = np.unique(node, return_index=True)
    more = np.isin(node, slit)
    more[first] = False
    number = node.copy()
    number[more] = n + np.arange(more.sum())
    return number[group].reshape(-1, 3), node[more]


def _fitted(
    rings: list[FloatArray],
    slits: list[FloatArray],
    lines: list[FloatArray],
    near: float,
    open_tips: bool,
) -> tuple[FloatArray, IntArray, dict[int, IntArray], IntArray]:
    """Fit rings and slits to the net of lines: what is within `near` of a line or node moves there.

    Returns points (n, 2), the nodes of the net line by line, then those of the outline; codes
    (n, 2) of where they lie, 2 i on line i, 2 i + 1 between the lines i and i + 1; the points
    of the fitted rings by number, without holes that vanish; and edges (k, 2) of the slits.
    """
    import shapely

    ends = np.array([line[k] for line in slits for k in (0, -1)]).reshape(-1, 2)
    index = np.meshgrid(*(np.arange(len(line)) for line in lines), indexing="ij")
    points = [np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)]
    codes = [2 * np.stack(index, axis=-1).reshape(-1, 2)]
    count, loops, raw = len(points[0]), {}, [np.empty((0, 2), dtype=int)]
    for k, ring in enumerate(rings):
        code, snapped, original = _divided(ring, lines, near)
        keep = _needed(code, snapped, original, near, _at(original, ends))
        code, snapped = code[keep], snapped[keep]
        on_node = (code % 2 == 0).all(1)
        number = np.where(on_node, code @ [len(lines[1]), 1] // 2, count + np.cumsum(~on_node) - 1)
        loop = _without_spikes(number.tolist())
        if len(loop) < 3:
            extent = np.ptp(ring, axis=0)
            if k == 0 or extent.max() > 2 * near:
                what = f"the {f'hole {k}' if k else 'outline'}, {extent.max():.3g} mm long,"
                remedy = "choose a smaller size" + " or fill the hole" * (k > 0)
                words = "is too narrow for the spacing of the fibre lines"
                raise InputError(f"{what} {words}: {remedy}")
            continue
        loops[k] = np.array(loop)
        raw.append(np.column_stack([number, np.roll(number, -1)])[: len(number) * open_tips])
        points.append(snapped[~on_node])
        codes.append(code[~on_node])
        count += len(points[-1])
    places, ways = np.vstack(points), np.vstack(raw)
    kept = shapely.Polygon(places[loops[0]], [places[loops[k]] for k in loops if k > 0])
    edges = [ways[shapely.contains_xy(kept, places[ways].mean(1))]]
    known = {tuple(p): k for k, p in enumerate(places[len(points[0]) :].tolist())}
    for line in slits:
        code, snapped, original = _divided(line, lines, near, closed=False)
        keep = _needed(code, snapped, original, near, _at(original, ends), closed=False)
        number = []
        for at, place in zip(code[keep].tolist(), snapped[keep].tolist(), strict=True):
            if at[0] % 2 == at[1] % 2 == 0:
                number.append(at[0] // 2 * len(lines[1]) + at[1] // 2)
                continue
            if tuple(place) not in known:
                known[tuple(place)] = len(known)
                points.append(np.array([place]))
                codes.append(np.array([at]))
            number.append(len(points[0]) + known[tuple(place)])
        edges.append(np.column_stack([number[:-1], number[1:]]))
    return np.vstack(points), np.vstack(codes), loops, _slit_edges(edges, loops)


def _slit_edges(edges: list[IntArray], loops: dict[int, IntArray]) -> IntArray:
    """Edges (k, 2) of slits, each once, without those on the outline."""
    rim = [np.column_stack([loop, np.roll(loop, -1)]) for loop in loops.values()]
    found = np.unique(np.sort(np.vstack(edges), axis=1), axis=0)
    found = found[found[:, 0] != found[:, 1]]
    on_rim = set(map(tuple, np.sort(np.vstack(rim), axis=1).tolist()))
    inside = [tuple(edge) not in on_rim for edge in found.tolist()]
    return found[np.array(inside, dtype=bool)]


def _at(points: FloatArray, ends: FloatArray) -> np.ndarray:
    """(n,) bool array: which points are exactly one of the ends."""
    return np.isin(points @ [1.0, 1j], ends @ [1.0, 1j])


def _divided(
    ring: FloatArray, lines: list[FloatArray], near: float, closed: bool = True
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Vertices of a ring and its crossings with the lines: codes, places moved and original."""
    step = np.roll(ring, -1, axis=0) - ring
    found = [(np.arange(len(ring)), np.zeros(len(ring)), ring)]
    for axis, line in enumerate(lines):
        ends = ring[:, axis], ring[:, axis] + step[:, axis]
        low = np.searchsorted(line, np.minimum(*ends), side="right")
        count = np.maximum(np.searchsorted(line, np.maximum(*ends), side="left") - low, 0)
        edge = np.repeat(np.arange(len(ring)), count)
        crossed = line[np.arange(len(edge)) + np.repeat(low - np.cumsum(count) + count, count)]
        share = (crossed - ring[edge, axis]) / step[edge, axis]
        place = ring[edge] + share[:, None] * step[edge]
        place[:, axis] = crossed
        found.append((edge, share, place))
    edges, shares, original = map(np.concatenate, zip(*found, strict=True))
    if not closed:
        there = (edges < len(ring) - 1) | (shares == 0)
        edges, shares, original = edges[there], shares[there], original[there]
    original = original[np.lexsort([shares, edges])]
    codes, moved = np.empty(original.shape, dtype=int), original.copy()
    for axis, line in enumerate(lines):
        x = original[:, axis]
        after = np.searchsorted(line, x, side="right")
        nearest = after - (x - line[after - 1] < line[np.minimum(after, len(line) - 1)] - x)
        on = np.abs(x - line[nearest]) <= near
        codes[:, axis] = np.where(on, 2 * nearest, 2 * after - 1)
        moved[:, axis] = np.where(on, line[nearest], x)
    return codes, moved, original


def _needed(
    codes: IntArray,
    moved: FloatArray,
    original: FloatArray,
    near: float,
    fixed: np.ndarray,
    closed: bool = True,
) -> IntArray:
    """Vertices of a divided ring that are kept: nodes, crossings and corners off them.

    So are `fixed` ones, (n,) bool; of an open line the first and the last must be so.
    """
    odd = (codes % 2).sum(1)
    n = len(codes)
    begins = (codes != np.roll(codes, 1, axis=0)).any(1)
    begins[0] |= not closed
    if not begins.any():
        return np.arange(0)
    # runs of vertices on the same node, leg or cell; a run on a leg crosses it, or only touches
    order = np.roll(np.arange(n), -int(begins.argmax()))
    first = np.flatnonzero(begins[order])
    last = np.append(first[1:], n) - 1
    code = codes[order[first]]
    sides = np.roll(code, 1, axis=0) - code, np.roll(code, -1, axis=0) - code
    crosses = (odd[order[first]] == 1) & ((sides[0] * sides[1] < 0) & (code % 2 == 0)).any(1)
    at_node = odd[order[first]] == 0
    crosses &= ~np.logical_or.reduceat(fixed[order], first)
    anchors = np.r_[first[at_node], (first[crosses] + last[crosses]) // 2]
    anchors = order[np.union1d(anchors, np.flatnonzero(fixed[order]))]
    if not len(anchors):
        return np.arange(0)
    order = np.roll(np.arange(n), -int(anchors[0]))
    anchors = (anchors - anchors[0]) % n
    moved, original = moved[order], original[order]
    kept = []
    for start, end in itertools.pairwise([*anchors.tolist(), len(order)]):
        kept += [start, *_corners_between(moved, original, start, end, near)]
    return order[kept]


def _corners_between(
    moved: FloatArray, original: FloatArray, start: int, end: int, near: float
) -> list[int]:
    """Vertices to keep so that the others lie within `near` of the straight line between."""
    if end - start < 2:
        return []
    p, q = moved[start], moved[end % len(moved)]
    along, off = q - p, original[start + 1 : end] - p
    share = np.clip(off @ along / max(along @ along, 1e-300), 0.0, 1.0)
    distance = np.linalg.norm(off - share[:, None] * along, axis=1)
    if distance.max() <= near:
        return []
    at = start + 1 + int(distance.argmax())
    sides = [_corners_between(moved, original, *part, near) for part in ((start, at), (at, end))]
    return [*sides[0], at, *sides[1]]


def _without_spikes(loop: list[int]) -> list[int]:
    """Leave out repeated vertices of a closed loop, and ways there and back.

    Examples
    --------
    >>> _without_spikes([9, 1, 2, 3, 2, 4, 4, 5, 1])
    [1, 2, 4, 5]
    """
    kept: list[int] = []
    for vertex in loop:
        if len(kept) > 1 and kept[-2] == vertex:
            kept.pop()
        elif not kept or kept[-1] != vertex:
            kept.append(vertex)
    while len(kept) > 1 and (kept[0] in kept[-2:] or kept[1] == kept[-1]):
        kept.pop(-1 if kept[0] in kept[-2:] else 0)
    return kept


def _cell_rim(
    i: int, j: int, n_b: int, on_legs: dict[tuple[int, int], list[int]], points: FloatArray
) -> list[int]:
    """Nodes around the cell (i, j), counter-clockwise, with those of the outline on its legs."""
    rim = []
    # each corner, and the middle of the leg after it, in halves of a leg
    for (I, J), (A, B) in (((0, 0), (1, 0)), ((1, 0), (2, 1)), ((1, 1), (1, 2)), ((0, 1), (0, 1))):
        node = (i + I) * n_b + j + J
        more = on_legs.get((2 * i + A, 2 * j + B), [])
        rim += [node, *sorted(more, key=lambda k: np.abs(points[k] - points[node]).sum())]
    return rim


def _faces(rim: list[int], segments: list[tuple[int, int]], points: FloatArray) -> list[list[int]]:
    """Faces on the left of the `segments` of the outline in a cell; without any, the cell."""
    if not segments:
        return [rim]
    ends: dict[int, list[int]] = {}
    for start, end in [*itertools.pairwise([*rim, rim[0]]), *segments]:
        ends.setdefault(start, []).append(end)

    def turn(u: int, v: int, w: int) -> float:
        """Clockwise angle at v from u to w."""
        (x, y), (s, t) = points[u] - points[v], points[w] - points[v]
        return atan2(y * s - x * t, x * s + y * t) % (2 * pi) or 2 * pi

    todo, faces = dict.fromkeys(segments), []
    while todo:
        first = u, v = next(iter(todo))
        face = []
        while not face or (u, v) != first:
            todo.pop((u, v), None)
            face.append(u)
            w = ends[v][0] if len(ends[v]) == 1 else min(ends[v], key=lambda w: turn(u, v, w))
            u, v = v, w
            if len(face) > len(rim) + len(segments):
                raise InputError(CROSSED)
        faces.append(face)
    return faces


def _triangulated(faces: list[list[int]], points: FloatArray, sharp: float) -> IntArray:
    """Triangles of all faces: fans, or what avoids angles below `sharp` (radians) best."""
    if not faces:
        return np.empty((0, 3), dtype=int)
    fans = [_fan(np.array(face), points[face]) for face in faces]
    angles = _smallest_angles(points[np.vstack(fans)])
    starts = np.cumsum([0, *map(len, fans[:-1])])
    worst = np.minimum.reduceat(angles, starts)
    for k in np.flatnonzero(worst < sharp):
        fans[k] = _best(faces[k], points)
    return np.vstack(fans)


def _fan(face: IntArray, ring: FloatArray) -> IntArray:
    """Triangles of one cell cut by the outline, fanned so that its first right corner stays whole.

    A right corner lies between a leg on a warp and one on a weft.
    """
    step = np.abs(np.roll(ring, -1, axis=0) - ring)
    along_a, along_b = step[:, 1] < 1e-9 * step[:, 0], step[:, 0] < 1e-9 * step[:, 1]
    right = (along_a & np.roll(along_b, 1)) | (along_b & np.roll(along_a, 1))
    starts = np.flatnonzero(right & ~np.roll(right, 1))
    fan = np.roll(face, 1 - (starts[0] if len(starts) else 1))
    return np.stack([np.broadcast_to(fan[0], len(fan) - 2), fan[1:-1], fan[2:]], axis=1)


def _smallest_angles(corners: FloatArray) -> FloatArray:
    """Smallest angle, radians, of triangles (n, 3, 2); negative if clockwise."""
    u, v = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    return np.arctan2(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0], (u * v).sum(-1)).min(1)


def _best(face: list[int], points: FloatArray) -> IntArray:
    """Triangulation of a face with the largest smallest angle.

    If all its triangles turn counter-clockwise, it tiles the face, convex or not.
    """
    triples = np.array(list(itertools.combinations(range(len(face)), 3)))
    angles = _smallest_angles(points[np.array(face)[triples]])
    angle = dict(zip(map(tuple, triples.tolist()), angles.tolist(), strict=True))

    @cache
    def best(first: int, last: int) -> tuple[float, tuple]:
        """Smallest angle and triangles of the vertices from `first` to `last`."""
        if last - first < 2:
            return np.inf, ()
        ways = []
        for k in range(first + 1, last):
            (left, some), (right, others) = best(first, k), best(k, last)
            tip = first, k, last
            ways.append((min(angle[tip], left, right), (tip, *some, *others)))
        return max(ways)

    value, triangles = best(0, len(face) - 1)
    if value <= 0:
        raise InputError(CROSSED)
    return np.array(face)[np.array(triangles)]
