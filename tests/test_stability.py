"""Saddles, snaps, rescues, perturbed starts; the same input gives the same result."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import quasiform as qf
from quasiform.energy.bending import Bending
from quasiform.energy.membrane import Membrane
from quasiform.result import measures
from quasiform.result.certificate import WRINKLED
from quasiform.result.measures import waves
from quasiform.result.stability import narrow_bands
from quasiform.solve import run as running
from quasiform.solve.equilibrium import Equilibrium, NotConvergedError
from quasiform.solve.newton import predict
from quasiform.solve.proximal import Bed, creep
from quasiform.unknowns import Unknowns
from validation.stability.scenes import arch, flat_strip


def hemisphere(size=20.0, travel=30.0):
    return qf.forming("hemisphere", orientation=0, size=size, travel=travel)


@pytest.mark.parametrize("convex", ["on demand", "never"])
def test_a_snap_through_ends_on_the_lower_branch(convex):
    result = qf.solve(arch(10.0, qf.Fabric.preset("locking")), convex=convex, estimate=False)
    assert result.status == "completed"
    assert result.negative_pivots == 0
    assert result.positions()[:, 2].min() < -5
    assert result.positions(0)[:, 2].max() > 5
    (snap,) = result.snaps  # a jump, not the error of the trapezoidal rule
    assert 1.3 < snap["released_mJ"] < 1.6


def test_a_gap_that_does_not_fall_with_the_increment_is_a_jump(monkeypatch):
    monkeypatch.setattr(running, "WEIGHED", 0.0)  # every gap is too large
    run = running.Run(Equilibrium(hemisphere()), running.Settings())
    run.open(run.start())
    with pytest.raises(running.TooCoarseError):
        run.advance(0.3, [], weigh=True)
    _, gap = run.account.missed
    assert 0 < gap < 1
    run.back()
    run.advance(0.3, [], weigh=False)
    assert [snap["released_mJ"] for snap in run.account.snaps] == pytest.approx([gap])


def test_a_saddle_is_left_on_both_sides_alike():
    """A strip that is pressed along its fibres stays exactly flat until it is told to look."""
    scene = flat_strip(10.0, qf.Fabric.preset("locking"))
    result = qf.solve(scene, estimate=False)
    assert result.rescues["saddle left"] >= 1
    assert np.abs(result.positions()[:, 2]).max() > 1
    assert "buckled away" in result.one_of_many
    assert result.summary()["one_of_many"] == result.one_of_many


def test_each_tangent_ends_alike():
    forces = [
        qf.solve(hemisphere(), convex=convex, estimate=False).force
        for convex in ("on demand", "always", "never")
    ]
    np.testing.assert_allclose(forces, forces[0], rtol=1e-3)


@pytest.mark.parametrize("setting", [{"convex": "sometimes"}, {"perturbation": -1}, {"seed": -1}])
def test_bad_settings_are_refused(setting):
    with pytest.raises(qf.InputError, match=next(iter(setting))):
        qf.solve(hemisphere(), **setting)


def test_a_perturbed_start_ends_where_the_plain_one_does_but_not_on_its_path():
    plain = qf.solve(hemisphere(), estimate=False)
    runs = [qf.solve(hemisphere(), estimate=False, perturbation=0.01, seed=s) for s in (1, 1, 2)]
    x = [run.states[-1].x for run in runs]
    np.testing.assert_array_equal(x[0], x[1])
    assert np.abs(x[0] - x[2]).max() > 1e-12
    for run in runs:
        assert run.force == pytest.approx(plain.force, rel=2e-3)
        assert run.certified.converged


def test_friction_is_not_certified_over_longer_increments_than_the_scenes_own():
    part = qf.forming("hemisphere", size=15.0, travel=6.0)
    rubbed = qf.solve(part, increment=6.0, estimate=False)
    assert "friction follows its path in increments of 5 mm, not 6" in str(rubbed.certified)
    assert "friction" not in str(qf.solve(part, increment=3.0, estimate=False).certified)
    smooth = replace(qf.Fabric(), friction=0.0)
    slides = qf.forming("hemisphere", size=15.0, travel=6.0, law=smooth)
    assert "friction" not in str(qf.solve(slides, increment=6.0, estimate=False).certified)


def test_a_wrinkled_sheet_is_certified_where_perturbed_starts_agree(monkeypatch):
    result = qf.solve(hemisphere(), estimate=False)
    waves = result.wrinkles | {"flange_lift_mm": 0.3, "waving_warp_lines": 4}
    monkeypatch.setattr(qf.Result, "flange_lift", 0.3)
    monkeypatch.setattr(qf.Result, "wrinkles", waves | {"waving_warp_lines": 0})
    coarse = result.certified.reasons  # the mesh is too coarse for the fillet
    assert not [reason for reason in coarse if "wrinkled" in reason]  # it only stands off there
    monkeypatch.setattr(qf.Result, "wrinkles", waves)
    assert result.certified.reasons[-1].startswith("wrinkled, one of many states")
    result.spread = {
        name: {"low": 1.0, "high": 1.0, "robust": True, "judged": True}
        for name in result.quantities
    }
    assert result.certified.reasons == coarse
    result.spread["force_N"]["robust"] = False
    assert set(result.certified.reasons) == {*coarse, "perturbed starts scatter in force_N"}


def test_a_state_of_lower_energy_is_named():
    result = qf.solve(hemisphere(travel=10.0), estimate=False)
    qf.spread(result, seeds=(1,))
    assert result.lower <= 1e-3 * result.energy
    assert "mJ less" not in str(result.certified)
    result.lower = 0.01 * result.energy
    assert f"found a state with {result.lower:.3g} mJ less" in str(result.certified)


def frame_in_space(shear=40.0):
    """Picture frame whose sheet may leave its plane."""
    plane = qf.picture_frame(100.0, shear, size=10.0)
    sheet = (unknowns := Unknowns()).sheet(plane.sheet.blank, qf.Fabric(), 3)
    x0, fixed, _ = unknowns.start(sheet)
    fixed[sheet.dofs] = plane.fixed.reshape(-1, 2)[:, :1]

    def frame(d):
        given = np.zeros((2, len(x0)))
        given[:, sheet.dofs[:, :2]] = np.reshape(plane.drive(d), (2, -1, 2))
        return tuple(given)

    terms = [Membrane(sheet), Bending(sheet)]
    start = "frame in space", unknowns, [sheet], terms, x0, fixed
    return qf.Model(*start, frame, plane.travel, 5.0, 5.0)


@pytest.mark.parametrize("build", [frame_in_space, partial(flat_strip, 10.0, qf.Fabric())])
def test_a_sheet_that_buckles_without_contact_has_wrinkled(build):
    result = qf.solve(build(), estimate=False)
    height = np.abs(result.positions()[:, 2]).max()
    assert height > 0.1
    assert result.wrinkles["buckle_mm"] == pytest.approx(height)
    assert result.certified.reasons == (WRINKLED,)
    assert f"the sheet has buckled by {height:.3g} mm" in result.summary()["one_of_many"]


def test_a_sheet_that_bends_under_a_load_or_is_held_flat_has_not_wrinkled():
    for load in (2e-6, 2e-5):  # N/mm²: bent by 13 and by 71 % of its length
        result = qf.solve(qf.cantilever(120.0, load), estimate=False)
        assert result.positions()[:, 2].min() < -15
        assert result.wrinkles["buckle_mm"] == 0.0
        assert result.certified
    flat = qf.solve(frame_in_space(5.0), estimate=False)
    assert 0 < flat.wrinkles["buckle_mm"] < 0.1  # less than a tenth of the thickness
    assert flat.certified


@pytest.mark.parametrize("orientation", [0.0, 30.0])
@pytest.mark.parametrize("family", ["warp", "weft"])
@pytest.mark.parametrize(("rows", "found"), [(1, True), (2, True), (3, True), (5, False)])
def test_a_band_that_is_narrower_than_the_mesh_shows_is_found(orientation, family, rows, found):
    blank = qf.rectangle(100.0, 80.0, 4.0, orientation)
    along = getattr(blank, family)
    across = blank.centroids @ [-along[1], along[0]] / blank.size
    inside = (across > 0.0) & (across < rows)
    flags = narrow_bands(blank, np.where(inside, -50.0, 20.0))
    assert flags.any() == found
    assert not flags[~inside].any()


def test_steps_and_smooth_peaks_of_shear_are_no_narrow_bands():
    blank = qf.rectangle(100.0, 80.0, 4.0)
    x = blank.centroids[:, 0]
    for gamma in (np.where(x > 0, 45.0, 5.0), 50.0 * np.exp(-((x / 12.0) ** 2)), 0.0 * x):
        assert not narrow_bands(blank, gamma).any()
    assert not narrow_bands(qf.rectangle(10.0, 10.0, 5.0), np.zeros(8)).any()


def test_a_sheet_with_narrow_bands_is_one_of_many_states(monkeypatch):
    result = qf.solve(hemisphere(size=10.0), estimate=False)
    assert result.one_of_many == ""
    monkeypatch.setattr(measures, "narrow_bands", lambda blank, _: blank.centroids[:, 0] > 145.0)
    banded = replace(result)
    assert "sheared in bands as narrow as the mesh, one of many states" in str(banded.certified)
    assert banded.one_of_many == "the sheet is sheared in bands as narrow as the mesh"
    banded.spread["force_N"] = {"low": 1.0, "high": 1.0, "robust": True, "judged": True}
    assert "bands" not in str(banded.certified)


def test_spread_tells_what_is_robust():
    result = qf.solve(hemisphere(size=10.0), estimate=False)
    table = qf.spread(result, seeds=(1, 2))
    assert table["shear_angle_mean_deg"]["robust"]
    assert table["shear_angle_mean_deg"]["low"] <= result.quantities["shear_angle_mean_deg"]
    assert result.one_of_many == ""
    result.spread["force_N"] = {"low": 1.0, "high": 9.0, "robust": False, "judged": True}
    assert result.one_of_many == "perturbed starts scatter in force_N"
    result.estimate = {"force_N": 2.0 * result.force, "shear_angle_mean_deg": 0.01}
    table = qf.spread(result, seeds=(1,))  # the mesh error is larger than the force
    assert not table["force_N"]["judged"]
    assert not table["force_N"]["robust"]
    assert table["shear_angle_mean_deg"]["robust"]
    assert "perturbed" not in result.one_of_many
    assert "the mesh error is large in force_N" in str(result.certified)
    with pytest.raises(qf.InputError, match="amplitude"):
        qf.spread(result, amplitude=0)


def test_the_bed_is_a_quadratic_term():
    bed = Bed(np.array([2.0, 4.0]))
    bed.m, bed.anchor = 0.5, np.array([1.0, 1.0])
    x, h = np.array([1.5, 0.5]), 1e-6
    for i, step in enumerate(np.eye(2) * h):
        slope = (bed.energy(x + step).sum() - bed.energy(x - step).sum()) / (2 * h)
        assert bed.gradient(x)[i, 0] == pytest.approx(slope, rel=1e-6)
        bend = (bed.gradient(x + step) - bed.gradient(x - step))[i, 0] / (2 * h)
        assert bed.hessian(x, None, False)[i, 0, 0] == pytest.approx(bend, rel=1e-6)


def test_creeping_comes_near_the_equilibrium_and_leaves_nothing_behind():
    scene = hemisphere(travel=10.0)
    run = running.Run(Equilibrium(scene), running.Settings())
    run.open(run.start())
    equilibrium = run.equations
    terms = list(equilibrium.potential.terms)
    x = predict(equilibrium, run.x, 5.0)
    assert equilibrium.residual(equilibrium.gradient(x)) > 1
    near, work = creep(equilibrium, x)
    assert work > 0
    assert equilibrium.residual(equilibrium.gradient(near)) < 0.1
    assert equilibrium.potential.terms == terms
    assert len(equilibrium.memory) == len(terms)


def test_rungs_are_climbed_in_order_and_change_nothing_in_the_end(monkeypatch):
    plain = qf.solve(hemisphere(), estimate=False)
    real, climbed = running.Run._climb, []

    def first_fails(self, target, rungs):
        """Newton's method fails once at each increment until a rung is there."""
        if 10 <= self.travel < 15 and not climbed:

            def fails(equations, x, travel):
                monkeypatch.setattr(running, "predict", predict)
                raise NotConvergedError("made to fail")

            monkeypatch.setattr(running, "predict", fails)
            if rungs:
                climbed.append([name for name, _ in rungs])
        return real(self, target, rungs)

    monkeypatch.setattr(running.Run, "_climb", first_fails)
    rescued = qf.solve(hemisphere(), estimate=False)
    assert climbed == [["proximal"]]
    assert rescued.rescues["proximal"] == 1
    assert rescued.rescues["shorter step"] >= 1
    assert rescued.stabilisation > 0
    assert rescued.summary()["stabilisation_work_relative"] == rescued.stabilisation
    assert rescued.force == pytest.approx(plain.force, rel=2e-3)
    assert rescued.certified.converged


