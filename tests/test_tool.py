"""Rigid shapes: true distances with their own derivatives, right at known points, C¹ at joins."""

from itertools import combinations

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from quasiform.checks import InputError
from quasiform.scenes import scene_file
from quasiform.tools.shapes import (
    FAR,
    Opening,
    Placed,
    Plane,
    Rounded,
    Tool,
    ball,
    bar,
    box_punch,
    flipped,
    opening,
    regular_polygon,
    round_opening,
    round_punch,
    tetrahedron_punch,
    turned,
)


def rectangle(length, width):
    return 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])


TURN = Rotation.from_rotvec([0.4, -0.7, 1.0]).as_matrix()
BOX = box_punch(60.0, 50.0, 6.0)
TETRAHEDRON = tetrahedron_punch(90.0, 70.0, 8.0, 20.0)
BOX_OPENING = opening(rectangle(90.0, 80.0), 20.0, 7.0)
TRIANGLE_OPENING = opening(regular_polygon(3, 150.0, 20.0), 20.0, 7.0)
NAMED = {
    "plane": Plane(),
    "ball": ball(30.0),
    "bar": bar(20.0),
    "round punch": round_punch(25.0),
    "round opening": round_opening(30.0, 8.0),
    "flipped round opening": flipped(round_opening(30.0, 8.0)),
    "flipped round punch": flipped(round_punch(25.0)),
    "box punch": BOX,
    "tetrahedron punch": TETRAHEDRON,
    "box opening": BOX_OPENING,
    "triangle opening": TRIANGLE_OPENING,
    "flipped triangle opening": flipped(TRIANGLE_OPENING),
    "turned box punch": turned(BOX, 30.0),
    "placed tetrahedron": Placed(TETRAHEDRON, TURN, (5.0, -3.0, 2.0)),
}
SHAPES = list(NAMED.values())
every_shape = pytest.mark.parametrize("shape", SHAPES, ids=NAMED)
# every solid grown from a core, and corners that make its core, found on paper
ROUNDED = {
    "box": (BOX, [[x, y, z] for x in (-24, 24) for y in (-19, 19) for z in (6.0, FAR)], 6.0),
    "tetrahedron": (TETRAHEDRON, None, 8.0),
    "long tetrahedron": (tetrahedron_punch(60.0, 120.0, 5.0, -70.0), None, 5.0),
    "flat tetrahedron": (tetrahedron_punch(200.0, 30.0, 4.0), None, 4.0),
    "section of the box opening": (
        BOX_OPENING.hole,
        [[x, y, z] for x in (-25, 25) for y in (-20, 20) for z in (-FAR, FAR)],
        20.0,
    ),
    "section of the triangle opening": (
        TRIANGLE_OPENING.hole,
        [
            [*xy, z]
            for xy in regular_polygon(3, 150.0 - 2 * np.sqrt(3.0) * 20.0, 20.0)
            for z in (-FAR, FAR)
        ],
        20.0,
    ),
}
every_rounded = pytest.mark.parametrize("name", ROUNDED)
H_STEP = 1e-5


def points_near(shape, count=400):
    """Random points between 5 mm inside and 15 mm outside the tool, away from the z axis."""
    points = np.random.default_rng(1).uniform(-60.0, 60.0, (20 * count, 3))
    d, _, _ = shape.distance(points)
    near = (d > -5.0) & (d < 15.0) & (np.linalg.norm(points[:, :2], axis=1) > 1.0)
    assert near.sum() >= count
    return points[near][:count]


def differences(function, points):
    """Derivative of `function` by the coordinates, appended as last axis."""
    steps = H_STEP * np.eye(3)
    return np.stack([function(points + s) - function(points - s) for s in steps], -1) / (2 * H_STEP)


@every_shape
def test_normal_is_the_gradient_of_the_distance(shape):
    points = points_near(shape)
    _, n, _ = shape.distance(points)
    assert_allclose(differences(lambda x: shape.distance(x)[0], points), n, atol=1e-8)
    assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-12)


