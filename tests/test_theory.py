"""The reference solutions against printed numbers, against each other and in their limits."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from quasiform.fabric import Fabric
from quasiform.theory import (
    OffAxisTension,
    capstan_ratio,
    heavy_elastica,
    heavy_elastica_shape,
    hemisphere_bias,
    hemisphere_net,
    picture_frame_displacement,
    picture_frame_force,
    strip_friction,
    tip_loaded_elastica,
)

T0 = 1.004
LAWS = {name: Fabric.preset(name).shear for name in ("best-fit", "locking")}


def strip(angle_deg, l0=320, w0=160):
    return OffAxisTension(l0, w0, np.radians(angle_deg))


def linear_stress(I6):
    return 0.334 * I6


def linear_energy(I6):
    return 0.167 * I6**2


def assert_printed(actual, printed, digits):
    """Agree to the last printed digit."""
    assert_allclose(actual, printed, rtol=0, atol=0.501 * 10.0**-digits)


# Off-axis tension

U_45 = np.array([10, 20, 30, 40, 50, 55])


def test_bias_extension_angles():
    assert_printed(
        np.degrees(strip(45).angles(U_45)[0]), [7.41, 15.40, 24.21, 34.23, 46.27, 53.67], 2
    )


@pytest.mark.parametrize(
    ("law", "force"),
    [
        ("best-fit", [8.07, 12.63, 15.68, 18.33, 23.95, 31.47]),
        ("locking", [8.07, 12.63, 15.68, 18.33, 21.51, 23.95]),
    ],
)
def test_bias_extension_force(law, force):
    assert_printed(strip(45).force(U_45, LAWS[law].stress, T0), force, 2)


def test_bias_extension_near_its_limit():
    assert_printed(np.degrees(strip(45).angles(58)[0]), 58.92, 2)
    assert_printed(strip(45).force(58, LAWS["best-fit"].stress, T0), 38.3, 1)
    assert_printed(strip(45).force(58, LAWS["locking"].stress, T0), 332, 0)
    assert_printed(strip(45).displacement_limit, 66.27, 2)


@pytest.mark.parametrize(("l0", "w0"), [(320, 160), (250, 160), (450, 150)])
def test_bias_extension_closed_form(l0, w0):
    u = np.linspace(0, 0.4 * (l0 - w0), 9)
    gamma, phi_a, phi_b = strip(45, l0, w0).angles(u)
    assert_allclose(np.sin(gamma), (1 + u / (l0 - w0)) ** 2 - 1, atol=1e-14)
    assert_allclose([phi_a, phi_b], [gamma / 2, gamma / 2], atol=1e-14)


def test_bias_extension_zone_areas():
    l0, w0 = 320, 160
    full, half_a, half_b, rigid = strip(45, l0, w0).zone_areas
    assert_allclose([full, half_a + half_b], [w0 * l0 - 1.5 * w0**2, w0**2], rtol=1e-14)
    assert_allclose(rigid, w0**2 / 2, rtol=1e-14)


@pytest.mark.parametrize("law", LAWS)
def test_bias_extension_returns_the_law(law):
    """Cao et al. 2008, Eq. 18: the force of a test gives the law of the fabric back."""
    H, W, S12 = 320, 160, LAWS[law].stress
    u = np.linspace(1, 60, 12)
    gamma, half, _ = strip(45, H, W).angles(u)
    first = (H / W - 1) * strip(45, H, W).force(u, S12, T0) * (np.cos(half) - np.sin(half))
    second = W * T0 * S12(np.sin(half)) * np.cos(half)
    F_sh = (first - second) / ((2 * H - 3 * W) * np.cos(gamma))
    assert_allclose(F_sh, T0 * S12(np.sin(gamma)), rtol=1e-12)


def test_kinematic_angle_of_cao_150_by_450():
    u = [30.0, 46.0, 66.2, 77.4, 88.7, 99.6, 106.5]
    gamma = np.degrees(strip(45, 450, 150).angles(u)[0])
    assert_printed(gamma, [12.1, 19.3, 29.3, 35.6, 42.7, 50.7, 56.7], 1)


def test_force_predicted_from_cao_picture_frame():
    """Inside the measured angles, with the table interpolated linearly."""
    table_deg = [15, 20, 25, 30, 35, 40, 45, 50]
    table_F_sh = [0.0112, 0.0162, 0.0259, 0.0396, 0.0572, 0.0897, 0.1409, 0.2229]

    def F_sh(I6):
        return np.interp(np.degrees(np.arcsin(I6)), table_deg, table_F_sh)

    assert_allclose(strip(45, 230, 115).force([30, 35], F_sh, 1), [11.80, 24.4], rtol=2e-3)


U_30 = np.array([2, 5, 10, 12, 15])


def test_30_degrees_angles():
    gamma, phi_a, phi_b = np.degrees(strip(30).angles(U_30))
    assert_printed(gamma, [4.95, 12.57, 26.18, 32.16, 42.12], 2)
    assert_printed(phi_a, [0.31, 0.86, 2.00, 2.56, 3.54], 2)
    assert_printed(phi_b, [4.64, 11.71, 24.18, 29.60, 38.58], 2)


def test_30_degrees_force():
    force = strip(30).force(U_30, LAWS["best-fit"].stress, T0)
    assert_printed(force, [6.62, 11.37, 14.75, 15.80, 18.35], 2)
    assert_printed(strip(30).force(15, LAWS["locking"].stress, T0), 17.67, 2)


def test_30_degrees_areas_and_limit():
    assert_printed(strip(30).zone_areas, [4225.6, 32194.2, 2633.9, 12146.3], 1)
    assert_printed(strip(30).displacement_limit, 21.96, 2)


def test_field_is_an_upper_bound_at_30_degrees():
    """Converged finite-element forces of the locking law lie below at 5 and 15 mm."""
    bound = strip(30).force(np.array([5, 10, 15]), LAWS["locking"].stress, T0)
    assert_allclose(bound, [11.26, 14.72, 17.59], rtol=0.012)
    assert np.all(bound > [11.26, 14.72, 17.59])


@pytest.mark.parametrize(("l0", "w0", "angle"), [(320, 160, 30), (320, 160, 58), (700, 160, 37)])
def test_zone_areas_by_counting(l0, w0, angle):
    """Sort a lattice of points by the grips that their two fibres reach."""
    theta0 = np.radians(angle)
    s, c = np.sin(theta0), np.cos(theta0)
    x, y = np.meshgrid((np.arange(1200) + 0.5) * l0 / 1200, (np.arange(1200) + 0.5) * w0 / 1200)
    xi, eta = c * x + s * y, s * x - c * y
    turns_a = (xi > w0 * s) & (xi < l0 * c)
    turns_b = (eta > 0) & (eta < l0 * s - w0 * c)
    zones = [turns_a & turns_b, turns_a & ~turns_b, ~turns_a & turns_b, ~turns_a & ~turns_b]
    counted = [zone.mean() * l0 * w0 for zone in zones]
    assert_allclose(strip(angle, l0, w0).zone_areas, counted, atol=2e-4 * l0 * w0)


@pytest.mark.parametrize("angle", [30, 40, 45, 58])
def test_fibres_close_between_the_grips(angle):
    """The turned fibres span the gap: u along the pull, no lateral motion."""
    test = strip(angle)
    u = np.linspace(-0.9, 0.9, 7) * test.displacement_limit
    _, phi_a, phi_b = test.angles(u)
    direction_a = test.theta0 - phi_a
    direction_b = test.theta0 - np.pi / 2 + phi_b
    span = test.alpha * np.exp(1j * direction_a) + test.beta * np.exp(1j * direction_b)
    D, e = test.chord
    assert_allclose(span, D + u + 1j * e, rtol=1e-13)


def test_swapping_the_families_swaps_the_angles():
    u = np.linspace(-15, 15, 7)
    gamma, phi_a, phi_b = strip(33).angles(u)
    assert_allclose(strip(57).angles(u), [gamma, phi_b, phi_a], atol=1e-14)
    assert_allclose(strip(57).zone_areas, strip(33).zone_areas[[0, 2, 1, 3]], rtol=1e-12)


@pytest.mark.parametrize("angle", [30, 40, 45, 58])
@pytest.mark.parametrize("law", LAWS)
def test_force_is_the_derivative_of_the_energy(angle, law):
    test, h = strip(angle), 1e-4
    u = np.linspace(-0.85, 0.85, 8) * test.displacement_limit
    higher, lower = (test.energy(v, LAWS[law].energy, T0) for v in (u + h, u - h))
    assert_allclose(test.force(u, LAWS[law].stress, T0), (higher - lower) / (2 * h), rtol=2e-6)


def test_small_displacements_are_linear():
    """With S12 = G I6 the force starts as G t0 u sum A_i (dgamma_i/du)^2."""
    test = strip(30)
    stiffness = 0.334 * T0 * test.zone_areas[:3] @ test.angle_rates(0) ** 2
    assert_allclose(test.force(1e-6, linear_stress, T0), 1e-6 * stiffness, rtol=1e-6)
    assert_allclose(test.energy(1e-6, linear_energy, T0), 0.5e-12 * stiffness, rtol=1e-6)


def test_displacement_limit_is_collapse():
    test = strip(30)
    with pytest.raises(ValueError, match="u must lie between") as caught:
        test.angles([0, 22])
    limits = re.findall(r"-?[\d.]+ (?=and|mm)", str(caught.value))
    shortest, longest = (float(limit) for limit in limits)
    assert_printed(longest, test.displacement_limit, 4)
    gamma = test.angles(np.array([shortest, longest]) * (1 - 1e-6))[0]
    assert_allclose(gamma, [-np.pi / 2, np.pi / 2], atol=5e-3)
    with pytest.raises(ValueError, match="got -365 to -365"):
        test.angles(-365)


@pytest.mark.parametrize("angle", [26.5, 63.5])
def test_fibre_joining_both_grips_is_refused(angle):
    strip(26.6)
    strip(63.4)
    with pytest.raises(ValueError, match=r"fibres join both grips: .* must exceed 32") as caught:
        strip(angle)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 160, 0.7), r"`OffAxisTension\(l0=...\)` must be positive, got 0"),
        ((320, np.nan, 0.7), r"`OffAxisTension\(w0=...\)` must be positive, got nan"),
        ((320, 160, 45), r"theta0=...\)` must lie between 0 and pi/2 radians, got 45"),
    ],
)
def test_strip_out_of_range_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        OffAxisTension(*arguments)


# Picture frame


def test_picture_frame_limits():
    assert picture_frame_displacement(0, 200) == pytest.approx(0, abs=1e-12)
    closed = picture_frame_displacement(np.pi / 2, 200)
    assert_allclose(closed, (2 - np.sqrt(2)) * 200, rtol=1e-14)


@pytest.mark.parametrize("law", LAWS)
def test_picture_frame_force_is_the_derivative_of_the_energy(law):
    side, h = 200, 1e-6
    gamma = np.radians([1, 10, 30, 50, 60])
    ends = np.array([gamma - h, gamma + h])
    energy = T0 * side**2 * LAWS[law].energy(np.sin(ends))
    slope = np.diff(energy, axis=0)[0] / np.diff(picture_frame_displacement(ends, side), axis=0)[0]
    assert_allclose(picture_frame_force(gamma, side, LAWS[law].stress, T0), slope, rtol=1e-6)


def test_picture_frame_starts_at_the_shear_modulus():
    """Small angles: d = L gamma / sqrt(2), F = sqrt(2) t0 L G gamma."""
    gamma = 1e-6
    assert_allclose(picture_frame_displacement(gamma, 200), 200 * gamma / np.sqrt(2), rtol=1e-5)
    force = picture_frame_force(gamma, 200, linear_stress, T0)
    assert_allclose(force, np.sqrt(2) * T0 * 200 * 0.334 * gamma, rtol=1e-5)


# Elastica


@pytest.mark.parametrize(
    ("k", "x", "drop", "slope_deg"),
    [
        (1, 0.991246, 0.123471, 9.460),
        (2, 0.966893, 0.238507, 18.426),
        (8, 0.724425, 0.640631, 53.865),
        (10, 0.656354, 0.700200, 60.312),
    ],
)
def test_heavy_elastica(k, x, drop, slope_deg):
    actual_x, actual_drop, slope = heavy_elastica(k)
    assert_printed([actual_x, actual_drop], [x, drop], 6)
    assert_printed(np.degrees(slope), slope_deg, 3)


def test_peirce_cantilever():
    """At L = 2 (B/w)^(1/3) the chord hangs at about 41.5 degrees."""
    x, drop, _ = heavy_elastica(8.0042)
    assert_printed(np.degrees(np.arctan2(drop, x)), 41.5, 4)


def test_heavy_elastica_limits():
    """Beam theory for small k: drop k/8, slope k/6; a vertical sheet for large k."""
    x, drop, slope = heavy_elastica(1e-3)
    assert_allclose([x, drop, slope], [1, 1e-3 / 8, 1e-3 / 6], rtol=1e-6)
    assert heavy_elastica(0) == (1, 0, 0)
    x, drop, slope = heavy_elastica(1e5)
    assert 0 < x < 0.005
    assert 0.998 < drop < 1
    assert_allclose(slope, np.pi / 2, rtol=1e-12)


@pytest.mark.parametrize("k", [0.5, 8.0042, 300.0])
def test_heavy_elastica_shape(k):
    """Unit speed from a horizontal clamp to the tip; the moment carries the weight beyond."""
    s = np.linspace(0, 1, 2001)
    x, drop = heavy_elastica_shape(k, s)
    assert_allclose([x[0], drop[0]], 0, atol=1e-12)
    assert_allclose([x[-1], drop[-1]], heavy_elastica(k)[:2], rtol=1e-12)
    slope = np.arctan2(np.diff(drop), np.diff(x))
    assert_allclose(np.hypot(np.diff(x), np.diff(drop)), s[1], rtol=k * s[1])
    curvature = np.diff(slope) / s[1]
    arm = np.array([((x[i:] - x[i]).mean()) * (1 - s[i]) for i in range(1, len(s) - 1)])
    assert_allclose(curvature, k * arm, atol=1e-3 * k)


def test_heavy_elastica_shape_limits():
    """Beam theory for small k: drop = k (6 s^2 - 4 s^3 + s^4) / 24; any shape of stations."""
    s = np.linspace(0, 1, 12).reshape(3, 4)
    x, drop = heavy_elastica_shape(1e-3, s)
    assert_allclose(x, s, atol=1e-7)
    assert_allclose(drop, 1e-3 * (6 * s**2 - 4 * s**3 + s**4) / 24, atol=1e-9)
    with pytest.raises(ValueError, match=r"s must lie between 0 and 1, got 0 to 1\.1"):
        heavy_elastica_shape(1, [0, 1.1])


@pytest.mark.parametrize(
    ("k", "u", "w"),
    [
        (1, 0.056433, 0.301721),
        (2, 0.160642, 0.493457),
        (5, 0.387628, 0.713792),
        (10, 0.554996, 0.810609),
    ],
)
def test_tip_loaded_elastica(k, u, w):
    assert_printed(tip_loaded_elastica(k), [u, w], 6)


@pytest.mark.parametrize("tip_slope", [0.01, 0.5, 1.0, 1.5, 1.57])
def test_tip_loaded_elastica_by_elliptic_integrals(tip_slope):
    m = (1 + np.sin(tip_slope)) / 2
    clamp = np.arcsin(1 / np.sqrt(2 * m))
    root_k = ellipk(m) - ellipkinc(clamp, m)
    u = 1 - np.sqrt(2 * np.sin(tip_slope)) / root_k
    w = 1 - 2 * (ellipe(m) - ellipeinc(clamp, m)) / root_k
    assert_allclose(tip_loaded_elastica(root_k**2), [u, w], atol=1e-9)


@pytest.mark.parametrize("k", [-1, np.inf, np.nan])
@pytest.mark.parametrize("elastica", [heavy_elastica, tip_loaded_elastica])
def test_elastica_refuses_a_meaningless_load(elastica, k):
    with pytest.raises(ValueError, match="k must be finite and not negative, got"):
        elastica(k)


def test_elastica_that_is_not_solved_raises():
    with pytest.raises(RuntimeError, match=r"k = 1e\+12 not solved after .* take a smaller k"):
        heavy_elastica(1e12)


# Hemisphere


def test_hemisphere_net():
    gamma = np.degrees(hemisphere_net(np.array([0.25, 0.5, 1]), 1, 1))
    assert_printed(gamma, [14.2744, 28.2568, 54.3183], 4)


def test_hemisphere_net_obeys_its_equation():
    """gamma_ab = cos(gamma) / R^2, by differences, on both sides of where the series ends."""
    radius, h = 75.0, 0.5
    a, b = np.array([1, 5, 7, 10, 40, 75, 90, -60]), np.array([1, 9, 9, 10, -60, 75, 100, -70])
    signs = [(i, j) for i in (-1, 1) for j in (-1, 1)]
    mixed = sum(i * j * hemisphere_net(a + i * h, b + j * h, radius) for i, j in signs) / (4 * h**2)
    assert_allclose(mixed * radius**2, np.cos(hemisphere_net(a, b, radius)), rtol=2e-4)


def test_hemisphere_net_is_odd_and_starts_at_the_pole():
    a = np.array([[0, 0.02, 1.0], [0.5, 0.09, 0.7]])
    assert_allclose(hemisphere_net(a, -a, 1), -hemisphere_net(a, a, 1))
    assert hemisphere_net(50, 0, 75) == 0
    p = np.array([1e-6, 0.005, 0.0099, 0.0101, 0.02])
    assert_allclose(hemisphere_net(p, 1, 1), p - p**3 / 18 + 7 * p**5 / 1800, rtol=5e-12)


def test_hemisphere_bias_line():
    gamma, _ = hemisphere_bias(np.radians([15, 30, 45, 60, 75, 90]), 75)
    assert_printed(np.degrees(gamma), [1.94, 7.52, 16.11, 26.95, 39.27, 52.43], 2)


def test_hemisphere_bias_line_by_quadrature():
    """The colatitude is the arc length of the diagonal of the net."""
    colatitude = np.radians([0, 20, 50, 90])
    gamma, s = hemisphere_bias(colatitude, 75)
    assert_allclose(gamma, hemisphere_net(s, s, 75))

    def arc(t):
        return 2 * np.cos(np.pi / 4 - hemisphere_net(t, t, 75) / 2)

    assert_allclose([quad(arc, 0, end)[0] / 75 for end in s], colatitude, rtol=1e-9, atol=1e-12)


def test_hemisphere_against_a_net_of_short_rods():
    """Swing each node a fixed chord away from its two neighbours on the sphere."""
    n, length = 100, 0.96
    arc = np.linspace(0, length, n + 1)
    node = np.zeros((n + 1, n + 1, 3))
    node[:, 0] = np.stack([np.sin(arc), 0 * arc, np.cos(arc)], axis=-1)
    node[0, :] = np.stack([0 * arc, np.sin(arc), np.cos(arc)], axis=-1)
    for i in range(n):
        for j in range(n):
            ends = node[i + 1, j] + node[i, j + 1]
            node[i + 1, j + 1] = 2 * (node[i, j] @ ends) / (ends @ ends) * ends - node[i, j]
    k = np.arange(n)
    warp = node[k + 1, k + 1] - node[k, k + 1]
    weft = node[k + 1, k + 1] - node[k + 1, k]
    gamma = np.arcsin(np.sum(warp * weft, axis=1) / np.sum(warp**2, axis=1))
    middle = (arc[1:] + arc[:-1]) / 2
    assert_allclose(gamma, hemisphere_net(middle, middle, 1), atol=1e-5)
    colatitude = np.arccos(node[k, k, 2])
    assert_allclose(hemisphere_bias(colatitude, 1)[1], arc[:-1], atol=1e-5)


def test_hemisphere_refuses_a_collapsed_net():
    assert_allclose(hemisphere_net(1.8615, 1, 1), np.pi / 2, atol=1e-3)
    with pytest.raises(ValueError, match=r"collapses at a b / radius\^2 = 1\.86159, got 1\.9"):
        hemisphere_net([1, -1.9], 1, 1)
    with pytest.raises(ValueError, match="must be positive, got 0"):
        hemisphere_net(1, 1, 0)
    with pytest.raises(ValueError, match="colatitude must lie between 0 and pi/2"):
        hemisphere_bias(1.6, 75)


# Friction


def test_friction():
    assert_printed(capstan_ratio(0.157, np.pi / 2), 1.27969, 5)
    assert capstan_ratio(0.157, 0) == 1
    assert_allclose(strip_friction(0.157, 2), 2 * 0.157 * 2 * 9.81)
