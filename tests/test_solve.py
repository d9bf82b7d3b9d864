"""Runs as a user makes them: odd meshes, own terms, interruptions, stops, certificates."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import csr_array

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.membrane import Membrane
from quasiform.solve import newton, tangent
from quasiform.solve.equilibrium import Equilibrium
from quasiform.solve.linear import SingularMatrixError
from quasiform.unknowns import Unknowns


@pytest.mark.parametrize("angle", [44.9, 44.95, 44.99, 45.01, 45.05, 45.1])
def test_lines_that_just_miss_a_corner_of_the_net_make_no_sliver(angle):
    result = qf.solve(qf.off_axis_tension(angle, displacement=10, size=20), estimate=False)
    straight = qf.solve(qf.off_axis_tension(45, displacement=10, size=20), estimate=False)
    assert result.certified
    assert result.force == pytest.approx(straight.force, rel=5e-3)


@pytest.mark.parametrize("orientation", [0.01, 44.9, -30.0, 90.0])
def test_forming_runs_at_any_orientation(orientation):
    result = qf.solve(qf.forming(orientation=orientation, size=20, travel=5), estimate=False)
    assert result.certified


def test_stored_energy_is_an_upper_bounds_lower_neighbour():
    """At 30 degrees the uniform bands are admissible: the minimiser stores no more."""
    ideal = theory.OffAxisTension(320.0, 160.0, np.pi / 6)
    result = qf.solve(qf.off_axis_tension(30, displacement=15), estimate=False)
    fabric = result.model.sheet.fabric
    for state in result.states[1:]:
        stored = result.model.membrane.energy(state.x).sum()
        bound = ideal.energy(state.travel, fabric.shear.energy, fabric.thickness)
        assert (0.98 if state.travel >= 5 else 0.97) * bound < stored < bound


def test_a_tension_test_has_a_row_for_every_increment():
    result = qf.solve(qf.off_axis_tension(displacement=15, size=20), estimate=False)
    travel, force = result.history["displacement_mm"], result.history["force_N"]
    assert len(travel) == 1 + result.increments
    assert {0.0, 5.0, 10.0, 15.0} < set(travel.tolist())
    assert (np.diff(travel) > 0).all()
    assert (np.diff(force) > 0).all()
    given = qf.solve(qf.off_axis_tension(displacement=15, size=20), estimate=False, increment=7.5)
    assert given.history["displacement_mm"].tolist() == [0.0, 7.5, 15.0]


@pytest.mark.parametrize("convex", ["on demand", "always"])
def test_linear_solvers_find_the_same_state(convex):
    scene = qf.off_axis_tension(displacement=10, size=40)
    result = qf.solve(scene, linear="superlu", convex=convex, estimate=False)
    assert result.force == pytest.approx(qf.solve(scene, estimate=False).force, rel=1e-4)


def test_a_factor_serves_the_steps_after_it(monkeypatch):
    def solved():
        return qf.solve(qf.forming("hemisphere", size=5.0, travel=25.0), estimate=False)

    reused = solved()
    monkeypatch.setattr(tangent, "FEW", np.inf)
    each = solved()
    assert reused.linear_solves < 0.7 * each.linear_solves
    assert reused.states[-1].force == pytest.approx(each.states[-1].force, rel=2e-4)
    assert np.abs(reused.states[-1].x - each.states[-1].x).max() < 0.01


class Quadratic:
    """A potential with a given Hessian K (3, 3), whose convex one is of absolute values."""

    def __init__(self, *diagonal):
        self.K, self.at = np.diag(diagonal), np.diag_indices(3)

    @property
    def pattern(self):
        return csr_array((np.ones(len(self.at[0])), self.at), shape=(3, 3))

    def hessian(self, x, memory, convex, stress=None):
        return np.abs(self.K[self.at]) if convex else self.K[self.at], None

    def follow(self, memory):
        return True


@pytest.fixture
def quadratic(monkeypatch):
    """A potential, a tangent of it that keeps factors, and its step."""
    monkeypatch.setattr(tangent, "FEW", 0)
    potential = Quadratic(1.0, 2.0, 4.0)
    places = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    kept = tangent.Tangent(potential, places, "superlu", "on demand")
    return potential, kept, lambda: kept.step(np.zeros(3), (), np.array([1.0, -2.0, 3.0]))


def test_a_factor_that_is_near_enough_is_kept(quadratic):
    potential, kept, step = quadratic
    assert_allclose(step(), [-1.0, 1.0, -0.75])
    kept.restart()
    potential.K = np.diag([1.2, 2.2, 4.1])
    d = step()
    assert kept.factorisations == 1
    # to a tenth, by the norm of the tangent
    error = d - np.array([-1.0, 2.0, -3.0]) / np.diag(potential.K)
    assert 0.0 < error @ (np.diag(potential.K) * error) < 0.1**2 * 4.5


def test_a_factor_that_is_not_positive_definite_is_not_kept(quadratic):
    potential, kept, step = quadratic
    potential.K = np.diag([1.0, -2.0, 4.0])
    assert kept.factor(np.zeros(3), (), False)[0] == 1
    potential.K = np.diag([1.0, 2.0, 4.0])
    kept.forget()
    assert_allclose(step(), [-1.0, 1.0, -0.75])
    assert kept.factorisations == 2


def test_a_factor_is_not_kept_after_one_that_has_failed(quadratic):
    potential, kept, step = quadratic
    step()
    potential.K = np.diag([1.0, 0.0, 4.0])
    with pytest.raises(SingularMatrixError):
        kept.factor(np.ones(3), (), False)
    potential.K = np.diag([1.0, 2.0, 4.0])
    step()
    assert kept.factorisations == 3


def test_a_pattern_that_has_grown_needs_another_factor(quadratic):
    potential, kept, step = quadratic
    step()
    potential.K, potential.at = potential.K + np.diag([0.5, 0.5], 1), np.triu_indices(3)
    kept.follow(())
    assert_allclose((potential.K + np.diag([0.5, 0.5], -1)) @ step(), [-1.0, 2.0, -3.0])
    assert kept.factorisations == 2


def test_negative_curvature_in_the_first_direction_asks_for_another_factor(quadratic):
    """Then the exact tangent is tried, and the convex one serves there."""
    potential, kept, step = quadratic
    step()
    potential.K = np.diag([1.0, -2.0, -4.0])
    kept.restart()
    assert_allclose(step(), [-1.0, 1.0, -0.75])
    assert dict(kept.counts) == {"check": 2, "check, convex": 1}


def test_newtons_method_ends_after_the_steps_asked_for():
    equations = Equilibrium(qf.off_axis_tension(45, displacement=5.0, size=20.0))
    x = newton.predict(equations, equations.model.x0, 5.0)
    before = equations.residual(equations.gradient(x))
    moved = newton.minimise(equations, x, 1e-12, steps=1)
    assert 1e-12 < equations.residual(equations.gradient(moved)) < before
    assert equations.tangent.factorisations == 2


def test_relaxation_alone_reaches_newtons_state():
    scene = qf.off_axis_tension(displacement=10, size=40)
    newton = qf.solve(scene, increment=10, estimate=False)
    relaxed = qf.solve(scene, increment=10, method="relaxation", estimate=False)
    assert relaxed.force == pytest.approx(newton.force, rel=1e-3)
    assert np.abs(relaxed.shear_angle - newton.shear_angle).max() < 0.02


def test_collapse_is_flagged_and_passed():
    result = qf.solve(qf.off_axis_tension(30, "best-fit", displacement=26, size=20), estimate=False)
    assert result.status == "completed"
    assert 20 < result.collapse["travel_mm"] < 26
    assert "collapsed" in str(result.certified)
    assert all(np.isfinite(values).all() for values in result.sheet.cell_fields.values())


def test_a_sheet_without_bending_stiffness_is_refused():
    fabric = qf.Fabric(bending_warp=0.0)
    with pytest.raises(qf.InputError, match="bending stiffness"):
        qf.forming(law=fabric)


def test_a_scene_by_hand_without_bending_is_told_and_saved(tmp_path):
    # such a sheet has no equilibrium of its own: the solver may stop, but not stumble
    scene = qf.forming(size=30, travel=1.0)
    scene.terms = [term for term in scene.terms if not isinstance(term, Bending)]
    result = qf.solve(scene, estimate=False)
    assert set(result.summary()["wrinkles"]) == {"flange_lift_mm"}
    result.save(tmp_path / "out", pictures=False)


def test_round_off_is_no_residual_before_a_tool_has_touched():
    scene = qf.off_axis_tension(size=40)
    equilibrium = Equilibrium(scene)
    g = np.where(scene.fixed, 0.0, 1e-13)
    assert equilibrium.force(g) == 0.0
    assert equilibrium.residual(g) < 1e-4
    assert equilibrium.residual(1e6 * g) > 1e-4


def test_stiff_fibres_that_turn_do_not_shorten_the_steps(monkeypatch):
    def solved():
        scene = qf.off_axis_tension(45, displacement=50, size=20)
        return qf.solve(scene, increment=50.0, estimate=False)

    foreseen = solved()
    monkeypatch.setattr(newton, "_foresee", lambda equations, x, moved: None)
    plain = solved()
    assert foreseen.force == pytest.approx(plain.force, rel=1e-5)
    assert foreseen.linear_solves <= 8
    assert plain.linear_solves >= 1.5 * foreseen.linear_solves


def test_the_foreseen_stress_is_the_linearised_one():
    membrane = qf.off_axis_tension(30, size=40).membrane
    x = qf.off_axis_tension(30, size=40).x0
    dx = np.random.default_rng(0).normal(size=len(x))
    h = 1e-6
    rise = (membrane.stress(x + h * dx) - membrane.stress(x - h * dx)) / (2 * h)
    ahead = membrane.foreseen_stress(x, dx).transpose(2, 0, 1) - membrane.stress(x)
    np.testing.assert_allclose(ahead, rise, rtol=1e-6, atol=1e-6 * np.abs(rise).max())


@dataclass(frozen=True, eq=False)
class Held:
    """Where a spring is held, and how often that was committed."""

    anchor: np.ndarray
    commits: np.ndarray


class Spring(qf.Term):
    """A user's own term with memory: a spring between a node and its first place."""

    name = "spring"

    def __init__(self, dof, stiffness):
        self.dofs = np.array([[dof]])
        self.stiffness = stiffness

    def energy(self, x, state):
        return 0.5 * self.stiffness * (x[self.dofs[0]] - state.anchor) ** 2

    def gradient(self, x, state):
        return self.stiffness * (x[self.dofs] - state.anchor[:, None])

    def hessian(self, x, state, convex):
        return np.full((1, 1, 1), self.stiffness)

    def initial(self, x):
        return Held(x[self.dofs[0]], np.zeros(1))

    def commit(self, x, state):
        return replace(state, commits=state.commits + 1)


