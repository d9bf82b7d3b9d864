"""Measured curves of off-axis tension and picture-frame tests, read from a laboratory's CSV.

What a machine exports becomes the loading part of the test (`loading`) with a standard deviation
for each force. `Curve.notices` reports everything that is inferred, converted, cut or shifted; what
cannot be decided is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import tables
from ..checks import InputError, check_keys, naming, suggestion
from ..tables import (
    FIRST_NAMES,
    SECOND_NAMES,
    Row,
    first_of_numbers,
    is_number,
    is_numeric,
    is_unit,
    known_unit,
    name_unit,
    numbers_in,
    plain,
    read_rows,
)
from .loading import FEWEST, SMALL, WHOLE, Part, label, loading, measured, noise, rows_of, were

FloatArray = np.ndarray

LARGEST = 1e9  # mm, N, rad or N/mm
OTHERS = {"displacement": "shear_angle", "force": "shear_force"}
SECOND = {quantity: tables.SECOND[quantity] for quantity in OTHERS}
QUANTITIES = ("displacement", "force", "shear_angle", "shear_force")
NAMES, UNITS = ({q: table[q] for q in QUANTITIES} for table in (tables.NAMES, tables.UNITS))


@dataclass(frozen=True)
class Curve:
    """The loading part of a test."""

    force: FloatArray  # (n,) N, or N/mm where `per_length`
    displacement: FloatArray | None  # (n,) mm, increasing strictly from zero or above
    shear_angle: FloatArray | None  # (n,) rad; increasing strictly where it has no displacement
    sigma: FloatArray  # (n,) standard deviation of the force
    per_length: bool = False  # whether it is the normalised force t0 S12 of a picture frame
    notices: tuple[str, ...] = ()  # what was inferred, converted, cut or shifted
    preload: float = 0.0  # force that was found in the first row and is taken to act on the fabric


def read(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    part: Part = WHOLE,
) -> Curve:
    """Read the loading part of a test from a CSV file (see `tables` for its forms).

    A force or a shear_force is needed, and a displacement or a shear_angle. `columns` has the
    heading, or the position from "1", of a quantity whose heading is not recognised or not the only
    one; a file without headings needs positions. `units` go over those of the file. `part` says
    which cycle is used, and where the curve begins.
    """
    notices: list[str] = []
    columns, units = dict(columns or {}), dict(units or {})
    with naming(path):
        check_keys(columns, NAMES, "columns")
        check_keys(units, NAMES, "units")
        rows = read_rows(Path(path))
        places, declared, first = _places(rows, columns, notices)
        values, lines = _numbers(rows[first:], places, notices)
        for quantity in values:
            unit = units.get(quantity) or declared.get(quantity)
            values[quantity] *= _factor(quantity, unit, values[quantity], notices)
            if not (largest := np.abs(values[quantity]).max()) < LARGEST:
                reached = measured(quantity, largest)
                raise InputError(f"the {label(quantity)} reaches {reached}: check its unit")
        along = "displacement" if "displacement" in values else "shear_angle"
        force = "shear_force" if "shear_force" in values else "force"
        angle = [values["shear_angle"]] if "shear_angle" in values else []
        rows = np.stack([values[along], values[force], *angle])  # (2 or 3, n)
        (x, f, *angle), preload = loading(rows, along, force, lines, part, notices)
        displacement, shear_angle = x if along == "displacement" else None, [*angle, None][0]
        per_length = force == "shear_force"
        sigma = noise(x, f)
        return Curve(f, displacement, shear_angle, sigma, per_length, tuple(notices), preload)


def mean_of(curves: Sequence[Curve]) -> Curve:
    """Mean of repeats of one test over the displacement (or shear angle) they have in common.

    Its sigma is the standard error of the mean: the relative scatter between the repeats, averaged
    over a moving fifth of the range, but at least their own noise, over the root of their number.
    """
    if not curves:
        raise InputError("mean_of needs at least one curve")
    if len(curves) == 1:
        return curves[0]
    kinds = dict.fromkeys((c.per_length, c.displacement is None) for c in curves)
    if len(kinds) > 1:
        names = ("force", "shear force"), ("displacement", "shear angle")
        words = " and ".join(f"{names[0][force]} over {names[1][angle]}" for force, angle in kinds)
        raise InputError(f"repeats must have the same quantities, got {words}")
    along = "shear_angle" if curves[0].displacement is None else "displacement"
    xs = [getattr(c, along) for c in curves]
    low, high = max(x[0] for x in xs), min(x[-1] for x in xs)
    if not low < high:
        spans = ", ".join(f"{measured(along, x[0])} to {measured(along, x[-1])}" for x in xs)
        raise InputError(f"repeats have no {label(along)} in common: {spans}")
    n, pairs = len(curves), list(zip(xs, curves, strict=True))
    grid = np.linspace(low, high, int(np.median([len(x) for x in xs])))

    def on_grid(name: str) -> FloatArray:
        return np.array([np.interp(grid, x, getattr(c, name)) for x, c in pairs])

    forces = on_grid("force")
    force = forces.mean(axis=0)
    size = np.maximum(force, SMALL * force.max())
    window = np.ones(max(1, len(grid) // 5))
    square = (forces.std(axis=0, ddof=1) / size) ** 2
    pooled = np.convolve(square, window, "same") / np.convolve(np.ones(len(grid)), window, "same")
    noise = (on_grid("sigma") ** 2).mean(axis=0)
    notices = dict.fromkeys(notice for c in curves for notice in c.notices)
    angles = all(c.shear_angle is not None for c in curves)
    return Curve(
        force,
        grid if along == "displacement" else None,
        on_grid("shear_angle").mean(axis=0) if angles else None,
        np.sqrt(np.maximum(pooled * size**2, noise) / n),
        curves[0].per_length,
        (*notices, f"{n} repeats, scatter {100 * np.sqrt(square.mean()):.1f} %"),
    )


# Columns


def _candidates(cells: list[str], columns: Mapping[str, str]) -> dict[str, list[int]]:
    """Columns that may be each quantity: those asked for, else those whose name is known."""
    found: dict[str, list[int]] = {}
    headings = [(plain(cell), name_unit(cell)[0]) for cell in cells]
    for quantity, asked in columns.items():
        name = plain(str(asked))
        found[quantity] = [k for k, names in enumerate(headings) if name in names]
        if not found[quantity] and name.isdecimal() and 1 <= int(name) <= len(cells):
            found[quantity] = [int(name) - 1]
    taken = {k for places in found.values() for k in places}
    for k, (_, name) in enumerate(headings):
        quantity = FIRST_NAMES.get(name)
        if quantity in NAMES and quantity not in columns and k not in taken:
            found.setdefault(quantity, []).append(k)
    for quantity in [q for q in SECOND if not {q, OTHERS[q]} & found.keys()]:
        second = [k for k, (_, name) in enumerate(headings) if SECOND_NAMES.get(name) == quantity]
        if places := [k for k in second if k not in taken]:
            found[quantity] = places
    if "force" in columns or "shear_force" in columns:  # the one asked for, not the other beside it
        found = {q: k for q, k in found.items() if q in columns or not q.endswith("force")}
    return found


def _enough(found: Mapping[str, object]) -> bool:
    return all(any(map(found.get, pair)) for pair in OTHERS.items())


def _places(
    rows: list[Row], columns: Mapping[str, str], notices: list[str]
) -> tuple[dict[str, int], dict[str, str], int]:
    """Column and declared unit of each quantity, and the first row of numbers."""
    numbers = first_of_numbers(rows)
    if _enough(columns) and all(str(asked).strip().isdecimal() for asked in columns.values()):
        places = {quantity: int(asked) - 1 for quantity, asked in columns.items()}
        width = max(len(row.cells) for row in rows[numbers:])
        for place in places.values():
            if not 0 <= place < width:
                raise InputError(f"column {place + 1} not found: there are {width} columns")
        declared = {}
        for row in rows[max(0, numbers - 2) : numbers]:
            declared |= _declared(row.cells, places)
        return _one_force(places, rows[numbers].cells), declared, numbers
    headings = (k for k, row in enumerate(rows) if not is_numeric(row.cells))
    heading = next((k for k in headings if _enough(_candidates(rows[k].cells, columns))), None)
    if heading is None:
        raise InputError(_no_heading(rows[:numbers], columns))
    cells = rows[heading].cells
    found = _candidates(cells, columns)
    for quantity, many in found.items():
        if not many:
            raise InputError(_not_found(str(columns[quantity]), cells))
        if len(many) > 1:
            names = " and ".join(f"'{cells[k]}' (column {k + 1})" for k in many)
            option = _option("columns", quantity, str(many[0] + 1))
            raise InputError(f"{names} may both be the {label(quantity)}: choose with {option}")
        if quantity not in columns and name_unit(cells[many[0]])[0] in SECOND_NAMES:
            notices.append(f"The column '{cells[many[0]]}' was taken as the {label(quantity)}.")
    places = _one_force({quantity: many[0] for quantity, many in found.items()}, cells)
    declared, first = _declared(cells, places), heading + 1
    while first < len(rows) and rows[first].comment:
        first += 1
    if first < len(rows) and not any(is_number(cell) for cell in rows[first].cells):
        declared = _declared(rows[first].cells, places, line_of_units=True) | declared
        first += 1
    return places, declared, first


def _one_force(places: dict[str, int], cells: list[str]) -> dict[str, int]:
    if {"force", "shear_force"} <= places.keys():
        force, shear_force = (cells[places[quantity]] for quantity in ("force", "shear_force"))
        options = _option("columns", "force", force), _option("columns", "shear_force", "...")
        words = f"'{force}' is a force and '{shear_force}' a shear force"
        raise InputError(f"{words}: choose one with {' or '.join(options)}")
    return places


def _declared(
    cells: list[str], places: Mapping[str, int], line_of_units: bool = False
) -> dict[str, str]:
    """Units in a heading, or in the line of units below it where a word is nothing else."""
    declared = {}
    for quantity, k in places.items():
        cell = cells[k] if k < len(cells) else ""
        bare = cell.strip("[]() ")
        unit = bare if line_of_units or known_unit(quantity, bare) else name_unit(cell)[1]
        if unit:
            declared[quantity] = unit
    return declared


def _option(name: str, quantity: str, value: str) -> str:
    """How each caller says which column or unit a quantity has."""
    return f'--{name} {quantity}="{value}" (in TOML and Python: {name})'


def _listed(cells: list[str]) -> str:
    return ", ".join(f"'{cell}'" for cell in cells)


def _not_found(asked: str, cells: list[str]) -> str:
    return f"column '{asked}' not found: {suggestion(asked, cells)} (columns: {_listed(cells)})"


def _no_heading(rows: list[Row], columns: Mapping[str, str]) -> str:
    """Say what the last line before the numbers that is not one of units lacks."""
    for cells in (row.cells for row in reversed(rows)):
        if len(cells) > 1 and not any(map(is_unit, cells)):
            found = _candidates(cells, columns)
            for quantity, asked in columns.items():
                if not found[quantity]:
                    return _not_found(str(asked), cells)
            key = "displacement" if found.get("force") or found.get("shear_force") else "force"
            lacking = f"{key} or {label(OTHERS[key])}"
            near = [cell for cell in cells if known_unit(key, name_unit(cell)[1] or "")]
            option = _option("columns", key, near[0] if near else "...")
            return f"no column of a {lacking}: found {_listed(cells)}; name it with {option}"
    option = "--columns displacement=1,force=2 (in TOML and Python: columns)"
    return f"no line of headings: give positions, {option}"


def _numbers(
    rows: list[Row], places: Mapping[str, int], notices: list[str]
) -> tuple[dict[str, FloatArray], np.ndarray]:
    """Numbers of each quantity and their lines in the file."""
    table = [row for row in rows if row.cells and not row.comment]
    if len(table) < FEWEST:
        raise InputError(f"only {rows_of(len(table))} of numbers, at least {FEWEST} are needed")
    if left := len(rows) - len(table):
        notices.append(were(left, "without numbers", "left out"))
    values = numbers_in(table, {f"the {label(q)}": place for q, place in places.items()})
    return dict(zip(places, values.T.copy(), strict=True)), np.array([row.line for row in table])


# Units


def _factor(quantity: str, unit: str | None, values: FloatArray, notices: list[str]) -> float:
    """Size of the unit, declared or inferred from the values, in mm, N, rad or N/mm."""
    name, known = label(quantity), UNITS[quantity]
    assumed, largest = next(iter(known)), np.abs(values).max()
    if unit is None:
        if quantity == "force" and largest < 0.5:
            words = f"the largest force is {largest:.3g} without a unit, which looks like kN"
            option = _option("units", "force", "kN")
            raise InputError(f"{words}: declare it, Force [kN] in the heading or {option}")
        if quantity == "shear_angle" and largest < 1.6:
            notices.append("The shear angle has no unit and stays below 1.6: taken as rad.")
            return known["rad"]
        notices.append(f"The {name} has no unit: taken as {assumed}.")
        return known[assumed]
    spelt = known_unit(quantity, unit)
    if spelt is None:
        other = [label(q) for q in UNITS if known_unit(q, unit)]
        hint = f", it is one of a {other[0]}" if other else ""
        words = f"unknown unit '{unit}' of the {name}{hint}"
        raise InputError(f"{words}: expected one of {', '.join(known)}")
    if known[spelt] != known[assumed]:
        notices.append(f"The {name} was read in {spelt}.")
    return known[spelt]
