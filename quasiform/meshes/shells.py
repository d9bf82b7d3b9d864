"""Surface elements of a mesh file, for all readers: tools, blanks, targets and references.

One rule: every element of a file is used, or counted in `left_out` by its kind. Of elements of
higher order the corners make the surface; their other nodes are kept in `middles`.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, check_file, check_number, naming
from .inp_file import read_inp
from .mesh_file import read_mesh

if TYPE_CHECKING:
    import meshio

FloatArray = np.ndarray
IntArray = np.ndarray
KINDS = re.compile(r"(?:vtk_(?:lagrange|bezier)_)?(triangle|quad)(?:rilateral)?\d*", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Shells:
    """Surface elements with the labels of their file."""

    points: FloatArray  # (n, 3), mm
    nodes: IntArray  # (n,) labels
    corners: IntArray  # (m, k) rows of `points`; -1 beyond the last corner
    elements: IntArray  # (m,) labels
    middles: IntArray  # (m, j) rows of the other nodes, of higher order; -1 where none
    left_out: Mapping[str, int] = field(default_factory=dict)  # elements and nodes, by kind

    @classmethod
    def counted(cls, points: FloatArray, corners: IntArray) -> Shells:
        """Elements of given corners, (m, k), labelled from 1."""
        corners = np.pad(corners, ((0, 0), (0, max(0, 4 - corners.shape[1]))), constant_values=-1)
        labels = 1 + np.arange(len(points)), 1 + np.arange(len(corners))
        return cls(points, labels[0], corners, labels[1], corners[:, :0])

    @classmethod
    def of_mesh(cls, mesh: meshio.Mesh) -> Shells:
        """Elements of a mesh of meshio, labelled by their place in the file, from 1."""
        blocks, labels, left_out, first = [], [], {}, 1
        for block in mesh.cells:
            many = len(block.data)
            if corners := corners_of(block.type, block.data):
                blocks.append((np.asarray(block.data), corners))
                labels.append(first + np.arange(many))
            elif many:
                left_out[block.type] = left_out.get(block.type, 0) + many
            first += many
        _check_rows([data for data, _ in blocks], len(mesh.points))
        corners = _padded([data[:, :n] for data, n in blocks], 4)
        middles = _padded([data[:, n:] for data, n in blocks])
        numbers = np.concatenate([np.empty(0, int), *labels])
        own = 1 + np.arange(len(mesh.points))
        return cls(mesh.points, own, corners, numbers, middles, left_out)

    @classmethod
    def of_faces(cls, points: FloatArray, faces: list[list[int]], left_out: dict) -> Shells:
        """Faces of any number of corners; those of one or two are left out."""
        blocks = [np.reshape(face, (1, -1)) for face in faces if len(face) > 2]
        _check_rows(blocks, len(points))
        if few := len(faces) - len(blocks):
            left_out = left_out | {"faces of less than three corners": few}
        width = max([block.shape[1] for block in blocks], default=3)
        rows = [[*face, *[-1] * (width - len(face))] for face in faces if len(face) > 2]
        made = cls.counted(points, np.reshape(rows, (-1, width)).astype(int))
        return replace(made, left_out=left_out)

    @cached_property
    def count(self) -> IntArray:
        """(m,) number of corners."""
        return (self.corners >= 0).sum(1)

    @property
    def triangular(self) -> np.ndarray:
        """(m,) bool."""
        return self.count == 3

    @property
    def centroids(self) -> FloatArray:
        """(m, 3) means of the corners, mm."""
        inside = (self.corners >= 0)[:, :, None]
        return (self.points[self.corners] * inside).sum(1) / self.count[:, None]

    @property
    def normals(self) -> FloatArray:
        """(m, 3) unit normals, right-handed about the corners."""
        first = self.points[self.corners[:, :1]]
        arms = np.where((self.corners >= 0)[:, :, None], self.points[self.corners] - first, 0.0)
        n = np.cross(arms[:, 1:-1], arms[:, 2:]).sum(1)
        length = np.linalg.norm(n, axis=1)[:, None]
        if not (length > 0).all():
            raise InputError(
                f"element {self.elements[int(length.argmin())]} has no area or is crossed"
            )
        return n / length

    def split(self) -> tuple[IntArray, IntArray]:
        """Triangles (k, 3) and the row (k,) of each one's element; all first ones come first."""
        triangles, rows, order = [np.empty((0, 3), int)], [np.empty(0, int)], [np.empty(0, int)]
        for n in np.unique(self.count).tolist():
            those = np.flatnonzero(self.count == n)
            ring = self.corners[those, :n]
            fan = np.stack([ring[:, [0, i, i + 1]] for i in range(1, n - 1)], axis=1)
            for k in np.flatnonzero(_concave(self.points[ring])):
                fan[k] = ring[k][_clipped(self.points[ring[k]])]
            triangles.append(fan.reshape(-1, 3))
            rows.append(np.repeat(those, n - 2))
            order.append(np.tile(np.arange(n - 2), len(those)))
        sort = np.lexsort((row := np.concatenate(rows), np.concatenate(order)))
        return np.concatenate(triangles)[sort], row[sort]

    def kept_nodes(self, known: Container[int]) -> IntArray:
        """(m,) nodes that an element has in a code that knows types of `known` numbers of nodes.

        Of an element of higher order than two the corners are kept.
        """
        whole = self.count + (self.middles >= 0).sum(1)
        second = np.where(self.triangular, np.where(whole > 7, 3, 6), np.where(whole > 9, 4, 8))
        kept = np.where(whole == 9, 9 if 9 in known else 8, second)
        return np.where(whole == self.count, self.count, kept)

    def rows_of(self, chosen: np.ndarray, nodes: int) -> IntArray:
        """(k, nodes) rows of `points` of some elements: the corners, then nodes of second order."""
        corners = 3 if nodes in (3, 6) else 4
        both = self.corners[chosen, :corners], self.middles[chosen, : nodes - corners]
        return np.hstack(both) if len(both[0]) else np.empty((0, nodes), dtype=int)

    def of_second_order(self) -> Shells:
        """Elements with a node on every side: where there is none, in the middle of the corners."""
        there, ends = self.corners >= 0, np.roll(self.corners, -1, axis=1)
        last = self.count - 1
        ends[np.arange(len(last)), last] = self.corners[:, 0]
        sides = np.sort(np.stack([self.corners, ends], axis=2)[there], axis=1)
        sides, at = np.unique(sides, axis=0, return_inverse=True)
        middles = np.full(self.corners.shape, -1)
        width = min(middles.shape[1], self.middles.shape[1])
        middles[:, :width] = self.middles[:, :width]
        node, given = np.full(len(sides), -1), middles[there]
        node[at[given >= 0]] = given[given >= 0]
        new = np.flatnonzero(node < 0)
        node[new] = len(self.points) + np.arange(len(new))
        middles[:] = -1
        middles[there] = node[at]
        points = np.vstack([self.points, self.points[sides[new]].mean(1)])
        labels = np.append(self.nodes, self.nodes.max() + 1 + np.arange(len(new)))
        return replace(self, points=points, nodes=labels, middles=middles)

    def with_used_nodes(self) -> Shells:
        """Without nodes that no element has, which are counted."""
        used = np.unique(np.append(self.corners, self.middles))
        used = used[used >= 0]
        if len(used) == len(self.points):
            return self
        place = np.full(len(self.points) + 1, -1)  # the last for -1
        place[used] = np.arange(len(used))
        corners, middles = (place[part] for part in (self.corners, self.middles))
        left_out = {**self.left_out, "nodes without an element": len(self.points) - len(used)}
        nodes = {"points": self.points[used], "nodes": self.nodes[used], "left_out": left_out}
        return replace(self, **nodes, corners=corners, middles=middles)

    def at_nodes(self, values: FloatArray) -> FloatArray:
        """(n,) means, weighted by area, of (m,) values; nan where none is known.

        A node of higher order gets the mean of the corners of its element.
        """
        triangles, rows = self.split()
        a, b = (self.points[triangles[:, 1:]] - self.points[triangles[:, :1]]).transpose(1, 0, 2)
        area = np.where(np.isfinite(values[rows]), np.linalg.norm(np.cross(a, b), axis=1), 0.0)
        total = np.repeat(area * np.nan_to_num(values[rows]), 3)
        total, area = (
            np.bincount(triangles.ravel(), w, len(self.points)) for w in (total, np.repeat(area, 3))
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            found = total / area
        for row in np.flatnonzero((self.middles >= 0).any(1)):
            corners, middles = (part[row][part[row] >= 0] for part in (self.corners, self.middles))
            found[middles] = found[corners].mean()
        return found


def corners_of(kind: str, data: Sequence) -> int:
    """How many of the nodes of a surface element of meshio's `kind` are corners; 0 for others."""
    if kind == "polygon":
        return np.shape(data)[1]
    found = KINDS.fullmatch(kind)
    return {"triangle": 3, "quad": 4}[found[1].lower()] if found else 0


def counted(left_out: Mapping[str, int]) -> str:
    """What was left out, as text: '2 line, 1 tetra'."""
    return ", ".join(f"{count} {kind}" for kind, count in left_out.items())


def read_shells(path: str | Path, scale: float = 1.0) -> Shells:
    """Read the shell elements of a structural mesh: .inp, or what meshio reads.

    `scale` is mm per unit of its lengths. Elements of more than four corners are left out.
    """
    path = Path(path)
    with naming(path):
        check_file(path)
        check_number("scale", scale)
        inp = path.suffix.lower() == ".inp"
        shells = Shells(**read_inp(path)) if inp else Shells.of_mesh(read_mesh(path))
        if large := int((shells.count > 4).sum()):
            names = ("corners", "elements", "middles")
            parts = {name: getattr(shells, name)[shells.count <= 4] for name in names}
            left_out = {**shells.left_out, "polygons of more than 4 corners": large}
            shells = replace(shells, **parts, left_out=left_out)
        if not len(shells.elements):
            others = f": the file holds {counted(shells.left_out)}" if shells.left_out else ""
            raise InputError(f"no triangles or quadrilaterals{others}")
        shells = shells.with_used_nodes()
        if not np.isfinite(shells.points).all():
            raise InputError("not all points are finite numbers")
        shells = replace(shells, points=scale * shells.points)
        shells.normals  # noqa: B018  (refuses an element without an area)
        return shells


def _check_rows(blocks: list[IntArray], many: int) -> None:
    """Refuse elements on nodes that are not there."""
    if any(block.size and not 0 <= block.min() <= block.max() < many for block in blocks):
        raise InputError("an element refers to a node that is not there")


def _padded(blocks: list[IntArray], least: int = 0) -> IntArray:
    """Stack rows of different widths, of `least` or more columns, with -1 at their ends."""
    width = max([least, *(block.shape[1] for block in blocks)])
    wide = [np.pad(b, ((0, 0), (0, width - b.shape[1])), constant_values=-1) for b in blocks]
    return np.concatenate([np.empty((0, width), dtype=int), *wide]).astype(int)


def _concave(ring: FloatArray) -> np.ndarray:
    """(m,) whether polygons (m, n, 3) have a corner that points inwards."""
    out, into = np.roll(ring, -1, axis=1) - ring, ring - np.roll(ring, 1, axis=1)
    turn = np.cross(into, out)
    return (np.einsum("mni,mi->mn", turn, turn.sum(1)) < 0).any(1)


def _clipped(ring: FloatArray) -> IntArray:
    """Triangles (n - 2, 3) of a plane polygon (n, 3) with corners that point inwards."""
    import shapely

    n = len(ring)
    fan = np.array([[0, i, i + 1] for i in range(1, n - 1)])
    normal = np.cross(ring[1:-1] - ring[0], ring[2:] - ring[0]).sum(0)
    plan = np.delete(ring, np.abs(normal).argmax(), axis=1)
    polygon = shapely.Polygon(plan)
    if not polygon.is_valid:
        return fan
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    place = {tuple(point): k for k, point in enumerate(plan.tolist())}
    rows = [[place.get(tuple(p), -1) for p in part.exterior.coords[:3]] for part in parts]
    if len(rows) != n - 2 or np.min(rows) < 0:
        return fan
    cut = np.array(rows)
    a, b, c = ring[cut].transpose(1, 0, 2)
    turned = np.cross(b - a, c - a) @ normal < 0
    return np.where(turned[:, None], cut[:, ::-1], cut)
