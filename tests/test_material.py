"""The fabric law against the audited table, its own derivatives and the paper's parameters."""

import copy
import json
import pickle
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

import quasiform as qf
from quasiform.checks import InputError
from quasiform.fabric import PRESETS, Fabric, TabulatedLaw, ThreeStageLaw, invariants, shear_angle

SHEAR = {name: Fabric.preset(name).shear for name in PRESETS}
LINEAR = ThreeStageLaw(C_ini=1000.0)
TABLE_I6 = np.append(0.06 * np.linspace(0, 1, 15)[:-1] ** 1.5, np.linspace(0.06, 1.0, 46))
TABLE = TabulatedLaw(TABLE_I6, SHEAR["best-fit"].stress(TABLE_I6))
COARSE = TabulatedLaw((0.04, 0.2, 0.5, 0.7), (0.03, 0.04, 0.05, 0.4))
LAWS = {**SHEAR, "linear": LINEAR, "tabulated": TABLE, "coarse table": COARSE}
law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
shear_law = pytest.mark.parametrize("law", SHEAR.values(), ids=SHEAR)

ANGLES = [1, 5, 10, 20, 30, 40, 50, 57, 60, 70, 90]
S12_BEST_FIT = """
    .00578 .02264 .03372 .04186 .04403 .04577 .06735 .09298 .10512 .14458 .18425"""
S12_LOCKING = """
    .00578 .02264 .03372 .04186 .04403 .04479 .04516 .43227 2.2568 14.612 32.807"""

# Sampled away from the joins of the stages at 0.0116, 0.61 and 0.819
I_SAMPLES = np.array([-0.9, -0.7, -0.3, -0.02, -0.005, 0.003, 0.02, 0.1, 0.5, 0.65, 0.83, 1.0])


@pytest.mark.parametrize(
    ("name", "printed"), [("best-fit", S12_BEST_FIT), ("locking", S12_LOCKING)]
)
def test_shear_stress_table(name, printed):
    stress = SHEAR[name].stress(np.sin(np.radians(ANGLES)))
    assert_allclose(stress, np.array(printed.split(), float), rtol=1e-4, atol=0.501e-5)


@shear_law
def test_stress_and_slope_are_continuous_at_both_joins(law):
    joins = np.array([law.S_ini / law.C_ini, law.I_lo])
    assert_allclose(joins[0], 0.011557, atol=0.5e-6)
    for sign in (1.0, -1.0):
        below, above = sign * (joins - 1e-10), sign * (joins + 1e-10)
        assert_allclose(law.stress(above), law.stress(below), rtol=1e-6)
        assert_allclose(law.stiffness(above), law.stiffness(below), rtol=1e-4)
    assert_allclose(law.stress(joins)[0], law.S_ini)
    assert_allclose(law.stiffness(joins)[0], law.C_ini)


@law
@pytest.mark.parametrize("I0", [0.0, 1.0])
def test_energy_is_even_and_stress_is_odd(law, I0):
    assert law.energy(I0, I0) == 0
    assert law.stress(I0, I0) == 0
    assert_allclose(law.energy(I0 - I_SAMPLES, I0), law.energy(I0 + I_SAMPLES, I0), rtol=1e-12)
    assert_allclose(law.stress(I0 - I_SAMPLES, I0), -law.stress(I0 + I_SAMPLES, I0), rtol=1e-12)
    assert (np.sign(law.stress(I0 + I_SAMPLES, I0)) == np.sign(I_SAMPLES)).all()


@law
@pytest.mark.parametrize("I0", [0.0, 1.0])
def test_energy_is_the_integral_of_the_stress(law, I0):
    if isinstance(law, TabulatedLaw):
        joins = law.I6[1:]
    else:
        joins = [] if law.linear else [law.S_ini / law.C_ini, law.I_lo]
    for x in I_SAMPLES:
        points = [sign * join for join in joins for sign in (1, -1) if 0 < sign * join * x < x * x]
        work, _ = quad(
            lambda s: law.stress(I0 + s, I0), 0, x, points=points or None, epsrel=1e-12, limit=200
        )
        assert_allclose(law.energy(I0 + x, I0), work, rtol=1e-10)


