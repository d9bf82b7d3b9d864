"""Forming scenes as TOML files: blank, tools, supports, what is measured; nothing is computed here.

The built-in scenes (`geometries/*.toml`) are such files. A number is written plainly, or as
`{ value, unit, standing }` where it carries its standing (stated, assumed, measured, ...).
Lengths are mm, masses kg, forces N, angles degrees. Paths are relative to the file.

The tables of a file are pydantic models, which become a `SceneFile` of plain parts (`scene_parts`);
`scene_toml` writes it back.
"""

import difflib
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    StrictBool,
    StrictStr,
    Tag,
    create_model,
    model_validator,
)

from .. import schema
from ..checks import FORMAT, InputError, check_keys, suggestion
from ..fabric import Fabric, fabric_of
from ..recipe import checksums
from ..schema import LARGEST, OPEN, Table, checked, number, path, vector
from ..toml_file import read_toml, toml_text, without_format
from ..tools.part import SHAPES, Form, ToolPart
from ..tools.shapes import FAR, Rows
from ..tools.surface_file import SurfaceFile
from .overrides import merged, overridden
from .scene_parts import (
    MOTIONS,
    OUTWARDS,
    REGION,
    SYMMETRIES,
    ElasticSheet,
    Gripper,
    Ply,
    Region,
    SceneFile,
    Seam,
    Slit,
    Support,
    Where,
)

__all__ = [
    *("Form", "Gripper", "Ply", "Region", "SceneFile", "Slit", "Support", "SurfaceFile"),
    *("ToolPart", "Where"),
]
_PACKAGED = Path(__file__).parents[1] / "geometries"
FOLDER = _PACKAGED if _PACKAGED.is_dir() else Path(__file__).parents[2] / "geometries"
OF_A_TOOL = ("friction", "mass", "force", "z", "place", "tilt", "stroke")
OF_A_FILE = ("scale", "flip", "rotate", "origin", "spacing", "offset")
MOST_ROWS = 10_000
LENGTHS = {  # of the shapes, mm
    "length": "Along x",
    "width": "Along y",
    "radius": "Radius",
    "fillet": "Radius of the edge that the sheet is drawn over",
    "edge_radius": "Radius of the rounded edges",
    "corner_radius": "Radius of the corners, seen from above",
    "base_edge": "Edge of the base, before rounding",
    "height": "Height from base to tip, before rounding",
    "edge": "Edge of the triangle, before rounding",
}


def _mesh(value: Any) -> str:
    word = value if isinstance(value, str) else ""
    if "." in word:
        raise InputError("is a file, which has its own outline: leave out shape")
    if word not in ("fibre", "free"):
        raise InputError(f"= {value!r}: {suggestion(word, ('fibre', 'free'))}")
    return word


def _law(value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"= {value!r}: expected a preset or the path of a material file")
    return value


def _points(value: Any) -> tuple[tuple[float, ...], ...]:
    good = isinstance(value, list) and all(
        isinstance(point, list) and [type(c) in (int, float) for c in point] == [True, True]
        for point in value
    )
    if not good or not np.isfinite(np.array(value, dtype=float)).all():
        raise InputError("must be a list of [x, y] in mm")
    return tuple((float(x), float(y)) for x, y in value)


POINT = vector("x and y, mm", 2)
PLACE = vector("x and y of its middle, mm", 2, "2 numbers, x and y in mm such as [10, 0],")
TURN = "3 numbers, the angles in degrees about x, y and z such as [180, 0, 0],"
ORIGIN = "3 numbers, the point of the file in mm such as [200, 100, 0],"
_PAIR = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
KEYS = {  # type and default of the keys of a shape; all others are lengths that must be given
    "points": (checked(_points, type="array", items=_PAIR, description="Corners x, y, mm"), ...),
    "file": (path("Drawing, mesh or table of the outline"), ...),
    "scale": (number("Length of one unit of the file", "mm"), 1.0),
    "layer": (Annotated[StrictStr, Field(description="Of a .dxf, the only one to read")], OPEN),
    "azimuth": (number("Direction of a corner, from x", "deg", signed=True), 0.0),
}


def _flag(text: str) -> Any:
    return Annotated[StrictBool, Field(description=text)]


def _word(text: str, *words: str) -> Any:
    return Annotated[Literal[words], Field(description=text)]


