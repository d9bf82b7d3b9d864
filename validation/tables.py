"""CSV files as checked rows (errors in one line), and Markdown tables."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

T = TypeVar("T")
EXPECTED = {
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "string_too_short": "some text",
}


def read_table(path: Path, schema: type[T], *, keyed: bool = True) -> list[T]:
    """Rows of a CSV file.

    Parameters
    ----------
    path : Path
    schema : pydantic dataclass
        One field per column. Columns of fields with a default may be absent.
    keyed : bool
        Whether there must be rows, and the values of the first field must be unique.

    Raises
    ------
    ValueError
        For a column, a cell or a row that is not as expected.
    """
    known = {field.name: field.default is MISSING for field in fields(schema)}
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        columns = next(reader, [])
        lines = [(reader.line_num, cells) for cells in reader if cells]
    where = f"{path.parent.name}/{path.name}"
    if columns.count("") or len(set(columns)) < len(columns):
        raise ValueError(f"{where}, row 1: {columns}, expected unique column names")
    if missing := [name for name, needed in known.items() if needed and name not in columns]:
        raise ValueError(f"{where}, row 1: no column {', '.join(missing)}")
    if unknown := [name for name in columns if name not in known]:
        raise ValueError(
            f"{where}, row 1: unknown column {', '.join(unknown)}, expected {', '.join(known)}"
        )
    if keyed and not lines:
        raise ValueError(f"{where}: no rows, expected at least one")
    key, rows = next(iter(known)), list[T]()
    for number, cells in lines:
        place = f"{where}, row {number} ({cells[0]})"
        if len(cells) != len(columns):
            raise ValueError(f"{place}: {len(cells)} cells, expected {len(columns)}")
        try:
            row = schema(**dict(zip(columns, cells, strict=True)))
        except ValidationError as error:
            raise ValueError(f"{place}, {_reason(error)}") from None
        if keyed and any(getattr(row, key) == getattr(other, key) for other in rows):
            raise ValueError(f"{place}, column {key}: {cells[0]!r}, expected a unique {key}")
        rows.append(row)
    return rows


def _reason(error: ValidationError) -> str:
    """Column, value and what was expected, of the first mistake of a row."""
    first = error.errors(include_url=False)[0]
    context = first.get("ctx", {})
    expected = EXPECTED.get(first["type"]) or str(
        context.get("expected") or context.get("error") or first["msg"]
    )
    return f"column {first['loc'][0]}: {first['input']!r}, expected {expected}"


def markdown_table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [head, ["-"] * len(head), *rows]
    return "\n".join("|" + "|".join(f" {_cell(c)} " for c in line) + "|" for line in lines)


def _cell(content: object) -> str:
    return str(content).replace("|", "\\|").replace("\n", " ")
