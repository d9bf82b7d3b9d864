"""Derivatives by parameters against central differences of the same increments."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import quasiform as qf
from quasiform.energy.friction import Friction
from quasiform.recipe import built
from quasiform.solve import sensitivity
from quasiform.solve.equilibrium import Equilibrium
from quasiform.solve.parameters import parameters, with_value
from quasiform.solve.run import Run, Settings

LAW = "fabric.shear.S_ini", "fabric.shear.C_mid"
FABRIC = "fabric.bending_warp", "fabric.thickness", *LAW
ALL = "fabric.friction", "tools.holder.mass", *FABRIC
TIGHT = 1e-8


@pytest.fixture(scope="module", params=[0.0, 45.0])
def hemisphere(request):
    model = qf.forming("hemisphere", orientation=request.param, size=20, travel=45)
    return qf.solve(model, estimate=False, tolerance=1e-9)


@pytest.fixture(scope="module")
def strip():
    model = qf.off_axis_tension(displacement=50, size=20)
    return qf.solve(model, estimate=False, tolerance=TIGHT)


def again(result, model):
    """Numbers at the end of the same increments, solved by the solver itself."""
    settings = Settings(tolerance=result.settings["tolerance"])
    run = Run(Equilibrium(model, tolerance=settings.tolerance), settings)
    run.open(run.start())
    run.keep()
    for travel, _ in result.track.increments:
        if travel > 0:
            run.advance(travel, [], weigh=False)
    run.keep()
    return run.result("", 0.0).quantities


def to_round_off(result, model):
    """Numbers at the end of the same increments, each solved by Newton's method to round-off."""
    run = sensitivity._Run.begin(model)
    tangent = sensitivity._WholeTangent(model, run.memory, result.settings)
    for travel, x in result.track.increments:
        x = np.where(model.fixed, model.prescribed(travel)[0], x)
        for _ in range(20):
            x, lagged, g = run.at(x)
            if np.abs(g[tangent.free]).sum() < 1e-7:
                break
            tangent.factor(x, run.memory, lagged)
            x = x.copy()
            x[tangent.free] -= tangent.solve(g[tangent.free])
        else:
            raise AssertionError(f"not converged at {travel} mm")
        run.commit(x, lagged)
    return run.numbers(result, run.columns(travel))


def central(result, name, solve, share):
    """Derivatives by central differences with a share of a parameter."""
    h = share * parameters(result.model)[name].value
    high, low = (solve(result, with_value(result.model, name, v)) for v in around(result, name, h))
    return {n: (high[n] - low[n]) / (2 * h) for n in low}


def around(result, name, h):
    value = parameters(result.model)[name].value
    return value + h, value - h


@pytest.mark.parametrize("name", FABRIC)
def test_strip_against_central_differences_of_the_solver(strip, name):
    found = strip.sensitivity([name]).derivatives[name]
    for output, expected in central(strip, name, again, 1e-3).items():
        assert found[output] == pytest.approx(expected, rel=1e-3), output


@pytest.mark.parametrize("name", ALL)
def test_hemisphere_against_central_differences_to_round_off(hemisphere, name):
    found = hemisphere.sensitivity([name]).derivatives[name]
    value, numbers = parameters(hemisphere.model)[name].value, hemisphere.quantities
    coarse, fine = (central(hemisphere, name, to_round_off, share) for share in (3e-4, 1e-4))
    for output in ("force_N", "shear_angle_deg", "shear_angle_mean_deg", "draw_in_+x_mm"):
        least = 1e-6 * numbers[output] / value
        assert coarse[output] == pytest.approx(fine[output], rel=2e-4, abs=least), output
        assert found[output] == pytest.approx(fine[output], rel=1e-3, abs=least), output


def test_the_step_is_short_enough_for_the_curvature_of_contact():
    """A forward difference with a step of 3e-5 misses this one by .26 %."""
    model = qf.forming("hemisphere", orientation=45.0, size=10, travel=60)
    result, name = qf.solve(model, estimate=False, tolerance=1e-9), "fabric.thickness"
    found = result.sensitivity([name]).derivatives[name]["draw_in_+x_mm"]
    expected = central(result, name, to_round_off, 1e-5)["draw_in_+x_mm"]
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", ["fabric.friction", "tools.holder.mass"])
@pytest.mark.parametrize("hemisphere", [45.0], indirect=True)
def test_hemisphere_against_central_differences_of_the_solver(hemisphere, name):
    """Not at 0 degrees, where on so coarse a mesh anchors depend on the iterates of the solver."""
    found = hemisphere.sensitivity([name]).derivatives[name]
    expected = central(hemisphere, name, again, 1e-3)["force_N"]
    assert found["force_N"] == pytest.approx(expected, rel=1e-3)