def _union(
    base: type[Table], kinds: dict[str, tuple], most: float, made: Callable, *others: Any
) -> Any:
    """Type of a table with a shape: one model for each, and what is `made` of it."""
    named = base is not _Cut  # else its keys tell
    models = list(others)
    for kind, (_, names) in kinds.items():
        keys = {key: KEYS.get(key) or (number(LENGTHS[key], "mm", most=most), ...) for key in names}
        model = create_model(
            kind, __base__=base, shape=(Literal[kind], ... if named else kind), **keys
        )
        models.append(Annotated[model, Tag(kind)])
    which = shape if named else cut_shape
    which = tool_shape if kinds is SHAPES else which
    return Annotated[reduce(or_, models), Discriminator(which), AfterValidator(made)]


def shape(table: Any) -> str | None:
    """Which model a blank or a hole has."""
    if not isinstance(table, Mapping):
        return None
    mesh = table.get("mesh")
    own = isinstance(mesh, str) and "." in mesh and "shape" not in table
    return "(own mesh)" if own else str(table.get("shape"))


def cut_shape(table: Any) -> str | None:
    """Which model a hole or a dart has: without a shape, that with its points or its file."""
    if isinstance(table, Mapping) and "shape" not in table:
        return "polygon" if "points" in table else "file" if "file" in table else str(None)
    return shape(table)


def tool_shape(table: Any) -> str | None:
    """Which model a tool has."""
    return "(surface file)" if isinstance(table, Mapping) and "file" in table else shape(table)


# Blank


class _Sheet(Table):
    orientation: number("Angle of the warp to x", "deg", signed=True) = 0.0
    size: number("Spacing of the fibre lines; well below the smallest fillet", "mm") = OPEN
    mesh_scale: number("Length of one unit of the mesh file", "mm") = OPEN


class _OwnMesh(_Sheet):
    mesh: path("The user's own mesh, which has its own outline")


class _Region(Table):
    centre: POINT = (0.0, 0.0)


def _region(table: Any) -> Region:
    values = tuple(getattr(table, key) for key in REGION[table.shape][1])
    cuts = {key: tuple(getattr(table, key, ())) for key in ("holes", "darts", "slits")}
    region = Region(table.shape, values, table.centre, **cuts)
    _ = region.loops if isinstance(table, _Cut) else region.lines  # refuses what is none
    return region


class _Cut(_Region):
    pass


class _Slit(Table):
    points: KEYS["points"][0] = OPEN
    file: path("Drawing or table of the lines") = OPEN
    scale: KEYS["scale"][0] = 1.0
    layer: KEYS["layer"][0] = OPEN
    centre: POINT = (0.0, 0.0)


def _slit(table: _Slit) -> Slit:
    if (table.points is None) == (table.file is None):
        raise InputError("give points or a file")
    if table.file is None and table.model_fields_set & {"scale", "layer"}:
        raise InputError("scale and layer go with a file")
    slit = Slit(table.points or (), table.file, table.scale, table.layer, table.centre)
    _ = slit.lines  # refuses what is none
    return slit


def _several(made: Any) -> Any:
    """Type of a list of tables; one alone may stand for it."""

    def listed(value: Any) -> Any:
        return [value] if isinstance(value, Mapping) else value

    return Annotated[list[made], BeforeValidator(listed, json_schema_input_type=list[made] | made)]


_CUT = _union(_Cut, REGION, LARGEST, _region)
_SLIT = Annotated[_Slit, AfterValidator(_slit)]


class _Outline(_Region):
    holes: _several(_CUT) = []  # noqa: RUF012
    darts: _several(_CUT) = []  # noqa: RUF012
    slits: _several(_SLIT) = []  # noqa: RUF012


class _Blank(_Sheet, _Outline):
    mesh: checked(_mesh, enum=["fibre", "free"], description="Along the fibres, or free") = "fibre"


def _blank(table: _Blank | _OwnMesh) -> dict[str, Any]:
    """What it is in a `SceneFile`."""
    own = isinstance(table, _OwnMesh)
    if not own and table.slits and table.mesh != "fibre":
        raise InputError("slits need mesh = 'fibre'")
    if not own and table.mesh_scale is not None:
        raise InputError("mesh_scale goes with a mesh from a file")
    sheet = table.model_dump(include={"orientation", "size", "mesh"})
    return sheet | {"blank": None if own else _region(table), "mesh_scale": table.mesh_scale or 1.0}