@law
@pytest.mark.parametrize("I0", [0.0, 1.0])
def test_stiffness_is_the_slope_of_the_stress(law, I0):
    I, h = I0 + I_SAMPLES, 1e-6
    slope = (law.stress(I + h, I0) - law.stress(I - h, I0)) / (2 * h)
    assert_allclose(law.stiffness(I, I0), slope, rtol=1e-6)
    assert (law.stiffness(I, I0) > 0).all()


def test_law_of_the_first_stage_alone_is_linear_for_every_argument():
    I = np.array([-50.0, 0.0, 1.0, 1.7, 300.0])
    assert LINEAR.linear
    assert_allclose(LINEAR.stress(I, 1.0), 1000.0 * (I - 1.0))
    assert_allclose(LINEAR.energy(I, 1.0), 500.0 * (I - 1.0) ** 2)
    assert_allclose(LINEAR.stiffness(I, 1.0), 1000.0)


def random_table(rng):
    """Strictly increasing, with steps over six decades in either direction."""
    n = rng.integers(4, 40)
    I6, S12 = (np.cumsum(10.0 ** rng.uniform(-decades, 0, n)) for decades in (3, 6))
    return TabulatedLaw(1.4 * I6 / I6[-1], S12)


def test_table_holds_its_points_and_begins_at_the_origin():
    assert (COARSE.I6, COARSE.S12) == (
        (0.0, 0.04, 0.2, 0.5, 0.7),
        (0.0, 0.03, 0.04, 0.05, 0.4),
    )
    assert TabulatedLaw([0, 0.04, 0.2, 0.5, 0.7], [0, 0.03, 0.04, 0.05, 0.4]) == COARSE
    assert not COARSE.linear
    assert_allclose(COARSE.stress(np.array(COARSE.I6)), COARSE.S12, rtol=1e-13)
    assert_allclose(TABLE.stress(TABLE_I6), TABLE.S12, rtol=1e-13)


def slopes_of_stiffness(law):
    """(2, n) at the ends of the intervals: five points of a quartic tell its slope."""
    knots, h = np.array(law.I6), np.diff(law.I6)
    K = law.stiffness(knots[:-1] + h * np.linspace(0, 1, 5)[:, None])
    weights = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 3
    return np.array([weights @ K, -weights @ K[::-1]]) / h, K.max(axis=0) / h


def assert_smooth(law):
    """The stiffness is C1 across every knot, zero and the end among them."""
    (start, end), scale = slopes_of_stiffness(law)
    assert (np.abs(end[:-1] - start[1:]) < 1e-8 * np.maximum(scale[:-1], scale[1:])).all()
    assert abs(start[0]) < 1e-8 * scale[0]  # even
    assert abs(end[-1]) < 1e-8 * scale[-1]  # constant beyond
    knots = np.array(law.I6)
    below, above = knots * (1 - 1e-14), knots * (1 + 1e-14)
    steepest = law.stiffness(knots).max()
    assert_allclose(law.stiffness(below), law.stiffness(above), rtol=1e-7, atol=1e-9 * steepest)
    assert_allclose(law.stress(below), law.stress(above), rtol=1e-7)
    assert_allclose(law.stress(knots), law.S12, rtol=1e-10)


@pytest.mark.parametrize("law", [TABLE, COARSE], ids=["fine", "coarse"])
def test_stiffness_of_a_table_is_smooth(law):
    assert_smooth(law)


def test_table_goes_on_as_a_straight_line():
    beyond = 0.7 + np.array([0.0, 0.1, 0.5])
    slope = COARSE.stiffness(0.7)
    assert 0.25 <= slope * 0.2 / 0.35 <= 1.25 + 1e-12
    assert_allclose(COARSE.stiffness(beyond), slope)
    assert_allclose(COARSE.stress(beyond), 0.4 + slope * (beyond - 0.7))
    work = 0.4 * 0.5 + slope * 0.125
    assert_allclose(COARSE.energy(1.2) - COARSE.energy(0.7), work)


def test_any_table_is_monotone_and_smooth():
    rng = np.random.default_rng(1)
    for _ in range(200):
        law = random_table(rng)
        knots, h = np.array(law.I6), np.diff(law.I6)
        inside = (knots[:-1, None] + h[:, None] * np.linspace(0, 1, 41)).ravel()
        assert (law.stiffness(np.append(inside, 1.6)) >= 0).all()
        assert (law.stiffness(knots) > 0).all()
        assert (np.diff(law.stress(inside)) >= -1e-14 * law.S12[-1]).all()
        assert_smooth(law)


