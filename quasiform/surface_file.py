"""Triangles of a surface from a file: STL, OBJ, PLY, VTU, VTK, MSH, and CAD through gmsh.

Files come from strangers: nothing in them is executed, and reading writes nothing.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import meshio
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .checks import InputError, check_number

FloatArray = np.ndarray
Surface = tuple[FloatArray, np.ndarray]

MESHES = {
    ".stl": meshio.stl,
    ".obj": meshio.obj,
    ".ply": meshio.ply,
    ".vtu": meshio.vtu,
    ".vtk": meshio.vtk,
    ".msh": meshio.gmsh,
}
CAD = {
    ".step": "step",
    ".stp": "step",
    ".iges": "iges",
    ".igs": "iges",
    ".brep": "brep",
    ".geo": "geo",
}
MERGED = 1e-6  # vertices nearer than this share of the surface's size are one
FACETS = 120  # on a full circle; a CAD surface's facets are 1/200 to 1/60 of its size
SEWN = 1e-3  # mm; gaps between the faces of an IGES file
# What makes a .geo file do more than describe a shape: run programs, read, write or end
_ACTIVE = (
    "System SystemCall NonBlockingSystemCall OnelabRun OnelabAction Include Merge "
    "MergeWithBoundingBox ShapeFromFile ListFromFile Save Print Printf SendToServer CreateDir "
    "Plugin ExternalProcess Exit Abort Call Macro Function StringToName S2N NameToString N2S "
    "GetEnv GetString GmshExecutableName General Solver PostProcessing View"
).split()
_COMMENT = re.compile(r'("[^"\n]*"|\'[^\'\n]*\')|//[^\n]*|/\*.*?\*/', re.DOTALL)
_TEXT = re.compile(
    r'SetFactory\s*\(\s*"(OpenCASCADE|Built-in)"\s*\)|Physical\s+\w+\s*\(\s*"[\w .-]{1,99}"'
)


def read_surface(path: str | Path, scale: float = 1.0) -> Surface:
    """Read a surface; nothing is printed and no file is left behind.

    STL, OBJ, PLY, VTU, VTK and MSH are read as they are: quadrilaterals are split, other cells
    ignored. STEP and IGES (in mm by their own unit), BREP and GEO are meshed by gmsh, finer where
    they are curved. A .geo file is a program: one that could do more than describe a shape (run
    programs, read or write files, end the process) is refused.

    Parameters
    ----------
    path : path
    scale : float
        mm per unit of the file.

    Returns
    -------
    vertices : (n, 3) array
        mm; those that coincide are merged.
    triangles : (m, 3) array
        Vertices in the order that turns about the outward normal; none degenerate.

    Raises
    ------
    InputError
        For a file that cannot be read, naming it.
    """
    path = Path(path)
    kind = path.suffix.lower()
    with naming(path):
        check_number("scale", scale)
        if kind not in {**MESHES, **CAD}:
            known = ", ".join([*MESHES, *CAD])
            raise InputError(f"unknown kind of surface '{kind}': expected one of {known}")
        with path.open("rb"):  # a missing file is told here, whoever reads it
            pass
        vertices, triangles = _read_cad(path, CAD[kind]) if kind in CAD else _read_mesh(path, kind)
        vertices, triangles = _merged(scale * vertices, triangles)
        return vertices, _oriented(vertices, triangles) if kind in CAD else triangles


def _read_mesh(path: Path, kind: str) -> Surface:
    if kind == ".ply" and not re.search(rb"^end_header\s*$", path.read_bytes(), re.MULTILINE):
        raise InputError("not a readable .ply file: no end_header")  # meshio would not end either
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = MESHES[kind].read(str(path))
    except Exception as error:  # whatever meshio's parsers meet
        raise InputError(f"not a readable {kind} file: {_line(error)}") from error
    splits = {"triangle": [[0, 1, 2]], "quad": [[0, 1, 2], [0, 2, 3]]}
    parts = [block.data[:, split] for block in mesh.cells for split in splits.get(block.type, [])]
    return np.asarray(mesh.points, float), np.concatenate([np.empty((0, 3), int), *parts])


def _read_cad(path: Path, kind: str) -> Surface:
    program = path.read_text(encoding="utf-8", errors="replace") if kind == "geo" else ""
    program = _only_shape(program)
    gmsh = optional("gmsh", "cad", f"a {path.suffix} file needs gmsh")
    if gmsh.isInitialized():
        raise InputError("gmsh is in use by the calling program: finalize it first")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        if kind == "geo":
            # what was checked, away from a .geo.opt beside the file, which gmsh would run too
            with TemporaryDirectory() as folder:
                checked = Path(folder, "tool.geo")
                checked.write_text(program, encoding="utf-8")
                gmsh.merge(str(checked))
        else:
            with _silent():
                gmsh.model.occ.importShapes(str(path), format=kind)
                if kind == "iges":  # its faces do not know their neighbours
                    gmsh.model.occ.healShapes(tolerance=SEWN)
            gmsh.model.occ.synchronize()
        box = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
        size = float(np.linalg.norm(box[1] - box[0]))
        sizes = {"FromCurvature": FACETS, "Min": size / 200, "Max": size / 60}
        sizes["ExtendFromBoundary"] = 0
        for option, value in sizes.items():
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", value)
        gmsh.option.setNumber("Mesh.ElementOrder", 1)
        gmsh.option.setNumber("Mesh.RecombineAll", 0)
        gmsh.model.mesh.generate(2)
        tags, points, _ = gmsh.model.mesh.getNodes()
        nodes = gmsh.model.mesh.getElementsByType(2)[1]
    except Exception as error:  # all that gmsh raises
        reason = re.sub(r"'\S*[/\\]", "'", _line(error))  # without the temporary folder
        raise InputError(f"gmsh cannot read it: {reason}") from error
    finally:
        gmsh.finalize()
    order = np.argsort(tags)
    triangles = order[np.searchsorted(tags, nodes, sorter=order)].reshape(-1, 3)
    return points.reshape(-1, 3), triangles


def _only_shape(program: str) -> str:
    """Return a .geo program without comments if all it can do is describe a shape."""
    program = _COMMENT.sub(lambda found: found[1] or found[0].count("\n") * "\n" or " ", program)
    for word in re.findall(r"\w+", program):
        if word in _ACTIVE:
            raise InputError(f"'{word}' is refused in a .geo file, which may only describe a shape")
    if text := re.search("[\"'].*", _TEXT.sub("", program)):
        raise InputError(f"text is refused in a .geo file but for names of groups: {text[0]}")
    return program


def _merged(vertices: FloatArray, triangles: np.ndarray) -> Surface:
    """Merge vertices that coincide, drop triangles that lose a side and vertices without any."""
    check_numbers(vertices, triangles)
    pairs = cKDTree(vertices).query_pairs(
        MERGED * np.ptp(vertices, axis=0).max(), output_type="ndarray"
    )
    n = len(vertices)
    near = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    same = connected_components(near, directed=False)[1]
    _, first = np.unique(same, return_index=True)
    triangles = same[triangles]
    sides = triangles != np.roll(triangles, 1, axis=1)
    used, triangles = np.unique(triangles[sides.all(1)], return_inverse=True)
    return vertices[first][used], triangles.reshape(-1, 3).astype(np.int64)


def _oriented(vertices: FloatArray, triangles: np.ndarray) -> np.ndarray:
    """Turn triangles of CAD faces, whose sense may be arbitrary, alike and outwards if closed."""
    igl = optional("igl", "surface", "a tool from a file needs libigl")
    alike, patch = igl.bfs_orient(triangles)
    corners = vertices[alike]
    area = np.linalg.norm(normals_of(corners), axis=1)
    kept = (alike == triangles).all(1)
    turned = np.bincount(patch, np.where(kept, area, -area))[patch] < 0  # the majority stays
    if (edges_of(triangles)[1] == 2).all():
        turned = np.bincount(patch, np.linalg.det(corners - vertices.mean(0)))[patch] < 0
    return np.where(turned[:, None], alike[:, ::-1], alike)


def check_numbers(vertices: FloatArray, triangles: np.ndarray) -> None:
    """Refuse coordinates that are not finite, and a surface without triangles."""
    if len(triangles) == 0:
        raise InputError("no triangles")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError("a triangle refers to a vertex that is not there")
    if not np.isfinite(vertices).all():
        wrong = len(vertices) - np.isfinite(vertices).all(1).sum()
        raise InputError(f"{wrong} vertices are not finite numbers")


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def optional(module: str, extra: str, need: str) -> Any:
    """Import an optional package, or say how to install it."""
    try:
        return import_module(module)
    except (ImportError, OSError) as error:  # OSError: gmsh without the system's libraries
        raise InputError(f"{need}: pip install 'quasiform[{extra}]'") from error


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what is printed below Python (by gmsh's OpenCASCADE) from the standard output."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name the file in every refusal."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def edges_of(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (k, 2), how many triangles share each, and the sum of the senses (±1) they run in."""
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    key = ends.min(1) * (ends.max() + 1) + ends.max(1)
    _, first, index, count = np.unique(
        key, return_index=True, return_inverse=True, return_counts=True
    )
    return ends[first], count, np.bincount(index, np.sign(ends[:, 1] - ends[:, 0]))


def normals_of(corners: FloatArray) -> FloatArray:
    """Normals (m, 3) of triangles (m, 3, 3), as long as twice their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