@every_shape
def test_curvature_is_the_gradient_of_the_normal(shape):
    points = points_near(shape)
    _, n, H = shape.distance(points)
    slope = differences(lambda x: shape.distance(x)[1], points)
    jumps = np.abs(slope - H).max((1, 2)) > 1e-7  # differences taken across a join
    assert jumps.mean() < 0.01
    assert_allclose(H, H.transpose(0, 2, 1), atol=1e-15)
    assert_allclose(np.einsum("pij,pj->pi", H, n), 0.0, atol=1e-14)
    assert (np.abs(H).max() > 0.01) == (not isinstance(shape, Plane))


@every_shape
def test_a_step_along_the_normal_changes_the_distance_by_its_length(shape):
    points = points_near(shape)
    d, n, _ = shape.distance(points)
    further, n_further, _ = shape.distance(points + 3.0 * n)
    assert_allclose(further, d + 3.0, atol=1e-12)
    assert_allclose(n_further, n, atol=1e-12)


@every_shape
def test_asking_for_the_distance_leaves_the_points_alone(shape):
    points = points_near(shape)
    before = points.copy()
    first, second = shape.distance(points), shape.distance(points)
    assert (points == before).all()
    for a, b in zip(first, second, strict=True):
        assert (a == b).all()
        assert not np.shares_memory(a, points)


R, r = 30.0, 8.0  # opening and its fillet
BISECTOR = np.sqrt(0.5)
CORNER = (-0.6 * BISECTOR, -0.8 * BISECTOR, BISECTOR)
# the triangle has a corner at 20 degrees; its core's is 20 mm from two sides
TO_CORNER, AWAY = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
SIXTY = 150 / 3**0.5 - 2 * 20 + 20 - 60
# the tip of the core of the tetrahedron is at z = 8; its faces are 8 mm inside those of the outer
# one: they rise by sin a to cos a, tan a = height over the inradius of the base
TOP = 70.0 + 8.0 - 8.0 / np.cos(np.arctan2(70.0, 90.0 / 12**0.5))