def test_own_terms_with_memory_are_committed_and_not_compared_with_another_scene():
    scene = qf.off_axis_tension(displacement=5, size=40)
    middle = np.linalg.norm(scene.sheet.blank.nodes, axis=1).argmin()
    scene.terms.append(Spring(2 * middle, 1.0))
    result = qf.solve(scene)
    assert result.memory[-1].commits == result.increments
    assert result.estimate == {"shear_angle_deg": None, "force_N": None}
    assert qf.solve(qf.off_axis_tension(displacement=5, size=40)).estimate["force_N"] < 0.1


def test_an_interrupt_keeps_what_is_there(tmp_path):
    def interrupt(progress):
        if progress.travel > 6:
            raise KeyboardInterrupt

    result = qf.solve(qf.off_axis_tension(displacement=20, size=40), callback=interrupt)
    assert result.status == "stopped"
    assert "interrupted" in result.reason
    assert 6 < result.states[-1].travel < 20
    result.save(tmp_path / "out", pictures=False)
    assert (tmp_path / "out" / "summary.json").is_file()


def test_a_scene_by_hand_needs_no_size():
    law = replace(qf.Fabric(), in_plane_bending=0.0)
    ready = qf.off_axis_tension(law=law, displacement=5, size=40)
    own = ready.sheet.blank
    blank = qf.Blank(own.nodes, own.triangles, own.warp, own.weft)
    unknowns = Unknowns()
    sheet = unknowns.sheet(blank, ready.sheet.fabric, dim=2)
    scene = qf.Model(
        name="by hand",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet)],
        x0=ready.x0,
        fixed=ready.fixed,
        drive=ready.drive,
        travel=5.0,
        increment=5.0,
        rows=5.0,
    )
    assert qf.solve(scene).force == pytest.approx(qf.solve(ready).force, rel=1e-9)


@pytest.mark.parametrize("linear", ["auto", "superlu"])
def test_a_motion_without_stiffness_stops_with_the_reason(linear):
    scene = qf.off_axis_tension(displacement=5, size=40)
    scene.fixed[:] = False  # nothing is held
    scene.fixed[0] = True
    result = qf.solve(scene, estimate=False, linear=linear)
    assert result.status == "stopped"
    assert result.reason.startswith("at 0 of 5: ")
    assert not result.certified


def test_increments_are_ten_thousand_at_most():
    model = qf.off_axis_tension(displacement=10, size=40)
    with pytest.raises(qf.InputError, match=r"increment must be at least 0\.001"):
        qf.solve(model, increment=10 / 10_000.5)
    allowed = qf.solve(model, increment=10 / 9_999.5, callback=lambda p: True, estimate=False)
    assert allowed.reason.startswith("stopped by the callback")
