"""The scene that was run, as the text of a scene file: every default, the fabric, the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..checks import InputError
from ..model import Model
from ..toml_file import toml_text
from .scene_file import SceneFile, scene_toml


def resolved(model: Model, run: Mapping[str, Any]) -> str:
    """Return the scene of a model as TOML; empty if a file cannot hold it.

    `run` is how it was solved, where its scene does not say so. What depends on the fabric (the
    height of tools at first touch, their friction) stays open, and is in the comments.
    """
    given = dict(model.recipe.given) if model.recipe else {}
    file = given.get("file")
    if not isinstance(file, SceneFile):
        return ""
    same: dict[str, Any] = {key: given[key] for key in ("orientation", "travel", "symmetry")}
    run = {"linear": "auto", "estimate": True, "draft": False, **run, **file.run}
    run = {key: value for key, value in run.items() if value is not None}
    same |= {"size": float(model.recipe.size), "law": given["fabric"], "run": run}
    same |= {"increment": model.increment, "rows": model.rows}
    names = {"travel": "travel", "orientation": "blank.orientation", "size": "blank.size"}
    other = {name for key, name in names.items() if getattr(file, key) != same[key]}
    same["standings"] = {k: v for k, v in file.standings.items() if k not in other}
    file = replace(file, **same)
    try:
        text = scene_toml(file)
    except InputError:  # a tool of the user's own shape
        return ""
    lines = ["# The scene that was run, with every default: `quasiform form` repeats it."]
    lines += [
        f"# {tool.name}: at z = {tool.height:.6g} mm, friction {tool.friction:g}"
        for tool in model.tools[0]
    ]
    if model.recipe.changes or model.changed:
        lines.append("# The model was changed in Python; these changes are not in this file.")
    files = {path: model.files[path] for path in map(str, map(_absolute, file.files()))}
    if files:  # the format is in the text already
        text += "\n" + toml_text({"files": files}).partition("\n")[2].lstrip("\n")
    return "\n".join([*lines, text])


def _absolute(path: Any) -> Any:
    return path.absolute()