def test_table_of_a_straight_line_is_that_line():
    law = TabulatedLaw((0.1, 0.3, 0.4, 0.9), (0.2, 0.6, 0.8, 1.8))
    I = np.linspace(-1.4, 1.4, 57)
    assert_allclose(law.stiffness(I), 2.0)
    assert_allclose(law.stress(I), 2.0 * I, atol=1e-15)
    assert_allclose(law.energy(I), I**2, atol=1e-15)


def test_sixty_points_stand_for_the_law():
    law = SHEAR["best-fit"]
    I = np.linspace(np.sin(np.radians(2)), 1.0, 5001)
    assert len(TABLE.I6) == 60
    assert_allclose(TABLE.stress(I), law.stress(I), rtol=1e-3)
    assert_allclose(TABLE.energy(I), law.energy(I), rtol=1e-3)


def test_table_is_plain_to_copy():
    law = TabulatedLaw(COARSE.I6, COARSE.S12)
    before = hash(law)
    law.stress(0.3)
    for other in (pickle.loads(pickle.dumps(law)), copy.deepcopy(law), replace(law)):
        assert other == law
        assert hash(other) == before
        assert other.energy(0.3) == law.energy(0.3)
    assert asdict(law) == {"I6": COARSE.I6, "S12": COARSE.S12}


def test_off_axis_tension_with_a_table():
    fabric = replace(Fabric.preset("best-fit"), shear=TABLE)
    scenes = (qf.off_axis_tension(law=law, size=40) for law in (fabric, "best-fit"))
    tabulated, three_stage = (qf.solve(scene, estimate=False) for scene in scenes)
    assert tabulated.status == "completed"
    assert tabulated.force == pytest.approx(three_stage.force, rel=5e-3)
    json.dumps(tabulated.model.parameters, allow_nan=False)


def test_invariants_of_a_stretched_and_sheared_fabric():
    a, b = 1.2 * np.array([1.0, 0.0, 0.0]), 0.9 * np.array([0.0, 0.6, 0.8])
    a0, b0 = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    F = np.outer(a, a0) + np.outer(b + 0.1 * a, b0)
    I4, I6, I8 = invariants(F, a0, b0)
    assert_allclose([I4, I6, I8], [1.44, 0.144, 0.81 + 0.0144])


