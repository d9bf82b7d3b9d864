"""From the file of a study to the descriptions of its runs, before the first one starts.

The name of a run is the start of the SHA-256 of its description: scene, values, settings, version,
linear solver, and the contents of all files that are read.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any

from ..checks import InputError, check_keys, check_number, naming, optional, suggestion
from ..fabric import Fabric, fabric_of
from ..model import Model
from ..recipe import Recipe
from ..result.run import Result, State
from ..scenes import scene_file
from ..scenes.fabric_tests import off_axis_tension
from ..scenes.overrides import merged, overridden
from ..schema import validated
from ..toml_file import dotted_values
from . import fields
from . import file as study_file
from .design import rows, saltelli
from .questions import Trim, target
from .run import PLACE, START, environment, model_of, unpack

Case = Callable[..., Recipe | Model]
TRIED = 20  # runs, of which one at least must have a model
OPEN_TABLES = ("wrinkles", "collapse", "spread", "resting_tools")  # keys that depend on the end


@dataclass(frozen=True)
class Job:
    """A run to do: its varied values, name, description; `error` says why there is none."""

    values: dict[str, Any]
    id: str
    description: dict[str, Any]
    error: str = ""


@dataclass(frozen=True)
class Plan:
    """A study that was checked.

    Parameters
    ----------
    study : Study
    jobs : list of Job
        In the order of the design.
    files : dict of name to bytes
        That the runs read, by the names that their descriptions use.
    paths : dict of name to path
        Where those files came from.
    described : callable
        The run that has some values.
    """

    study: study_file.Study
    jobs: list[Job]
    files: dict[str, bytes]
    paths: dict[str, str]
    described: Callable[[dict[str, Any]], Job]

    @property
    def keys(self) -> list[str]:
        """Columns of the varied values."""
        return list(self.jobs[0].values)

    @cached_property
    def first(self) -> tuple[Model, dict[str, Any]]:
        """Model and options of the first run that has them; InputError if there is none."""
        reasons = []
        for job in islice(self.jobs, TRIED):
            try:
                if job.error:
                    raise InputError(job.error)
                unpack(self.files)
                return model_of(job.description)
            except InputError as error:
                reasons.append(str(error))
        count = "the only run" if len(self.jobs) == 1 else f"the first {len(reasons)} runs"
        raise InputError(f"no model for {count}: {reasons[0]}")


def plan(source: str | Path | Mapping[str, Any], case: Case | None = None) -> Plan:
    """Read a study and describe every run; nothing is solved.

    InputError for a wrong file, an unknown key or output, and where no run has a model.
    """
    study, folder = study_file.read(source, case)
    if study.fields:
        fields.needed()
    with naming(source if isinstance(source, str | Path) else study.name):
        values = _values(study)
        luggage = _Luggage()
        kind = _function if case else _scene if study.kind == "form" else _strip
        describe = partial(kind, case or study, folder, luggage)
        described = partial(_job, study, describe, {"environment": environment()})
        jobs = [described(entry) for entry in values]
        if all(job.error for job in jobs):
            raise InputError(jobs[0].error)
        found = Plan(study, jobs, luggage.files, luggage.paths, described)
        _check_outputs(study.columns, found.first[0])
        if study.trim:
            _check_trim(study.trim, found.first[0])
    return found


def _values(study: study_file.Study) -> list[dict[str, Any]]:
    """Values of the keys by run; of an optimisation or a trim line, of the runs that come first."""
    if study.sobol:
        return saltelli(study.values, study.sobol.points, study.seed)
    if study.optimise:
        return rows("sobol", study.values, study.optimise.start, study.seed)
    found = rows(study.design, study.values, study.runs, study.seed)
    starts = (study.robust and study.robust.starts) or 0
    return [{**entry, START: k} for entry in found for k in range(starts)] if starts else found


def _job(
    study: study_file.Study,
    describe: Callable[[dict[str, Any]], dict[str, Any]],
    here: dict[str, Any],
    values: dict[str, Any],
) -> Job:
    """Describe a run, or say why it is impossible."""
    own = {**study.fixed, **values}
    if study.robust and study.robust.starts and (start := own.pop(START)):
        here = here | {START: start}
    try:
        description, error = describe(own) | here, ""
    except InputError as wrong:
        description, error = {"values": {**study.fixed, **values}}, str(wrong)
    text = json.dumps(description, sort_keys=True, default=str)
    return Job(values, sha256(text.encode()).hexdigest()[:12], description, error)


class _Luggage:
    """Contents of the files that travel to the workers, each read once."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.paths: dict[str, str] = {}
        self._names: dict[Path, str] = {}

    def packed(self, value: Any, paths: Sequence[Path]) -> Any:
        """Return a description in which the names of the files stand for their paths."""
        if isinstance(value, dict):
            return {key: self.packed(inner, paths) for key, inner in value.items()}
        if isinstance(value, list | tuple):
            return [self.packed(inner, paths) for inner in value]
        if isinstance(value, str):
            for path in sorted(paths, key=lambda path: -len(str(path))):
                name = PLACE + self._name(path.absolute())
                for text in (str(path), str(path.absolute())):  # in TOML \ is \\
                    value = value.replace(json.dumps(text, ensure_ascii=False)[1:-1], name)
                    value = value.replace(text, name)
        return value

    def _name(self, path: Path) -> str:
        if path not in self._names:
            with naming(path):
                content = path.read_bytes()
            name = self._names[path] = sha256(content).hexdigest() + path.suffix
            self.files[name], self.paths[name] = content, str(path)
        return self._names[path]


