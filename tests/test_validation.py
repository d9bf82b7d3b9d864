"""Quick validation cases pass, and the suite reports what does not."""

import json
import re

import pytest

from validation import frozen, mutations, run
from validation.apart import outcome
from validation.bands import (
    FAILED,
    INFORMATION,
    LIMITATION,
    MISSING,
    NO_REFERENCE,
    PASSED,
    SKIPPED,
    Reference,
    Row,
)
from validation.tables import read_table


@pytest.mark.parametrize("case", ["cantilever", "oat_45", "picture_frame"])
def test_case_passes(case):
    rows, problem = run.compare(case, outcome(case, quick=True).values, quick=True)
    assert rows
    assert not problem
    assert not [row.reference.name for row in rows if not row.passed]


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
    assert sum(row.quick_seconds or 0 for row in times) < 300
    assert sum(row.seconds for row in times) < 3600


@pytest.mark.parametrize(
    ("tolerance", "inside", "outside"),
    [("1%", 10.09, 10.11), ("0.2", 9.81, 9.79), ("max", 10.0, 10.1), ("min", 10.0, 9.9)],
)
def test_bands(tolerance, inside, outside):
    reference = Reference("x", 10.0, tolerance, "N", "exact", "none")
    assert reference.accepts(inside)
    assert not reference.accepts(outside)
    assert reference.used(inside) <= 1 < reference.used(outside)
    assert Row(reference, inside).state == PASSED
    assert Row(reference, outside).state == FAILED
    assert Row(reference, float("nan")).state == FAILED
    assert not Row(reference, None).passed


def test_a_limitation_has_a_band_of_its_own():
    reference = Reference("x", 10.0, "min", "N", "measured", "a test", "rovings slip")
    assert Row(reference, 11.0).state == LIMITATION
    assert Row(reference, 9.0).state == FAILED
    assert Row(reference, None).state == MISSING