def test_lagged_values_add_their_derivative_to_the_hessian():
    """On tools that tilt too, where some points touch for the first time."""
    model = qf.forming("hemisphere", orientation=45, size=25, travel=40, symmetry="none")
    result = qf.solve(model, estimate=False)
    x, before = result.states[-1].x, result.states[-2].x
    v, h = np.random.default_rng(0).normal(size=len(x)), 1e-6
    active = fresh = 0
    for term in (t for t in model.terms if isinstance(t, Friction)):
        start = term.commit(before, term.refresh(before, term.initial(model.x0)))
        rows, H = term.through_refresh(x, start, term.refresh(x, start))
        high, low = (term.gradient(x, term.refresh(x + d, start)) for d in (h * v, -h * v))
        found = np.zeros_like(high)
        found[rows] = np.einsum("sij,sj->si", H, v[term.dofs[rows]])
        expected = (high - low) / (2 * h)
        assert found == pytest.approx(expected, abs=1e-4 * np.abs(expected).max(initial=1e-9))
        active, fresh = active + len(rows), fresh + int((start.p[rows] <= 0).sum())
    assert active > 50
    assert fresh > 0


def test_along_the_path_and_at_the_end(hemisphere):
    found = hemisphere.sensitivity(["friction"], ["force_N"])
    along = found.along["fabric.friction"]["force_N"]
    assert len(along) == len(hemisphere.history["force_N"])
    assert along[0] == 0
    assert along[-1] == pytest.approx(found.derivatives["fabric.friction"]["force_N"])
    half = qf.solve(
        qf.forming(
            "hemisphere", orientation=hemisphere.model.parameters["orientation"], size=20, travel=20
        ),
        estimate=False,
        tolerance=1e-9,
    )
    row = np.flatnonzero(hemisphere.history["travel_mm"] == 20)[0]
    expected = half.sensitivity(["friction"]).derivatives["fabric.friction"]["force_N"]
    assert along[row] == pytest.approx(expected, rel=1e-2)


def test_default_parameters_have_values_and_standings(strip):
    found = strip.sensitivity()
    assert found.parameters["fabric.thickness"].standing == "stated"
    assert found.parameters["fabric.in_plane_bending"].standing == "assumed"
    assert found.derivatives["fabric.friction"]["force_N"] == 0
    assert "angle" not in found.parameters
    table = found.table()
    assert {len(column) for column in table.values()} == {len(found.parameters) * 7}
    row = table["output"].index("force_N")
    assert table["by_percent"][row] == pytest.approx(
        0.01 * table["value"][row] * table["derivative"][row]
    )


@dataclass(frozen=True, eq=False)
class Drawn:
    longest: np.ndarray


class Straps(qf.Term):
    """Springs from the free edge to where it was, which harden by their longest stretch so far."""

    name = "straps"

    def __init__(self, sheet, stiffness):
        self.stiffness = stiffness
        self.nodes = np.flatnonzero(np.abs(sheet.blank.nodes[:, 1]) > 79.9)
        self.dofs, self.flat = sheet.dofs[self.nodes], sheet.blank.nodes[self.nodes]

    def initial(self, x):
        return Drawn(np.zeros(len(self.dofs)))

    def commit(self, x, state):
        return Drawn(np.maximum(state.longest, np.linalg.norm(x[self.dofs] - self.flat, axis=1)))

    def dissipated(self, before, after, x):
        return float((self.energy(x, before) - self.energy(x, after)).sum())

    def _k(self, state):
        return self.stiffness * (1 + 0.02 * state.longest)[:, None]

    def energy(self, x, state):
        return (0.5 * self._k(state) * (x[self.dofs] - self.flat) ** 2).sum(1)

    def gradient(self, x, state):
        return self._k(state) * (x[self.dofs] - self.flat)

    def hessian(self, x, state, convex):
        return self._k(state)[:, None] * np.eye(2)


def strapped(size, like, stiffness):
    model = qf.off_axis_tension(displacement=40, size=size)
    model.terms.append(Straps(model.sheet, stiffness))
    return model


def test_a_number_of_an_own_recipe_and_an_own_term_with_memory():
    result = qf.solve(built(strapped, 20.0, stiffness=2e-4), estimate=False, tolerance=TIGHT)
    found = result.sensitivity(["stiffness"]).derivatives["stiffness"]
    assert found["force_N"] > 0
    for output, expected in central(result, "stiffness", again, 1e-3).items():
        assert found[output] == pytest.approx(expected, rel=1e-3), output