class _Seam(Table):
    points: checked(_points, type="array", items=_PAIR, description="x, y of the flat ply, mm")
    spacing: number("Of the stitches of a line through the points", "mm") = OPEN
    stiffness: number("Of a thread", "N/mm") = OPEN
    slack: number("Of a thread", "mm", zero=True) = 0.0


def _seam(table: _Seam) -> Seam:
    seam = Seam(**dict(table))
    _ = seam.places  # refuses what is none
    return seam


class _Ply(Table):
    orientation: number("Angle of its warp to that of the scene", "deg", signed=True) = 0.0
    law: checked(_law, type="string", description="That of the scene if left out") = OPEN
    fabric: Annotated[dict[str, Any], Field(description="Keys that replace those of `law`")] = OPEN
    blank: _union(_Outline, REGION, LARGEST, _region) = OPEN
    offset: POINT = (0.0, 0.0)
    joined: _flag("Whether it is stitched or bonded to the ply above it") = False
    friction: number("Coulomb coefficient with the ply above it", "1", zero=True) = OPEN
    stitches: _several(Annotated[_Seam, AfterValidator(_seam)]) = []  # noqa: RUF012


def _ply(number: int, table: _Ply, law: str | Fabric, folder: Path) -> Ply:
    """One layer; `law` is that of the scene."""
    own = table.law and (str(folder / table.law) if table.law.endswith(".toml") else table.law)
    if table.fabric is not None:
        own = _fabric(table.fabric, own or law, f"[plies {number}.fabric]")
    given = {key: value for key, value in table if key != "fabric"}
    return Ply(**given | {"law": own, "stitches": tuple(table.stitches)})


class _Diaphragm(Table):
    modulus: number("Young's modulus", "MPa")
    thickness: number("Thickness without stress", "mm")
    poisson: number("Poisson's ratio", "1", most=0.5) = 0.5
    prestretch: number("Stretch of its flat outline", "1", most=10.0) = 1.0
    side: _word("On which side of the plies", "above", "under") = "above"
    clamped: _flag("Whether its edge is clamped") = True
    friction: number("Coulomb coefficient with the plies", "1", zero=True) = 0.0
    blank: _union(_Outline, REGION, LARGEST, _region) = OPEN


def _diaphragm(table: _Diaphragm) -> ElasticSheet:
    if table.prestretch < 1.0:
        raise InputError(f"prestretch must be at least 1, got {table.prestretch:g}")
    if table.prestretch > 1.0 and not table.clamped:
        raise InputError("prestretch needs clamped = true")
    return ElasticSheet(**dict(table))


# Tools


class _Tool(Table):
    role: _word("Its name if left out", "punch", "die", "holder") = OPEN
    motion: _word("That of its role if left out", "driven", "fixed", "free") = OPEN
    friction: number("Coulomb coefficient; the fabric's if left out", "1", zero=True) = OPEN
    mass: number("Mass that rests on the sheet", "kg", zero=True) = 0.0
    force: number("Force on the sheet beside the weight", "N", zero=True, over="mm") = 0.0
    stroke: number("Way down over the travel, of a driven tool", "mm", signed=True, over="mm") = (
        OPEN
    )
    z: number("Height; where it touches the sheet if left out", "mm", signed=True) = OPEN
    place: PLACE = (0.0, 0.0)
    tilt: _flag("Whether a free tool may tilt") = OPEN


class _FromFile(_Tool):
    file: path("The tool's surface")
    scale: number("Length of one unit of the file", "mm") = 1.0
    flip: _flag("Whether the inside of the surface is out") = False
    rotate: vector("Turn about x, y and z, degrees", 3, TURN) = (0.0, 0.0, 0.0)
    origin: vector("Point of the file that comes to the middle, mm", 3, ORIGIN) = (0.0, 0.0, 0.0)
    spacing: number("Spacing of the grid of distances of a surface file", "mm") = OPEN
    offset: number("Clearance: moves the surface into the tool", "mm", signed=True) = 0.0


