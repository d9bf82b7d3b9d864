"""A formed sheet, computed or measured, and a run of them along the travel.

A sheet is known at points: where they are when formed, where they were when flat, or both; the
shear angle there; and what the triangles between them are, if there are any. A value by triangle is
brought to the nodes as the mean of the triangles around, weighted by area. The same for every code:
a linear triangle sees the shear best at a place that is not its centroid, and the mean hides where.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from ..checks import InputError
from ..tools.surface_file import edges_of

FloatArray = np.ndarray
SAME = 1e-3  # travels nearer than this share of the travel are one


@dataclass(frozen=True, eq=False)
class Sheet:
    """A formed sheet at one travel.

    Parameters
    ----------
    points : (n, 3) array, optional
        Formed positions x, mm.
    flat : (n, 2) array, optional
        Flat positions X, mm.
    triangles : (m, 3) int array, optional
    gamma : (n,) array, optional
        Shear angle at the points, degrees; nan where it is not known.
    contour : shapely.LineString, optional
        Outline seen along z, where it is not that of the triangles; closed or a part of it.
    by_triangle : (m,) array, optional
        Shear angle of the triangles, degrees, where it is known by triangle.
    """

    points: FloatArray | None = None
    flat: FloatArray | None = None
    triangles: np.ndarray | None = None
    gamma: FloatArray | None = None
    contour: shapely.LineString | None = None
    by_triangle: FloatArray | None = None

    @property
    def places(self) -> FloatArray:
        """(n, 3) positions to show the points at: formed ones, or flat ones at z = 0."""
        return self.points if self.points is not None else np.pad(self.flat, ((0, 0), (0, 1)))

    @property
    def outline(self) -> shapely.LineString | None:
        """Outer outline of the formed sheet seen along z, mm; without its holes."""
        if self.contour is not None or self.triangles is None or self.points is None:
            return self.contour
        ends, count, _ = edges_of(self.triangles)
        rim = shapely.linestrings(self.points[ends[count == 1], :2])
        lines = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(rim)))
        spans = np.array([np.ptp(shapely.get_coordinates(line), axis=0).max() for line in lines])
        return lines[spans.argmax()] if len(lines) else None

    @property
    def weights(self) -> FloatArray:
        """(n,) area that a point stands for, of the flat sheet if it is known; 1 without a mesh."""
        if self.triangles is None:
            return np.ones(len(self.places))
        places = self.places if self.flat is None else np.pad(self.flat, ((0, 0), (0, 1)))
        return np.bincount(
            self.triangles.ravel(), np.repeat(_areas(places, self.triangles) / 3, 3), len(places)
        )

    @property
    def blank(self) -> shapely.Polygon | None:
        """What the flat sheet covers, without its holes; None where it is not known."""
        if self.flat is None or self.triangles is None:
            return None
        rim = Sheet(points=np.pad(self.flat, ((0, 0), (0, 1))), triangles=self.triangles).outline
        return shapely.make_valid(shapely.Polygon(rim)) if rim is not None else None

    def own(self) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Shear angles of the triangles, their areas and their flat centroids."""
        places = self.places if self.flat is None else np.pad(self.flat, ((0, 0), (0, 1)))
        centroids = None if self.flat is None else self.flat[self.triangles].mean(1)
        return self.by_triangle, _areas(places, self.triangles), centroids

    @property
    def spacing(self) -> float:
        """Median distance of a point to its nearest neighbour, mm."""
        places = self.places if self.flat is None else self.flat
        if len(places) < 2:
            raise InputError("a field needs more than one point")
        return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))


