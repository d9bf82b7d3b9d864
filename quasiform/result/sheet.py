"""A formed sheet: flat net, formed positions, fibres and fields; made by a run or read from a file.

With the flat legs dX of a triangle and its formed legs dx, F = dx dX⁻¹ (3, 2). The fibres become
a = F warp and b = F weft, sin γ = a·b / (|a| |b|), and the area changes by |F e1 × F e2|.

A file of another code is read as it stands: triangles, quadrilaterals and polygons, which are
split; of cells of higher order the corners. Everything else (solid cells, lines, nodes without an
element) is left out and counted in `left_out`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import InputError, check_file, naming
from ..meshes.shells import Shells
from ..net.blank import Blank

if TYPE_CHECKING:
    import meshio
    import pyvista

FloatArray = np.ndarray
FLAT = 1e-3  # of its size: how far an undeformed sheet may leave its plane
KINDS = (".vtu", ".vtk", ".xdmf", ".xmf")
DOUBTS = (
    "beyond_identified_range",
    "bands_may_form",
    "collapsed",
    "rovings_may_slip",
    "fibres_may_buckle",
    "narrow_bands",
)
"""Why the shear angle of a triangle may be wrong; the cell field `doubt` adds 1, 2, 4, ... 32."""


@dataclass(frozen=True, eq=False)
class FormedSheet:
    """A formed sheet at one travel.

    Parameters
    ----------
    points : (n, 3) array or None
        Formed positions x, mm; None where only flat ones are known.
    triangles : (m, 3) int array
        Node numbers; (0, 3) for points without a mesh.
    flat : (n, 2) array or None
        Flat positions X, mm.
    point_fields, cell_fields : dict of name to (n, ...) and (m, ...) arrays
        `shear_angle` in degrees, `warp` and `weft` as unit vectors, `displacement` in mm, ...
    name : str
    travel : float or None
        mm; None where it is not known.
    loose : dict of name to float
        Single numbers of a file, such as energies.
    left_out : dict of kind to count
        What a file holds besides the sheet: cells of another kind, nodes without an element.
    contour : (k, 2) array or None
        Outline seen along z, where it is known without a mesh; closed, or a part of it.
    by_formed_area : bool
        Whether means go by the formed area although the flat one is known.
    """

    points: FloatArray | None = None
    triangles: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=int))
    flat: FloatArray | None = None
    point_fields: Mapping[str, FloatArray] = field(default_factory=dict)
    cell_fields: Mapping[str, FloatArray] = field(default_factory=dict)
    name: str = "sheet"
    travel: float | None = None
    loose: Mapping[str, float] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)
    contour: FloatArray | None = None
    by_formed_area: bool = False

    def __repr__(self) -> str:
        at = "" if self.travel is None else f" at {self.travel:.4g} mm"
        return f"<FormedSheet {self.name}{at}: {len(self.triangles)} triangles>"

    @property
    def places(self) -> FloatArray:
        """(n, 3) formed positions, or the flat ones at z = 0 where only these are known, mm."""
        return self.rest if self.points is None else self.points

    @property
    def rest(self) -> FloatArray:
        """(n, 3) flat positions at z = 0, or the formed ones where only these are known, mm."""
        if self.flat is None:
            return np.empty((0, 3)) if self.points is None else self.points
        return np.pad(self.flat, ((0, 0), (0, 1)))

    @cached_property
    def F(self) -> FloatArray:
        """(m, 3, 2) deformation gradients; nan where the flat triangle has no area.

        InputError if the flat or the formed positions are not known.
        """
        if self.points is None or self.flat is None:
            raise InputError(f"{self.name}: needs flat and formed positions")
        legs = legs_of(self.points, self.triangles)
        a, b = legs_of(self.flat, self.triangles).transpose(1, 2, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.array([[b[1], -b[0]], [-a[1], a[0]]]) / (a[0] * b[1] - a[1] * b[0])
        return np.einsum("mki,kjm->mij", legs, inverse)

    @cached_property
    def areas(self) -> FloatArray:
        """(m,) areas of the formed triangles, mm²."""
        return _areas(self.places, self.triangles)

    @cached_property
    def flat_areas(self) -> FloatArray:
        """(m,) areas of the flat triangles, mm²; of the formed ones where these alone are known."""
        return _areas(self.rest, self.triangles)

    @property
    def weighing_areas(self) -> FloatArray:
        """(m,) areas of the triangles by which means go, mm²."""
        return self.areas if self.by_formed_area else self.flat_areas

    @cached_property
    def area_ratio(self) -> FloatArray:
        """(m,) formed area over flat area."""
        return np.linalg.norm(np.cross(self.F[..., 0], self.F[..., 1]), axis=1)

    @cached_property
    def along(self) -> FloatArray:
        """(2, 2) flat unit vectors of warp and weft, one a row: F⁻¹ of the formed ones.

        InputError without cell fields `warp` and `weft` of three components.
        """
        back, found = np.linalg.pinv(self.F), []
        for family in ("warp", "weft"):
            if np.shape(self.cell_fields.get(family))[1:] != (3,):
                raise InputError(f"no cell field '{family}' of three components")
            flat = np.einsum("mij,mj->mi", back, self.cell_fields[family])
            mean = (flat / np.linalg.norm(flat, axis=1)[:, None]).mean(0)
            found.append(mean / np.linalg.norm(mean))
        return np.array(found)

    @cached_property
    def shear_angle(self) -> FloatArray:
        """(m,) signed shear angle, degrees: the cell field, or worked out from F and `along`."""
        given = self.cell_fields.get("shear_angle")
        return self.sheared(self.along) if given is None else np.ravel(given)

    def fibres(self, along: FloatArray) -> FloatArray:
        """(2, m, 3) formed unit vectors of fibres along (2, 2) flat unit vectors, one a row."""
        formed = np.einsum("mij,fj->fmi", self.F, along)
        return formed / np.linalg.norm(formed, axis=2)[:, :, None]

    def sheared(self, along: FloatArray) -> FloatArray:
        """(m,) signed shear angle, degrees, of fibres along (2, 2) flat unit vectors, one a row."""
        a, b = self.fibres(along)
        return np.degrees(np.arcsin(np.clip((a * b).sum(1), -1.0, 1.0)))

    @cached_property
    def blank(self) -> Blank:
        """The flat sheet with its fibres."""
        if self.flat is None:
            raise InputError(f"{self.name}: needs flat positions")
        return Blank(self.flat, self.triangles, *self.along)

    @cached_property
    def loops(self) -> list[np.ndarray]:
        """Outlines as closed lists of node numbers: the outer one first, then the holes.

        Seen from the side from which the triangles run counter-clockwise, the sheet is on the left.
        """
        return _loops(self.triangles, self.rest[:, :2])

    @property
    def outline(self) -> list[FloatArray]:
        """Closed outline of the formed sheet, then those of its holes; (k, 3) points each, mm."""
        return [self.places[loop] for loop in self.loops]

    @property
    def weights(self) -> FloatArray:
        """(n,) area that a point stands for, mm², of the flat sheet if known; 1 without a mesh."""
        if not len(self.triangles):
            return np.ones(len(self.places))
        share = np.repeat(self.weighing_areas / 3.0, 3)
        return np.bincount(self.triangles.ravel(), share, len(self.places))

    def at_nodes(self, values: FloatArray) -> FloatArray:
        """(n,) means, weighted by flat area, of (m,) values; nan at a point without one.

        Examples
        --------
        >>> X = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
        >>> sheet = FormedSheet(None, np.array([[0, 1, 2], [0, 2, 3]]), X)
        >>> sheet.at_nodes(np.array([3.0, 6.0])).tolist()
        [4.5, 3.0, 4.5, 6.0]
        """
        known = np.isfinite(values)
        around, n = self.triangles[known].ravel(), len(self.places)
        weight = np.repeat(self.weighing_areas[known], 3)
        with np.errstate(invalid="ignore", divide="ignore"):
            total = np.bincount(around, weight * np.repeat(values[known], 3), n)
            return total / np.bincount(around, weight, n)

    def doubts(self) -> dict[str, np.ndarray]:
        """Triangles whose shear angle may be wrong, by reason; bool (m,) each (`DOUBTS`)."""
        bits = np.ravel(self.cell_fields["doubt"]).astype(int)
        return {reason: bits >> k & 1 > 0 for k, reason in enumerate(DOUBTS)}

    def with_flat(self) -> FormedSheet:
        """Return it with the flat positions that its point field `displacement` leads back to.

        InputError without such a field, or where the undeformed sheet is not flat.
        """
        if np.shape(self.point_fields.get("displacement"))[1:] != (3,):
            raise InputError("no point field 'displacement' of three components")
        rest = self.points - self.point_fields["displacement"]
        if np.ptp(rest[:, 2]) > FLAT * np.ptp(rest, axis=0).max():
            raise InputError("its undeformed sheet is not flat")
        return replace(self, flat=rest[:, :2])

    @classmethod
    def of_surface(
        cls,
        points: FloatArray,
        triangles: np.ndarray,
        point_fields: Mapping[str, Any],
        cell_fields: Mapping[str, Any],
        left_out: Mapping[str, int] | None = None,
        **more: Any,
    ) -> FormedSheet:
        """Make it of those points that belong to triangles; the others are counted.

        InputError without triangles, or with points that are missing or not finite.
        """
        if not len(triangles):
            raise InputError("no triangles or quadrilaterals")
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise InputError("a triangle refers to a point that is not there")
        used, triangles = np.unique(triangles, return_inverse=True)
        if not np.isfinite(points[used]).all():
            raise InputError("not all points are finite numbers")
        left_out = dict(left_out or {})
        if unused := len(points) - len(used):
            left_out["nodes without an element"] = unused
        return cls(
            points[used],
            triangles.reshape(-1, 3),
            point_fields={name: np.asarray(values)[used] for name, values in point_fields.items()},
            cell_fields=dict(cell_fields),
            left_out=left_out,
            **more,
        )

    @classmethod
    def from_meshio(cls, mesh: meshio.Mesh, travel: float | None = None) -> FormedSheet:
        """Make it of the surface cells of a mesh of meshio; it refuses what `of_surface` does."""
        return _from_meshio(mesh, travel)

    def to_meshio(self) -> meshio.Mesh:
        """Mesh of meshio with all fields; `displacement` leads back to the flat sheet."""
        import meshio

        fields = dict(self.point_fields)
        if self.points is not None and self.flat is not None:
            fields.setdefault("displacement", self.points - self.rest)
        return meshio.Mesh(
            self.places,
            [("triangle", self.triangles)],
            point_data=fields,
            cell_data={name: [values] for name, values in self.cell_fields.items()},
        )

    def to_pyvista(self) -> pyvista.PolyData:
        """Surface of PyVista with all fields; InputError if PyVista is not installed."""
        try:
            import pyvista
        except ImportError as error:
            raise InputError("PyVista is not installed: pip install pyvista") from error
        mesh = self.to_meshio()
        faces = np.column_stack([np.full(len(self.triangles), 3), self.triangles]).ravel()
        surface = pyvista.PolyData(self.places, faces)
        surface.point_data.update(mesh.point_data)
        surface.cell_data.update(self.cell_fields)
        return surface

    def write(self, path: str | Path) -> None:
        """Write a file that ParaView and meshio open; its ending tells the format (.vtu)."""
        self.to_meshio().write(path)


def read_sheets(path: str | Path) -> list[FormedSheet]:
    """Read a formed mesh as it stands in a .vtu, .vtk, .xdmf or .xmf file; of a series its states.

    The flat positions are left open: `FormedSheet.with_flat` finds them in files of this program.
    InputError names the file and its defect.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise InputError(f"{path}: unknown kind of file '{kind}': expected {', '.join(KINDS)}")
    return readable(path, lambda: [FormedSheet.from_meshio(*state) for state in _meshes(path)])


