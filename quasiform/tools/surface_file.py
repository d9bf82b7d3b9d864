"""Triangles of a surface from a file: STL, OBJ, PLY, OFF, VTU, VTK, MSH, and CAD through gmsh.

Files are not trusted: nothing in them is executed, and reading writes nothing.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO, StringIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, check_file, check_number, naming, optional
from .mending import check_numbers, merged, oriented, without_defects

if TYPE_CHECKING:
    import meshio
    from scipy.spatial.transform import Rotation

FloatArray = np.ndarray
Surface = tuple[FloatArray, np.ndarray]
Vector = tuple[float, float, float]

MESHIO = {".ply": "ply", ".off": "off", ".vtu": "vtu", ".vtk": "vtk", ".msh": "gmsh"}
CAD = {".step": "step", ".stp": "step", ".iges": "iges", ".igs": "iges", ".brep": "brep"}
KINDS = (".stl", ".obj", *MESHIO, *CAD)
MEMORY = 500_000_000  # bytes for reading a mesh, beside a hundred times its file
PATIENCE = 120.0  # s, for a CAD file
CUT_OFF = "the file is cut off, {}: export or copy it anew"
CAD_MESH = Path(__file__).with_name("cad.py")


@dataclass(frozen=True)
class SurfaceFile:
    """A tool's surface in a file. A point p of it comes to R (scale p - origin)."""

    path: Path
    scale: float = 1.0  # mm per unit of the file
    flip: bool = False  # whether the normals are turned round
    rotate: Vector = (0.0, 0.0, 0.0)  # R, degrees about the fixed axes x, y, z, in this order
    origin: Vector = (0.0, 0.0, 0.0)  # point of the file, mm, that becomes the tool's origin
    spacing: float | None = None  # of the grid of its distance, mm

    def placed(self) -> tuple[FloatArray, np.ndarray, list[str]]:
        """Vertices and triangles as `read_surface`, in the tool's frame, and what was repaired."""
        vertices, triangles, merging = _read(self.path, self.scale)
        with naming(self.path):
            triangles, repairs = without_defects(vertices, triangles)
        vertices = self._turn.apply(vertices - self.origin)
        return vertices, triangles[:, :: -1 if self.flip else 1], merging + repairs

    def moved_origin(self, dx: float, dy: float) -> str:
        """The `origin` that moves the placed surface by -dx and -dy (mm), as a scene's line."""
        origin = np.round(np.add(self.origin, self._turn.inv().apply([dx, dy, 0.0])), 6) + 0.0
        return "origin = [{:.4g}, {:.4g}, {:.4g}]".format(*origin)

    @property
    def _turn(self) -> Rotation:
        from scipy.spatial.transform import Rotation

        return Rotation.from_euler("xyz", self.rotate, degrees=True)


def read_surface(path: str | Path, scale: float = 1.0) -> Surface:
    """Read a surface; nothing is printed and no file is left behind.

    Polygons are split into triangles, other cells ignored. STEP and IGES (in mm by their own unit)
    and BREP are meshed by gmsh, finer where they are curved. `scale` is mm per unit of the file.

    Returns vertices (n, 3), mm, those that coincide merged, and triangles (m, 3), turning about the
    outward normal, none degenerate. InputError names a file that cannot be read.
    """
    return _read(path, scale)[:2]


def _read(path: str | Path, scale: float) -> tuple[FloatArray, np.ndarray, list[str]]:
    path = Path(path)
    kind = path.suffix.lower()
    with naming(path):
        check_number("scale", scale)
        if kind not in KINDS:
            known = ", ".join(KINDS)
            raise InputError(f"unknown kind of surface '{kind}': expected one of {known}")
        check_file(path)
        vertices, triangles = _read_cad(path, CAD[kind]) if kind in CAD else _read_mesh(path, kind)
        check_numbers(vertices, triangles)
        vertices, triangles, repairs = merged(scale * vertices, triangles)
        return vertices, oriented(vertices, triangles) if kind in CAD else triangles, repairs


def _read_mesh(path: Path, kind: str) -> Surface:
    """Vertices and triangles of a mesh, its polygons split."""
    content = path.read_bytes()
    if kind == ".ply" and not re.search(rb"^end_header\s*$", content, re.MULTILINE):
        raise InputError("not a readable .ply file: no end_header")  # meshio would not end either
    if kind in MESHIO:
        mesh = read_mesh(path, MESHIO[kind])
        kinds = ("triangle", "quad", "polygon")
        faces = [block.data for block in mesh.cells if block.type in kinds]
        fans = [face[:, [0, i, i + 1]] for face in faces for i in range(1, face.shape[1] - 1)]
        return mesh.points, np.concatenate(fans or [np.empty((0, 3), int)])
    if kind == ".obj":
        with _reading(path):
            return _read_obj(content)
    trimesh = optional("trimesh", "surface", "an .stl file needs trimesh")
    content = _whole_stl(content)
    with _reading(path):
        mesh = trimesh.load_mesh(BytesIO(content), file_type="stl", process=False)
        return np.array(mesh.vertices, float), np.array(mesh.faces)