def _part(table: _Tool) -> ToolPart:
    if isinstance(table, _FromFile):
        geometry = SurfaceFile(table.file, *(getattr(table, key) for key in OF_A_FILE))
    else:
        geometry = Form(table.shape, tuple(getattr(table, key) for key in SHAPES[table.shape][1]))
    motion = table.motion or MOTIONS[table.role]
    values = {key: getattr(table, key) for key in OF_A_TOOL}
    part = ToolPart("", table.role, motion, geometry, **values)
    _ = part.shape  # refuses numbers that make no shape
    rows = part.force if isinstance(part.force, tuple) else ((0.0, part.force),)
    if motion == "free" and not (part.mass or all(force for _, force in rows)):
        raise InputError("a free tool needs a mass or a force, over the whole travel")
    if motion != "free" and table.model_fields_set & {"mass", "force", "tilt"}:
        raise InputError("mass, force and tilt belong to a tool with motion = 'free'")
    if part.stroke is not None and motion != "driven":
        raise InputError("stroke belongs to a tool with motion = 'driven'")
    if isinstance(part.stroke, tuple) and part.stroke[0][1]:
        raise InputError(f"stroke must start at 0 mm, got {part.stroke[0][1]:g}")
    return part


# Edges that are fixed or pulled


def _ply_numbers(value: Any) -> tuple[int, ...]:
    good = isinstance(value, list | tuple) and all(type(k) is int and k > 0 for k in value)
    if not good or not value:
        raise InputError(f"= {value!r}: expected numbers of plies from 1 on, such as [1, 2]")
    return tuple(value)


NUMBERS = {
    "type": "array",
    "items": {"type": "integer", "minimum": 1},
    "minItems": 1,
    "description": "Numbers of plies; all that lie there if left out",
}


class _Place(Table):
    side: _word("Side of the blank", *OUTWARDS) = OPEN
    box: vector("x0, y0, x1, y1, mm", 4) = OPEN
    centre: POINT = OPEN
    radius: number("Radius", "mm") = OPEN
    plies: checked(_ply_numbers, **NUMBERS) = OPEN


LETTERS = {"type": "string", "pattern": "^[xyz]+$", "description": "Directions that are fixed"}


class _Support(_Place):
    fix: Annotated[Any, Field(json_schema_extra=LETTERS)] = OPEN
    clamp: _flag("Whether the direction of the fibres is kept too") = False


class _Gripper(_Place):
    direction: vector("Of the pull, outwards if left out", 2) = OPEN
    tension: number("Pull", "N", zero=True) = 0.0
    stiffness: number("Decrease of the pull with the motion", "N/mm", zero=True) = 0.0


def _where(table: _Place) -> Where:
    keys = table.model_fields_set
    given = keys & {"side", "box", "centre"}
    if len(given) != 1 or ("radius" in keys and given != {"centre"}):
        raise InputError("give one of side, box, or centre and radius")
    if given == {"centre"} and "radius" not in keys:
        raise InputError("radius missing")
    return Where(**table.model_dump(include=given | (keys & {"radius"})))


def _support(table: _Support) -> Support:
    fix = "xyz" if table.clamp and "fix" not in table.model_fields_set else table.fix
    if not isinstance(fix, str) or not fix or set(fix) - set("xyz"):
        raise InputError(f"fix = {fix!r}: expected some of the letters xyz")
    return Support(_where(table), fix, table.clamp, table.plies)


def _gripper(table: _Gripper) -> Gripper:
    where = _where(table)
    direction = table.direction or OUTWARDS.get(where.side)
    if direction is not None and not any(direction):
        raise InputError("direction must not be zero")
    if not (table.tension or table.stiffness):
        raise InputError("needs a tension or a stiffness")
    length = float(np.linalg.norm(direction)) if direction else 1.0
    if abs(length - 1) > 1e-12:  # else it is the same when it is read again
        direction = (direction[0] / length, direction[1] / length)
    return Gripper(where, direction, table.tension, table.stiffness, table.plies)


# The whole


class _Area(Table):
    centre: POINT
    radius: number("Radius", "mm")
    unit: Literal["mm"] = "mm"
    standing: Literal[schema.STANDINGS] = OPEN

    @model_validator(mode="before")
    @classmethod
    def _standing(cls, table: Any) -> Any:
        if isinstance(table, Mapping) and table.keys() & {"unit", "standing"}:
            schema.check_standing({"standing": "assumed", **table}, "mm", *cls.model_fields)
        return table


class _Increments(Table):
    largest: number("Largest increment of the travel; else near 1/60 of the blank", "mm") = OPEN
    rows: number("Distance of the rows of history.csv; as `largest`", "mm") = OPEN