def test_a_term_that_refreshes_has_to_give_its_derivative():
    class Lagged(Straps):
        def refresh(self, x, state):
            return self.commit(x, state)

    def change(model):
        model.terms.append(Lagged(model.sheet, 1e-4))

    model = qf.off_axis_tension(displacement=5, size=20).including(change)
    result = qf.solve(model, estimate=False)
    with pytest.raises(
        qf.InputError, match=r"'straps' has lagged values, but no `through_refresh`"
    ):
        result.sensitivity(["thickness"])


def test_errors_by_parameters_beside_that_of_the_mesh(strip):
    uncertain = {"S_ini": 4e-4, "thickness": 0.05}
    judged = replace(strip, estimate={"force_N": 0.5})
    found, rates = judged.parameter_errors(uncertain), strip.sensitivity(uncertain).derivatives
    entry = found["force_N"]
    by = [4e-4 * rates[LAW[0]]["force_N"], 0.05 * rates["fabric.thickness"]["force_N"]]
    assert [entry[LAW[0]], entry["fabric.thickness"]] == pytest.approx(np.abs(by))
    assert [entry["value"], entry["mesh"]] == [strip.force, 0.5]
    assert entry["total"] == pytest.approx(np.sqrt(0.25 + by[0] ** 2 + by[1] ** 2))
    assert found["shear_angle_deg"]["mesh"] is None


def test_a_saddle_left_by_less_than_a_tenth_of_the_thickness_is_no_other_path(strip):
    little = replace(strip, rescues={"saddle left": 1}, parted=0.01)
    found, expected = (result.sensitivity(["thickness"]) for result in (little, strip))
    assert found.derivatives == expected.derivatives


def test_a_polish_that_does_not_end_nearby_keeps_the_state_of_the_run(hemisphere, monkeypatch):
    name = "fabric.thickness"
    expected = hemisphere.sensitivity([name]).derivatives[name]["force_N"]
    solve = sensitivity._WholeTangent.solve

    def far(self, b):
        x = solve(self, b)
        return x * np.nan if b.ndim == 1 and np.abs(x).max() > 1e-6 else x  # the polish only

    monkeypatch.setattr(sensitivity._WholeTangent, "solve", far)
    monkeypatch.setattr(sensitivity, "_check_motion", lambda *given: None)  # its rates are wrong
    found = hemisphere.sensitivity([name]).derivatives[name]["force_N"]
    assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"reason": "interrupted"}, "not completed: interrupted"),
        ({"snaps": [{"from_mm": 9.0, "to_mm": 10.0, "released_mJ": 1.0}]}, "jumped .* near 10 mm"),
        ({"rescues": {"saddle left": 1}, "parted": 0.3}, r"unstable and buckled away, by 0.3 mm"),
        ({"stabilisation": 0.1}, "a rescue of the solver"),
        ({"negative_pivots": 2}, "not converged: 2 negative pivots"),
        ({"increments": 3}, "continued from a record"),
        ({"track": None}, "holds no increments"),
    ],
)
def test_refused_with_the_reason(strip, change, why):
    with pytest.raises(qf.InputError, match=why):
        replace(strip, **change).sensitivity(["thickness"])


def test_refused_where_the_model_was_changed_by_hand():
    result = qf.solve(qf.off_axis_tension(displacement=5, size=40), estimate=False)
    result.model.terms[0].volume = 2 * result.model.terms[0].volume
    with pytest.raises(qf.InputError, match="changed by hand"):
        result.sensitivity(["thickness"])


@pytest.mark.parametrize(
    ("scene", "size"), [("box", 15), ("hemisphere", 20)], ids=["box", "hemisphere"]
)
def test_refused_where_the_sheet_jumps_between_increments(scene, size):
    """Both fold at 45 degrees, without a saddle on the way; one at the end of its travel."""
    result = qf.solve(qf.forming(scene, orientation=45, size=size), estimate=False)
    with pytest.raises(qf.InputError, match=r"no sensitivities: (between|the sheet|the run)"):
        result.sensitivity(["friction"])


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("frction", "did you mean 'fabric.friction'"),
        ("C_ini", "one of fabric.shear.C_ini, fabric.warp.C_ini, fabric.weft.C_ini"),
        ("angle", "changes the mesh"),
        ("displacement", "unknown|changes|travel"),
    ],
)
def test_parameters_that_are_refused(strip, name, why):
    with pytest.raises(qf.InputError, match=why):
        strip.sensitivity([name])


def test_outputs_that_are_refused(strip):
    with pytest.raises(qf.InputError, match="unknown output 'force': did you mean 'force_N'"):
        strip.sensitivity(["thickness"], ["force"])


def test_a_number_that_is_zero_is_refused(hemisphere):
    with pytest.raises(qf.InputError, match=r"'tools\.holder\.force' is zero"):
        hemisphere.sensitivity(["tools.holder.force"])