@pytest.mark.parametrize(
    ("shape", "point", "distance", "normal"),
    [
        (Plane(), (3, 4, -2), -2, (0, 0, 1)),
        (ball(30.0), (0, 0, -33), 3, (0, 0, -1)),
        (ball(30.0), (18, 0, 24), 0, (0.6, 0, 0.8)),
        (bar(20.0), (0, 70, 15), -5, (0, 0, 1)),
        (bar(20.0), (-30, -7, 40), 30, (-0.6, 0, 0.8)),
        (round_punch(25.0), (0, 0, 0), 0, (0, 0, -1)),
        (round_punch(25.0), (0, 0, -4), 4, (0, 0, -1)),
        (round_punch(25.0), (0, 28, 25), 3, (0, 1, 0)),
        (round_punch(25.0), (-18, 24, 300), 5, (-0.6, 0.8, 0)),
        (round_opening(R, r), (50, 0, 2), 2, (0, 0, 1)),
        (round_opening(R, r), (50, 0, -20), -20, (0, 0, 1)),
        (round_opening(R, r), (0, R, -100), 0, (0, -1, 0)),
        (round_opening(R, r), (R - 10, 0, -100), 10, (-1, 0, 0)),
        (round_opening(R, r), (R + 3, 0, -100), -3, (-1, 0, 0)),
        (round_opening(R, r), (R, R, -20), R * (1 - np.sqrt(2)), (-BISECTOR, -BISECTOR, 0)),
        (round_opening(R, r), (R, R, -9), -9, (0, 0, 1)),  # the face is nearer than the wall
        (
            round_opening(R, r),
            (R + r * (1 - BISECTOR), 0, -r * (1 - BISECTOR)),
            0,
            (-BISECTOR, 0, BISECTOR),
        ),
        (round_opening(R, r), (R, 0, 0), r * (np.sqrt(2) - 1), (-BISECTOR, 0, BISECTOR)),
        (flipped(round_opening(R, r)), (50, 0, -2), 2, (0, 0, -1)),
        (flipped(round_opening(R, r)), (R, 0, 0), r * (np.sqrt(2) - 1), (-BISECTOR, 0, -BISECTOR)),
        (flipped(round_punch(25.0)), (0, 0, 4), 4, (0, 0, 1)),
        (BOX, (0, 0, 0), 0, (0, 0, -1)),  # lower face
        (BOX, (-24, 19, -5), 5, (0, 0, -1)),  # its outermost point
        (BOX, (33, -10, 70), 3, (1, 0, 0)),  # sides
        (BOX, (3, -27, 200), 2, (0, -1, 0)),
        (BOX, (24 + 6, 4, 6 - 8), 4, (0.6, 0, -0.8)),  # lower edge
        (BOX, (24 + 3, -19 - 4, 50), -1, (0.6, -0.8, 0)),  # upright edge
        (BOX, (24 + 4, -19 - 4, 6 - 2), 0, (2 / 3, -2 / 3, -1 / 3)),  # corner
        (BOX, (-24 - 8, 19 + 8, 6 - 4), 6, (-2 / 3, 2 / 3, -1 / 3)),
        (BOX, (20, 3, 90), -10, (1, 0, 0)),  # inside
        (BOX, (0, 0, 9), -9, (0, 0, -1)),
        (turned(BOX, 90.0), (10, 33, 70), 3, (0, 1, 0)),
        (Placed(BOX, np.eye(3), (10.0, 0.0, -5.0)), (43, -10, 65), 3, (1, 0, 0)),
        (Placed(BOX, np.diag([1.0, 1.0, -1.0]), (0.0, 0.0, 2.0)), (0, 0, 5), 3, (0, 0, 1)),
        (TETRAHEDRON, (0, 0, 0), 0, (0, 0, -1)),  # tip
        (TETRAHEDRON, (0, 0, -7), 7, (0, 0, -1)),
        (TETRAHEDRON, (3, 4, 8 - 12), 5, (3 / 13, 4 / 13, -12 / 13)),
        (TETRAHEDRON, (0, 0, TOP + 3), 3, (0, 0, 1)),  # base
        (TETRAHEDRON, (0, 0, TOP - 9), -9, (0, 0, 1)),
        (BOX_OPENING, (70, 10, 2), 2, (0, 0, 1)),
        (BOX_OPENING, (52, -10, 0), 0, (0, 0, 1)),  # end of the fillet
        (BOX_OPENING, (40, 5, -60), 5, (-1, 0, 0)),  # wall
        (BOX_OPENING, (-11, -43, -60), -3, (0, 1, 0)),
        (BOX_OPENING, (45, 0, 0), 7 * (np.sqrt(2) - 1), (-BISECTOR, 0, BISECTOR)),  # fillet
        (BOX_OPENING, (25 + 9, 20 + 12, -60), 5, (-0.6, -0.8, 0)),  # rounded corner
        (BOX_OPENING, (25 + 12, 20 + 16, 0), 7 * (np.sqrt(2) - 1), CORNER),
        (flipped(BOX_OPENING), (70, 10, -2), 2, (0, 0, -1)),
        (TRIANGLE_OPENING, (90, 60, 2), 2, (0, 0, 1)),
        (
            TRIANGLE_OPENING,
            (-35 * TO_CORNER, -35 * AWAY, -60),
            75 / 3**0.5 - 35,
            (TO_CORNER, AWAY, 0),
        ),
        (TRIANGLE_OPENING, (60 * TO_CORNER, 60 * AWAY, -60), SIXTY, (-TO_CORNER, -AWAY, 0)),
    ],
)
def test_distance_at_known_points(shape, point, distance, normal):
    d, n, _ = shape.distance(np.array([point], dtype=float))
    assert_allclose(d, [distance], atol=1e-12)
    assert_allclose(n, [normal], atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "point", "curvatures"),
    [
        (ball(30.0), (0, 40, 0), (0, 1 / 40, 1 / 40)),
        (bar(20.0), (0, 5, 25), (0, 0, 1 / 25)),
        (round_punch(25.0), (0, 0, -5), (0, 1 / 30, 1 / 30)),
        (round_punch(25.0), (30, 0, 80), (0, 0, 1 / 30)),
        (round_opening(R, r), (R - 5, 0, -50), (-1 / (R - 5), 0, 0)),
        (round_opening(R, r), (R, 0, 0), (-BISECTOR / R, 0, 1 / (np.sqrt(2) * r))),
        (BOX, (5, 5, -2), (0, 0, 0)),
        (BOX, (24 + 6, 4, 6 - 8), (0, 0, 1 / 10)),
        (BOX, (24 + 4, -19 - 4, 6 - 2), (0, 1 / 6, 1 / 6)),
        (BOX, (0, 0, 9), (0, 0, 0)),
        (TETRAHEDRON, (0, 0, -7), (0, 1 / 15, 1 / 15)),
        (turned(TETRAHEDRON, 77.0), (0, 0, -7), (0, 1 / 15, 1 / 15)),
        (BOX_OPENING, (40, 5, -60), (0, 0, 0)),
        (BOX_OPENING, (45, 0, 0), (0, 0, 1 / (np.sqrt(2) * 7))),
        (BOX_OPENING, (25 + 9, 20 + 12, -60), (-1 / 15, 0, 0)),
        (BOX_OPENING, (25 + 12, 20 + 16, 0), (-BISECTOR / 20, 0, 1 / (np.sqrt(2) * 7))),
    ],
)
def test_principal_curvatures_at_known_points(shape, point, curvatures):
    _, _, H = shape.distance(np.array([point], dtype=float))
    assert_allclose(np.linalg.eigvalsh(H[0]), curvatures, atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "point", "across"),
    [
        (round_opening(R, r), (R + r, 0, 0), (1, 0, 0)),  # fillet and face
        (round_opening(R, r), (R + r, 0, 9), (1, 0, 0)),
        (round_opening(R, r), (R, 0, -r), (0, 0, 1)),  # fillet and wall
        (round_opening(R, r), (R - 6, 0, -r), (0, 0, 1)),
        (round_punch(25.0), (25, 0, 25), (0, 0, 1)),  # hemisphere and shaft
        (round_punch(25.0), (0, -40, 25), (0, 0, 1)),
        (BOX, (24, 4, 0), (1, 0, 0)),  # lower face and edge
        (BOX, (24, 4, -5), (1, 0, 0)),
        (BOX, (30, 4, 6), (0, 0, 1)),  # lower edge and side
        (BOX, (30, 19, 40), (0, 1, 0)),  # side and upright edge
        (BOX, (24 + 3.6, 19, 6 - 4.8), (0, 1, 0)),  # lower edge and corner
        (BOX, (24 + 3.6, 19 + 4.8, 6), (0, 0, 1)),  # corner and upright edge
        (BOX_OPENING, (45, 20, -60), (0, 1, 0)),  # wall and rounded corner
        (BOX_OPENING, (45, 20, 0), (0, 1, 0)),  # and on the fillet
        (BOX_OPENING, (52, 5, 0), (1, 0, 0)),  # fillet and face
        (BOX_OPENING, (45, 5, -7), (0, 0, 1)),  # fillet and wall
    ],
)
def test_distance_and_normal_are_continuous_across_joins(shape, point, across):
    gap = 1e-7 * np.array(across)
    d, n, H = shape.distance(np.array([point - gap, point + gap]))
    assert_allclose(d[0], d[1], atol=3e-7)
    assert_allclose(n[0], n[1], atol=1e-7)
    assert np.abs(H[0] - H[1]).max() > 0.01  # it is a join: the curvature jumps