def test_where_every_rung_fails_the_run_stops_and_says_where(monkeypatch):
    def fails(self, x):
        if self.equations.travel > 12:
            raise NotConvergedError("made to fail")
        return solve(self, x)

    solve = running.Run._solve
    monkeypatch.setattr(running.Run, "_solve", fails)
    result = qf.solve(hemisphere(), estimate=False)
    assert result.status == "stopped"
    assert 11 < result.states[-1].travel <= 12
    assert result.reason.startswith("at 1")
    assert "made to fail" in result.reason
    assert result.rescues["dynamic relaxation"] >= 1
    assert result.rescues["proximal"] > result.rescues["dynamic relaxation"]
    assert result.stabilisation == 0


def test_waves_are_counted_and_measured():
    s, t = np.meshgrid(np.arange(0.0, 200.5), np.arange(0.0, 50.0, 5.0))
    flat = np.column_stack([s.ravel(), t.ravel()])
    wavy = np.where(flat[:, 1] < 20, np.sin(2 * np.pi * flat[:, 0] / 40.0 + 0.1), 0.0)
    lines, wavelength = waves(flat, np.array([1.0, 0.0]), wavy)
    assert lines == 4
    assert wavelength == pytest.approx(40.0, abs=1.0)
    bent = np.where(np.abs(flat[:, 0] - 100) < 50, 1.0, -1.0)  # twice turned, as by a tool
    assert waves(flat, np.array([1.0, 0.0]), bent) == (0, None)
    assert waves(flat, np.array([1.0, 0.0]), np.full(len(flat), np.nan)) == (0, None)


