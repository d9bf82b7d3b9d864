"""The flat sheet: a mesh whose element legs lie on fibre lines.

The fabric is a net of two families of straight fibre lines. The lines cut the blank into
rectangular cells; every cell becomes two right triangles with both legs on fibres, the diagonals
alternating, so the mesh has the mirror planes and quarter turns of the net. Such P1 triangles see
the stretch of a fibre on a leg and the shear at a right corner: they neither lock nor have an
hourglass mode (the net is isostatic, as the inextensible fabric is).

Cells cut by the outline are fanned from a point of the outline, so that at least one of their right
corners keeps its triangle. Triangles there may have one leg on a fibre only; as every node of the
outline ends one line, the net stays isostatic and does not lock.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skfem import Basis, ElementTriP1, MeshLine, MeshTri

from .checks import InputError, check_number

FloatArray = np.ndarray
IntArray = np.ndarray
MOST_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False)
class Blank:
    """A flat sheet meshed along its fibres.

    Parameters
    ----------
    nodes : (n_nodes, 2) array
        Flat positions X, mm.
    triangles : (n_triangles, 3) array
        Node numbers, counter-clockwise; they tile the blank.
    warp, weft : (2,) arrays
        Unit vectors of the fibres.
    mirror : tuple of "x" and "y"
        Planes x = 0, y = 0 of which only the positive side is meshed.
    """

    nodes: FloatArray
    triangles: IntArray
    warp: FloatArray
    weft: FloatArray
    mirror: tuple[str, ...] = ()

    @cached_property
    def size(self) -> float:
        """Typical spacing of the fibre lines, mm: the leg of the median triangle."""
        return float(np.sqrt(2.0 * np.median(self.areas)))

    @cached_property
    def mesh(self) -> MeshTri:
        """The tiling as a scikit-fem mesh."""
        return _mesh(MeshTri, self.nodes, self.triangles)

    @cached_property
    def basis(self) -> Basis:
        """P1 basis with one quadrature point a triangle."""
        point = np.full((2, 1), 1 / 3), np.array([0.5])
        return Basis(self.mesh, ElementTriP1(), quadrature=point)

    @cached_property
    def areas(self) -> FloatArray:
        """(n_triangles,) areas of the triangles, mm²."""
        return self.basis.dx[:, 0]

    @cached_property
    def node_areas(self) -> FloatArray:
        """(n_nodes,) tributary areas, mm²; they sum to the area of the blank."""
        share = np.repeat(self.areas / 3.0, 3)
        return np.bincount(self.triangles.ravel(), share, minlength=len(self.nodes))

    @cached_property
    def centroids(self) -> FloatArray:
        """(n_triangles, 2) flat positions of the triangles' centroids, mm."""
        return self.nodes[self.triangles].mean(1)

    def fibre_lines(self, family: str) -> MeshLine:
        """Return all segments of the lines of "warp" or "weft" as a 1D scikit-fem mesh.

        The coordinate is the arc length along the fibre; node numbers are those of the blank.
        """
        along = self.warp if family == "warp" else self.weft
        legs = self.mesh.facets.T
        direction = self.nodes[legs[:, 1]] - self.nodes[legs[:, 0]]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        segments = legs[np.abs(direction @ along) > 1 - 1e-5]
        s = self.nodes @ along
        backwards = s[segments[:, 0]] > s[segments[:, 1]]
        segments[backwards] = segments[backwards, ::-1]
        return _mesh(MeshLine, s[:, None], segments)

    def unfolded(self) -> tuple[Blank, IntArray, FloatArray, IntArray, FloatArray]:
        """Mirror a part of the blank into the whole.

        Returns
        -------
        whole : Blank
        node_source : (n_whole_nodes,) int array
            Node of this blank that each node of the whole mirrors.
        node_sign : (n_whole_nodes, 3) array
            Factors of its position components, 1 or -1.
        triangle_source : (n_whole_triangles,) int array
        triangle_sign : (n_whole_triangles,) array
            Factor of the shear angle, 1 or -1 (a mirrored net shears the other way).
        """
        nodes, source = self.nodes, np.arange(len(self.nodes))
        sign = np.ones((len(nodes), 3))
        triangles, triangle_source = self.triangles, np.arange(len(self.triangles))
        triangle_sign = np.ones(len(triangles))
        for plane in self.mirror:
            axis = "xy".index(plane)
            off = np.flatnonzero(np.abs(nodes[:, axis]) > 1e-9)
            number = np.arange(len(nodes))
            number[off] = len(nodes) + np.arange(len(off))
            flip = np.ones(3)
            flip[axis] = -1.0
            nodes = np.vstack([nodes, nodes[off] * flip[:2]])
            source, sign = np.append(source, source[off]), np.vstack([sign, sign[off] * flip])
            triangles = np.vstack([triangles, number[triangles][:, ::-1]])
            triangle_source = np.tile(triangle_source, 2)
            triangle_sign = np.append(triangle_sign, -triangle_sign)
        whole = replace(self, nodes=nodes, triangles=triangles, mirror=())
        return whole, source, sign, triangle_source, triangle_sign

    def turned(self, angle: float) -> Blank:
        """Turn the blank together with its fibres by `angle` degrees about the origin."""
        R = rotation(angle)
        return replace(self, nodes=self.nodes @ R.T, warp=R @ self.warp, weft=R @ self.weft)