class _Outputs(Table):
    pictures: _flag("Whether pictures are drawn") = True
    increments: _flag("Whether each row has its .vtu file") = True


_OWN_MESH = Annotated[_OwnMesh, Tag("(own mesh)")]
_FROM_FILE = Annotated[_FromFile, Tag("(surface file)")]
FAR_OFF = FAR / 4  # mm; a straight tool ends at FAR


class Run(Table):
    """How a scene is solved."""

    increment: number("Increment of the travel; chosen by the program if left out", "mm") = OPEN
    accuracy: number("Refine until the error of the shear angle (p99) is below", "deg") = OPEN
    seeds: Annotated[int, Field(strict=True, ge=1, le=1000, description="Perturbed starts")] = OPEN
    linear: _word("Linear solver", "auto", "pardiso", "superlu") = "auto"
    one_mesh: _flag("Whether the whole path is followed on this mesh") = False
    estimate: _flag("Whether the error of the mesh is estimated") = True
    draft: _flag("Whether it is solved with twice the size and the increments") = False


class Scene(Table):
    """A forming scene: lengths in mm, masses in kg, forces in N, angles in degrees.

    Paths are relative to the file.
    """

    name: StrictStr = OPEN
    travel: number("Travel of the driven tools from first touch, or path of a pressure", "mm")
    law: checked(_law, type="string", description="Preset, or path of a material file") = "locking"
    fabric: Annotated[dict[str, Any], Field(description="Keys that replace those of `law`")] = OPEN
    gravity: _flag("Whether the sheet's own weight acts") = False
    pressure: number("On the upper face; a number rises from 0", "MPa", zero=True, over="mm") = OPEN
    symmetry: _word("Mirror planes that are used: all, at most one, none", *SYMMETRIES) = "auto"
    blank: _union(_Blank, REGION, LARGEST, _blank, _OWN_MESH)
    tools: dict[str, _union(_Tool, SHAPES, FAR_OFF, _part, _FROM_FILE)]
    supports: list[Annotated[_Support, AfterValidator(_support)]] = []  # noqa: RUF012
    grippers: list[Annotated[_Gripper, AfterValidator(_gripper)]] = []  # noqa: RUF012
    plies: Annotated[list[_Ply], Field(description="Layers, from the punch down")] = []  # noqa: RUF012
    diaphragm: Annotated[_Diaphragm, AfterValidator(_diaphragm)] = OPEN
    areas: dict[str, _Area] = {}  # noqa: RUF012
    increments: _Increments = _Increments()
    outputs: _Outputs = _Outputs()
    run: Run = OPEN
    files: Annotated[dict[str, str], Field(description="SHA-256 of files, by path")] = OPEN

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_increments(self.travel, **self.increments.model_dump())
        driven = any(tool.motion == "driven" for tool in self.tools.values())
        if not driven and (self.pressure is None or not self.tools):
            words = "one of [tools] needs role = 'punch', or the scene a tool and a pressure"
            raise InputError(f"no tool is driven: {words}")
        return self


def check_increments(travel: float, **increments: float | None) -> None:
    """Refuse (InputError) a travel that has too many increments or rows, mm."""
    for key, value in increments.items():
        if value is not None and travel > MOST_ROWS * value:
            least = f"1/{MOST_ROWS} of the travel, {travel / MOST_ROWS:g} mm"
            raise InputError(f"increments.{key} must be at least {least}, got {value:g}")


NOT_POSSIBLE = {  # keys that people try: what is possible instead
    "layers": "layers are given as [[plies]], from the punch down",
    "temperature": "the fabric is dry and cold: no matrix, no temperature",
}


def _refuse_impossible(table: Any) -> None:
    """Say of a key of what is not modelled that it is not possible."""
    for key, value in table.items() if isinstance(table, Mapping) else ():
        if key in NOT_POSSIBLE:
            raise InputError(f"'{key}' is not possible: {NOT_POSSIBLE[key]}")
        _refuse_impossible(value)


