"""Identification: power balance, stress curve, parameters, elements in the loop, files, words."""

import csv
import hashlib
import json
from dataclasses import replace
from datetime import date
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import quasiform as qf
from quasiform.checks import InputError
from quasiform.console.cli import main
from quasiform.identification import picture
from quasiform.identification.campaign import Campaign, ShearTest, load
from quasiform.identification.energy_method import Forces, energy_method
from quasiform.identification.fit import NAMES, Unknowns, fit, report
from quasiform.identification.inverse import Sheet
from quasiform.identification.records import Curve
from quasiform.identification.specimen import OffAxis, PictureFrame
from quasiform.solve.newton import NotConvergedError
from quasiform.theory import (
    OffAxisTension,
    heavy_elastica,
    picture_frame_displacement,
    picture_frame_force,
)

T0 = 1.004  # mm
FABRICS = {name: qf.Fabric.preset(name) for name in ("best-fit", "locking")}
LAWS = {name: fabric.shear for name, fabric in FABRICS.items()}
FILES = {"material.toml", "parameters.csv", "stress.csv", "summary.json", "identification.png"}


STRIP = OffAxis()


def displacement(gamma, strip=STRIP):
    """Grip displacement, mm, at which inextensible fibres are sheared by gamma, rad."""
    l0, w0, theta = strip.length, strip.width, np.radians(strip.angle)
    alpha = l0 * np.cos(theta) - w0 * np.sin(theta)
    beta = l0 * np.sin(theta) - w0 * np.cos(theta)
    D = l0 - w0 * np.sin(2 * theta)
    return np.sqrt(D**2 + 2 * alpha * beta * np.sin(gamma)) - D


def bias_extension(gamma, S12):
    """Force of the strip of 320 mm x 160 mm at 45°, N: a full zone of D²/2, half ones of D²."""
    D = 160.0
    power = D**2 / 2 * S12(np.sin(gamma)) * np.cos(gamma)
    power += D**2 * S12(np.sin(gamma / 2)) * np.cos(gamma / 2) / 2
    return T0 * power / (D / np.sqrt(2) * np.sin(np.pi / 4 - gamma / 2))


def case(law, top, noise=0.0, seed=0, as_printed=False, rows=300, low=2.0):
    """A test at 45° from low to top degrees with relative noise; what is found for it is kept."""
    return law, top, noise, seed, as_printed, rows, low


@cache
def _strip_test(given):
    law, top, noise, seed, as_printed, rows, low = given
    gamma = np.radians(np.linspace(low, top, rows))
    force = bias_extension(gamma, LAWS[law].stress)
    force = force * (1 + noise * np.random.default_rng(seed).normal(size=rows))
    curve = Curve(force, displacement(gamma), None, (noise or 1e-3) * force)
    return Forces(force, curve.sigma, *OffAxis().shares(curve, T0, as_printed))


@cache
def _curve_of(given):
    return energy_method([_strip_test(given)])


@cache
def _fit_of(given):
    return fit([_strip_test(given)], _curve_of(given))


def strip_test(*given, **named):
    return _strip_test(case(*given, **named))


def curve_of(*given, **named):
    return _curve_of(case(*given, **named))


def fit_of(*given, **named):
    return _fit_of(case(*given, **named))


def frame_test(law, top, rows=100, side=100.0):
    gamma = np.radians(np.linspace(2.0, top, rows))
    force = picture_frame_force(gamma, side, LAWS[law].stress, T0)
    curve = Curve(force, picture_frame_displacement(gamma, side), None, 1e-3 * force)
    return Forces(force, curve.sigma, *PictureFrame(side).shares(curve, T0))


def error(stress, law, low, high):
    """Largest relative deviation of S12 between two shear angles, degrees."""
    I6 = np.sin(np.radians(np.linspace(low, high, 400)))
    return np.abs(stress(I6) / LAWS[law].stress(I6) - 1).max()


def values(law):
    return [getattr(law, name) for name in NAMES]


def states(found):
    return {p.name: p.state for p in found.parameters}


def intervals(found):
    return {p.name: (p.low, p.high) for p in found.parameters}


# Power balance


@pytest.mark.parametrize(("angle", "top"), [(45.0, 60.0), (30.0, 19.0), (38.0, 30.0)])
def test_shares_of_a_strip_give_its_force(angle, top):
    strip, law = OffAxis(angle=angle), LAWS["best-fit"]
    u = np.linspace(0.5, top, 60)
    shares, angles = strip.shares(Curve(u, u, None, u), T0)
    net = OffAxisTension(320.0, 160.0, np.radians(angle))
    assert_allclose((shares * law.stress(np.sin(angles))).sum(0), net.force(u, law.stress, T0))
    assert_allclose(angles[0], net.angles(u)[0])
    assert (angles[0] >= angles.max(axis=0)).all()


def test_bias_extension_has_a_full_zone_and_half_ones():
    gamma, law = np.radians(np.linspace(1.0, 70.0, 50)), LAWS["locking"]
    u = displacement(gamma)
    shares, angles = OffAxis().shares(Curve(u, u, None, u), T0)
    assert_allclose(angles, [gamma, gamma / 2, gamma / 2])
    found = (shares * law.stress(np.sin(angles))).sum(0)
    assert_allclose(found, bias_extension(gamma, law.stress))


def test_reference_forces():
    u = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    shares, angles = OffAxis().shares(Curve(u, u, None, u), T0)
    force = (shares * LAWS["best-fit"].stress(np.sin(angles))).sum(0)
    assert_array_equal(force.round(2), [8.07, 12.63, 15.68, 18.33, 23.95])


def test_a_measured_angle_of_a_strip_is_a_check_only():
    strip = OffAxis(angle=35.0)
    u = np.linspace(2.0, 20.0, 30)
    shares, angles = strip.shares(Curve(u, u, None, u), T0)
    gamma = angles[0]
    same, same_angles = strip.shares(Curve(u, u, 0.9 * gamma, u), T0)
    assert_array_equal(same, shares)
    assert_array_equal(same_angles, angles)
    alone, alone_angles = strip.shares(Curve(u, None, gamma, u), T0)  # no displacement
    assert_allclose(alone, shares)
    assert_allclose(alone_angles, angles)


@pytest.mark.parametrize("kind", ["kinematic", "computed", "measured", "given"])
def test_the_range_of_the_law_ends_where_the_angle_is_trusted(kind):
    test = strip_test("best-fit", 50.0, rows=60, low=0.0)
    gamma = np.degrees(test.angles[0])
    heading, columns = "displacement_mm,force_N", [displacement(test.angles[0]), test.force]
    if kind in ("computed", "measured"):
        columns.append({"computed": 1.0, "measured": 0.8}[kind] * gamma)
    table("a.csv", heading + ",shear_angle_deg" * (len(columns) > 2), *columns)
    found = qf.identify("a.csv", method="table", **({"to": 45.0} if kind == "given" else {}))
    end = {"kinematic": 30.0, "computed": 30.0, "measured": 40.0, "given": gamma[gamma < 45].max()}
    assert found.fabric.shear_range == pytest.approx(end[kind], abs=1e-6)
    words = {"measured": "angle measured", "given": "kinematic angle, the end is given"}
    words = words.get(kind, "kinematic angle, trusted to 30 degrees")
    assert found.fabric.provenance["shear_range"] == words
    assert error(found.fabric.shear.stress, "best-fit", 5.0, 42.0) < 5e-3  # the angle is no matter
    notices = " ".join(found.notices)
    assert ("was computed, not measured" in notices) == (kind == "computed")
    assert ("at the end 40.0 and 50.0 degrees" in notices) == (kind == "measured")
    assert ("shear_range ends at" in notices) == (kind != "given")


def test_the_rate_of_a_frame_follows_the_measured_angle():
    law, side = LAWS["best-fit"], 145.0
    frame = np.radians(np.linspace(1.0, 60.0, 800))
    gamma = frame - 0.15 * frame**2  # the fabric turns less than its frame
    u = picture_frame_displacement(frame, side)
    force = np.gradient(T0 * 110.0**2 * law.energy(np.sin(gamma)), u)
    shares, angles = PictureFrame(side, 110.0).shares(Curve(u, u, gamma, u), T0)
    assert_array_equal(angles[0], gamma)
    assert_allclose((shares[0] * law.stress(np.sin(gamma)))[1:-1], force[1:-1], rtol=1e-3)


def test_a_linkage_amplifies_the_displacement_of_the_machine():
    law, side, factor = LAWS["best-fit"], 145.0, 4.0
    gamma = np.radians(np.linspace(1.0, 60.0, 50))
    u = picture_frame_displacement(gamma, side)
    force = picture_frame_force(gamma, side, law.stress, T0)
    shares, angles = PictureFrame(side, None, factor).shares(Curve(u, u / factor, None, u), T0)
    assert_allclose(angles[0], gamma)
    assert_allclose(shares[0] * law.stress(np.sin(gamma)), factor * force)  # the same work


