"""The mesh of the flat sheet: legs on fibres, lines through the corners, symmetries, tiling."""

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose, assert_array_equal

from quasiform.checks import InputError
from quasiform.energy.membrane import Membrane
from quasiform.fabric import Fabric
from quasiform.net import outline as outlines
from quasiform.net.blank import Blank, _corners, cut, rectangle, rotation
from quasiform.net.cells import _fan
from quasiform.unknowns import Unknowns

LENGTH, WIDTH = 320.0, 160.0


def specimen(angle, size=10.0):
    """Off-axis tension specimen as `experiments` meshes it."""
    return rectangle(LENGTH, WIDTH, size / np.sqrt(2.0), orientation=-angle)


# name: how it is meshed, and its area in mm²
BLANKS = {
    "along": (lambda: rectangle(120.0, 80.0, 10.0), 9600.0),
    "centred": (lambda: rectangle(120.0, 80.0, 7.0, through=((0.0, 0.0),)), 9600.0),
    "off centre": (lambda: rectangle(100.0, 25.0, 5.0, -90.0, centre=(50.0, 3.0)), 2500.0),
    "quarter": (lambda: rectangle(120.0, 80.0, 10.0, 90.0, mirror=("x", "y")), 2400.0),
    "specimen 45": (lambda: specimen(45), 51200.0),
    "specimen 30": (lambda: specimen(30), 51200.0),
    "specimen 60": (lambda: specimen(60), 51200.0),
    "at 20": (lambda: rectangle(100.0, 100.0, 9.0, 20.0, through=((0.0, 0.0),)), 10000.0),
}
every_blank = pytest.mark.parametrize(("make", "area"), BLANKS.values(), ids=BLANKS)


def signed_areas(blank):
    a, b = np.moveaxis(
        blank.nodes[blank.triangles[:, 1:]] - blank.nodes[blank.triangles[:, :1]], 1, 0
    )
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def fibre_legs(blank, tolerance=1e-8):
    """(n_triangles,) number of edges parallel to a fibre."""
    edges = blank.nodes[np.roll(blank.triangles, -1, axis=1)] - blank.nodes[blank.triangles]
    edges /= np.linalg.norm(edges, axis=2)[:, :, None]
    off_warp, off_weft = np.abs(edges @ blank.weft), np.abs(edges @ blank.warp)
    return (np.minimum(off_warp, off_weft) < tolerance).sum(1)


def on_outline(blank):
    """(n_triangles,) whether a corner of the triangle lies on the outline of a specimen."""
    on = np.isclose(np.abs(blank.nodes), [LENGTH / 2, WIDTH / 2], rtol=1e-10).any(1)
    return on[blank.triangles].any(1)


def triangle_set(nodes, triangles):
    """Triangles by the positions of their corners, regardless of numbering."""
    return {frozenset(map(tuple, corners)) for corners in np.round(nodes, 6)[triangles] + 0.0}


@every_blank
def test_triangles_tile_the_rectangle(make, area):
    blank = make()
    assert (signed_areas(blank) > 0).all()
    assert_allclose(blank.areas, signed_areas(blank), rtol=1e-9)
    assert_allclose(blank.areas.sum(), area, rtol=1e-12)
    assert_allclose(blank.node_areas.sum(), area, rtol=1e-12)
    assert (blank.node_areas > 0).all()
    centre = 0.5 * (blank.nodes.min(0) + blank.nodes.max(0))
    assert_allclose(blank.areas @ blank.centroids / area, centre, atol=1e-9)


@every_blank
def test_edges_without_a_neighbour_are_the_outline(make, area):
    """No hanging node: edges of one triangle alone make up the perimeter."""
    blank = make()
    rim = blank.mesh.facets[:, blank.mesh.boundary_facets()]
    length = np.linalg.norm(blank.nodes[rim[1]] - blank.nodes[rim[0]], axis=1).sum()
    assert_allclose(length, 2 * np.ptp(blank.nodes, axis=0).sum(), rtol=1e-12)


