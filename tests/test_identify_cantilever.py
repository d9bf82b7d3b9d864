"""Peirce's test backwards: the exact curve of a chosen stiffness gives that stiffness back."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from quasiform import Fabric, identify, solve
from quasiform.checks import InputError
from quasiform.fabric import MomentCurve
from quasiform.identification.campaign import load
from quasiform.identification.cantilever import from_overhang, from_profile, from_repeats, from_tip
from quasiform.scenes.fabric_tests import cantilever
from quasiform.theory import heavy_elastica, heavy_elastica_shape, heavy_strip

B, AREAL_WEIGHT = 3.403, 600.0
W = 600.0e-3 * 9.81 / 1e6  # N/mm², from kg/m² and m/s²
lengths = pytest.mark.parametrize("length", [40.0, 100.0, 165.0, 300.0])


def droop(length):
    return W * length**3 / B


def profile(length, end=1.0, n=40):
    x, drop = heavy_elastica_shape(droop(length), np.linspace(0, end, n))
    return x * length, drop * length


def shot_from_the_tip(slope):
    """(k, chord angle) by integration from a free end of given slope back to the horizontal.

    Over the bending length c, with σ from the tip: θ'' = -σ cos θ, and L/c = k^(1/3).
    """

    def horizontal(_, state):
        return state[0]

    horizontal.terminal = True
    shot = solve_ivp(
        lambda sigma, y: [y[1], -sigma * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])],
        (0, 100),
        [slope, 0, 0, 0],
        method="DOP853",
        events=horizontal,
        rtol=1e-12,
        atol=1e-13,
    )
    _, _, x, drop = shot.y[:, -1]
    return shot.t[-1] ** 3, np.degrees(np.arctan2(drop, x))


@lengths
def test_overhang_gives_the_stiffness_back(length):
    x, drop, _ = heavy_elastica(droop(length))
    angle = np.degrees(np.arctan2(drop, x))
    assert_allclose(from_overhang(length, angle, AREAL_WEIGHT), B, rtol=1e-6)


@lengths
def test_tip_gives_the_stiffness_back(length):
    x, drop, _ = heavy_elastica(droop(length))
    found = from_tip(x * length, drop * length, length, AREAL_WEIGHT)
    assert_allclose(found.value, B, rtol=1e-6)
    assert np.isnan(found.standard_error)
    assert found.misfit < 1e-6 * length


@lengths
@pytest.mark.parametrize("end", [1.0, 0.6])
def test_profile_gives_the_stiffness_back(length, end):
    found = from_profile(*profile(length, end), AREAL_WEIGHT, length)
    assert_allclose(found.value, B, rtol=1e-6)
    assert found.standard_error < 1e-6 * B
    assert found.misfit < 1e-6 * length


def test_steep_and_shallow_angles():
    """Take k = 8 tan θ where the strip is nearly straight, x = sqrt(2/k) where it hangs."""
    small = np.radians(0.5)
    assert_allclose(W * 1e6 / from_overhang(100.0, 0.5, 600.0), 8 * np.tan(small), rtol=1e-3)
    assert_allclose(W * 1e6 / from_overhang(100.0, 89.0, 600.0), 2 / np.radians(1) ** 2, rtol=0.05)


@pytest.mark.parametrize("slope", [0.3, 0.9, 1.3, 1.5])
def test_exact_angle_against_shooting_from_the_tip(slope):
    k, angle = shot_from_the_tip(slope)
    assert_allclose(from_overhang(100.0, angle, AREAL_WEIGHT), W * 1e6 / k, rtol=1e-8)


def test_half_the_length_at_the_slope_of_testers():
    """The rule c = L/2 at 41.5° is exact within 0.1 %."""
    exact = from_overhang(165.0, 41.5, AREAL_WEIGHT)
    assert_allclose(W * 165.0**3 / exact, 8.0042, atol=1e-4)
    assert_allclose(exact, W * (165.0 / 2) ** 3, rtol=1e-3)
    assert from_overhang(165.0, areal_weight=AREAL_WEIGHT) == exact


def test_peirce_formula_in_its_own_words():
    """Peirce: the bending length is the overhang at 7.1° and half of it at 43°."""
    c = (from_overhang(100.0, np.array([7.1, 43.0]), 600.0, classical=True) / W) ** (1 / 3)
    assert_allclose(c, [100.0, 50.0], rtol=1e-3)


@pytest.mark.parametrize(("angle", "excess"), [(41.5, 0.0575), (60, 0.1386), (75, 0.3421)])
def test_peirce_formula_lies_above_the_exact_value(angle, excess):
    slope = brentq(lambda slope: shot_from_the_tip(slope)[1] - angle, 0.5, 1.57)
    k, theta = shot_from_the_tip(slope)[0], np.radians(angle)
    assert_allclose(k * np.cos(theta / 2) / (8 * np.tan(theta)) - 1, excess, atol=1e-4)
    peirce = from_overhang(100.0, angle, 600.0, classical=True)
    assert_allclose(peirce / from_overhang(100.0, angle, 600.0) - 1, excess, atol=1e-4)


def test_classical_value_stands_beside():
    length = 165.0
    x, drop, _ = heavy_elastica(droop(length))
    angle = np.degrees(np.arctan2(drop, x))
    peirce = from_overhang(length, angle, AREAL_WEIGHT, classical=True)
    tip = from_tip(x * length, drop * length, length, AREAL_WEIGHT)
    curve = from_profile(*profile(length, 0.7), AREAL_WEIGHT, length)
    repeats = from_repeats(length, angle, AREAL_WEIGHT)
    assert_allclose([tip.classical, curve.classical, repeats.classical], peirce, rtol=1e-6)
    assert peirce > 1.04 * B


def test_repeats():
    length = np.array([160.0, 165.0, 171.0])
    each = from_overhang(length, 41.5, AREAL_WEIGHT)
    assert each.shape == (3,)
    assert_allclose(each, [from_overhang(L, 41.5, AREAL_WEIGHT) for L in length])
    found = from_repeats(length, 41.5, AREAL_WEIGHT)
    assert_allclose(found.value, each.mean())
    assert_allclose(found.standard_error, each.std(ddof=1) / np.sqrt(3))
    x, drop = np.array(
        [L * np.array(heavy_elastica(W * L**3 / b)[:2]) for L, b in zip(length, each, strict=True)]
    ).T
    tips = from_tip(x, drop, length, AREAL_WEIGHT)
    assert_allclose([tips.value, tips.standard_error], [found.value, found.standard_error])
    assert np.isnan(found.misfit)


def test_nearest_tip():
    """A tip pushed off the curve of all tips along its normal keeps its stiffness."""
    length, k = 165.0, droop(165.0)
    tip, h = np.array(heavy_elastica(k)[:2]), 1e-4
    along = np.subtract(heavy_elastica(k * (1 + h))[:2], heavy_elastica(k * (1 - h))[:2])
    off = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    x, drop = length * tip - 0.8 * np.sign(off[0]) * off
    found = from_tip(x, drop, length, AREAL_WEIGHT)
    assert_allclose(found.value, B, rtol=1e-3)
    assert_allclose(found.misfit, 0.8, rtol=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_noise_on_a_profile_is_within_its_standard_error(seed):
    rng = np.random.default_rng(seed)
    x, drop = profile(165.0, 0.9) + rng.normal(0, 0.5, (2, 40))
    order = rng.permutation(40)
    found = from_profile(x[order], drop[order], AREAL_WEIGHT, 165.0)
    assert abs(found.value - B) < 3 * found.standard_error
    assert 0.001 * B < found.standard_error < 0.02 * B
    assert 0.3 < found.misfit < 0.7


def test_standard_error_is_the_scatter():
    rng = np.random.default_rng(0)
    exact = np.array(profile(120.0, 1.0, 20))
    noisy = (exact + rng.normal(0, 0.5, exact.shape) for _ in range(30))
    fits = [from_profile(*each, AREAL_WEIGHT, 120.0) for each in noisy]
    scatter = np.std([fit.value for fit in fits], ddof=1)
    assert_allclose(np.mean([fit.standard_error for fit in fits]), scatter, rtol=0.3)
    assert abs(np.mean([fit.value for fit in fits]) - B) < 3 * scatter / np.sqrt(30)


TIP = (119.53, 105.7, 165.0, 600.0)
X, DROP = np.array([10.0, 50.0, 90.0]), np.array([0.5, 12.0, 40.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: from_overhang(165.0, 90.0, 600.0), "angle must lie between 0 and 90 degrees, got"),
        (lambda: from_overhang(165.0, 0, 600.0), "angle must lie between 0 and 90 degrees, got 0"),
        (lambda: from_overhang([1, 2], [45, 95], 600.0), "between 0 and 90 degrees, got 95"),
        (lambda: from_overhang(165.0, 89.9, 600.0), "89.9 degrees the strip hangs straight down"),
        (lambda: from_overhang([165.0, -1.0], 41.5, 600.0), "length must be a positive number"),
        (lambda: from_overhang(165.0, 41.5), "areal_weight must be a positive number, got None"),
        (lambda: from_overhang(165.0, 41.5, 0), "areal_weight must be a positive number, got 0"),
        (lambda: from_overhang("long", 41.5, 600.0), "length must be numbers, got 'long'"),
        (lambda: from_overhang([np.nan, 1], 41.5, 600.0), "length must be finite numbers"),
        (lambda: from_overhang([], 41.5, 600.0), "length must be finite numbers, got []"),
        (
            lambda: from_repeats([1, 2, 3], [40, 41], 600.0),
            "the arrays do not match: 3 of length and 2 of angle",
        ),
        (
            lambda: from_tip(80.0, 66.5, 100.0, 600.0),
            "the tip lies 104 mm from the clamp, further than the strip is long",
        ),
        (lambda: from_tip(TIP[0], 0.0, *TIP[2:]), "drop must be a positive number, got 0.0"),
        (lambda: from_tip(-3.0, *TIP[1:]), "x must be a positive number, got -3.0"),
        (lambda: from_tip(*TIP[:2], 0, 600.0), "length must be a positive number"),
        (
            lambda: from_tip(100.0, 0.001, 100.0, 600.0),
            "the strip does not droop: measure a longer",
        ),
        (lambda: from_tip(0.2, 99.9, 100.0, 600.0), "hangs straight down: measure a shorter"),
        (lambda: from_profile(X, DROP[:2], 600.0, 165.0), "do not match: 3 of x and 2 of drop"),
        (lambda: from_profile(X[:2], DROP[:2], 600.0, 165.0), "at least 3 points, got 2"),
        (lambda: from_profile(1.0, 2.0, 600.0, 165.0), "at least 3 points, got 1"),
        (lambda: from_profile(X, DROP, -600.0, 165.0), "areal_weight must be a positive number"),
        (lambda: from_profile(X, DROP, 600.0, 0.0), "length must be a positive number, got 0.0"),
        (
            lambda: from_profile(X, DROP, 600.0, 95.0),
            "the point farthest out lies 98.49 mm from the clamp, further than the strip is long",
        ),
        (lambda: from_profile(X, 0 * X, 600.0, 165.0), "does not droop: measure a longer overhang"),
    ],
)
def test_bad_measurements_are_refused_in_one_line(call, message):
    with pytest.raises(InputError) as refused:
        call()
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_refusal_of_a_single_file_names_it(tmp_path):
    file = tmp_path / "profile.csv"
    np.savetxt(file, np.column_stack([X, DROP]), "%g", ",", header="x [mm],drop [mm]", comments="")
    given = {"kind": "cantilever", "family": "warp", "areal_weight": 600.0, "length": 95.0}
    with pytest.raises(InputError, match=r"profile\.csv: the point farthest out lies 98\.49 mm"):
        load(file, **given)


def test_a_little_stretch_of_the_tape_is_forgiven():
    x, drop, _ = heavy_elastica(droop(165.0))
    reach = 165.0 * np.hypot(x, drop)
    assert from_tip(x * 165.0, drop * 165.0, reach / 1.019, AREAL_WEIGHT).misfit > 1.0


# Moment over curvature

SOFT = np.array([[2.39, 0.2849], [8.86, 0.344], [17.7, 0.375]])  # 1/m, N; Broberg et al. 2024


def bending_campaign(folder, table, heading="curvature [1/m],moment [N]"):
    np.savetxt(folder / "moment.csv", table, "%.9g", ",", header=heading, comments="")
    path = folder / "b.toml"
    test = '[[tests]]\nkind = "bending"\nfamily = "weft"\nmoments = "moment.csv"\n'
    path.write_text(f'name = "soft"\n{test}', encoding="utf-8")
    return path


@pytest.mark.parametrize("many", [False, True])
def test_a_measured_softening_comes_back(tmp_path, many):
    table = SOFT
    curve = MomentCurve(tuple(1e-3 * SOFT[:, 0]), tuple(SOFT[:, 1]))
    if many:
        kappa = np.linspace(0.1, 17.7, 200)
        noise = 1 + 0.01 * np.random.default_rng(0).standard_normal(200)
        table = np.column_stack([kappa, noise * curve.law.stress(1e-3 * kappa)])
    found = identify(bending_campaign(tmp_path, table))
    fabric = found.fabric
    kappa = np.linspace(1.0, 17.7, 50)
    expected = np.interp(kappa, *SOFT.T) if not many else curve.law.stress(1e-3 * kappa)
    measured = fabric.moment_weft.law.stress(1e-3 * kappa)
    assert_allclose(measured[kappa > 2.4], expected[kappa > 2.4], rtol=0.05)
    assert_allclose(fabric.moment_weft.law.stress(1e-3 * SOFT[:, 0]), SOFT[:, 1], rtol=0.05)
    assert fabric.bending_weft == fabric.moment_weft.initial == pytest.approx(119.2, rel=0.1)
    assert fabric.moment_warp is None
    assert fabric.provenance["moment_weft"] == fabric.provenance["bending_weft"] == "measured"
    assert any("times less than by it (moment_weft)" in notice for notice in found.notices)
    found.save(tmp_path / "out")
    assert Fabric.load(tmp_path / "out/material.toml") == fabric


@pytest.mark.parametrize(
    ("heading", "table", "words"),
    [
        ("curvature,moment [N]", SOFT, "unit of the curvature missing: expected one of 1/mm"),
        ("curvature [1/m],moment [kg]", SOFT, "unit of the moment kg: expected one of N"),
        ("curvature [1/m],moment [N]", SOFT[:1], "needs at least 4 points"),
        ("curvature [1/m],moment [N]", SOFT * [1, -1], "no positive moment"),
        ("curvature [1/m],moment [N]", SOFT * [1, 0] + [0, 1], r"moment\[1\] must be greater"),
    ],
)
def test_a_wrong_moment_curve_is_refused(tmp_path, heading, table, words):
    with pytest.raises(InputError, match=words) as caught:
        identify(bending_campaign(tmp_path, table, heading))
    assert "moment.csv: " in str(caught.value)
    assert "I6" not in str(caught.value)


def test_a_softening_strip_hangs_as_the_elastica_of_its_moments():
    length, curve = 160.0, MomentCurve((0.002, 0.008, 0.03), (0.0068, 0.018, 0.03))
    fabric = Fabric(bending_warp=curve.initial, moment_warp=curve)
    kappa = np.linspace(0.0, 0.06, 2000)
    x, drop, _ = heavy_strip(length, W, kappa, curve.law.stress(kappa))
    linear = heavy_elastica(W * length**3 / curve.initial)
    assert drop > 1.2 * length * linear[1]
    off = []
    for size in (10.0, 5.0):
        model = cantilever(length, W, law=fabric, size=size)
        formed = solve(model, estimate=False).positions()
        tip = formed[np.isclose(model.sheet.blank.nodes[:, 0], length)].mean(0)
        off.append(np.hypot(tip[0] - x, -tip[2] - drop))
    assert off[1] < 0.01 * length
    assert off[1] < 0.4 * off[0]


def test_a_linear_moment_is_the_heavy_elastica():
    length = 165.0
    x, drop, slope = heavy_strip(length, W, np.array([0.0, 0.01]), np.array([0.0, 0.01 * B]))
    expected = np.array(heavy_elastica(W * length**3 / B)) * [length, length, 1.0]
    assert_allclose([x, drop, slope], expected, rtol=1e-6)


def test_one_file_of_a_profile_or_of_moments(tmp_path):
    """The command line reads a single CSV file; its kind says what is in it."""
    file = tmp_path / "profile.csv"
    np.savetxt(file, np.transpose(profile(165.0)), header="x_mm,drop_mm", delimiter=",")
    how = {"kind": "cantilever", "family": "weft", "areal_weight": AREAL_WEIGHT}
    found = identify(load(file, **how, length=165.0)).fabric
    assert found.bending_weft == pytest.approx(B, rel=1e-5)
    moments = tmp_path / "moments.csv"
    moments.write_text("curvature [1/m],moment [N]\n2,0.006\n5,0.01\n10,0.015\n", encoding="utf-8")
    bending = load(moments, kind="bending", family="warp").bending
    assert bending["warp"].moment[-3:] == (0.006, 0.01, 0.015)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({}, "family missing"),
        ({"family": "warp"}, "length missing"),
        ({"family": "warp", "length": 165.0, "width": 20.0}, "width is not a size"),
        ({"family": "warp", "length": 165.0, "cycle": "last"}, "cycle does not apply"),
    ],
)
def test_a_wrong_file_of_a_profile_is_refused(tmp_path, how, words):
    file = tmp_path / "profile.csv"
    np.savetxt(file, np.transpose(profile(165.0)), header="x_mm,drop_mm", delimiter=",")
    with pytest.raises(InputError, match=words):
        load(file, kind="cantilever", **how)