def test_half_zones_count_for_half_as_printed():
    u = np.linspace(2.0, 50.0, 10)
    shares, angles = OffAxis().shares(Curve(u, u, None, u), T0)
    printed, same = OffAxis().shares(Curve(u, u, None, u), T0, as_printed=True)
    assert_allclose(printed, shares * [[1.0], [0.5], [0.5]])
    assert_array_equal(same, angles)


def test_shares_of_a_picture_frame_give_its_force():
    gamma, law = np.radians(np.linspace(1.0, 65.0, 40)), LAWS["best-fit"]
    u = picture_frame_displacement(gamma, 145.0)
    force = picture_frame_force(gamma, 145.0, law.stress, T0)
    for curve in (Curve(u, u, None, u), Curve(u, None, gamma, u)):
        shares, angles = PictureFrame(145.0).shares(curve, T0)
        assert shares.shape == angles.shape == (1, 40)
        assert_allclose(angles[0], gamma)
        assert_allclose(shares[0] * law.stress(np.sin(gamma)), force)
    # the measured angle, not that of the hinges
    curve = Curve(u, u, 0.9 * gamma, u)
    assert_allclose(PictureFrame(145.0).shares(curve, T0)[1][0], 0.9 * gamma)


def test_less_fabric_than_frame():
    law, frame = LAWS["best-fit"], PictureFrame(145.0, fabric_side=110.0)
    gamma = np.radians(np.linspace(1.0, 60.0, 2000))
    u = picture_frame_displacement(gamma, 145.0)
    shares, _ = frame.shares(Curve(u, u, None, u), T0)
    energy = T0 * 110.0**2 * law.energy(np.sin(gamma))  # of the fabric alone
    force = np.gradient(energy, u)
    assert_allclose((shares[0] * law.stress(np.sin(gamma)))[1:-1], force[1:-1], rtol=1e-4)


def test_force_per_length_is_thickness_times_stress():
    gamma = np.radians(np.linspace(1.0, 60.0, 9))
    curve = Curve(gamma, None, gamma, gamma, per_length=True)
    shares, angles = PictureFrame(145.0, 110.0).shares(curve, 0.7)
    assert_array_equal(shares, np.full((1, 9), 0.7))
    assert_array_equal(angles, gamma[None])


FAR = np.linspace(1.0, 70.0, 10)  # mm
MOVED = Curve(FAR, FAR, None, FAR)
TURNED = Curve(FAR, None, 0.024 * FAR, FAR)  # to 96.26 degrees


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: OffAxis().shares(MOVED, T0), ["reaches 70 mm", "at 66.27 mm the net"]),
        (lambda: PictureFrame().shares(MOVED, T0), ["reaches 70 mm", "closes at 58.58 mm", "side"]),
        (lambda: OffAxis().shares(TURNED, T0), ["96.26 degrees", "limit of 90"]),
        (lambda: PictureFrame().shares(TURNED, T0), ["96.26 degrees", "limit of 90"]),
        (
            lambda: OffAxis().shares(replace(TURNED, displacement=FAR / 5), T0),
            ["96.26 degrees", "check its unit"],
        ),
        (lambda: OffAxis(length=160.0), ["fibres join both grips", "must exceed 160 mm"]),
        (lambda: OffAxis(angle=25.0), ["fibres join both grips"]),
        (lambda: OffAxis(width=-1.0), ["width must be a positive number", "-1.0"]),
        (lambda: PictureFrame(side=0), ["side must be a positive number", "got 0"]),
        (lambda: PictureFrame(fabric_side=-3), ["fabric_side must be", "-3"]),
    ],
)
def test_what_no_specimen_can_do_is_refused(make, words):
    with pytest.raises(InputError) as caught:
        make()
    message = str(caught.value)
    assert [word for word in words if word not in message] == []
    assert "\n" not in message


# Energy method


@pytest.mark.parametrize("law", LAWS)
def test_stress_without_noise(law):
    curve = curve_of(law, 50.0)
    assert error(curve.stress, law, 5.0, 47.6) < 1e-3
    assert error(curve.stress, law, 2.1, 49.9) < 5e-3
    assert_allclose([curve.low, curve.high], [2.0, 50.0])
    assert curve.misfit < 1e-4


def test_stress_is_odd_and_ends_with_the_tests():
    curve = curve_of("best-fit", 50.0)
    I6 = np.sin(np.radians([0.0, 5.0, 50.0]))
    assert_array_equal(curve.stress(-I6), -curve.stress(I6))
    assert np.isfinite(curve.stress(I6)).all()
    assert curve.stress(I6)[0] == 0
    assert np.isnan(curve.stress(np.sin(np.radians(50.1))))
    rise = np.diff(curve.stress(np.linspace(0.0, I6[-1], 2000)))
    assert (rise >= 0).all()


def test_law_through_the_curve():
    for law in LAWS:
        curve = curve_of(law, 50.0)
        table = curve.law()
        assert isinstance(table, qf.TabulatedLaw)
        I6 = np.sin(np.radians(np.linspace(2.0, 49.99, 500)))
        assert_allclose(table.stress(I6), curve.stress(I6), rtol=1e-3)