@every_blank
def test_fibres_are_unit_vectors_at_a_right_angle(make, area):
    blank = make()
    axes = np.column_stack([blank.warp, blank.weft])
    assert_allclose(axes.T @ axes, np.eye(2), atol=1e-15)
    assert_allclose(np.linalg.det(axes), 1.0)


@pytest.mark.parametrize("name", ["along", "centred", "off centre", "quarter", "specimen 45"])
def test_aligned_triangles_have_both_legs_on_fibres(name):
    make, _ = BLANKS[name]
    assert_array_equal(fibre_legs(make()), 2)


@pytest.mark.parametrize("angle", [30, 60, 37.5])
def test_only_triangles_at_the_outline_of_a_cut_net_miss_a_leg(angle):
    blank = specimen(angle)
    legs = fibre_legs(blank)
    inside = ~on_outline(blank)
    assert inside.sum() > 0.7 * len(legs)
    assert_array_equal(legs[inside], 2)
    assert set(legs[~inside]) == {1, 2}


def cells(blank):
    """(n_triangles,) number of the cell between fibre lines that holds the triangle."""
    number = 0
    for family, across in (("warp", blank.weft), ("weft", blank.warp)):
        first, _ = blank.fibre_lines(family).t
        lines = np.unique(np.round(blank.nodes[first] @ across, 6))
        number = 1000 * number + np.searchsorted(lines, blank.centroids @ across)
    return np.unique(number, return_inverse=True)[1]


@pytest.mark.parametrize("angle", [30, 45, 60, 37.5])
def test_every_cell_cut_by_the_outline_keeps_a_right_corner(angle):
    """A triangle with both legs on fibres, which carries the shear of the cell."""
    blank = specimen(angle)
    cell = cells(blank)
    assert (np.bincount(cell, fibre_legs(blank) == 2) >= 1).all()
    assert np.bincount(cell).max() == (2 if angle == 45 else 3)


@pytest.mark.parametrize("size", [14.0, 9.4, 7.0])
def test_diagonals_alternate_up_to_an_outline_at_45_degrees(size):
    """Four triangles meet in every node of the outline, as diagonals of the net run along it."""
    blank = rectangle(40.0, 40.0, size, orientation=45.0, centre=(70.0, 30.0))
    meeting = np.bincount(blank.triangles.ravel())
    on_edge = np.isclose(np.abs(blank.nodes - [70.0, 30.0]), 20.0)
    assert_array_equal(fibre_legs(blank), 2)
    assert_array_equal(meeting[on_edge.sum(1) == 1], 4)
    assert_array_equal(meeting[on_edge.sum(1) == 2], 2)
    assert set(meeting[~on_edge.any(1)]) == {4, 8}


@pytest.mark.parametrize("angle", [30, 45, 60, 52.25])
def test_a_fibre_line_ends_in_every_grip_corner(angle):
    blank = specimen(angle)
    segments = np.hstack([blank.fibre_lines(family).t for family in ("warp", "weft")])
    for corner in np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * [LENGTH / 2, WIDTH / 2]:
        distance = np.linalg.norm(blank.nodes - corner, axis=1)
        assert distance.min() < 1e-9
        assert (segments == distance.argmin()).sum() == 1


def test_a_line_of_each_family_runs_through_the_points_asked_for():
    blank = rectangle(100.0, 100.0, 9.0, 20.0, through=((0.0, 0.0), (11.0, -7.0)))
    for point in ((0.0, 0.0), (11.0, -7.0)):
        distance = np.linalg.norm(blank.nodes - point, axis=1)
        assert distance.min() < 1e-9
        for family in ("warp", "weft"):
            assert (blank.fibre_lines(family).t == distance.argmin()).sum() == 2