RUN = """
import sys, json, hashlib
import quasiform as qf
linear = sys.argv[1]
result = qf.solve(qf.forming("hemisphere", orientation=45, size=20, travel=40), estimate=False,
                  linear=linear)
x = result.states[-1].x
print(json.dumps({"bits": hashlib.sha256(x.tobytes()).hexdigest(), "x": x.tolist(),
                  "force": result.force, "mean": result.quantities["shear_angle_mean_deg"]}))
"""


def run(linear, threads):
    names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
    environment = os.environ | dict.fromkeys(names, str(threads))
    done = subprocess.run(
        [sys.executable, "-c", RUN, linear],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_the_same_input_gives_the_same_bits_on_one_thread():
    assert run("auto", 1)["bits"] == run("auto", 1)["bits"]


def test_threads_and_linear_solvers_agree():
    one = run("auto", 1)
    for other in (run("auto", 2), run("superlu", 1), run("superlu", 2)):
        np.testing.assert_allclose(other["x"], one["x"], rtol=1e-6, atol=1e-6)
        assert other["force"] == pytest.approx(one["force"], rel=1e-6)
        assert other["mean"] == pytest.approx(one["mean"], rel=1e-6)


def test_a_sheet_that_folds_on_itself_is_not_certified(monkeypatch):
    result = qf.solve(hemisphere(size=10.0, travel=5.0), estimate=False)
    monkeypatch.setattr("quasiform.energy.plies.folds_on_itself", lambda *_: True)
    assert "the sheet folds on itself, and self-contact is not modelled" in str(result.certified)
