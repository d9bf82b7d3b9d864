"""Triangles of a surface from a file: STL, OBJ, PLY, VTU, VTK, MSH, and CAD through gmsh.

Files come from strangers: nothing in them is executed, and reading writes nothing.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import meshio
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..checks import InputError, check_file, check_number

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
LARGEST = 1e12  # of a coordinate, in any unit of a file
MERGED = 1e-5  # of the surface's diagonal: nearer vertices are one, flatter triangles are slivers
PINHOLE = 0.05  # a rim that encloses less than this share of the surface is a hole
FILLED = 8, 0.01  # most edges of a hole that is filled, and most of the surface it encloses
ROUNDS = 10  # of turning edges, for slivers side by side
MEMORY = 500_000_000  # bytes for reading a mesh, beside a hundred times its file
PATIENCE = 120.0  # s, for a CAD file
CAD_MESH = Path(__file__).with_name("cad.py")
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
    return _read(path, scale)[:2]


def read_repaired(path: str | Path, scale: float = 1.0) -> tuple[FloatArray, np.ndarray, list[str]]:
    """Read a surface and mend what CAD exports leave behind.

    In this order: vertices nearer than `MERGED` are one (`read_surface`), double triangles are
    taken out, triangles are turned alike (the larger area stays; outwards if closed), small holes
    are filled, and slivers are merged with their neighbours by turning their longest edge. Nothing
    moves by more than `MERGED` times the diagonal, but that a filled hole is spanned by flat
    triangles. A surface without such defects is left as it is.

    Returns
    -------
    vertices, triangles
        As `read_surface`.
    repairs : list of str
        What was done, in words.

    Raises
    ------
    InputError
        For a file that cannot be read, naming it.
    """
    vertices, triangles, repairs = _read(path, scale)
    single = _without_doubles(triangles)
    if len(single) == 0:
        raise InputError(f"{path}: every triangle is there twice, with its two sides")
    if gone := len(triangles) - len(single):
        repairs.append(f"{_count(gone, 'double triangle')} taken out")
    triangles = single
    _, count, turns = edges_of(triangles)
    if ((count == 2) & (turns != 0)).any():
        with naming(path):
            alike = _oriented(vertices, triangles)
        repairs.append(f"{_count((alike != triangles).any(1).sum(), 'triangle')} turned round")
        triangles = alike
    small = _small_holes(vertices, triangles)
    if small:
        fans = [[rim[0], b, a] for rim in small for a, b in pairwise(rim[1:])]
        triangles = np.vstack([triangles, fans])
        edges, at = max(map(len, small)), position(vertices[small[0]].mean(0))
        one, some = f"a hole of {edges} edges", f"{len(small)} holes of up to {edges} edges, one"
        repairs.append(f"{one if len(small) == 1 else some} around {at} of the file filled")
    least = MERGED * np.linalg.norm(np.ptp(vertices, axis=0))
    triangles, slivers = _without_slivers(vertices, triangles, least)
    if slivers:
        repairs.append(f"{_count(slivers, 'sliver')} taken out")
    return vertices, triangles, repairs


def _read(path: str | Path, scale: float) -> tuple[FloatArray, np.ndarray, list[str]]:
    """Vertices, triangles and what was merged, in words: see `read_surface`."""
    path = Path(path)
    kind = path.suffix.lower()
    with naming(path):
        check_number("scale", scale)
        if kind not in {**MESHES, **CAD}:
            known = ", ".join([*MESHES, *CAD])
            raise InputError(f"unknown kind of surface '{kind}': expected one of {known}")
        check_file(path)
        vertices, triangles = _read_cad(path, CAD[kind]) if kind in CAD else _read_mesh(path, kind)
        check_numbers(vertices, triangles)
        vertices, triangles, repairs = _merged(scale * vertices, triangles)
        return vertices, _oriented(vertices, triangles) if kind in CAD else triangles, repairs


def _read_mesh(path: Path, kind: str) -> Surface:
    if kind == ".ply" and not re.search(rb"^end_header\s*$", path.read_bytes(), re.MULTILINE):
        raise InputError("not a readable .ply file: no end_header")  # meshio would not end either
    if kind == ".stl":
        _check_whole(path.read_bytes())
    mesh = read_mesh(path, MESHES[kind].read)
    splits = {"triangle": [[0, 1, 2]], "quad": [[0, 1, 2], [0, 2, 3]]}
    parts = [block.data[:, split] for block in mesh.cells for split in splits.get(block.type, [])]
    if not parts:
        raise InputError("no triangles")
    points = np.pad(np.asarray(mesh.points, float), ((0, 0), (0, 3 - mesh.points.shape[1])))
    return points, np.concatenate(parts)


def _check_whole(content: bytes) -> None:
    """Refuse an STL file that ends too early."""
    text = b"\0" not in content  # a name may hold any letters; binary triangles hold zeros
    if text and content[:5] == b"solid" and b"facet" in content:
        if b"endsolid" not in content[-1000:]:
            raise InputError(
                "the file is cut off, without endsolid at its end: export or copy it anew"
            )
    elif len(content) >= 84 and not text:
        promised = int.from_bytes(content[80:84], "little")
        if len(content) < 84 + 50 * promised:
            there = (len(content) - 84) // 50
            raise InputError(
                f"the file is cut off, {there} triangles of the {promised} that its head promises: "
                "export or copy it anew"
            )


def read_mesh(path: Path, read: Callable[[str], meshio.Mesh] = meshio.read) -> meshio.Mesh:
    """Read a mesh by meshio, which prints, warns, exits and raises what it likes.

    Raises
    ------
    InputError
    """
    try:
        with (
            redirect_stdout(StringIO()),
            redirect_stderr(StringIO()),
            warnings.catch_warnings(),
            _enough_memory(path.stat().st_size),
        ):
            warnings.simplefilter("ignore")
            mesh = read(str(path))
    except (Exception, SystemExit) as error:
        reason = "" if isinstance(error, SystemExit) else f": {_line(error)}"
        raise InputError(f"not a readable {path.suffix.lower()} file{reason}") from error
    if len(mesh.points) and (mesh.points.ndim != 2 or mesh.points.shape[1] not in (2, 3)):
        raise InputError("the points have no two or three coordinates")
    return mesh


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
    most = used + MEMORY + 100 * size
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([most, *limits]), hard))
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
        given = path.absolute()
        if kind == "geo":
            # what was checked, away from a .geo.opt beside the file, which gmsh would run too
            given = Path(folder, "tool.geo")
            program = _only_shape(path.read_text(encoding="utf-8", errors="replace"))
            given.write_text(program, encoding="utf-8")
        try:
            run = subprocess.run(
                [sys.executable, "-P", CAD_MESH, given, kind, out],
                cwd=folder,
                env=os.environ | {"HOME": folder},  # gmsh leaves a folder there
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
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


def _only_shape(program: str) -> str:
    """Return a .geo program without comments if all it can do is describe a shape."""
    program = _COMMENT.sub(lambda found: found[1] or found[0].count("\n") * "\n" or " ", program)
    for word in re.findall(r"\w+", program):
        if word in _ACTIVE:
            raise InputError(f"'{word}' is refused in a .geo file, which may only describe a shape")
    if text := re.search("[\"'].*", _TEXT.sub("", program)):
        raise InputError(f"text is refused in a .geo file but for names of groups: {text[0]}")
    return program


def _merged(
    vertices: FloatArray, triangles: np.ndarray
) -> tuple[FloatArray, np.ndarray, list[str]]:
    """Merge vertices that coincide, drop triangles that lose a side and vertices without any."""
    check_numbers(vertices, triangles)
    vertices, index = np.unique(vertices, axis=0, return_inverse=True)
    triangles, n = index.reshape(-1)[triangles], len(vertices)
    pairs = cKDTree(vertices).query_pairs(
        MERGED * np.linalg.norm(np.ptp(vertices, axis=0)), output_type="ndarray"
    )
    near = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    same = connected_components(near, directed=False)[1]
    share = np.bincount(same)
    middle = np.stack([np.bincount(same, x) / share for x in vertices.T], axis=1)
    triangles = same[triangles]
    sides = triangles != np.roll(triangles, 1, axis=1)
    whole = sides.all(1)
    if not whole.any():
        raise InputError("no triangle has an area")
    repairs = []
    if len(pairs):
        apart = np.linalg.norm(np.subtract(*vertices[pairs.T]), axis=1).max()
        merged = _count(n - len(middle), "vertex", "vertices")
        repairs.append(f"{merged} up to {apart:.1g} mm from another merged with it")
    if not whole.all():
        repairs.append(f"{_count((~whole).sum(), 'triangle')} without area taken out")
    used, triangles = np.unique(triangles[whole], return_inverse=True)
    return middle[used], triangles.reshape(-1, 3).astype(np.int64), repairs


def _without_doubles(triangles: np.ndarray) -> np.ndarray:
    """One of triangles on the same vertices, none where as many face one way as the other."""
    a, b, c = triangles.T
    sense = np.sign(b - a) * np.sign(c - b) * np.sign(c - a)  # of the order beside that by number
    low, mid, high = np.sort(triangles, axis=1).T
    pair = np.unique(low * (triangles.max() + 1) + mid, return_inverse=True)[1]
    index = np.unique(pair * (triangles.max() + 1) + high, return_inverse=True)[1]
    excess = np.bincount(index, sense)[index]
    kept = np.flatnonzero(sense * excess > 0)  # of those that face the way of most
    return triangles[np.sort(kept[np.unique(index[kept], return_index=True)[1]])]


def _small_holes(vertices: FloatArray, triangles: np.ndarray) -> list[list[int]]:
    """Vertices about each hole that may be filled, in the sense of the triangles beside it."""
    area = np.linalg.norm(normals_of(vertices[triangles]), axis=1).sum()
    small = []
    for loop in holes_of(vertices, triangles):
        after: dict[int, list[int]] = {}
        for a, b in loop.tolist():
            after.setdefault(a, []).append(b)
        for start in list(after):  # holes that touch in a vertex are parted there
            path = [start]
            while after.get(path[-1]):
                there = after[path[-1]].pop()
                if there not in path:
                    path.append(there)
                    continue
                rim = path[path.index(there) :]
                del path[path.index(there) + 1 :]
                edges = np.stack([rim, np.roll(rim, -1)], axis=1)
                if len(rim) <= FILLED[0] and _enclosed(vertices, edges) < FILLED[1] * area:
                    small.append(rim)
    return small


def _enclosed(vertices: FloatArray, loop: np.ndarray) -> float:
    """Twice the area that edges (k, 2) enclose, mm²."""
    start, end = vertices[loop[:, 0]], vertices[loop[:, 1]]
    centre = start.mean(0)
    return float(np.linalg.norm(np.cross(start - centre, end - centre).sum(0)))


def _without_slivers(
    vertices: FloatArray, triangles: np.ndarray, least: float
) -> tuple[np.ndarray, int]:
    """Turn the longest edge of triangles lower than `least` (mm); how many there were."""
    triangles, taken, n = triangles.copy(), 0, len(vertices)

    def heights(some: np.ndarray) -> tuple[FloatArray, np.ndarray]:
        corners = vertices[some]
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        return np.linalg.norm(normals_of(corners), axis=1) / sides.max(1), sides.argmax(1)

    for _ in range(ROUNDS):
        height, longest = heights(triangles)
        slivers = np.flatnonzero(height < least)
        if len(slivers) == 0:
            break
        keys = triangles.ravel() * n + np.roll(triangles, -1, axis=1).ravel()
        order = np.argsort(keys)
        keys, touched, dropped = keys[order], set(), []
        for t in slivers:
            a, b, m = np.roll(triangles[t], -longest[t])
            at = keys.searchsorted(b * n + a)
            u = order[at] // 3 if b * n + a in keys[at : at + 1] else -1
            if t in touched or u in touched:
                continue
            if u < 0:  # its longest edge is on the rim
                dropped.append(t)
                touched |= {t}
                continue
            c = (set(triangles[u].tolist()) - {a, b}).pop()
            pair = np.array([[a, c, m], [c, b, m]])
            there = any(k in keys[keys.searchsorted(k) :][:1] for k in (c * n + m, m * n + c))
            if c == m or there or heights(pair)[0].min() <= height[t]:
                continue
            triangles[[t, u]] = pair
            touched |= {t, u}
            taken += 1
        if not touched:
            break
        taken += len(dropped)
        triangles = np.delete(triangles, dropped, axis=0)
    return triangles, taken


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
    wrong = ~(np.abs(vertices) < LARGEST).all(1)
    if wrong.any():
        raise InputError(f"{wrong.sum()} vertices are not finite numbers below {LARGEST:g}")


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n} {one if n == 1 else many or one + 's'}"


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def optional(module: str, extra: str, need: str) -> Any:
    """Import an optional package, or say how to install it."""
    try:
        return import_module(module)
    except (ImportError, OSError) as error:  # OSError: gmsh without the system's libraries
        raise InputError(f"{need}: pip install 'quasiform[{extra}]'") from error


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


def holes_of(vertices: FloatArray, triangles: np.ndarray) -> list[np.ndarray]:
    """Edges (k, 2) of each hole of a surface, which may be open at one outer rim."""
    edges, count, _ = edges_of(triangles)
    area = np.linalg.norm(normals_of(vertices[triangles]), axis=1).sum()
    loops = loops_of(vertices, edges[count == 1])
    return [
        loop for i, loop in enumerate(loops) if i > 0 or _enclosed(vertices, loop) < PINHOLE * area
    ]


def loops_of(vertices: FloatArray, rim: np.ndarray) -> list[np.ndarray]:
    """Edges (k, 2) of each connected part of the rim, the longest first."""
    n = len(vertices)
    joined = coo_array((np.ones(len(rim)), rim.T), shape=(n, n))
    part = connected_components(joined, directed=False)[1][rim[:, 0]]
    starts = np.flatnonzero(np.diff(np.sort(part))) + 1
    loops = np.split(rim[np.argsort(part, kind="stable")], starts)
    return sorted(
        filter(len, loops), key=lambda e: -np.linalg.norm(np.subtract(*vertices[e.T]), axis=1).sum()
    )


def position(point: FloatArray) -> str:
    """A point in words."""
    return "({:.4g}, {:.4g}, {:.4g}) mm".format(*point)