def test_shear_angle_needs_the_root():
    """Fibres 50° from their right angle and stretched by 1.01: the printed Eq. 6 reads 48.7°."""
    turn = np.radians(50.0)
    F = 1.01 * np.array([[1.0, np.sin(turn)], [0.0, np.cos(turn)]])
    I4, I6, I8 = invariants(F, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    assert_allclose(np.degrees(shear_angle(I4, I6, I8)), 50.0, rtol=1e-12)
    assert_allclose(np.degrees(np.arcsin(I6 / (I4 * I8))), 48.7, atol=0.05)


def test_shear_angle_is_signed_and_survives_round_off():
    assert_allclose(np.degrees(shear_angle(1.0, np.array([-0.5, 0.5]), 1.0)), [-30.0, 30.0])
    assert shear_angle(1.0, 1.0 + 1e-15, 1.0) == np.pi / 2


@pytest.mark.parametrize(
    ("name", "C_lo", "I_lo"), [("best-fit", 0.911, 0.610), ("locking", 1000.0, 0.819)]
)
def test_presets_hold_the_numbers_of_the_paper(name, C_lo, I_lo):
    fabric = Fabric.preset(name)
    assert fabric.shear == ThreeStageLaw(0.334, 0.00386, 0.00196, 0.0399, C_lo, I_lo)
    assert fabric.warp == fabric.weft == ThreeStageLaw(C_ini=1000.0)
    assert (fabric.thickness, fabric.areal_weight, fabric.friction) == (1.004, 600.0, 0.157)
    assert (fabric.bending_warp, fabric.bending_weft) == (3.403, 3.863)
    assert name in fabric.name


@pytest.mark.parametrize(
    "fabric",
    [
        *map(Fabric.preset, PRESETS),
        Fabric(name='two "quotes" \\ Gelege 90°', shear=LINEAR, friction=0.0, thickness=2),
        Fabric(warp=SHEAR["locking"], weft=SHEAR["best-fit"], in_plane_bending=1e-3),
        Fabric(name="a table", shear=TABLE),
        Fabric(
            name="lines\nand\ttabs \x07\x7f", provenance={"bias test": '3 "good"\nruns', "n": 3}
        ),
        Fabric(
            name="from tests",
            shear=COARSE,
            provenance={"": "–", 'ä "b".c': 0.1, "slack": False, "tiny": 1e-300, "whole": 2.0},
        ),
    ],
    ids=lambda fabric: fabric.name,
)
def test_toml_round_trip(fabric, tmp_path):
    fabric.save(tmp_path / "fabric.toml")
    loaded = Fabric.load(tmp_path / "fabric.toml")
    assert loaded == fabric
    assert list(map(type, loaded.provenance.values())) == list(
        map(type, fabric.provenance.values())
    )
    json.dumps(asdict(fabric), allow_nan=False)


def test_what_a_file_leaves_out_keeps_its_default(tmp_path):
    path = tmp_path / "fabric.toml"
    path.write_text("thickness = 2.0\n[shear]\nC_ini = 0.5\n", encoding="utf-8")
    shear = ThreeStageLaw(C_ini=0.5)
    assert Fabric.load(path) == Fabric(name="fabric", thickness=2.0, shear=shear)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("bending_wrap = 3.0", ["unknown key 'bending_wrap'", "did you mean 'bending_warp'?"]),
        ("[shear]\nC_ini = 1.0\nC_lock = 2.0", ["[shear] unknown key 'C_lock'", "'C_lo'"]),
        ("thickness = nan", ["thickness", "positive", "nan"]),
        ("thickness = -1.0", ["thickness", "positive", "-1.0"]),
        ("thickness = 0", ["thickness", "positive", "0"]),
        ("friction = -0.1", ["friction", "at least zero", "-0.1"]),
        ("friction = true", ["friction", "number", "True"]),
        ("compaction = inf", ["compaction", "positive", "inf"]),
        ('bending_weft = "stiff"', ["bending_weft", "number", "'stiff'"]),
        ("name = 3", ["name", "text"]),
        ("shear = 0.3", ["shear", "expected a table"]),
        ("[warp]", ["[warp]", "C_ini missing"]),
        ("[warp]\nC_ini = -5.0", ["[warp]", "C_ini", "positive", "-5.0"]),
        ("[shear]\nC_ini = 0.3\nS_ini = 0.004", ["[shear]", "C_mid, dS_mid, C_lo, I_lo missing"]),
        ("thickness == 1", ["line 1"]),
        ("[shear]\nI6 = [0.1, 0.2]", ["[shear]", "S12 missing"]),
        ("[shear]\nI6 = [0.1]\nS12 = [1]\nC_ini = 1.0", ["[shear]", "I6 is of a table, C_ini of"]),
        ("[shear]\nI6 = 0.1\nS12 = [1]", ["[shear]", "I6 must be a list of numbers, got 0.1"]),
        (
            "[shear]\nI6 = [0.1, 0.2, 0.2, 0.3]\nS12 = [1, 2, 3, 4]",
            ["[shear]", "I6[2] must be greater than I6[1] = 0.2, got 0.2"],
        ),
        ("[shear]\nI_6 = [0.1]\nS12 = [1]", ["[shear] unknown key 'I_6'", "'I6'"]),
        ("[warp]\nI6 = [0.1]\nS12 = [1]", ["[warp] unknown key 'I6'"]),
        ("provenance = 'here'", ["provenance must be a table of texts and numbers", "'here'"]),
        ("[provenance]\nday = 2024-05-01", ["provenance 'day' must be a text, a finite number"]),
        ("[provenance]\nforces = [1, 2]", ["provenance 'forces'", "[1, 2]"]),
        ("[provenance]\nerror = nan", ["provenance 'error'", "finite", "nan"]),
    ],
)
def test_bad_fabric_file_is_refused_in_one_line(content, words, tmp_path):
    path = tmp_path / "fabric.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        Fabric.load(path)
    message = str(refused.value)
    assert "\n" not in message
    for word in [str(path), *words]:
        assert word in message


@pytest.mark.parametrize("make", [lambda path: None, lambda path: path.mkdir()])
def test_unreadable_fabric_file_is_refused_in_one_line(make, tmp_path):
    path = tmp_path / "missing.toml"
    make(path)
    with pytest.raises(InputError, match=r"missing\.toml") as refused:
        Fabric.load(path)
    assert "\n" not in str(refused.value)


