"""Rigid shapes: true distances with their own derivatives, right at known points, C¹ at joins."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quasiform.checks import InputError
from quasiform.tool import Cylinder, Flipped, Plane, RoundOpening, RoundPunch, Sphere, Tool

SHAPES = [
    Plane(),
    Sphere(30.0),
    Cylinder(20.0),
    RoundPunch(25.0),
    RoundOpening(30.0, 8.0),
    Flipped(RoundOpening(30.0, 8.0)),
    Flipped(RoundPunch(25.0)),
]
every_shape = pytest.mark.parametrize("shape", SHAPES, ids=repr)
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


@pytest.mark.parametrize(
    ("shape", "point", "distance", "normal"),
    [
        (Plane(), (3, 4, -2), -2, (0, 0, 1)),
        (Sphere(30.0), (0, 0, -33), 3, (0, 0, -1)),
        (Sphere(30.0), (18, 0, 24), 0, (0.6, 0, 0.8)),
        (Cylinder(20.0), (0, 70, 15), -5, (0, 0, 1)),
        (Cylinder(20.0), (-30, -7, 40), 30, (-0.6, 0, 0.8)),
        (RoundPunch(25.0), (0, 0, 0), 0, (0, 0, -1)),
        (RoundPunch(25.0), (0, 0, -4), 4, (0, 0, -1)),
        (RoundPunch(25.0), (0, 28, 25), 3, (0, 1, 0)),
        (RoundPunch(25.0), (-18, 24, 300), 5, (-0.6, 0.8, 0)),
        (RoundOpening(R, r), (50, 0, 2), 2, (0, 0, 1)),
        (RoundOpening(R, r), (50, 0, -20), -20, (0, 0, 1)),
        (RoundOpening(R, r), (0, R, -100), 0, (0, -1, 0)),
        (RoundOpening(R, r), (R - 10, 0, -100), 10, (-1, 0, 0)),
        (RoundOpening(R, r), (R + 3, 0, -100), -3, (-1, 0, 0)),
        (
            RoundOpening(R, r),
            (R + r * (1 - BISECTOR), 0, -r * (1 - BISECTOR)),
            0,
            (-BISECTOR, 0, BISECTOR),
        ),
        (RoundOpening(R, r), (R, 0, 0), r * (np.sqrt(2) - 1), (-BISECTOR, 0, BISECTOR)),
        (Flipped(RoundOpening(R, r)), (50, 0, -2), 2, (0, 0, -1)),
        (Flipped(RoundOpening(R, r)), (R, 0, 0), r * (np.sqrt(2) - 1), (-BISECTOR, 0, -BISECTOR)),
        (Flipped(RoundPunch(25.0)), (0, 0, 4), 4, (0, 0, 1)),
    ],
)
def test_distance_at_known_points(shape, point, distance, normal):
    d, n, _ = shape.distance(np.array([point], dtype=float))
    assert_allclose(d, [distance], atol=1e-12)
    assert_allclose(n, [normal], atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "point", "curvatures"),
    [
        (Sphere(30.0), (0, 40, 0), (0, 1 / 40, 1 / 40)),
        (Cylinder(20.0), (0, 5, 25), (0, 0, 1 / 25)),
        (RoundPunch(25.0), (0, 0, -5), (0, 1 / 30, 1 / 30)),
        (RoundPunch(25.0), (30, 0, 80), (0, 0, 1 / 30)),
        (RoundOpening(R, r), (R - 5, 0, -50), (-1 / (R - 5), 0, 0)),
        (RoundOpening(R, r), (R, 0, 0), (-BISECTOR / R, 0, 1 / (np.sqrt(2) * r))),
    ],
)
def test_principal_curvatures_at_known_points(shape, point, curvatures):
    _, _, H = shape.distance(np.array([point], dtype=float))
    assert_allclose(np.linalg.eigvalsh(H[0]), curvatures, atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "point", "across"),
    [
        (RoundOpening(R, r), (R + r, 0, 0), (1, 0, 0)),  # fillet and face
        (RoundOpening(R, r), (R + r, 0, 9), (1, 0, 0)),
        (RoundOpening(R, r), (R, 0, -r), (0, 0, 1)),  # fillet and wall
        (RoundOpening(R, r), (R - 6, 0, -r), (0, 0, 1)),
        (RoundPunch(25.0), (25, 0, 25), (0, 0, 1)),  # hemisphere and shaft
        (RoundPunch(25.0), (0, -40, 25), (0, 0, 1)),
    ],
)
def test_distance_and_normal_are_continuous_across_joins(shape, point, across):
    gap = 1e-7 * np.array(across)
    d, n, H = shape.distance(np.array([point - gap, point + gap]))
    assert_allclose(d[0], d[1], atol=3e-7)
    assert_allclose(n[0], n[1], atol=1e-7)
    assert np.abs(H[0] - H[1]).max() > 0.01  # it is a join: the curvature jumps


def test_flipped_twice_is_the_shape_itself():
    shape = RoundOpening(R, r)
    points = points_near(shape)
    for once, twice in zip(
        shape.distance(points), Flipped(Flipped(shape)).distance(points), strict=True
    ):
        assert_allclose(twice, once, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(-1.0), "radius must be a positive number, got -1.0"),
        (lambda: Cylinder(0.0), "radius must be a positive number"),
        (lambda: RoundPunch(np.nan), "radius must be a positive number, got nan"),
        (lambda: RoundOpening(30.0, 0.0), "fillet must be a positive number"),
        (lambda: Tool("die", Plane(), motion="fast"), "die: motion must be .*got 'fast'"),
        (lambda: Tool("die", Plane(), friction=-0.1), "die: friction must be"),
        (lambda: Tool("holder", Plane(), motion="free"), "holder: mass must be a positive number"),
    ],
)
def test_bad_tool_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
