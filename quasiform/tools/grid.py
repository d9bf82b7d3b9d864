"""Rigid tools from surface files: a smooth signed distance on a grid.

The distance to a triangle mesh has kinks at every facet, where Newton's method stalls. Therefore
the nodes of a coarse grid get their exact signed distance; those of two finer ones get theirs near
the surface and interpolate the coarser grid elsewhere. The tricubic B-spline through the nodes is
the distance d. It is C², n is its true gradient and H its true second derivative.

Closed surfaces take their sign from the winding number, which the needle-shaped facets of CAD
exports do not disturb [1]_. Open ones take it from the side of the nearest facet: outside is where
the normals point [2]_. The body behind an open surface ends in a wall that falls from its rim along
the normals, so that a sheet slides off the rim.

References
----------
.. [1] G. Barill et al., Fast winding numbers for soups and clouds, ACM Trans. Graph. 37 (2018) 43.
.. [2] J. A. Bærentzen, H. Aanæs, Signed distance computation using the angle weighted
   pseudonormal, IEEE Trans. Vis. Comput. Graph. 11 (2005) 243-253.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..checks import InputError, check_number, naming, optional
from .mending import check_numbers, edges_of, holes_of, normals_of, position
from .shapes import Distance
from .surface_file import SurfaceFile

FloatArray = np.ndarray

SPACING, FINEST = 2.0, 1 / 80  # mm; of the sheet, for small ones
AT_RIM = 1e-6  # of the surface's size: feet nearer to the rim lie on it
UNITS = {"mm": 1.0, "inches": 25.4, "metres": 1e3, "centimetres": 10.0, "micrometres": 1e-3}
REMEDY = "export it anew as one watertight body, or mend it in CAD, MeshLab or Blender"
SMALL = 0.1  # of the blank: a smaller tool may be in another unit
LOST = 0.4  # of a normal's length along n: walls and gaps thinner than a cell
BAND = 8.0  # cells of each level next to the surface whose nodes get exact distances
MARGIN = 5  # cells of grid around the tool, and
BESIDE = 1 / 31  # of the sheet
PAD = 5  # cells beyond the box: the spline's end conditions have died out there (0.27 a cell)
MOST_NODES = 1e8
CHUNK = 1024  # points whose coefficients stay in the cache


# Cubic B-spline on a cell: powers of t (rows) in each of the four coefficients
_POWERS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0


@dataclass(frozen=True, eq=False)
class SurfaceGrid:
    """A tool's signed distance as a tricubic B-spline. Built by `surface_grid`.

    Edges sharper than 2.5 cells are rounded. n is the gradient of the spline and therefore only
    nearly a unit vector. Facets larger than a cell show in n and H as they do in the file. Beyond
    the box, d is that of the nearest point of it plus √(s² + h²) - h with the distance s to the box
    and the spacing h: continuous, with a kink at the box, and negative only close to where the box
    cuts through the tool.
    """

    low: FloatArray  # (3,) and (3,): box in which the spline is the distance, mm
    high: FloatArray
    spacing: float  # h, mm
    coefficients: FloatArray = field(repr=False)  # (nx, ny, nz), the first at low - PAD h
    notes: tuple[str, ...] = ()  # what was left out of the surface, and defects off the sheet

    @property
    def box(self) -> FloatArray:
        return np.stack([self.low, self.high])

    @cached_property
    def steepest(self) -> float:
        """A bound on the length of the gradient: each component is a mean of differences."""
        bounds = [np.abs(np.diff(self.coefficients, axis=a)).max() / self.spacing for a in range(3)]
        return float(np.linalg.norm([*bounds, 1.0]))

    def distance(self, points: FloatArray) -> Distance:
        """Signed distance d (m,), gradient (m, 3) and second derivative (m, 3, 3) at (m, 3)."""
        nearest = np.clip(points, self.low, self.high)
        parts = [self._spline(nearest[i : i + CHUNK]) for i in range(0, len(points), CHUNK)]
        d, n, H = map(np.concatenate, zip(*parts, strict=True)) if parts else self._spline(nearest)
        arm = points - nearest
        beyond = arm != 0
        length = np.sqrt((arm**2).sum(1) + self.spacing**2)
        m = arm / length[:, None]
        d += length - self.spacing
        n = np.where(beyond, m, n)
        H *= ~(beyond[:, :, None] | beyond[:, None, :])
        across = beyond[:, :, None] * np.eye(3) - m[:, :, None] * m[:, None, :]
        return d, n, H + across / length[:, None, None]

    def _spline(self, points: FloatArray) -> Distance:
        _, ny, nz = self.coefficients.shape
        strides = np.array([ny * nz, nz, 1])
        u = (points - self.low).T / self.spacing + PAD
        cell = np.floor(u).astype(int)
        t = u - cell
        four = np.arange(-1, 3)
        cube = np.add.outer(np.add.outer(four * strides[0], four * strides[1]), four * strides[2])
        C = self.coefficients.ravel()[cube[..., None] + strides @ cell]
        one, zero, h = np.ones_like(t), np.zeros_like(t), self.spacing
        powers = [[one, t, t**2, t**3], [zero, one, 2 * t, 3 * t**2], [zero, zero, 2 * one, 6 * t]]
        # B[order of derivative, coefficient, axis, point]
        B = [np.tensordot(_POWERS.T, np.stack(p) / h**k, 1) for k, p in enumerate(powers)]
        Bx, By, Bz = np.moveaxis(np.stack(B), 2, 0)
        D = np.einsum("xyzm,czm->cxym", C, Bz)
        D = np.einsum("cxym,bym->bcxm", D, By)
        D = np.einsum("bcxm,axm->abcm", D, Bx)
        n = [D[1, 0, 0], D[0, 1, 0], D[0, 0, 1]]
        xy, yz, zx = D[1, 1, 0], D[0, 1, 1], D[1, 0, 1]
        H = [[D[2, 0, 0], xy, zx], [xy, D[0, 2, 0], yz], [zx, yz, D[0, 0, 2]]]
        return D[0, 0, 0], np.stack(n, -1), np.moveaxis(np.array(H), -1, 0)


def from_file(
    path: str | Path, low: FloatArray, high: FloatArray, spacing: float | None = None, **how: Any
) -> SurfaceGrid:
    """Distance of `SurfaceFile(path, **how)` as `surface_grid`; InputError names the file."""
    file = SurfaceFile(Path(path), **how)
    surface = file.placed()[:2]
    with naming(path):
        return surface_grid(*surface, low, high, spacing, scale=file.scale, flip=file.flip)


def surface_grid(
    vertices: FloatArray,
    triangles: np.ndarray,
    low: FloatArray,
    high: FloatArray,
    spacing: float | None = None,
    reach: float | None = None,
    scale: float = 1.0,
    flip: bool = False,
) -> SurfaceGrid:
    """Return the smooth signed distance of a surface, checked.

    The vertices (n, 3), in mm, are in the tool's frame. The grid covers the box from `low` to
    `high`, in which the sheet can be, as far as the tool's surroundings; its spacing, 2 mm by
    default, shall be at most 0.4 of the smallest radius that matters. `reach` (that of the box by
    default), `scale` and `flip` are as for `check_surface`. InputError also for a tool that is
    nowhere near the box, and for a grid that is too large, or too coarse for the tool.
    """
    h = check_number("spacing", SPACING if spacing is None else spacing)
    reach = float(np.ptp([low, high], axis=0).max()) if reach is None else reach
    notes = check_surface(vertices, triangles, low, high, reach, scale, flip)
    margin = max(BESIDE * reach, MARGIN * h)
    low = np.maximum(low, vertices.min(0) - margin)
    high = np.minimum(high, vertices.max(0) + margin)
    if (low >= high).any():
        box = " to ".join(f"{position(end)} mm" for end in (vertices.min(0), vertices.max(0)))
        remedy = "check origin, rotate and scale"
        raise InputError(f"the tool is nowhere near the sheet, it spans {box}: {remedy}")
    cells = np.ceil(((high - low) / h + 2 * PAD) / 9).astype(int)
    if (nodes := np.prod(9.0 * cells + 1.0)) > MOST_NODES:
        at_least = h * (nodes / MOST_NODES) ** (1 / 3)
        raise InputError(f"grid of {nodes:.1e} nodes: set spacing = {at_least:.2g} or more")
    inner, hidden = _in_other_bodies(vertices, triangles)
    if inner.any():
        notes.append(f"bodies in each other united: {inner.sum()} triangles inside left out")
    surface = (vertices, triangles, triangles[~inner])
    C = _coefficients(*surface, low - PAD * h, h, cells)
    grid = SurfaceGrid(low, high, h, C, tuple(notes))
    corners = vertices[triangles[~hidden]]
    centres, normals = corners.mean(1), normals_of(corners)
    covered = ((centres > low) & (centres < high)).all(1)
    centres, normals = centres[covered], normals[covered]
    area = np.linalg.norm(normals, axis=1)
    along = np.einsum("pi,pi->p", grid.distance(centres)[1], normals)
    lost = np.where(along < LOST * area, area, 0.0)
    if lost.sum() > 0.01 * area.sum():
        at = position(centres[lost.argmax()])
        words = f"walls or gaps that a grid of {h:g} mm cannot show, for one at {at} mm"
        size = float(np.ptp(vertices, axis=0).max())
        remedy = (
            likely_unit(size / scale, reach)
            if size < SMALL * reach
            else f"set spacing = {h / 4:.2g} or less"
        )
        raise InputError(f"{words}: {remedy}")
    return grid


def _coefficients(
    vertices: FloatArray,
    triangles: np.ndarray,
    outer: np.ndarray,
    first: FloatArray,
    h: float,
    cells: np.ndarray,
) -> FloatArray:
    """Coefficients of the spline on a grid of 9 `cells` from `first` on, from coarse to fine.

    The sign is that of all triangles, the distance that from the `outer` ones.
    """
    from scipy.ndimage import spline_filter, zoom

    edges, count, _ = edges_of(triangles)
    surface = (vertices, triangles, outer, edges[count == 1])
    for step in (9, 3, 1):
        shape = cells * 9 // step + 1
        if step == 9:
            d, near = np.zeros(shape), np.arange(np.prod(shape))
        else:
            d = zoom(d, shape / d.shape, mode="nearest")
            near = np.flatnonzero(np.abs(d) < BAND * step * h)
        for part in np.array_split(near, len(near) // 500_000 + 1):
            nodes = np.stack(np.unravel_index(part, shape), -1) * (step * h) + first
            d.flat[part] = _signed_distance(nodes, *surface)
    return spline_filter(d, mode="mirror")


def _in_other_bodies(vertices: FloatArray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of closed bodies that lie inside another one: the whole, and the centroid alone.

    Their outer side is inside by the winding number, which counts the bodies around a point.
    """
    none = np.zeros(len(triangles), dtype=bool)
    edges, count, _ = edges_of(triangles)
    link = coo_array((np.ones(len(edges)), edges.T), shape=2 * (len(vertices),))
    if (count != 2).any() or len(np.unique(connected_components(link, False)[1][edges])) < 2:
        return none, none
    igl = optional("igl", "surface", "a tool from a file needs libigl")
    corners = vertices[triangles]
    normals = normals_of(corners)
    out = 1e-4 * np.sqrt(np.linalg.norm(normals, axis=1))  # of the size of the triangle
    step = (out / np.linalg.norm(normals, axis=1))[:, None] * normals
    near = 0.98 * np.eye(3) + 0.02 / 3  # the corners, just inside the triangle
    shares = np.vstack([np.full(3, 1 / 3), near, 0.5 * (near + np.roll(near, 1, axis=0))])
    points = np.einsum("ks,msi->mki", shares, corners) + step[:, None]
    around = igl.fast_winding_number(vertices, triangles, points.reshape(-1, 3)) > 0.5
    around = around.reshape(len(triangles), len(shares))
    return around.all(1), around[:, 0]


