"""Rigid tools as signed distance: value, normal and curvature in closed form.

A shape answers `distance(points)` in its own frame with

    d  (m,)       signed distance, mm, positive outside the tool
    n  (m, 3)     gradient of d, a unit vector pointing away from the tool
    H  (m, 3, 3)  second derivative of d, 1/mm

All shapes here are C¹ with bounded curvature (rounded edges), which Newton's method needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from .checks import InputError, check_number

FloatArray = np.ndarray
Distance = tuple[FloatArray, FloatArray, FloatArray]


class Shape(Protocol):
    """A rigid surface in its own frame."""

    def distance(self, points: FloatArray) -> Distance:
        """Signed distance, gradient and second derivative at `points` (m, 3), mm."""
        ...


@dataclass(frozen=True)
class Plane:
    """The half space z < 0."""

    def distance(self, points: FloatArray) -> Distance:
        n = np.zeros_like(points)
        n[:, 2] = 1.0
        return points[:, 2].copy(), n, np.zeros((len(points), 3, 3))


@dataclass(frozen=True)
class Sphere:
    """A ball with its centre at the origin."""

    radius: float

    def __post_init__(self) -> None:
        check_number("radius", self.radius)

    def distance(self, points: FloatArray) -> Distance:
        r = np.linalg.norm(points, axis=1)
        n = points / r[:, None]
        return r - self.radius, n, (np.eye(3) - _outer(n, n)) / r[:, None, None]


@dataclass(frozen=True)
class Cylinder:
    """A round bar along y through the origin."""

    radius: float

    def __post_init__(self) -> None:
        check_number("radius", self.radius)

    def distance(self, points: FloatArray) -> Distance:
        n = points * [1.0, 0.0, 1.0]
        r = np.linalg.norm(n, axis=1)
        n /= r[:, None]
        P = np.diag([1.0, 0.0, 1.0]) - _outer(n, n)
        return r - self.radius, n, P / r[:, None, None]


@dataclass(frozen=True)
class RoundPunch:
    """A hemisphere on a shaft of the same radius, its lowest point at the origin."""

    radius: float

    def __post_init__(self) -> None:
        check_number("radius", self.radius)

    def distance(self, points: FloatArray) -> Distance:
        arm = points - [0.0, 0.0, self.radius]
        above = arm[:, 2] > 0
        arm[above, 2] = 0.0
        r = np.linalg.norm(arm, axis=1)
        n = arm / r[:, None]
        P = np.eye(3) - _outer(n, n)
        P[above, 2, 2] = 0.0
        return r - self.radius, n, P / r[:, None, None]


@dataclass(frozen=True)
class RoundOpening:
    """A plate below z = 0 with a round opening about the z axis and a filleted upper edge.

    The opening's wall stands at `radius`; the fillet joins it at z = -fillet and the upper face at
    radius + fillet.
    """

    radius: float
    fillet: float

    def __post_init__(self) -> None:
        check_number("radius", self.radius)
        check_number("fillet", self.fillet)

    def distance(self, points: FloatArray) -> Distance:
        rho = np.linalg.norm(points[:, :2], axis=1)
        radial = np.zeros_like(points)
        radial[:, :2] = points[:, :2] / np.maximum(rho, 1e-12)[:, None]
        # distance to the plate shrunk by the fillet, less the fillet (in the plane of rho and z)
        u = np.minimum(rho - (self.radius + self.fillet), 0.0)
        v = np.maximum(points[:, 2] + self.fillet, 0.0)
        inside = (u == 0) & (v == 0)
        q = np.where(inside, 1.0, np.hypot(u, v))
        m_rho, m_z = u / q, np.where(inside, 1.0, v / q)
        n = m_rho[:, None] * radial
        n[:, 2] = m_z
        d = np.where(inside, points[:, 2] + self.fillet, q) - self.fillet
        # curvature of the fillet in that plane, and of the ring about the axis
        tangent = m_z[:, None] * radial
        tangent[:, 2] = -m_rho
        around = np.stack([-radial[:, 1], radial[:, 0], np.zeros(len(rho))], axis=1)
        on_fillet = (u < 0) & (v > 0)
        H = (on_fillet / q)[:, None, None] * _outer(tangent, tangent)
        H += (m_rho / np.maximum(rho, 1e-12))[:, None, None] * _outer(around, around)
        return d, n, H


@dataclass(frozen=True)
class Flipped:
    """Another shape upside down (mirrored at z = 0), for a holder above the sheet."""

    shape: Shape

    def distance(self, points: FloatArray) -> Distance:
        flip = np.array([1.0, 1.0, -1.0])
        d, n, H = self.shape.distance(points * flip)
        return d, n * flip, H * np.outer(flip, flip)


@dataclass(frozen=True)
class Tool:
    """A rigid tool: a shape, where it starts and how it may move along z.

    Parameters
    ----------
    name : str
        "punch", "die", "blank holder", ...
    shape : Shape
    height : float
        z of the shape's origin at the start, mm.
    motion : "fixed", "driven" or "free"
        "driven" tools follow the travel along -z; "free" tools float on one vertical degree of
        freedom and carry `mass`.
    friction : float
        Coulomb coefficient.
    mass : float
        kg, of free tools.
    """

    name: str
    shape: Shape
    height: float = 0.0
    motion: Literal["fixed", "driven", "free"] = "fixed"
    friction: float = 0.0
    mass: float = 0.0

    def __post_init__(self) -> None:
        if self.motion not in ("fixed", "driven", "free"):
            raise InputError(
                f"{self.name}: motion must be 'fixed', 'driven' or 'free', got {self.motion!r}"
            )
        check_number(f"{self.name}: friction", self.friction, zero_allowed=True)
        check_number(f"{self.name}: mass", self.mass, zero_allowed=self.motion != "free")


def _outer(u: FloatArray, v: FloatArray) -> FloatArray:
    return u[:, :, None] * v[:, None, :]