@every_blank
@pytest.mark.parametrize("family", ["warp", "weft"])
def test_fibre_lines_cover_the_blank(make, area, family):
    """The length of the lines, integrated across them, is the area.

    The length is linear between lines through the corners, so the trapezoidal rule is exact.
    """
    blank = make()
    along, across = (blank.warp, blank.weft) if family == "warp" else (blank.weft, blank.warp)
    line = blank.fibre_lines(family)
    first, second = line.t
    step = blank.nodes[second] - blank.nodes[first]
    assert_allclose(step @ across, 0.0, atol=1e-9)
    assert (step @ along > 0).all()
    assert_allclose(line.p[0, second] - line.p[0, first], step @ along)
    offset = np.round(blank.nodes @ across, 6)
    # a line through a corner alone has no length and no segment
    place = np.r_[offset[first], offset.min(), offset.max()]
    offsets, number = np.unique(place, return_inverse=True)
    lengths = np.bincount(number, np.r_[step @ along, 0.0, 0.0])
    assert_allclose(np.trapezoid(lengths, offsets), area, rtol=1e-6)


def test_size_of_the_45_degree_specimen():
    blank = specimen(45)
    assert (len(blank.triangles), len(blank.nodes)) == (2048, 1073)


def test_size_larger_than_the_blank_makes_one_cell():
    blank = rectangle(10.0, 8.0, 30.0)
    assert len(blank.triangles) == 2
    assert blank.size == pytest.approx(np.sqrt(80.0))


def test_absurdly_fine_mesh_is_refused():
    with pytest.raises(InputError, match=r"size 0\.001 mm on 320 x 160 mm makes more than"):
        rectangle(LENGTH, WIDTH, 0.001)


@pytest.mark.parametrize(("orientation", "spacing"), [(0.0, 100 / 14), (45.0, None)])
def test_lines_are_evenly_spaced_by_about_the_size(orientation, spacing):
    blank = rectangle(100.0, 100.0, 7.0, orientation, through=((0.0, 0.0),))
    for family in ("warp", "weft"):
        first, second = blank.fibre_lines(family).t
        lengths = np.linalg.norm(blank.nodes[second] - blank.nodes[first], axis=1)
        assert_allclose(lengths, spacing or lengths[0])
        assert 7.0 / 1.2 < lengths[0] < 7.0 * 1.2


@pytest.mark.parametrize("orientation", [0.0, 90.0, 45.0])
def test_square_has_the_symmetry_of_the_net(orientation):
    """Mirror planes and quarter turns map the alternating diagonals onto themselves."""
    blank = rectangle(100.0, 100.0, 10.0, orientation, through=((0.0, 0.0),))
    tiles = triangle_set(blank.nodes, blank.triangles)
    assert len(tiles) == len(blank.triangles)
    for motion in (np.diag([-1.0, 1.0]), np.diag([1.0, -1.0]), rotation(90.0)):
        assert triangle_set(blank.nodes @ motion.T, blank.triangles) == tiles


@pytest.mark.parametrize("mirror", [("x", "y"), ("x",), ("y",)])
@pytest.mark.parametrize("orientation", [0.0, 90.0])
def test_unfolded_part_is_the_whole_mesh(mirror, orientation):
    part = rectangle(120.0, 80.0, 10.0, orientation, through=((0.0, 0.0),), mirror=mirror)
    whole, source, sign, triangle_source, triangle_sign = part.unfolded()
    direct = rectangle(120.0, 80.0, 10.0, orientation, through=((0.0, 0.0),))
    assert whole.mirror == ()
    assert len(whole.nodes) == len(direct.nodes)
    assert triangle_set(whole.nodes, whole.triangles) == triangle_set(
        direct.nodes, direct.triangles
    )
    assert (signed_areas(whole) > 0).all()
    assert_allclose(whole.areas.sum(), 9600.0)
    assert_allclose(whole.nodes, part.nodes[source] * sign[:, :2], atol=1e-12)
    assert_allclose(whole.areas, part.areas[triangle_source])

    # the shear angle of a mirrored motion, with its sign
    X, Y = part.nodes.T
    bulge = np.column_stack([np.sin(X / 20) * np.cos(Y / 20), X**2 * Y / 5e3, np.cos(X / 30)])
    x = np.column_stack([part.nodes, np.zeros(len(X))]) + bulge
    gamma = Membrane(Unknowns().sheet(part, Fabric(), dim=3)).shear_angle(x.ravel())
    membrane = Membrane(Unknowns().sheet(whole, Fabric(), dim=3))
    gamma_whole = membrane.shear_angle((x[source] * sign).ravel())
    assert np.abs(gamma).max() > 0.1
    assert_allclose(gamma_whole, gamma[triangle_source] * triangle_sign, atol=1e-12)


