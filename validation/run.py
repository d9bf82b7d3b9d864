"""Run validation cases, compare their values with `reference.csv`, and write the report.

    python -m validation.run                     every case
    python -m validation.run --quick             those of the quick suite
    python -m validation.run oat_45 ...          some of them

`quasiform validate` is the same. Each case is a folder with `case.py`, `reference.csv` (see
`bands.py`) and a README; `case.py` has a function `values()` that returns {name: value}, or
`run(quick)` that returns an `Outcome`. `cases.csv` lists the cases in the order of the report.
Every case runs in a process of its own, and the report is written again after each.

Exit status: 0 every band held; 1 a band was missed, or a case, a value or a reference is missing;
2 wrong input; 3 interrupted.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from quasiform.checks import InputError, suggestion
from quasiform.result.files import check_folder

from .bands import Case, Reference, Row, read
from .report_text import verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from quasiform.result.run import Result

FOLDER = Path(__file__).parent
OUTCOME = "outcome.json"
LIMIT_S = 3600.0  # a case that takes longer hangs


@dataclass(frozen=True)
class Outcome:
    """What a case hands over.

    Parameters
    ----------
    values : dict of name to number
        To be compared with the rows of `reference.csv`, each in the unit of its row.
    figures : dict of caption to Figure
        Pictures beside the numbers.
    sheets : dict of caption to Result
        Formed sheets, shown to be turned and probed.
    notes : list of str
        Sentences of the run, Markdown.
    """

    values: dict[str, float]
    figures: dict[str, Figure] = field(default_factory=dict)
    sheets: dict[str, Result] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def listed() -> dict[str, tuple[float, float | None]]:
    """Cases of `cases.csv`: seconds of the full case, and of the quick one where there is one."""
    with (FOLDER / "cases.csv").open(newline="", encoding="utf-8") as file:
        return {
            row["case"]: (
                float(row["seconds"]),
                float(row["quick_seconds"]) if row["quick_seconds"] else None,
            )
            for row in csv.DictReader(file)
        }


def cases(*, quick: bool = False) -> list[str]:
    """Names of the cases in the order of `cases.csv`, then of the folders not listed there."""
    known = listed()
    if quick:
        return [name for name, (_, seconds) in known.items() if seconds is not None]
    found = {path.parent.name for path in FOLDER.glob("*/case.py")}
    found |= {path.parent.name for path in FOLDER.glob("*/reference.csv")}
    return [*known, *sorted(found - known.keys())]


def references(case: str) -> list[Reference]:
    """Rows of a case's `reference.csv`, with the values that its `measured_*.csv` fill in.

    Raises
    ------
    ValueError
        If a measured value belongs to no row that waits for one.
    """
    rows, measured = read(FOLDER / case / "reference.csv"), dict[str, float]()
    for path in sorted((FOLDER / case).glob("measured_*.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            filled = [row for row in csv.DictReader(file) if row["value"].strip()]
        measured |= {row["name"]: float(row["value"]) for row in filled}
    if strange := measured.keys() - {row.name for row in rows if row.value is None}:
        raise ValueError(f"{case}: no row waits for {', '.join(sorted(strange))}")
    return [replace(row, value=measured.get(row.name, row.value)) for row in rows]


def compare(case: str, values: dict[str, float], *, quick: bool = False) -> tuple[list[Row], str]:
    """Set the values of a case beside its references; rows, and the problem with them if any."""
    try:
        known = references(case)
    except (OSError, ValueError) as error:
        return [], str(error)
    alone = sorted(values.keys() - {reference.name for reference in known})
    problem = f"no reference for {', '.join(alone)}" if alone else ""
    return [Row(reference, values.get(reference.name), quick) for reference in known], problem


def evaluate(case: str, folder: Path, *, quick: bool = False) -> Case:
    """Run a case in a process of its own; pictures and values go to a folder made for it.

    A case that cannot be run, or not to its end, comes back with the problem and with all its rows.
    """
    date = datetime.now().astimezone().isoformat(timespec="seconds")
    missing = [name for name in ("case.py", "reference.csv") if not (FOLDER / case / name).exists()]
    problem = f"missing: {' and '.join(missing)}" if missing else ""
    left = {"values": {}, "notes": [], "figures": [], "sheets": []}
    start = time.perf_counter()
    if "case.py" not in missing:
        folder.mkdir(parents=True, exist_ok=True)
        ended = _run_apart(case, folder, quick)
        if (folder / OUTCOME).exists():
            left = json.loads((folder / OUTCOME).read_text(encoding="utf-8"))
            problem = problem or left["problem"]
        else:
            problem = problem or ended
    seconds = left.get("seconds", time.perf_counter() - start)
    rows: list[Row] = []
    if "reference.csv" not in missing:
        values = {name: float(value) for name, value in left["values"].items()}
        rows, doubt = compare(case, values, quick=quick)
        problem = "; ".join(filter(None, [problem, doubt]))
    return Case(
        case,
        tuple(rows),
        problem,
        seconds,
        date,
        tuple(left["notes"]),
        tuple((caption, folder / name) for caption, name in left["figures"]),
        tuple(
            (caption, words, folder / view if view else None, folder / picture)
            for caption, words, view, picture in left["sheets"]
        ),
    )


def _run_apart(case: str, folder: Path, quick: bool) -> str:
    """Run `validation.apart`; say how it ended if it left nothing."""
    path = os.pathsep.join(filter(None, [str(FOLDER.parent), os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-P", "-m", "validation.apart", case, str(folder.resolve())]
    try:
        ended = subprocess.run(
            command + ["--quick"] * quick,
            env=os.environ | {"PYTHONPATH": path},
            timeout=LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"stopped after {LIMIT_S:.0f} s"
    return f"crashed: its process ended with {ended.returncode}"


def table(case: Case) -> str:
    """Rows of a case as text."""
    lines = [case.name]
    for row in case.rows:
        reference, value = row.reference, row.value
        known = "" if reference.value is None else f"{reference.value:<9g}"
        shown = "-" if value is None else f"{value:.6g}"
        off = "" if value is None else reference.deviation(value)
        mark = row.state if row.held else row.state.upper()
        lines.append(
            f"  {mark:<11} {reference.name:<44} {shown:>12} {reference.unit:<4} "
            f"reference {known:<9} {off:>10} (band {reference.tolerance}; "
            f"{reference.standing}: {reference.source})"
        )
        if reference.limitation:
            lines.append(f"{'':14}known limitation: {reference.limitation}")
    if case.problem:
        lines.append(f"  PROBLEM     {case.problem}")
    return "\n".join([*lines, f"  {case.seconds:.1f} s"])


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
        The quick suite: the cases with a short form, in that form.
    out : path, optional
        Folder of the report; a new one named `validation-report` if not given.
    force : bool
        Replace the report in `out`.

    Returns
    -------
    int
        The exit status: 0 every band held, 1 something was missed or is missing, 3 interrupted.

    Raises
    ------
    InputError
        For a case that is not known, or a folder that cannot be written to.
    """
    from . import report

    known = cases()
    for name in names or []:
        if name not in known:
            raise InputError(f"unknown case '{name}': {suggestion(name, known)}")
    chosen = list(dict.fromkeys(names or cases(quick=quick)))
    folder = check_folder(out or _unused("validation-report"), force=force, names=report.FILES)
    pictures = folder / report.PICTURES
    if (folder / report.JSON).exists():  # the pictures are of the report that is replaced
        shutil.rmtree(pictures, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    print(f"writing to {folder}", flush=True)
    times = listed()
    expected = [times.get(name, (0.0, None))[quick] or 0.0 for name in chosen]
    print(f"{len(chosen)} cases, some {max(1, round(sum(expected) / 60))} minutes", flush=True)
    about = report.about(quick=quick, left_out=[name for name in known if name not in chosen])
    done: list[Case] = []
    report.write(folder, about, done, chosen)
    try:
        for name in chosen:
            done.append(evaluate(name, pictures / name, quick=quick))
            report.write(folder, about, done, chosen[len(done) :])
            print(table(done[-1]), flush=True)
    except KeyboardInterrupt:
        print(f"interrupted: the report in {folder} holds {len(done)} of {len(chosen)} cases")
        return 3
    print(verdict(done, []))
    print(f"report: {folder / report.HTML}")
    return 0 if all(case.held for case in done) else 1


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
    given = parser.parse_args(argv)
    try:
        return validate(given.cases, quick=given.quick, out=given.out, force=given.force)
    except InputError as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
