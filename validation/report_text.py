"""Numbers, rows and results of the validation as text: for the console and for all reports."""

from __future__ import annotations

import sys
from collections import Counter

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .bands import FAILED, LIMITATION, MISSING, NO_REFERENCE, Case, Row

WIDTH = 170  # columns of a table that does not go to a terminal


def verdict(done: list[Case], waiting: list[str]) -> str:
    """State in one sentence whether everything passed."""
    total = sum((case.counts for case in done), Counter())
    failed = [case for case in done if case.problem]
    wrong = []
    if rows := total[FAILED]:
        wrong.append(_count(rows, "row") + " failed")
    if values := total[MISSING]:
        wrong.append(_count(values, "value") + " missing")
    if failed:
        names = ", ".join(case.name for case in failed)
        wrong.append(f"{_count(len(failed), 'case')} with errors ({names})")
    parts = [", ".join(wrong) if wrong else f"every row passed in {_count(len(done), 'case')}"]
    if not done:
        parts = ["no case has been run"]
    elif total[LIMITATION]:
        known = _count(total[LIMITATION], "known limitation")
        parts.append(f"{known} within {'its' if total[LIMITATION] == 1 else 'their'} own tolerance")
    if total[NO_REFERENCE]:
        parts.append(f"{_count(total[NO_REFERENCE], 'row')} without a reference yet")
    if skipped := [case for case in done if case.mostly_skipped]:
        parts.append(f"{_count(len(skipped), 'case')} {skipped[0].mostly_skipped}")
    if waiting:
        parts.append(f"{_count(len(waiting), 'case')} not run yet")
    sentence = "; ".join(parts)
    return sentence[0].upper() + sentence[1:] + "."


def print_case(case: Case) -> None:
    """Print the rows of a case as a table."""
    console = Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)
    table = Table(box=SIMPLE_HEAD, title=case.name, title_justify="left", pad_edge=False)
    for name in ("result", "quantity", "computed", "reference", "difference", "tolerance"):
        right = name in ("computed", "reference", "difference")
        table.add_column(name, justify="right" if right else "left", no_wrap=right)
    table.add_column("source of the reference")
    for row in case.rows:
        known, value = row.reference, row.value
        state = Text(row.state if row.passed else row.state.upper(), "" if row.passed else "red")
        name = known.name + (f"\nknown limitation: {known.limitation}" * bool(known.limitation))
        computed, reference = quantity(value, known.unit), quantity(known.value, known.unit)
        off = "" if value is None else known.deviation(value)
        source = f"{known.standing}: {known.source}"
        table.add_row(state, *map(Text, (name, computed, reference, off, band(row), source)))
    console.print(table)
    if case.problem:
        console.print(Text(f"ERROR in {case.name}: {case.problem}", "red"))
    console.print(f"{case.name}: {duration(case.seconds)}")


def quantity(value: float | None, unit: str) -> str:
    """A number with its unit; a dash for none."""
    if value is None:
        return "–"
    sign = {"deg": "°", "1": ""}.get(unit, f" {unit}")
    return f"{value:.5g}{sign}".replace("-", "−")


def band(row: Row) -> str:
    """The tolerance of a row as text."""
    known = row.reference
    if known.tolerance == "report":
        return "none"
    if known.tolerance in ("max", "min"):
        bound = "measured" if known.value is None else quantity(known.value, known.unit)
        return f"{'≤' if known.tolerance == 'max' else '≥'} {bound}"
    if known.tolerance.endswith("%"):
        return f"± {known.tolerance[:-1]} %"
    return f"± {quantity(float(known.tolerance), known.unit)}"


def duration(seconds: float) -> str:
    """A time, "8.1 s" or "3 min 05 s"."""
    if seconds < 99.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