def _scene(table: dict[str, Any], folder: Path, stem: str) -> SceneFile:
    """Return the scene that the table of a file describes; `stem` is its name where it has none."""
    _refuse_impossible({k: v for k, v in table.items() if k not in ("fabric", "areas")})
    check_keys(table, Scene.model_fields)
    for key in ("blank", "tools"):
        if not isinstance(table.get(key), dict):
            raise InputError(f"table [{key}] missing")
    tools = {name: _with_role(name, tool) for name, tool in table["tools"].items()}
    scene = schema.validated(Scene, {**table, "tools": tools}, folder)
    law = str(folder / scene.law) if scene.law.endswith(".toml") else scene.law
    if scene.fabric is not None:
        law = _fabric(scene.fabric, law if "law" in table else "")
    file = SceneFile(
        name=stem if scene.name is None else scene.name,
        tools=tuple(
            replace(
                part,
                name="blank holder" if name == "holder" else name,
                stroke=over_travel(part.stroke, scene.travel),
            )
            for name, part in scene.tools.items()
        ),
        law=law,
        supports=tuple(scene.supports),
        grippers=tuple(scene.grippers),
        plies=tuple(_ply(k, ply, law, folder) for k, ply in enumerate(scene.plies, 1)),
        diaphragm=scene.diaphragm,
        areas={name: (area.centre, area.radius) for name, area in scene.areas.items()},
        increment=scene.increments.largest,
        rows=scene.increments.rows,
        outputs=scene.outputs.model_dump(),
        run={} if scene.run is None else scene.run.model_dump(exclude_none=True),
        standings=schema.standings(table),
        **scene.model_dump(include={"travel", "gravity", "symmetry", "pressure"}),
        **scene.blank,
    )
    for name, digest in (checksums(file.files()) if scene.files else {}).items():
        if scene.files.get(name, digest) != digest:
            words = "has changed since this scene was written; remove [files] to use it as it is"
            raise InputError(f"{name} {words}")
    return file


def over_travel(value: float | Rows | None, travel: float) -> Rows | None:
    """Rows over the travel of a value, which rises from zero to the end where it is a number."""
    return ((0.0, 0.0), (travel, value)) if isinstance(value, float) else value


def _fabric(table: dict[str, Any], law: str | Fabric, where: str = "[fabric]") -> Fabric:
    """Return the fabric of a scene: the keys of its table over those of a law, if there is one."""
    law = law or ("" if "shear" in table else "locking")
    try:
        return Fabric.read(merged(fabric_of(law).written(), table) if law else table)
    except InputError as error:
        raise InputError(f"{where} {error}") from error


def _with_role(name: str, tool: Any) -> dict[str, Any]:
    """Give a tool the role that its name says."""
    if not isinstance(tool, dict):
        raise InputError(f"tools.{name} = {tool!r}: expected a table [tools.{name}]")
    if "role" in tool:
        return tool
    near = difflib.get_close_matches(name, MOTIONS, n=1)
    if not near:
        known = ", ".join(MOTIONS)
        raise InputError(f"[tools.{name}] role missing: expected one of {known}")
    if near[0] != name:
        words = f"[tools.{name}] did you mean [tools.{near[0]}]?"
        raise InputError(f"{words} Another name needs role = 'punch', 'die' or 'holder'")
    return tool | {"role": name}


# Reading and writing


