"""Mesh continuation and the error estimate."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

import quasiform as qf
from quasiform.result.estimate import discretisation_error
from quasiform.scenes import scene_file
from quasiform.solve import carry, dependence, levels
from quasiform.solve.asked import asked, solved
from quasiform.solve.carry import carried, transferred


@cache
def wide_fillets():
    """The hemisphere with fillets of 25 mm, over which the path may be followed at 10 mm."""
    text = scene_file.scene_toml(scene_file.load("hemisphere"))
    text = text.replace("fillet = { value = 10.0", "fillet = { value = 25.0")
    return scene_file.read_text({"toml": text, "source": ""})


def wide(size=None, travel=None):
    return qf.forming(wide_fillets(), size=size, travel=travel)


@pytest.fixture(scope="module")
def refined():
    return qf.refine(wide(size=5, travel=30))


@pytest.fixture(scope="module")
def full():
    return qf.solve(wide(size=5, travel=30))


def test_the_end_is_that_of_the_full_path(refined, full):
    assert refined.status == full.status == "completed"
    assert refined.certified
    assert refined.model.size == full.model.size == 5
    assert refined.force == pytest.approx(full.force, rel=5e-3)
    estimate = refined.estimate
    off = refined.quantities["shear_angle_deg"] - full.quantities["shear_angle_deg"]
    assert abs(off) < 0.1 * estimate["shear_angle_deg"]
    assert_allclose(refined.shear_angle, full.shear_angle, atol=0.5)


def test_it_takes_a_fraction_of_the_solves(refined, full):
    assert refined.linear_solves < 0.7 * full.linear_solves
    assert refined.history["linear_solves"][-1] == refined.linear_solves


def test_the_history_says_where_it_comes_from(refined, tmp_path):
    history = refined.history
    assert list(history)[-1] == "size_mm"
    assert_allclose(history["size_mm"], [10.0] * 6 + [5.0])
    assert_allclose(history["travel_mm"], np.arange(0.0, 31.0, 5.0))
    assert history["force_N"][-1] == refined.force
    assert refined.summary()["path_size_mm"] == 10.0
    assert any("path on a mesh of 10 mm" in entry for entry in refined.summary()["model"])
    refined.save(tmp_path / "out", pictures=False)
    assert len(list((tmp_path / "out").glob("increment_*.vtu"))) == 7
    text = (tmp_path / "out" / "result.vtu").read_text(errors="ignore")
    assert "shear_angle_error" in text


def test_a_full_path_has_one_mesh_and_says_nothing_of_sizes(full):
    assert full.path is None
    assert "size_mm" not in full.history
    assert full.summary()["path_size_mm"] is None


def test_accuracy_refines_until_the_estimate_is_below_it():
    loose = qf.refine(wide(size=10, travel=5), accuracy=20.0)
    assert loose.model.size == 10
    error = loose.estimate["shear_angle_deg"]
    assert error < 20
    sharp = qf.refine(wide(size=10, travel=5), accuracy=0.9 * error)
    assert sharp.model.size < 10
    assert sharp.estimate["shear_angle_deg"] < 0.9 * error
    assert sharp.path.model.size == 10
    assert sharp.factorisations["10 mm"] == loose.factorisations["10 mm"]


@pytest.mark.parametrize("accuracy", [0.0, -1.0, np.nan])
def test_accuracy_must_be_positive(accuracy):
    with pytest.raises(qf.InputError, match="accuracy must be a positive number"):
        qf.refine(wide(), accuracy=accuracy)


def test_a_scene_that_is_as_coarse_as_its_tools_allow_is_solved_as_it_is():
    result = qf.refine(wide(size=10, travel=10))
    assert result.path is None
    assert result.estimate["shear_angle_deg"] > 0  # from a mesh twice as coarse


def test_a_changed_scene_is_solved_as_it_is():
    scene = wide(size=5, travel=10)
    scene.travel = 2.0
    result = qf.refine(scene)
    assert result.model is scene
    assert result.states[-1].travel == 2.0
    assert result.path is None


def test_an_accuracy_that_is_not_reached_is_told(monkeypatch):
    monkeypatch.setattr(levels, "FINEST", 1)
    result = qf.refine(qf.off_axis_tension(45, displacement=20, size=20), accuracy=1e-6)
    assert result.status == "stopped"
    assert "accuracy of 1e-06 degrees not reached: estimated" in result.reason
    assert result.model.size == 20


def test_what_was_completed_survives_an_interrupted_finer_mesh(monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(carry, "transferred", interrupted)
    result = qf.refine(wide(size=5, travel=5))
    assert result.model.size == 10
    assert result.reason == "interrupted on a mesh of 5 mm"
    assert result.states[-1].travel == 5.0


def test_a_scene_is_solved_alike_a_second_time():
    scene = wide(size=20, travel=10)
    first = qf.solve(scene, estimate=False)
    second = qf.solve(scene, estimate=False)
    assert second.linear_solves == first.linear_solves
    assert_allclose(second.states[-1].x, first.states[-1].x, rtol=1e-12, atol=1e-12)
    before = list(scene.description)
    qf.refine(wide(size=5, travel=5))
    assert scene.description == before


def test_a_path_that_stops_is_the_result(monkeypatch):
    stopped = qf.solve(wide(size=10, travel=5), estimate=False)
    stopped.reason = "torn"
    monkeypatch.setattr(levels, "follow", lambda *arguments, **named: stopped)
    result = qf.refine(wide(size=5, travel=5))
    assert result is stopped
    assert result.model.size == 10


def test_where_the_end_is_not_found_the_path_is_followed(monkeypatch):
    def settle(run, x):
        raise carry.NotConvergedError("lost")

    fresh = qf.solve(wide(size=5, travel=10), estimate=False)
    # after the state has been carried, memory of friction and all
    monkeypatch.setattr(carry.Run, "settle", settle)
    result = qf.refine(wide(size=5, travel=10))
    assert result.rescues["path followed on the finer mesh"] == 1
    assert result.certified
    assert result.path is None
    assert result.force == pytest.approx(fresh.force, rel=1e-9)
    assert sum(result.factorisations.values()) > fresh.linear_solves


def test_a_plane_test_is_refined_too():
    scene = qf.off_axis_tension(45, displacement=20, size=10)
    result = qf.refine(scene)
    full = qf.solve(qf.off_axis_tension(45, displacement=20, size=10), estimate=False)
    assert result.path.model.size == 40
    assert result.force == pytest.approx(full.force, rel=1e-4)


def test_a_smooth_state_is_carried_exactly_where_cubics_are_exact():
    coarse = qf.solve(wide(size=20, travel=1), estimate=False)
    end = coarse.states[-1]
    X = coarse.model.sheet.blank.nodes
    end.x[:] = coarse.model.x0
    bent = 1e-3 * X[:, 0] ** 2
    end.x[coarse.model.sheet.dofs[:, 2]] += bent
    last = np.zeros_like(end.x)
    fine = wide(size=10, travel=1)
    x, before = transferred(coarse, fine, last)
    Y = fine.sheet.blank.nodes
    inner = (Y > 20).all(1) & (Y < 130).all(1)
    z = (x - fine.x0)[fine.sheet.dofs[:, 2]]
    assert_allclose(z[inner], 1e-3 * Y[inner, 0] ** 2, atol=0.02)
    assert_allclose(x, before)


def test_friction_starts_from_the_last_increment():
    coarse = qf.solve(wide(size=10, travel=15), estimate=False)
    fine = wide(size=5, travel=15)
    last = coarse.states[-1].x - coarse.states[-2].x  # 5 mm of travel
    x, before = transferred(coarse, fine, last)
    memory = carried(coarse, fine, last, x, before)
    assert np.abs(x - before).max() > 4.0  # the punch has moved by 5 mm
    limits = [[s.limit.sum() for s in states if s] for states in (coarse.memory, memory)]
    assert_allclose(np.sum(limits[1]), np.sum(limits[0]), rtol=0.05)
    for term in fine.frictions:
        state = memory[fine.terms.index(term)]
        assert np.abs(term.force(x, state)).sum() > 0.5 * state.limit.sum()  # slips where it bears


# The estimate


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_the_error_of_a_converging_value_is_bounded(order):
    for sizes in ((1.0, 2.0, 4.0), (1.0, 2**0.5, 2.0), (1.0, 2.0, 2.8, 4.0)):
        exact, values = 3.0, [3.0 + 0.7 * h**order for h in sizes]
        error = values[0] - exact
        assert error < discretisation_error(values, sizes) < 1.3 * error
        assert discretisation_error(values[:2], sizes[:2]) >= 1.2 * error
    sizes = 0.5, 1.0, 2**0.5
    finer = [exact + 0.7 * h**order for h in sizes]
    assert error < discretisation_error(finer, sizes, own=1) < 1.7 * error
    assert error < discretisation_error(finer[:2], sizes[:2], own=1) < 2.2 * error


def test_two_levels_that_happen_to_agree_are_not_believed():
    sizes = 1.0, 2.0, 4.0
    assert discretisation_error([1.0, 1.0, 1.4], sizes) == pytest.approx(1.25 * 0.1 * 0.328125)
    assert discretisation_error([1.0, 1.0, 1.0], sizes) == 0.0


def test_differences_that_grow_are_taken_to_stay():
    sizes = 1.0, 2.0, 4.0
    assert discretisation_error([1.0, 2.0, 2.5], sizes) == pytest.approx(1.25 * 3)
    assert discretisation_error([1.0, 2.0, 2.0], sizes) == pytest.approx(1.25 * 3)  # no ratio: one


def test_fields_are_judged_point_by_point():
    values = [np.array([1.0, 5.0]), np.array([1.5, 5.5]), np.array([2.5, 5.5])]
    sizes = 1.0, 2.0, 4.0
    each = [discretisation_error([v[i] for v in values], sizes) for i in (0, 1)]
    assert_allclose(discretisation_error(values, sizes), each)


def test_the_estimate_holds_for_the_hemisphere(refined):
    """Against the whole path at size 2.5, in at least nine of ten quantities."""
    finer = qf.solve(wide(size=2.5, travel=30), estimate=False).quantities
    inside = [abs(refined.quantities[n] - finer[n]) <= e for n, e in refined.estimate.items()]
    assert np.mean(inside) >= 0.9
    assert len(inside) == 10


def test_rescues_of_all_levels_are_added(monkeypatch):
    real = levels.follow

    def counted(*arguments, **named):
        result = real(*arguments, **named)
        result.rescues["proximal"] = 3
        return result

    monkeypatch.setattr(levels, "follow", counted)
    refined = qf.refine(wide(size=5, travel=5))
    assert refined.path.rescues["proximal"] == refined.rescues["proximal"] == 3


# Mesh of the path, friction's path, in-plane bending


def test_the_default_mesh_resolves_the_smallest_fillet():
    for name in ("hemisphere", "tetrahedron", "box"):
        model = qf.forming(name)
        assert model.coarsest == 4.0  # 0.4 of 10 mm
        assert model.size == 155 / 39  # which fits half of the blank
        assert not model.changed
    assert qf.forming(wide_fillets()).size == 5.0  # nothing finer is needed
    assert qf.forming("hemisphere", size=10.0).size == 10.0


@pytest.mark.parametrize(("size", "sizes"), [(10, [10]), (4, [4]), (3, [3]), (2, [4, 2])])
def test_each_level_is_at_most_twice_as_fine_as_the_one_before(size, sizes):
    model = qf.forming("hemisphere", size=size)
    assert [round(one.size, 9) for one in levels.meshes(model)] == sizes


def test_coarse_meshes_are_named_in_the_certificate():
    coarse = qf.solve(qf.forming("hemisphere", size=15.5, travel=20), estimate=False).certified
    assert coarse.converged
    assert not coarse
    assert "too coarse for the radius of 10.0 mm" in str(coarse)
    assert "a fibre cuts" in str(coarse)
    assert coarse.figures["smallest_radius_mm"] == pytest.approx(10.0, rel=0.01)
    fine = qf.solve(qf.forming("hemisphere", size=5, travel=10), estimate=False).certified
    assert fine
    assert fine.figures["fibre_chord_mm"] < fine.figures["fibre_chord_allowed_mm"]


def test_the_end_has_an_energy_balance_of_its_own(refined):
    assert refined.energy_balance != refined.path.energy_balance
    assert refined.energy_balance < 0.01


def test_what_the_end_depends_on_its_path_is_in_the_estimate(refined, full, monkeypatch):
    errors = refined.summary()["error_estimate"]
    assert errors["path_N"] == refined.path_gap["force_N"] > 0
    assert errors["path_deg"] == refined.path_gap["shear_angle_deg"] > 0
    assert refined.estimate["force_N"] > errors["path_N"]
    assert full.summary()["error_estimate"]["path_N"] == 0.0
    monkeypatch.setattr(levels, "GAP", 0.0)
    followed = qf.refine(wide(size=5, travel=30))
    assert followed.path is None
    assert followed.rescues["path followed on the finer mesh"] == 1
    assert followed.force == pytest.approx(full.force, rel=1e-9)


def test_the_force_has_an_error_along_the_travel(refined, full):
    for result in (refined, full):
        error, force = result.history["force_error_N"], result.history["force_N"]
        assert error[-1] == result.estimate["force_N"]
        assert (error[1:] > 0).all()
        assert (error < force[-1]).all()


def test_trust_names_what_in_plane_bending_changes(full):
    assert full.in_plane == {}  # the other value adds less than .2 % to the energy
    box = qf.solve(qf.forming("box", size=10, travel=14))
    names = {"0.03", "0.1"}
    assert box.in_plane
    assert all(set(values) == names for values in box.in_plane.values())
    low, high = box.in_plane["force_N"].values()
    assert low < high
    full.in_plane = {"force_N": {"0.03": low, "0.1": low + 2 * full.estimate["force_N"]}}
    assert any(
        s.startswith("the force depends on in_plane_bending") for s in full.summary()["trust"]
    )
    full.in_plane["force_N"]["0.1"] = low + 0.5 * full.estimate["force_N"]
    assert not [s for s in full.summary()["trust"] if s.startswith("the force depends")]


def test_a_coarse_estimate_is_wider_where_the_mesh_is_coarser_than_the_fillets():
    for size, factor in ((12, 3.0), (5, 1.25)):  # .4 of the fillets is 10 mm
        model = wide(size=size, travel=10)
        result = qf.solve(model, estimate="coarse")
        coarse = qf.solve(model.recipe.build(1.4 * size, like=model), estimate=False)
        assert result.in_plane == {}
        assert set(result.factorisations) == {f"{s:g} mm" for s in (size, 1.4 * size)}
        expected = factor * abs(result.force - coarse.force) / 0.4
        assert result.estimate["force_N"] == pytest.approx(expected, rel=1e-6)


def pulled():
    return qf.solve(qf.off_axis_tension(45, displacement=10, size=20))


def test_a_finer_end_of_higher_energy_is_not_used(monkeypatch):
    plain = pulled()
    monkeypatch.setattr(dependence, "HIGHER", -1.0)
    coarse = pulled()
    assert not plain.notes
    assert coarse.notes[0][0] == "end on a finer mesh is another state"
    assert coarse.estimate["force_N"] != plain.estimate["force_N"]


def test_a_plane_test_is_followed_where_its_finer_end_is_not_found(monkeypatch):
    def lost(*arguments):
        raise carry.NotConvergedError("lost")

    plain = pulled()
    monkeypatch.setattr(dependence, "carry", lost)
    followed = pulled()
    assert not followed.notes
    assert followed.estimate["force_N"] == pytest.approx(plain.estimate["force_N"], rel=1e-3)


def test_a_draft_of_the_hemisphere_covers_the_fine_answer():
    # p99 and the mean agree by chance on 7.95 and 11.1 mm: .006 and .01 degrees apart
    model, options = asked(qf.forming("hemisphere"), {"draft": True})
    draft = solved(model, options)
    # size 1, default settings: p99, mean, areas in degrees, force in N (own)
    fine = {"shear_angle_deg": 46.24, "shear_angle_mean_deg": 18.18, "force_N": 48.56}
    fine |= {"area_green_deg": 24.84, "area_blue_deg": 44.78, "area_pink_deg": 18.28}
    for name, value in fine.items():
        assert abs(draft.quantities[name] - value) < draft.estimate[name]
    local = np.abs(draft.shear_angle_error)
    assert draft.estimate["shear_angle_deg"] < local.max()  # but it is no bound of the field


def test_a_coarser_run_that_takes_many_times_the_work_is_stopped(monkeypatch):
    monkeypatch.setattr(dependence, "MOST_WORK", 0.0)
    result = qf.solve(qf.off_axis_tension(size=40, displacement=2))
    notes = dict(result.notes)
    entry = "the same on a mesh of 56 mm did not reach the end"
    assert "0 times the work of the run" in notes[entry]
    assert result.estimate["shear_angle_deg"] > 0  # by the finer one
