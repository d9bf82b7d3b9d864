"""Scaled scenes have scaled answers: the program has no lengths and forces of its own."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import quasiform as qf
from quasiform.toml_file import toml_text

SCENES = Path(qf.__file__).parents[1] / "geometries"
FABRIC = qf.Fabric.preset("locking")
FEW = {"blank.size": 36.0, "travel": 20.0}


def scaled_fabric(s, c):
    """The fabric with lengths times s and stresses times c."""
    stresses = {
        "shear": ("C_ini", "S_ini", "C_mid", "dS_mid", "C_lo"),
        "warp": ("C_ini",),
        "weft": ("C_ini",),
    }
    laws = {
        name: replace(law, **{key: c * getattr(law, key) for key in keys})
        for name, keys in stresses.items()
        for law in [getattr(FABRIC, name)]
    }
    factors = {"thickness": s, "compaction": c / s, "areal_weight": c}
    factors |= {"bending_warp": c * s**3, "bending_weft": c * s**3}
    return replace(FABRIC, **laws, **{k: f * getattr(FABRIC, k) for k, f in factors.items()})


def scaled_table(table, s):
    """A table of a scene file with its lengths times s."""
    if table.get("unit") == "mm":
        lengths = {k: v for k, v in table.items() if k in ("value", "centre", "radius")}
        return table | {k: (s * np.array(v)).tolist() for k, v in lengths.items()}
    return {k: scaled_table(v, s) if isinstance(v, dict) else v for k, v in table.items()}


def formed(folder, name, s=1.0, c=1.0, **more):
    """A built-in scene with lengths times s and stresses times c, on a coarse mesh."""
    table = scaled_table(tomllib.loads((SCENES / f"{name}.toml").read_text("utf-8")), s)
    (folder / "scaled.toml").write_text(toml_text(table), "utf-8")
    few = {key: s * value for key, value in FEW.items()}
    few |= {"tools.holder.mass": 5.0 * c * s**2, **more}
    model = qf.forming(folder / "scaled.toml", law=scaled_fabric(s, c), overrides=few)
    return qf.solve(model, estimate=False)


@pytest.mark.parametrize(("name", "large"), [("hemisphere", 10.0), ("tetrahedron", 1.0)])
def test_a_scaled_scene_has_the_scaled_answer(tmp_path, name, large):
    """The holder of the tetrahedron tilts; its punch times 10 exceeds what a scene may have."""
    one = formed(tmp_path, name)
    assert one.status == "completed"
    for s, c in ((0.01, 1.0), (0.1, 1.0), (large, 7.0)):
        other, force = formed(tmp_path, name, s, c), c * s**2
        assert_allclose(other.force, force * one.force, rtol=1e-8)
        x, y = one.states[-1].x, other.states[-1].x
        assert_allclose(y, s * x, rtol=0, atol=1e-8 * s)
        assert_allclose(other.shear_angle, one.shear_angle, rtol=0, atol=1e-7)
        assert_allclose(other.energy, s * force * one.energy, rtol=1e-8)
        assert (other.linear_solves, other.purposes) == (one.linear_solves, one.purposes)
        assert_allclose(other.history["travel_mm"], s * np.array(one.history["travel_mm"]))
        assert len(other.certified.reasons) == len(one.certified.reasons)


def test_a_scaled_tension_test_has_the_scaled_answer():
    sizes = {"length": 320.0, "width": 160.0, "displacement": 20.0, "size": 40.0}
    one = qf.solve(qf.off_axis_tension(law=FABRIC, **sizes), estimate=False)
    for s, c in ((0.1, 1.0), (10.0, 1.0), (1.0, 7.0)):
        given = {key: s * value for key, value in sizes.items()}
        model = qf.off_axis_tension(law=scaled_fabric(s, c), **given)
        other = qf.solve(model, estimate=False)
        scaled = c * s**2 * np.array(one.history["force_N"])
        assert_allclose(other.history["force_N"], scaled, rtol=1e-8, atol=1e-9 * scaled[-1])
        assert other.linear_solves == one.linear_solves


def test_perturbed_starts_are_scaled_too(tmp_path):
    one, other = (formed(tmp_path, "hemisphere", s, travel=5.0 * s) for s in (1.0, 0.1))
    first, second = (qf.solve.spread(result, [1]) for result in (one, other))
    assert first["force_N"]["low"] < first["force_N"]["high"]
    for key, share in (("low", 0.01), ("high", 0.01), ("judged", 1.0), ("robust", 1.0)):
        assert second["force_N"][key] == pytest.approx(share * first["force_N"][key], rel=1e-6)


@pytest.mark.parametrize(("s", "usual"), [(1.0, 5.0), (0.1, 0.5), (10.0, 50.0), (0.6, 2.0)])
def test_default_sizes_are_round_shares_of_the_blank(s, usual):
    lengths = {"blank.length": 310.0 * s, "blank.width": 310.0 * s}
    tools = {"punch.radius": 75.0, "die.radius": 80.0, "die.fillet": 12.5}
    tools |= {"holder.radius": 80.0, "holder.fillet": 12.5}
    lengths |= {f"tools.{key}": s * value for key, value in tools.items()}
    model = qf.forming("hemisphere", law=scaled_fabric(s, 1.0), overrides=lengths, travel=s)
    assert (model.increment, model.rows) == (usual, usual)
    assert model.size == usual
