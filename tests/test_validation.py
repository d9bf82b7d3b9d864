"""The quick validation cases hold, and the runner sees what does not."""

import pytest

from validation import run


@pytest.mark.parametrize("case", ["cantilever", "oat_45", "picture_frame"])
def test_case_holds(case):
    rows = run.compare(case)
    assert rows
    missed = [row.reference.name for row in rows if not row.held]
    assert not missed


@pytest.mark.parametrize("case", run.cases())
def test_case_is_complete(case):
    assert run.references(case)
    assert (run.FOLDER / case / "README.md").is_file()


@pytest.mark.parametrize(
    ("tolerance", "inside", "outside"),
    [("1%", 10.09, 10.11), ("0.2", 9.81, 9.79), ("max", 10.0, 10.1), ("min", 10.0, 9.9)],
)
def test_bands(tolerance, inside, outside):
    reference = run.Reference("x", 10.0, tolerance, "N", "exact", "none")
    assert reference.holds(inside)
    assert not reference.holds(outside)
    assert not run.Row(reference, None).held


def test_missed_band_makes_the_exit_status(monkeypatch, capsys):
    reference = run.Reference("x", 10.0, "max", "N", "exact", "none")
    monkeypatch.setattr(run, "compare", lambda case: [run.Row(reference, 11.0)])
    assert run.main(["oat_45"]) == 1
    assert "MISS x" in capsys.readouterr().out
