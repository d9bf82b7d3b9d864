"""Measured curves of off-axis tension and picture-frame tests, read from a laboratory's CSV.

What a machine exports becomes the loading part of the test with a standard deviation for each
force: unloading and tearing are cut, slack is cut and its end becomes zero, noise is estimated.
`Curve.notices` reports everything that is inferred, converted, cut or shifted; what cannot be
decided is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
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

FloatArray = np.ndarray

FEWEST = 8  # rows of a curve
UNSTRAINED = 0.25  # of the force at the slope of the start: below, the displacement has an offset
BACK = 0.02  # of the range; going back further is no jitter
DROP = 0.2  # of the largest force; a specimen whose force drops by more is torn
LARGEST = 1e9  # mm, N, rad or N/mm
SMALL = 0.02  # of the largest force: near zero, and where relative noise becomes absolute
OFFSET = 0.05  # of the largest force; a constant level above is friction, not a load cell's offset
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


def read(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Curve:
    """Read the loading part of a test from a CSV file (see `tables` for its forms).

    A force or a shear_force is needed, and a displacement or a shear_angle. `columns` has the
    heading, or the position from "1", of a quantity whose heading is not recognised or not the only
    one; a file without headings needs positions. `units` go over those of the file.
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
                reached = _measured(quantity, largest)
                raise InputError(f"the {_label(quantity)} reaches {reached}: check its unit")
        return _loading(values, lines, notices)


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
        spans = ", ".join(f"{_measured(along, x[0])} to {_measured(along, x[-1])}" for x in xs)
        raise InputError(f"repeats have no {_label(along)} in common: {spans}")
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
            raise InputError(f"{names} may both be the {_label(quantity)}: choose with {option}")
        if quantity not in columns and name_unit(cells[many[0]])[0] in SECOND_NAMES:
            notices.append(f"The column '{cells[many[0]]}' was taken as the {_label(quantity)}.")
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
            lacking = f"{key} or {_label(OTHERS[key])}"
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
        notices.append(_were(left, "without numbers", "left out"))
    values = numbers_in(table, {f"the {_label(q)}": place for q, place in places.items()})
    return dict(zip(places, values.T.copy(), strict=True)), np.array([row.line for row in table])


def rows_of(n: int) -> str:
    """Return "1 row" or "2 rows"."""
    return "1 row" if n == 1 else f"{n} rows"


def _were(n: int, where: str, what: str) -> str:
    return f"{rows_of(n)} {where} {'was' if n == 1 else 'were'} {what}."


# Units


def _label(quantity: str) -> str:
    return quantity.replace("_", " ")


def _measured(quantity: str, value: float) -> str:
    unit = next(iter(UNITS[quantity]))
    return f"{np.degrees(value) if unit == 'deg' else value:.3g} {unit}"


def _factor(quantity: str, unit: str | None, values: FloatArray, notices: list[str]) -> float:
    """Size of the unit, declared or inferred from the values, in mm, N, rad or N/mm."""
    label, known = _label(quantity), UNITS[quantity]
    assumed, largest = next(iter(known)), np.abs(values).max()
    if unit is None:
        if quantity == "force" and largest < 0.5:
            words = f"the largest force is {largest:.3g} without a unit, which looks like kN"
            option = _option("units", "force", "kN")
            raise InputError(f"{words}: declare it, Force [kN] in the heading or {option}")
        if quantity == "shear_angle" and largest < 1.6:
            notices.append("The shear angle has no unit and stays below 1.6: taken as rad.")
            return known["rad"]
        notices.append(f"The {label} has no unit: taken as {assumed}.")
        return known[assumed]
    spelt = known_unit(quantity, unit)
    if spelt is None:
        other = [_label(q) for q in UNITS if known_unit(q, unit)]
        hint = f", it is one of a {other[0]}" if other else ""
        words = f"unknown unit '{unit}' of the {label}{hint}"
        raise InputError(f"{words}: expected one of {', '.join(known)}")
    if known[spelt] != known[assumed]:
        notices.append(f"The {label} was read in {spelt}.")
    return known[spelt]


