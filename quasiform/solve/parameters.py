"""The numbers that a model is built from: their values, their standing, the model with another."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from ..checks import InputError, suggestion
from ..fabric import Fabric
from ..model import Model
from ..result.assumed import STATED, assumed
from ..scenes.scene_file import SceneFile, changed, scene_toml

NO_PARAMETER = "name", "format", "size", "travel", "areas", "increments", "outputs", "run", "law"
BESIDE = "provenance", "shear_range"  # of a fabric: what no state depends on
OF_THE_MESH = "blank.", "angle", "length", "width", "mesh", "displacement"  # only if asked for
STEP = 1e-5  # relative to its value: by how much a parameter is changed for a derivative
CLOSE = 1e-6  # the same with contact, whose forces are smooth over a shorter way
READ_ANEW = "tools.", "blank.", "fabric.thickness"


@dataclass(frozen=True)
class Parameter:
    """A number of a recipe, by its dotted name as in `--set`."""

    name: str
    value: float
    standing: str = ""  # "assumed", "stated", "measured": ..., empty where nothing is known

    @property
    def listed(self) -> bool:
        """Whether it is one of the parameters of the model, not of its mesh."""
        return not self.name.startswith(OF_THE_MESH) and self.value != 0


def parameters(model: Model) -> dict[str, Parameter]:
    """All numbers that the recipe of a model holds, by name."""
    given, standings = dict(model.recipe.given), model.parameters.get("standings", {})
    found = {name: value for name, value in given.items() if name not in NO_PARAMETER}
    fabric = found.pop("fabric", None)
    if isinstance(file := found.pop("file", None), SceneFile):
        table = tomllib.loads(scene_toml(file))
        found |= {key: table[key] for key in table if key not in (*NO_PARAMETER, "fabric")}
    if isinstance(fabric, Fabric):
        found["fabric"] = {k: v for k, v in fabric.written().items() if k not in BESIDE}
        of_fabric = {f"fabric.{name}": str(text) for name, text in fabric.provenance.items()}
        if fabric.shear in (Fabric.preset("locking").shear, Fabric.preset("best-fit").shear):
            of_fabric = {f"fabric.{name}": "stated" for name in STATED} | of_fabric
        standings = of_fabric | dict.fromkeys(assumed(model), "assumed") | standings
    numbers = dict(_numbers(found))
    return {name: Parameter(name, v, standings.get(name, "")) for name, v in numbers.items()}


def _numbers(table: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Dotted names and values of the numbers in nested tables; lists are counted from 1."""
    if isinstance(table, Real) and not isinstance(table, bool):
        yield name, float(table)
    elif isinstance(table, Mapping) and "value" in table:
        yield from _numbers(table["value"], name)
    elif isinstance(table, Mapping):
        for key, inner in table.items():
            yield from _numbers(inner, f"{name}.{key}" if name else key)
    elif isinstance(table, list) and all(isinstance(entry, Mapping) for entry in table):
        yield from _numbers({str(i): entry for i, entry in enumerate(table, 1)}, name)


def named(known: Mapping[str, Parameter], name: str) -> Parameter:
    """The parameter of that dotted name, or the only one of which it is the last part.

    Raises InputError if there is none, if there are several, or if it is zero.
    """
    inner = [key for key in known if key.endswith(f".{name}")]
    fabric = [key for key in inner if key == f"fabric.{name}"]
    match = [name] if name in known else fabric or inner
    if len(match) != 1:
        why = f"one of {', '.join(match)}" if match else suggestion(name, known)
        raise InputError(f"parameter '{name}': {why}")
    if (found := known[match[0]]).value == 0:
        raise InputError(f"parameter '{found.name}' is zero: nothing to vary it by")
    return found


def check_smooth(model: Model, parameter: Parameter) -> None:
    """Refuse (InputError) a parameter that changes the mesh, the supports or the travel."""
    with_value(model, parameter.name, parameter.value * (1.0 + STEP))


def with_value(model: Model, name: str, value: float) -> Model:
    """Build the model with another value of one number of its recipe.

    Raises InputError where that changes the mesh, the supports or the travel.
    """
    given, (first, *rest) = dict(model.recipe.given), name.split(".")
    if first == "fabric":
        table = here = deepcopy(given["fabric"].written())
        for part in rest[:-1]:
            here = here[part]
        here[rest[-1]] = value
        given["fabric"] = Fabric.read(table)
    elif name in given:
        given[name] = value
    else:
        given["file"] = changed(given["file"], {name: value})
    # what was read from files depends on these
    anew = name.startswith(READ_ANEW) and model.tools and model.tools[1]
    recipe = replace(model.recipe, given=tuple(sorted(given.items())))
    other = recipe.build(model.size, like=None if anew else model)
    same = other.x0.shape == model.x0.shape and np.array_equal(other.fixed, model.fixed)
    pairs = zip(other.sheets, model.sheets, strict=True)
    same = same and all(np.array_equal(o.blank.nodes, m.blank.nodes) for o, m in pairs)
    if not same or other.travel != model.travel:
        raise InputError(f"parameter '{name}' changes the mesh, the supports or the travel")
    return other
