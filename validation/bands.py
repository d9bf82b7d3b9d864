"""Reference rows, their bands, and what became of each.

`reference.csv` has the columns name, value, tolerance, unit, standing, source and, where needed,
limitation and only:

- tolerance: "0.1%" of the value, "0.15" in its unit, "max" or "min" for a bound, "report" for a
  value that is shown without a band (beside the reference, unless that is 0). It is fixed before
  the run.
- standing "measured" with an empty value: the measurement is not there yet, and the row waits.
- limitation: why the model is known to be off here. The row's band is then a band of its own, and
  the reason is shown beside it.
- only: "full" or "quick" for a row that one of the two suites does not compute.
"""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from pathlib import Path

STANDINGS = ("measured", "stated", "exact", "peer", "prototype", "inferred", "assumed", "own")
COLUMNS = ("name", "value", "tolerance", "unit", "standing", "source")
OPTIONAL = ("limitation", "only")

HELD, MISSED, MISSING = "held", "missed", "missing"
LIMITATION, AWAITED = "limitation", "needs measured data"
SHOWN, LEFT_OUT = "shown only", "left out"
FAILURES = (MISSED, MISSING)


@dataclass(frozen=True)
class Reference:
    """One row of `reference.csv`; the value is None where the measured data are awaited."""

    name: str
    value: float | None
    tolerance: str
    unit: str
    standing: str
    source: str
    limitation: str = ""
    only: str = ""

    def __post_init__(self) -> None:
        if self.standing not in STANDINGS:
            raise ValueError(f"{self.name}: unknown standing {self.standing!r}")
        if self.only not in ("", "full", "quick"):
            raise ValueError(f"{self.name}: only must be 'full' or 'quick', got {self.only!r}")
        if self.value is None:
            if self.standing != "measured":
                raise ValueError(f"{self.name}: no reference value (standing {self.standing})")
        elif not isfinite(self.value):
            raise ValueError(f"{self.name}: the reference value is {self.value}")
        elif self.tolerance.endswith("%") and self.value == 0:
            raise ValueError(f"{self.name}: a band in percent of zero")
        if self.tolerance not in ("max", "min", "report"):
            try:
                sound = float(self.tolerance.removesuffix("%")) >= 0
            except ValueError:
                sound = False
            if not sound:
                raise ValueError(
                    f"{self.name}: tolerance must be a number, a percentage, max, min or report, "
                    f"got {self.tolerance!r}"
                )

    @property
    def half_band(self) -> float | None:
        """Half the width of a two-sided band in the row's unit; None for a bound or no band."""
        if self.tolerance in ("max", "min", "report") or self.value is None:
            return None
        if self.tolerance.endswith("%"):
            return 0.01 * float(self.tolerance[:-1]) * abs(self.value)
        return float(self.tolerance)

    def deviation(self, value: float) -> str:
        """How far a value is off, in words; empty for a bound, and where there is no reference."""
        if self.value is None or self.tolerance in ("max", "min"):
            return ""
        if self.tolerance == "report" and self.value == 0:  # shown, with nothing beside it
            return ""
        if self.tolerance == "report" or self.tolerance.endswith("%"):
            return f"{100 * (value / self.value - 1):+.3f} %"
        return f"{value - self.value:+.3g}"

    def used(self, value: float) -> float | None:
        """Share of the band that a value takes, 1 at its edge; None where that has no meaning."""
        if self.half_band:
            return abs(value - self.value) / self.half_band
        if self.tolerance == "max" and self.value and self.value > 0 and value >= 0:
            return value / self.value
        if self.tolerance == "min" and self.value and self.value > 0 and value > 0:
            return self.value / value
        return None

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
    """A reference beside what was computed; `quick` tells by which suite."""

    reference: Reference
    value: float | None
    quick: bool = False

    @property
    def state(self) -> str:
        """What became of the row: one of the words above."""
        known, value = self.reference, self.value
        if known.only and known.only != ("quick" if self.quick else "full"):
            return LEFT_OUT
        if value is not None and not isfinite(value):
            return MISSED
        if known.value is None:
            return AWAITED
        if value is None:
            return MISSING
        if not known.holds(value):
            return MISSED
        if known.limitation:
            return LIMITATION
        return SHOWN if known.tolerance == "report" else HELD

    @property
    def held(self) -> bool:
        """Whether nothing is wrong with the row: no band missed, no value missing."""
        return self.state not in FAILURES


@dataclass(frozen=True)
class Case:
    """A case after its run, or why there is nothing to see of it.

    Parameters
    ----------
    name : str
    rows : tuple of Row
    problem : str
        What went wrong with the case as a whole; empty if nothing did.
    seconds : float
    date : str
    notes : tuple of str
    figures : tuple of (caption, path of a PNG)
    sheets : tuple of (caption, words, path of the view's JSON or None, path of a PNG)
    """

    name: str
    rows: tuple[Row, ...] = ()
    problem: str = ""
    seconds: float = 0.0
    date: str = ""
    notes: tuple[str, ...] = ()
    figures: tuple[tuple[str, Path], ...] = ()
    sheets: tuple[tuple[str, str, Path | None, Path], ...] = ()

    @cached_property
    def counts(self) -> Counter[str]:
        """Number of rows by state."""
        return Counter(row.state for row in self.rows)

    @property
    def held(self) -> bool:
        """Whether the case ran, and every row is held."""
        return not self.problem and all(row.held for row in self.rows)


def read(path: Path) -> list[Reference]:
    """Rows of a `reference.csv`.

    Raises
    ------
    ValueError
        For a column, number or word that is not known, or a name that comes twice.
    """
    with path.open(newline="", encoding="utf-8") as file:
        table = csv.DictReader(file)
        columns = table.fieldnames or []
        if missing := [name for name in COLUMNS if name not in columns]:
            raise ValueError(f"{path.name}: no column {', '.join(missing)}")
        if unknown := [str(name) for name in columns if name not in COLUMNS + OPTIONAL]:
            raise ValueError(f"{path.name}: unknown column {', '.join(unknown)}")
        rows = [_reference(row, path.name) for row in table]
    names = Counter(row.name for row in rows)
    if twice := [name for name, count in names.items() if count > 1]:
        raise ValueError(f"{path.name}: more than one row {', '.join(twice)}")
    if not rows:
        raise ValueError(f"{path.name}: no row")
    return rows


def _reference(row: dict[str, str | None], file: str) -> Reference:
    if None in row or None in row.values():
        raise ValueError(f"{file}: row {row['name']!r} has not one entry a column")
    try:
        value = float(row["value"]) if row["value"].strip() else None
    except ValueError:
        raise ValueError(f"{file}: {row['name']}: no number: {row['value']!r}") from None
    return Reference(**{**row, "value": value})