# The loading part


def _loading(values: Mapping[str, FloatArray], lines: np.ndarray, notices: list[str]) -> Curve:
    """Cut what is not loading, move the zero, estimate the noise."""
    along = "displacement" if "displacement" in values else "shear_angle"
    force = "shear_force" if "shear_force" in values else "force"
    angle = [values["shear_angle"]] if "shear_angle" in values else []
    rows = np.stack([values[along], values[force], *angle])  # (2 or 3, n)
    rows = _ahead(rows[:, : _end(rows, along, force, lines, notices)], along, lines, notices)
    if rows[1].max() <= 0:
        raise InputError("the force is nowhere positive while loading: is its sign reversed?")
    if along == "displacement":
        rows = _from_zero(rows, force, notices)
    x, f, *angle = _enough_rows(rows)
    sigma = _noise(x, f)
    if along == "displacement" and x[0] == 0 and f[0] > 3 * sigma[0]:
        notices.append(f"A preload of {_measured(force, f[0])} was kept.")
    displacement = x if along == "displacement" else None
    shear_angle = angle[0] if angle else None
    return Curve(f, displacement, shear_angle, sigma, force == "shear_force", tuple(notices))


def _enough_rows(rows: FloatArray, why: str = "") -> FloatArray:
    """Refuse too few rows (k, n)."""
    if (n := rows.shape[-1]) < FEWEST:
        belong = "belongs" if n == 1 else "belong"
        words = f"only {rows_of(n)} {belong} to the loading, at least {FEWEST} are needed{why}"
        raise InputError(words)
    return rows


def _end(rows: FloatArray, along: str, force: str, lines: np.ndarray, notices: list[str]) -> int:
    """Number of rows before unloading and tearing."""
    x, f = rows[:2]
    end = int(x.argmax()) + 1
    _enough_rows(x[:end], f": the {_label(along)} is largest at line {lines[end - 1]}")
    if n := len(x) - end:
        largest = f"{_label(along)}, {_measured(along, x[end - 1])}"
        notices.append(_were(n, f"after the largest {largest},", "cut"))
    top = int(f[:end].argmax())
    if f[top] > 0 and f[top:end].min() < (1 - DROP) * f[top]:
        place = f"after {_measured(force, f[top])} at {_measured(along, x[top])}"
        rest = _were(end - top, "from there on", "cut")
        notices.append(f"The force drops by more than {100 * DROP:g} % {place}: {rest}")
        end = top
    _enough_rows(x[:end])
    return end


def _ahead(rows: FloatArray, along: str, lines: np.ndarray, notices: list[str]) -> FloatArray:
    """Leave out rows that do not move ahead; refuse a record that goes back."""
    x = rows[0]
    reached = np.maximum.accumulate(x)
    back, worst = (reached - x).max(), int((reached - x).argmax())
    if back > BACK * np.ptp(x):
        words = f"{_measured(along, back)} at line {lines[worst]}"
        raise InputError(f"{_label(along)} is not monotone: goes back by {words}")
    ahead = np.r_[True, x[1:] > reached[:-1]]
    if not ahead.all():
        n = int((~ahead).sum())
        move = "does not move" if n == 1 else "do not move"
        notices.append(_were(n, f"that {move} ahead", "left out"))
    return _enough_rows(rows[:, ahead])


