"""A formed mesh with its fields, as other codes write it: VTU, VTK, XDMF, or Abaqus .inp and CSV.

Only surface cells count: triangles, and quadrilaterals, which are split; of those of higher order
the corners. Solid cells are tools and are left out, and so are Abaqus' rigid elements beside others
and nodes that belong to nothing else.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..checks import InputError
from ..tables import read_table

FloatArray = np.ndarray
READERS = {".vtu": meshio.vtu, ".vtk": meshio.vtk, ".xdmf": meshio.xdmf, ".xmf": meshio.xdmf}
CORNERS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}
SPLIT = {3: [[0, 1, 2]], 4: [[0, 1, 2], [0, 2, 3]]}
INP_CORNERS = {"S3": 3, "STRI3": 3, "STRI65": 3, "M3D3": 3, "SFM3D3": 3, "CPS3": 3, "CPE3": 3}
INP_CORNERS |= {
    "R3D3": 3,
    "R3D4": 4,
    "S4": 4,
    "S8": 4,
    "S9": 4,
    "M3D4": 4,
    "SFM3D4": 4,
    "CPS4": 4,
    "CPE4": 4,
}
NAMED = ("node", "element", "u1", "u2", "u3")


@dataclass(frozen=True, eq=False)
class Fields:
    """Points, triangles and fields of a file, as they stand there.

    Parameters
    ----------
    points : (n, 3) array
    triangles : (m, 3) int array
    by_point, by_triangle : dict of name to (n, ...) and (m, ...) arrays
    loose : dict of name to float
        Single numbers of the file, such as energies.
    time : float, optional
    """

    points: FloatArray
    triangles: np.ndarray
    by_point: dict[str, FloatArray] = field(default_factory=dict)
    by_triangle: dict[str, FloatArray] = field(default_factory=dict)
    loose: dict[str, float] = field(default_factory=dict)
    time: float | None = None


def read_fields(path: Path, values: Path | None = None, wanted: str = "") -> list[Fields]:
    """Read a file; of a series in time its states.

    Parameters
    ----------
    path : path
    values : path, optional
        CSV of values by node or element label, for an .inp file: angle, u1, u2, u3.
    wanted : str
        Heading of the angle in `values`.

    Raises
    ------
    InputError
        Naming the file and its defect.
    """
    kind = path.suffix.lower()
    try:
        with path.open("rb"):  # a missing file is told here
            pass
        if kind == ".inp":
            return [_abaqus(path, values, wanted)]
        if values is not None:
            raise InputError(f"values by label belong to an .inp file, not to {kind}")
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return [_surface(mesh, time) for mesh, time in _meshes(path, kind)]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except InputError as error:
        named = str(error).startswith(str(values))
        raise InputError(str(error) if named else f"{path}: {error}") from error
    except ImportError as error:
        raise InputError(
            f"{path}: its numbers are in HDF5, which needs h5py: pip install h5py"
        ) from error
    except (Exception, SystemExit) as error:  # whatever meshio's parsers meet
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a readable {kind} file: {reason}") from error


def _meshes(path: Path, kind: str) -> Iterator[tuple[meshio.Mesh, float | None]]:
    if READERS[kind] is meshio.xdmf and b"<Time" in path.read_bytes():
        with meshio.xdmf.TimeSeriesReader(path) as reader:
            points, cells = reader.read_points_cells()
            for k in range(reader.num_steps):
                time, by_point, by_cell = reader.read_data(k)
                yield meshio.Mesh(points, cells, by_point, by_cell), time
    else:
        yield READERS[kind].read(path), None


def _surface(mesh: meshio.Mesh, time: float | None) -> Fields:
    triangles, chosen = [np.empty((0, 3), dtype=int)], []
    for block in mesh.cells:
        rows = np.empty(0, dtype=int)
        if corners := CORNERS.get(block.type, 0):
            for split in SPLIT[corners]:
                triangles.append(block.data[:, split])
            rows = np.tile(np.arange(len(block.data)), len(SPLIT[corners]))
        chosen.append(rows)
    by_triangle = {
        name: np.concatenate([np.asarray(v)[rows] for v, rows in zip(blocks, chosen, strict=True)])
        for name, blocks in mesh.cell_data.items()
    }
    points = np.asarray(mesh.points, dtype=float)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    loose = {
        name: float(np.ravel(value)[-1])
        for name, value in mesh.field_data.items()
        if np.issubdtype(np.asarray(value).dtype, np.number) and np.size(value)
    }
    return _used(points, np.concatenate(triangles), dict(mesh.point_data), by_triangle, loose, time)


def _used(
    points: FloatArray,
    triangles: np.ndarray,
    by_point: dict[str, FloatArray],
    by_triangle: dict[str, FloatArray],
    loose: dict[str, float],
    time: float | None = None,
) -> Fields:
    """Leave out nodes without a triangle."""
    if not len(triangles):
        raise InputError("no triangles or quadrilaterals")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError("a triangle refers to a point that is not there")
    used, triangles = np.unique(triangles, return_inverse=True)
    if not np.isfinite(points[used]).all():
        raise InputError("not all points are finite numbers")
    kept = {name: np.asarray(values)[used] for name, values in by_point.items()}
    return Fields(points[used], triangles.reshape(-1, 3), kept, by_triangle, loose, time)


def _abaqus(path: Path, values: Path | None, wanted: str) -> Fields:
    """Nodes and surface elements of an .inp file, in all its blocks, with values by label."""
    node_rows: list[list[float]] = []
    elements: dict[bool, list[tuple[int, list[list[float]]]]] = {True: [], False: []}
    into: list[list[float]] | None = None
    going_on = False
    for k, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*"):
            words = [word.strip().upper() for word in line[1:].split(",")]
            kind = next((w.split("=")[1].strip() for w in words if w.startswith("TYPE")), "")
            into, going_on = None, False
            if words[0] == "NODE":
                into = node_rows
            elif words[0] == "ELEMENT" and (corners := _inp_corners(kind)):
                into = []
                elements[kind.startswith("R3D")].append((corners, into))
            elif words[0] == "INCLUDE":
                raise InputError(f"line {k}: *INCLUDE is not followed: put nodes into one file")
        elif into is not None:
            try:
                row = [float(word) for word in line.split(",") if word.strip()]
            except ValueError:
                raise InputError(f"line {k}: not numbers: {line!r}") from None
            if going_on:
                into[-1] += row
            else:
                into.append(row)
            going_on = line.endswith(",")
    if not node_rows:
        raise InputError("no *NODE")
    labels = np.array([row[0] for row in node_rows], dtype=int)
    if len(set(labels.tolist())) < len(labels):
        raise InputError("node labels repeat: write the model without parts and instances")
    points = np.array([[*row[1:4], 0.0, 0.0][:3] for row in node_rows])
    place = {label: i for i, label in enumerate(labels.tolist())}
    triangles, names = [np.empty((0, 3), dtype=int)], [np.empty(0, dtype=int)]
    for corners, rows in elements[False] or elements[True]:
        try:
            cells = np.array([[place[int(v)] for v in row[1 : corners + 1]] for row in rows])
        except KeyError as error:
            raise InputError(f"an element refers to node {error}, which is not there") from None
        for split in SPLIT[corners]:
            triangles.append(cells.reshape(-1, corners)[:, split])
            names.append(np.array([row[0] for row in rows], dtype=int))
    by_point, by_triangle = {}, {}
    if values is not None:
        table = read_table(values, wanted)
        columns = {name: column for name, column in table.items() if name not in NAMED}
        key = next((name for name in ("node", "element") if name in table), None)
        if key is None:
            raise InputError(f"{values}: no column of node or element labels ('node', 'element')")
        if all(f"u{i}" in table for i in (1, 2, 3)):
            columns["displacement"] = np.column_stack([table[f"u{i}"] for i in (1, 2, 3)])
        asked = labels if key == "node" else np.concatenate(names)
        into = by_point if key == "node" else by_triangle
        for name, column in columns.items():
            into[name] = _by_label(asked, table[key].astype(int), column)
    return _used(points, np.concatenate(triangles), by_point, by_triangle, {})


def _inp_corners(kind: str) -> int:
    return max(
        ((len(name), n) for name, n in INP_CORNERS.items() if kind.startswith(name)),
        default=(0, 0),
    )[1]


def _by_label(asked: np.ndarray, labels: np.ndarray, column: Any) -> FloatArray:
    """Values of a column at labels; nan where it has none."""
    order = np.argsort(labels, kind="stable")
    at = np.searchsorted(labels, asked, sorter=order).clip(0, len(labels) - 1)
    row = order[at]
    found = np.array(column, dtype=float)[row]
    found[labels[row] != asked] = np.nan
    return found
