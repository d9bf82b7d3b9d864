"""Blanks on meshes that do not follow the fibres: the user's own, or a free triangulation.

Such meshes get `pairs` of triangles that share their fibre strains (`energy.membrane`): the
quadrilaterals of the mesh, and for triangles the pairing with the best quadrilaterals.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_array

from ..checks import InputError, check_number, naming, optional
from ..meshes.shells import counted, read_shells
from ..tools.mending import MERGED, check_numbers, together
from .blank import MOST_TRIANGLES, Blank, check_unit, rotation
from .sound import check_elements, check_one_piece

if TYPE_CHECKING:
    import shapely

FloatArray = np.ndarray
IntArray = np.ndarray
ALIGNED = np.sin(np.radians(0.1))
PAIRED = (
    "fibre strains shared by pairs of triangles",
    "the mesh does not follow the fibres; the answer is less accurate than on one cut along them, "
    "in off-axis tension at 2000 triangles by some 2 % of the force at 45 degrees and 12 % at 30",
)


def triangulate(outline: shapely.Polygon, size: float, orientation: float = 0.0) -> Blank:
    """Triangulate an outline (mm) with its holes by gmsh, without regard to the fibres.

    The size (mm) is the spacing of fibre lines that make as many triangles, the orientation the
    angle of the warp to x, degrees. A bad size, or no gmsh, raises InputError.
    """
    import shapely

    check_number("size", size)
    if not 2 * outline.area < MOST_TRIANGLES * size**2:
        raise InputError(f"size {size:g} mm makes more than {MOST_TRIANGLES:.0e} triangles")
    gmsh = optional("gmsh", "cad", "a free triangulation needs gmsh")
    edge = size * np.sqrt(2.0 / np.sqrt(3.0))  # an equilateral triangle of half a cell's area
    if gmsh.isInitialized():
        raise InputError("gmsh is in use by the calling program: finalize it first")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        geo = gmsh.model.geo
        loops = []
        for ring in (outline.exterior, *outline.interiors):
            places = shapely.get_coordinates(ring.simplify(1e-3 * size))[:-1]
            points = [geo.addPoint(*place, 0.0, edge) for place in places]
            ends = zip(points, np.roll(points, -1).tolist(), strict=True)
            loops.append(geo.addCurveLoop([geo.addLine(*pair) for pair in ends]))
        geo.addPlaneSurface(loops)
        geo.synchronize()
        gmsh.model.mesh.generate(2)
        tags, places, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType(2)
    finally:
        gmsh.finalize()
    order = np.argsort(tags)
    found = order[np.searchsorted(tags, corners, sorter=order)]
    used, triangles = np.unique(found, return_inverse=True)
    nodes = places.reshape(-1, 3)[used, :2]
    return _blank(nodes, triangles.reshape(-1, 3), np.zeros((0, 4), dtype=int), orientation)


def check_same_size(size: float, built: float | None) -> None:
    """Refuse to build a model on the user's own mesh at another size than it was built before."""
    if built is not None and size != built:
        raise InputError(f"a mesh of its own has one size only: not {size:g} mm")


def own_mesh(path: str | Path, orientation: float = 0.0, scale: float = 1.0) -> Blank:
    """Read the user's own flat mesh of triangles and quadrilaterals (.inp, or what meshio reads).

    The orientation is the angle of the warp to x, degrees; the scale is mm per unit of the file.
    Nodes at one place are merged. InputError names the element of a mesh that is not flat, is in
    pieces, overlaps itself, or has a node on the side of an element.
    """
    path = Path(path)
    with naming(path):
        shells = read_shells(path, scale)
        check_numbers(shells.points, shells.corners[:, :3])
        if polygons := [kind for kind in shells.left_out if kind.startswith("polygons")]:
            raise InputError(f"{shells.left_out[polygons[0]]} {polygons[0]}: split them")
        higher, left_out = (shells.middles >= 0).any(1).sum(), shells.left_out
        shells = replace(shells, middles=shells.middles[:, :0]).with_used_nodes()
        points = shells.points
        if np.ptp(points[:, 2]) > 1e-6 * np.ptp(points):
            raise InputError(f"the mesh is not flat: its z spans {np.ptp(points[:, 2]):.3g} mm")
        check_unit(np.ptp(points, axis=0).max(), scale)
        nodes, same, _ = together(points[:, :2], MERGED * np.linalg.norm(np.ptp(points, axis=0)))
        corners = np.where(shells.corners < 0, -1, same[shells.corners])
        check_elements(nodes, corners, shells.elements)
        triangles, quads = (corners[shells.count == n, :n] for n in (3, 4))
        blank = _blank(nodes, triangles, quads, orientation)
        check_one_piece(blank)
        one = len(points) - len(nodes)
        notes = [f"{one} nodes merged with another at their place"] * bool(one)
        notes += [f"of {higher} elements of second order the corners are taken"] * bool(higher)
        notes += [f"left out: {counted(left_out)}"] * bool(left_out)
        return replace(blank, notes=tuple(notes))


