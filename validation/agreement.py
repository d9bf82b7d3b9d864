"""Agreement with measurement in numbers: computed over measured, good and bad."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, log

import numpy as np
from matplotlib.figure import Figure

from .bands import NO_REFERENCE, Case, Row

SERIES = re.compile(r",?\s*(?:\bto u=|u=|at )[\d.]+(?: deg| 1/m| mm)?")  # one place of a curve
WORDS = (
    (r"\bto u=([\d.]+)", r"to \1 mm"),
    (r"u=([\d.]+)", r"at \1 mm"),
    (r" deg\b", "°"),
    (r"(\d) x (\d)", r"\1 × \2"),
    (", elements", " (finite elements)"),
    (", power balance", " (closed form)"),
    (r"^(\w+) frame law over", r"force of a strip predicted from the frame of \1, over"),
    (r"\bstrip of (?=[A-Z])", "strip of laboratory "),
    (r"\bframe of (?=[A-Z])", "picture frame of laboratory "),
    (r"^moment", "bending moment"),
    (r"([\d.]+) 1/m", r"a curvature of \1 1/m"),
)
CLOSE = 0.1  # of the measured value
SHOWN = 10  # groups in the picture


@dataclass(frozen=True)
class Compared:
    """A computed number beside the measured one."""

    case: str
    row: Row

    @property
    def ratio(self) -> float:
        """Computed over measured."""
        return self.row.value / self.row.reference.value

    @property
    def away(self) -> float:
        """How far they are apart: |log ratio|."""
        return abs(log(self.ratio)) if self.ratio > 0 else np.inf

    @property
    def group(self) -> str:
        """Name of the curve that the row is a place of."""
        return label(SERIES.sub("", self.row.reference.name))


def label(name: str) -> str:
    """Name of a row for readers.

    Examples
    --------
    >>> label("INSA 150 x 450: force u=10, elements")
    'INSA 150 × 450: force at 10 mm (finite elements)'
    >>> label("deviation of the kinematics to u=30")
    'deviation of the kinematics to 30 mm'
    """
    for pattern, words in WORDS:
        name = re.sub(pattern, words, name)
    return name


def compared(done: Sequence[Case]) -> list[Compared]:
    """Rows of all cases with a computed and a measured value.

    A bound `max` is one on an error and no measured value.
    """
    return [
        Compared(case.name, row)
        for case in done
        for row in case.rows
        if row.reference.standing == "measured" and row.reference.tolerance != "max"
        if row.reference.value and row.value is not None and isfinite(row.value)
    ]


def groups(rows: Sequence[Compared]) -> dict[tuple[str, str], list[Compared]]:
    """Rows by case and curve, the one with the largest difference first."""
    found: dict[tuple[str, str], list[Compared]] = {}
    for row in sorted(rows, key=lambda row: -row.away):
        found.setdefault((row.case, row.group), []).append(row)
    return found


def by_case(rows: Sequence[Compared]) -> list[dict[str, str]]:
    """Agreement of each case: how many numbers, how many are close, half within, and the range."""
    found = []
    for case in dict.fromkeys(row.case for row in rows):
        ratios = sorted(row.ratio for row in rows if row.case == case)
        off = sorted(abs(ratio - 1) for ratio in ratios)
        found.append(
            {
                "case": case,
                "numbers": str(len(ratios)),
                f"within {100 * CLOSE:g} %": str(sum(x <= CLOSE for x in off)),
                "half of them within": f"{100 * off[(len(off) - 1) // 2]:.0f} %",
                "computed over measured": f"{ratios[0]:.2f} to {ratios[-1]:.2f}",
            }
        )
    return found


def headline(done: Sequence[Case]) -> str:
    """State the agreement with measurement in numbers."""
    rows = compared(done)
    open_rows = {case.name: sum(row.state == NO_REFERENCE for row in case.rows) for case in done}
    known = {row.case for row in rows}
    alone = [name for name, count in open_rows.items() if count and name not in known]
    more = (
        f" {sum(open_rows.values())} more are not published yet" if any(open_rows.values()) else ""
    )
    more += f": all those of {' and '.join(alone)}" if alone else ""
    more += "." if more else ""
    if not rows:
        return f"No computed number could be compared with a measurement.{more}"
    off = sorted(abs(row.ratio - 1) for row in rows)
    close = sum(x <= CLOSE for x in off)
    cases = len(known)
    worst = max(rows, key=lambda row: row.away)
    return (
        f"{len(rows)} numbers were compared with measurements, in {cases} "
        f"case{'s' * (cases > 1)}: {close} of them differ by at most {100 * CLOSE:g}\u00a0%, half "
        f"of them by at most {100 * off[(len(off) - 1) // 2]:.0f}\u00a0%, the worst by "
        f"{times(worst.ratio)}.{more}"
    )


def times(ratio: float) -> str:
    """A ratio as a difference, or as a factor where it is large.

    Examples
    --------
    >>> times(1.321), times(0.98), times(5.7363)
    ('+32 %', '−2 %', 'a factor of 5.7')
    """
    if 0.5 < ratio < 2.0:
        return f"{100 * (ratio - 1):+.{0 if abs(ratio - 1) > 0.0195 else 1}f} %".replace("-", "−")
    return f"a factor of {ratio:.2g}"


def figure(done: Sequence[Case]) -> Figure:
    """Computed over measured by curve, the worst first."""
    found = list(groups(compared(done)).items())[:SHOWN][::-1]
    drawn = Figure(figsize=(7.2, 1.0 + 0.36 * len(found)), layout="constrained")
    axes = drawn.subplots()
    axes.axvspan(1 - CLOSE, 1 + CLOSE, color="#d8ecdf", label=f"within {100 * CLOSE:g} %")
    axes.axvline(1.0, color="0.2", linewidth=0.8)
    for k, (_, rows) in enumerate(found):
        axes.plot(
            [row.ratio for row in rows], [k] * len(rows), "o", ms=5, color="#4b2991", alpha=0.7
        )
    names = [textwrap.fill(name, 48) for (_, name), _ in found]
    axes.set_yticks(range(len(found)), names, fontsize=8)
    axes.set_xscale("log")
    ticks = (0.2, 0.5, 1, 2, 5, 10)
    low, high = axes.get_xlim()
    axes.set_xticks([x for x in ticks if low <= x <= high], minor=False)
    axes.set_xticks([], minor=True)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("computed / measured")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False, fontsize=8)
    return drawn