def _scene(
    study: study_file.Study, folder: Path, luggage: _Luggage, values: dict[str, Any]
) -> dict[str, Any]:
    """Describe a run of a forming scene: as the text of a scene file with every default."""
    name = study.scene
    if name not in scene_file.built_in():
        name = str(folder / name)
    size = check_number("size", values.pop("size")) if "size" in values else None
    law = {"law": str(_law(values.pop("law"), folder))} if "law" in values else {}
    solving = ({"one_mesh": True} if size is not None else {}) | study.solving
    run = {f"run.{key}": value for key, value in solving.items()}
    file = scene_file.load(name, run | law | values)
    if isinstance(file.law, str) and file.law.endswith(".toml"):
        file = replace(file, law=fabric_of(file.law))
    text = scene_file.scene_toml(replace(file, source=""))
    return {"scene": luggage.packed(text, file.files()), "size": size and float(size)}


def _strip(
    study: study_file.Study, folder: Path, luggage: _Luggage, values: dict[str, Any]
) -> dict[str, Any]:
    """Describe an off-axis tension test."""
    run = {key[4:]: values.pop(key) for key in list(values) if key.startswith("run.")}
    own = {key: values.pop(key) for key in list(values) if key.startswith("fabric.")}
    options = values
    check_keys(options, inspect.signature(off_axis_tension).parameters)
    law = fabric_of(_law(options.pop("law", "locking"), folder))
    own = overridden({"law": "", "fabric": {}}, own)["fabric"]
    fabric = Fabric.read(merged(law.written(), own))
    mesh = options.get("mesh", "fibre")
    paths = [] if mesh in ("fibre", "free") else [folder / mesh]
    options = {k: v if k == "mesh" else _number(k, v) for k, v in options.items()}
    options |= {"mesh": str(paths[0])} if paths else {}
    run = study.solving | run
    run = validated(study_file.Run, run).model_dump(include=set(run))
    strip = luggage.packed(options, paths)
    return {"strip": strip, "fabric": fabric.written(), "run": run}


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{key} must be a number, got {value!r}")
    return float(value)


def _law(law: Any, folder: Path) -> Any:
    """A preset, or a file relative to the folder of the study."""
    return folder / law if isinstance(law, str) and law.endswith(".toml") else law


def _function(
    case: Case, folder: Path, luggage: _Luggage, values: dict[str, Any]
) -> dict[str, Any]:
    """Describe a run by the recipe that a function returns."""
    try:
        inspect.signature(case).bind(**values)
    except TypeError as error:
        raise InputError(f"the function cannot be called with these keys: {error}") from error
    try:
        made = case(**values)
    except Exception as error:  # a run that has no model is a row of the study
        raise InputError(f"the function failed: {type(error).__name__}: {error}") from error
    recipe = made.recipe if isinstance(made, Model) else made
    if not isinstance(recipe, Recipe):
        raise InputError(f"the function must return a recipe or a model with one, got {made!r}")
    if isinstance(made, Model) and made.changed:
        raise InputError("a model that was changed by hand has no recipe: use including(change)")
    given = dict(recipe.given)
    if isinstance(file := given.get("file"), scene_file.SceneFile):
        given["file"] = replace(file, source="")  # where it was is no part of a run
    recipe = replace(recipe, given=tuple(given.items()))
    return {"recipe": luggage.packed(recipe.written(), [Path(name) for name in recipe.files()])}


def _check_trim(trim: Trim, model: Model) -> None:
    """Refuse a line that cannot be used, and a blank whose outline cannot change."""
    from ..comparison.mapping import IGL

    optional(*IGL)
    target(trim)
    file = dict(model.recipe.given)["file"]
    if file.blank is None:
        raise InputError("[trim] needs a blank with an outline, not one with its own mesh")
    if file.slits:
        raise InputError("[trim] is not possible for a blank with slits")


def _check_outputs(outputs: Sequence[str], model: Model) -> None:
    """Refuse names that no summary of this model has: its start has all but some of their keys."""
    counts = dict.fromkeys(("wall_s", "linear_solves", "increments"), 0)
    zero = dict.fromkeys(("residual", "energy_balance", "negative_pivots", "stabilisation"), 0)
    begun = {"settings": {}, "rescues": {}, "reason": "not solved", "model": model}
    start = Result(states=[State(0.0, model.x0, 0.0, 0, {})], **begun, **counts, **zero)
    start.estimate = dict.fromkeys(start.quantities)
    known = dotted_values(start.summary())
    for name in outputs:
        table = name.partition(".")[0]
        if name in known or (table in OPEN_TABLES and "." in name):
            continue
        inner = [key for key in known if key.startswith(f"{name}.")]
        words = f"expected one of {', '.join(inner)}" if inner else suggestion(name, known)
        raise InputError(f"outputs: unknown output '{name}': {words}")