def test_rows_that_are_not_judged():
    awaited = Reference("x", None, "10%", "deg", "measured", "nobody yet")
    assert Row(awaited, 3.0).state == Row(awaited, None).state == NO_REFERENCE
    shown = Reference("x", 0.0, "report", "N", "own", "none")
    assert Row(shown, 3.0).state == INFORMATION
    assert Row(shown, None).state == MISSING
    assert Row(shown, float("nan")).state == FAILED
    slow = Reference("x", 1.0, "max", "N", "own", "none", only="full")
    assert Row(slow, None, quick=True).state == SKIPPED
    assert Row(slow, None, quick=False).state == MISSING


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (
            "x,,1%,N,exact,none",
            "'exact', expected 'measured', as the row has no value",
        ),
        ("x,1,1%,N,guessed,none", "'guessed', expected 'measured', 'input', 'between tests'"),
        ("x,0,1%,N,exact,none", "percentage of zero"),
        (
            "x,1,small,N,exact,none",
            "column tolerance: .*, expected a number of at least",
        ),
        (
            "x,1,-1,N,exact,none",
            "column tolerance: .*, expected a number of at least",
        ),
        (
            "x,one,1%,N,exact,none",
            r"csv, row 2 \(x\), column value: 'one', expected a number",
        ),
        ("x,1,1%,N,exact", "5 cells, expected 6"),
        (
            "x,1,1%,N,exact,none\nx,2,1%,N,exact,none",
            r"row 3 \(x\), column name: 'x', expected a unique name",
        ),
        ("", "no rows"),
    ],
)
def test_a_bad_reference_is_refused_with_one_line(row, message, tmp_path):
    file = tmp_path / "reference.csv"
    file.write_text(f"name,value,tolerance,unit,standing,source\n{row}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_table(file, Reference)


def test_missed_band_makes_the_exit_status(monkeypatch, capsys, tmp_path):
    def evaluate(case, folder, *, quick):
        reference = Reference("x", 10.0, "max", "N", "exact", "none")
        return run.Case(case, (Row(reference, 11.0),), date="2000-01-01T00:00:00+00:00")

    monkeypatch.setattr(run, "evaluate", evaluate)
    assert run.main(["oat_45", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert re.search("FAILED +x ", said)
    assert "1 row failed" in said
    assert "failed" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_interrupted_run_leaves_a_report(monkeypatch, capsys, tmp_path):
    def evaluate(case, folder, *, quick):
        if case == "oat_30":
            raise KeyboardInterrupt
        return run.Case(case, date="2000-01-01T00:00:00+00:00")

    monkeypatch.setattr(run, "evaluate", evaluate)
    assert run.main(["oat_45", "oat_30", "--out", str(tmp_path)]) == 3
    assert "1 of 2 cases" in capsys.readouterr().out
    assert "not run yet" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_unknown_and_missing_columns_are_refused(tmp_path):
    file = tmp_path / "reference.csv"
    header = "name,value,tolerance,unit,standing,source"
    for text, message in (
        (f"{header},sources\nx,1,1%,N,exact,none,\n", "unknown column sources, expected name, "),
        ("name,value\nx,1\n", "row 1: no column tolerance, unit, standing, source"),
        (f"{header},name\nx,1,1%,N,exact,none,x\n", "expected unique column names"),
    ):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            read_table(file, Reference)


@pytest.mark.parametrize(
    ("change", "snaps", "status"), [(0.0, 0, 0), (1e-10, 0, 0), (1e-8, 0, 1), (1e-8, 1, 0)]
)
def test_frozen_results_differ_beyond_round_off(change, snaps, status, tmp_path, capsys):
    files = []
    for name, factor in (("a.json", 1.0), ("b.json", 1.0 + change)):
        run = {"history": {"force_N": [0.0, 2.0 * factor]}, "quantities": {"x": None}}
        files.append(tmp_path / name)
        files[-1].write_text(json.dumps({"box": run | {"snaps": snaps}}))
    assert frozen.main(["compare", *map(str, files)]) == status
    said = capsys.readouterr().out
    assert ("snap: not judged" in said) == bool(snaps)
    assert ("history force_N" in said) == bool(change)


def test_frozen_results_that_cannot_be_compared_differ(tmp_path):
    run = {"history": {"force_N": [1.0]}, "quantities": {}, "snaps": 0}
    for other in ({}, {"box": run | {"history": {}}}, {"box": run | {"quantities": {"x": 1.0}}}):
        assert frozen.compare({"box": run}, other) == 1


def test_mutants_are_signs_comparisons_and_bounds():
    source = """LIMIT = 1e-3  # µ
def f(x: int = -1) -> float:
    if x[-1] <= 0 and "a" + "b":
        raise ValueError(1 + 1)
    x += max(x, 2)
    return -x - 0.5 * x[0:3]
"""
    found = mutations.mutants("f.py", source.encode())
    assert [(m.line, m.after) for m in found] == [
        (1, "LIMIT = 0.01  # µ"),
        (3, 'if x[-1] > 0 and "a" + "b":'),
        (3, 'if x[-1] <= 1 and "a" + "b":'),
        (5, "x -= max(x, 2)"),
        (5, "x += max(x, 3)"),
        (6, "return +x - 0.5 * x[0:3]"),
        (6, "return -x + 0.5 * x[0:3]"),
    ]
    for m in found:
        changed = source.encode()[: m.start] + m.new.encode() + source.encode()[m.end :]
        assert changed.decode().splitlines()[m.line - 1].strip() == m.after


def test_mutants_are_drawn_in_the_same_order_without_equivalent_ones():
    drawn = mutations.draw(0)
    assert drawn == mutations.draw(0)
    assert drawn != mutations.draw(1)
    listed = mutations.Path(mutations.__file__).with_name("equivalent_mutants.csv")
    known = read_table(listed, mutations.Equivalent, keyed=False)
    assert not {(m.file, m.before, m.after) for m in drawn} & {
        (row.file, row.before, row.after) for row in known
    }
