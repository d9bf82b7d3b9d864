"""Tables of a study that ask a question: [sobol], [robust], [optimise], [trim]."""

from typing import Annotated, Any, Self

import numpy as np
import shapely
from pydantic import Field, StrictStr, model_validator

from ..checks import InputError, naming
from ..schema import OPEN, Table, number, path

Name = StrictStr
Limits = Annotated[
    dict[Name, number("Largest value", "1", signed=True)],
    Field(description="Outputs that must not exceed these values"),
]


def _count(text: str, least: int = 1, most: int = 100_000) -> Any:
    return Annotated[int, Field(strict=True, ge=least, le=most, description=text)]


class Sobol(Table):
    """Which share of the variance of each output comes from which key."""

    points: _count("A power of 2; points × (keys + 2) runs", 8)
    confidence: number("Of the intervals", "1") = 0.95

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if self.points & (self.points - 1):
            near = 2 ** (self.points.bit_length() - 1)
            words = f"points must be a power of 2 such as {near} or {2 * near}, got {self.points}"
            raise InputError(words)
        return _with_confidence(self)


class Robust(Table):
    """How probable wrinkles, locking and limited trust are over all runs."""

    window: Annotated[list[Name], Field(description="Two keys, for a picture")] = OPEN
    starts: _count("Runs at each place: one without and others with noise on the nodes", 2) = OPEN
    apart: number("Distance of two end states from which on they differ", "mm") = 1.0
    limits: Limits = {}  # noqa: RUF012
    confidence: number("Of the intervals", "1") = 0.95

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if self.window is not None and (len(self.window) != 2 or len(set(self.window)) != 2):
            raise InputError(f"window must name two keys of [vary], got {self.window}")
        return _with_confidence(self)


class Optimise(Table):
    """Which values of the keys are best."""

    least: Annotated[Name, Field(description="Output that shall be as small as possible")] = OPEN
    most: Annotated[Name, Field(description="Output that shall be as large as possible")] = OPEN
    target: Annotated[
        dict[Name, number("Value", "1", signed=True)],
        Field(min_length=1, description="Values that outputs shall come near to"),
    ] = OPEN
    limits: Limits = {}  # noqa: RUF012
    start: _count("Runs that are spread over the ranges first", 2) = 8
    runs: _count("Runs at most, with these") = 40
    tolerance: number("Where it ends, relative to the ranges", "1") = 0.01

    @model_validator(mode="after")
    def _checked(self) -> Self:
        given = [key for key in ("least", "most", "target") if getattr(self, key) is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise InputError(f"give one of least, most, target, got {got}")
        if zero := [name for name, value in (self.target or {}).items() if value == 0]:
            raise InputError(f"target: {zero[0]} must not be 0, deviations are relative to it")
        if self.runs <= self.start:
            raise InputError(f"runs must exceed start = {self.start}, got {self.runs}")
        if not self.tolerance < 0.2:
            raise InputError(f"tolerance must be less than 0.2, got {self.tolerance:g}")
        return self


class Trim(Table):
    """Which blank has its edge on a line after forming."""

    line: path("CSV of the line: x, y[, z] in mm, and loop where it has holes")
    scale: number("Length of one unit of the line", "mm") = 1.0
    within: number("Where it ends: largest distance of edge and line", "mm") = 1.0
    runs: _count("Runs at most", 2) = 6


QUESTIONS = {"sobol": Sobol, "robust": Robust, "optimise": Optimise, "trim": Trim}


def _with_confidence(table: Any) -> Any:
    if not 0.5 <= table.confidence < 1:
        words = f"confidence must be at least 0.5 and less than 1, got {table.confidence:g}"
        raise InputError(words)
    return table


def target(trim: Trim) -> list[np.ndarray]:
    """Lines (k, 3), or (k, 2) seen along z, mm: the outer one first, then holes.

    InputError for a line that cannot be read, or crosses itself, and for a hole beside the line.
    """
    from ..handover.pattern import curves

    with naming(trim.line):
        lines = curves(trim.line, trim.scale)
        lines.sort(key=lambda line: -shapely.Polygon(line[:, :2]).area)
        outer = shapely.Polygon(lines[0][:, :2])
        for k, line in enumerate(lines, 1):
            polygon = shapely.Polygon(line[:, :2])
            if not polygon.is_valid:
                raise InputError(f"line {k} crosses itself, seen along z")
            if k > 1 and not outer.contains_properly(polygon):
                raise InputError(f"line {k} is not a hole within the longest one, seen along z")
    return lines
