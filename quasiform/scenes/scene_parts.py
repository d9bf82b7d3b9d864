"""The parts of a forming scene as plain data, from which outline and tools are built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError
from ..fabric import Fabric
from ..net import outline as outlines
from ..net.slits import check_slits
from ..tools.part import ToolPart
from ..tools.shapes import Rows

Point = tuple[float, float]
REGION: dict[str, tuple[Callable[..., shapely.Polygon], tuple[str, ...]]] = {
    "rectangle": (outlines.rectangle, ("length", "width")),
    "disc": (outlines.disc, ("radius",)),
    "polygon": (outlines.polygon, ("points",)),
    "file": (outlines.read_outline, ("file", "scale", "layer")),
}
MOST_STITCHES = 10_000  # of a line
OUTWARDS = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
SYMMETRIES = ("auto", "half", "none")  # mirror planes that are used: all, at most one, none
MOTIONS = {"punch": "driven", "die": "fixed", "holder": "free"}


@dataclass(frozen=True)
class Slit:
    """Open lines along which the flat sheet is cut: one through points, or those of a file."""

    points: tuple[Point, ...] = ()  # mm
    file: Path | None = None
    scale: float = 1.0  # mm per unit of the file
    layer: str | None = None  # of a drawing
    centre: Point = (0.0, 0.0)  # by how much they are moved, mm

    @cached_property
    def lines(self) -> list[np.ndarray]:
        """(k, 2) points of each, mm; InputError for what is no line."""
        lines = [np.array(self.points, dtype=float).reshape(-1, 2)]
        if self.file is not None:
            lines = outlines.read_lines(self.file, self.scale, self.layer)
        for line in lines:
            if len(line) < 2 or not np.ptp(line, axis=0).any():
                raise InputError("a slit needs two different points")
        return [line + self.centre for line in lines]


@dataclass(frozen=True)
class Region:
    """An area of the flat sheet with what is cut out of it and into it."""

    shape: str  # a key of REGION
    parameters: tuple[Any, ...]  # in the order of REGION: numbers in mm, corners, a path
    centre: Point = (0.0, 0.0)  # by how much it is moved, mm
    holes: tuple[Region, ...] = ()
    darts: tuple[Region, ...] = ()  # as holes; they may cross the edge
    slits: tuple[Slit, ...] = ()

    @staticmethod
    def of(polygon: shapely.Polygon) -> Region:
        """Region of a polygon in mm."""
        rings = [polygon.exterior, *polygon.interiors]
        loops = [tuple((float(x), float(y)) for x, y in ring.coords[:-1]) for ring in rings]
        outer, *holes = (Region("polygon", (loop,)) for loop in loops)
        return replace(outer, holes=tuple(holes))

    @cached_property
    def drawing(self) -> outlines.Drawing:
        """The area before it is moved, and what was read of a file."""
        if self.shape == "file":
            return outlines.read_drawing(*self.parameters)
        return outlines.Drawing(REGION[self.shape][0](*self.parameters))

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The area, mm; InputError if it has none, crosses itself, or a hole is not inside."""
        moved = shapely.affinity.translate(self.drawing.polygon, *self.centre)
        for name, cuts in (("hole", self.holes), ("dart", self.darts)):
            loops = [loop for cut in cuts for loop in cut.loops]
            moved = outlines.with_holes(moved, loops, name)
        return moved

    @cached_property
    def loops(self) -> list[shapely.Polygon]:
        """As a hole: its area, or those of all closed lines of a file; mm."""
        if self.shape != "file":
            return [self.polygon]
        loops = outlines.read_loops(*self.parameters)
        return [shapely.affinity.translate(loop, *self.centre) for loop in loops]

    @cached_property
    def lines(self) -> list[np.ndarray]:
        """(k, 2) points of its slits, mm; InputError if one is outside, or divides it."""
        lines = [line for slit in self.slits for line in slit.lines]
        check_slits(self.polygon, lines)
        return lines

    def cuts(
        self, offset: Point = (0.0, 0.0)
    ) -> tuple[tuple[np.ndarray, ...], tuple[shapely.Polygon, ...]]:
        """Lines of its slits and areas of its darts, moved by an offset, mm."""
        loops = [loop for dart in self.darts for loop in dart.loops]
        darts = [shapely.affinity.translate(loop, *offset) for loop in loops]
        return tuple(line + offset for line in self.lines), tuple(darts)

    def files(self) -> list[Any]:
        """Paths that it names, among its other parameters."""
        cuts = [*self.holes, *self.darts]
        inner = [part for cut in cuts for part in cut.parameters]
        return [*self.parameters, *inner, *(slit.file for slit in self.slits)]