@every_shape
def test_normal_turns_no_faster_than_the_sharpest_radius_allows(shape):
    """C¹ everywhere near the tool: no jump of n on lines drawn across all joins."""
    rng = np.random.default_rng(3)
    ends = rng.uniform(-70.0, 70.0, (60, 2, 3))
    s = np.linspace(0.0, 1.0, 4001)[:, None]
    for start, end in ends:
        d, n, _ = shape.distance(start + s * (end - start))
        step = np.linalg.norm(end - start) / 4000
        near = (d[1:] > -4.0) & (d[1:] < 15.0)
        turn = np.linalg.norm(np.diff(n, axis=0), axis=1)[near]
        assert (np.abs(np.diff(d)) <= step * (1 + 1e-9))[near].all()
        if turn.size:
            assert turn.max() <= 1.01 * step / (shape.sharpest - 4.0)


# Against other ways to find the distance


def nearest_in_hull(corners, points):
    """(m,) distance of points to the convex hull of corners: the best foot on any simplex."""
    best = np.linalg.norm(points[:, None] - corners, axis=2).min(1)
    for count in (2, 3):
        for chosen in combinations(corners, count):
            base = np.array(chosen[0])
            A = (np.array(chosen[1:]) - base).T
            if np.linalg.matrix_rank(A) < count - 1:
                continue
            shares = np.linalg.lstsq(A, (points - base).T, rcond=None)[0]
            on = (shares > -1e-9).all(0) & (shares.sum(0) < 1 + 1e-9)
            off = np.linalg.norm(points - base - (A @ shares).T, axis=1)
            best = np.where(on, np.minimum(best, off), best)
    return best


