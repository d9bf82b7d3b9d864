"""A tool as it is written down: a shape by its name and numbers, or a surface in a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from inspect import signature

import numpy as np

from . import shapes
from .shapes import Shape, opening
from .surface_file import SurfaceFile

Point = tuple[float, float]


def _box_opening(length: float, width: float, corner_radius: float, fillet: float) -> Shape:
    x, y = length / 2, width / 2
    return opening(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), corner_radius, fillet)


def _triangle_opening(edge: float, azimuth: float, corner_radius: float, fillet: float) -> Shape:
    return opening(shapes.regular_polygon(3, edge, azimuth), corner_radius, fillet)


# what builds each shape, from the keys that are its parameters: mm; an azimuth in degrees
_BUILDERS: dict[str, Callable[..., Shape]] = {
    "round punch": shapes.round_punch,
    "box punch": shapes.box_punch,
    "tetrahedron punch": shapes.tetrahedron_punch,
    "round opening": shapes.round_opening,
    "box opening": _box_opening,
    "triangle opening": _triangle_opening,
    "ball": shapes.ball,
    "bar": shapes.bar,
    "plane": shapes.Plane,
}
SHAPES = {name: (build, tuple(signature(build).parameters)) for name, build in _BUILDERS.items()}


@dataclass(frozen=True)
class Form:
    """A shape by its name and numbers as in `SHAPES`, such as `Form("round punch", (75.0,))`."""

    shape: str
    numbers: tuple[float, ...] = ()

    def build(self) -> Shape:
        """Return the distance function of the tool; InputError for numbers that make none."""
        return SHAPES[self.shape][0](*self.numbers)


@dataclass(frozen=True)
class ToolPart:
    """A tool of the file; `friction`, `z` and `tilt` are None where the file leaves them open.

    `geometry` may also be a shape of the user's own, which cannot be written to a file.
    """

    name: str
    role: str
    motion: str
    geometry: Form | SurfaceFile | Shape
    friction: float | None = None
    mass: float = 0.0
    force: float | shapes.Rows = 0.0
    z: float | None = None
    place: Point = (0.0, 0.0)
    tilt: bool | None = None
    stroke: shapes.Rows | None = None

    @cached_property
    def shape(self) -> Shape | SurfaceFile:
        """Its distance function (InputError for numbers that make none); no file is read here."""
        if not isinstance(self.geometry, Form):
            return self.geometry
        shape = self.geometry.build()
        turned = self.role == "holder" or (self.role == "die" and "punch" in self.geometry.shape)
        return shapes.flipped(shape) if turned else shape