def test_file_in_another_encoding_is_refused(tmp_path):
    path = tmp_path / "latin.toml"
    path.write_bytes("name = 'Gewebe für 90°'".encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.toml"):
        Fabric.load(path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"C_ini": np.nan}, "C_ini must be a positive number, got nan"),
        ({"C_ini": 0.0}, "C_ini must be a positive number"),
        ({"C_ini": 1.0, "I_lo": 0.5}, "S_ini, C_mid, dS_mid, C_lo missing"),
        (
            {"C_ini": 0.3, "S_ini": 0.6, "C_mid": 0, "dS_mid": 1, "C_lo": 0, "I_lo": 1.9},
            "I_lo must lie beyond S_ini/C_ini = 2, got 1.9",
        ),
        ({"C_ini": 0.3, "S_ini": 0.1, "C_mid": 0, "dS_mid": 0, "C_lo": 0, "I_lo": 0.9}, "dS_mid"),
        ({"C_ini": 0.3, "S_ini": 0.1, "C_mid": -1, "dS_mid": 1, "C_lo": 0, "I_lo": 0.9}, "C_mid"),
    ],
)
def test_bad_law_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        ThreeStageLaw(**arguments)


@pytest.mark.parametrize(
    ("I6", "S12", "message"),
    [
        ((0.1, 0.2, 0.3), (1, 2, 3, 4), "I6 and S12 must be of one length, got 3 and 4 numbers"),
        ((0.1, 0.2), (1, 2), "at least 4 points with the origin, got 3"),
        ((), (), "I6 must be a list of numbers, got none"),
        ("0.1", (1, 2), "I6 must be a list of numbers, got '0.1'"),
        ((0, 0.1, 0.2, 0.3), (0.1, 1, 2, 3), "S12[0] must be 0, where I6[0] = 0, got 0.1"),
        ((0.1, 0.2, 0.3), (0, 1, 2), "S12[0], where I6[0] = 0.1, must be a positive number"),
        ((0.1, 0.2, 0.3), (1, 2, 2), "S12[2] must be greater than S12[1] = 2.0, got 2.0"),
        ((0.1, 0.3, 0.2), (1, 2, 3), "I6[2] must be greater than I6[1] = 0.3, got 0.2"),
        ((-0.1, 0.3, 0.4), (1, 2, 3), "I6[0] must be a number of at least zero, got -0.1"),
        ((0.1, 0.3, 0.4), (1, np.nan, 3), "S12[1] must be a number of at least zero, got nan"),
        ((0.1, 0.3, 0.4), (1, "2", 3), "S12[1] must be a number of at least zero, got '2'"),
        ((10, 20, 30), (1, 2, 3), "I6 = sin(shear angle) must not exceed 1.5, got 30.0"),
    ],
)
def test_bad_table_is_refused(I6, S12, message):
    with pytest.raises(InputError, match=re.escape(message)):
        TabulatedLaw(I6, S12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"shear": 0.3}, "Fabric(shear=...) must be a ThreeStageLaw or a TabulatedLaw, got float"),
        ({"warp": COARSE}, "Fabric(warp=...) must be a ThreeStageLaw, got TabulatedLaw"),
        ({"weft": None}, "Fabric(weft=...) must be a ThreeStageLaw, got NoneType"),
        ({"provenance": {"law": LINEAR}}, "provenance 'law' must be a text, a finite number"),
        ({"provenance": {3: "a"}}, "a key of provenance must be a text, got 3"),
        ({"provenance": ["a"]}, "provenance must be a table of texts and numbers, got ['a']"),
    ],
)
def test_bad_fabric_is_refused(arguments, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Fabric(**arguments)


def test_provenance_is_a_plain_copy():
    given = {"error": np.float64(0.1), "n": np.int64(3), "averaged": np.bool_(True)}
    fabric = Fabric(provenance=given)
    given["n"] = 4
    assert fabric.provenance == {"error": 0.1, "n": 3, "averaged": True}
    assert [type(value) for value in fabric.provenance.values()] == [float, int, bool]
    assert hash(fabric) == hash(Fabric())
    assert fabric != Fabric()


def test_unknown_preset_is_refused_with_a_suggestion():
    with pytest.raises(InputError, match=r"unknown law 'lokcing': did you mean 'locking'\?"):
        Fabric.preset("lokcing")