@every_rounded
def test_core_is_the_one_found_on_paper(name):
    shape, core, radius = ROUNDED[name]
    assert shape.radius == radius
    if core is not None:
        assert len(shape.core) == len(core)
        off = np.abs(shape.core[:, None] - np.array(core)).max(2).min(1)
        assert off.max() < 1e-9


@pytest.mark.parametrize(
    ("edge", "height", "radius"), [(90.0, 70.0, 8.0), (60.0, 120.0, 5.0), (200.0, 30.0, 4.0)]
)
def test_tetrahedron_is_the_sharp_one_rounded(edge, height, radius):
    """Its faces are those of the sharp one, its tip is round and at z = 0."""
    shape = tetrahedron_punch(edge, height, radius, 20.0)
    base = np.column_stack([regular_polygon(3, edge, 20.0), np.full(3, height)])
    assert_allclose(np.linalg.norm(base[0] - base[1]), edge)
    corners = np.vstack([base, np.zeros(3)])
    assert_allclose(np.arctan2(base[0, 1], base[0, 0]), np.radians(20.0))
    planes = np.array(sorted(ConvexHull(corners).equations.tolist()))
    core = ConvexHull(shape.core)
    faces = np.array(sorted(core.equations.tolist()))
    assert_allclose(faces[:, :3], planes[:, :3], atol=1e-9)
    lift = shape.core[:, 2].min() - radius
    assert abs(lift) < 1e-9
    moved = faces[:, 3] - radius - planes[:, 3]  # what is left is the shift along z
    assert_allclose(moved / planes[:, 2], moved[0] / planes[0, 2], rtol=1e-9)
    assert_allclose(shape.distance(np.array([[0.0, 0.0, -3.0]]))[0], 3.0)


@every_rounded
def test_rounded_solids_against_the_best_foot_on_any_simplex(name):
    shape, core, radius = ROUNDED[name]
    core = shape.core if core is None else np.array(core)
    rng = np.random.default_rng(4)
    middle = np.clip(core.mean(0), -100.0, 100.0)
    points = middle + rng.uniform(-90.0, 90.0, (2500, 3))
    hull = ConvexHull(core)
    height = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
    true = np.where(height <= 0, height, nearest_in_hull(core, points)) - radius
    d, n, _ = shape.distance(points)
    assert (height > 0).sum() > 200
    assert (height < 0).sum() > 5
    assert_allclose(d, true, atol=1e-8)
    # n leads to the surface
    outside = height > 1e-6
    foot = points[outside] - (d + radius)[outside, None] * n[outside]
    assert_allclose(nearest_in_hull(core, foot), 0.0, atol=1e-6)
    assert_allclose(np.linalg.norm(n, axis=1), 1.0)


def surface_of(plate, reach=60.0, spacing=0.6):
    """Points on the surface of a plate with an opening, from its section grown by shapely."""
    flat = shapely.MultiPoint(plate.hole.core[:, :2]).convex_hull
    angle = np.linspace(0.0, np.pi / 2, 25)
    levels = [(plate.fillet * (1 - np.cos(a)), plate.fillet * (np.sin(a) - 1)) for a in angle]
    levels += [(0.0, z) for z in np.arange(-plate.fillet, -reach, -spacing)]
    levels += [(out, 0.0) for out in np.arange(plate.fillet, reach, spacing)]
    rings = []
    for out, z in levels:
        ring = flat.buffer(plate.hole.radius + out, quad_segs=48).exterior
        points = shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, spacing))
        rings.append(np.insert(shapely.get_coordinates(points), 2, z, axis=1))
    return np.vstack(rings)


