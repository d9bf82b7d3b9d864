"""The file of a study: what is solved, what is varied, which outputs."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StrictBool, StrictStr, model_validator

from ..checks import InputError, suggestion
from ..scenes.scene_file import Run
from ..schema import OPEN, checked, number, validated
from ..toml_file import read_toml, without_format
from .design import DESIGNS, MOST, SAMPLED, Range, Values, varied
from .questions import QUESTIONS, Optimise, Robust, Sobol, Trim
from .run import START

OUTPUTS = ["force_N", "shear_angle_deg.p99"]  # where none are named
OF_A_SCENE = ("orientation", "travel", "symmetry")
OF_A_STRIP = ("angle", "length", "width", "displacement")
RANGE = {"type": "object", "properties": {"from": {}, "to": {}, "mean": {}, "std": {}}}
Names = Annotated[list[StrictStr], Field(min_length=1)]


class Study(Run):
    """A study: many runs of one case. Lengths in mm, forces in N, angles in degrees.

    Paths are relative to the file. Keys of [set] and [vary] are the dotted names of a scene.
    """

    name: Annotated[StrictStr, Field(description="By default that of the file")] = OPEN
    kind: Annotated[Literal["form", "oat"], Field(description="Forming, off-axis tension")] = "form"
    scene: Annotated[StrictStr, Field(description="Name of a scene, or path of its file")] = OPEN
    law: Annotated[StrictStr, Field(description="Preset, or path of a material file")] = OPEN
    size: number("Spacing of the fibre lines, of the whole path", "mm") = OPEN
    orientation: number("Angle of the warp to x", "deg", signed=True) = OPEN
    travel: number("Travel of the punch", "mm") = OPEN
    symmetry: Annotated[Literal["auto", "half", "none"], Field(description="Mirror planes")] = OPEN
    angle: number("oat: angle between load and warp", "deg", signed=True) = OPEN
    length: number("oat: free length", "mm") = OPEN
    width: number("oat: width", "mm") = OPEN
    displacement: number("oat: displacement of the grip at the end", "mm") = OPEN
    design: Annotated[Literal[DESIGNS], Field(description="How the values are chosen")] = "grid"
    runs: Annotated[int, Field(ge=1, le=MOST, description="Runs of lhs and sobol")] = OPEN
    seed: Annotated[int, Field(ge=0, lt=2**63, description="Of lhs and sobol")] = 0
    outputs: Annotated[Names, Field(description="Dotted names of numbers in summary.json")] = OPEN
    keep: Annotated[StrictBool, Field(description="Keep the folder of every result")] = False
    fields: Annotated[StrictBool, Field(description="Keep all fields in fields.h5")] = False
    set: Annotated[dict[str, Any], Field(description="Other values of keys, in every run")] = {}  # noqa: RUF012
    vary: Annotated[
        dict[str, checked(varied, anyOf=[{"type": "array"}, RANGE])],
        Field(min_length=1, description="Values of keys, by run"),
    ] = OPEN
    sobol: Sobol = OPEN
    robust: Robust = OPEN
    optimise: Optimise = OPEN
    trim: Trim = OPEN

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        foreign = OF_A_STRIP if self.kind == "form" else ("scene", *OF_A_SCENE)
        for key in foreign:
            if key in self.model_fields_set:
                raise InputError(f"{key} does not go with kind = '{self.kind}'")
        if self.design not in SAMPLED and self.runs is not None:
            words = f"runs = {self.runs} goes with design = 'lhs' or 'sobol', not '{self.design}'"
            raise InputError(words)
        if twice := sorted(self.fixed.keys() & self.values.keys()):
            raise InputError(f"{twice[0]} is both varied and given")
        self._check_question()
        return self

    def _check_question(self) -> None:
        """Refuse what does not go with the question, and what it needs but does not have."""
        asked = [f"[{name}]" for name in QUESTIONS if getattr(self, name) is not None]
        if len(asked) > 1:
            raise InputError(f"{' and '.join(asked)}: a study has one of them")
        own = bool(asked) and not self.robust
        for key in ("design", "runs") * own + ("vary",) * bool(self.trim):
            if key in self.model_fields_set:
                words = f"{key} does not go with {asked[0]}"
                raise InputError(f"{words}, which chooses the runs itself")
        alone = self.trim or (self.robust and self.robust.starts)
        if self.vary is None and not alone:
            raise InputError("vary missing")
        if self.outputs is None and asked in ([], ["[sobol]"]):
            raise InputError("outputs missing")
        if self.trim and self.kind != "form":
            raise InputError("[trim] needs a scene")
        if START in self.values and self.robust and self.robust.starts:
            raise InputError(f"[vary] {START} is what starts = {self.robust.starts} varies")
        if self.optimise:
            for name, key in self.values.items():
                if not isinstance(key, Range) or key.std is not None:
                    raise InputError(f"[vary] {name} must be a range from ... to for [optimise]")
        for name in (self.robust and self.robust.window) or ():
            if name not in self.values:
                words = f"[robust] window: {suggestion(name, self.values)}"
                raise InputError(f"{words}, got '{name}'")
            values = getattr(self.values[name], "values", (0.0,))
            if not all(isinstance(value, int | float) for value in values):
                raise InputError(f"[robust] window: {name} must have numbers, got {values}")

    @property
    def values(self) -> dict[str, Values | Range]:
        """What is varied, by key."""
        return self.vary or {}

    @property
    def columns(self) -> list[str]:
        """Outputs of the table: those that are named, and those that the question is about."""
        names = dict.fromkeys(self.outputs or (() if self.optimise else OUTPUTS))
        if self.optimise:
            aim = self.optimise.least or self.optimise.most
            names = dict.fromkeys([aim] if aim else self.optimise.target) | names
        limits = (self.optimise or self.robust or Optimise.model_construct()).limits
        return list(names | dict.fromkeys(limits))

    @property
    def leaves(self) -> tuple[bool, bool]:
        """Whether each run leaves its folder, and its fields."""
        states = bool(self.trim or (self.robust and self.robust.starts))
        return self.keep, self.fields or states

    @property
    def fixed(self) -> dict[str, Any]:
        """Values of keys that are the same in every run."""
        keys = ("law", "size", *OF_A_SCENE, *OF_A_STRIP)
        given = {key: getattr(self, key) for key in keys if key in self.model_fields_set}
        return given | self.set

    @property
    def solving(self) -> dict[str, Any]:
        """How every run is solved, where the file says so: keys of the table [run] of a scene."""
        return self.model_dump(include=set(Run.model_fields), exclude_unset=True)


def read(source: str | Path | Mapping[str, Any], case: Callable | None) -> tuple[Study, Path]:
    """Return a study from its file or table, and the folder to which its paths are relative."""
    if isinstance(source, Mapping):
        return _study(dict(source), "study", case, Path.cwd()), Path.cwd()
    path, folder = Path(source), Path(source).absolute().parent
    return read_toml(path, lambda table: _study(table, path.stem, case, folder)), folder


def _study(table: dict[str, Any], stem: str, case: Callable | None, folder: Path) -> Study:
    name = re.sub(r"[^\w.+-]+", "-", stem).lstrip(".-") or "study"
    study = validated(Study, {"name": name, **without_format(table)}, folder)
    if not re.fullmatch(r"\w[\w.+-]*", study.name):
        raise InputError(f"name must be that of a folder, got {study.name!r}")
    if case is None and study.kind == "form" and study.scene is None:
        raise InputError("scene missing: a built-in one, a .toml file, or kind = 'oat'")
    if case is not None and study.trim:
        raise InputError("[trim] needs a scene, not a function")
    if case is not None and (study.scene is not None or study.solving):
        key = "scene" if study.scene is not None else next(iter(study.solving))
        raise InputError(f"{key} does not go with a function, which says it itself")
    return study
