"""The chart of error against work: its pure functions on made-up rows, nothing is solved."""

from dataclasses import replace

import numpy as np
import pytest

from quasiform.result.estimate import discretisation_error
from validation.speed import chart
from validation.speed.rows import REFERENCE, Row, expected_seconds, judged, pareto, read, write
from validation.speed.runs import PROBLEMS, plans

ROW = Row(
    scene="hemisphere",
    strategy="full path",
    size=10.0,
    increment=0.0,
    seconds=2.5,
    wall=3.0,
    dofs=834,
    solves=285.0,
    units=57.5,
    force=49.4,
    p99=46.0,
    certified="yes",
    estimate=None,
    estimate_force=None,
    version="1",
)
FINEST = replace(ROW, strategy=REFERENCE, size=1.25, seconds=90.0, p99=45.5, force=49.0)


def test_front_leaves_out_what_is_beaten():
    points = [(3.0, 1.0), (1.0, 4.0), (2.0, 2.0), (2.5, 3.0), (2.0, 2.0), (9.0, 0.999)]
    assert pareto(points) == [1, 2, 0]
    assert pareto(points, gain=0.0) == [1, 2, 0, 5]
    assert pareto([]) == []


def test_errors_are_against_the_reference_of_the_scene():
    other = replace(ROW, scene="box")
    fields = {ROW.name: np.array([1.0, 3.0]), FINEST.name: np.array([2.0, 1.0])}
    row, alone, reference = judged([ROW, other, FINEST], fields)
    assert row.error_field == pytest.approx(1.5)
    assert row.error == pytest.approx(0.5)
    assert row.error_force == pytest.approx(100 * (49.4 / 49.0 - 1))
    assert alone.error is None
    assert reference.error is None


def test_full_path_is_estimated_from_the_same_on_a_coarser_mesh():
    coarse, convex = replace(ROW, size=20.0, p99=42.0), replace(ROW, strategy="convex")
    found = judged([coarse, ROW, convex])
    assert [row.estimate for row in found] == [
        None,
        pytest.approx(discretisation_error([46.0, 42.0], (10.0, 20.0))),
        None,
    ]
    assert judged(found) == found


def test_expected_time_is_that_of_the_nearest_coarser_run_like_it():
    known = [replace(ROW, size=20.0, seconds=1.0), ROW, replace(ROW, strategy="whole", seconds=7.0)]
    assert expected_seconds("hemisphere", "whole", 5.0, 0.0, known) == pytest.approx(7 * 6)
    assert expected_seconds("hemisphere", "full path", 2.5, 0.0, known) == pytest.approx(2.5 * 36)
    assert expected_seconds("hemisphere", "full path", 20.0, 0.0, known) is None
    assert expected_seconds("box", "full path", 5.0, 0.0, known) is None


def test_rows_survive_their_file(tmp_path):
    rows = judged([ROW, FINEST])
    write(rows, tmp_path / "rows.csv")
    assert read(tmp_path / "rows.csv") == rows
    assert read(tmp_path / "none.csv") == []


def test_every_panel_has_its_default_and_one_reference():
    found = plans(list(PROBLEMS))
    assert len(set(found)) == len(found)
    for name, problem in PROBLEMS.items():
        own = [plan for plan in found if plan.scene == name]
        defaults = [p for p in own if (p.strategy, p.size, p.increment) == (*problem.default, 0.0)]
        assert len(defaults) == problem.charted
        references = [p.size for p in own if p.strategy == REFERENCE]
        assert len(references) == problem.charted
        assert all(
            size < min(p.size for p in own if p.strategy != REFERENCE) for size in references
        )
    assert len(plans(["box"], quick=True)) < len(plans(["box"]))


def test_chart_is_drawn_from_rows(tmp_path):
    default = replace(ROW, strategy="continuation", size=5.0, seconds=3.3, units=60.0, p99=45.7)
    fields = {row.name: np.array([row.p99]) for row in (ROW, default, FINEST)}
    rows = judged([ROW, default, FINEST], fields)
    assert [row.size for row in rows if chart.is_default(row)] == [5.0]
    paths = chart.draw(rows, tmp_path)
    assert len(paths) == 4
    for path in paths:
        assert path.stat().st_size > 10_000
