"""Forming scenes as TOML files: blank, tools, supports, what is measured; nothing is computed here.

The built-in scenes (`geometries/*.toml`) are such files. A number is written plainly, or as
`{ value, unit, standing }` where it carries its standing (stated, assumed, measured, ...).
Lengths are mm, masses kg, forces N, angles degrees. Paths are relative to the file.

A `SceneFile` and its parts are plain data, from which outline and tools are built when they are
asked for; `scene_toml` writes it back.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..checks import InputError, suggestion
from ..toml_file import read_toml, toml_text
from ..tools.part import SHAPES, Form, ToolPart
from ..tools.surface_file import SurfaceFile
from .scene_parts import (
    OF_A_FILE,
    OF_A_TOOL,
    REGION,
    Gripper,
    Region,
    SceneFile,
    Support,
    Where,
)

__all__ = ["Form", "Gripper", "Region", "SceneFile", "Support", "SurfaceFile", "ToolPart", "Where"]
_PACKAGED = Path(__file__).parents[1] / "geometries"
FOLDER = _PACKAGED if _PACKAGED.is_dir() else Path(__file__).parents[2] / "geometries"


def built_in() -> list[str]:
    """Names of the scenes that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name: str) -> SceneFile:
    """Read a built-in scene by name, or a TOML file.

    InputError in one line that names file, table and key.
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


def read_text(written: Mapping[str, str]) -> SceneFile:
    """Return the scene that `scene_toml` has written as `toml`, with its `source`."""
    from .scene_schema import read_scene  # pydantic

    file = read_scene(tomllib.loads(written["toml"]), Path(), "scene")
    return replace(file, source=written["source"])


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene file: keys, units, limits and defaults, for editors."""
    from .scene_schema import Scene

    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return dialect | Scene.model_json_schema()


def scene_toml(file: SceneFile) -> str:
    """Return a scene as the text of a TOML file with every default; paths are absolute."""
    blank = _region(file.blank) if file.blank else {"mesh_scale": file.mesh_scale}
    blank |= {"orientation": file.orientation, "size": file.size, "mesh": file.mesh}
    tools = {"holder" if t.name == "blank holder" else t.name: _tool(t) for t in file.tools}
    settings = ("name", "travel", "law", "gravity", "symmetry")
    table = {key: getattr(file, key) for key in settings} | {
        "blank": blank,
        "tools": tools,
        "supports": [_edge(support) for support in file.supports],
        "grippers": [_edge(gripper) for gripper in file.grippers],
        "areas": {name: {"centre": c, "radius": r} for name, (c, r) in file.areas.items()},
        "increments": {"largest": file.increment, "rows": file.rows},
        "outputs": dict(file.outputs),
    }
    if file.law.endswith(".toml"):
        table["law"] = Path(file.law)
    return toml_text(_plain(table, "", file.standings))


def _region(region: Region) -> dict[str, Any]:
    keys = dict(zip(REGION[region.shape][1], region.parameters, strict=True))
    holes = {"holes": [_region(hole) for hole in region.holes]} if region.holes else {}
    return {"shape": region.shape, **keys, "centre": region.centre, **holes}


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


def _edge(edge: Support | Gripper) -> dict[str, Any]:
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