@dataclass(frozen=True)
class Where:
    """A part of the flat blank: one side of its bounding box, a box, or a disc; mm."""

    side: str = ""
    box: tuple[float, float, float, float] | None = None
    centre: Point = (0.0, 0.0)
    radius: float = 0.0

    def nodes(self, points: np.ndarray, bounds: tuple[float, float, float, float]) -> np.ndarray:
        """(n,) bool array: which points (n, 2) lie in it; `bounds` are those of the blank."""
        if self.box:
            low, high = np.array(self.box[:2]), np.array(self.box[2:])
            near = 1e-6 * max(np.subtract(bounds[2:], bounds[:2]))
            return ((points >= low - near) & (points <= high + near)).all(1)
        if self.side:
            axis = "xy".index(self.side[1])
            edge = bounds[axis + 2 * (self.side[0] == "+")]
            return np.abs(points[:, axis] - edge) < 1e-6 * (bounds[2] - bounds[0])
        return np.linalg.norm(points - self.centre, axis=1) <= self.radius * (1 + 1e-9)

    def measure(self, outline: shapely.Polygon, bounds: tuple[float, ...]) -> float:
        """Length of an outline at a side of the blank, mm, or area of it in a box or disc, mm²."""
        if not self.side:
            disc = shapely.Point(self.centre).buffer(self.radius)
            return (shapely.box(*self.box) if self.box else disc).intersection(outline).area
        low, high = np.reshape(bounds, (2, 2))
        axis, near = "xy".index(self.side[1]), 1e-6 * (high[0] - low[0])
        edge = (high if self.side[0] == "+" else low)[axis]
        low[axis], high[axis] = edge - near, edge + near
        return outline.boundary.intersection(shapely.box(*low, *high)).length


@dataclass(frozen=True)
class Support:
    """Nodes that cannot move in x, y, z; a clamp also keeps the direction of the fibres."""

    where: Where
    fix: str
    clamp: bool = False
    plies: tuple[int, ...] | None = None  # their numbers, from 1 on; None: all that lie there


@dataclass(frozen=True)
class Gripper:
    """A pull of `tension` N along `direction`, less `stiffness` N/mm times the motion.

    Without a direction it pulls away from the nearest side of the blank. Both numbers are those of
    the whole gripper, however many plies it holds.
    """

    where: Where
    direction: Point | None = None
    tension: float = 0.0
    stiffness: float = 0.0
    plies: tuple[int, ...] | None = None  # their numbers, from 1 on; None: all that lie there


@dataclass(frozen=True)
class Seam:
    """Stitches at points of the flat ply, or along the line through them; mm."""

    points: tuple[Point, ...]
    spacing: float | None = None  # of the stitches of a line; None: one at each point
    stiffness: float | None = None  # of a thread, N/mm
    slack: float = 0.0  # of a thread, mm

    @cached_property
    def places(self) -> np.ndarray:
        """(m, 2) places of its stitches, mm; InputError if there are none, or too many."""
        if not self.points:
            raise InputError("has no points")
        if self.spacing is None:
            return np.array(self.points)
        if len(self.points) < 2:
            raise InputError("spacing goes with a line of two points or more")
        line = shapely.LineString(self.points)
        if not 0 < (count := line.length / self.spacing) < MOST_STITCHES:
            raise InputError(f"a line has 1 to {MOST_STITCHES:,} stitches, got {count:.3g}")
        along = self.spacing * np.arange(int(count * (1 + 1e-9)) + 1)
        return shapely.get_coordinates(shapely.line_interpolate_point(line, along))


@dataclass(frozen=True)
class Ply:
    """One layer of a stack, from the punch down."""

    orientation: float = 0.0  # of its warp to that of the scene, degrees
    law: str | Fabric | None = None  # preset, path or fabric; None: that of the scene
    blank: Region | None = None  # its outline; None: that of the scene
    offset: Point = (0.0, 0.0)  # by how much the outline is moved, mm
    joined: bool = False  # whether it is stitched or bonded to the ply above it
    friction: float | None = None  # Coulomb coefficient with the ply above it
    stitches: tuple[Seam, ...] = ()  # to the ply above it


