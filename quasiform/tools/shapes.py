"""Rigid tools as signed distance: value, normal and curvature in closed form.

A shape answers `distance(points)` in its own frame with

    d  (m,)       signed distance, mm, positive outside the tool
    n  (m, 3)     gradient of d, a unit vector pointing away from the tool
    H  (m, 3, 3)  second derivative of d, 1/mm

All shapes here are C¹ with bounded curvature (rounded edges), which Newton's method needs. Two
ideas make them: a convex core grown by a radius (ball, bar, punches), and a plate with a straight
opening whose section is such a grown core (die, blank holder).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from ..checks import InputError, check_number

try:
    from .. import compiled
except ImportError:  # the extra `fast` is not installed
    compiled = None  # type: ignore[assignment]

FloatArray = np.ndarray
Distance = tuple[FloatArray, FloatArray, FloatArray]
Rows = tuple[tuple[float, float], ...]  # travel, mm, and what there is at it
FAR = 1e4  # mm; half the length of straight tools that have no end


class Shape(Protocol):
    """A rigid surface in its own frame.

    A shape may also have a `box` (2, 3), the corners of its bounding box, beyond which distances
    are not evaluated, `sharpest`, its smallest radius of curvature (mm), `is_ball`, whether its
    lower end is one, and `steepest`, the largest length of the gradient if that may exceed 1.
    """

    def distance(self, points: FloatArray) -> Distance:
        """Signed distance, gradient and second derivative at `points` (m, 3), mm."""
        ...


@dataclass(frozen=True)
class Plane:
    """The half space z < 0."""

    sharpest = np.inf

    def distance(self, points: FloatArray) -> Distance:
        n = np.zeros_like(points)
        n[:, 2] = 1.0
        return points[:, 2].copy(), n, np.zeros((len(points), 3, 3))


@dataclass(frozen=True, eq=False)
class Rounded:
    """The convex hull of a few points, grown by a radius: d = dist(x, hull) - radius.

    One point makes a ball, two a round bar, the corners of a polyhedron a polyhedron with filleted
    edges. The nearest point of the hull lies in a vertex, on an edge or on a face; d bends with
    1/(d + radius) in two directions, in one, or not at all.
    """

    kernels: ClassVar[Any] = compiled  # compiled loops over points; None: numpy alone
    core: FloatArray  # (n, 3) one point, two, or the corners of a convex solid, mm
    radius: float  # mm

    def __post_init__(self) -> None:
        check_number("radius", self.radius)
        object.__setattr__(self, "core", np.atleast_2d(np.asarray(self.core, dtype=float)))
        self._features  # noqa: B018  (a flat core is refused now, not when first used)

    @cached_property
    def _features(self) -> tuple[FloatArray, ...]:
        """Corners (k, 3); edges by start, direction and length; faces by N, c, sides and at_side.

        A point x lies above a triangle where N·x + c > 0 and its three sides·x ≥ at_side, but for
        round-off.
        """
        core, none = self.core, np.zeros((0, 3))
        edges, faces = core[None, :0], (none, np.zeros(0), none, np.zeros(0))
        if len(core) == 2:
            edges = core[None]
        elif len(core) > 2:
            core, edges, *faces = _polyhedron(core)
        start, end = edges.reshape(-1, 2, 3).transpose(1, 0, 2)
        length = np.linalg.norm(end - start, axis=1)
        N, c, sides, at_side = faces
        at_side = at_side - 1e-8 * np.linalg.norm(sides, axis=1)
        found = core, start, (end - start) / length[:, None], length, N, c, sides, at_side
        return tuple(np.ascontiguousarray(array) for array in found)

    @property
    def sharpest(self) -> float:
        return self.radius

    @property
    def is_ball(self) -> bool:
        return len(self.core) <= 2 and not np.ptp(self.core[:, :2])

    @cached_property
    def box(self) -> FloatArray:
        return np.stack([self.core.min(0) - self.radius, self.core.max(0) + self.radius])

    def distance(self, points: FloatArray) -> Distance:
        if self.kernels:
            return self.kernels.rounded(np.ascontiguousarray(points), self._features, self.radius)
        corners, start, t, length, N, c, sides, at_side = self._features
        n_faces, n_flat = len(N), len(N) + len(t)
        height = points @ N.T + c  # above each face, (m, n_faces)
        inside = (height <= 0).all(1) if n_faces else np.zeros(len(points), dtype=bool)
        # the nearest of faces, edges and corners whose foot lies in them, faces first
        square = np.full((len(points), n_flat + len(corners)), np.inf)
        over = points @ sides.T >= at_side
        over = over.reshape(len(points), n_faces, 3).all(2)
        np.copyto(square[:, :n_faces], height**2, where=over & (height > 0))
        to_edge = points[:, None] - start
        s = np.einsum("mec,ec->me", to_edge, t)
        to_edge -= s[:, :, None] * t
        to_edge_2 = np.einsum("mec,mec->me", to_edge, to_edge)
        np.copyto(square[:, n_faces:n_flat], to_edge_2, where=(s > 0) & (s < length))
        to_corner = points[:, None] - corners
        square[:, n_flat:] = np.einsum("mkc,mkc->mk", to_corner, to_corner)
        nearest = square.argmin(1)
        rho = np.sqrt(square[np.arange(len(points)), nearest])
        away = np.where(rho > 0, rho, np.inf)  # on the core itself d has no gradient

        n, H = np.empty_like(points), np.zeros((len(points), 3, 3))
        face, corner = nearest < n_faces, nearest >= n_flat
        n[face] = N[nearest[face]]
        i = np.flatnonzero(~(face | corner))
        k = nearest[i] - n_faces
        n[i] = to_edge[i, k] / away[i, None]
        H[i] = -_outer(t[k], t[k])
        i = np.flatnonzero(corner)
        n[i] = to_corner[i, nearest[i] - n_flat] / away[i, None]
        bent = ~(face | inside)
        H[bent] = (np.eye(3) + H[bent] - _outer(n[bent], n[bent])) / away[bent, None, None]
        if inside.any():
            highest = height[inside].argmax(1)
            rho[inside], n[inside], H[inside] = height[inside, highest], N[highest], 0.0
        return rho - self.radius, n, H


def _polyhedron(core: FloatArray) -> tuple[FloatArray, ...]:
    """Corners, edges (k, 2, 3), N, c, sides and at_side of the convex hull of points (n, 3)."""
    from scipy.spatial import ConvexHull

    if np.linalg.matrix_rank(core - core.mean(0), tol=1e-9 * np.ptp(core)) < 3:
        raise InputError("the core of a rounded solid must be a point, a line or a solid")
    hull = ConvexHull(core)
    N, c = hull.equations[:, :3], hull.equations[:, 3]
    # an edge between coplanar triangles is none
    pairs = {
        tuple(sorted((a, b)))
        for f, ring in enumerate(hull.simplices)
        for a, b, across in zip(ring, np.roll(ring, -1), np.roll(hull.neighbors[f], 1), strict=True)
        if N[f] @ N[across] < 1 - 1e-9
    }
    ring = core[hull.simplices]
    along = np.roll(ring, -1, axis=1) - ring
    turn = np.sign(np.einsum("fc,fc->f", np.cross(along[:, 0], along[:, 1]), N))
    inward = turn[:, None, None] * np.cross(N[:, None], along)
    at_side = np.einsum("fkc,fkc->fk", inward, ring).ravel()
    return core[hull.vertices], core[np.array(sorted(pairs))], N, c, inward.reshape(-1, 3), at_side


@dataclass(frozen=True, eq=False)
class Opening:
    """A plate below z = 0 with a straight opening along z and a filleted upper edge.

    The fillet joins the opening's wall at z = -fillet and the upper face at `fillet` from the wall.
    """

    hole: Rounded  # the opening as a solid, long in z
    fillet: float  # mm

    def __post_init__(self) -> None:
        check_number("fillet", self.fillet)

    @property
    def sharpest(self) -> float:
        return self.fillet

    @cached_property
    def _ends(self) -> FloatArray:
        """(2, 2) corners in the plane, beyond which the plate is flat, mm."""
        return self.hole.box[:, :2] + [[-self.fillet], [self.fillet]]

    def distance(self, points: FloatArray) -> Distance:
        low, high = self._ends
        if self.hole.kernels:
            given = self.hole._features, self.hole.radius, self.fillet, low, high
            return self.hole.kernels.opening(np.ascontiguousarray(points), *given)
        d, n, H = Plane().distance(points)
        near = ((points[:, :2] > low) & (points[:, :2] < high)).all(1)
        d[near], n[near], H[near] = self._in_hole(points[near])
        return d, n, H

    def _in_hole(self, points: FloatArray) -> Distance:
        s, m, bend = self.hole.distance(points * [1.0, 1.0, 0.0])
        # distance to the plate shrunk by the fillet, less the fillet (in the plane of m and z)
        u = np.minimum(s - self.fillet, 0.0)
        v = np.maximum(points[:, 2] + self.fillet, 0.0)
        inside = (u == 0) & (v == 0)
        q = np.where(inside, 1.0, np.hypot(u, v))
        depth = points[:, 2] + self.fillet  # deep in the plate the nearer of face and wall counts
        to_wall = self.fillet - s
        wall = inside & (to_wall > depth)
        n_m = np.where(wall, -1.0, u / q)
        n_z = np.where(inside, np.where(wall, 0.0, 1.0), v / q)
        n = n_m[:, None] * m
        n[:, 2] = n_z
        d = np.where(inside, np.maximum(depth, to_wall), q) - self.fillet
        # curvature of the fillet in that plane, and of the opening about the axis
        tangent = n_z[:, None] * m
        tangent[:, 2] = -n_m
        on_fillet = (u < 0) & (v > 0)
        H = (on_fillet / q)[:, None, None] * _outer(tangent, tangent) + n_m[:, None, None] * bend
        return d, n, H


@dataclass(frozen=True, eq=False)
class Placed:
    """Another shape, turned (or mirrored) and moved."""

    shape: Shape
    axes: FloatArray  # (3, 3) orthogonal; its columns are the axes of the shape's frame
    origin: FloatArray = (0.0, 0.0, 0.0)  # of the shape's frame, mm

    @property
    def sharpest(self) -> float:  # 0 where it is unknown
        return getattr(self.shape, "sharpest", 0.0)

    @property
    def is_ball(self) -> bool:
        return getattr(self.shape, "is_ball", False)

    @property
    def steepest(self) -> float:
        return getattr(self.shape, "steepest", 1.0)

    @cached_property
    def box(self) -> FloatArray | None:
        box = getattr(self.shape, "box", None)
        if box is None:
            return None
        corners = np.stack(np.meshgrid(*np.transpose(box), indexing="ij"), axis=-1).reshape(-1, 3)
        corners = corners @ np.asarray(self.axes).T + np.asarray(self.origin)
        return np.stack([corners.min(0), corners.max(0)])

    def distance(self, points: FloatArray) -> Distance:
        A = np.asarray(self.axes)
        d, n, H = self.shape.distance((points - np.asarray(self.origin)) @ A)
        # A H A' for all points in one product
        return d, n @ A.T, (H.reshape(-1, 9) @ self._twice).reshape(-1, 3, 3)

    @cached_property
    def _twice(self) -> FloatArray:
        return np.kron(self.axes, self.axes).T


def flipped(shape: Shape) -> Placed:
    """Return a shape upside down (mirrored at z = 0), for a holder above the sheet."""
    return Placed(shape, np.diag([1.0, 1.0, -1.0]))


def turned(shape: Shape, angle: float) -> Shape:
    """Return a shape turned about z by `angle` degrees."""
    if angle == 0:
        return shape
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return Placed(shape, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


def ball(radius: float) -> Rounded:
    """Return a ball with its centre at the origin."""
    return Rounded(np.zeros((1, 3)), radius)


def bar(radius: float) -> Rounded:
    """Return a round bar along y through the origin."""
    return Rounded(np.array([[0.0, -FAR, 0.0], [0.0, FAR, 0.0]]), radius)


def round_punch(radius: float) -> Rounded:
    """Return a hemisphere on a shaft of the same radius, its lowest point at the origin."""
    check_number("radius", radius)
    return Rounded(np.array([[0.0, 0.0, radius], [0.0, 0.0, FAR]]), radius)


def box_punch(length: float, width: float, edge_radius: float) -> Rounded:
    """Return an upright bar of rectangular section, its filleted lower face at z = 0.

    Its outer dimensions are `length` along x and `width` along y, mm.
    """
    r = check_number("edge_radius", edge_radius)
    for name, side in (("length", length), ("width", width)):
        if check_number(name, side) <= 2 * r:
            raise InputError(f"{name} must exceed twice the edge_radius {r:g} mm, got {side:g}")
    x, y = length / 2 - r, width / 2 - r
    corners = [[i * x, j * y, z] for i in (-1, 1) for j in (-1, 1) for z in (r, FAR)]
    return Rounded(np.array(corners), r)


def tetrahedron_punch(
    base_edge: float, height: float, edge_radius: float, azimuth: float = 0.0
) -> Rounded:
    """Return a tetrahedron on its tip with filleted edges, the lowest point of the fillet at z = 0.

    Equilateral base (above) and height are those before rounding, mm; the azimuth is the direction
    of one of the three edges that run up from the tip, degrees from x.
    """
    from scipy.spatial import ConvexHull

    for name, value in (("base_edge", base_edge), ("height", height), ("edge_radius", edge_radius)):
        check_number(name, value)
    base = np.column_stack([regular_polygon(3, base_edge, azimuth), np.full(3, height)])
    faces = ConvexHull(np.vstack([np.zeros(3), base])).equations
    core = _shrunk(faces, np.array([0.0, 0.0, 0.75 * height]), edge_radius)
    if core is None:
        raise InputError(
            f"edge_radius {edge_radius:g} mm is too large for a tetrahedron with base_edge "
            f"{base_edge:g} and height {height:g} mm"
        )
    core[:, 2] += edge_radius - core[:, 2].min()
    return Rounded(core, edge_radius)


def opening(corners: FloatArray, corner_radius: float, fillet: float) -> Opening:
    """Return a plate with an opening whose section is a convex polygon with rounded corners.

    The corners (n, 2) before rounding, mm, turn counter-clockwise; one makes a round opening. The
    fillet is that of the upper edge.
    """
    corners = np.atleast_2d(np.asarray(corners, dtype=float))
    check_number("corner_radius" if len(corners) > 1 else "radius", corner_radius)
    if len(corners) > 1:
        side = np.roll(corners, -1, axis=0) - corners
        inward = np.column_stack([-side[:, 1], side[:, 0]])
        inward /= np.linalg.norm(inward, axis=1)[:, None]
        lines = np.column_stack([-inward, (inward * corners).sum(1)])
        corners = _shrunk(lines, corners.mean(0), corner_radius)
        if corners is None:
            raise InputError(f"corner_radius {corner_radius:g} mm is too large for the opening")
    core = np.vstack([np.insert(corners, 2, z, axis=1) for z in (-FAR, FAR)])
    return Opening(Rounded(core, corner_radius), fillet)


def _shrunk(faces: FloatArray, centre: FloatArray, radius: float) -> FloatArray | None:
    """Corners of faces n·x + c = 0, rows (n, c), moved inwards; None if nothing is left."""
    from scipy.spatial import HalfspaceIntersection

    if (faces[:, :-1] @ centre + faces[:, -1] + radius).max() >= 0:
        return None
    moved = np.zeros(faces.shape[1])
    moved[-1] = radius
    return HalfspaceIntersection(faces + moved, centre).intersections


def round_opening(radius: float, fillet: float) -> Opening:
    """Return a plate with a round opening about the z axis."""
    return opening(np.zeros((1, 2)), radius, fillet)


def regular_polygon(sides: int, edge: float, azimuth: float = 0.0) -> FloatArray:
    """(sides, 2) corners of a regular polygon about the origin, the first one at `azimuth`."""
    angle = np.radians(azimuth) + 2 * np.pi * np.arange(sides) / sides
    return edge / (2 * np.sin(np.pi / sides)) * np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True, eq=False)
class Tool:
    """A rigid tool: a shape, where it starts and how it may move.

    Parameters
    ----------
    name : str
        "punch", "die", "blank holder", ...
    shape : Shape
    height : float
        z of the shape's origin at the start, mm.
    motion : "fixed", "driven" or "free"
        "driven" tools follow the travel along -z; "free" tools float on one vertical degree of
        freedom, and carry `mass` and `force`.
    friction : float
        Coulomb coefficient.
    mass : float
        kg, of free tools.
    force : float or rows (travel, force)
        N along -z, on free tools, beside their weight; rows over the travel in mm, linear in
        between and constant beyond.
    place : (2,)
        x and y of the shape's origin, mm.
    stroke : rows (travel, mm), optional
        How far along -z a driven tool has moved over the travel; as far as the travel without it.
    tilts : bool
        Whether a free tool may also tilt about x and y through its shape's origin, where its
        weight acts.
    """

    name: str
    shape: Shape
    height: float = 0.0
    motion: Literal["fixed", "driven", "free"] = "fixed"
    friction: float = 0.0
    mass: float = 0.0
    force: float | Rows = 0.0
    place: tuple[float, float] = (0.0, 0.0)
    tilts: bool = False
    stroke: Rows | None = None

    def __post_init__(self) -> None:
        if self.motion not in ("fixed", "driven", "free"):
            raise InputError(
                f"{self.name}: motion must be 'fixed', 'driven' or 'free', got {self.motion!r}"
            )
        weightless = self.motion != "free" or self.forces[:, 1].min() > 0
        for key, zero in (("friction", True), ("mass", weightless)):
            check_number(f"{self.name}: {key}", getattr(self, key), zero_allowed=zero)
        for force in self.forces[:, 1]:
            check_number(f"{self.name}: force", float(force), zero_allowed=True)
        if self.tilts and self.motion != "free":
            raise InputError(f"{self.name}: only a free tool tilts")

    @property
    def forces(self) -> FloatArray:
        """(n, 2) travel, mm, and force, N, of each row; one row for a constant force."""
        return np.array(self.force if isinstance(self.force, tuple) else [(0.0, self.force)])

    def moved(self, travel: float) -> float:
        """How far it has moved along z at a travel, mm."""
        if self.motion != "driven":
            return 0.0
        return -float(np.interp(travel, *np.transpose(self.stroke)) if self.stroke else travel)

    def turns(self, travel: float) -> list[float]:
        """Travels up to `travel` at which a driven tool is farthest from where it was, mm."""
        return sorted({*(s for s, _ in self.stroke or () if s < travel), travel})

    def gap(self, points: FloatArray, moved: float = 0.0) -> FloatArray:
        """(n,) distances of points (n, 3) from the tool that has moved along z, mm."""
        return self.shape.distance(points - [*self.place, self.height + moved])[0]


def _outer(u: FloatArray, v: FloatArray) -> FloatArray:
    return u[:, :, None] * v[:, None, :]