def readable(path: Path, read: Callable[[], Any]) -> Any:
    """Call a reader of a mesh file; what its parser meets becomes an InputError naming the file."""
    log = StringIO()
    with naming(path), redirect_stdout(log), redirect_stderr(log), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            check_file(path)
            return read()
        except (OSError, InputError):
            raise
        except ImportError as error:
            missing = "its numbers are in HDF5, which needs h5py: pip install h5py"
            raise InputError(missing) from error
        except (Exception, SystemExit) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"not a readable {path.suffix.lower()} file: {reason}") from error


def _from_meshio(mesh: meshio.Mesh, travel: float | None) -> FormedSheet:
    """Surface cells of a mesh, quadrilaterals split, with their fields."""
    shells = Shells.of_mesh(mesh)
    triangles, rows = shells.split()
    chosen = shells.elements[rows] - 1
    cell_fields = {
        name: np.concatenate([np.asarray(values) for values in blocks])[chosen]
        for name, blocks in mesh.cell_data.items()
    }
    loose = {
        name: float(np.ravel(value)[-1])
        for name, value in mesh.field_data.items()
        if np.issubdtype(np.asarray(value).dtype, np.number) and np.size(value)
    }
    points = np.asarray(mesh.points, dtype=float)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    surface = points, triangles, mesh.point_data, cell_fields, shells.left_out
    return FormedSheet.of_surface(*surface, travel=travel, loose=loose)


