"""The mesh that directions are handed over to: the formed one, or the user's structural mesh.

Element and node numbers of an .inp file are kept; elsewhere both count from 1.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..checks import InputError, check_file, check_number
from ..comparison.mesh_file import INP_CORNERS
from ..tools.surface_file import read_mesh

FloatArray = np.ndarray
CELLS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}


@dataclass(frozen=True, eq=False)
class Target:
    """Shell elements with labels.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    nodes : (n,) int array
        Labels.
    corners : (m, 4) int array
        Rows of `points`; the last is -1 in a triangle.
    elements : (m,) int array
        Labels.
    """

    points: FloatArray
    nodes: np.ndarray
    corners: np.ndarray
    elements: np.ndarray

    @property
    def triangular(self) -> np.ndarray:
        """(m,) bool."""
        return self.corners[:, 3] < 0

    @property
    def centroids(self) -> FloatArray:
        """(m, 3) means of the corners, mm."""
        total = self.points[self.corners[:, :3]].sum(1)
        return np.where(
            self.triangular[:, None], total / 3, (total + self.points[self.corners[:, 3]]) / 4
        )

    @property
    def normals(self) -> FloatArray:
        """(m, 3) unit normals, right-handed about the corners."""
        a, b, c, d = self.points[self.corners].transpose(1, 0, 2)
        n = np.where(self.triangular[:, None], np.cross(b - a, c - a), np.cross(c - a, d - b))
        length = np.linalg.norm(n, axis=1)[:, None]
        if not (length > 0).all():
            at = self.elements[int(length.argmin())]
            raise InputError(f"element {at} has no area")
        return n / length


def of_triangles(points: FloatArray, triangles: np.ndarray) -> Target:
    """Target of a mesh of triangles, counted from 1."""
    corners = np.pad(triangles, ((0, 0), (0, 1)), constant_values=-1)
    return Target(points, 1 + np.arange(len(points)), corners, 1 + np.arange(len(triangles)))


def read_target(path: str | Path, scale: float = 1.0) -> Target:
    """Read the shell elements of a structural mesh.

    Parameters
    ----------
    path : path
        .inp, or what meshio reads. Of elements of higher order only the corners count.
    scale : float
        mm per unit of its lengths.

    Raises
    ------
    InputError
        Naming the file and its defect.
    """
    path = Path(path)
    try:
        check_file(path)
        check_number("scale", scale)
        target = _abaqus(path) if path.suffix.lower() == ".inp" else _meshio(path)
        if not len(target.elements):
            raise InputError("no triangles or quadrilaterals")
        if not np.isfinite(target.points).all():
            raise InputError("not all points are finite numbers")
        target = Target(scale * target.points, target.nodes, target.corners, target.elements)
        target.normals  # noqa: B018  (refuses an element without an area)
        return target
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _meshio(path: Path) -> Target:
    mesh = read_mesh(path)
    rows = [np.empty((0, 4), dtype=int)]
    for block in mesh.cells:
        if corners := CELLS.get(block.type):
            cells = np.asarray(block.data)[:, :corners]
            rows.append(np.pad(cells, ((0, 0), (0, 4 - corners)), constant_values=-1))
    cells = np.concatenate(rows)
    points = np.pad(np.asarray(mesh.points, float), ((0, 0), (0, 3 - mesh.points.shape[1])))
    return Target(points, 1 + np.arange(len(points)), cells, 1 + np.arange(len(cells)))


def _abaqus(path: Path) -> Target:
    nodes: dict[int, list[float]] = {}
    cells: dict[int, list[int]] = {}
    into, corners, row = "", 0, []
    for k, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*"):
            words = [word.strip().upper() for word in line[1:].split(",")]
            into, row = words[0], []
            if into in ("INCLUDE", "INSTANCE"):
                raise InputError(f"line {k}: *{into} is not followed: put the mesh into one file")
            kind = next((re.sub(r"TYPE\s*=\s*", "", w) for w in words if w[:4] == "TYPE"), "")
            corners = max(
                ((len(n), c) for n, c in INP_CORNERS.items() if kind.startswith(n)),
                default=(0, 0),
            )[1]
            continue
        if into != "NODE" and not (into == "ELEMENT" and corners):
            continue
        try:
            row += [float(word) for word in line.split(",") if word.strip()]
        except ValueError:
            raise InputError(f"line {k}: not numbers: {line!r}") from None
        if line.endswith(","):
            continue
        if len(row) < (2 if into == "NODE" else corners + 1):
            raise InputError(f"line {k}: too few numbers: {line!r}")
        label = int(row[0])
        if label in (nodes if into == "NODE" else cells):
            raise InputError(f"line {k}: the label {label} repeats: write one part only")
        if into == "NODE":
            nodes[label] = [*row[1:4], 0.0, 0.0][:3]
        else:
            cells[label] = [int(v) for v in row[1 : corners + 1]]
        row = []
    place = {label: i for i, label in enumerate(nodes)}
    try:
        rows = [[*(place[v] for v in cell), *[-1] * (4 - len(cell))] for cell in cells.values()]
    except KeyError as error:
        raise InputError(f"an element refers to node {error}, which is not there") from None
    return Target(
        np.array(list(nodes.values())).reshape(-1, 3),
        np.array(list(nodes), dtype=int),
        np.array(rows, dtype=int).reshape(-1, 4),
        np.array(list(cells), dtype=int),
    )
