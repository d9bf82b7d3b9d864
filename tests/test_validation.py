"""The quick validation cases hold, and the runner sees what does not."""

import pytest

from validation import run
from validation.apart import hand_over
from validation.bands import (
    AWAITED,
    HELD,
    LEFT_OUT,
    LIMITATION,
    MISSED,
    MISSING,
    SHOWN,
    Reference,
    Row,
    read,
)


@pytest.mark.parametrize("case", ["cantilever", "oat_45", "picture_frame"])
def test_case_holds(case):
    rows, problem = run.compare(case, hand_over(case, quick=True).values, quick=True)
    assert rows
    assert not problem
    assert not [row.reference.name for row in rows if not row.held]


@pytest.mark.parametrize("case", run.cases())
def test_case_is_complete(case):
    assert run.references(case)
    assert (run.FOLDER / case / "case.py").is_file()
    readme = (run.FOLDER / case / "README.md").read_text(encoding="utf-8")
    assert readme.startswith("# ")


def test_every_case_is_listed():
    assert set(run.cases()) == set(run.listed())
    assert set(run.cases(quick=True)) < set(run.cases())


def test_quick_suite_is_expected_to_take_less_than_five_minutes_and_all_less_than_sixty():
    times = run.listed().values()
    assert sum(quick or 0 for _, quick in times) < 300
    assert sum(full for full, _ in times) < 3600


@pytest.mark.parametrize(
    ("tolerance", "inside", "outside"),
    [("1%", 10.09, 10.11), ("0.2", 9.81, 9.79), ("max", 10.0, 10.1), ("min", 10.0, 9.9)],
)
def test_bands(tolerance, inside, outside):
    reference = Reference("x", 10.0, tolerance, "N", "exact", "none")
    assert reference.holds(inside)
    assert not reference.holds(outside)
    assert reference.used(inside) <= 1 < reference.used(outside)
    assert Row(reference, inside).state == HELD
    assert Row(reference, outside).state == MISSED
    assert Row(reference, float("nan")).state == MISSED
    assert not Row(reference, None).held


def test_a_limitation_has_a_band_of_its_own():
    reference = Reference("x", 10.0, "min", "N", "measured", "a test", "rovings slip")
    assert Row(reference, 11.0).state == LIMITATION
    assert Row(reference, 9.0).state == MISSED
    assert Row(reference, None).state == MISSING


def test_rows_that_are_not_judged():
    awaited = Reference("x", None, "10%", "deg", "measured", "nobody yet")
    assert Row(awaited, 3.0).state == Row(awaited, None).state == AWAITED
    shown = Reference("x", 0.0, "report", "N", "own", "none")
    assert Row(shown, 3.0).state == SHOWN
    assert Row(shown, None).state == MISSING
    assert Row(shown, float("nan")).state == MISSED
    slow = Reference("x", 1.0, "max", "N", "own", "none", only="full")
    assert Row(slow, None, quick=True).state == LEFT_OUT
    assert Row(slow, None, quick=False).state == MISSING


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("x,,1%,N,exact,none", "no reference value"),
        ("x,1,1%,N,guessed,none", "unknown standing"),
        ("x,0,1%,N,exact,none", "percent of zero"),
        ("x,1,small,N,exact,none", "tolerance must be"),
        ("x,1,-1,N,exact,none", "tolerance must be"),
        ("x,one,1%,N,exact,none", "no number: 'one'"),
        ("x,1,1%,N,exact", "not one entry a column"),
        ("x,1,1%,N,exact,none\nx,2,1%,N,exact,none", "more than one row x"),
        ("", "no row"),
    ],
)
def test_a_reference_that_says_nothing_is_refused(row, message, tmp_path):
    file = tmp_path / "reference.csv"
    file.write_text(f"name,value,tolerance,unit,standing,source\n{row}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read(file)


def test_missed_band_makes_the_exit_status(monkeypatch, capsys, tmp_path):
    def evaluate(case, folder, *, quick):
        reference = Reference("x", 10.0, "max", "N", "exact", "none")
        return run.Case(case, (Row(reference, 11.0),), date="2000-01-01T00:00:00+00:00")

    monkeypatch.setattr(run, "evaluate", evaluate)
    assert run.main(["oat_45", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "MISSED      x" in said
    assert "1 band missed" in said
    assert "missed" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_interrupted_run_leaves_a_report(monkeypatch, capsys, tmp_path):
    def evaluate(case, folder, *, quick):
        if case == "oat_30":
            raise KeyboardInterrupt
        return run.Case(case, date="2000-01-01T00:00:00+00:00")

    monkeypatch.setattr(run, "evaluate", evaluate)
    assert run.main(["oat_45", "oat_30", "--out", str(tmp_path)]) == 3
    assert "1 of 2 cases" in capsys.readouterr().out
    assert "not run yet" in (tmp_path / "report.html").read_text(encoding="utf-8")