@dataclass(frozen=True)
class ElasticSheet:
    """A diaphragm, which lies over the plies or under them."""

    modulus: float  # Young's modulus, MPa
    thickness: float  # without stress, mm
    poisson: float = 0.5
    prestretch: float = 1.0  # of its flat outline
    side: str = "above"
    clamped: bool = True  # whether its edge is
    friction: float = 0.0  # Coulomb coefficient with the plies
    blank: Region | None = None  # its outline; None: that of the plies, enlarged


@dataclass(frozen=True)
class SceneFile:
    """A forming scene as it is written down."""

    name: str
    blank: Region | None  # the flat sheet; None where the user's own mesh brings its outline
    travel: float  # of the driven tools, from first touch, mm; without them a path of the loads
    tools: tuple[ToolPart, ...]
    orientation: float = 0.0  # angle of the warp to x, degrees
    size: float | None = None  # spacing of the fibre lines, mm
    mesh: str | Path = "fibre"  # cut from the fibre lines, or "free", or the user's own
    mesh_scale: float = 1.0  # mm
    law: str | Fabric = "locking"  # a preset, the path of a material file, or the fabric itself
    gravity: bool = False  # whether the sheet's own weight acts
    pressure: float | Rows | None = None  # on the upper face, MPa; rows: over the travel, mm
    supports: tuple[Support, ...] = ()
    grippers: tuple[Gripper, ...] = ()
    plies: tuple[Ply, ...] = ()  # from the punch down; none: one sheet
    diaphragm: ElasticSheet | None = None
    areas: Mapping[str, tuple[Point, float]] = field(default_factory=dict, hash=False)  # discs, mm
    symmetry: str = "auto"  # one of SYMMETRIES
    increment: float | None = None  # largest increment of the travel, mm; None: `usual_length`
    rows: float | None = None  # distance of the rows of the history, mm
    outputs: Mapping[str, bool] = field(
        default_factory=lambda: {"pictures": True, "increments": True}, hash=False
    )
    run: Mapping[str, Any] = field(default_factory=dict, hash=False)  # how it is solved
    standings: Mapping[str, str] = field(default_factory=dict, hash=False)  # by dotted name
    source: str = field(default="", compare=False)  # absolute path; empty for a built-in one

    def __post_init__(self) -> None:
        for name in ("tools", "supports", "grippers", "plies"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def driven(self) -> bool:
        """Whether a tool is driven."""
        return any(tool.motion == "driven" for tool in self.tools)

    @property
    def pressures(self) -> np.ndarray:
        """(n, 2) travel, mm, and pressure, MPa; a constant one rises from zero to the end."""
        p = self.pressure
        return np.array(p if isinstance(p, tuple) else [(0.0, 0.0), (self.travel, p or 0.0)])

    def heights(self, outline: shapely.Polygon, travel: float) -> tuple[float, float]:
        """Between which heights the sheet may be, mm, by its tools, or half of the blank down."""
        strokes = [part.stroke for part in self.tools if part.motion == "driven"]
        ends = [0.0, *(-mm for rows in strokes for _, mm in rows or ((0.0, travel),))]
        if not strokes:
            ends.append(
                -max(travel, 0.5 * float(np.ptp(np.reshape(outline.bounds, (2, 2)), 0).max()))
            )
        return min(ends), max(ends)

    @property
    def outline(self) -> shapely.Polygon:
        """The flat blank with its holes, mm; empty where the mesh is the user's own."""
        return self.blank.polygon if self.blank else shapely.Polygon()

    @property
    def slits(self) -> list[np.ndarray]:
        """Lines (k, 2) along which the flat blank is cut, mm."""
        return self.blank.lines if self.blank else []

    def files(self) -> list[Path]:
        """All files that the scene names: meshes, outlines and surfaces of tools."""
        named: list[Any] = [self.mesh, *(tool.geometry for tool in self.tools)]
        for blank in (self.blank, *(part.blank for part in (*self.plies, self.diaphragm) if part)):
            named += blank.files() if blank else ()
        named = [getattr(part, "path", part) for part in named]
        return [part for part in named if isinstance(part, Path)]

    def texts(self) -> list[Path]:
        """Files that it was read from: its own, and that of its fabric."""
        laws = [self.law, *(ply.law for ply in self.plies)]
        read = [law for law in laws if isinstance(law, str) and law.endswith(".toml")]
        return [Path(name) for name in (self.source, *read) if name]