def _mesh(kind: type, nodes: FloatArray, elements: IntArray) -> MeshTri | MeshLine:
    """Build a scikit-fem mesh with the node order kept, so that orientations survive."""
    arrays = np.ascontiguousarray(nodes.T), np.ascontiguousarray(elements.T)
    return kind(*arrays, sort_t=False)


def rotation(angle: float) -> FloatArray:
    """(2, 2) matrix of a counter-clockwise turn by `angle` degrees, exact at quarter turns."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    if angle % 90 == 0:
        c, s = np.round(c), np.round(s)
    return np.array([[c, -s], [s, c]])


def rectangle(
    length: float,
    width: float,
    size: float,
    orientation: float = 0.0,
    centre: tuple[float, float] = (0.0, 0.0),
    through: tuple[tuple[float, float], ...] = (),
    mirror: tuple[str, ...] = (),
) -> Blank:
    """Mesh a rectangle, length along x, with fibre lines through its corners.

    Parameters
    ----------
    length, width : float
        mm, along x and y.
    size : float
        Spacing of the fibre lines, mm; the nearest spacing that fits is taken.
    orientation : float
        Angle of the warp to x, degrees.
    centre : (2,)
        Centre of the rectangle, mm.
    through : points, mm
        Further points that shall lie on a warp and a weft line.
    mirror : tuple of "x" and "y"
        Mesh only the positive side of the planes x = 0, y = 0 (through the centre).

    Raises
    ------
    InputError
        For bad numbers, mirror planes that do not fit, or more than two million triangles.
    """
    for name, value in (("length", length), ("width", width), ("size", size)):
        check_number(name, value)
    if mirror and (orientation % 90 != 0 or any(centre)):
        raise InputError("mirror planes need fibres along x and y and the centre at the origin")
    if not 2 * length * width < MOST_TRIANGLES * size**2:
        raise InputError(
            f"size {size:g} mm on {length:g} x {width:g} mm makes more than "
            f"{MOST_TRIANGLES:.0e} triangles: choose a larger size"
        )
    R = rotation(orientation)
    x0 = -length / 2 * ("x" not in mirror)
    y0 = -width / 2 * ("y" not in mirror)
    box = np.array(
        [[x0, y0], [length / 2, y0], [length / 2, width / 2], [x0, width / 2]], dtype=float
    ) + np.asarray(centre)
    stops = np.array([*box, *through]) @ R  # in fibre coordinates (a, b)
    a, b = (_lines_through(stops[:, i], size) for i in (0, 1))
    nodes, triangles = _cut_net(a, b, box @ R)
    return Blank(nodes @ R.T, triangles, R[:, 0], R[:, 1], mirror)


def _lines_through(points: FloatArray, size: float) -> FloatArray:
    """Coordinates of fibre lines through all `points`, evenly spaced by about `size` between."""
    stops = np.sort(points)
    stops = stops[np.r_[True, np.diff(stops) > 1e-6 * size]]
    pieces = [
        np.linspace(p, q, max(1, round((q - p) / size)), endpoint=False)
        for p, q in itertools.pairwise(stops)
    ]
    return np.append(np.concatenate(pieces), stops[-1])


def _cut_net(a: FloatArray, b: FloatArray, outline: FloatArray) -> tuple[FloatArray, IntArray]:
    """Cut the net of lines `a` x `b` by a polygon; nodes and triangles (fibre coordinates)."""
    polygon = shapely.Polygon(outline)
    # points nearer than this are one: a line that just misses a corner of the net makes no sliver
    snap = 1e-3 * min(np.diff(a).min(), np.diff(b).min())
    i, j = (k.ravel() for k in np.meshgrid(np.arange(len(a) - 1), np.arange(len(b) - 1)))
    cells = shapely.box(a[i], b[j], a[i + 1], b[j + 1])
    shapely.prepare(polygon)
    whole = shapely.covers(polygon.buffer(1e-4 * snap), cells)
    # diagonals end on the nodes whose parity is that of the outline's first corner, so that an
    # outline at 45° to the fibres is itself made of diagonals
    parity = sum(int(np.abs(line - c).argmin()) for line, c in zip((a, b), outline[0], strict=True))

    number = lambda i, j: i * len(b) + j  # noqa: E731
    I, J = i[whole], j[whole]
    ring = np.stack(
        [number(I, J), number(I + 1, J), number(I + 1, J + 1), number(I, J + 1)], axis=1
    )
    even = ((I + J) % 2 == parity % 2)[:, None, None]
    first = np.where(even, ring[:, [[0, 1, 2], [2, 3, 0]]], ring[:, [[3, 0, 1], [1, 2, 3]]])
    triangles = [first.reshape(-1, 3)]

    points = [np.stack([c.ravel() for c in np.meshgrid(a, b, indexing="ij")], axis=1)]
    next_number = len(points[0])
    cut = cells[~whole]
    for piece in shapely.get_parts(shapely.intersection(cut, polygon)):
        if shapely.get_type_id(piece) != 3:
            continue  # cell and outline share a line or a point
        ring_points = np.asarray(shapely.orient_polygons(piece).exterior.coords)[:-1]
        apart = np.linalg.norm(ring_points - np.roll(ring_points, 1, axis=0), axis=1)
        ring_points = ring_points[apart > snap]
        if len(ring_points) < 3:
            continue
        triangles.append(_fan(ring_points, snap) + next_number)
        points.append(ring_points)
        next_number += len(ring_points)
    return _merge(np.vstack(points), np.vstack(triangles), snap)


def _fan(ring: FloatArray, snap: float) -> IntArray:
    """Triangles of one cell cut by the outline (indices into its ring).

    The fan starts at the vertex before the first right corner, which is so kept whole.
    """
    n = len(ring)
    step = np.roll(ring, -1, axis=0) - ring
    along_a, along_b = np.abs(step[:, 1]) < snap, np.abs(step[:, 0]) < snap
    right = (along_a & np.roll(along_b, 1)) | (along_b & np.roll(along_a, 1))
    starts = np.flatnonzero(right & ~np.roll(right, 1))
    order = ((starts[0] if len(starts) else 1) - 1 + np.arange(n)) % n
    return np.array([[order[0], order[k], order[k + 1]] for k in range(1, n - 1)])


def _merge(points: FloatArray, triangles: IntArray, snap: float) -> tuple[FloatArray, IntArray]:
    """Make near points one node (the net's own first); drop flat triangles and unused points."""
    used = np.unique(triangles)
    pairs = cKDTree(points[used]).query_pairs(snap, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(used), len(used)))
    _, group = connected_components(links, directed=False)
    _, representative, group = np.unique(group, return_index=True, return_inverse=True)
    number = np.full(len(points), -1)
    number[used] = group
    points, triangles = points[used][representative], number[triangles]
    u, v = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    thick = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > snap * np.linalg.norm(u - v, axis=1)
    used, triangles = np.unique(triangles[thick], return_inverse=True)
    return points[used], triangles.reshape(-1, 3)