def built_in() -> list[str]:
    """Names of the scenes that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name: str, overrides: Mapping[str, Any] | None = None) -> SceneFile:
    """Read a built-in scene by name, or a TOML file; `overrides` have the dotted names of keys.

    InputError in one line that names file, table and key.
    """
    if name in built_in():
        place = FOLDER / f"{name}.toml"
    elif name.endswith(".toml"):
        place = Path(name)
    else:
        known = suggestion(name, built_in())
        raise InputError(f"unknown scene '{name}': {known} (or a .toml file)")

    def build(table: dict[str, Any]) -> SceneFile:
        return _scene(overridden(table, overrides or {}), place.parent, place.stem)

    file = read_toml(place, build)
    return file if name in built_in() else replace(file, source=str(place.resolve()))


def changed(file: SceneFile, overrides: Mapping[str, Any]) -> SceneFile:
    """Return a scene with other values of its keys, by their dotted names."""
    table = without_format(tomllib.loads(scene_toml(file)))
    again = _scene(overridden(table, overrides), Path(), file.name)
    return replace(again, source=file.source)


def read_text(written: Mapping[str, str]) -> SceneFile:
    """Return the scene that `scene_toml` has written as `toml`, with its `source`."""
    file = _scene(without_format(tomllib.loads(written["toml"])), Path(), "scene")
    return replace(file, source=written["source"])


def json_schema(file: type[Table] = Scene) -> dict[str, Any]:
    """Return the JSON schema of a scene file: keys, units, limits and defaults, for editors."""
    schema = file.model_json_schema()
    schema["properties"]["format"] = {"enum": [1, FORMAT], "description": "Of the file"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema


def scene_toml(file: SceneFile) -> str:
    """Return a scene as the text of a TOML file with every default; paths are absolute."""
    blank = _region_table(file.blank) if file.blank else {"mesh_scale": file.mesh_scale}
    blank |= {"orientation": file.orientation, "size": file.size, "mesh": file.mesh}
    tools = {"holder" if t.name == "blank holder" else t.name: _tool_table(t) for t in file.tools}
    settings = ("name", "travel", "law", "gravity", "pressure", "symmetry")
    given = {"largest": file.increment, "rows": file.rows}
    table = {key: getattr(file, key) for key in settings} | {
        "blank": blank,
        "tools": tools,
        "supports": [_edge_table(support) for support in file.supports],
        "grippers": [_edge_table(gripper) for gripper in file.grippers],
        **({"plies": [_ply_table(ply) for ply in file.plies]} if file.plies else {}),
        **({"diaphragm": _outlined(file.diaphragm)} if file.diaphragm else {}),
        "areas": {name: {"centre": c, "radius": r} for name, (c, r) in file.areas.items()},
        **({"increments": given} if any(given.values()) else {}),
        "outputs": dict(file.outputs),
    }
    if file.run:
        table["run"] = dict(file.run)
    if isinstance(file.law, Fabric):
        table["fabric"] = table.pop("law").written()
    elif file.law.endswith(".toml"):
        table["law"] = Path(file.law)
    return toml_text(_plain(table, "", file.standings))


def _region_table(region: Region) -> dict[str, Any]:
    keys = dict(zip(REGION[region.shape][1], region.parameters, strict=True))
    cuts = {
        "holes": [_region_table(hole) for hole in region.holes],
        "darts": [_region_table(dart) for dart in region.darts],
        "slits": [_slit_table(slit) for slit in region.slits],
    }
    cuts = {key: tables for key, tables in cuts.items() if tables}
    return {"shape": region.shape, **keys, "centre": region.centre, **cuts}


def _slit_table(slit: Slit) -> dict[str, Any]:
    if slit.file is None:
        return {"points": slit.points, "centre": slit.centre}
    return {key: getattr(slit, key) for key in ("file", "scale", "layer", "centre")}


def _outlined(part: Ply | ElasticSheet) -> dict[str, Any]:
    own = {"blank": _region_table(part.blank)} if part.blank else {}
    return {key: value for key, value in vars(part).items() if key != "blank"} | own


def _ply_table(ply: Ply) -> dict[str, Any]:
    table = {key: value for key, value in _outlined(ply).items() if key not in ("law", "stitches")}
    if ply.stitches:
        table["stitches"] = [asdict(seam) for seam in ply.stitches]
    if isinstance(ply.law, Fabric):
        return table | {"fabric": ply.law.written()}
    return table | {"law": Path(ply.law) if ply.law and ply.law.endswith(".toml") else ply.law}


def _tool_table(part: ToolPart) -> dict[str, Any]:
    geometry = part.geometry
    if isinstance(geometry, Form):
        keys = dict(zip(SHAPES[geometry.shape][1], geometry.numbers, strict=True))
        table = {"shape": geometry.shape, **keys}
    elif isinstance(geometry, SurfaceFile):
        table = {"file": geometry.path} | {key: getattr(geometry, key) for key in OF_A_FILE}
    else:
        raise InputError(f"{part.name}: a shape of your own cannot be written to a file")
    others = ("stroke",) if part.motion == "free" else ("mass", "force", "tilt")
    keys = [key for key in OF_A_TOOL if key not in others]
    table |= {"role": part.role, "motion": part.motion}
    return table | {key: getattr(part, key) for key in keys}


def _edge_table(edge: Support | Gripper) -> dict[str, Any]:
    where, keys = edge.where, {k: v for k, v in vars(edge).items() if k != "where"}
    if where.side or where.box:
        return {"side": where.side or None, "box": where.box} | keys
    return {"centre": where.centre, "radius": where.radius} | keys


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
