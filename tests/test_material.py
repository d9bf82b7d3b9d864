"""The fabric law against the audited table, its own derivatives and the paper's parameters."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from quasiform.checks import InputError
from quasiform.material import PRESETS, Fabric, ThreeStageLaw, invariants, shear_angle

SHEAR = {name: Fabric.preset(name).shear for name in PRESETS}
LINEAR = ThreeStageLaw(C_ini=1000.0)
LAWS = {**SHEAR, "linear": LINEAR}
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
    joins = [] if law.linear else [law.S_ini / law.C_ini, law.I_lo]
    for x in I_SAMPLES:
        points = [sign * join for join in joins for sign in (1, -1) if 0 < sign * join * x < x * x]
        work, _ = quad(lambda s: law.stress(I0 + s, I0), 0, x, points=points or None, epsrel=1e-12)
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
    ],
    ids=lambda fabric: fabric.name,
)
def test_toml_round_trip(fabric, tmp_path):
    fabric.save(tmp_path / "fabric.toml")
    assert Fabric.load(tmp_path / "fabric.toml") == fabric


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


def test_unknown_preset_is_refused_with_a_suggestion():
    with pytest.raises(InputError, match=r"unknown law 'lokcing': did you mean 'locking'\?"):
        Fabric.preset("lokcing")
