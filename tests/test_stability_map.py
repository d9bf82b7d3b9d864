"""The stability map: what it runs, how it judges, and that a crash or a hang is a cell of it."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import quasiform as qf
from validation.stability import cells, draw, judge
from validation.stability.cells import Solved
from validation.stability.scenes import CASES, wavelength, waves
from validation.stability.settings import DEFAULT, SETTINGS, Cell, is_check, rechecks
from validation.stability.settings import cells as cells_of

ROOT = Path(__file__).parents[1]
PERTURBED = SETTINGS["perturbed"]
forks = pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")


def solved(setting=DEFAULT, scene="box-45", **known):
    """A made-up cell: completed, certified, with a mean shear of 10 degrees."""
    usual = {
        "outcome": "completed",
        "reached": 50.0,
        "goal": 50.0,
        "certified": "yes",
        "averages": {"shear_angle_mean_deg": 10.0},
    }
    return Solved(scene, setting, **usual | known)


def by_cell(*rows):
    return {row.cell: row for row in rows}


# What is run


@pytest.mark.parametrize("name", CASES)
def test_each_scene_is_built_with_its_size_and_its_fabric(name):
    case = CASES[name]
    fabric = case.fabric(contact=10.0, friction=0.5)
    if case.refused:
        with pytest.raises(qf.InputError, match="bending stiffness"):
            case.build(case.sizes[0], fabric)
        return
    scene = case.build(case.sizes[0], fabric)
    assert scene.size == case.sizes[0]
    assert scene.recipe.build(case.sizes[1]).size == case.sizes[1]
    assert bool(scene.contacts) == case.contact
    assert all(contact.compaction == 100.0 for contact in scene.contacts)
    assert all(contact.tool.friction == 0.5 for contact in scene.contacts)
    assert np.divide(case.sizes[:-1], case.sizes[1:]) == pytest.approx(2.0)


def test_the_specimen_is_compressed():
    coarse = CASES["oat-45-compressed"].build(20.0, qf.Fabric())
    for scene in (coarse, coarse.recipe.build(10.0)):
        x = scene.prescribed(30.0)[0][0::2]
        assert np.unique(x[scene.fixed[0::2]]) == pytest.approx([-160.0, 130.0])


def test_settings_of_contact_are_for_scenes_with_contact():
    plane = {setting for _, setting in cells_of(["oat-45-locking"], list(SETTINGS))}
    space = {setting for _, setting in cells_of(["box-0"], list(SETTINGS))}
    assert space == set(SETTINGS)
    left_out = {name for name in SETTINGS if name.startswith(("contact", "friction"))}
    assert len(left_out) == 6
    assert plane == space - left_out


def test_each_setting_changes_one_thing_or_a_pair():
    for name, setting in SETTINGS.items():
        changed = draw.describe(setting).split(", ")
        # relaxation alone: on the coarse mesh, with few increments
        count = 3 if name == "relaxation" else 2 if "+" in name else 1
        assert len(changed) == count, name


# How it is judged


def test_a_check_has_the_same_problem_and_a_perturbed_start_or_a_finer_increment():
    coarse_steps, fine_steps = SETTINGS["increment-20"], SETTINGS["increment-1"]
    assert is_check(PERTURBED, DEFAULT)
    assert is_check(DEFAULT, PERTURBED)
    assert is_check(fine_steps, coarse_steps)
    assert is_check(fine_steps, DEFAULT)
    assert not is_check(coarse_steps, fine_steps)
    assert not is_check(coarse_steps, DEFAULT)
    assert not is_check(DEFAULT, DEFAULT)
    assert not is_check(SETTINGS["perturbed+fine"], DEFAULT)
    for setting in SETTINGS.values():
        assert all(is_check(check, setting) for check in rechecks(setting))


def test_a_certified_cell_without_a_check_is_solved_again():
    alone = solved(SETTINGS["contact-10"])
    (first,) = judge.wanted(by_cell(alone))
    assert first.setting.perturbation
    assert first.setting.problem == alone.setting.problem
    failed = solved(first.setting, certified="stopped early")
    (second,) = judge.wanted(by_cell(alone, failed))
    assert second.setting.increment == pytest.approx(2.5)
    assert judge.wanted(by_cell(alone, solved(first.setting))) == []
    assert judge.wanted(by_cell(replace(alone, certified="energy"))) == []


def test_a_contradiction_is_a_difference_beyond_the_error_estimate():
    def against(difference, **known):
        other = {"shear_angle_mean_deg": 10.0 + difference}
        kept = by_cell(
            solved(estimate={"shear_angle_mean_deg": 0.2}, **known),
            solved(PERTURBED, averages=other),
        )
        return judge.contradictions([kept[Cell("box-45", DEFAULT)]], kept)

    assert against(0.19) == []
    assert against(-0.19) == []
    (found,) = against(-0.21)
    assert found.difference == pytest.approx(0.21)
    assert found.check.setting == PERTURBED
    assert against(0.21, certified="3 negative pivots of the tangent") == []


def test_error_where_the_program_gives_none():
    def sized(name, value, **known):
        return solved(SETTINGS[name], averages={"shear_angle_mean_deg": value}, **known)

    rows = [sized("coarse", 12.0), sized("default", 10.5), sized("fine", 10.0)]
    found = judge.errors("box-45", by_cell(*rows))
    r = 0.5 / 1.5
    error, origin = found["fine", "shear_angle_mean_deg"]
    assert error == pytest.approx(1.25 * 0.5 * (r + r**2 + r**3))
    assert origin == "sizes of the map"
    assert found["default", "shear_angle_mean_deg"] == (pytest.approx(1.875), "sizes of the map")
    assert found["coarse", "shear_angle_mean_deg"] == (pytest.approx(3.0), "the next finer size")
    rows[0] = replace(rows[0], outcome="stopped")
    found = judge.errors("box-45", by_cell(*rows))
    assert found["default", "shear_angle_mean_deg"] == (pytest.approx(1.0), "the next finer size")
    assert found["coarse", "shear_angle_mean_deg"] == (0.0, "none")
    rows[1] = replace(rows[1], estimate={"shear_angle_mean_deg": 0.7})
    found = judge.errors("box-45", by_cell(*rows))
    assert found["default", "shear_angle_mean_deg"] == (0.7, "program")


def test_bars():
    def missed(*rows, minutes=1.0):
        shown = {
            (row.scene, next(n for n, s in SETTINGS.items() if s == row.setting)): row
            for row in rows
        }
        kept = by_cell(*rows)
        against = judge.contradictions(shown.values(), kept)
        return [b.name for b in judge.bars(shown, kept, against, minutes) if not b.met]

    good = [solved(setting) for name, setting in SETTINGS.items() if name.startswith("increment")]
    good += [solved(), solved(PERTURBED)]
    assert missed(*good) == []
    stopped = {"outcome": "stopped", "reached": 40.0, "certified": "stopped early"}
    short = solved(SETTINGS["exact"], **stopped, reason="why")
    assert missed(*good, short) == [
        "the paper's scenes reach full travel in at least 95% of the settings"  # 7 of 8
    ]
    assert any("reason" in name for name in missed(*good, replace(short, reason="")))
    assert any("at the default" in w for w in missed(*good[:-2], solved(**stopped, reason="why")))
    assert any("hangs" in w for w in missed(*good, solved(scene="arch", outcome="hang")))
    assert any("crashes" in w for w in missed(*good, solved(scene="arch", outcome="crash")))
    assert missed(solved()) == ["each certified cell has been checked"]
    other = solved(PERTURBED, averages={"shear_angle_mean_deg": 11.0})
    assert any("contradicted" in name for name in missed(*good[:-1], other))
    uncertified = {"certified": "energy"}
    assert missed(solved(scene="arch", reason="upper branch", **uncertified)) == [
        "no completed cell ends in a wrong state"
    ]
    assert "refused" in missed(solved(scene="without-bending", **uncertified))[-1]
    assert missed(solved(scene="without-bending", outcome="refused", **uncertified)) == []
    assert len(missed(*good, minutes=41.0)) == 1


@pytest.mark.parametrize(
    ("reason", "letter"),
    [
        ("at 1 of 2: no equilibrium in 400 Newton iterations: residual 1e-3", "N"),
        ("at 1 of 2: no descent along Newton's direction: residual 1e-3", "N"),
        ("at 1 of 2: dynamic relaxation: residual 1e-2 after 5000 iterations", "R"),
        ("at 1 of 2: friction does not settle in 60 passes: residual 1e-3", "F"),
        ("at 1 of 2: the tangent is singular: no", "S"),
        ("at 1 of 2: the blank holder tilts by more than 10 degrees", "L"),
        ("disk full", "?"),
    ],
)
def test_reasons_have_letters(reason, letter):
    assert draw.code(solved(outcome="stopped", reason=reason)) == letter
    assert letter in draw.MEANING


# Wrinkles


def test_wavelength_by_zero_crossings():
    s = np.linspace(0.0, 60.0, 500)
    assert wavelength(s, np.sin(2 * np.pi * s / 13.0 + 0.4)) == pytest.approx(13.0, rel=1e-3)
    assert wavelength(s, 1.0 + s) is None


def test_waves_of_a_sheet_are_read_off_its_height():
    blank = qf.rectangle(100.0, 40.0, 2.0)
    x = blank.nodes[:, 0]

    class Waved:
        """A result with waves of 0.3 mm, 20 mm long, on a slope."""

        def positions(self):
            return np.column_stack([blank.nodes, 0.3 * np.sin(2 * np.pi * x / 20) + 0.01 * x])

    Waved.blank = blank
    line = np.column_stack([np.linspace(-40, 40, 161), np.zeros(161)])
    found = waves(line, Waved())
    assert found["wavelength_mm"] == pytest.approx(20.0, rel=0.02)
    assert found["envelope_mm"] == pytest.approx(0.3, rel=0.1)


# Processes, and what is kept


def _well(cell, limit, sender):
    sender.send({"outcome": "completed"})


def _dies(cell, limit, sender):
    os.abort()


def _hangs(cell, limit, sender):
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (1, 2))
    while True:
        pass


def _sleeps(cell, limit, sender):
    time.sleep(60)


@forks
@pytest.mark.parametrize(
    ("work", "outcome", "reason"),
    [
        (_well, "completed", ""),
        (_dies, "crash", "SIGABRT"),
        (_hangs, "hang", "processor time"),
        (_sleeps, "hang", "not done after"),
    ],
)
def test_a_crash_or_a_hang_is_a_cell(work, outcome, reason):
    limit = 0.25 if work is _sleeps else 10.0
    jobs = [Cell("arch", DEFAULT), Cell("block", DEFAULT)]
    found = list(cells.solve_all(jobs, 2, limit, work))
    assert {row.scene for row in found} == {"arch", "block"}
    for row in found:
        assert row.outcome == outcome
        assert reason in row.reason
        assert row.key == cells.key(row.cell)


@forks
def test_an_exception_is_a_crash_with_its_place(monkeypatch):
    def broken(size, fabric):
        raise ZeroDivisionError("of the fabric")

    monkeypatch.setitem(CASES, "arch", replace(CASES["arch"], build=broken))
    (row,) = cells.solve_all([Cell("arch", DEFAULT)], 1)
    assert row.outcome == "crash"
    assert row.reason.startswith("ZeroDivisionError: of the fabric (test_stability_map.py:")


def test_cells_are_kept_by_their_input(tmp_path):
    row = solved(key="1", date="2026-01-01T00:00:00+00:00", rescues={"proximal": 2})
    path = tmp_path / "cells.json"
    cells.write(path, by_cell(row, solved(PERTURBED)))
    assert cells.read(path)[row.cell] == row
    json.loads(path.read_text())
    newer = replace(row, date="2026-01-02T00:00:00+00:00")
    cells.write(tmp_path / "other.json", by_cell(newer))
    assert cells.read(tmp_path / "other.json", path)[row.cell] == newer
    keys = {cells.key(Cell("arch", s)) for s in SETTINGS.values()} | {
        cells.key(Cell("block", DEFAULT))
    }
    assert len(keys) == len(SETTINGS) + 1


def test_comments_and_docstrings_leave_the_fingerprint(tmp_path):
    path = tmp_path / "solve.py"

    def of(text):
        path.write_text(text)
        return cells.fingerprint([path])

    code = 'def f(x):\n    """Say."""\n    return x + 1\n'
    assert of(code) == of(code.replace("Say", "Tell").replace("+ 1", "+ 1  # why"))
    assert of(code) != of(code.replace("+ 1", "- 1"))


def test_map_of_a_small_scene(tmp_path):
    command = [sys.executable, "-m", "validation.stability", "--only", "block", "--out", tmp_path]
    command += ["--settings", "default", "contact-10", "perturbed"]
    first = subprocess.run([*command, "--fresh"], cwd=ROOT, capture_output=True, text=True)
    assert first.returncode == 0, first.stdout + first.stderr
    assert "4/4" in first.stdout or "1/1" in first.stdout  # the check of contact-10
    kept = cells.read(tmp_path / "cells.json")
    row = kept[Cell("block", DEFAULT)]
    assert row.arrived
    assert row.certified == "yes"
    report = (tmp_path / "map.md").read_text()
    assert "| and in all of them at the default | 0 of 0 | met |" in report
    assert (tmp_path / "map.png").stat().st_size > 10_000
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert again.returncode == 0
    assert "certified" not in again.stdout.replace("each certified", "").replace("no certified", "")
    assert cells.read(tmp_path / "cells.json") == kept
