"""The flat sheet: a mesh whose element legs lie on fibre lines.

The fabric is a net of two families of straight fibre lines. The lines cut the blank into
rectangular cells; every cell becomes two right triangles with both legs on fibres, the diagonals
alternating, so the mesh has the mirror planes and quarter turns of the net. Such P1 triangles see
the stretch of a fibre on a leg and the shear at a right corner: they neither lock nor have an
hourglass mode (the net is isostatic, as the inextensible fabric is).

An outline of any form, with holes, is cut out of the net (`cells.cut_net`). Triangles at the
outline may have one leg on a fibre only; as every node of the outline ends one line, the net stays
isostatic and does not lock.
"""

from __future__ import annotations

import itertools
from bisect import bisect
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skfem import Basis, ElementTriP1, MeshLine, MeshTri

from ..checks import InputError, check_number
from ..tools.mending import edges_of, position, rings_of
from .cells import cut_net
from .slits import check_slits, met, mirror_slits

if TYPE_CHECKING:
    import shapely

FloatArray = np.ndarray
IntArray = np.ndarray
MOST_TRIANGLES = 2_000_000
# in spacings of the fibre lines:
GIVE = 0.07  # how far an outline moves along each family of lines to meet the net
EXACT = 1e-3  # the same for a rectangle, whose edges may be gripped
APART = 0.4  # least distance of lines through corners and extremes
CLOSE = 0.1  # the same for a rectangle, whose corners share a line if they are nearer
SMALLEST, LARGEST = 5.0, 20e3  # mm across; beyond, the unit of a file is probably wrong


