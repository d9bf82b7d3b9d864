"""Triangles of a surface from a file: STL, OBJ, OFF, meshes, and CAD through gmsh.

Files are not trusted: nothing in them is executed, and reading writes nothing.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, check_file, check_number, naming, optional
from ..meshes.inp_file import read_inp
from ..meshes.mesh_file import read_mesh, reading
from ..meshes.shells import Shells, counted
from .mending import check_numbers, merged, oriented, without_defects

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FloatArray = np.ndarray
Surface = tuple[FloatArray, np.ndarray]
Vector = tuple[float, float, float]
Faces = tuple[FloatArray, list[list[int]], dict[str, int]]

MESHIO = {".ply": "ply", ".vtu": "vtu", ".vtk": "vtk", ".msh": "gmsh"}
MESHIO |= dict.fromkeys((".nas", ".bdf", ".fem"), "nastran")
CAD = {".step": "step", ".stp": "step", ".iges": "iges", ".igs": "iges", ".brep": "brep"}
KINDS = (".stl", ".obj", ".off", *MESHIO, ".inp", *CAD)
OTHERS = {
    "l": "lines",
    "p": "points",
    "curv": "curves",
    "curv2": "curves",
    "surf": "surfaces",
}  # of OBJ
LOST = 2**31 - 1  # number of a vertex that is not there
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
    offset: float = 0.0  # by how much the surface is moved into the tool, along its normals, mm

    def placed(self) -> tuple[FloatArray, np.ndarray, list[str]]:
        """Vertices and triangles as `read_surface`, in the tool's frame, and what was repaired."""
        vertices, triangles, merging = read_with_notes(self.path, self.scale)
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

    Polygons are split into triangles, other cells counted among the repairs of a tool. STEP and
    IGES (in mm by their own unit) and BREP are meshed by gmsh, finer where they are curved.
    `scale` is mm per unit of the file.

    Returns vertices (n, 3), mm, those that coincide merged, and triangles (m, 3), turning about the
    outward normal, none degenerate. InputError names a file that cannot be read.
    """
    return read_with_notes(path, scale)[:2]


def read_with_notes(path: str | Path, scale: float) -> tuple[FloatArray, np.ndarray, list[str]]:
    """Read as `read_surface`, with what was merged and left out."""
    path = Path(path)
    kind = path.suffix.lower()
    with naming(path):
        check_number("scale", scale)
        if kind not in KINDS:
            known = ", ".join(KINDS)
            raise InputError(f"unknown kind of surface '{kind}': expected one of {known}")
        check_file(path)
        left_out: Mapping[str, int] = {}
        if kind in CAD:
            vertices, triangles = _read_cad(path, CAD[kind])
        elif kind == ".stl":
            vertices, triangles = _read_stl(path)
        else:
            shells = _read_mesh(path, kind)
            vertices, triangles, left_out = shells.points, shells.split()[0], shells.left_out
        if left_out and not len(triangles):
            raise InputError(f"no triangles: the file holds {counted(left_out)}")
        check_numbers(vertices, triangles)
        vertices, triangles, repairs = merged(scale * vertices, triangles)
        repairs += [f"left out: {counted(left_out)}"] * bool(left_out)
        return vertices, oriented(vertices, triangles) if kind in CAD else triangles, repairs


def _read_mesh(path: Path, kind: str) -> Shells:
    """Vertices and faces of a mesh."""
    if kind == ".inp":
        return Shells(**read_inp(path))
    content = path.read_bytes()
    if kind == ".ply" and not re.search(rb"^end_header\s*$", content, re.MULTILINE):
        raise InputError("not a readable .ply file: no end_header")  # meshio would not end either
    if kind in MESHIO:
        return Shells.of_mesh(read_mesh(path, MESHIO[kind]))
    with reading(path):
        read = {".obj": _read_obj, ".off": _read_off}[kind](content.decode("latin-1"))
    return Shells.of_faces(*read)


def _read_stl(path: Path) -> Surface:
    trimesh = optional("trimesh", "surface", "an .stl file needs trimesh")
    content = _whole_stl(path.read_bytes())
    with reading(path):
        mesh = trimesh.load_mesh(BytesIO(content), file_type="stl", process=False)
        return np.array(mesh.vertices, float), np.array(mesh.faces)


def _read_obj(text: str) -> Faces:
    """Vertices and faces of an OBJ file; negative numbers count back from the last vertex.

    trimesh 5 mixes up negative numbers where vertices follow a face, and fails at comments.
    """
    points: list[list[float]] = []
    faces: list[list[int]] = []
    left_out: dict[str, int] = {}
    text = text.replace("\r", "\n")
    for line in re.sub(r"\\\n+", " ", text).split("\n"):
        key, *words = line.split("#")[0].split() or [""]
        if key == "v":
            x, y, z = map(float, words[:3])  # a weight or colours may follow
            points.append([x, y, z])
        elif key == "f":
            numbers = [int(word.split("/")[0]) for word in words]
            back = [len(points) + k if 0 < -k <= len(points) else LOST for k in numbers]
            faces.append([k - 1 if k > 0 else b for k, b in zip(numbers, back, strict=True)])
        elif key in OTHERS:
            left_out[OTHERS[key]] = left_out.get(OTHERS[key], 0) + 1
    return np.reshape(points, (-1, 3)), faces, left_out


def _read_off(text: str) -> Faces:
    """Vertices and faces of an OFF file; what follows a vertex or a face, as a colour, is ignored.

    meshio reads triangles only.
    """
    lines = [line.split() for line in re.sub(r"#.*", "", text).splitlines() if line.split()]
    head = lines[0][0]
    if not head.endswith("OFF") or head.startswith(("4", "n", "ST4", "STn")):
        raise ValueError("expected OFF in its first line")
    first = lines[0][1:] or lines.pop(1)
    many, faces = int(first[0]), int(first[1])
    body = lines[1:]
    points = np.array([row[:3] for row in body[:many]], dtype=float).reshape(-1, 3)
    chosen = [(int(row[0]), row[1:]) for row in body[many : many + faces]]
    rows = [(n, [int(word) for word in row[:n]]) for n, row in chosen]
    if len(rows) < faces or any(len(row) < n for n, row in rows):
        raise ValueError("the file ends too early")
    return points, [row for _, row in rows], {}


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
