"""The examples run as they are, without a warning, and find what they are about."""

import runpy
import tomllib
from pathlib import Path

import numpy as np
import pytest

import quasiform as qf
from quasiform.potential import Potential
from quasiform.studies import plan

EXAMPLES = Path(__file__).parent.parent / "examples"


def example(name):
    """Names of an example's script after its run."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")


def test_every_example_has_a_docstring_and_a_test():
    tests = Path(__file__).read_text(encoding="utf-8")
    names = [path.stem for path in EXAMPLES.glob("*.py")]
    assert len(names) >= 7
    for name in names:
        assert f'example("{name}")' in tests
        assert '"""' in (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")


def test_hemisphere(capsys):
    result = example("hemisphere")["result"]
    assert result.status == "completed"
    assert result.model.size < 4  # the fillet needs it
    assert result.certified
    assert "certified: True" in capsys.readouterr().out


def test_own_energy():
    """It stiffens the test, and its derivatives are those of its energy."""
    found = example("own_energy")
    plain, stitched = found["plain"], found["stitched"]
    assert stitched.certified
    assert 1.01 * plain.force < stitched.force < 1.5 * plain.force
    assert 0 < stitched.estimate["force_N"] < 0.05 * stitched.force
    term, x, h = stitched.model.terms[-1], stitched.states[-1].x, 1e-6
    assert (term.energy(x) > 0).any()
    rng = np.random.default_rng(0)
    dx = rng.normal(size=len(x))
    slope = (term.energy(x + h * dx) - term.energy(x - h * dx)) / (2 * h)
    along = dx[term.dofs]
    np.testing.assert_allclose((term.gradient(x) * along).sum(1), slope, atol=1e-8)
    bend = (term.gradient(x + h * dx) - term.gradient(x - h * dx)) / (2 * h)
    product = np.einsum("mij,mj->mi", term.hessian(x, None, False), along)
    np.testing.assert_allclose(product, bend, atol=1e-7)


@pytest.mark.parametrize("scene", ["hemisphere", "tetrahedron"])
def test_studies_of_the_surrogate(scene):
    """Six keys and 1024 runs each, of a mesh of 8 mm."""
    table = tomllib.loads((EXAMPLES / "surrogate" / f"{scene}.toml").read_text(encoding="utf-8"))
    assert table["runs"] == 1024
    planned = plan(table | {"runs": 8})
    assert len(planned.keys) == 6
    assert planned.first[0].size == 8.0


def test_softening():
    """Yarns that soften for good; what they dissipate closes the energy balance."""
    found = example("softening")
    first, second = found["first"], found["second"]
    assert first.status == "completed"
    assert second.force == first.force
    assert first.energy_balance < 0.01
    assert 0 < first.estimate["force_N"] < 0.1 * first.force


def test_own_tool():
    """The sheet lies on the ring, and its distance has the derivatives it claims."""
    found = example("own_tool")
    result, ring = found["result"], found["Ring"](40.0, 15.0)
    assert result.status == "completed"
    punch = next(c for c in result.model.contacts if c.tool.motion == "driven")
    assert (punch.pressure(result.states[-1].x) > 0).any()
    points = np.array([[35.0, 10.0, 2.0], [60.0, -5.0, 20.0], [3.0, 4.0, -8.0]])
    d, n, H = ring.distance(points)
    assert d[0] < 0 < d[1]
    assert ring.distance(np.array([[40.0, 0.0, 0.0]]))[0] == pytest.approx(0.0)
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        after, before = ring.distance(points + step), ring.distance(points - step)
        np.testing.assert_allclose((after[0] - before[0]) / 2e-5, n[:, axis], atol=1e-8)
        np.testing.assert_allclose((after[1] - before[1]) / 2e-5, H[:, axis], atol=1e-8)


def test_stop_and_change():
    found = example("stop_and_change")
    stopped, pressed = found["stopped"], found["pressed"]
    assert stopped.status == "stopped"
    assert stopped.reason == (
        "stopped by the callback at 30 of 50: sheared by more than 20 degrees"
    )
    gamma = stopped.history["shear_angle_max_deg"]
    assert gamma[-1] > 20 > gamma[-2]
    travel, force = pressed.history["travel_mm"], pressed.history["holder_force_N"]
    light = force[travel <= 10]
    np.testing.assert_allclose(light, light[0], rtol=0.01)
    np.testing.assert_allclose(force[travel > 10], 4 * light[0], rtol=0.01)


@pytest.mark.parametrize("answer", [True, np.True_, "enough"])
def test_a_callback_stops_at_once_but_not_at_the_goal(answer):
    scene = qf.off_axis_tension(displacement=10, size=40)
    told = []
    result = qf.solve(scene, lambda step: told.append(step.travel) or answer)
    words = ": enough" if answer == "enough" else ""
    assert result.reason == f"stopped by the callback at 2.5 of 10{words}"
    assert told == [2.5]
    assert result.estimate["force_N"] is None
    assert qf.solve(scene, lambda step: step.travel >= 10).status == "completed"


def test_a_callback_stops_a_refinement_on_its_path(tmp_path):
    scene = qf.off_axis_tension(displacement=10, size=20)
    result = qf.refine(scene, lambda step: True, out=tmp_path / "run")
    assert result.status == "stopped"
    assert result.model.size == 40
    carried_on = qf.refine(scene, out=tmp_path / "run", resume=True)
    assert carried_on.status == "completed"
    assert carried_on.model.size == 20


def test_scene_by_hand():
    """Gravity and reaction balance: the ball carries the sheet."""
    found = example("scene_by_hand")
    result, weight = found["result"], found["weight"]
    assert result.status == "completed"
    potential = Potential(result.model.terms, ~result.model.fixed, result.memory)
    forces = potential.gradient(result.states[-1].x, result.memory)
    lift = forces[found["height"].dofs].item()
    assert lift == pytest.approx(3 * weight * found["blank"].areas.sum(), rel=1e-3)
    assert result.estimate["load_work_mJ"] is None  # there is no way to build it coarser
    assert found["corner"] < -50


def test_tables(capsys):
    pytest.importorskip("pandas")
    found = example("tables")
    forces, triangles = found["forces"], found["triangles"]
    assert list(forces.columns) == ["best-fit", "locking"]
    assert forces.loc[30.0, "locking"] == pytest.approx(15.68, rel=0.005)  # power balance
    assert forces.loc[55.0, "best-fit"] > 1.2 * forces.loc[55.0, "locking"]
    assert triangles["area_mm2"].sum() == pytest.approx(320 * 160)
    assert not triangles.isna().any().any()
    assert "sheared beyond 45 degrees" in capsys.readouterr().out


def test_notebook(capsys):
    found = example("notebook")
    results = found["results"]
    assert set(results) == {0, 45}
    written = [path.name for path in found["folder"].iterdir()]
    assert {"summary.json", "result.vtu", "shear_angle.png"} <= set(written)
    said = capsys.readouterr().out
    assert len(said) < 3000  # a result that is shown is one line, not its arrays
    assert "<Result hemisphere-45: completed at 15 of 15" in said