@pytest.mark.parametrize(
    "plate",
    [round_opening(30.0, 8.0), BOX_OPENING, TRIANGLE_OPENING],
    ids=["round", "box", "triangle"],
)
def test_openings_against_a_cloud_of_points_on_their_surface(plate):
    points = np.random.default_rng(5).uniform([-60, -60, -30], [60, 60, 20], (3000, 3))
    d, n, _ = plate.distance(points)
    cloud = cKDTree(surface_of(plate))
    distance, _ = cloud.query(points, distance_upper_bound=25.0)
    near = (distance > 2.0) & (d > -plate.fillet) & (distance < plate.hole.radius)
    assert near.sum() > 1000
    assert (d[near] < 0).sum() > 50
    assert_allclose(np.abs(d[near]), distance[near], atol=0.05)
    assert cloud.query((points - d[:, None] * n)[near])[0].max() < 0.45


@pytest.mark.parametrize("sides", [3, 4, 5, 6])
def test_distance_is_right_on_lines_of_symmetry(sides):
    """Opposite the middles of the sides, where nodes of a mesh like to be."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        edge, azimuth = rng.uniform(80.0, 200.0), rng.uniform(0.0, 360.0)
        plate = opening(regular_polygon(sides, edge, azimuth), 10.0, 6.0)
        middle = 0.5 * edge / np.tan(np.pi / sides)
        angle = np.radians(azimuth) + 2 * np.pi * (np.arange(sides) + 0.5) / sides
        outward = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        for s in (-9.0, -1.0, 2.0, 5.0):
            d, n, _ = plate.distance((middle + s) * outward - [0.0, 0.0, 20.0])
            assert_allclose(d, -s, atol=1e-9)
            assert_allclose(n, -outward, atol=1e-9)


@pytest.mark.parametrize("name", ["tetrahedron", "box"])
def test_built_in_tools_have_no_jumps_on_their_axes(name):
    """Along x and y, where nodes of the mesh lie: |d(b) - d(a)| ≤ |b - a|."""
    s = np.linspace(-160.0, 160.0, 3201)
    for part in scene_file.load(name).tools:
        for direction in ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0)):
            for z in (-5.0, 0.0, 3.0):
                line = np.column_stack([*np.outer(direction, s), np.full_like(s, z)])
                line += np.random.default_rng(0).uniform(-5e-14, 5e-14, line.shape)  # round-off
                d, _, _ = part.shape.distance(line)
                assert np.abs(np.diff(d)).max() <= 0.1 * np.hypot(*direction) * (1 + 1e-6)


# Boxes, turns, refusals


@pytest.mark.parametrize(
    "name", [name for name in NAMED if "opening" not in name and name != "plane"]
)
def test_box_encloses_the_tool_and_touches_it(name):
    shape = NAMED[name]
    low, high = shape.box
    points = np.random.default_rng(7).uniform(-120.0, 120.0, (20000, 3))
    d, n, _ = shape.distance(points)
    feet = (points - d[:, None] * n)[np.abs(d) < 60.0]
    assert (feet >= low - 1e-9).all()
    assert (feet <= high + 1e-9).all()
    assert not ((d <= 0) & ((points < low) | (points > high)).any(1)).any()
    if not isinstance(shape, Placed):  # a turned box is larger than the box of the turned
        for corner in (low, high):
            for axis in np.flatnonzero(np.abs(corner) < 1000.0):
                side = np.clip(points, low, high)
                side[:, axis] = corner[axis]
                assert shape.distance(side)[0].min() < 4.0


def test_plane_and_openings_have_no_box():
    for shape in (Plane(), BOX_OPENING, flipped(BOX_OPENING), turned(Plane(), 10.0)):
        assert getattr(shape, "box", None) is None


def test_sharpest_radius():
    assert Plane().sharpest == np.inf
    assert BOX.sharpest == 6.0
    assert TETRAHEDRON.sharpest == 8.0
    assert BOX_OPENING.sharpest == 7.0
    assert round_opening(30.0, 8.0).sharpest == 8.0
    assert flipped(BOX_OPENING).sharpest == turned(BOX_OPENING, 20.0).sharpest == 7.0


@every_shape
def test_placed_shape_is_the_shape_seen_from_another_frame(shape):
    points = points_near(shape)
    origin = np.array([5.0, -3.0, 2.0])
    d, n, H = shape.distance(points)
    placed = Placed(shape, TURN, origin).distance(points @ TURN.T + origin)
    for value, expected in zip(placed, (d, n @ TURN.T, TURN @ H @ TURN.T), strict=True):
        assert_allclose(value, expected, atol=1e-9)


def test_turned_by_nothing_is_the_shape_itself():
    assert turned(BOX, 0) is BOX


@pytest.mark.parametrize("angle", [30.0, -90.0])
def test_turned_shape_turns_counter_clockwise(angle):
    points = points_near(TETRAHEDRON)
    Q = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    d, n, _ = TETRAHEDRON.distance(points)
    moved = turned(TETRAHEDRON, angle).distance(points @ Q.T)
    assert_allclose(moved[0], d, atol=1e-9)
    assert_allclose(moved[1], n @ Q.T, atol=1e-9)


def test_turns_add_up():
    once = turned(BOX, 30.0).distance(points := points_near(BOX))
    back = turned(turned(BOX, 50.0), -20.0).distance(points)
    for a, b in zip(once, back, strict=True):
        assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize(("sides", "azimuth"), [(3, 0.0), (4, 45.0), (5, -10.0)])
def test_regular_polygon(sides, azimuth):
    corners = regular_polygon(sides, 30.0, azimuth)
    assert_allclose(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1), 30.0)
    assert_allclose(corners.sum(0), 0.0, atol=1e-12)
    assert_allclose(np.arctan2(corners[0, 1], corners[0, 0]), np.radians(azimuth))
    assert shapely.LinearRing(corners).is_ccw


def test_flipped_twice_is_the_shape_itself():
    shape = round_opening(R, r)
    points = points_near(shape)
    for once, twice in zip(
        shape.distance(points), flipped(flipped(shape)).distance(points), strict=True
    ):
        assert_allclose(twice, once, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ball(-1.0), "radius must be a positive number, got -1.0"),
        (lambda: bar(0.0), "radius must be a positive number"),
        (lambda: round_punch(np.nan), "radius must be a positive number, got nan"),
        (lambda: round_opening(30.0, 0.0), "fillet must be a positive number"),
        (
            lambda: box_punch(100.0, 12.0, 6.0),
            "width must exceed twice the edge_radius 6 mm, got 12",
        ),
        (lambda: box_punch(-100.0, 50.0, 6.0), "length must be a positive number, got -100.0"),
        (lambda: box_punch(100.0, 50.0, 0.0), "edge_radius must be a positive number, got 0.0"),
        (lambda: tetrahedron_punch(0.0, 50.0, 5.0), "base_edge must be a positive number"),
        (lambda: tetrahedron_punch(90.0, np.inf, 5.0), "height must be a positive number, got inf"),
        (
            lambda: tetrahedron_punch(90.0, 70.0, 30.0),
            "edge_radius 30 mm is too large for a tetrahedron with base_edge 90 and height 70 mm",
        ),
        (
            lambda: opening(rectangle(50.0, 40.0), 21.0, 5.0),
            "corner_radius 21 mm is too large for the opening",
        ),
        (
            lambda: opening(rectangle(50.0, 40.0), -1.0, 5.0),
            "corner_radius must be a positive number, got -1.0",
        ),
        (lambda: opening(rectangle(50.0, 40.0), 5.0, -1.0), "fillet must be a positive number"),
        (lambda: round_opening(-30.0, 8.0), "radius must be a positive number, got -30.0"),
        (
            lambda: Rounded([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 2.0),
            "must be a point, a line or a solid",
        ),
        (lambda: Opening(ball(30.0), np.nan), "fillet must be a positive number, got nan"),
        (lambda: Tool("die", Plane(), tilts=True), "die: only a free tool tilts"),
        (lambda: Tool("die", Plane(), force=-1.0), "die: force must be a number of at least zero"),
        (lambda: Tool("die", Plane(), motion="fast"), "die: motion must be .*got 'fast'"),
        (lambda: Tool("die", Plane(), friction=-0.1), "die: friction must be"),
        (lambda: Tool("holder", Plane(), motion="free"), "holder: mass must be a positive number"),
    ],
)
def test_bad_tool_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_flat_core_away_from_the_origin_is_refused():
    square = np.array([[0.0, 0, 9], [4, 0, 9], [4, 4, 9], [0, 4, 9]])
    with pytest.raises(InputError, match="core of a rounded solid"):
        Rounded(square, 2.0)
