"""Run validation cases, compare their values with `reference.csv`, and write the report.

    python -m validation.run                     every case
    python -m validation.run --quick             the cases of the quick suite
    python -m validation.run oat_45 ...          some cases

`quasiform validate` does the same. Each case is a folder with `case.py`, `reference.csv` (see
`bands.py`) and a README; `case.py` has a function `values()` that returns {name: value}, or
`run(quick)` that returns an `Outcome`. `cases.csv` lists the cases in the order of the report.
Each case runs in its own process, and the report is written again after each case.

Exit status: 0 every row passed; 1 a row failed, or a case, a value or a reference is missing;
2 wrong input; 3 interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quasiform.checks import InputError, suggestion
from quasiform.result.files import check_folder

from . import report
from .agreement import headline
from .bands import Case, Listed, Measured, Reference, Row
from .report_text import print_case, verdict
from .tables import read_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from quasiform.result.run import Result

FOLDER = Path(__file__).parent
OUTCOME = "outcome.json"
NOTHING = {"values": {}, "notes": [], "figures": [], "sheets": []}  # what a case leaves at first
LIMIT_S = 3600.0  # a case that takes longer is stopped


@dataclass(frozen=True)
class Outcome:
    """What a case returns.

    Parameters
    ----------
    values : dict of name to number
        Values of the rows of `reference.csv`, each in the unit of its row.
    figures : dict of caption to Figure
        Pictures for the report.
    sheets : dict of caption to Result
        Formed sheets, shown in 3D.
    notes : list of str
        Remarks on this run, Markdown.
    """

    values: dict[str, float]
    figures: dict[str, Figure] = field(default_factory=dict)
    sheets: dict[str, Result] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def listed() -> dict[str, Listed]:
    """Rows of `cases.csv` by case."""
    return {row.case: row for row in read_table(FOLDER / "cases.csv", Listed)}


def cases(*, quick: bool = False) -> list[str]:
    """Names of the cases in the order of `cases.csv`, then of the folders not listed there."""
    known = listed()
    if quick:
        return [name for name, row in known.items() if row.quick_seconds is not None]
    found = {path.parent.name for path in FOLDER.glob("*/case.py")}
    found |= {path.parent.name for path in FOLDER.glob("*/reference.csv")}
    return [*known, *sorted(found - known.keys())]


def references(case: str) -> list[Reference]:
    """Rows of a case's `reference.csv`, completed with the values of its `measured_*.csv`.

    Raises
    ------
    ValueError
        If a measured value belongs to no row without a value.
    """
    rows = read_table(FOLDER / case / "reference.csv", Reference)
    measured = {
        row.name: row.value
        for path in sorted((FOLDER / case).glob("measured_*.csv"))
        for row in read_table(path, Measured)
        if row.value is not None
    }
    if strange := measured.keys() - {row.name for row in rows if row.value is None}:
        raise ValueError(
            f"{case}: measured values for {', '.join(sorted(strange))}, but reference.csv has no "
            "row of this name without a value"
        )
    return [replace(row, value=measured.get(row.name, row.value)) for row in rows]


def compare(case: str, values: dict[str, float], *, quick: bool = False) -> tuple[list[Row], str]:
    """Compare the values of a case with its references: rows, and the problem if there is one."""
    try:
        known = references(case)
    except (OSError, ValueError) as error:
        return [], str(error)
    alone = sorted(values.keys() - {reference.name for reference in known})
    problem = f"no reference for {', '.join(alone)}" if alone else ""
    return [Row(reference, values.get(reference.name), quick) for reference in known], problem


def evaluate(case: str, folder: Path, *, quick: bool = False) -> Case:
    """Run a case in its own process; pictures and values go to a folder made for it.

    A case that fails is returned with the problem and with all its rows.
    """
    date = datetime.now().astimezone().isoformat(timespec="seconds")
    missing = [name for name in ("case.py", "reference.csv") if not (FOLDER / case / name).exists()]
    problem = f"missing: {' and '.join(missing)}" if missing else ""
    left = dict(NOTHING)
    start = time.perf_counter()
    if "case.py" not in missing:
        folder.mkdir(parents=True, exist_ok=True)
        message = _run_process(case, folder, quick)
        if (folder / OUTCOME).exists():
            left = json.loads((folder / OUTCOME).read_text(encoding="utf-8"))
            problem = problem or left["problem"]
        else:
            problem = problem or message
    seconds = left.get("seconds", time.perf_counter() - start)
    return _judged(case, folder, left, problem, (seconds, date), quick=quick)


def _judged(
    case: str,
    folder: Path,
    left: dict[str, Any],
    problem: str,
    when: tuple[float, str],
    *,
    quick: bool,
) -> Case:
    """Compare what a case left in its folder with the references."""
    rows: list[Row] = []
    if (FOLDER / case / "reference.csv").exists():
        values = {name: float(value) for name, value in left["values"].items()}
        rows, mistake = compare(case, values, quick=quick)
        problem = "; ".join(filter(None, [problem, mistake]))
    return Case(
        case,
        tuple(rows),
        problem,
        *when,
        tuple(left["notes"]),
        tuple((caption, folder / name) for caption, name in left["figures"]),
        tuple(
            (caption, description, folder / view if view else None, folder / picture)
            for caption, description, view, picture in left["sheets"]
        ),
    )


def draw(folder: Path) -> int:
    """Write the report in a folder again from the numbers and pictures there."""
    try:
        content = json.loads((folder / report.JSON).read_text(encoding="utf-8"))
        names = [field.name for field in fields(report.About)]
        about = report.About(**{name: content[name] for name in names})
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{folder}: no report of a validation run: {error}") from error
    done = []
    for case in content["cases"]:
        place = folder / report.PICTURES / case["name"]
        left, problem = dict(NOTHING), case["problem"]
        if (place / OUTCOME).exists():
            left = json.loads((place / OUTCOME).read_text(encoding="utf-8"))
            problem = left["problem"]
        when = case["seconds"], case["date"]
        done.append(_judged(case["name"], place, left, problem, when, quick=about.quick))
    report.write(folder, about, done, content["waiting"])
    print(f"report: {folder / report.HTML}")
    return 0 if all(case.passed for case in done) else 1


def _run_process(case: str, folder: Path, quick: bool) -> str:
    """Run `validation.apart`; the problem to report if it wrote nothing."""
    command = [sys.executable, "-m", "validation.apart", case, str(folder.resolve())]
    try:
        ended = subprocess.run(
            command + ["--quick"] * quick, cwd=FOLDER.parent, timeout=LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"stopped after {LIMIT_S:.0f} s"
    return f"crashed: its process ended with {ended.returncode}"


def validate(
    names: list[str] | None = None,
    *,
    quick: bool = False,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Run the cases and write the report.

    Parameters
    ----------
    names : list of str, optional
        Cases; all, or all of the quick suite, if not given.
    quick : bool
        Only the cases that have a quick form, in this form.
    out : path, optional
        Folder of the report; a new one named `validation-report` if not given.
    force : bool
        Replace the report in `out`.

    Returns
    -------
    int
        The exit status: 0 every row passed, 1 something failed or is missing, 3 interrupted.

    Raises
    ------
    InputError
        For an unknown case, or a folder that cannot be written to.
    """
    known = cases()
    for name in names or []:
        if name not in known:
            raise InputError(f"unknown case '{name}': {suggestion(name, known)}")
    chosen = list(dict.fromkeys(names or cases(quick=quick)))
    folder = check_folder(out or _unused("validation-report"), force=force, names=report.FILES)
    pictures = folder / report.PICTURES
    if (folder / report.JSON).exists():  # its pictures are replaced too
        shutil.rmtree(pictures, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    print(f"writing to {folder}", flush=True)
    times = [row for name, row in listed().items() if name in chosen]
    expected = sum((row.quick_seconds or 0.0) if quick else row.seconds for row in times)
    print(f"{len(chosen)} cases, about {max(1, round(expected / 60))} min", flush=True)
    about = report.about(quick=quick, not_run=[name for name in known if name not in chosen])
    done: list[Case] = []
    report.write(folder, about, done, chosen)
    try:
        for name in chosen:
            done.append(evaluate(name, pictures / name, quick=quick))
            report.write(folder, about, done, chosen[len(done) :])
            print_case(done[-1])
    except KeyboardInterrupt:
        print(f"interrupted: the report in {folder} has {len(done)} of {len(chosen)} cases")
        return 3
    print(headline(done), verdict(done, []), sep="\n")
    print(f"report: {folder / report.HTML}")
    return 0 if all(case.passed for case in done) else 1


def _unused(name: str) -> Path:
    """First of name, name-2, name-3, ... that does not exist."""
    names = (name if i == 1 else f"{name}-{i}" for i in count(1))
    return next(path for path in map(Path, names) if not os.path.lexists(path))


def main(argv: list[str] | None = None) -> int:
    """Run the cases named on the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.run",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(cases()))
    parser.add_argument("--quick", action="store_true", help="the quick suite")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the report (a new one)")
    parser.add_argument("--force", action="store_true", help="replace the report in --out")
    again = "write the report in DIR again from its stored numbers, without computing"
    parser.add_argument("--draw", type=Path, metavar="DIR", help=again)
    given = parser.parse_args(argv)
    try:
        if given.draw:
            return draw(given.draw)
        return validate(given.cases, quick=given.quick, out=given.out, force=given.force)
    except InputError as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
