"""Shell elements with their labels, as structural codes number them, and their files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..checks import InputError, check_file, check_number, naming
from ..result.sheet import CORNERS as CELLS
from ..result.sheet import FormedSheet
from ..tools.surface_file import read_mesh

FloatArray = np.ndarray
CORNERS = dict.fromkeys("S3 STRI3 STRI65 M3D3 SFM3D3 CPS3 CPE3 R3D3".split(), 3)
CORNERS |= dict.fromkeys("S4 S8 S9 M3D4 SFM3D4 CPS4 CPE4 R3D4".split(), 4)


@dataclass(frozen=True, eq=False)
class Shells:
    """Shell elements with labels."""

    points: FloatArray  # (n, 3), mm
    nodes: np.ndarray  # (n,) labels
    corners: np.ndarray  # (m, 4) rows of `points`; the last is -1 in a triangle
    elements: np.ndarray  # (m,) labels

    @classmethod
    def counted(cls, points: FloatArray, corners: np.ndarray) -> Shells:
        """Elements of three or four corners, (m, 3) or (m, 4), labelled from 1."""
        corners = np.pad(corners, ((0, 0), (0, 4 - corners.shape[1])), constant_values=-1)
        return cls(points, 1 + np.arange(len(points)), corners, 1 + np.arange(len(corners)))

    @property
    def triangular(self) -> np.ndarray:
        """(m,) bool."""
        return self.corners[:, 3] < 0

    @property
    def centroids(self) -> FloatArray:
        """(m, 3) means of the corners, mm."""
        total, last = self.points[self.corners[:, :3]].sum(1), self.points[self.corners[:, 3]]
        return np.where(self.triangular[:, None], total / 3, (total + last) / 4)

    @property
    def normals(self) -> FloatArray:
        """(m, 3) unit normals, right-handed about the corners."""
        a, b, c, d = self.points[self.corners].transpose(1, 0, 2)
        n = np.where(self.triangular[:, None], np.cross(b - a, c - a), np.cross(c - a, d - b))
        length = np.linalg.norm(n, axis=1)[:, None]
        if not (length > 0).all():
            raise InputError(f"element {self.elements[int(length.argmin())]} has no area")
        return n / length

    def split(self) -> tuple[np.ndarray, np.ndarray]:
        """Triangles (k, 3), quadrilaterals in two, and the row (k,) of each one's element."""
        quads = np.flatnonzero(~self.triangular)
        triangles = np.concatenate([self.corners[:, :3], self.corners[quads][:, [0, 2, 3]]])
        return triangles, np.concatenate([np.arange(len(self.corners)), quads])

    def at_nodes(self, values: FloatArray) -> FloatArray:
        """(n,) means, weighted by area, of (m,) values; nan where none is known."""
        triangles, rows = self.split()
        return FormedSheet(self.points, triangles).at_nodes(values[rows])


def read_shells(path: str | Path, scale: float = 1.0) -> Shells:
    """Read the shell elements of a structural mesh: .inp, or what meshio reads.

    `scale` is mm per unit of its lengths. Of elements of higher order only the corners count.
    """
    path = Path(path)
    with naming(path):
        check_file(path)
        check_number("scale", scale)
        if path.suffix.lower() == ".inp":
            shells = read_inp(path, ("INCLUDE", "INSTANCE"))
        else:
            mesh, rows = read_mesh(path), [np.empty((0, 4), dtype=int)]
            for block in mesh.cells:
                if corners := CELLS.get(block.type):
                    cells = np.asarray(block.data)[:, :corners]
                    rows.append(np.pad(cells, ((0, 0), (0, 4 - corners)), constant_values=-1))
            shells = Shells.counted(mesh.points, np.concatenate(rows))
        if not len(shells.elements):
            raise InputError("no triangles or quadrilaterals")
        if not np.isfinite(shells.points).all():
            raise InputError("not all points are finite numbers")
        shells = replace(shells, points=scale * shells.points)
        shells.normals  # noqa: B018  (refuses an element without an area)
        return shells


def read_inp(path: Path, refused: tuple[str, ...] = ("INCLUDE",)) -> Shells:
    """Read the nodes and shell elements of an .inp file; rigid ones only if there are no others.

    A file with a `refused` keyword, and any defect, raises InputError with the number of the line.
    """
    nodes: dict[int, list[float]] = {}
    cells: tuple[dict[int, list[int]], ...] = {}, {}  # others, rigid
    text = path.read_text(encoding="utf-8", errors="replace")
    for number, corners, rigid, row in _rows(text, refused):
        if len(row) < (corners + 1 if corners else 2):
            raise InputError(f"line {number}: too few numbers: {row}")
        table, label = cells[rigid] if corners else nodes, int(row[0])
        if label in table:
            remedy = "write the model without parts and instances"
            raise InputError(f"line {number}: the label {label} repeats: {remedy}")
        values = [int(v) for v in row[1 : corners + 1]] if corners else [*row[1:4], 0.0, 0.0][:3]
        table[label] = values
    if not nodes:
        raise InputError("no *NODE")
    chosen, place = cells[0] or cells[1], {label: i for i, label in enumerate(nodes)}
    try:
        rows = [[*(place[v] for v in cell), *[-1] * (4 - len(cell))] for cell in chosen.values()]
    except KeyError as error:
        raise InputError(f"an element refers to node {error}, which is not there") from None
    points, corners = np.reshape(list(nodes.values()), (-1, 3)), np.reshape(rows, (-1, 4))
    labels = np.array(list(nodes), dtype=int), np.array(list(chosen), dtype=int)
    return Shells(points, labels[0], corners.astype(int), labels[1])


def _rows(text: str, refused: tuple[str, ...]) -> Iterator[tuple[int, int, bool, list[float]]]:
    """Numbers after *NODE and *ELEMENT: line, corners (0 for nodes), whether rigid, the numbers."""
    wanted, corners, kind = False, 0, ""
    row: list[float] = []
    for number, line in enumerate(map(str.strip, text.splitlines()), 1):
        if line.startswith("*") and not line.startswith("**"):
            keyword, *words = (word.strip().upper() for word in line[1:].split(","))
            if keyword in refused:
                remedy = "put the mesh into one file"
                raise InputError(f"line {number}: *{keyword} is not followed: {remedy}")
            kind = next((w.partition("=")[2].strip() for w in words if w[:4] == "TYPE"), "")
            named = [name for name in CORNERS if kind.startswith(name)]
            corners = CORNERS[max(named, key=len)] if named and keyword == "ELEMENT" else 0
            wanted, row = keyword == "NODE" or corners > 0, []
        elif wanted and line and not line.startswith("**"):
            try:
                row += [float(word) for word in line.split(",") if word.strip()]
            except ValueError:
                raise InputError(f"line {number}: not numbers: {line!r}") from None
            if not line.endswith(","):
                yield number, corners, kind.startswith("R3D"), row
                row = []