@dataclass(frozen=True, eq=False)
class Run:
    """Sheets along the travel, with their history.

    Parameters
    ----------
    name : str
    travels : tuple of float or None
        Travel of each state, mm, ascending; a single None where it is not known.
    state : callable
        Returns the sheet of a state by number.
    history : mapping of str to (k,) arrays
        travel (mm), force (N), kinetic and internal (energies, mJ), as far as they are known.
    areas : mapping of str to (centre, radius)
        Discs of the flat blank, mm.
    notes : tuple of str
        How it was read, for the report.
    scene : str
        Scene that a run is of; empty where it is not told.
    locking : float, optional
        Shear angle at which its fabric locks, degrees.
    """

    name: str
    travels: tuple[float | None, ...]
    state: Callable[[int], Sheet]
    history: Mapping[str, FloatArray] = field(default_factory=dict)
    areas: Mapping[str, tuple[tuple[float, float], float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    scene: str = ""
    locking: float | None = None

    def at(self, travel: float | None) -> tuple[Sheet, str]:
        """Sheet at a travel, interpolated between two states on one mesh; and how it was found.

        Raises
        ------
        InputError
            If the run does not reach the travel.
        """
        if travel is None or self.travels[-1] is None:
            return self.state(len(self.travels) - 1), "its only state"
        s = np.array(self.travels, dtype=float)
        near = int(np.abs(s - travel).argmin())
        slack = SAME * max(abs(travel), 1.0)
        if abs(s[near] - travel) <= slack:
            return self.state(near), f"its state at {s[near]:.6g} mm"
        if not s[0] <= travel <= s[-1]:
            raise InputError(
                f"{self.name}: travels do not overlap: it has {s[0]:g} to {s[-1]:g} mm, "
                f"asked for {travel:g} mm"
                if len(s) > 1
                else f"{self.name}: travels do not overlap: it is at {s[0]:g} mm, "
                f"asked for {travel:g} mm"
            )
        i = int(np.searchsorted(s, travel))
        before, after = self.state(i - 1), self.state(i)
        if not _one_mesh(before, after):
            return self.state(near), (
                f"its nearest state, at {s[near]:.6g} mm (the mesh changes on the way)"
            )
        share = (travel - s[i - 1]) / (s[i] - s[i - 1])

        def mixed(p: FloatArray | None, q: FloatArray | None) -> FloatArray | None:
            return None if p is None or q is None else (1 - share) * p + share * q

        sheet = replace(
            before,
            points=mixed(before.points, after.points),
            gamma=mixed(before.gamma, after.gamma),
            by_triangle=mixed(before.by_triangle, after.by_triangle),
        )
        return sheet, f"interpolated between {s[i - 1]:.6g} and {s[i]:.6g} mm"


def _one_mesh(a: Sheet, b: Sheet) -> bool:
    if a.triangles is None or b.triangles is None:
        return False
    return np.array_equal(a.triangles, b.triangles) and len(a.places) == len(b.places)


def _areas(points: FloatArray, triangles: np.ndarray) -> FloatArray:
    """(m,) areas of triangles, mm²."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def at_nodes(values: FloatArray, places: FloatArray, triangles: np.ndarray) -> FloatArray:
    """(n,) means, weighted by area, of (m,) values by triangle; nan at a point without one.

    Examples
    --------
    >>> X = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> at_nodes(np.array([3.0, 6.0]), X, np.array([[0, 1, 2], [0, 2, 3]])).tolist()
    [4.5, 3.0, 4.5, 6.0]
    """
    known = np.isfinite(values)
    values, triangles = values[known], triangles[known]
    around, weight = triangles.ravel(), np.repeat(_areas(places, triangles), 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.bincount(around, weight * np.repeat(values, 3), len(places)) / np.bincount(
            around, weight, len(places)
        )


def sheared(flat: FloatArray, x: FloatArray, triangles: np.ndarray, along: float) -> FloatArray:
    """(m,) signed shear angle, degrees, of a net with its warp at `along` degrees to x.

    sin γ = a·b/(|a||b|) with a, b = F (warp, weft), the images of the two fibres.
    """
    legs = x[triangles[:, 1:]] - x[triangles[:, :1]]
    rest = flat[triangles[:, 1:]] - flat[triangles[:, :1]]
    F = np.linalg.solve(rest, legs)  # (m, 2, 3): images of the unit vectors along x and y
    c, s = np.cos(np.radians(along)), np.sin(np.radians(along))
    a, b = c * F[:, 0] + s * F[:, 1], c * F[:, 1] - s * F[:, 0]
    sine = (a * b).sum(1) / np.sqrt((a * a).sum(1) * (b * b).sum(1))
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))
