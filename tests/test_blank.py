"""The mesh of the flat sheet: legs on fibres, lines through the corners, symmetries, tiling."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quasiform.blank import rectangle, rotation
from quasiform.checks import InputError
from quasiform.energy.membrane import Membrane
from quasiform.material import Fabric

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
    gamma = Membrane(part, Fabric(), dim=3).shear_angle(x.ravel())
    gamma_whole = Membrane(whole, Fabric(), dim=3).shear_angle((x[source] * sign).ravel())
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
