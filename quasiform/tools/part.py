"""A tool as it is written down: a shape by its name and numbers, or a surface in a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .shapes import (
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
from .surface_file import SurfaceFile

Point = tuple[float, float]


def _box_opening(length: float, width: float, corner_radius: float, fillet: float) -> Shape:
    x, y = length / 2, width / 2
    return opening(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), corner_radius, fillet)


def _triangle_opening(edge: float, azimuth: float, corner_radius: float, fillet: float) -> Shape:
    return opening(regular_polygon(3, edge, azimuth), corner_radius, fillet)


# what builds each shape, and from which keys: mm; an azimuth in degrees
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


@dataclass(frozen=True)
class Form:
    """A shape of a tool by its name and numbers, such as `Form("round punch", (75.0,))`.

    Parameters
    ----------
    shape : str
        A key of `SHAPES`.
    numbers : tuple of float
        In the order of `SHAPES`, mm and degrees.
    """

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
    force: float = 0.0
    z: float | None = None
    place: Point = (0.0, 0.0)
    tilt: bool | None = None

    @cached_property
    def shape(self) -> Shape | SurfaceFile:
        """Its distance function (InputError for numbers that make none); no file is read here."""
        if not isinstance(self.geometry, Form):
            return self.geometry
        shape = self.geometry.build()
        return flipped(shape) if self.role == "holder" else shape