def _read_obj(content: bytes) -> Surface:
    """Vertices and faces of an OBJ file; negative numbers count back from the last vertex."""
    points: list[list[float]] = []
    fans: list[tuple[int, int, int]] = []
    text = content.decode("latin-1").replace("\r", "\n")
    for line in re.sub(r"\\\n+", " ", text).split("\n"):
        key, *words = line.split("#")[0].split() or [""]
        if key == "v":
            x, y, z = map(float, words[:3])  # a weight or colours may follow
            points.append([x, y, z])
        elif key == "f":
            numbers = [int(word.split("/")[0]) for word in words]
            face = [k - 1 if k > 0 else len(points) + k if k < 0 else -1 for k in numbers]
            fans += [(face[0], b, c) for b, c in pairwise(face[1:])]
    return np.reshape(points, (-1, 3)), np.array(fans, dtype=int).reshape(-1, 3)


def _whole_stl(content: bytes) -> bytes:
    """Return an STL file without what follows its triangles; refuse one that ends too early."""
    if b"\0" not in content:  # a name may hold any letters; binary triangles hold zeros
        lower = content.lower()
        if content and b"facet" not in lower:
            raise InputError("not a readable .stl file: could not find a facet")
        if content and b"endsolid" not in lower[-1000:]:
            raise InputError(CUT_OFF.format("without endsolid at its end"))
        return content
    there = len(content[84:]) // 50
    count = int.from_bytes(content[80:84], "little") or there
    if there < count:
        what = f"{there} triangles of the {count} that its head promises"
        raise InputError(CUT_OFF.format(what))
    return content[:80] + count.to_bytes(4, "little") + content[84 : 84 + 50 * count]


def read_mesh(path: Path, kind: str | None = None) -> meshio.Mesh:
    """Read a mesh, its points (n, 3), by meshio, in the format `kind` or that of the suffix."""
    reader = import_module(f"meshio.{kind}" if kind else "meshio")
    with _reading(path):
        mesh = reader.read(str(path))
    if mesh.points.ndim != 2 or mesh.points.shape[1] not in (2, 3):
        raise InputError("the points have no two or three coordinates")
    mesh.points = np.pad(np.asarray(mesh.points, float), ((0, 0), (0, 3 - mesh.points.shape[1])))
    return mesh


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Silence a reader that prints and warns; what it raises or exits with is an InputError."""
    try:
        silent = redirect_stdout(StringIO()), redirect_stderr(StringIO())
        with silent[0], silent[1], warnings.catch_warnings(), _enough_memory(path.stat().st_size):
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read to its end")
            yield
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        reason = "" if isinstance(error, SystemExit) else f": {reason}"
        raise InputError(f"not a readable {path.suffix.lower()} file{reason}") from error


@contextmanager
def _enough_memory(size: int) -> Iterator[None]:
    """Let a damaged count in a file of `size` bytes end in a MemoryError, where Linux can."""
    try:
        resource = import_module("resource")
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    least = min([used + MEMORY + 100 * size, *limits])
    resource.setrlimit(resource.RLIMIT_AS, (least, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _read_cad(path: Path, kind: str) -> Surface:
    gmsh = optional("gmsh", "cad", f"a {path.suffix} file needs gmsh")
    if gmsh.isInitialized():
        raise InputError("gmsh is in use by the calling program: finalize it first")
    with TemporaryDirectory() as folder:
        out = Path(folder, "mesh.npz")
        try:
            run = subprocess.run(
                [sys.executable, "-P", CAD_MESH, path.absolute(), kind, out],
                cwd=folder,
                env=os.environ | {"HOME": folder},  # gmsh leaves a folder there
                capture_output=True,
                stdin=subprocess.DEVNULL,
                timeout=PATIENCE,
            )
        except subprocess.TimeoutExpired as error:
            raise InputError(f"gmsh cannot read it within {PATIENCE:g} s") from error
        if run.returncode:
            said = run.stderr.decode(errors="replace").strip() if run.returncode > 0 else "it fails"
            reason = re.sub(r"'\S*[/\\]", "'", said)  # without the folder
            raise InputError(f"gmsh cannot read it: {reason}")
        with np.load(out) as found:
            tags, points, corners = (found[name] for name in ("tags", "points", "corners"))
    order = np.argsort(tags)
    return points, order[np.searchsorted(tags, corners, sorter=order)]
