"""Run validation cases and compare their values with `reference.csv`.

    python -m validation.run              every case
    python -m validation.run oat_45 ...   some of them

Each case is a folder with `case.py` (a function `values()` that returns {name: value}),
`reference.csv` and a README. The tolerance of a row is fixed in the file: "0.1%" of the value,
"0.15" in its unit, "max" or "min" for a bound, "report" for a value that is shown only. The exit
status is 1 if a band is missed or a value is missing.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import sys
import time
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent
STANDINGS = ("measured", "stated", "exact", "peer", "prototype", "inferred", "assumed", "own")


@dataclass(frozen=True)
class Reference:
    """One row of `reference.csv`."""

    name: str
    value: float
    tolerance: str
    unit: str
    standing: str
    source: str

    def __post_init__(self) -> None:
        if self.standing not in STANDINGS:
            raise ValueError(f"{self.name}: unknown standing {self.standing!r}")

    def deviation(self, value: float) -> str:
        """How far a value is off, in words."""
        if self.tolerance in ("max", "min", "report"):
            return ""
        if self.tolerance.endswith("%"):
            return f"{100 * (value / self.value - 1):+.3f} %"
        return f"{value - self.value:+.3g}"

    def holds(self, value: float) -> bool:
        """Whether a value is within the band."""
        if self.tolerance == "report":
            return True
        if self.tolerance == "max":
            return value <= self.value
        if self.tolerance == "min":
            return value >= self.value
        if self.tolerance.endswith("%"):
            return abs(value / self.value - 1) <= 0.01 * float(self.tolerance[:-1])
        return abs(value - self.value) <= float(self.tolerance)


@dataclass(frozen=True)
class Row:
    """A reference beside what was computed."""

    reference: Reference
    value: float | None

    @property
    def held(self) -> bool:
        """Whether there is a value and it is within the band."""
        return self.value is not None and self.reference.holds(self.value)


def cases() -> list[str]:
    """Names of the cases."""
    return sorted(path.parent.name for path in FOLDER.glob("*/case.py"))


def references(case: str) -> list[Reference]:
    """Rows of a case's `reference.csv`."""
    with (FOLDER / case / "reference.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [Reference(**{**row, "value": float(row["value"])}) for row in rows]


def compare(case: str) -> list[Row]:
    """Run a case and set its values beside the references.

    Raises
    ------
    ValueError
        If the case returns a value that has no reference.
    """
    values = importlib.import_module(f"validation.{case}.case").values()
    rows = [Row(reference, values.pop(reference.name, None)) for reference in references(case)]
    if values:
        raise ValueError(f"{case}: no reference for {', '.join(values)}")
    return rows


def table(case: str, rows: list[Row]) -> str:
    """Rows as text."""
    lines = [case]
    for row in rows:
        reference, value = row.reference, row.value
        shown = "missing" if value is None else f"{value:.6g}"
        off = "" if value is None else reference.deviation(value)
        mark = "ok  " if row.held else "MISS"
        lines.append(
            f"  {mark} {reference.name:<44} {shown:>12} {reference.unit:<4} "
            f"reference {reference.value:<9g} {off:>10} (band {reference.tolerance}; "
            f"{reference.standing}: {reference.source})"
        )
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Run the cases named on the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m validation.run", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(cases()))
    names = parser.parse_args(argv).cases or cases()
    if unknown := set(names) - set(cases()):
        parser.error(f"unknown case {', '.join(sorted(unknown))}: expected {', '.join(cases())}")
    missed = 0
    for name in names:
        start = time.perf_counter()
        rows = compare(name)
        missed += sum(not row.held for row in rows)
        print(table(name, rows), f"\n  {time.perf_counter() - start:.1f} s", flush=True)
    print("every band held" if not missed else f"{missed} bands missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
