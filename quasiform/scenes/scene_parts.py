"""The parts of a forming scene as plain data, from which outline and tools are built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..net import outline as outlines
from ..tools.shapes import (
    Plane,
    Shape,
    ball,
    bar,
    box_punch,
    flipped,
    opening,
    regular_polygon,
    round_opening,
    round_punch,
    tetrahedron_punch,
)

Point = tuple[float, float]


def _box_opening(length: float, width: float, corner_radius: float, fillet: float) -> Shape:
    x, y = length / 2, width / 2
    return opening(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), corner_radius, fillet)


def _triangle_opening(edge: float, azimuth: float, corner_radius: float, fillet: float) -> Shape:
    return opening(regular_polygon(3, edge, azimuth), corner_radius, fillet)


# what builds each shape, and from which keys: mm; an azimuth in degrees
SHAPES: dict[str, tuple[Callable[..., Shape], tuple[str, ...]]] = {
    "round punch": (round_punch, ("radius",)),
    "box punch": (box_punch, ("length", "width", "edge_radius")),
    "tetrahedron punch": (tetrahedron_punch, ("base_edge", "height", "edge_radius", "azimuth")),
    "round opening": (round_opening, ("radius", "fillet")),
    "box opening": (_box_opening, ("length", "width", "corner_radius", "fillet")),
    "triangle opening": (_triangle_opening, ("edge", "azimuth", "corner_radius", "fillet")),
    "ball": (ball, ("radius",)),
    "bar": (bar, ("radius",)),
    "plane": (Plane, ()),
}
REGION: dict[str, tuple[Callable[..., shapely.Polygon], tuple[str, ...]]] = {
    "rectangle": (outlines.rectangle, ("length", "width")),
    "disc": (outlines.disc, ("radius",)),
    "polygon": (outlines.polygon, ("points",)),
    "file": (outlines.read_outline, ("file", "scale")),
}
MOTIONS = {"punch": "driven", "die": "fixed", "holder": "free"}
OF_A_TOOL = ("friction", "mass", "force", "z", "place", "tilt")
OF_A_FILE = ("scale", "flip", "rotate", "origin", "spacing")


@dataclass(frozen=True)
class Region:
    """An area of the flat sheet with its holes.

    Parameters
    ----------
    shape : str
        A key of `REGION`.
    parameters : tuple
        What it is built from, in the order of `REGION`: numbers in mm, corners, a path.
    centre : (float, float)
        By how much it is moved, mm.
    holes : tuple of Region
    """

    shape: str
    parameters: tuple[Any, ...]
    centre: Point = (0.0, 0.0)
    holes: tuple[Region, ...] = ()

    @staticmethod
    def of(polygon: shapely.Polygon) -> Region:
        """Region of a polygon in mm."""
        rings = [polygon.exterior, *polygon.interiors]
        loops = [tuple((float(x), float(y)) for x, y in ring.coords[:-1]) for ring in rings]
        outer, *holes = (Region("polygon", (loop,)) for loop in loops)
        return replace(outer, holes=tuple(holes))

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The area, mm.

        Raises
        ------
        InputError
            If it encloses no area, crosses itself, or a hole does not lie inside.
        """
        build, _ = REGION[self.shape]
        moved = shapely.affinity.translate(build(*self.parameters), *self.centre)
        return outlines.with_holes(moved, [hole.polygon for hole in self.holes])


@dataclass(frozen=True)
class Form:
    """A shape of a tool by its name and numbers, such as `Form("round punch", (75.0,))`.

    Parameters
    ----------
    shape : str
        A key of `SHAPES`.
    numbers : tuple of float
        In the order of `SHAPES`, mm and degrees.
    """

    shape: str
    numbers: tuple[float, ...] = ()


@dataclass(frozen=True)
class SurfaceFile:
    """A tool's surface in a file: what `grid.from_file` needs."""

    path: Path
    scale: float = 1.0
    flip: bool = False
    rotate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spacing: float | None = None


