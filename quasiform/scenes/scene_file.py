"""Forming scenes as TOML files: blank, tools, supports, what is measured; nothing is computed here.

The built-in scenes (`geometries/*.toml`) are such files. A number is written plainly, or as
`{ value, unit, standing }` where it carries its standing (stated, assumed, measured, ...).
Lengths are mm, masses kg, forces N, angles degrees. Paths are relative to the file.

A `SceneFile` and its parts are plain data, from which outline and tools are built when they are
asked for; `scene_toml` writes it back.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError, suggestion
from ..net import outline as outlines
from ..toml_file import read_toml, toml_text
from ..tools.part import SHAPES, Form, ToolPart
from ..tools.surface_file import SurfaceFile

_PACKAGED = Path(__file__).parents[1] / "geometries"
FOLDER = _PACKAGED if _PACKAGED.is_dir() else Path(__file__).parents[2] / "geometries"

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

    def written(self) -> dict[str, str]:
        """Return the scene as plain text, for a recipe; its standings and paths are in it."""
        return {"toml": scene_toml(self), "source": self.source}

    @staticmethod
    def read(written: Mapping[str, str]) -> SceneFile:
        """Return the scene that was written.

        Raises
        ------
        InputError
        """
        from .scene_schema import read_scene  # pydantic

        file = read_scene(tomllib.loads(written["toml"]), Path(), "scene")
        return replace(file, source=written["source"])

    def files(self) -> list[Path]:
        """All files that the scene names: meshes, outlines, tools and the material."""
        named: list[Any] = [self.mesh, *(t.geometry for t in self.tools)]
        named += [] if self.blank is None else [*self.blank.parameters]
        named = [getattr(part, "path", part) for part in named]
        return [part for part in named if isinstance(part, Path)]


def built_in() -> list[str]:
    """Names of the scenes that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name: str) -> SceneFile:
    """Read a built-in scene by name, or a TOML file.

    Raises
    ------
    InputError
        For an unknown name, an unreadable file, unknown keys and bad values: one line that names
        file, table and key.
    """
    from .scene_schema import read_scene  # pydantic

    if name in built_in():
        path = FOLDER / f"{name}.toml"
    elif name.endswith(".toml"):
        path = Path(name)
    else:
        raise InputError(f"unknown scene '{name}': {suggestion(name, built_in())}, or a .toml file")
    file = read_toml(path, lambda table: read_scene(table, path.parent, path.stem))
    return file if name in built_in() else replace(file, source=str(path.resolve()))


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene file: keys, units, limits and defaults, for editors."""
    from .scene_schema import Scene

    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Scene.model_json_schema(),
    }


def scene_toml(file: SceneFile) -> str:
    """Return a scene as the text of a TOML file with every default; paths are absolute.

    Raises
    ------
    InputError
        For a tool with a shape of the user's own.
    """
    blank: dict[str, Any] = _region(file.blank) if file.blank else {}
    blank |= {"orientation": file.orientation, "size": file.size, "mesh": file.mesh}
    if file.blank is None:
        blank["mesh_scale"] = file.mesh_scale
    elif file.blank.holes:
        blank["holes"] = [_region(hole) for hole in file.blank.holes]
    tools = {"holder" if t.name == "blank holder" else t.name: _tool(t) for t in file.tools}
    law = Path(file.law) if file.law.endswith(".toml") else file.law
    table = {
        "name": file.name,
        "travel": file.travel,
        "law": law,
        "gravity": file.gravity,
        "symmetry": file.symmetry,
        "blank": blank,
        "tools": tools,
        "supports": [_place(s.where) | {"fix": s.fix, "clamp": s.clamp} for s in file.supports],
        "grippers": [
            _place(g.where)
            | {"direction": g.direction, "tension": g.tension, "stiffness": g.stiffness}
            for g in file.grippers
        ],
        "areas": {
            name: {"centre": centre, "radius": radius}
            for name, (centre, radius) in file.areas.items()
        },
        "increments": {"largest": file.increment, "rows": file.rows},
        "outputs": dict(file.outputs),
    }
    return toml_text(_plain(table, "", file.standings))


def _region(region: Region) -> dict[str, Any]:
    keys = dict(zip(REGION[region.shape][1], region.parameters, strict=True))
    return {"shape": region.shape, **keys, "centre": region.centre}


def _tool(part: ToolPart) -> dict[str, Any]:
    geometry = part.geometry
    if isinstance(geometry, Form):
        keys = dict(zip(SHAPES[geometry.shape][1], geometry.numbers, strict=True))
        table = {"shape": geometry.shape, **keys}
    elif isinstance(geometry, SurfaceFile):
        table = {"file": geometry.path} | {key: getattr(geometry, key) for key in OF_A_FILE}
    else:
        raise InputError(f"{part.name}: a shape of your own cannot be written to a file")
    keys = [k for k in OF_A_TOOL if part.motion == "free" or k not in ("mass", "force", "tilt")]
    table |= {"role": part.role, "motion": part.motion}
    return table | {key: getattr(part, key) for key in keys}


def _place(where: Where) -> dict[str, Any]:
    if where.side or where.box:
        return {"side": where.side or None, "box": where.box}
    return {"centre": where.centre, "radius": where.radius}


def _plain(value: Any, name: str, standings: Mapping[str, str]) -> Any:
    """Return what TOML can hold: without None, with the standings, paths absolute."""
    if isinstance(value, Path):
        return str(value.absolute())
    if isinstance(value, tuple | list):
        return [_plain(v, f"{name} {i}", standings) for i, v in enumerate(value, 1)]
    if isinstance(value, dict):
        start = f"{name}." if name else ""
        inner = {key: _plain(v, start + key, standings) for key, v in value.items()}
        inner = {key: v for key, v in inner.items() if v is not None}
        return inner | ({"standing": standings[name]} if name in standings else {})
    return {"value": value, "standing": standings[name]} if name in standings else value
