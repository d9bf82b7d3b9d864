"""Tables in text files: one reader for records, outlines, fields and histories, and a writer.

Columns are separated by semicolons, tabs, blanks or commas, with a decimal point or comma. Lines
before the heading are skipped; the heading may be a comment, and a line of units may follow it.
Names are known by what they usually are called, in any case, with underscores or without, with a
unit at the end: "Force [kN]", "x_mm", "Kraft in N", "Node Label".
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .checks import InputError, check_file, naming, suggestion

FloatArray = np.ndarray
WIDEST = 5000  # characters of a line
SAMPLE = 1000  # lines from which the separator is found

NAMES = {  # of each quantity
    "displacement": "displacement disp extension elongation crosshead stroke travel weg "
    "verschiebung traverse u d",
    "force": "force load kraft f standardkraft",
    "shear_angle": "shearangle gamma γ angle scherwinkel",
    "shear_force": "shearforce normalisedshearforce normalizedshearforce fsh",
    "x": "x xformed formedx xdeformed coordx",
    "y": "y yformed formedy ydeformed coordy",
    "z": "z zformed formedz zdeformed coordz",
    "x0": "x0 xflat flatx xundeformed xmaterial xblank",
    "y0": "y0 yflat flaty yundeformed ymaterial yblank",
    "node": "node nodelabel nodeid nodenumber",
    "element": "element elementlabel elementid elementnumber elem",
    "u1": "u1 ux",
    "u2": "u2 uy",
    "u3": "u3 uz",
    "loop": "loop",
    "kinetic": "kineticenergy kinetic ekin allke",
    "internal": "internalenergy internal eint allie strainenergy allse",
}
SECOND = {  # names that count where none of NAMES is there: they may be another's beside it
    "displacement": "position crossheaddisplacement crossheadposition crossheadtravel "
    "crossheadextension crossheadmovement machinedisplacement machineextension standardtravel "
    "standardweg tensiledisplacement tensileextension axialdisplacement axialposition actuator "
    "actuatordisplacement actuatorposition pistonstroke gripdisplacement traversenweg "
    "traversenposition traversenverschiebung maschinenweg kolbenweg prüfweg dehnweg "
    "längenänderung punchtravel punchdisplacement",
    "force": "standardforce tensileforce tensileload axialforce axialload testforce testload "
    "loadcell prüfkraft zugkraft axialkraft maschinenkraft punchforce reaction",
    "shear_angle": "shear scherung",
}
_LENGTH = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "µm": 1e-3, "in": 25.4, "inch": 25.4}
_ENERGY = {"mJ": 1.0, "J": 1e3, "Nmm": 1.0}
UNITS = {  # in mm, N, rad, N/mm, mJ; the first is assumed where none is declared
    "displacement": _LENGTH,
    "force": {"N": 1.0, "kN": 1e3, "cN": 1e-2, "lbf": 4.4482216152605},
    "shear_angle": {"deg": pi / 180, "°": pi / 180, "rad": 1.0},
    "shear_force": {"N/mm": 1.0, "N/m": 1e-3, "kN/m": 1.0},
    **dict.fromkeys(("x", "y", "z", "x0", "y0", "u1", "u2", "u3"), _LENGTH),
    **dict.fromkeys(("kinetic", "internal"), _ENERGY),
}
FIRST_NAMES = {name: quantity for quantity, names in NAMES.items() for name in names.split()}
SECOND_NAMES = {name: quantity for quantity, names in SECOND.items() for name in names.split()}
_UNIT = "|".join(sorted({re.escape(u) for known in UNITS.values() for u in known}, key=len)[::-1])
_NAME_UNIT = (  # what a heading may look like, its name and its unit
    re.compile(r"(.+?)\s*[\[(]\s*([^\])]*?)\s*[\])]"),  # Force [N]
    re.compile(rf"(.+?)(?:\s+in)?[\s_/,:]+({_UNIT})", re.IGNORECASE),  # force_N, Kraft in N
    re.compile(r"([^/]+?)\s*/\s*(\S+)"),  # Force/kp
)
_CHANNEL = re.compile(r"(station|channel|kanal)[\s_]*\d+[\s_:.-]+(?=\w)", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)


class Row(NamedTuple):
    """A line that is not blank; empty cells at the end are only in `width`."""

    line: int
    comment: bool
    cells: list[str]
    width: int


def read_rows(path: Path) -> list[Row]:
    """Rows of a file that are not blank, by the separator that gives most rows of numbers.

    Where two do, the earlier is right: in "1,5;2,5" the commas are decimal signs. InputError for
    what is no text in UTF-8 or Latin-1, and where no row has two numbers.
    """
    check_file(path)
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if re.search("[\x00-\x08\x0e-\x1f]", text):
        raise InputError("not a text file: expected CSV in UTF-8 or Latin-1")
    lines = [(k, s.strip(" ")) for k, s in enumerate(re.split("\r\n|\r|\n", text), 1) if s.strip()]
    for k, line in lines:
        if len(line) > WIDEST:  # the time for a heading grows with the square of its blanks
            raise InputError(f"line {k} has {len(line)} characters: no row of a table")
    lines = [(k, re.sub(r"\s#.*", "", s) if s[0] in "+-.0123456789" else s) for k, s in lines]
    best, most = None, 0
    for separator in (";", "\t", None, ","):
        table = (_split(line, separator) for _, line in lines[:SAMPLE])
        widths = Counter(len(cells) for cells in table if is_numeric(cells))
        if (count := max(widths.values(), default=0)) > most:
            best, most = separator, count
    if not most:
        raise InputError("no rows of two or more numbers")
    bare = [line.lstrip("#% ") for _, line in lines]
    table = [_split(line, best) for line in bare]
    if best is None:  # a heading may hold blanks, and prose as many words as there are columns
        widths = Counter(len(cells) for cells in table if is_numeric(cells))
        width = widths.most_common(1)[0][0]
        for k, cells in enumerate(table):
            wrong = len(cells) != width and not all(map(is_number, cells))
            table[k] = _heading(bare[k], width) if wrong or not is_numeric(cells) else cells
    return [
        Row(k, line[0] in "#%", _filled(cells), len(cells))
        for (k, line), cells in zip(lines, table, strict=True)
    ]


def _heading(line: str, width: int) -> list[str]:
    """Cells of a line between columns of blanks: all of it is one where their number is wrong."""
    joined = re.sub(r"\s+(?=[\[(])", "", line)
    for cells in (re.split(r"\s{2,}", line), _split(joined, None), _split(line, None)):
        if len(cells) == width:
            return cells
    return [line]


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return [cell.strip('"') for cell in re.findall(r'"[^"]*"|\S+', line)]
    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def _filled(cells: list[str]) -> list[str]:
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def is_number(cell: str) -> bool:
    """Whether a cell is a number, nan and inf included."""
    return bool(_NUMBER.fullmatch(cell))


def is_numeric(cells: list[str]) -> bool:
    """Whether there are two numbers or more."""
    return sum(map(is_number, cells)) > 1


def first_of_numbers(rows: list[Row]) -> int:
    """Place of the first row of numbers that is not a comment.

    A heading may hold two figures, but among words where most rows have numbers.
    """
    numeric = [k for k, row in enumerate(rows) if is_numeric(row.cells) and not row.comment]
    places = Counter(j for k in numeric for j, cell in enumerate(rows[k].cells) if is_number(cell))
    usual = [j for j, count in places.items() if 2 * count > len(numeric)]
    for k in numeric:
        cells = dict(enumerate(rows[k].cells))
        if all(not cells.get(j) or is_number(cells[j]) for j in usual):
            return k
    raise InputError("no rows of two or more numbers that are not comments")


def numbers_in(rows: list[Row], columns: Mapping[str, int], gaps: bool = False) -> FloatArray:
    """(n, k) numbers of columns, each called in messages as it is named here.

    The decimal sign is the comma or the point, whichever there is more of. With `gaps` empty cells
    are nan. InputError for a cell that is not a finite number.
    """
    table = [[row.cells[k] if k < len(row.cells) else "" for k in columns.values()] for row in rows]
    marks = [mark for cells in table for cell in cells for mark in cell if mark in ",."]
    wrong = "." if 2 * marks.count(",") > len(marks) else ","
    values = np.full((len(rows), len(columns)), np.nan)
    for i, (row, cells) in enumerate(zip(rows, table, strict=True)):
        for j, (name, cell) in enumerate(zip(columns, cells, strict=True)):
            if gaps and cell.lower() in ("", "nan"):
                continue
            if not is_number(cell) or wrong in cell:
                raise InputError(f"line {row.line}: {name} is not a number: {cell!r}")
            values[i, j] = float(cell.replace(",", "."))
            if not abs(values[i, j]) < 1e30:
                raise InputError(f"line {row.line}: {name} is not finite: {cell!r}")
    return values


# Names and units


def plain(name: str) -> str:
    """Return a name without blanks and in small letters."""
    return re.sub(r"[\s_.-]", "", name).casefold()


def name_unit(heading: str) -> tuple[str, str | None]:
    """Plain name and unit of a heading such as Force [kN]."""
    heading = _CHANNEL.sub("", heading)
    if plain(heading) not in FIRST_NAMES | SECOND_NAMES and len(heading) < 200:
        for match in (pattern.fullmatch(heading) for pattern in _NAME_UNIT):
            if match:
                return plain(match[1]), match[2] or None
    return plain(heading), None


def known_unit(quantity: str, unit: str) -> str | None:
    """Return the unit as it is spelt here: MM is mm, the other letter µ is the same."""
    unit = re.sub("[μµ]", "u", unit).casefold()
    return next((name for name in UNITS.get(quantity, ()) if name.casefold() == unit), None)


def name_of(heading: str) -> tuple[str, float]:
    """Name of a column and the factor of its unit; another quantity keeps its heading.

    >>> name_of("Punch force [kN]"), name_of("shear_angle_deg"), name_of("S12")
    (('force', 1000.0), ('angle', 1.0), ('S12', 1.0))
    """
    name, unit = name_unit(heading)
    quantity = (FIRST_NAMES | SECOND_NAMES).get(name)
    if quantity is None or (unit and known_unit(quantity, unit) is None):
        return heading, 1.0
    factor = UNITS[quantity][known_unit(quantity, unit)] if unit else 1.0
    if quantity == "shear_angle":
        return "angle", float(np.degrees(factor)) if unit else 1.0
    return {"displacement": "travel"}.get(quantity, quantity), factor


# Whole tables


class Columns(dict[str, FloatArray]):
    """Columns of a table by name; `left_out` rows had no number."""

    left_out = 0


def read_table(path: Path, wanted: str = "") -> Columns:
    """Columns of a file by their names (see `name_of`) or, unknown ones, by their headings.

    Lengths come in mm, forces in N, energies in mJ, angles in degrees where a heading names its
    unit, else as they stand. Empty cells are nan, rows without a number are left out and counted.
    The column with the heading `wanted` is taken as the angle, whatever it is called. InputError
    names the file and its defect.
    """
    headings, units, numbers = read_numbers(path)
    found, width = Columns(), numbers.shape[1]
    with naming(path):
        if len(headings) != width:
            such = ", ".join(["x", "y", "z", "angle"][: max(2, min(4, width))])
            raise InputError(f"no line of headings for its {width} columns, such as {such}")
        if wanted and wanted not in headings:
            raise InputError(f"column '{wanted}' not found: {suggestion(wanted, headings)}")
        whole = ~np.isnan(numbers).all(1)
        found.left_out = int((~whole).sum())
        for heading, unit, column in zip(headings, units, numbers[whole].T, strict=True):
            name, factor = name_of(f"{heading} [{unit}]" if unit else heading)
            if wanted:
                name = "angle" if heading == wanted else heading if name == "angle" else name
            if name in found and name_unit(heading)[0] in SECOND_NAMES:
                name = heading
            if name in found:
                words = f"'{heading}' and another ({name})"
                raise InputError(f"two columns of the same meaning: {words}")
            found[name] = column * factor
    return found


def read_numbers(path: Path, most: int = WIDEST) -> tuple[list[str], list[str], FloatArray]:
    """Headings, units of the line below them, and numbers (n, k) of the columns of a file.

    Only the first columns are read where there are more than `most`; empty cells are nan.
    InputError names the file and its defect.
    """
    with naming(path):
        rows = read_rows(path)
        first = first_of_numbers(rows)
        above = [row.cells for row in rows[:first]]
        below = [row for row in rows[first:] if not row.comment]
        width = min(below[0].width, most)
        units = [""] * width
        if len(above) > 1 and all(not cell or is_unit(cell) for cell in above[-1]):
            units = [cell.strip("[]() ") for cell in above.pop()] + units
        for row in below:
            if min(row.width, most) != width:
                words = f"{row.width} cells, the first row of numbers has {width}"
                raise InputError(f"line {row.line}: {words}")
        numbers = numbers_in(below, {f"column {k + 1}": k for k in range(width)}, gaps=True)
        return (above[-1] if above else []), units[:width], numbers


def write_rows(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV file, its headings first."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


def is_unit(cell: str) -> bool:
    """Whether a cell is a unit such as [kN]."""
    return any(known_unit(quantity, cell.strip("[]() ")) for quantity in UNITS)
