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
from ..tools.part import SHAPES, Form, ToolPart
from ..tools.surface_file import SurfaceFile

__all__ = ["SHAPES", "Form", "SurfaceFile", "ToolPart"]
Point = tuple[float, float]
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

    def files(self) -> list[Path]:
        """All files that the scene names: meshes, outlines and surfaces of tools."""
        named: list[Any] = [self.mesh, *(tool.geometry for tool in self.tools)]
        named += self.blank.parameters if self.blank else ()
        named = [getattr(part, "path", part) for part in named]
        return [part for part in named if isinstance(part, Path)]