def test_as_printed_the_stress_is_too_high():
    I6 = np.sin(np.radians([5.0, 10.0, 20.0, 40.0]))
    printed = curve_of("best-fit", 58.0, as_printed=True)
    excess = printed.stress(I6) / LAWS["best-fit"].stress(I6) - 1
    assert_allclose(excess, [0.23, 0.26, 0.31, 0.39], atol=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_stress_with_noise(seed):
    curve = curve_of("best-fit", 50.0, noise=0.01, seed=seed)
    assert error(curve.stress, "best-fit", 5.0, 47.6) < 0.03
    assert 0.008 < curve.misfit < 0.012  # the noise: neither followed nor smoothed over


def test_band_of_two_deviations():
    I6 = np.sin(np.radians(np.linspace(5.0, 47.6, 200)))
    truth, inside, widths = LAWS["best-fit"].stress(I6), [], []
    for seed in range(5):
        curve = curve_of("best-fit", 50.0, noise=0.01, seed=seed)
        half = 2 * curve.deviation(I6)
        inside.append(np.mean(np.abs(curve.stress(I6) - truth) < half))
        widths.append(np.median(half / truth))
    assert np.mean(inside) >= 0.8
    assert max(widths) < 0.02  # and is no wider than two deviations of single rows


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_onset_of_locking_stays_sharp(noise):
    curve, law = curve_of("locking", 58.0, noise, rows=200), LAWS["locking"]
    assert error(curve.stress, "locking", 5.0, 56.0) < 0.06
    gamma = np.linspace(30.0, 57.9, 2000)
    I6 = np.sin(np.radians(gamma))
    twice = 2 * law.stress(np.sin(np.radians(50.0)))
    found, truth = (gamma[np.argmax(stress(I6) > twice)] for stress in (curve.stress, law.stress))
    assert 55.0 < truth < 56.0
    assert abs(found - truth) < 0.3


def test_two_tests_at_once():
    tests = [strip_test("best-fit", 30.0, rows=60), frame_test("best-fit", 58.0, rows=60)]
    curve = energy_method(tests)
    assert_allclose([curve.low, curve.high], [2.0, 58.0])
    assert error(curve.stress, "best-fit", 5.0, 56.0) < 2e-3
    # a tenth too much on the strip: seen only where it was tested, and shared with the frame
    high = replace(tests[0], force=1.1 * tests[0].force)
    I6 = np.sin(np.radians([20.0, 50.0]))
    both, alone = energy_method([high, tests[1]]), energy_method([high])
    early, late = both.stress(I6) / LAWS["best-fit"].stress(I6) - 1
    assert 0.02 < early < 0.08
    assert abs(late) < 0.02
    assert alone.stress(I6)[0] / LAWS["best-fit"].stress(I6)[0] - 1 == pytest.approx(0.1, abs=0.01)


def test_the_surer_test_counts_for_more():
    sure, doubtful = strip_test("best-fit", 30.0, rows=60), strip_test("best-fit", 30.0, rows=60)
    doubtful = replace(doubtful, force=1.1 * doubtful.force, sigma=30 * doubtful.sigma)
    curve = energy_method([sure, doubtful])
    assert error(curve.stress, "best-fit", 5.0, 28.0) < 5e-3


# Zero, preload and the load cell


def machine_csv(path, kind, law="locking", top=58.0, rows=400):
    """A machine's record with 0.6 % noise: of a preload of 1 N or a load cell's level of 1 N.

    The preload is there before the record starts, at a reading of 0.35 mm.
    """
    test = strip_test(law, top, rows=4000, low=0.0)
    u, force = displacement(test.angles[0]), test.force
    start = np.interp(1.0, force[:400], u[:400]) if kind == "preload" else 0.0
    at = np.linspace(start, u[-1], rows)
    measured = np.interp(at, u, force) + (1.0 if kind == "level" else 0.0)
    measured *= 1 + 0.006 * np.random.default_rng(0).standard_normal(rows)
    shift = 0.0 if kind == "clean" else 0.35 - start
    table = [f"{i / 10};{x:.4f};{f:.4f}" for i, (x, f) in enumerate(np.c_[at + shift, measured])]
    text = "\n".join(["Prüfzeit;Verschiebung;Kraft", "s;mm;N", *table]).replace(".", ",")
    Path(path).write_text(text + "\n", encoding="utf-8")


@pytest.mark.parametrize(("law", "top"), [("locking", 58.0), ("best-fit", 50.0)])
@pytest.mark.parametrize("kind", ["clean", "preload", "level"])
def test_a_machine_record_with_preload_and_offset(kind, law, top):
    machine_csv("m.csv", kind, law, top)
    found = qf.identify("m.csv")
    assert set(states(found.fitted).values()) == {"fitted"}
    assert found.fitted.misfit < 0.007
    assert_allclose(values(found.fabric.shear), values(LAWS[law]), rtol=0.3)
    assert found.fabric.shear.C_ini == pytest.approx(LAWS[law].C_ini, rel=0.03)
    words = {"clean": "", "preload": "a preload of 1 N", "level": "a level of the load cell"}[kind]
    (told,) = [n for n in found.notices if "shifted" in n] or [""]
    assert words in told
    assert ("--zero MM, --preload N" in told) == (kind != "clean")


# Fit


@pytest.mark.parametrize(
    ("law", "top", "algorithm"),
    [
        ("best-fit", 50.0, "least-squares"),
        ("locking", 58.0, "least-squares"),
        ("best-fit", 50.0, "nelder-mead"),
    ],
)
def test_parameters_without_noise(law, top, algorithm):
    given = {"rows": 200}
    found = fit([strip_test(law, top, **given)], curve_of(law, top, **given), None, algorithm)
    assert_allclose(values(found.law), values(LAWS[law]), rtol=1e-6)
    assert set(states(found).values()) == {"fitted"}
    assert [p.name for p in found.parameters] == list(NAMES)
    assert [p.value for p in found.parameters] == values(found.law)
    assert [p.unit for p in found.parameters] == ["MPa"] * 5 + ["1"]
    assert found.misfit < 1e-8
    onset = {"best-fit": np.arcsin(0.61), "locking": np.arcsin(0.819)}[law]
    assert_allclose(found.stages, np.degrees([np.arcsin(0.00386 / 0.334), onset]), rtol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_fitted_law_with_noise(seed):
    found = fit_of("best-fit", 50.0, noise=0.01, seed=seed)
    assert error(found.law.stress, "best-fit", 5.0, 47.6) < 0.02
    assert 0.008 < found.misfit < 0.012


def test_intervals_hold_the_truth():
    truth, inside = LAWS["best-fit"], dict.fromkeys(NAMES, 0)
    for seed in range(10):
        found = fit_of("best-fit", 50.0, noise=0.01, seed=seed)
        for name, (low, high) in intervals(found).items():
            inside[name] += low <= getattr(truth, name) <= high
    assert inside["C_ini"] >= 8
    assert inside["dS_mid"] >= 8
    assert inside["I_lo"] >= 8
    low, high = intervals(found)["C_ini"]
    assert 0.005 < (high - low) / truth.C_ini < 0.2  # for a reason


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_no_locking_within_the_tests(noise):
    found = fit_of("locking", 50.0, noise, rows=200)
    assert list(states(found).values())[4:] == ["not tested"] * 2
    assert states(found)["C_ini"] == states(found)["dS_mid"] == "fitted"
    assert found.law.C_lo == 0
    assert found.law.I_lo == pytest.approx(np.sin(np.radians(50.0)), rel=1e-9)
    assert np.isnan([intervals(found)["C_lo"], intervals(found)["I_lo"]]).all()
    assert_allclose(values(found.law)[:4:3], values(LAWS["locking"])[:4:3], rtol=0.05)


@pytest.mark.parametrize("algorithm", ["least-squares", "nelder-mead"])
def test_locking_is_kept_as_asked(algorithm):
    keep = {"C_lo": 1000.0, "I_lo": 0.819}
    found = fit([strip_test("locking", 50.0)], curve_of("locking", 50.0), keep, algorithm)
    assert (found.law.C_lo, found.law.I_lo) == (1000.0, 0.819)
    assert states(found) == dict.fromkeys(NAMES[:4], "fitted") | dict.fromkeys(keep, "kept")
    assert intervals(found)["C_lo"] == (1000.0, 1000.0)
    assert intervals(found)["I_lo"] == (0.819, 0.819)
    assert_allclose(values(found.law)[:4], values(LAWS["locking"])[:4], rtol=1e-5)


@pytest.mark.parametrize(
    "name",
    [
        "C_ini",
        "S_ini",
        "C_mid",
        "dS_mid",
        "C_lo",
        "I_lo",
    ],
)
def test_what_is_kept_stays_as_it_is(name):
    keep = {name: getattr(LAWS["best-fit"], name)}
    found = fit([strip_test("best-fit", 50.0)], curve_of("best-fit", 50.0), keep)
    assert getattr(found.law, name) == pytest.approx(keep[name], rel=1e-12)
    assert states(found)[name] == "kept"
    assert_allclose(values(found.law), values(LAWS["best-fit"]), rtol=1e-5)


def test_an_onset_kept_beyond_the_tests_brings_no_stiffness():
    keep = {"I_lo": 0.819}
    found = fit([strip_test("locking", 50.0)], curve_of("locking", 50.0), keep)
    assert (found.law.I_lo, states(found)["C_lo"]) == (0.819, "not tested")
    assert found.law.C_lo == 0


def test_a_law_that_is_kept_as_a_whole():
    keep = dict(zip(NAMES, values(LAWS["best-fit"]), strict=True))
    found = fit([strip_test("best-fit", 50.0)], curve_of("best-fit", 50.0), keep)
    assert found.law == LAWS["best-fit"]


def test_what_the_tests_do_not_see_is_not_identified():
    found = fit_of("best-fit", 10.0, noise=0.01, low=0.5)  # C_mid is the slope far beyond
    assert states(found)["C_ini"] == "fitted"
    assert states(found)["C_mid"] == "not identified"
    low, high = intervals(found)["C_mid"]
    assert low == 0
    assert high > 2 * found.law.C_mid
    assert low <= LAWS["best-fit"].C_mid <= high
    assert states(fit_of("best-fit", 50.0))["C_mid"] == "fitted"


def test_what_the_tests_do_not_see_stays_out_of_the_other_intervals():
    """From 2° on a plateau: the first stage and the step to it are one number for the forces."""
    law = qf.ThreeStageLaw(
        C_ini=6.27, S_ini=0.0209, C_mid=0.0234, dS_mid=0.00974, C_lo=3.53, I_lo=0.45
    )
    gamma = np.radians(np.linspace(2.0, 52.0, 80))
    force = 2.0 * law.stress(np.sin(gamma)) * (1 + 0.03 * np.sin(15 * gamma))
    test = Forces(force, 0.03 * force, np.full((1, 80), 2.0), gamma[None])
    unknowns = Unknowns(law, NAMES)
    p = np.ones(6)
    fun, jac = unknowns.residuals([test], p)
    found = report([test], unknowns, SimpleNamespace(x=p, fun=fun, jac=jac), {})
    unseen = dict.fromkeys(["C_ini", "S_ini", "dS_mid"], "not identified")
    assert states(found) == unseen | dict.fromkeys(["C_mid", "C_lo", "I_lo"], "fitted")
    assert {intervals(found)[name] for name in unseen} == {(0.0, np.inf)}
    for name, share in (("C_lo", 0.3), ("I_lo", 0.1)):
        low, high = intervals(found)[name]
        assert high - low < 2 * share * getattr(law, name)


@pytest.mark.parametrize(
    ("keep", "algorithm", "words"),
    [
        ({"C_l": 1.0}, "least-squares", ["[keep]", "unknown key 'C_l'", "did you mean 'C_lo'?"]),
        ({"C_lo": -1.0}, "least-squares", ["keep C_lo must be", "at least zero", "-1.0"]),
        ({"I_lo": 0.0}, "least-squares", ["keep I_lo must be a positive number", "0.0"]),
        ({"C_lo": "x"}, "least-squares", ["keep C_lo must be", "'x'"]),
        ({}, "simplex", ["unknown algorithm 'simplex'", "least-squares or nelder-mead"]),
    ],
)
def test_fits_that_are_refused(keep, algorithm, words):
    with pytest.raises(InputError) as caught:
        fit([strip_test("best-fit", 50.0)], curve_of("best-fit", 50.0), keep, algorithm)
    assert [word for word in words if word not in str(caught.value)] == []


# Elements in the loop


def sheet_of(strip, law, top, size, with_angle=False):
    """Finite-element model of a test with the forces and angles of inextensible fibres."""
    gamma = np.radians(np.linspace(2.0, top, 40))
    u = displacement(gamma, strip)
    force = strip.net.force(u, LAWS[law].stress, T0)
    curve = Curve(force, u, gamma if with_angle else None, 0.01 * force)
    forces = Forces(force, curve.sigma, *strip.shares(curve, T0))
    return Sheet(strip, curve, forces, FABRICS[law], size, LAWS[law]), curve


def by_elements(sheet, curve, law, with_angle=False):
    """The test that the model itself would measure."""
    angle = None
    if with_angle:
        centre = [sheet.angle(x) for x in sheet.states(LAWS[law])]
        angle = sheet.to_rows @ np.radians(centre)
    force = sheet.predicted(LAWS[law])
    return Curve(force, curve.displacement, angle, 0.01 * force)


@pytest.mark.parametrize(("angle", "with_angle"), [(45.0, False), (45.0, True), (35.0, True)])
def test_derivatives_by_the_parameters(angle, with_angle):
    sheet, _ = sheet_of(OffAxis(angle=angle), "best-fit", 45.0, 40.0, with_angle)
    unknowns = Unknowns(LAWS["best-fit"], NAMES)
    p = 1.02 * unknowns.start  # no residual is zero, and no row at an onset
    r, J = sheet.residual(unknowns, p)
    assert r.shape == ((80 if with_angle else 40),) == (sheet.rows,)
    for i, name in enumerate(unknowns.free):
        h = np.zeros(6)
        h[i] = 1e-3 * p[i]
        above, below = (sheet.residual(unknowns, p + s * h)[0] for s in (1, -1))
        central = (above - below) / (2 * h[i])
        for part in (slice(0, 40), slice(40, None))[: 1 + with_angle]:
            size = np.abs(J[part, i]).max()
            assert size > 0, name
            assert np.abs(central - J[:, i])[part].max() < 1e-4 * size, name


def test_derivatives_of_a_frame():
    frame = frame_test("best-fit", 50.0, rows=30)
    unknowns = Unknowns(LAWS["best-fit"], NAMES)
    p = 1.02 * unknowns.start
    r, J = frame.residual(unknowns, p)
    test = frame
    assert_allclose(r, (test.predicted(unknowns.law(p)) - test.force) / test.sigma)
    step = np.array([1e-3, -2e-3, 1e-3, 2e-3, -1e-3, 1e-4])
    above, below = (frame.residual(unknowns, p + s * step * p)[0] for s in (1, -1))
    expected = J @ (2 * step * p)
    assert np.abs(above - below - expected).max() < 1e-3 * np.abs(expected).max()


def test_the_law_of_a_finite_element_test_comes_back():
    strip = OffAxis(angle=30.0)
    top = float(np.degrees(strip.net.angles(18.0)[0]))
    gamma = np.radians(np.linspace(2.0, top, 40))
    u = displacement(gamma, strip)
    scene = qf.off_axis_tension(30.0, FABRICS["best-fit"], displacement=18.0, size=28.0)
    history = qf.solve(scene, increment=0.9, estimate=False, tolerance=1e-6).history
    at, force = history["displacement_mm"][1:], history["force_N"][1:]
    stress = LAWS["best-fit"].stress
    ratio = np.interp(u, at, force / strip.net.force(at, stress, T0))
    force = ratio * strip.net.force(u, stress, T0)
    test = ShearTest("by elements", strip, Curve(force, u, None, 1e-3 * force))
    campaign = Campaign("by elements", FABRICS["best-fit"], (test,), size=28.0)
    off = {
        method: error(
            qf.identify(campaign, method=method).fabric.shear.stress, "best-fit", 5.0, 0.95 * top
        )
        for method in ("fit", "inverse")
    }
    assert off["inverse"] < 2e-3
    assert off["fit"] > 1e-2  # which is what the elements are for


def test_the_truth_leaves_no_residual():
    strip = OffAxis(angle=35.0)
    sheet, curve = sheet_of(strip, "best-fit", 45.0, 40.0)
    measured = by_elements(sheet, curve, "best-fit")
    forces = Forces(measured.force, measured.sigma, *strip.shares(measured, T0))
    own = Sheet(strip, measured, forces, FABRICS["best-fit"], 40.0, LAWS["best-fit"])
    unknowns = Unknowns(LAWS["best-fit"], NAMES)
    assert np.abs(own.residual(unknowns, unknowns.start)[0]).max() < 1e-6


def test_the_truth_leaves_no_residual_with_a_measured_angle():
    strip = OffAxis(angle=35.0)
    sheet, curve = sheet_of(strip, "best-fit", 45.0, 40.0)
    measured = by_elements(sheet, curve, "best-fit", with_angle=True)
    forces = Forces(measured.force, measured.sigma, *strip.shares(measured, T0))
    own = Sheet(strip, measured, forces, FABRICS["best-fit"], 40.0, LAWS["best-fit"])
    unknowns = Unknowns(LAWS["best-fit"], NAMES)
    assert np.abs(own.residual(unknowns, unknowns.start)[0]).max() < 0.05


def noisy_strip(seed, **settings):
    """Campaign of 40 rows at 45° with 1 % noise."""
    test = strip_test("best-fit", 50.0, 0.01, seed, rows=40)
    curve = Curve(test.force, displacement(test.angles[0]), None, test.sigma)
    shear = ShearTest("noisy", OffAxis(), curve)
    return Campaign("noisy", FABRICS["best-fit"], (shear,), size=40.0, **settings)


def test_locking_in_the_loop_beside_what_is_kept():
    found = qf.identify(noisy_strip(0, keep={"C_ini": 0.334}), method="inverse")
    assert states(found)["C_ini"] == "kept"
    assert states(found)["C_lo"] == states(found)["I_lo"] == "fitted"
    assert not any("no locking" in notice for notice in found.notices)


@pytest.mark.parametrize("keep", [{"I_lo": 0.61}, {"I_lo": 0.95}, {"C_lo": 1000.0}])
def test_elements_leave_alone_what_is_kept_of_locking(keep):
    found = qf.identify(noisy_strip(0, keep=keep), method="inverse")
    (name,) = keep
    assert getattr(found.fabric.shear, name) == keep[name]
    assert states(found)[name] == "kept"
    assert states(found)["C_lo"] == {0.61: "fitted", 0.95: "not tested", 1000.0: "kept"}[keep[name]]


def test_elements_move_a_parameter_that_the_balance_left_at_zero():
    campaign = noisy_strip(2)
    assert qf.identify(campaign).fabric.shear.C_mid < 1e-9
    found = qf.identify(campaign, method="inverse")
    assert np.isfinite([intervals(found)[name] for name in NAMES]).all()
    assert states(found)["C_ini"] == states(found)["C_lo"] == "fitted"


def test_a_test_without_equilibrium_at_the_start_is_refused(monkeypatch):
    def fails(*_):
        raise NotConvergedError("no equilibrium")

    monkeypatch.setattr(Sheet, "states", fails)
    with pytest.raises(InputError, match="a test finds no equilibrium under the law"):
        qf.identify(noisy_strip(0), method="inverse")


# Campaign


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty working directory for every test."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def table(path, heading, *columns):
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=heading, comments="")


@pytest.fixture
def undrawn(monkeypatch):
    """Write a placeholder for the picture, where a test is about other things."""
    monkeypatch.setattr(picture, "save_picture", lambda _, path: Path(path).write_bytes(b""))


def strip_csv(path, law="best-fit", top=50.0, noise=0.0, seed=0, rows=100):
    """Record of a strip at 45°."""
    test = strip_test(law, top, noise, seed, rows=rows, low=0.0)
    table(path, "displacement_mm,force_N", displacement(test.angles[0]), test.force)


def overhang(B, k=5.0, areal_weight=600.0):
    """Length (mm) and angle (degrees) of a strip of stiffness B, N mm, that bends by k."""
    x, drop, _ = heavy_elastica(k)
    weight = areal_weight * 9.81e-9  # N/mm²
    return (k * B / weight) ** (1 / 3), np.degrees(np.arctan2(drop, x))


CAMPAIGN = """\
name = "my fabric"
standing = "made up"

[fabric]
base = "best-fit"
thickness = 1.004
areal_weight = 500.0
friction = 0.2

[[tests]]
kind = "off-axis"
files = ["a.csv", "b.csv"]

[[tests]]
kind = "picture-frame"
files = ["lab/frame.csv"]
side = 145.0
to = 45.0
units = {{ force = "kN" }}

[[tests]]
kind = "cantilever"
family = "warp"
overhang = [{warp}, {warp}]
angle = {angle}

[[tests]]
kind = "cantilever"
family = "weft"
overhang = {weft}
angle = {angle}
"""


@pytest.mark.usefixtures("undrawn")
def test_a_campaign_becomes_a_fabric(here):
    for name, seed in (("a.csv", 1), ("b.csv", 2)):
        strip_csv(name, noise=0.01, seed=seed)
    gamma = np.radians(np.linspace(0.0, 55.0, 80))
    force = picture_frame_force(gamma, 145.0, LAWS["best-fit"].stress, T0)
    Path("lab").mkdir()
    u = picture_frame_displacement(gamma, 145.0)
    table("lab/frame.csv", "displacement_mm,force", u, force / 1e3)
    (warp, angle), (weft, _) = overhang(3.0, areal_weight=500.0), overhang(4.0, areal_weight=500.0)
    Path("mine.toml").write_text(
        CAMPAIGN.format(warp=warp, weft=weft, angle=angle), encoding="utf-8"
    )

    found = qf.identify("mine.toml")
    fabric, campaign = found.fabric, found.campaign
    assert (fabric.name, fabric.friction, fabric.areal_weight) == ("my fabric", 0.2, 500.0)
    assert_allclose([fabric.bending_warp, fabric.bending_weft], [3.0, 4.0], rtol=1e-3)
    assert error(fabric.shear.stress, "best-fit", 5.0, 47.0) < 0.02
    assert fabric.shear_range == pytest.approx(45.0, abs=1.0)  # of the frame
    assert fabric.warp == FABRICS["best-fit"].warp
    strip, frame = campaign.shear
    assert (strip.name, frame.name) == ("a.csv + b.csv", "frame.csv")
    assert frame.forces(T0).angles.max() <= np.radians(45.0)
    assert strip.forces(T0).angles[0].min() >= np.radians(0.5)
    assert_allclose(frame.curve.force.max(), np.interp(np.pi / 4, gamma, force), rtol=0.1)
    assert any("2 repeats" in notice for notice in found.notices)
    assert any("bending_warp by Peirce" in notice for notice in found.notices)
    assert [p.name for p in found.parameters] == [*NAMES, "bending_warp", "bending_weft"]
    assert states(found)["bending_weft"] == "fitted"

    given = fabric.provenance
    assert (given["standing"], given["date"]) == ("made up", date.today().isoformat())
    for number, path in enumerate(["mine.toml", "a.csv", "b.csv", "lab/frame.csv"], start=1):
        assert given[f"source_{number}"] == Path(path).name
        assert given[f"sha256_{number}"] == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    assert "source_5" not in given

    # a lone overhang has no scatter, which is no number in JSON
    found.save("out")
    summary = json.loads(Path("out/summary.json").read_text(encoding="utf-8"), parse_constant=int)
    weft = summary["parameters"][-1]
    assert (weft["name"], weft["low"], weft["high"]) == ("bending_weft", None, None)


def test_bending_alone(here):
    length, angle = overhang(3.0)
    text = f'[[tests]]\nkind="cantilever"\nfamily="warp"\noverhang={length}\nangle={angle}\n'
    Path("bend.toml").write_text(text, encoding="utf-8")
    found = qf.identify("bend.toml")
    assert (found.curve, found.fitted, found.fabric.name) == (None, None, "bend")
    assert found.fabric.shear == LAWS["locking"]
    found.save("out")
    names = {path.name for path in Path("out").iterdir()}
    assert names == {"material.toml", "parameters.csv", "summary.json"}
    assert qf.Fabric.load("out/material.toml") == found.fabric


BIAS = '[[tests]]\nkind = "off-axis"\nfiles = ["a.csv"]\n'
BEND = '[[tests]]\nkind = "cantilever"\nfamily = "warp"\noverhang = 160.0\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no tests", "[[tests]]"]),
        ('[tests]\nkind = "off-axis"\n', ["tests: expected tables [[tests]]"]),
        (
            BIAS.replace("off-axis", "of-axis"),
            ["[tests 1] kind = 'of-axis'", "did you mean 'off-axis'?"],
        ),
        ('[[tests]]\nfiles = ["a.csv"]\n', ["[tests 1] kind missing", "off-axis, picture-frame"]),
        ('method = "tabel"\n' + BIAS, ["unknown method 'tabel'", "did you mean 'table'?"]),
        ('algorithm = "x"\n' + BIAS, ["unknown algorithm 'x'", "expected one of least-squares"]),
        ('metod = "fit"\n' + BIAS, ["unknown key 'metod'", "did you mean 'method'?"]),
        (BIAS + "lenght = 3\n", ["[tests 1] unknown key 'lenght'", "'length'?"]),
        (BIAS + "side = 3\n", ["[tests 1] unknown key 'side'", "width, angle"]),
        (BIAS + BEND + "with = 3\n", ["[tests 2] unknown key 'with'"]),
        ("[fabric]\nthicknes = 1\n" + BIAS, ["[fabric] unknown key 'thicknes'", "'thickness'?"]),
        ("[fabric]\nthickness = -1.0\n" + BIAS, ["thickness", "positive number", "-1.0"]),
        ('[fabric]\nbase = "loking"\n' + BIAS, ["unknown law 'loking'", "'locking'?"]),
        ("fabric = 3\n" + BIAS, ["fabric = 3: expected a table [fabric]"]),
        (BIAS.replace("a.csv", "no.csv"), ["no.csv: No such file"]),
        (BIAS.replace('["a.csv"]', "5"), ["[tests 1] files = 5: expected a list of files"]),
        (BIAS.replace('["a.csv"]', "[]"), ["[tests 1] files = []: expected a list of files"]),
        (BIAS.replace('["a.csv"]', "[1]"), ["[tests 1] files = [1]: expected a list"]),
        (BIAS + "to = 2.0\n", ["a.csv: only 3 rows", "between 0.5 and 2 degrees", "at least 8"]),
        (BIAS + "from = 60.0\n", ["a.csv: only 0 rows", "between 60 and 90 degrees"]),
        (BIAS + 'zero = "x"\n', ["[tests 1] zero = 'x': expected a number or auto"]),
        (BIAS + "cycle = 0\n", ["[tests 1] cycle = 0: expected last, first, envelope or a num"]),
        (BIAS + 'to = "x"\n', ["[tests 1] to must be a positive number", "'x'"]),
        (BIAS + "length = 200.0\n", ["a.csv: the displacement reaches 52.6", "at 16.57 mm"]),
        (BIAS + "angle = 20.0\n", ["[tests 1] fibres join both grips"]),
        (BEND + BEND, ["[tests 2] family 'warp' is there twice"]),
        (BEND.replace("warp", "wrap"), ["[tests 1] family = 'wrap'", "did you mean 'warp'?"]),
        (BEND + "tip = [[1.0, 2.0]]\n", ["[tests 1] expected one of overhang, tip, profile"]),
        (
            'method = "table"\nkeep = { C_lo = 1.0 }\n' + BIAS,
            ["a table has no parameters to keep", "'fit' or 'inverse'"],
        ),
        (
            'method = "inverse"\nalgorithm = "nelder-mead"\n' + BIAS,
            ["the inverse method", "'least-squares'"],
        ),
        ("keep = 3\n" + BIAS, ["keep = 3: expected a table"]),
        ("size = -1\n" + BIAS, ["size must be a positive number, got -1"]),
        ("name = 3\n" + BIAS, ["name must be a text, got 3"]),
        ("standing = 3\n" + BIAS, ["standing must be a text, got 3"]),
        ("name = = 3\n", ["line 1"]),
    ],
)
def test_a_wrong_campaign_is_refused(text, words):
    strip_csv("a.csv")
    Path("mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load("mine.toml")
    message = str(caught.value)
    assert message.startswith("mine.toml: ")
    assert "\n" not in message
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize(
    "text",
    [
        BIAS + "columns = 5\n",
        BIAS + 'columns = "force"\n',
        BIAS + "units = { force = 5 }\n",
        BIAS.replace('"off-axis"', '["off-axis"]'),
        'method = ["fit"]\n' + BIAS,
    ],
)
def test_a_value_of_the_wrong_kind_is_refused(text):
    strip_csv("a.csv")
    Path("mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"^mine\.toml: "):
        load("mine.toml")


def test_settings_of_a_csv_file():
    strip = OffAxis(300.0, 100.0, 40.0)
    gamma = np.radians(np.linspace(0.0, 45.0, 60))
    u = displacement(gamma, strip)
    table("s.csv", "displacement_mm,force_N", u, strip.net.force(u, LAWS["best-fit"].stress, 0.5))
    size = {"length": 300.0, "width": 100.0, "angle": 40.0, "thickness": 0.5}
    campaign = load("s.csv", **size, name="mine", keep={"C_lo": 0.911}, method="fit")
    (test,) = campaign.shear
    assert test.specimen == strip
    assert (campaign.name, campaign.method, campaign.keep) == ("mine", "fit", {"C_lo": 0.911})
    assert (campaign.fabric.thickness, campaign.sources) == (0.5, (Path("s.csv"),))
    found = qf.identify(campaign)
    assert error(found.fabric.shear.stress, "best-fit", 5.0, 42.0) < 2e-3
    assert found.fabric.provenance["kept"] == "C_lo = 0.911"


def test_settings_stand_over_the_file():
    strip_csv("a.csv")
    Path("mine.toml").write_text('method = "table"\nname = "x"\n' + BIAS, encoding="utf-8")
    campaign = load("mine.toml", method="fit", name="y")
    assert (campaign.method, campaign.name) == ("fit", "y")
    assert load("mine.toml").method == "table"


@pytest.mark.usefixtures("undrawn")
def test_a_frame_from_a_csv_file():
    gamma = np.linspace(0.0, 50.0, 60)
    S12 = LAWS["best-fit"].stress(np.sin(np.radians(gamma)))
    table("f.csv", "shear_angle_deg,shear_force [N/mm]", gamma, 0.8 * S12)
    found = qf.identify("f.csv", kind="picture-frame", thickness=0.8, method="table")
    assert error(found.fabric.shear.stress, "best-fit", 5.0, 47.0) < 2e-3
    assert isinstance(found.fabric.shear, qf.TabulatedLaw)
    assert found.fitted is None
    assert found.parameters == ()
    with pytest.raises(InputError, match=r"f\.csv: a force per length is that of a picture frame"):
        load("f.csv")
    found.save("out")
    assert qf.Fabric.load("out/material.toml") == found.fabric
    assert json.loads(Path("out/summary.json").read_text())["stages_deg"] is None


@pytest.mark.parametrize(
    "heading", ["displacement_mm,force_N,shear_angle_deg", "force_N,shear_angle_deg"]
)
def test_a_measured_angle_may_begin_at_zero(heading):
    test = strip_test("best-fit", 50.0, rows=60, low=0.0)
    columns = [displacement(test.angles[0]), test.force, np.degrees(test.angles[0])]
    table("a.csv", heading, *columns[-1 - heading.count(",") :])
    (test,) = load("a.csv").shear
    assert np.isfinite(test.forces(T0).shares).all()


def test_unusable_settings_of_a_csv_file():
    strip_csv("a.csv")
    for given, word in (
        ({"angel": 30.0}, "did you mean 'angle'?"),
        ({"kind": "frame"}, "kind = 'frame'"),
        ({"thickness": -1.0}, "thickness"),
        ({"side": 100.0}, "side is not a size of the off-axis test"),
        ({"method": "tabel"}, "did you mean 'table'?"),
    ):
        with pytest.raises(InputError) as caught:
            load("a.csv", **given)
        assert word in str(caught.value)
    with pytest.raises(InputError, match=r"b\.csv: No such file"):
        load("b.csv")


# Files


def rows_of(path):
    with Path(path).open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_what_is_saved(here):
    strip_csv("a.csv", "locking", noise=0.01)
    found = qf.identify("a.csv", name="mine")
    assert found.save("out") == Path("out")
    out = here / "out"
    assert {path.name for path in out.iterdir()} == FILES

    fabric = qf.Fabric.load(out / "material.toml")
    assert fabric == found.fabric
    assert fabric.name == "mine"
    given = fabric.provenance
    assert given["sha256_1"] == hashlib.sha256(Path("a.csv").read_bytes()).hexdigest()
    assert (given["standing"], given["source_1"]) == ("measured", "a.csv")
    assert given["date"] == date.today().isoformat()
    assert given["tested_to_deg"] == pytest.approx(50.0, abs=0.01)
    assert given["force_misfit_percent"] == pytest.approx(100 * found.fitted.misfit, rel=1e-2)

    head, *rows = rows_of(out / "parameters.csv")
    assert head == ["name", "value", "low_95", "high_95", "unit", "state"]
    assert [row[0] for row in rows] == list(NAMES)
    assert_allclose([float(row[1]) for row in rows], values(fabric.shear), rtol=1e-6)
    assert [row[5] for row in rows][-2:] == ["not tested"] * 2

    head, *rows = rows_of(out / "stress.csv")
    assert head == ["shear_angle_deg", "S12_MPa", "S12_low_MPa", "S12_high_MPa", "S12_law_MPa"]
    gamma, S, low, high, law = np.array(rows, dtype=float).T
    I6 = np.sin(np.radians(gamma))
    assert_allclose([gamma[0], gamma[-1]], [found.curve.low, found.curve.high], rtol=1e-6)
    assert_allclose(S[:-1], found.curve.stress(I6[:-1]), rtol=1e-6)
    assert_allclose(law, fabric.shear.stress(I6), rtol=1e-6)
    assert_allclose((high - S)[:-1], 2 * found.curve.deviation(I6[:-1]), rtol=1e-4)
    assert (low <= S).all()
    assert np.isfinite(high).all()

    def no_constant(word):
        raise AssertionError(word)

    text = (out / "summary.json").read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=no_constant)
    assert summary["case"] == "mine"
    assert summary["provenance"] == dict(given)
    assert [p["name"] for p in summary["parameters"]] == list(NAMES)
    assert summary["parameters"][-1]["low"] is None
    assert summary["parameters"][0]["low"] == found.parameters[0].low
    assert any("no locking up to 50.0 degrees" in notice for notice in summary["notices"])
    assert summary["stages_deg"] == list(found.fitted.stages)
    drawn = (out / "identification.png").read_bytes()
    assert drawn.startswith(b"\x89PNG")
    assert len(drawn) > 20_000


@pytest.mark.parametrize(("thickness", "drawn"), [(1.0, 2), (1.6, 2), (6.0, 0)])
def test_the_picture_hides_no_data(thickness, drawn, monkeypatch):
    figures = []
    draw = picture._draw_stress
    monkeypatch.setattr(
        picture, "_draw_stress", lambda axes, found: (figures.append(axes), draw(axes, found))
    )
    name = "a long name of a test on a fabric in a laboratory.csv"
    strip_csv(name, "best-fit", rows=60)
    text = f'standing = "{name}"\n[fabric]\nthickness = {thickness}\n' + 3 * BIAS
    Path("a.toml").write_text(text.replace("a.csv", name), encoding="utf-8")
    picture.save_picture(qf.identify("a.toml"), "a.png")
    (axes,) = figures
    axes.figure.set_dpi(picture.DPI)  # of the file
    axes.figure.draw_without_rendering()
    for each in axes.figure.axes:
        legend, inside = each.get_legend().get_window_extent(), each.get_window_extent()
        assert not legend.overlaps(inside)
        assert inside.width > 0.35 * axes.figure.bbox.width
        assert inside.height > 0.35 * axes.figure.bbox.height
        assert axes.figure.bbox.x0 <= legend.x0 < legend.x1 <= axes.figure.bbox.x1
        assert axes.figure.bbox.y0 <= legend.y0
    words = [
        text.get_text() for text in axes.get_legend().get_texts() if "MD600" in text.get_text()
    ]
    assert len(words) == 2
    assert sum("not drawn, over 3 times as high" in text for text in words) == 2 - drawn
    presets = [line for line in axes.lines if "MD600" in line.get_label() and len(line.get_xdata())]
    assert len(presets) == drawn
    for line in presets:  # on the axis, as far as the tests go
        gamma, stress = line.get_data()
        assert stress[gamma <= 50.0].max() < axes.get_ylim()[1]
        assert stress[gamma <= 50.0].max() > 0.04


def test_a_preset_that_locks_within_the_tests_is_drawn_up_to_there():
    onset = LAWS["locking"].stress(0.819)
    assert picture._tallest(FABRICS["locking"], 60.0, 0.1) == pytest.approx(onset)
    assert picture._tallest(FABRICS["locking"], 60.0, 0.01) is None
    assert picture._tallest(FABRICS["locking"], 60.0, 10.0) > 1.0


# What was not tested


def test_each_value_says_where_it_comes_from(here):
    strip_csv("a.csv", rows=60)
    found = qf.identify("a.csv", thickness=1.2, method="table")
    given = found.fabric.provenance
    assert (given["standing"], given["standing_of"]) == ("measured", "shear")
    assumed = "assumed: that of MD600 locking"
    others = ("warp", "weft", "bending_warp", "bending_weft", "friction", "areal_weight")
    others += ("compaction", "in_plane_bending")
    assert {name: given[name] for name in others} == dict.fromkeys(others, assumed)
    assert (given["thickness"], given["shear"]) == ("given", "measured")
    assert f"not in these tests, taken from MD600 locking: {', '.join(others)}" in found.notices
    found.save("out")
    lines = Path("out/material.toml").read_text(encoding="utf-8").splitlines()
    for line in ("friction = 0.157  # assumed: that of MD600 locking", "thickness = 1.2  # given"):
        assert line in lines
    assert "[shear]  # measured" in lines
    assert "[weft]  # assumed: that of MD600 locking" in lines
    assert qf.Fabric.load("out/material.toml") == found.fabric
    # a fabric that is the base of another: what was measured stays so, what was assumed too
    length, angle = overhang(3.0)
    Path("bend.toml").write_text(
        f'[fabric]\nbase = "out/material.toml"\nareal_weight = 600.0\n[[tests]]\n'
        f'kind = "cantilever"\nfamily = "warp"\noverhang = {length}\nangle = {angle}\n',
        encoding="utf-8",
    )
    given = qf.identify("bend.toml").fabric.provenance
    assert given["standing_of"] == "bending_warp"
    assert (given["bending_warp"], given["areal_weight"]) == ("measured", "given")
    assert (given["shear"], given["friction"]) == ("that of a: measured", assumed)


def test_what_a_measured_value_owes_to_an_assumed_one():
    strip_csv("a.csv", "locking", top=40.0, rows=60)
    given = qf.identify("a.csv", keep={"C_mid": 0.00196}).fabric.provenance
    words = "measured, with an assumed thickness; kept: C_mid; not tested: C_lo, I_lo"
    assert given["shear"] == words
    length, angle = overhang(3.0)
    text = f'[[tests]]\nkind="cantilever"\nfamily="warp"\noverhang={length}\nangle={angle}\n'
    Path("bend.toml").write_text(text, encoding="utf-8")
    given = qf.identify("bend.toml").fabric.provenance
    assert given["bending_warp"] == "measured, with an assumed areal_weight"
    assert given["shear"] == "assumed: that of MD600 locking"


def test_a_note_beside_a_value_stays_one_line(here):
    fabric = qf.Fabric(provenance={"friction": "of\na lab\x07", "thickness": 3, "shear": "x"})
    fabric.save("f.toml")
    text = Path("f.toml").read_text(encoding="utf-8")
    assert "friction = 0.157  # of a lab \n" in text
    assert "thickness = 1.004\n" in text
    assert qf.Fabric.load("f.toml") == fabric


@pytest.mark.usefixtures("undrawn")
def test_a_result_stays_unless_it_shall_be_replaced(here):
    strip_csv("a.csv")
    found = qf.identify("a.csv", method="table")
    out = Path("out")
    out.mkdir()
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    (out / "stress.csv").write_text("old", encoding="utf-8")
    with pytest.raises(InputError, match=r"out holds a result already \(stress\.csv\)"):
        found.save(out)
    assert {p.name: p.read_text() for p in out.iterdir()} == {
        "notes.txt": "mine",
        "stress.csv": "old",
    }
    found.save(out, force=True)
    assert {p.name for p in out.iterdir()} == FILES | {"notes.txt"}
    assert (out / "stress.csv").read_text(encoding="utf-8").startswith("shear_angle_deg")


# Command line


def assert_refused(capsys, argv, *words):
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("quasiform: ")
    assert err.count("\n") == 1
    assert [word for word in words if word not in err] == []


def test_identify_and_use_what_was_found(capsys, here):
    strip_csv("data.csv")
    assert main(["identify", "data.csv", "--out", "x", "--name", "my own"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert {path.name for path in Path("x").iterdir()} == FILES
    lines = [line.split() for line in out.splitlines()]
    shown = {line[0]: float(line[1]) for line in lines if line and line[0] in NAMES}
    assert list(shown) == list(NAMES)
    assert_allclose(list(shown.values()), values(LAWS["best-fit"]), rtol=0.02)
    assert "my own" in out
    assert [name for name in FILES if name not in out] == []
    assert qf.Fabric.load("x/material.toml").name == "my own"

    coarse = ["--size", "80", "--displacement", "5", "--out"]
    assert main(["oat", "--law", "x/material.toml", *coarse, "mine"]) == 0
    assert "fabric: my own" in capsys.readouterr().out
    assert main(["oat", "--law", "best-fit", *coarse, "paper"]) == 0
    mine, paper = (json.loads(Path(n, "summary.json").read_text()) for n in ("mine", "paper"))
    assert mine["force_N"] == pytest.approx(paper["force_N"], rel=2e-3)


@pytest.mark.usefixtures("undrawn")
def test_kept_parameters_and_the_folder(capsys, here):
    strip_csv("data.csv", "locking", top=45.0, rows=60)
    argv = ["identify", "data.csv", "--keep", "I_lo=0.8,C_lo=5", "--algorithm", "nelder-mead"]
    assert main(argv) == 0
    out = capsys.readouterr().out
    assert sum(line.split()[-1:] == ["kept"] for line in out.splitlines()) == 2
    fabric = qf.Fabric.load("data-fabric/material.toml")
    assert (fabric.shear.I_lo, fabric.shear.C_lo) == (0.8, 5.0)
    assert fabric.provenance["algorithm"] == "nelder-mead"
    before = {path.name: path.read_bytes() for path in Path("data-fabric").iterdir()}
    assert_refused(capsys, [*argv, "--out", "data-fabric"], "holds a result already")
    assert before == {path.name: path.read_bytes() for path in Path("data-fabric").iterdir()}


@pytest.mark.usefixtures("undrawn")
def test_options_of_the_test(capsys, here):
    gamma = np.radians(np.linspace(0.0, 50.0, 60))
    force = picture_frame_force(gamma, 200.0, LAWS["best-fit"].stress, 0.5)
    table("f.csv", "displacement_mm,force_N", picture_frame_displacement(gamma, 200.0), force)
    line = "identify f.csv --kind picture-frame --side 200 --thickness 0.5 --method table --out f"
    assert main(line.split()) == 0
    fabric = qf.Fabric.load("f/material.toml")
    assert fabric.thickness == 0.5
    assert error(fabric.shear.stress, "best-fit", 5.0, 47.0) < 2e-3


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("missing.csv", ["missing.csv: No such file"]),
        ("missing.toml", ["missing.toml: No such file"]),
        ("words.csv", ["words.csv: no rows of two or more numbers"]),
        ("data.csv --keep X=1", ["--keep", "unknown parameter 'X'", "expected one of C_ini"]),
        ("data.csv --keep I_lo", ["--keep", "expected NAME=VALUE", "'I_lo'"]),
        ("data.csv --keep C_lo=5,I_l=0.8", ["--keep", "'I_l'", "did you mean 'I_lo'?"]),
        ("data.csv --method tabel", ["--method", "'tabel'", "did you mean 'table'?"]),
        ("data.csv --algorithm simplex", ["--algorithm", "'simplex'"]),
        ("data.csv --kind of-axis", ["--kind", "'of-axis'", "did you mean 'off-axis'?"]),
        ("data.csv --method table --keep C_lo=5", ["a table has no parameters to keep"]),
        ("data.csv --thickness 0", ["--thickness", "positive number"]),
        ("data.csv --thicknes 1", ["unknown option '--thicknes'", "'--thickness'?"]),
        ("data.csv --columns forse=2", ["--columns", "'forse'", "did you mean 'force'?"]),
        ("data.csv --columns force=", ["--columns", "expected NAME=WORD,..."]),
        ("data.csv --columns force=Kraft", ["'Kraft' not found", "'force_N'"]),
        ("data.csv --units force=kp", ["unknown unit 'kp' of the force"]),
        ("bias.toml --columns force=2", ["bias.toml: columns belongs into", "[[tests]]"]),
        ("bias.toml --thickness 2", ["bias.toml: thickness belongs into", "[fabric]"]),
        ("odd.csv", ["odd.csv: no column of a displ", '--columns displacement="Way, left (mm)"']),
        ("data.csv --angle 20", ["fibres join both grips"]),
        ("data.csv --to -3", ["--to", "positive number"]),
        ("data.csv --zero start", ["--zero", "expected a number or auto, got 'start'"]),
        ("data.csv --preload x", ["--preload", "expected a number or auto"]),
        ("data.csv --cycle 0", ["--cycle", "expected last, first, envelope or a number from 1"]),
        ("data.csv --cycle 2", ["data.csv: cycle 2 is not in the record, which has 1 cycle"]),
        ("bias.toml --to 40", ["bias.toml: to belongs into", "[[tests]]"]),
        ("data.csv --length 250", ["data.csv: ", "at 37.28 mm"]),
        ("", ["FILE requires an argument"]),
    ],
)
def test_wrong_words_are_refused(capsys, here, line, words):
    strip_csv("data.csv", rows=30)
    Path("words.csv").write_text("no numbers\nat all\n", encoding="utf-8")
    Path("bias.toml").write_text(BIAS.replace("a.csv", "data.csv"), encoding="utf-8")
    odd = Path("data.csv").read_text(encoding="utf-8")
    odd = odd.replace("displacement_mm", '"Way, left (mm)"')
    Path("odd.csv").write_text(odd, encoding="utf-8")
    before = {path.name for path in here.iterdir()}
    assert_refused(capsys, ["identify", *line.split()], *words)
    assert_refused(capsys, ["identify", *line.split(), "--out", "x"], *words)
    assert {path.name for path in here.iterdir()} == before


def test_columns_and_units_of_a_file(capsys, here):
    strip_csv("data.csv", rows=30)
    rows = Path("data.csv").read_text(encoding="utf-8").split("\n", 1)[1]
    Path("odd.csv").write_text(f'"Way (x), left",Push\n{rows}', encoding="utf-8")
    known = load("data.csv").shear[0].curve
    for columns in ("displacement=Way (x), left,force=Push", 'displacement="1", force="push"'):
        argv = ["identify", "odd.csv", "--columns", columns, "--dry-run"]
        assert main([*argv, "--units", "force=N,displacement=mm"]) == 0
        assert "29 rows" in capsys.readouterr().out
    columns = {"displacement": "Way (x), left", "force": "Push"}
    for unit, size in (("inch", 25.4), ("mm", 1.0)):
        length = {"length": 320 * size, "width": 160 * size}
        units = {"displacement": unit, "force": "N"}
        curve = load("odd.csv", columns=columns, units=units, **length).shear[0].curve
        assert_allclose(curve.displacement, size * known.displacement, rtol=1e-12)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(("loose", "shown"), [(-1.0, True), (100.0, False)])
def test_a_large_misfit_points_to_the_table(capsys, here, monkeypatch, loose, shown):
    monkeypatch.setattr("quasiform.console.terminal.LOOSE", loose)
    strip_csv("data.csv", rows=30)
    assert main(["identify", "data.csv", "--out", "x"]) == 0
    assert ("--method table follows the forces" in capsys.readouterr().out) is shown


@pytest.mark.usefixtures("undrawn")
def test_sizes_and_defaults_are_told_before_the_fit(capsys, here):
    strip_csv("data.csv", rows=30)
    argv = ["identify", "data.csv", "--method", "table", "--width", "160"]
    assert main([*argv, "--out", "x"]) == 0
    out = capsys.readouterr().out
    before, _, after = out.partition("fitting, some seconds\n")
    assert "thickness 1.004 mm (assumed: that of MD600 locking)" in before
    words = "Taken as a strip of 320 x 160 mm at 45 degrees; not given, defaults: length, angle."
    assert words in before
    assert after.count(words) == 1
    assert f"warning: {words}" in after  # it is read last
    assert words in json.loads(Path("x/summary.json").read_text(encoding="utf-8"))["notices"]
    assert after.count("not in these tests, taken from MD600 locking: warp, weft,") == 1
    assert main([*argv, "--length", "320", "--angle", "45", "--thickness", "1", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "thickness 1 mm (given)" in out
    assert "strip of 320 x 160 mm at 45 degrees.\n" in out
    assert "fitting" not in out
    assert "default" not in out


def test_a_frame_needs_no_side_for_a_normalised_force():
    gamma = np.linspace(0.0, 50.0, 60)
    table("f.csv", "shear_angle_deg,shear_force [N/mm]", gamma, 0.001 * gamma)
    (test,) = load("f.csv", kind="picture-frame").shear
    assert test.curve.notices == ()
    table("f.csv", "shear_angle_deg,force [N]", gamma, 0.1 * gamma)
    (test,) = load("f.csv", kind="picture-frame", fabric_side=90.0).shear
    words = "Taken as a frame of 100 mm sides, fabric of 90 mm; not given, defaults: side."
    assert test.curve.notices == (words,)
    with pytest.raises(InputError, match="must not exceed the side of the frame, 100 mm, got 110"):
        load("f.csv", kind="picture-frame", fabric_side=110.0)


@pytest.mark.usefixtures("undrawn")
def test_a_fabric_smaller_than_its_frame(capsys, here):
    gamma = np.radians(np.linspace(0.0, 50.0, 60))
    u = picture_frame_displacement(gamma, 250.0)
    force = (180 / 250) ** 2 * picture_frame_force(gamma, 250.0, LAWS["best-fit"].stress, 1.2)
    table("f.csv", "displacement_mm,force_N", u, force)
    line = "identify f.csv --kind picture-frame --side 250 --thickness 1.2 --method table --out"
    assert main([*line.split(), "f"]) == 0
    told = "filled by the fabric (if not, S12 is (side/fabric_side)² times: --fabric-side)"
    assert told in capsys.readouterr().out
    assert main([*line.split(), "g", "--fabric-side", "180"]) == 0
    assert "fabric of 180 mm" in capsys.readouterr().out
    assert error(qf.Fabric.load("g/material.toml").shear.stress, "best-fit", 5.0, 47.0) < 2e-3


@pytest.mark.usefixtures("undrawn")
def test_the_range_is_cut_before_the_kinematics(capsys, here):
    """The fibres slip and the record runs on beyond the limit of the net, 66.27 mm."""
    test = strip_test("best-fit", 50.0, rows=100, low=0.0)
    u = np.append(displacement(test.angles[0]), np.linspace(53.0, 75.0, 30))
    table("a.csv", "displacement_mm,force_N", u, np.append(test.force, np.linspace(29, 60, 30)))
    assert_refused(capsys, ["identify", "a.csv"], "reaches 75 mm", "at 66.27 mm", "(--to)")
    assert main(["identify", "a.csv", "--to", "40", "--method", "table", "--out", "x"]) == 0
    fabric = qf.Fabric.load("x/material.toml")
    assert 39.0 < fabric.shear_range <= 40.0
    assert error(fabric.shear.stress, "best-fit", 5.0, 38.0) < 2e-3


@pytest.mark.usefixtures("undrawn")
def test_options_of_the_part_of_a_record(capsys, here):
    test = strip_test("best-fit", 50.0, rows=60, low=0.0)
    u = displacement(test.angles[0])
    table("a.csv", "displacement_mm,force_N", u + 0.35, test.force + 1.0)
    line = "identify a.csv --zero 0.35 --preload 0 --cycle 1 --method table --out x"
    assert main(line.split()) == 0
    out = capsys.readouterr().out
    assert "The displacement was shifted by -0.35 mm: given." in out
    assert "The force was shifted, from 1 N in the first row to 0 N" in out
    assert error(qf.Fabric.load("x/material.toml").shear.stress, "best-fit", 5.0, 47.0) < 0.01
    Path("b.toml").write_text(BIAS + 'zero = 0.35\npreload = "auto"\ncycle = "first"\n')
    assert load("b.toml").shear[0].curve.displacement[-1] == pytest.approx(u[-1])


def test_short_strips_are_reported():
    u = np.linspace(0.5, 8.0, 20)
    table("a.csv", "displacement_mm,force_N", u, 2 * u)
    notices = " ".join(load("a.csv", length=130.0, width=100.0).shear[0].curve.notices)
    assert "Length over width is 1.3, below 2" in notices
    table("b.csv", "displacement_mm,force_N", u, 2 * u)
    assert "Length over" not in " ".join(load("b.csv").shear[0].curve.notices)


def test_a_dry_run_writes_nothing(capsys, here):
    strip_csv("data.csv", rows=30)
    assert main(["identify", "data.csv", "--dry-run", "--out", "x"]) == 0
    out, _ = capsys.readouterr()
    assert "data.csv" in out
    assert "writing" not in out
    assert [path.name for path in here.iterdir()] == ["data.csv"]