def _signed_distance(
    points: FloatArray,
    vertices: FloatArray,
    triangles: np.ndarray,
    outer: np.ndarray,
    rim: np.ndarray,
) -> FloatArray:
    """Exact signed distance (m,) of points (m, 3) to the outer triangles; rim: (k, 2) edges."""
    igl = optional("igl", "surface", "a tool from a file needs libigl")
    if not len(rim):
        inside = igl.fast_winding_number(vertices, triangles, points) > 0.5
        d = np.sqrt(igl.point_mesh_squared_distance(points, vertices, outer)[0])
        return np.where(inside, -d, d)
    by = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    d, _, foot, normal = igl.signed_distance(points, vertices, triangles, by)
    to_rim = np.sqrt(igl.point_mesh_squared_distance(foot, vertices, rim)[0])
    behind = np.minimum(np.einsum("pi,pi->p", points - foot, normal), 0.0)
    from_wall = np.sqrt(np.maximum(d**2 - behind**2, 0.0))
    on_rim = to_rim < AT_RIM * np.ptp(vertices)
    return np.where(on_rim, from_wall, np.where(d < 0, -np.minimum(-d, to_rim), d))


def check_surface(
    vertices: FloatArray,
    triangles: np.ndarray,
    low: FloatArray | None = None,
    high: FloatArray | None = None,
    reach: float | None = None,
    scale: float = 1.0,
    flip: bool = False,
) -> list[str]:
    """Check that a surface has one size, one outside and no holes where the sheet can be.

    It may be open at one outer boundary; outside the box from `low` to `high`, mm, defects are
    allowed, and returned. `reach` is the size of the blank, mm, for the check of units; `scale` and
    `flip`, applied already, are for the messages. InputError names the defect and where it is.
    """
    check_numbers(vertices, triangles)
    if reach is not None:
        check_size(np.ptp(vertices[triangles].reshape(-1, 3), axis=0).max(), reach, scale)
    edges, count, turns = edges_of(triangles)
    notes = []
    for wrong, what in (
        (count > 2, "shared by more than two triangles"),
        ((count == 2) & (turns != 0), "between triangles with opposite normals"),
    ):
        ends = edges[wrong]
        near = _reached(vertices[ends[:, 0]], vertices[ends[:, 1]], low, high)
        for bad, here in ((ends[near], True), (ends[~near], False)):
            if n := len(bad):
                at = position(vertices[bad[0]].mean(0))
                words = f"{n} edge{'s' * (n > 1)} {what}, one at {at} mm"
                if here:
                    raise InputError(f"{words}: {REMEDY}")
                notes.append(f"{words}: away from the sheet")
    corners = vertices[triangles] - vertices.mean(0)
    if (count == 2).all() and np.linalg.det(corners).sum() < 0:
        raise InputError(f"the normals point inwards: set flip = {str(not flip).lower()}")
    for ring in holes_of(vertices, triangles):
        start, end = vertices[ring], vertices[np.roll(ring, -1)]
        hole = f"a hole of {len(ring)} edges, {np.ptp(start, axis=0).max():.3g} mm across"
        words = f"{hole}, around {position(start.mean(0))} mm"
        if _reached(start, end, low, high).any():
            raise InputError(f"{words}: close it ({REMEDY})")
        notes.append(f"{words}: away from the sheet")
    return notes