def test_unfolding_the_whole_changes_nothing():
    blank = rectangle(120.0, 80.0, 10.0)
    whole, source, sign, _, triangle_sign = blank.unfolded()
    assert_array_equal(whole.nodes, blank.nodes)
    assert_array_equal(source, np.arange(len(blank.nodes)))
    assert (sign == 1).all()
    assert (triangle_sign == 1).all()


@pytest.mark.parametrize("angle", [90.0, 33.0])
def test_turned_blank_takes_its_fibres_along(angle):
    blank = rectangle(60.0, 40.0, 10.0)
    before = blank.nodes.copy()
    turned = blank.turned(angle)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    assert_allclose(turned.nodes[:, 0], c * before[:, 0] - s * before[:, 1], atol=1e-12)
    assert_allclose(turned.nodes[:, 1], s * before[:, 0] + c * before[:, 1], atol=1e-12)
    assert_allclose(turned.warp, [c, s], atol=1e-15)
    assert_allclose(turned.weft, [-s, c], atol=1e-15)
    assert_array_equal(fibre_legs(turned), 2)
    assert_allclose(turned.areas, blank.areas)
    assert_array_equal(blank.nodes, before)


def test_rotation_is_exact_at_quarter_turns():
    assert_array_equal(rotation(90.0), [[0, -1], [1, 0]])
    assert_array_equal(rotation(-180.0), [[-1, 0], [0, -1]])
    assert_allclose(rotation(30.0), [[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]])


@pytest.mark.parametrize("size", [10.0, 20.0])
def test_no_cut_leaves_a_degenerate_triangle(size):
    """The outline may give way by a thousandth of the spacing where it just misses a node."""
    slack = 1e-3 * size / np.sqrt(2.0)
    for angle in [*range(27, 64), 44.5, 44.9, 44.95, 44.99, 45.001, 45.1]:
        blank = specimen(angle, size)
        edges = blank.nodes[np.roll(blank.triangles, -1, axis=1)] - blank.nodes[blank.triangles]
        altitude = 2 * signed_areas(blank) / np.linalg.norm(edges, axis=2).max(1)
        assert altitude.min() > 1e-4 * size, f"{angle} degrees"
        missing = LENGTH * WIDTH - blank.areas.sum()
        assert abs(missing) < 2 * (LENGTH + WIDTH) * slack, f"{angle} degrees"
        assert fibre_legs(blank, tolerance=1e-3).min() >= 1, f"{angle} degrees"


# Blanks of any outline


def plate(rng):
    """A rectangle with three round holes."""
    holes = [
        outlines.disc(rng.uniform(6, 13), rng.uniform(-3, 3, 2) + place)
        for place in ((-30, -10), (25, 12), (42, -28))
    ]
    return outlines.with_holes(outlines.rectangle(140.0, 100.0), holes)