@dataclass(frozen=True)
class ToolPart:
    """A tool of the file; `friction`, `z` and `tilt` are None where the file leaves them open.

    `geometry` may also be a shape of the user's own, which cannot be written to a file.
    """

    name: str
    role: str
    motion: str
    geometry: Form | SurfaceFile | Shape
    friction: float | None = None
    mass: float = 0.0
    force: float = 0.0
    z: float | None = None
    place: Point = (0.0, 0.0)
    tilt: bool | None = None

    @cached_property
    def shape(self) -> Shape | SurfaceFile:
        """Its distance function; a surface file is not read here.

        Raises
        ------
        InputError
            For numbers that make no shape.
        """
        if not isinstance(self.geometry, Form):
            return self.geometry
        build, _ = SHAPES[self.geometry.shape]
        shape = build(*self.geometry.numbers)
        return flipped(shape) if self.role == "holder" else shape


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
            return ((points >= low - 1e-6) & (points <= high + 1e-6)).all(1)
        if self.side:
            axis = "xy".index(self.side[1])
            edge = bounds[axis + 2 * (self.side[0] == "+")]
            return np.abs(points[:, axis] - edge) < 1e-6 * (bounds[2] - bounds[0])
        return np.linalg.norm(points - self.centre, axis=1) <= self.radius


@dataclass(frozen=True)
class Support:
    """Nodes that cannot move in x, y, z; a clamp also keeps the direction of the fibres."""

    where: Where
    fix: str
    clamp: bool = False


@dataclass(frozen=True)
class Gripper:
    """A pull of `tension` N along `direction`, less `stiffness` N/mm times the motion."""

    where: Where
    direction: Point
    tension: float = 0.0
    stiffness: float = 0.0


@dataclass(frozen=True)
class SceneFile:
    """A forming scene as it is written down.

    Parameters
    ----------
    name : str
    blank : Region or None
        The flat sheet; None where the user's own mesh brings its outline.
    travel : float
        Of the driven tools, from first touch, mm.
    tools : tuple of ToolPart
    orientation : float
        Angle of the warp to x, degrees.
    size : float or None
        Spacing of the fibre lines, mm.
    mesh : "fibre", "free" or a path
        Cut from the fibre lines; a free triangulation; the user's own mesh.
    law : str
        A preset, or the path of a material file.
    gravity : bool
        Whether the sheet's own weight acts.
    supports, grippers : tuples of Support and Gripper
    areas : dict of name to (centre (2,), radius)
        Discs in blank coordinates, mm.
    symmetry : "auto" or "none"
    increment, rows : float
        Largest increment, and the distance of history rows, mm.
    outputs : dict
        `pictures` and `increments`: whether these files are written.
    standings : dict of dotted name to standing
    source : str
        File that it was read from, from the root; empty for a built-in one.
    """

    name: str
    blank: Region | None
    travel: float
    tools: tuple[ToolPart, ...]
    orientation: float = 0.0
    size: float | None = None
    mesh: str | Path = "fibre"
    mesh_scale: float = 1.0
    law: str = "locking"
    gravity: bool = False
    supports: tuple[Support, ...] = ()
    grippers: tuple[Gripper, ...] = ()
    areas: Mapping[str, tuple[Point, float]] = field(default_factory=dict, hash=False)
    symmetry: str = "auto"
    increment: float = 5.0
    rows: float = 5.0
    outputs: Mapping[str, bool] = field(
        default_factory=lambda: {"pictures": True, "increments": True}, hash=False
    )
    standings: Mapping[str, str] = field(default_factory=dict, hash=False)
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name in ("tools", "supports", "grippers"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def outline(self) -> shapely.Polygon:
        """The flat blank with its holes, mm; empty where the mesh is the user's own.

        Raises
        ------
        InputError
        """
        return self.blank.polygon if self.blank else shapely.Polygon()