def _reached(
    start: FloatArray, end: FloatArray, low: FloatArray | None, high: FloatArray | None
) -> np.ndarray:
    """(k,) whether edges between points (k, 3) reach into a box; all do if there is none."""
    if low is None or high is None:
        return np.ones(len(start), dtype=bool)
    along = start + np.linspace(0.0, 1.0, 20)[:, None, None] * (end - start)
    return ((along > low) & (along < high)).all(-1).any(0)


def check_size(size: float, reach: float, scale: float = 1.0) -> None:
    """Refuse a tool of a size (mm) that only a wrong unit explains, beside a blank of `reach`."""
    if not reach / 50 <= size <= reach * 50:
        unit = likely_unit(size / scale, reach)
        across = f"the tool is {size:.3g} mm across (scale = {scale:g})"
        raise InputError(f"{across} beside a sheet of {reach:.3g} mm: {unit}")


def likely_unit(size: float, reach: float) -> str:
    """Ask for the scale that brings a tool of `size` units nearest to `reach` (mm)."""
    known = {unit: mm for unit, mm in UNITS.items() if reach / 12 < mm * size < 2 * reach}
    near = sorted(known, key=lambda unit: abs(np.log(known[unit] * size / reach)))
    if not near:
        return "check scale, the mm per unit of the file"
    return "is the file in " + ", or in ".join(
        f"{unit}? set scale = {known[unit]:g} ({known[unit] * size:.3g} mm)" for unit in near[:2]
    )
