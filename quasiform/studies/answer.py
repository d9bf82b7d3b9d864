"""The answer to the question of a study: lines to read, a table, a picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..toml_file import dotted_values
from .plan import Job

Row = Mapping[str, Any]
Solve = Callable[[Sequence[Job]], list[Row]]  # the rows of runs, solved where they are not finished


@dataclass(frozen=True)
class Answer:
    """What a study answers.

    Parameters
    ----------
    lines : list of str
        To read.
    tables : dict by file name
        Text of each, or its columns by name.
    pictures : dict by file name
        What `draw.studies` draws them by: start of the name of a function, and its arguments.
    """

    lines: list[str] = field(default_factory=list)
    tables: dict[str, str | Mapping[str, Sequence[Any]]] = field(default_factory=dict)
    pictures: dict[str, tuple[str, tuple[Any, ...]]] = field(default_factory=dict)


def completed(row: Row) -> bool:
    """Whether a run reached its goal."""
    return row.get("summary", {}).get("status") == "completed"


def numbers(row: Row, names: Sequence[str]) -> list[float] | None:
    """Outputs of a run that was completed; None if one is missing."""
    known = dotted_values(row["summary"]) if completed(row) else {}
    found = [known.get(name) for name in names]
    return None if None in found else [float(value) for value in found]


def shortfall(rows: Sequence[Row]) -> list[str]:
    """Say how many runs were not completed or did not converge, and why; nothing if all did."""
    lost = [row for row in rows if not completed(row)]
    reasons = Counter(row.get("error") or row["summary"]["reason"] for row in lost)
    words = [f"{n} × {reason}" for reason, n in reasons.most_common(3)]
    lines = [f"{len(lost)} of {len(rows)} runs not completed: {'; '.join(words)}"] * bool(lost)
    open_ = sum(not row["summary"]["certificate"]["converged"] for row in rows if completed(row))
    return lines + [f"{open_} of {len(rows)} runs completed, but not converged"] * bool(open_)