@dataclass(frozen=True, eq=False)
class Blank:
    """A flat sheet meshed along its fibres.

    Parameters
    ----------
    nodes : (n_nodes, 2) array
        Flat positions X, mm.
    triangles : (n_triangles, 3) array
        Node numbers, counter-clockwise; they tile the blank.
    warp, weft : (2,) arrays
        Unit vectors of the fibres.
    mirror : tuple of "x" and "y"
        Planes x = 0, y = 0 of which only the positive side is meshed.
    pairs : (n_pairs, 2) int array, optional
        Triangles of a mesh that does not follow the fibres, in pairs that share a mean fibre
        strain (a triangle without a partner is paired with itself).
    notes : tuple of str
        What was done to the mesh when it was read.
    """

    nodes: FloatArray
    triangles: IntArray
    warp: FloatArray
    weft: FloatArray
    mirror: tuple[str, ...] = ()
    pairs: IntArray | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def size(self) -> float:
        """Typical spacing of the fibre lines, mm: the leg of the median triangle."""
        return float(np.sqrt(2.0 * np.median(self.areas)))

    @cached_property
    def mesh(self) -> MeshTri:
        """The tiling as a scikit-fem mesh."""
        return _mesh(MeshTri, self.nodes, self.triangles)

    @cached_property
    def basis(self) -> Basis:
        """P1 basis with one quadrature point a triangle."""
        point = np.full((2, 1), 1 / 3), np.array([0.5])
        return Basis(self.mesh, ElementTriP1(), quadrature=point)

    @cached_property
    def areas(self) -> FloatArray:
        """(n_triangles,) areas of the triangles, mm²."""
        return self.basis.dx[:, 0]

    @cached_property
    def node_areas(self) -> FloatArray:
        """(n_nodes,) tributary areas, mm²; they sum to the area of the blank."""
        share = np.repeat(self.areas / 3.0, 3)
        return np.bincount(self.triangles.ravel(), share, minlength=len(self.nodes))

    @cached_property
    def doubled(self) -> IntArray:
        """Nodes on slits: others lie at the same places."""
        from scipy.spatial import cKDTree

        near = 1e-6 * self.size
        return np.unique(cKDTree(self.nodes).query_pairs(near, output_type="ndarray"))

    @cached_property
    def centroids(self) -> FloatArray:
        """(n_triangles, 2) flat positions of the triangles' centroids, mm."""
        return self.nodes[self.triangles].mean(1)

    def fibre_lines(self, family: str) -> MeshLine:
        """Segments of a family, "warp" or "weft", as a 1D mesh on the nodes; arc lengths in mm."""
        along = self.warp if family == "warp" else self.weft
        legs = self.mesh.facets.T
        direction = self.nodes[legs[:, 1]] - self.nodes[legs[:, 0]]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        across = along[::-1] * [-1.0, 1.0]
        segments = legs[np.abs(direction @ across) < 1e-4]  # sharper than any corner of a cut
        s = self.nodes @ along
        backwards = s[segments[:, 0]] > s[segments[:, 1]]
        segments[backwards] = segments[backwards, ::-1]
        return _mesh(MeshLine, s[:, None], segments)

    @cached_property
    def outline(self) -> list[IntArray]:
        """Closed polylines of nodes, the first repeated: the outer boundary, then the holes.

        The blank lies on the left of all.
        """
        edges, count, _ = edges_of(self.triangles)
        rings = [np.array([*ring, ring[0]]) for ring in rings_of(edges[count == 1])]
        return sorted(rings, key=lambda ring: -np.ptp(self.nodes[ring], axis=0).sum())

    def unfolded(self) -> tuple[Blank, IntArray, FloatArray, IntArray, FloatArray]:
        """Mirror a part of the blank into the whole.

        Returns the whole; of its n nodes, the node (n,) that each mirrors and the signs (n, 3) of
        its position components; of its m triangles, the same: the source (m,) and the sign (m,) of
        the shear angle (a mirrored net shears the other way).
        """
        nodes, source = self.nodes, np.arange(len(self.nodes))
        sign = np.ones((len(nodes), 3))
        triangles, triangle_source = self.triangles, np.arange(len(self.triangles))
        triangle_sign, pairs = np.ones(len(triangles)), self.pairs
        for plane in self.mirror:
            axis = "xy".index(plane)
            off = np.flatnonzero(np.abs(nodes[:, axis]) > 1e-9)
            number = np.arange(len(nodes))
            number[off] = len(nodes) + np.arange(len(off))
            flip = np.ones(3)
            flip[axis] = -1.0
            nodes = np.vstack([nodes, nodes[off] * flip[:2]])
            source, sign = np.append(source, source[off]), np.vstack([sign, sign[off] * flip])
            triangles = np.vstack([triangles, number[triangles][:, ::-1]])
            triangle_source = np.tile(triangle_source, 2)
            triangle_sign = np.append(triangle_sign, -triangle_sign)
            if pairs is not None:
                pairs = np.vstack([pairs, pairs + len(triangles) // 2])
        whole = replace(self, nodes=nodes, triangles=triangles, mirror=(), pairs=pairs)
        return whole, source, sign, triangle_source, triangle_sign

    def turned(self, angle: float) -> Blank:
        """Turn the blank together with its fibres by `angle` degrees about the origin."""
        R = rotation(angle)
        return replace(self, nodes=self.nodes @ R.T, warp=R @ self.warp, weft=R @ self.weft)


def _mesh(kind: type, nodes: FloatArray, elements: IntArray) -> MeshTri | MeshLine:
    """Build a scikit-fem mesh with the node order kept, so that orientations survive."""
    return kind(np.ascontiguousarray(nodes.T), np.ascontiguousarray(elements.T), sort_t=False)


def rotation(angle: float) -> FloatArray:
    """(2, 2) matrix of a counter-clockwise turn by `angle` degrees, exact at quarter turns."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    if angle % 90 == 0:
        c, s = np.round(c), np.round(s)
    return np.array([[c, -s], [s, c]])


def rectangle(
    length: float,
    width: float,
    size: float,
    orientation: float = 0.0,
    centre: tuple[float, float] = (0.0, 0.0),
    through: tuple[tuple[float, float], ...] = (),
    mirror: tuple[str, ...] = (),
) -> Blank:
    """Mesh a rectangle, length along x, with fibre lines through its corners.

    Its edges stay straight to a thousandth of the spacing, as for grips. Corners that miss each
    other's lines by less than a tenth of the spacing share one, and are moved there.

    Parameters
    ----------
    length, width : float
        mm, along x and y.
    centre : (2,)
        mm.
    size, orientation, through, mirror
        As for `cut`, the spacing in mm and the orientation in degrees; so are the errors.

    Returns
    -------
    Blank
    """
    for name, value in (("length", length), ("width", width), ("size", size)):
        check_number(name, value)
    if mirror and (orientation % 90 != 0 or any(centre)):
        raise InputError("mirror planes need fibres along x and y and the centre at the origin")
    x1, y1 = length / 2, width / 2
    x0, y0 = -x1 * ("x" not in mirror), -y1 * ("y" not in mirror)
    box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float) + np.asarray(centre)
    _check_count(size, length, width, length * width)
    R = rotation(orientation)
    points = np.array([*box, *through]) @ R  # in fibre coordinates (a, b)
    corners, through, lines = points[:4], points[4:], []
    for side, inner in zip(corners.T, through.T, strict=True):
        stops = _stops([*inner, *side], CLOSE * min(size, np.ptp(side)))
        side[:] = stops[np.abs(side - stops[:, None]).argmin(0)]
        lines.append(_lines_through(stops, size))
    near = EXACT * min(np.diff(line).min() for line in lines)
    nodes, triangles = cut_net(lines, [corners], near, 0.5 * EXACT, corners[0])
    return Blank(nodes @ R.T, triangles, R[:, 0], R[:, 1], mirror)


def cut(
    outline: shapely.Polygon,
    size: float,
    orientation: float = 0.0,
    through: Sequence[tuple[float, float]] = (),
    mirror: tuple[str, ...] = (),
    slits: Sequence[FloatArray] = (),
    open_tips: bool = False,
) -> Blank:
    """Mesh a blank of any outline, with holes and slits.

    Fibre lines run through the points `through`, the corners (of more than 20°) and the extremes of
    the outline and its holes, and the ends of slits, in this order, unless one is there already
    within 0.4 of the spacing.
    The others are `size` apart from the first of these on, so that they stay where they are when
    the outline changes; they are evenly spaced between these where an edge is at 45° to the fibres,
    which then runs along diagonals of the cells.
    Outline and slits move by at most a tenth of the spacing to meet the net. What is narrower than
    a seventh of the spacing can be lost: small holes, the ends of sharp tips.

    Parameters
    ----------
    outline : shapely.Polygon
        mm.
    size : float
        Spacing of the fibre lines, mm; the nearest that fits where they are evenly spaced.
    orientation : float
        Angle of the warp to x, degrees.
    through : points, mm
        Points that must lie on a warp and a weft line.
    mirror : tuple of "x" and "y"
        Mesh only the positive side of the planes x = 0, y = 0.
    slits : (k, 2) arrays, mm
        Open lines along which the fabric is cut: the nodes on them are doubled.
    open_tips : bool
        Whether ends of notches that are too narrow for the size are cut as slits, and not closed.

    Raises
    ------
    InputError
        For bad numbers or outlines, outlines with parts too narrow for the size, mirror planes
        that do not fit, or more than two million triangles.

    Examples
    --------
    >>> import shapely
    >>> blank = cut(shapely.box(0, 0, 40, 20).difference(shapely.box(10, 5, 20, 15)), 5.0)
    >>> len(blank.triangles), round(float(blank.areas.sum()), 6), len(blank.outline)
    (56, 700.0, 2)
    """
    import shapely

    check_number("size", size)
    if not isinstance(orientation, Real) or not np.isfinite(orientation):
        raise InputError(f"orientation must be a number of degrees, got {orientation!r}")
    if not isinstance(outline, shapely.Polygon) or outline.area <= 0 or not outline.is_valid:
        kind = getattr(outline, "geom_type", type(outline).__name__)
        raise InputError(f"the outline must be one valid polygon with an area, got a {kind}")
    x0, y0, x1, y1 = outline.bounds
    _check_count(size, x1 - x0, y1 - y0, outline.area)
    check_slits(outline, slits)
    outline = _mirrored_part(outline, mirror, orientation, size)
    for plane in mirror:
        if not mirror_slits(slits, "xy".index(plane), 0.01 * size):
            remedy = f"leave '{plane}' out of mirror"
            raise InputError(f"the slits are not symmetric to {plane} = 0: {remedy}")
    R = rotation(orientation)
    oriented = shapely.orient_polygons(outline)
    rings = [shapely.get_coordinates(r)[:-1] for r in (oriented.exterior, *oriented.interiors)]
    first = rings[0][rings[0].sum(1).argmin()] @ R
    rings, lines = [ring @ R for ring in rings], [np.asarray(line) @ R for line in slits]
    rings, slits = met(rings, lines, GIVE * size)
    corners = [_corners(ring, size) for ring in rings]
    extremes = [_extremes(*pair, size) for pair in zip(rings, corners, strict=True)]
    ends = [line[[0, -1]] for line in slits]
    points = np.vstack([np.reshape(through, (-1, 2)) @ R, *corners, *extremes, *ends])
    lines, even = [], _on_diagonals(rings[0], size)
    for i in (0, 1):
        planes = [0.0 for plane in mirror if abs(R["xy".index(plane), i]) == 1]
        least = APART * min(size, np.ptp(rings[0][:, i]))
        stops = _stops([*planes, *points[:, i]], least)
        anchor = [*planes, *points[:, i]][0]
        lines.append(_lines_through(stops, size) if even else _lines_from(anchor, stops, size))
    near = GIVE * min(size, max(np.diff(line).max() for line in lines))
    nodes, triangles = cut_net(lines, rings, near, GIVE, first, slits, open_tips)
    blank = Blank(nodes @ R.T, triangles, R[:, 0], R[:, 1], mirror)
    return _in_one_part(blank, outline, size, 0.0 if slits else 0.1 * size**2)


def check_unit(across: float, scale: float) -> None:
    """Refuse (InputError) a blank of a few mm or many metres across: its unit is probably wrong."""
    if not SMALLEST <= across <= LARGEST:
        unit, factor = ("metres", 1000.0) if across < SMALLEST else ("micrometres", 1e-3)
        remedy = f"is it in {unit}? set scale = {factor * scale:g}"
        raise InputError(f"the blank is {across:.3g} mm across: {remedy}")


def _check_count(size: float, length: float, width: float, area: float) -> None:
    # a cell of the net outside the outline costs a tenth of one inside
    if not max(2 * area, 0.2 * length * width) < MOST_TRIANGLES * size**2:
        words = f"makes more than {MOST_TRIANGLES:.0e} triangles: choose a larger size"
        raise InputError(f"size {size:g} mm on {length:g} x {width:g} mm {words}")


def _mirrored_part(
    outline: shapely.Polygon, mirror: tuple[str, ...], orientation: float, size: float
) -> shapely.Polygon:
    """Return the positive side of the mirror planes of an outline that has their symmetry."""
    import shapely

    if mirror and orientation % 90 != 0:
        raise InputError("mirror planes need fibres along x and y")
    far = 2 * np.abs(outline.bounds).max()
    part = outline
    for plane in mirror:
        flip, half = np.ones(2), [-far, -far, far, far]
        flip["xy".index(plane)], half["xy".index(plane)] = -1.0, 0.0
        image = shapely.transform(outline, lambda p, flip=flip: p * flip)
        if outline.symmetric_difference(image).area > 0.01 * size * outline.length:
            remedy = f"leave '{plane}' out of mirror"
            raise InputError(f"the outline is not symmetric to {plane} = 0: {remedy}")
        part = part.intersection(shapely.box(*half))
    pieces = [piece for piece in shapely.get_parts(part) if piece.area > 0]
    if len(pieces) != 1:
        raise InputError("the mirror planes divide the outline into parts")
    return pieces[0]


def _corners(ring: FloatArray, size: float) -> FloatArray:
    """(n, 2) vertices of a ring where it turns by more than 20°, the sharpest first."""
    import shapely

    points = shapely.get_coordinates(shapely.simplify(shapely.LinearRing(ring), 0.02 * size))[:-1]
    along = np.roll(points, -1, axis=0) - points
    into = np.roll(along, 1, axis=0)
    cross = into[:, 0] * along[:, 1] - into[:, 1] * along[:, 0]
    turn = np.abs(np.arctan2(cross, (into * along).sum(1)))
    order = np.argsort(-turn.round(6), kind="stable")
    return points[order[turn[order] > np.radians(20.0)]]


def _extremes(ring: FloatArray, corners: FloatArray, size: float) -> FloatArray:
    """(n, 2) points of a ring farthest along ±a, ±b, where these are no corners."""
    points = []
    for axis, sign in itertools.product((0, 1), (1.0, -1.0)):
        t = sign * ring[:, axis]
        if len(corners) and (sign * corners[:, axis]).max() > t.max() - 0.01 * size:
            continue
        beside = ring[t > t.max() - 0.01 * size, 1 - axis]
        point = np.array([sign * t.max(), 0.5 * (beside.min() + beside.max())])
        points.append(point[[axis, 1 - axis]])
    return np.reshape(points, (-1, 2))


def _stops(values: Iterable[float], least: float) -> FloatArray:
    """Sort `values`, without those nearer than `least` to an earlier one."""
    kept: list[float] = []
    for value in values:
        at = bisect(kept, value)
        if all(abs(value - other) > least for other in kept[max(at - 1, 0) : at + 1]):
            kept.insert(at, float(value))
    return np.array(kept)


def _on_diagonals(ring: FloatArray, size: float) -> bool:
    """Whether an edge of the outline is at 45° to the fibres, so that diagonals may tile it."""
    edges = np.abs(np.roll(ring, -1, axis=0) - ring)
    return bool((np.abs(edges[:, 0] - edges[:, 1]) < 1e-9 * edges.max())[edges[:, 0] > size].any())


def _lines_from(anchor: float, stops: FloatArray, size: float) -> FloatArray:
    """Coordinates of fibre lines `size` apart, one of them at the `anchor`, and at all `stops`.

    A line nearer than `APART` to a stop gives way to it. Lines do not move with the outline.

    Examples
    --------
    >>> _lines_from(0.0, np.array([-22.0, 0.0, 27.0, 35.0]), 10.0).tolist()
    [-22.0, -10.0, 0.0, 10.0, 20.0, 27.0, 35.0]
    >>> _lines_from(0.0, np.array([0.0, 30.0]), 10.0).tolist()
    [0.0, 10.0, 20.0, 30.0]
    """
    low, high = (stops[[0, -1]] - anchor) / size
    even = anchor + size * np.arange(np.ceil(low - 1e-9), np.floor(high + 1e-9) + 1)
    near = np.abs(even[:, None] - stops).min(1) < APART * size
    return np.sort(np.r_[even[~near], stops])


def _lines_through(stops: FloatArray, size: float) -> FloatArray:
    """Coordinates of fibre lines through all `stops`, evenly spaced by about `size` between."""
    steps = [max(1, round(gap / size)) for gap in np.diff(stops)]
    pairs = zip(stops, stops[1:], steps, strict=False)
    return np.concatenate([*(np.linspace(*pair, endpoint=False) for pair in pairs), stops[-1:]])


def _in_one_part(blank: Blank, outline: shapely.Polygon, size: float, small: float) -> Blank:
    """Leave out parts of up to a `small` area joined by a node; refuse what size cannot resolve."""
    count = len(blank.triangles)
    edges, shared, turns = edges_of(blank.triangles)
    on_top = (shared > 2) | ((shared == 2) & (turns != 0))
    bad = blank.nodes[edges[on_top, 0]]  # triangles on top of each other
    beside = blank.mesh.f2t[:, blank.mesh.f2t[1] >= 0]
    links = coo_array((np.ones(beside.shape[1]), beside), shape=(count, count))
    _, part = connected_components(links, directed=False)
    areas = np.bincount(part, blank.areas)
    main = part == areas.argmax()
    bad = np.vstack([bad, blank.centroids[~main & (areas[part] > small)]])
    if not main.all():
        used, triangles = np.unique(blank.triangles[main], return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        blank = replace(blank, nodes=blank.nodes[used], triangles=triangles)
    edges, shared, _ = edges_of(blank.triangles)
    rim, visits = np.unique(edges[shared == 1, 0], return_counts=True)
    bad = np.vstack([bad, blank.nodes[rim[visits > 1]]])  # parts joined by a node
    missing = abs(outline.area - blank.areas.sum()) > CLOSE * size * outline.length
    if len(bad) or missing:
        at = position(bad[0] if len(bad) else outline.centroid.coords[0])
        words = "it is narrower there than the spacing of the fibre lines"
        raise InputError(f"size {size:g} mm is too large for the outline near {at}: {words}")
    return blank
