"""Forming scenes as TOML files: blank, tools, supports, what is measured; nothing is computed here.

The built-in scenes (`geometries/*.toml`) are such files. A number is written plainly, or as
`{ value, unit, standing }` where it shall carry its standing (stated, assumed, measured, ...).
Lengths are mm, masses kg, forces N, angles degrees. Paths are relative to the file.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError, check_keys, check_number, read_toml, suggestion
from ..net import outline as outlines
from ..tools.shapes import (
    FAR,
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
from ..tools.surface_file import SurfaceFile
from ..tools.tool_file import ToolPart

STANDINGS = ("measured", "stated", "exact", "peer", "inferred", "assumed")
_PACKAGED = Path(__file__).parents[1] / "geometries"
FOLDER = _PACKAGED if _PACKAGED.is_dir() else Path(__file__).parents[2] / "geometries"

Table = dict[str, Any]


def _box_opening(length: float, width: float, corner_radius: float, fillet: float) -> Shape:
    x, y = length / 2, width / 2
    return opening(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), corner_radius, fillet)


def _triangle_opening(edge: float, azimuth: float, corner_radius: float, fillet: float) -> Shape:
    return opening(regular_polygon(3, edge, azimuth), corner_radius, fillet)


# the numbers that make each shape, in mm; an azimuth in degrees
SHAPES: dict[str, tuple[Callable[..., Shape], tuple[str, ...]]] = {
    "round punch": (round_punch, ("radius",)),
    "box punch": (box_punch, ("length", "width", "edge_radius")),
    "tetrahedron punch": (
        tetrahedron_punch,
        ("base_edge", "height", "edge_radius", "azimuth"),
    ),
    "round opening": (round_opening, ("radius", "fillet")),
    "box opening": (_box_opening, ("length", "width", "corner_radius", "fillet")),
    "triangle opening": (_triangle_opening, ("edge", "azimuth", "corner_radius", "fillet")),
    "ball": (ball, ("radius",)),
    "bar": (bar, ("radius",)),
    "plane": (Plane, ()),
}

REGION = {
    "rectangle": ("length", "width"),
    "disc": ("radius",),
    "polygon": ("points",),
    "file": ("file", "scale"),
}
MOTIONS = {"punch": "driven", "die": "fixed", "holder": "free"}


LARGEST = 1e6  # of a number, in its unit: a kilometre, a meganewton
MOST_ROWS = 10_000
# what is expected where the key alone does not tell
VECTORS = {
    "rotate": "3 numbers, the angles in degrees about x, y and z such as [180, 0, 0],",
    "origin": "3 numbers, the point of the file in mm such as [200, 100, 0],",
    "place": "2 numbers, x and y in mm such as [10, 0],",
}


@dataclass(frozen=True)
class Where:
    """A part of the flat blank: one side of its bounding box, a box, or a disc; mm."""

    side: str = ""
    box: tuple[float, float, float, float] | None = None
    centre: tuple[float, float] = (0.0, 0.0)
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
    direction: tuple[float, float]
    tension: float = 0.0
    stiffness: float = 0.0


@dataclass(frozen=True)
class SceneFile:
    """A forming scene as it is written down.

    Parameters
    ----------
    name : str
    outline : shapely.Polygon
        The flat blank with its holes, mm.
    travel : float
        Of the driven tools, from first touch, mm.
    tools : list of ToolPart
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
    supports, grippers : list
    areas : dict of name to (centre (2,), radius)
        Discs in blank coordinates, mm.
    symmetry : "auto" or "none"
    increment, rows : float
        Largest increment, and the distance of history rows, mm.
    outputs : dict
        `pictures` and `increments`: whether these files are written.
    standings : dict of "table.key" to standing
    source : str
        File that it was read from, from the root; empty for a built-in one.
    """

    name: str
    outline: shapely.Polygon
    travel: float
    tools: list[ToolPart]
    orientation: float = 0.0
    size: float | None = None
    mesh: str | Path = "fibre"
    mesh_scale: float = 1.0
    law: str = "locking"
    gravity: bool = False
    supports: list[Support] = field(default_factory=list)
    grippers: list[Gripper] = field(default_factory=list)
    areas: dict[str, tuple[tuple[float, float], float]] = field(default_factory=dict)
    symmetry: str = "auto"
    increment: float = 5.0
    rows: float = 5.0
    outputs: dict[str, bool] = field(default_factory=lambda: {"pictures": True, "increments": True})
    standings: dict[str, str] = field(default_factory=dict)
    source: str = field(default="", compare=False)


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
    if name in built_in():
        path = FOLDER / f"{name}.toml"
    elif name.endswith(".toml"):
        path = Path(name)
    else:
        raise InputError(f"unknown scene '{name}': {suggestion(name, built_in())}, or a .toml file")
    file = read_toml(path, lambda table: _Reader(path.parent).scene(table, path.stem))
    return file if name in built_in() else replace(file, source=str(path.resolve()))


class _Reader:
    """Turns the tables of one file into its parts; remembers the standings of the numbers."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.standings: dict[str, str] = {}

    def scene(self, table: Table, stem: str) -> SceneFile:
        check_keys(
            table,
            [
                *("name", "travel", "symmetry", "gravity", "law", "blank", "tools"),
                *("supports", "grippers", "areas", "increments", "outputs"),
            ],
        )
        name = table.get("name", stem)
        if not isinstance(name, str):
            raise InputError(f"name must be a text, got {name!r}")
        blank = self.table(table, "blank", required=True)
        tools = self.table(table, "tools", required=True)
        increments = self.table(table, "increments")
        check_keys(increments, ["largest", "rows"], "increments")
        outputs = self.table(table, "outputs")
        check_keys(outputs, ["pictures", "increments"], "outputs")
        size = self.number(blank, "size", "blank") if "size" in blank else None
        mesh = self.choice(blank, "mesh", "blank", ("fibre", "free"), "fibre", or_path=True)
        own = isinstance(mesh, Path)
        if own and "shape" not in blank:
            check_keys(blank, ["orientation", "size", "mesh", "mesh_scale"], "blank")
        if own and "shape" in blank:
            raise InputError("[blank] mesh is a file, which has its own outline: leave out shape")
        if not own and "mesh_scale" in blank:
            raise InputError("[blank] mesh_scale goes with a mesh from a file")
        scene = SceneFile(
            name=name,
            outline=shapely.Polygon() if own else self.outline(blank),
            travel=self.number(table, "travel", ""),
            tools=[self.tool(name, tools) for name in tools],
            orientation=self.number(blank, "orientation", "blank", 0.0, signed=True),
            size=size,
            mesh=mesh,
            mesh_scale=self.number(blank, "mesh_scale", "blank", 1.0),
            law=self.law(table.get("law", "locking")),
            gravity=self.flag(table, "gravity", "", False),
            supports=[
                self.support(entry, f"supports {i}")
                for i, entry in enumerate(self.entries(table, "supports"), 1)
            ],
            grippers=[
                self.gripper(entry, f"grippers {i}")
                for i, entry in enumerate(self.entries(table, "grippers"), 1)
            ],
            areas={name: self.area(name, table["areas"]) for name in self.table(table, "areas")},
            symmetry=self.choice(table, "symmetry", "", ("auto", "none"), "auto"),
            increment=self.number(increments, "largest", "increments", 5.0),
            rows=self.number(increments, "rows", "increments", 5.0),
            outputs={
                key: self.flag(outputs, key, "outputs", True) for key in ("pictures", "increments")
            },
            standings=self.standings,
        )
        for key in ("increment", "rows"):
            if scene.travel > MOST_ROWS * getattr(scene, key):
                named = {"increment": "largest"}.get(key, key)
                raise InputError(
                    f"increments.{named} must be at least 1/{MOST_ROWS} of the travel, "
                    f"{scene.travel / MOST_ROWS:g} mm, got {getattr(scene, key):g}"
                )
        if not any(tool.motion == "driven" for tool in scene.tools):
            raise InputError("no tool is driven: one of [tools] needs role = 'punch'")
        return scene

    # Parts

    def outline(self, table: Table) -> shapely.Polygon:
        polygon = self.region(table, "blank")
        holes = [
            self.region(hole, f"blank.holes {i}", ("rectangle", "disc", "polygon"))
            for i, hole in enumerate(self.entries(table, "holes"), 1)
        ]
        return outlines.with_holes(polygon, holes) if holes else polygon

    def region(self, table: Table, where: str, known: tuple[str, ...] = ()) -> shapely.Polygon:
        known = known or ("rectangle", "disc", "polygon", "file")
        shape = self.choice(table, "shape", where, known, None)
        more = ["holes", "orientation", "size", "mesh", "mesh_scale"] * (where == "blank")
        check_keys(table, ["shape", "centre", *REGION[shape], *more], where)
        centre = self.vector(table, "centre", where, 2, (0.0, 0.0))
        if shape == "rectangle":
            sides = [self.number(table, key, where) for key in ("length", "width")]
            polygon = outlines.rectangle(*sides)
        elif shape == "disc":
            polygon = outlines.disc(self.number(table, "radius", where))
        elif shape == "polygon":
            if "points" not in table:
                raise InputError(f"[{where}] points missing")
            polygon = outlines.polygon(table["points"])
        else:
            path = self.path(table, "file", where)
            polygon = outlines.read_outline(path, self.number(table, "scale", where, 1.0))
        return shapely.affinity.translate(polygon, *centre)

    def tool(self, name: str, tools: Table) -> ToolPart:
        where = f"tools.{name}"
        table = self.table(tools, name, where="tools.", required=True)
        if "role" not in table and (near := difflib.get_close_matches(name, MOTIONS, n=1)):
            if near[0] != name:
                raise InputError(
                    f"[{where}] did you mean [tools.{near[0]}]? Another name needs role = 'punch', "
                    "'die' or 'holder'"
                )
        role = self.choice(table, "role", where, tuple(MOTIONS), name if name in MOTIONS else None)
        common = ["role", "motion", "friction", "mass", "force", "z", "place", "tilt"]
        if "file" in table:
            check_keys(
                table, [*common, "file", "scale", "flip", "rotate", "origin", "spacing"], where
            )
            spacing = self.number(table, "spacing", where) if "spacing" in table else None
            shape: Shape | SurfaceFile = SurfaceFile(
                self.path(table, "file", where),
                self.number(table, "scale", where, 1.0),
                self.flag(table, "flip", where, False),
                self.vector(table, "rotate", where, 3, (0.0, 0.0, 0.0)),
                self.vector(table, "origin", where, 3, (0.0, 0.0, 0.0)),
                spacing,
            )
        else:
            kind = self.choice(table, "shape", where, tuple(SHAPES), None)
            build, keys = SHAPES[kind]
            check_keys(table, [*common, "shape", *keys], where)
            numbers = {}
            for key in keys:
                angle = key == "azimuth"
                numbers[key] = self.number(table, key, where, 0.0 if angle else None, signed=angle)
                if numbers[key] > FAR / 4 and not angle:  # a straight tool ends at FAR
                    raise InputError(
                        f"{where}.{key} must not exceed {FAR / 4:g} mm, got {numbers[key]:g}"
                    )
            try:
                shape = build(**numbers)
            except InputError as error:
                raise InputError(f"[{where}] {error}") from error
            if role == "holder":
                shape = flipped(shape)
        motion = self.choice(table, "motion", where, ("driven", "fixed", "free"), MOTIONS[role])
        loads = {key: self.number(table, key, where, 0.0, zero=True) for key in ("mass", "force")}
        if motion == "free" and not any(loads.values()):
            raise InputError(f"[{where}] a free tool needs a mass or a force")
        if motion != "free" and any(key in table for key in ("mass", "force", "tilt")):
            raise InputError(
                f"[{where}] mass, force and tilt belong to a tool with motion = 'free'"
            )
        return ToolPart(
            name="blank holder" if name == "holder" else name,
            role=role,
            motion=motion,
            shape=shape,
            friction=(
                self.number(table, "friction", where, zero=True) if "friction" in table else None
            ),
            z=self.number(table, "z", where, signed=True) if "z" in table else None,
            place=self.vector(table, "place", where, 2, (0.0, 0.0)),
            tilt=self.flag(table, "tilt", where, True) if "tilt" in table else None,
            **loads,
        )

    def where(self, table: Table, where: str) -> Where:
        given = [key for key in ("side", "box", "centre") if key in table]
        if len(given) != 1 or ("radius" in table and given != ["centre"]):
            raise InputError(f"[{where}] give one of side, box, or centre and radius")
        if given == ["side"]:
            return Where(side=self.choice(table, "side", where, ("+x", "-x", "+y", "-y"), None))
        if given == ["box"]:
            return Where(box=self.vector(table, "box", where, 4, None))
        return Where(
            centre=self.vector(table, "centre", where, 2, None),
            radius=self.number(table, "radius", where),
        )

    def support(self, table: Table, where: str) -> Support:
        check_keys(table, ["side", "box", "centre", "radius", "fix", "clamp"], where)
        clamp = self.flag(table, "clamp", where, False)
        fix = table.get("fix", "xyz" if clamp else None)
        if not isinstance(fix, str) or not fix or set(fix) - set("xyz"):
            raise InputError(f"[{where}] fix = {fix!r}: expected some of the letters xyz")
        return Support(self.where(table, where), fix, clamp)

    def gripper(self, table: Table, where: str) -> Gripper:
        keys = ["side", "box", "centre", "radius", "direction", "tension", "stiffness"]
        check_keys(table, keys, where)
        place = self.where(table, where)
        outward = None
        if place.side:
            sign = 1.0 if place.side[0] == "+" else -1.0
            outward = (sign, 0.0) if place.side[1] == "x" else (0.0, sign)
        direction = np.array(self.vector(table, "direction", where, 2, outward))
        if not direction.any():
            raise InputError(f"[{where}] direction must not be zero")
        loads = {
            key: self.number(table, key, where, 0.0, zero=True) for key in ("tension", "stiffness")
        }
        if not any(loads.values()):
            raise InputError(f"[{where}] needs a tension or a stiffness")
        return Gripper(place, tuple(direction / np.linalg.norm(direction)), **loads)

    def area(self, name: str, areas: Table) -> tuple[tuple[float, float], float]:
        where = f"areas.{name}"
        table = self.table(areas, name, where="areas.", required=True)
        check_keys(table, ["centre", "radius", "unit", "standing"], where)
        if table.get("unit", "mm") != "mm":
            raise InputError(f"{where}: unit must be 'mm', got {table['unit']!r}")
        if "standing" in table:
            self.standings[where] = _standing(table, where)
        return (
            self.vector(table, "centre", where, 2, None),
            self.number(table, "radius", where),
        )

    # Values

    def table(self, parent: Table, key: str, *, where: str = "", required: bool = False) -> Table:
        if key not in parent and not required:
            return {}
        if not isinstance(parent.get(key), dict):
            raise InputError(f"table [{where}{key}] missing")
        return parent[key]

    def entries(self, parent: Table, key: str) -> list[Table]:
        entries = parent.get(key, [])
        if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
            raise InputError(f"{key}: expected tables [[{key}]]")
        return entries

    def number(
        self,
        table: Table,
        key: str,
        where: str,
        default: float | None = None,
        *,
        signed: bool = False,
        zero: bool = False,
    ) -> float:
        name = f"{where}.{key}" if where else key
        if key not in table:
            if default is None:
                raise InputError(f"[{where}] {key} missing" if where else f"{key} missing")
            return default
        value = table[key]
        if isinstance(value, dict):
            check_keys(value, ["value", "unit", "standing"], name)
            unit = {"mass": "kg", "force": "N", "tension": "N", "stiffness": "N/mm"}.get(key, "mm")
            unit = "deg" if signed and key in ("azimuth", "orientation") else unit
            unit = "1" if key == "friction" else unit
            if value.get("unit", unit) != unit:
                raise InputError(f"{name}: unit must be {unit!r}, got {value['unit']!r}")
            self.standings[name] = _standing(value, name)
            value = value.get("value")
        if signed:
            if type(value) not in (int, float) or not abs(value) <= LARGEST:
                raise InputError(f"{name} must be a number of up to {LARGEST:g}, got {value!r}")
            return float(value)
        if check_number(name, value, zero_allowed=zero) > LARGEST:
            raise InputError(f"{name} must not exceed {LARGEST:g}, got {value!r}")
        return float(value)

    def vector(
        self, table: Table, key: str, where: str, length: int, default: tuple | None
    ) -> tuple:
        value = table.get(key, default)
        if isinstance(value, tuple):
            return value
        numbers = isinstance(value, list) and all(
            type(c) in (int, float) and abs(c) <= LARGEST for c in value
        )
        if not numbers or len(value) != length:
            wanted = VECTORS.get(key, f"{length} numbers")
            raise InputError(f"[{where}] {key} = {value!r}: expected {wanted} of up to {LARGEST:g}")
        return tuple(float(c) for c in value)

    def flag(self, table: Table, key: str, where: str, default: bool) -> bool:
        value = table.get(key, default)
        if not isinstance(value, bool):
            name = f"[{where}] {key}" if where else key
            raise InputError(f"{name} = {value!r}: expected true or false")
        return value

    def choice(
        self,
        table: Table,
        key: str,
        where: str,
        known: tuple[str, ...],
        default: str | None,
        *,
        or_path: bool = False,
    ) -> Any:
        name = f"[{where}] {key}" if where else key
        value = table.get(key, default)
        if value is None:
            raise InputError(f"{name} missing: expected one of {', '.join(known)}")
        if value in known:
            return value
        if not isinstance(value, str):
            raise InputError(f"{name} = {value!r}: expected one of {', '.join(known)}")
        if or_path and "." in value:
            return self.path(table, key, where)
        raise InputError(f"{name} = {value!r}: {suggestion(value, known)}")

    def path(self, table: Table, key: str, where: str) -> Path:
        value = table.get(key)
        if not isinstance(value, str) or not value or "\0" in value:
            raise InputError(f"[{where}] {key} = {value!r}: expected the path of a file")
        return self.folder / value

    def law(self, value: Any) -> str:
        if not isinstance(value, str):
            raise InputError(f"law = {value!r}: expected a preset or the path of a material file")
        return str(self.folder / value) if value.endswith(".toml") else value


def _standing(entry: Table, where: str) -> str:
    standing = entry.get("standing")
    if standing not in STANDINGS:
        raise InputError(
            f"{where}: standing must be one of {', '.join(STANDINGS)}, got {standing!r}"
        )
    return standing
