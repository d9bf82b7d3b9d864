"""Reference values with their tolerances, and the outcome of each comparison.

`reference.csv` has the columns name, value, tolerance, unit, standing, source and, where needed,
limitation and only:

- tolerance: "0.1%" of the value, "0.15" in its unit, "max" or "min" for a bound, "report" for a
  value that is printed for information and not judged (a reference of 0 is then not printed). It is
  fixed before the run.
- standing "measured" with an empty value: the measurement is not published yet. The row is listed
  and not judged.
- limitation: why the model is known to differ from the reference here. The row then has its own
  tolerance, and the reason is printed next to it.
- only: "full" or "quick" for a row that only this suite computes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import BeforeValidator, Field, FiniteFloat, ValidationInfo, field_validator
from pydantic.dataclasses import dataclass as checked

Standing = Literal[
    "measured",
    "input",
    "between tests",
    "stated",
    "exact",
    "peer",
    "prototype",
    "inferred",
    "assumed",
    "own",
]
STANDINGS: tuple[str, ...] = get_args(Standing)

PASSED, FAILED, MISSING = "passed", "failed", "missing"
LIMITATION, NO_REFERENCE = "known limitation", "no reference yet"
INFORMATION, SKIPPED = "for information", "skipped"
WRONG = (FAILED, MISSING)

OptionalNumber = Annotated[
    FiniteFloat | None,
    BeforeValidator(lambda v: None if isinstance(v, str) and not v.strip() else v),
]
Text = Annotated[str, Field(min_length=1)]


@checked(frozen=True)
class Listed:
    """One row of `cases.csv`: a case with its time, s; no quick time: not in the quick suite."""

    case: Text
    seconds: FiniteFloat
    quick_seconds: OptionalNumber


@checked(frozen=True)
class Measured:
    """One row of a `measured_*.csv`: the value of a row of `reference.csv`, once it is known."""

    name: Text
    value: OptionalNumber
    source: str


@checked(frozen=True)
class Reference:
    """One row of `reference.csv`; the value is None where no measurement is published yet."""

    name: Text
    value: OptionalNumber
    tolerance: str
    unit: str
    standing: Standing
    source: str
    limitation: str = ""
    only: Literal["", "full", "quick"] = ""

    @field_validator("tolerance")
    @classmethod
    def _tolerance(cls, tolerance: str, info: ValidationInfo) -> str:
        if tolerance in ("max", "min", "report"):
            return tolerance
        if tolerance.endswith("%") and info.data.get("value") == 0:
            raise ValueError("a tolerance in the row's unit: a percentage of zero is zero")
        try:
            sound = float(tolerance.removesuffix("%")) >= 0
        except ValueError:
            sound = False
        if not sound:
            raise ValueError("a number of at least zero, a percentage, max, min or report")
        return tolerance

    @field_validator("standing")
    @classmethod
    def _standing(cls, standing: str, info: ValidationInfo) -> str:
        if info.data.get("value", 0) is None and standing != "measured":
            raise ValueError("'measured', as the row has no value")
        return standing

    @property
    def half_width(self) -> float | None:
        """Half the width of a two-sided band in the row's unit; None for a bound or no band."""
        if self.tolerance in ("max", "min", "report") or self.value is None:
            return None
        if self.tolerance.endswith("%"):
            return 0.01 * float(self.tolerance[:-1]) * abs(self.value)
        return float(self.tolerance)

    def deviation(self, value: float) -> str:
        """Difference from the reference as text; empty for a bound or without a reference."""
        if self.value is None or self.tolerance in ("max", "min"):
            return ""
        if self.tolerance == "report" and self.value == 0:
            return ""
        if self.tolerance == "report" or self.tolerance.endswith("%"):
            return f"{100 * (value / self.value - 1):+.3f} %"
        return f"{value - self.value:+.3g}"

    def used(self, value: float) -> float | None:
        """Used share of the band, 1 at its edge; None where this has no meaning."""
        if self.half_width:
            return abs(value - self.value) / self.half_width
        if self.tolerance == "max" and self.value and self.value > 0 and value >= 0:
            return value / self.value
        if self.tolerance == "min" and self.value and self.value > 0 and value > 0:
            return self.value / value
        return None

    def accepts(self, value: float) -> bool:
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
    """A reference and the computed value; `quick` says by which suite."""

    reference: Reference
    value: float | None
    quick: bool = False

    @property
    def state(self) -> str:
        """Outcome of the comparison: one of the words above."""
        known, value = self.reference, self.value
        if known.only and known.only != ("quick" if self.quick else "full"):
            return SKIPPED
        if value is not None and not isfinite(value):
            return FAILED
        if known.value is None:
            return NO_REFERENCE
        if value is None:
            return MISSING
        if not known.accepts(value):
            return FAILED
        if known.limitation:
            return LIMITATION
        return INFORMATION if known.tolerance == "report" else PASSED

    @property
    def passed(self) -> bool:
        """Whether the row is neither outside its band nor without a computed value."""
        return self.state not in WRONG


@dataclass(frozen=True)
class Case:
    """A case after its run, or the reason why it has no results.

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
    sheets : tuple of (caption, description, path of the view's JSON or None, path of a PNG)
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
    def passed(self) -> bool:
        """Whether the case ran and no row failed."""
        return not self.problem and all(row.passed for row in self.rows)

    @property
    def mostly_skipped(self) -> str:
        """A remark where the suite skips more than half of the rows; else empty."""
        skipped = [row for row in self.rows if row.state == SKIPPED]
        if 2 * len(skipped) <= len(self.rows):
            return ""
        suite = "quick" if skipped[0].reference.only == "full" else "full"
        return f"mostly skipped by the {suite} suite"

    @property
    def state(self) -> str:
        """State of the case as a whole.

        Passed only if most of it was computed, and without the help of a known limitation.
        """
        if not self.passed:
            return FAILED
        if self.mostly_skipped:
            return SKIPPED
        left = (state for state in (LIMITATION, PASSED, NO_REFERENCE) if self.counts[state])
        return next(left, INFORMATION)
