"""The report in words: the verdict, and Markdown for a pull request."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from .bands import AWAITED, HELD, LEFT_OUT, LIMITATION, MISSED, MISSING, SHOWN, Case, Row

if TYPE_CHECKING:
    from .report import About


def verdict(done: list[Case], waiting: list[str]) -> str:
    """Say in one sentence whether everything holds."""
    total = sum((case.counts for case in done), Counter())
    failed = [case for case in done if case.problem]
    wrong = []
    if bands := total[MISSED]:
        wrong.append(_count(bands, "band") + " missed")
    if values := total[MISSING]:
        wrong.append(_count(values, "value") + " missing")
    if failed:
        wrong.append(f"{_count(len(failed), 'case')} failed ({', '.join(c.name for c in failed)})")
    parts = [", ".join(wrong) if wrong else f"every band held in {_count(len(done), 'case')}"]
    if not done:
        parts = ["no case has been run"]
    elif total[LIMITATION]:
        known = _count(total[LIMITATION], "known limitation")
        parts.append(f"{known} inside {'its' if total[LIMITATION] == 1 else 'their'} own band")
    if total[AWAITED]:
        parts.append(f"{_count(total[AWAITED], 'row')} without measured data")
    if folded := [case for case in done if mostly_left_out(case)]:
        parts.append(f"{_count(len(folded), 'case')} {mostly_left_out(folded[0])}")
    if waiting:
        parts.append(f"{_count(len(waiting), 'case')} not run yet")
    sentence = "; ".join(parts)
    return sentence[0].upper() + sentence[1:] + "."


def mostly_left_out(case: Case) -> str:
    """Say so where a suite leaves out more than half of a case: what holds is not the case."""
    left_out = [row for row in case.rows if row.state == LEFT_OUT]
    if 2 * len(left_out) <= len(case.rows):
        return ""
    suite = "quick" if left_out[0].reference.only == "full" else "full"
    return f"mostly left out by the {suite} suite"


def markdown(about: About, done: list[Case], waiting: list[str]) -> str:
    """The verdict and what is not as it should be, for a pull request."""
    suite = "quick suite" if about.quick else "full suite"
    lines = [
        f"## Validation: {verdict(done, waiting)}",
        "",
        f"quasiform {about.versions['quasiform']}, {suite}, {about.date}, "
        f"{about.machine['processor']}, {about.machine['cores']} cores.",
        "",
        "| case | rows | held | missed | limitations | no data | shown only | left out | time |",
        "|-|-:|-:|-:|-:|-:|-:|-:|-:|",
    ]
    for case in done:
        n = case.counts
        missed = n[MISSED] + n[MISSING]
        name = f"`{case.name}`" + (f" ({words})" if (words := mostly_left_out(case)) else "")
        lines.append(
            f"| {'' if case.held else '**✗** '}{name} | {len(case.rows)} | {n[HELD]} | "
            f"{f'**{missed}**' if missed else 0} | {n[LIMITATION]} | {n[AWAITED]} | {n[SHOWN]} | "
            f"{n[LEFT_OUT]} | {duration(case.seconds)} |"
        )
    lines += [f"| `{name}` | not run yet | | | | | | | |" for name in waiting]
    if problems := [f"- **`{c.name}`: {_cell(c.problem)}**" for c in done if c.problem]:
        lines += ["", *problems]
    for state, title in (
        (MISSED, "Bands missed"),
        (MISSING, "Values missing"),
        (LIMITATION, "Known limitations, each inside a band of its own"),
        (AWAITED, "Measured data needed"),
    ):
        rows = [(case.name, row) for case in done for row in case.rows if row.state == state]
        if not rows:
            continue
        lines += ["", f"### {title}", "", "| case | row | computed | reference | band | standing |"]
        lines.append("|-|-|-:|-:|-|-|")
        for name, row in rows:
            known = row.reference
            reason = f" ({_cell(known.limitation)})" if known.limitation else ""
            lines.append(
                f"| `{name}` | {_cell(known.name)}{reason} | {quantity(row.value, known.unit)} | "
                f"{quantity(known.value, known.unit)} | {band(row)} | {known.standing} |"
            )
    if about.left_out:
        lines += ["", f"Not part of this run: {', '.join(f'`{n}`' for n in about.left_out)}."]
    return "\n".join(lines) + "\n"


def quantity(value: float | None, unit: str) -> str:
    """A number with its unit; a dash for none."""
    if value is None:
        return "–"
    sign = {"deg": "°", "1": ""}.get(unit, f" {unit}")
    return f"{value:.5g}{sign}".replace("-", "−")


def band(row: Row) -> str:
    """The band of a row in words."""
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
    """Seconds as a reader would say them."""
    if seconds < 99.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _cell(text: str) -> str:
    """Text that does not end a cell of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|")