def _from_zero(rows: FloatArray, force: str, notices: list[str]) -> FloatArray:
    """Cut the slack, or let the displacement start at zero; an angle stays as it was measured."""
    x, f = rows[:2]
    if slack := _slack(x, f):
        start, level = slack
        cut = f"Slack up to {start:.4g} mm was cut, displacement counts from there"
        before = f"the constant {_measured(force, level)} before it was subtracted from the force"
        notices.append(f"{cut}; {before}.")
        return np.stack([x - start, f - level, *rows[2:]])[:, x > start]
    if x[0] == 0:
        return rows
    # a sheet that was strained by x[0] already would have taken about the slope of the start
    near = slice(0, max(FEWEST, np.searchsorted(x, x[0] + abs(x[0]))))
    slope = max(np.polyfit(x[near], f[near], 1)[0], 0.0)
    if x[0] < 0 or f[0] < UNSTRAINED * slope * x[0]:
        notices.append(f"The displacement was shifted by {-x[0]:.4g} mm to start at 0.")
        return np.stack([x - x[0], *rows[1:]])
    notices.append(f"The curve begins at {x[0]:.4g} mm with {_measured(force, f[0])}: not shifted.")
    return rows


def _slack(x: FloatArray, f: FloatArray) -> tuple[float, float] | None:
    """End of the slack, mm, and constant force before it, N; None if there is no slack.

    Rows from the first on are flat as long as their slope is not significant. The line through
    the first rise meets their level at the end of the slack, provided that this kinked line fits
    better than a parabola, as which a curve that just begins softly would pass.
    """
    top, n = f.max(), len(f)
    if np.ptp(f) == 0:
        return None
    step = np.diff(np.unique(f)).min() / np.sqrt(12)  # what rounding to a step scatters

    def scatter(k: int) -> float:
        return max(np.sqrt(np.mean(np.diff(f[:k], 2) ** 2) / 6), step, 1e-6 * top)

    k = 6
    while k < n:
        u = x[:k] - x[:k].mean()
        if abs(u @ f[:k]) > 4 * scatter(k) * np.sqrt(u @ u):
            break
        k = max(k + 1, int(1.05 * k))
    flat = int(0.8 * min(k, n))
    level, noise = float(np.median(f[:flat])), scatter(flat)
    if k >= n or flat < 5 or abs(level) > OFFSET * top:
        return None
    above = f > level + 5 * noise
    first = flat + int(np.argmax(above[flat:-1] & above[flat + 1 :]))
    last = max(first + 6, int(np.argmax(f > level + 20 * noise)) + 1)
    X, F = x[first:last], f[first:last]
    if len(X) < 4:
        return None
    i, j = np.triu_indices(len(X), 1)
    slope = np.median((F[j] - F[i]) / (X[j] - X[i]))  # Theil-Sen
    start = float(np.median(X - (F - level) / slope))
    X, F = x[:last], f[:last]
    kinked = level + slope * np.maximum(X - start, 0) - F
    u = (X - X[0]) / np.ptp(X)
    parabola = np.polyval(np.polyfit(u, F, 2), u) - F
    if slope <= 0 or kinked @ kinked > 0.7 * (parabola @ parabola):
        return None
    return start, level


def _noise(x: FloatArray, f: FloatArray) -> FloatArray:
    """Standard deviation of the force: a share of it, of at least SMALL of the largest.

    The share is the median of what is left of a row by the cubic through its four neighbours,
    which a smooth curve's curvature does not enter, over the standard deviation of that by
    noise of one.
    """
    k = np.arange(2, len(x) - 2)
    near = k[:, None] + [-2, -1, 1, 2]  # (n - 4, 4)
    weight = np.ones(near.shape)  # of Lagrange
    for a, b in permutations(range(4), 2):
        weight[:, a] *= (x[k] - x[near[:, b]]) / (x[near[:, a]] - x[near[:, b]])
    left = (f[k] - (weight * f[near]).sum(axis=1)) / np.sqrt(1 + (weight**2).sum(axis=1))
    floor = SMALL * f.max()
    local = np.maximum((f[k - 1] + f[k] + f[k + 1]) / 3, floor)
    share = np.median(np.abs(left) / local) / 0.6745
    return max(share, 1e-6) * np.maximum(f, floor)