def outline_of(blank: Blank) -> shapely.Polygon:
    """Return the outline of a blank with its holes."""
    import shapely

    outer, *holes = (blank.nodes[loop] for loop in blank.outline)
    return shapely.Polygon(outer, holes)


def aligned_share(blank: Blank) -> float:
    """Share of the triangles with two legs on the fibres, within 0.1°."""
    corners = blank.nodes[blank.triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    edges /= np.linalg.norm(edges, axis=2)[:, :, None]
    on_warp = (np.abs(edges @ blank.weft) < ALIGNED).any(1)
    on_weft = (np.abs(edges @ blank.warp) < ALIGNED).any(1)
    return float((on_warp & on_weft).mean())


def _blank(nodes: FloatArray, triangles: IntArray, quads: IntArray, orientation: float) -> Blank:
    """Split quadrilaterals, turn all elements counter-clockwise, and pair the triangles."""
    halves = np.hstack([quads[:, [0, 1, 2]], quads[:, [2, 3, 0]]]).reshape(-1, 3)
    single = len(triangles)
    triangles = np.vstack([triangles, halves])
    u, v = (nodes[triangles[:, k]] - nodes[triangles[:, 0]] for k in (1, 2))
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    triangles[twice < 0] = triangles[twice < 0][:, ::-1]
    R = rotation(orientation)
    blank = Blank(nodes, triangles, R[:, 0], R[:, 1])
    if aligned_share(blank) == 1.0:
        return blank  # its elements do not lock
    pairs = np.vstack([_pairs(blank, single), np.arange(single, len(triangles)).reshape(-1, 2)])
    return Blank(nodes, triangles, R[:, 0], R[:, 1], (), pairs)


def _pairs(blank: Blank, count: int) -> IntArray:
    """Pair the first `count` triangles with neighbours, single ones with themselves.

    It is a matching of largest weight: as many and as good quadrilaterals as there can be.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    mesh, nodes = blank.mesh, blank.nodes
    inner = np.flatnonzero((mesh.f2t[1] >= 0) & (mesh.f2t < count).all(0))
    if not len(inner):
        return np.repeat(np.arange(count)[:, None], 2, axis=1)
    left, right = mesh.f2t[:, inner]
    ends = mesh.facets[:, inner]
    tips = [blank.triangles[side].sum(1) - ends.sum(0) for side in (left, right)]
    ring = nodes[np.stack([ends[0], tips[0], ends[1], tips[1]], axis=1)]
    out, into = np.roll(ring, -1, axis=1) - ring, np.roll(ring, 1, axis=1) - ring
    cosine = (out * into).sum(2) / np.sqrt((out**2).sum(2) * (into**2).sum(2))
    worst = np.abs(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) - 90.0).max(1)
    weight = 1.0 + np.clip(1.0 - worst / 90.0, 0.0, 1.0)
    m = len(inner)
    once = csc_array((np.ones(2 * m), (np.r_[left, right], np.tile(np.arange(m), 2))), (count, m))
    limits = {"constraints": LinearConstraint(once, -np.inf, 1.0), "bounds": Bounds(0.0, 1.0)}
    found = milp(-weight, **limits, integrality=np.ones(m), options={"mip_rel_gap": 1e-3})
    if found.x is None:
        raise InputError(f"the triangles cannot be paired: {found.message}")
    chosen = found.x > 0.5
    pairs = np.column_stack([left[chosen], right[chosen]])
    alone = np.setdiff1d(np.arange(count), pairs)
    return np.vstack([pairs, np.column_stack([alone, alone])])
