"""Numbers from a CSV table of strangers: separators, decimal signs, headings with units.

Columns are separated by semicolons, tabs, commas or blanks; with semicolons or tabs a comma may be
the decimal sign. The heading may be a comment. Names are told by what they usually are called, in
any case, with underscores or without, with a unit at the end: "Force [kN]", "x_mm", "Node Label".
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from ..checks import InputError, suggestion

FloatArray = np.ndarray
NAMES = {
    "x": "x xformed formedx xdeformed coordx",
    "y": "y yformed formedy ydeformed coordy",
    "z": "z zformed formedz zdeformed coordz",
    "x0": "x0 xflat flatx xundeformed xmaterial xblank",
    "y0": "y0 yflat flaty yundeformed ymaterial yblank",
    "angle": "angle shearangle gamma γ shear scherwinkel scherung",
    "node": "node nodelabel nodeid nodenumber",
    "element": "element elementlabel elementid elementnumber elem",
    "u1": "u1 ux",
    "u2": "u2 uy",
    "u3": "u3 uz",
    "loop": "loop",
    "travel": "travel punchtravel stroke displacement punchdisplacement",
    "force": "force punchforce load reaction",
    "kinetic": "kineticenergy kinetic ekin allke",
    "internal": "internalenergy internal eint allie strainenergy allse",
}
FACTORS = {"mm": 1.0, "m": 1e3, "cm": 10.0, "N": 1.0, "kN": 1e3, "mJ": 1.0, "J": 1e3}
FACTORS |= {"deg": 1.0, "°": 1.0, "rad": float(np.degrees(1.0)), "Nmm": 1.0}
_NAME = {alias: name for name, words in NAMES.items() for alias in words.split()}
_UNIT = re.compile(rf"(.*?)(?:_({'|'.join(FACTORS)})|\s*[\[(]\s*({'|'.join(FACTORS)})\s*[\])])\s*")


def read_table(path: Path, wanted: str = "") -> dict[str, FloatArray]:
    """Columns of a CSV file by their names here (`NAMES`) or, unknown ones, by their headings.

    Lengths come in mm, forces in N, energies in mJ, angles in degrees where a heading names its
    unit, as they stand where not.

    Parameters
    ----------
    path : path
    wanted : str
        Heading of the column to be taken as the angle, whatever it is called.

    Raises
    ------
    InputError
        Naming the file and its defect.
    """
    try:
        content = path.read_bytes()
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
        return _columns(text, wanted)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _columns(text: str, wanted: str) -> dict[str, FloatArray]:
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    bare = [(k, line.lstrip("#% "), line[0] in "#%") for k, line in lines]
    separator = _separator([line for _, line, comment in bare if not comment])
    headings: list[str] = []
    rows: list[list[float]] = []
    for number, line, comment in bare:
        cells = _cells(line, separator)
        values = [_number(cell, separator) for cell in cells]
        if not comment and None not in values and not np.isnan(values).all():
            if rows and len(values) != len(rows[0]):
                raise InputError(
                    f"line {number}: {len(values)} numbers, the lines before have {len(rows[0])}"
                )
            rows.append(values)
        elif not rows:
            headings = cells
        elif not comment and None in values:
            cell = cells[values.index(None)]
            raise InputError(f"line {number}: not a number: {cell!r}")
    if not rows:
        raise InputError("no rows of numbers")
    if len(headings) != len(rows[0]):
        raise InputError(
            f"no line of headings for its {len(rows[0])} columns, such as "
            f"{', '.join(['x', 'y', 'z', 'angle'][: max(2, min(4, len(rows[0])))])}"
        )
    if wanted and wanted not in headings:
        raise InputError(f"column '{wanted}' not found: {suggestion(wanted, headings)}")
    numbers, found = np.array(rows), {}
    for heading, column in zip(headings, numbers.T, strict=True):
        name, factor = name_of(heading)
        if wanted:
            name = "angle" if heading == wanted else heading if name == "angle" else name
        if name in found:
            raise InputError(f"two columns of the same meaning: '{heading}' and another ({name})")
        found[name] = column * factor
    return found


def _separator(lines: list[str]) -> str | None:
    """Return what separates the last line's cells; None for blanks."""
    last = lines[-1] if lines else ""
    return next((mark for mark in ";\t," if mark in last), None)


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return re.sub(r"\s+(?=[\[(])", "", line).split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _number(cell: str, separator: str | None) -> float | None:
    """Number in a cell, nan where it is empty; None if it is none."""
    if not cell:
        return np.nan
    try:
        value = float(cell.replace(",", ".") if separator != "," else cell)
    except ValueError:
        return None
    return value if np.isfinite(value) or cell.lower() == "nan" else None


def name_of(heading: str) -> tuple[str, float]:
    """Name of a column and the factor of its unit.

    Examples
    --------
    >>> name_of("Punch force [kN]"), name_of("shear_angle_deg"), name_of("S12")
    (('force', 1000.0), ('angle', 1.0), ('S12', 1.0))
    """
    match = _UNIT.fullmatch(heading)
    name, unit = (match[1], match[2] or match[3]) if match else (heading, "")
    plain = re.sub(r"[\s_.-]", "", name).casefold()
    if plain not in _NAME:
        return heading, 1.0
    return _NAME[plain], FACTORS.get(unit, 1.0)