def _meshes(path: Path) -> Iterator[tuple[meshio.Mesh, float | None]]:
    """Meshes of a file with their times."""
    import meshio

    kind = path.suffix.lower()
    if kind in (".xdmf", ".xmf") and b"<Time" in path.read_bytes():
        with meshio.xdmf.TimeSeriesReader(path) as reader:
            points, cells = reader.read_points_cells()
            for k in range(reader.num_steps):
                time, by_point, by_cell = reader.read_data(k)
                yield meshio.Mesh(points, cells, by_point, by_cell), time
    else:
        module = {".vtu": meshio.vtu, ".vtk": meshio.vtk}.get(kind, meshio.xdmf)
        yield module.read(path), None


def _loops(triangles: np.ndarray, flat: FloatArray) -> list[np.ndarray]:
    """Closed lists of nodes around (n, 2) places: the outer one first, then the holes."""
    edges = np.stack([triangles, np.roll(triangles, -1, 1)], axis=2).reshape(-1, 2)
    both = np.sort(edges, axis=1)
    _, first, count = np.unique(both, axis=0, return_index=True, return_counts=True)
    beside: dict[int, list[int]] = {}
    rim = edges[np.sort(first[count == 1])].tolist()
    for start, end in rim:
        beside.setdefault(start, []).append(end)
        beside.setdefault(end, []).append(start)
    loops = []
    for start, end in rim:
        if end not in beside[start]:
            continue
        loop = [start]
        while len(loop) == 1 or loop[-1] != start:
            here = loop[-1]
            there = end if len(loop) == 1 else beside[here][0]
            beside[here].remove(there)
            beside[there].remove(here)
            loop.append(there)
        loops.append(np.array(loop))
    ends = [flat[loop[:-1]] for loop in loops]
    areas = [float(x @ (np.roll(y, -1) - np.roll(y, 1))) for x, y in (p.T for p in ends)]
    sense = np.sign(max(areas, key=abs, default=1.0))
    return [loops[k] for k in np.argsort(-sense * np.array(areas), kind="stable")]


def _areas(points: FloatArray, triangles: np.ndarray) -> FloatArray:
    """(m,) areas of triangles between (n, 3) points, mm²."""
    a, b = legs_of(points, triangles).transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(a, b), axis=1)


def legs_of(points: FloatArray, triangles: np.ndarray) -> FloatArray:
    """(m, 2, dim) vectors from the first corner of each triangle to the others."""
    return points[triangles[:, 1:]] - points[triangles[:, :1]]