def flower(rng):
    angle = np.radians(np.arange(0.0, 360.0, 0.5))
    r = 60.0 * (
        1 + rng.uniform(0.05, 0.35) * np.cos(rng.integers(2, 7) * angle + rng.uniform(0, 6))
    )
    return outlines.polygon(r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def star(rng):
    angle = 2 * np.pi * (np.arange(9) + rng.uniform(-0.2, 0.2, 9)) / 9
    r = rng.uniform(40, 90, 9)
    return outlines.polygon(r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def ell(rng):
    return outlines.polygon([(0, 0), (100, 0), (100, 40), (45, 40), (45, 90), (0, 90)])


def pocket(rng):
    """A rectangle with a bay, all corners round."""
    bay = shapely.box(-70, -50, 70, 50).difference(shapely.box(-20, 0, 15, 60))
    return bay.buffer(-8.0).buffer(16.0).buffer(-8.0)


OUTLINES = {
    "disc": lambda rng: outlines.disc(rng.uniform(30, 80), rng.uniform(-5, 5, 2)),
    "rectangle": lambda rng: outlines.rectangle(160.0, 80.0),
    "plate": plate,
    "flower": flower,
    "star": star,
    "ell": ell,
    "pocket": pocket,
}
ANGLES = [0.0, 45.0, 90.0, 30.0, 44.9, 44.99, 0.01, -17.3, 61.2]


def shape_of(blank):
    """The boundary of a blank as a polygon with holes."""
    outer, *holes = (blank.nodes[loop] for loop in blank.outline)
    return shapely.Polygon(outer, holes)


def smallest_angle(blank):
    corners = blank.nodes[blank.triangles]
    u, v = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (u * v).sum(-1) / np.linalg.norm(u, axis=-1) / np.linalg.norm(v, axis=-1)
    return np.degrees(np.arccos(cosine.max()))


def check_mesh(blank, outline, size):
    """Tiling, connection, no slivers, an outline off by a tenth at most, legs on fibres."""
    assert (signed_areas(blank) > 0).all()
    assert_array_equal(np.unique(blank.triangles), np.arange(len(blank.nodes)))
    shape = shape_of(blank)
    # the outline of connected triangles that neither overlap nor leave gaps
    assert shape.is_valid
    assert shape.area == pytest.approx(blank.areas.sum(), rel=1e-10)
    edges = len(blank.mesh.facets.T)
    assert len(blank.nodes) - edges + len(blank.triangles) == 1 - len(outline.interiors)
    assert len(shape.interiors) == len(outline.interiors)
    assert shapely.hausdorff_distance(shape.boundary, outline.boundary) < 0.1 * size
    assert abs(shape.area - outline.area) < 0.05 * size * outline.length
    assert smallest_angle(blank) > 2.5
    assert blank.node_areas.min() > 8e-4 * size**2
    rim = np.zeros(len(blank.nodes), dtype=bool)
    rim[np.concatenate(blank.outline)] = True
    assert_array_equal(fibre_legs(blank, 1e-10)[~rim[blank.triangles].any(1)], 2)


@pytest.mark.parametrize("name", OUTLINES)
def test_cut_blanks_are_sound(name):
    rng = np.random.default_rng(list(OUTLINES).index(name))
    for angle in ANGLES:
        for size in (10.0, 6.3, 4.1):
            outline = OUTLINES[name](rng)
            check_mesh(cut(outline, size, angle), outline, size)


@pytest.mark.parametrize("angle", [30.0, 37.5, 20.0, 52.25, -11.0])
def test_cells_cut_by_a_fitted_outline_keep_a_right_corner(angle):
    blank = cut(outlines.rectangle(160.0, 80.0), 5.0, angle)
    assert (np.bincount(cells(blank), fibre_legs(blank) == 2) >= 1).all()


@pytest.mark.parametrize("orientation", [0.0, 45.0, 90.0, -45.0])
def test_a_cut_rectangle_is_the_rectangle(orientation):
    through = ((0.0, 0.0),)
    for mirror in ((), ("x", "y")) if orientation % 90 == 0 else ((),):
        size = 50.0 / 7.0  # fits; `rectangle` spaces its lines evenly at any size
        direct = rectangle(100.0, 100.0, size, orientation, through=through, mirror=mirror)
        blank = cut(outlines.rectangle(100.0, 100.0), size, orientation, through, mirror)
        assert triangle_set(blank.nodes, blank.triangles) == triangle_set(
            direct.nodes, direct.triangles
        )


def test_lines_run_through_corners_extremes_and_points_asked_for():
    shape = outlines.with_holes(
        ell(None), [outlines.disc(9.0, (25.0, 21.0)), outlines.disc(6.0, (71.0, 17.0))]
    )
    blank = cut(shape, 5.0, through=((31.0, 63.0),))
    points = [(31, 63), *ell(None).exterior.coords, (34, 21), (25, 30), (65, 17), (71, 11)]
    for point in points:
        assert np.linalg.norm(blank.nodes - point, axis=1).min() < 1e-9
    disc = cut(outlines.disc(50.0), 6.0, orientation=30.0)
    for angle in (30, 120, 210, 300):
        at = 50.0 * rotation(angle)[:, 0]
        assert np.linalg.norm(disc.nodes - at, axis=1).min() < 1e-9


@pytest.mark.parametrize("mirror", [(), ("x", "y")])
def test_lines_stay_where_they_are_when_the_outline_changes(mirror):
    """They belong to the cloth: only the last cell follows the edge."""
    inner = []
    for side in (310.0, 309.5, 309.0, 304.0):
        outline = outlines.rectangle(side, side)
        blank = cut(outline, 10.0, through=((0.0, 0.0),), mirror=mirror)
        check_mesh(blank.unfolded()[0], outline, 10.0)
        assert_array_equal(fibre_legs(blank), 2)
        found = np.unique(blank.nodes.round(9))
        assert found[-1] == 0.5 * side
        inner.append(found[np.abs(found) < 141])
    assert_allclose(inner, [10.0 * np.arange(0 if mirror else -14, 15)] * 4)


def test_lines_of_near_corners_are_shared():
    """Steps of a twentieth and a third of the spacing make no strips of narrow cells."""
    steps = [(0, 0), (60, 0), (60, 40), (30, 40), (30, 39.5), (26.7, 39.5), (26.7, 36.2), (0, 36.2)]
    outline = outlines.polygon(steps)
    blank = cut(outline, 10.0)
    for family in ("warp", "weft"):
        line = blank.fibre_lines(family)
        across = blank.nodes[line.t[0]] @ (blank.weft if family == "warp" else blank.warp)
        inner = np.unique(across.round(6))
        assert np.diff(inner).min() > 3.0
    check_mesh(blank, outline, 10.0)


@pytest.mark.parametrize("size", [10.0, 7.0, 5.0])
@pytest.mark.parametrize("mirror", [("x", "y"), ("x",), ("y",), ()])
def test_a_square_turned_by_45_degrees_is_made_of_diagonals(size, mirror):
    """The quarter is a triangle whose long side runs along the diagonals of the cells."""
    diamond = shapely.affinity.rotate(outlines.rectangle(310.0, 310.0), 45.0)
    blank = cut(diamond, size, through=((0.0, 0.0),), mirror=mirror)
    assert_array_equal(fibre_legs(blank), 2)
    assert smallest_angle(blank) == pytest.approx(45.0)
    whole = blank.unfolded()[0]
    assert_allclose(whole.areas.sum(), 310.0**2)
    assert shape_of(whole).symmetric_difference(diamond).area < 1e-6
    # alternating up to the outline: four or eight triangles inside, four or one on it
    meeting = np.bincount(whole.triangles.ravel())
    rim = np.isin(np.arange(len(whole.nodes)), whole.outline[0])
    assert set(meeting[~rim]) == {4, 8}
    assert set(meeting[rim]) <= {1, 2, 4}


SYMMETRIC = {
    "disc": outlines.disc(50.0),
    "plate": outlines.with_holes(
        outlines.rectangle(140.0, 100.0),
        [outlines.disc(8.0, (x, y)) for x in (-40, 40) for y in (-22, 22)]
        + [outlines.disc(11.0), outlines.disc(6.0, (0.0, 31.0)), outlines.disc(6.0, (0.0, -31.0))],
    ),
    "cross": shapely.box(-60, -21, 60, 21).union(shapely.box(-17, -50, 17, 50)),
}


@pytest.mark.parametrize("name", SYMMETRIC)
@pytest.mark.parametrize("mirror", [("x", "y"), ("x",), ("y",)])
def test_a_mirrored_part_unfolds_to_the_whole(name, mirror):
    outline = SYMMETRIC[name]
    for orientation, size in ((0.0, 6.0), (90.0, 9.0), (180.0, 4.3)):
        part = cut(outline, size, orientation, mirror=mirror)
        for plane in mirror:
            x = part.nodes[:, "xy".index(plane)]
            assert ((x == 0) | (x > 0.01 * size)).all()
        whole, source, sign, *_ = part.unfolded()
        assert_allclose(whole.nodes, part.nodes[source] * sign[:, :2], atol=1e-12)
        check_mesh(whole, outline, size)


def test_unfolding_mirrors_pairs_too():
    part = rectangle(40.0, 40.0, 10.0, mirror=("x", "y"))
    pairs = np.arange(len(part.triangles)).reshape(-1, 2)
    part = Blank(part.nodes, part.triangles, part.warp, part.weft, part.mirror, pairs)
    whole, *_, triangle_source, _ = part.unfolded()
    assert_array_equal(np.sort(whole.pairs.ravel()), np.arange(len(whole.triangles)))
    assert_array_equal(triangle_source[whole.pairs], np.tile(pairs, (4, 1)))


def test_outline_of_a_plate_with_holes():
    shape = outlines.with_holes(outlines.rectangle(60.0, 40.0), [outlines.rectangle(20.0, 10.0)])
    blank = cut(shape, 5.0)
    outer, hole = blank.outline
    for loop in (outer, hole):
        assert loop[0] == loop[-1]
        assert len(np.unique(loop)) == len(loop) - 1
    assert shapely.LinearRing(blank.nodes[outer]).is_ccw
    assert not shapely.LinearRing(blank.nodes[hole]).is_ccw
    assert shapely.Polygon(blank.nodes[outer]).equals(outlines.rectangle(60.0, 40.0))
    assert shapely.Polygon(blank.nodes[hole]).equals(outlines.rectangle(20.0, 10.0))
    part = cut(shape, 5.0, mirror=("x", "y"))
    assert len(part.outline) == 1
    assert shape_of(part).equals(shapely.box(0, 0, 30, 20).difference(shapely.box(0, 0, 10, 5)))
    assert shape_of(part.unfolded()[0]).equals(shape)


def test_a_fan_keeps_its_first_right_corner_whole():
    ring = np.array([(1.0, 2.0), (0.0, 2.0), (0.0, 0.0), (2.0, 0.0), (2.0, 1.0)])
    for shift in range(5):
        triangles = _fan(np.roll(np.arange(5), shift), np.roll(ring, shift, axis=0))
        assert {0, 1, 2} in [set(triangle) for triangle in triangles.tolist()]


def test_parts_too_small_for_the_size_are_left_out():
    box = outlines.rectangle(60.0, 40.0)
    pinhole = outlines.with_holes(box, [outlines.disc(0.2, (3.3, 7.1))])
    assert len(cut(pinhole, 5.0, 20.0).outline) == 1
    thorn = box.union(shapely.Polygon([(-10, 20), (10, 20), (0, 20.2)]))
    assert len(cut(thorn, 5.0).triangles) == len(cut(box, 5.0, through=((0, 0),)).triangles)


@pytest.mark.parametrize(("tip", "angle"), [(22.5, 0.0), (1.5, 0.0), (20.0, 15.0)])
def test_slits(tip, angle):
    """A slit along a line that is too narrow closes; a wider one crosses every leg twice."""
    box = outlines.rectangle(60.0, 40.0, centre=(30.0, 20.0))
    narrow = box.difference(shapely.box(tip, 19.9, 61, 20.1))
    if angle == 0:
        closed = cut(narrow, 5.0, through=((21.0, 20.0),))
        assert_array_equal(fibre_legs(closed), 2)
        check_mesh(closed, box, 5.0)
    wide = box.difference(shapely.box(tip, 19.4, 61, 20.6))
    check_mesh(cut(wide, 5.0, angle, through=((21.0, 7.0),)), wide, 5.0)


def test_a_mirror_plane_is_a_line_whatever_else_is_asked_for():
    part = cut(BOX, 5.0, through=((0.2, 0.3),), mirror=("x", "y"))
    check_mesh(part.unfolded()[0], BOX, 5.0)


BOX = outlines.rectangle(60.0, 40.0)
REFUSED = {
    "two parts": (lambda: cut(shapely.MultiPolygon([BOX]), 5.0), "got a MultiPolygon"),
    "crossing": (
        lambda: cut(shapely.Polygon([(0, 0), (9, 9), (9, 0), (0, 9)]), 5.0),
        "must be one valid polygon",
    ),
    "no number": (lambda: cut(BOX, 5.0, float("nan")), "orientation must be a number of degrees"),
    "size": (lambda: cut(BOX, 0.0), "size must be a positive number"),
    "too fine": (lambda: cut(BOX, 0.02), r"size 0.02 mm on 60 x 40 mm makes more than"),
    "mirror and angle": (lambda: cut(BOX, 5.0, 30.0, mirror=("x",)), "fibres along x and y"),
    "not symmetric": (lambda: cut(ell(None), 5.0, mirror=("y",)), "not symmetric to y = 0: leave"),
    "neck": (
        lambda: cut(
            shapely.union_all(
                [
                    shapely.box(-30, -20, -5, 20),
                    shapely.box(5, -20, 30, 20),
                    shapely.box(-6, -0.1, 6, 0.1),
                ]
            ),
            5.0,
            through=((0, 0),),
        ),
        r"size 5 mm is too large for the outline near",
    ),
    "hole at the edge": (
        lambda: cut(BOX.difference(outlines.disc(9.0, (0.0, -10.9))), 5.0),
        r"size 5 mm is too large for the outline near \(0, -20\)",
    ),
    "slit": (
        lambda: cut(BOX.difference(shapely.box(-20, 3, 20, 3.2)), 5.0),
        "hole 1, 40 mm long, is too narrow",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_cut_is_refused(case):
    make, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize("orientation", [0.01, 44.99, 44.9])
def test_corners_that_just_miss_a_line_share_it(orientation):
    """No strip of cells a hundredth of the spacing wide beside the middle of a square."""
    blank = rectangle(100.0, 100.0, 10.0, orientation, through=((0.0, 0.0),))
    assert smallest_angle(blank) > 35.0
    assert_allclose(blank.areas.sum(), 1e4, rtol=1e-3)
    assert_array_equal(fibre_legs(blank), 2)


def test_the_sharpest_corners_come_first():
    ring = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [10.0, 40.0]])
    turns = {(0.0, 0.0): 104.0, (60.0, 0.0): 90.0, (60.0, 40.0): 90.0, (10.0, 40.0): 76.0}
    found = [tuple(corner) for corner in _corners(ring, 5.0).tolist()]
    assert set(found) == set(turns)
    assert [turns[corner] for corner in found] == [104.0, 90.0, 90.0, 76.0]
