"""A result beside another one, or beside another code's or a measured field."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import FORMAT, InputError, check_keys, check_number
from ..meshes.shells import counted
from ..result.files import replaced
from ..result.sheet import FormedSheet
from ..result.summary import package_version
from ..tables import write_rows
from ..toml_file import dotted_values
from .differences import (
    COLUMNS,
    Row,
    Rows,
    common_forces,
    matched,
    other_blank,
    own_values,
    weighed_alike,
)
from .mapping import ANGLE, SIDES, WAYS
from .place import aligned, unfolded
from .read import Reading, Side, read_side

if TYPE_CHECKING:
    from ..result.record import Record
    from ..result.run import Result

FloatArray = np.ndarray
FILES = ("compare.json", "compare.csv", "difference.vtu", "difference.png", "compare.md")
STANDINGS = ("measured", "stated", "exact", "peer", "prototype", "inferred", "assumed", "own")
ALIGN = ("none", "shift", "rigid")
BANDS = (  # with a word in the quantities that they are for
    ("band_angle", "γ", "shear angle"),
    ("band_outline", "outline", "outline"),
    ("band_force", "force", "force"),
)
MOST = 5  # keys of two scenes that are listed
ON_SHEET = 0.9  # of the reference: with less of it on the result they are hardly in one place


@dataclass(frozen=True, eq=False)
class Comparison:
    """A result beside a reference.

    Parameters
    ----------
    names : (str, str)
        Of the result and of the reference.
    rows : tuple of Row
        One a difference, with its band if it has one.
    notes : tuple of str
        What was compared with what, and how.
    travel : float or None
        mm.
    sheets : (FormedSheet, FormedSheet)
        As they were compared, the reference in its place; point field `shear_angle`, degrees.
    field : FormedSheet or None
        Where the difference lives.
    gamma : (2, n) array or None
        Shear angles of result and reference there, degrees; nan where not compared.
    forces : (3, k) array or None
        Common travels (mm), forces of result and reference (N).
    locking : tuple of float
        Shear angles at which the fabrics of both lock, degrees, where they are known.
    """

    names: tuple[str, str]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    travel: float | None
    sheets: tuple[FormedSheet, FormedSheet]
    field: FormedSheet | None = None
    gamma: FloatArray | None = None
    forces: FloatArray | None = None
    locking: tuple[float, ...] = ()

    @property
    def held(self) -> bool:
        """Whether every difference is within its band; true without bands."""
        return all(row.held is not False for row in self.rows)

    @property
    def difference(self) -> FloatArray | None:
        """(n,) difference of the shear angles, degrees."""
        return None if self.gamma is None else self.gamma[0] - self.gamma[1]

    def __getitem__(self, quantity: str) -> Row:
        """Row by its name."""
        return {row.quantity: row for row in self.rows}[quantity]

    def table(self) -> str:
        """Rows as text."""
        width = max(len(row.quantity) for row in self.rows)
        line = f"{{quantity:<{width}}}{{result:>12}}{{reference:>12}}{{difference:>12}}"
        lines = [line.format(**dict(zip(COLUMNS, ["", *COLUMNS[1:]], strict=True)))]
        for row in self.rows:
            cells = row.cells(".4g")
            more = f"  {row.over}" * bool(row.over)
            more += f"  {cells['held']} (band {cells['band']})" * bool(cells["held"])
            lines.append(f"{line.format(**cells)} {row.unit:<4}{more}".rstrip())
        return "\n".join(lines)

    def markdown(self) -> str:
        """Return the comparison as Markdown."""
        heads = [name for name in COLUMNS if name != "held"]
        table = [heads, ["-"] * len(heads)]
        for row in self.rows:
            cells = row.cells(".4g")
            verdict = cells.pop("held")
            cells["band"] += f": {verdict}" * bool(verdict)
            cells["quantity"] = row.quantity.replace("|", r"\|")
            table.append(cells.values())
        lines = [f"# {self.names[0]} beside {self.names[1]}", ""]
        lines += [f"| {' | '.join(words)} |" for words in table]
        lines += ["", *(f"- {note}" for note in self.notes), "", "![difference](difference.png)"]
        return "\n".join([*lines, ""])

    def save(self, out: str | Path, *, force: bool = False) -> Path:
        """Write `FILES` into the folder `out`; `force` replaces an existing comparison there."""
        import meshio

        from .picture import draw

        content = dict(zip(("result", "reference"), self.names, strict=True))
        content |= {"version": package_version(), "format": FORMAT}
        content |= {"travel_mm": self.travel, "held": self.held}
        content |= {"notes": self.notes}
        content |= {"rows": [asdict(row) | {"held": row.held} for row in self.rows]}
        with replaced(out, force=force, names=FILES) as folder:
            text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
            (folder / "compare.json").write_text(text + "\n", encoding="utf-8")
            rows = [row.cells(".8g").values() for row in self.rows]
            write_rows(folder / "compare.csv", [COLUMNS, *rows])
            (folder / "compare.md").write_text(self.markdown(), encoding="utf-8")
            if self.field is not None:
                names, values = ("difference", *SIDES), (self.difference, *self.gamma)
                fields = {f"shear_angle_{k}": v for k, v in zip(names, values, strict=True)}
                places, triangles = self.field.places, self.field.triangles
                points = ("vertex", np.arange(len(places))[:, None])
                cells = ("triangle", triangles) if len(triangles) else points
                meshio.Mesh(places, [cells], fields).write(folder / "difference.vtu")
            drawn = (self.sheets, self.field, self.gamma, self.forces, self.locking)
            draw(folder / "difference.png", self.names, *drawn)
        return Path(out)


def compare(
    result: Result | Record | str | Path,
    reference: Result | Record | str | Path,
    *,
    standing: str = "peer",
    travel: float | None = None,
    by: str = "auto",
    within: float | None = None,
    align: str = "none",
    mirror: Sequence[str] = (),
    ply: int | None = None,
    areas: Mapping[str, tuple[tuple[float, float], float]] | None = None,
    band_angle: float | None = None,
    band_outline: float | None = None,
    band_force: float | None = None,
    **reading: object,
) -> Comparison:
    """Compare a result with another one, or with another code's or a measured field.

    Parameters
    ----------
    result : Result or path
        A result, or the folder of one.
    reference : Result or path
        The same, or a file (`read.py` lists the kinds).
    standing : str
        Of the reference: measured, exact, peer, ...
    travel : float, optional
        Where to compare, mm; the largest travel of both if not given.
    by : "auto", "flat" or "formed"
        How points are matched: by flat coordinates, else by the closest formed point.
    within : float, optional
        Points farther than this from the other sheet are not compared, mm.
    align : "none", "shift" or "rigid"
        Whether the reference is shifted, or shifted and turned about z, to fit first.
    mirror : sequence of "x" and "y"
        Planes at which the reference, a half or a quarter, is unfolded.
    ply : int, optional
        Of a stack, from the punch down; the same one of a reference that is a run of a stack.
    areas : mapping of name to (centre, radius), optional
        Discs of the flat blank over which |γ| is averaged; the result's own if not given.
    band_angle : float, optional
        Degrees within which the difference shall be on 95 % of the area, and in the means of areas.
    band_outline : float, optional
        mm within which the outlines shall be everywhere.
    band_force : float, optional
        Percent within which the force shall be: at the end, of the reference's force there; along
        the travel (root mean square), of its largest.
    **reading
        How the reference's file is to be read: `Reading`; its `travel` is `reference_travel` here.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        For wrong input, and where the two cannot be compared.
    """
    choices = (standing, STANDINGS), (by, ("auto", *WAYS)), (align, ALIGN)
    for name, (value, known) in zip(("standing", "by", "align"), choices, strict=True):
        if value not in known:
            raise InputError(f"{name} must be one of {', '.join(known)}, got {value!r}")
    if not set(mirror) <= {"x", "y"} or len(set(mirror)) < len(mirror):
        raise InputError(f"mirror must be x, y or both, got {mirror!r}")
    limits = {"within": within, "travel": travel, "band_angle": band_angle}
    limits |= {"band_outline": band_outline, "band_force": band_force}
    for name, value in limits.items():
        check_number(name, 0.0 if value is None else value, zero_allowed=True)
    if "reference_travel" in reading:
        reading["travel"] = reading.pop("reference_travel")
    check_keys(reading, Reading.__dataclass_fields__, "compare")
    how = Reading(**reading, ply=ply)
    mine = read_side(result, Reading(signed=how.signed, ply=ply))
    if (ply or 1) > 1 and not mine.ply:
        raise InputError(f"{mine.name}: no ply {ply}: it is not a stack")
    other = read_side(reference, how)
    ends = [side.end for side in (mine, other) if side.end is not None]
    goal = min(ends, default=None) if travel is None else travel
    sheet, theirs, notes = _in_place((mine, other), goal, mirror, align, how.signed)
    sheet, theirs = weighed_alike(sheet, theirs)
    warnings, rows = other_blank(sheet, theirs), Rows(standing, notes)
    field = gamma = None
    if ANGLE in sheet.point_fields and ANGLE in theirs.point_fields:
        field, gamma, share = matched(sheet, theirs, by, within, notes)
        warnings += _off_sheet(share, field is sheet, align, theirs.left_out)
        whole = share > 1 - 1e-9 and not warnings
        own, what = own_values((sheet, theirs), field, gamma, whole, notes)
        rows.angles(own, field, gamma, "γ" if how.signed else "|γ|", band_angle)
        rows.areas(own, what, mine.areas if areas is None else areas, band_angle)
    rows.slips((sheet, theirs))
    rows.outlines(sheet, theirs, band_outline)
    forces = common_forces(mine, other, goal)
    rows.forces(forces, band_force)
    rows.energies((mine, other), goal)
    if not rows.rows:
        words = "nothing in common to compare: no field of γ, outline or force"
        raise InputError(f"{other.name}: {words}")
    for key, word, what in BANDS:
        if limits[key] is not None and not any(word in row.quantity for row in rows.rows):
            raise InputError(f"{other.name}: a band for the {what}, but there is none to compare")
    names = mine.name, other.name
    if names[0] == names[1] and all(isinstance(one, str | Path) for one in (result, reference)):
        names = str(result), str(reference)
    notes = (*(f"warning: {words}" for words in warnings), *notes)
    locking = tuple(side.locking for side in (mine, other) if side.locking)
    found = (names, tuple(rows.rows), notes, goal, (sheet, theirs))
    return Comparison(*found, field, gamma, forces, locking)


def _in_place(
    sides: tuple[Side, Side], goal: float | None, mirror: Sequence[str], align: str, signed: bool
) -> tuple[FormedSheet, FormedSheet, list[str]]:
    """Both sheets at a travel, the reference in its place; what was done."""
    mine, other = sides
    notes = [f"compared at {goal or 0:.6g} mm of travel"]
    if goal is None:
        notes = ["no travel is known: the last states are compared"]
    elif unknown := [side.name for side in sides if side.end is None]:
        notes.append(f"{unknown[0]} names no travel: taken to be at {goal:.6g} mm")
    (sheet, words), (theirs, their_words) = mine.at(goal), other.at(goal)
    notes.append(f"result: {mine.ply}{words}")
    notes += [f"reference: {other.ply}{their_words}", *other.notes]
    if mirror:
        theirs = unfolded(theirs, tuple(mirror), signed)
        notes.append(f"reference unfolded at {' and '.join(f'{p} = 0' for p in mirror)}")
    if align != "none":
        theirs, words = aligned(theirs, sheet, align == "rigid")
        notes.append(f"reference {words}")
    notes += _scenes_differ(mine.scene, other.scene)
    return sheet, theirs, notes


def _scenes_differ(mine: str, other: str) -> list[str]:
    """What differs between the scenes of two runs: keys of their files, or names."""
    if not mine or not other or mine == other:
        return []
    if "\n" not in mine or "\n" not in other:  # the name alone is known of one of them
        names = [tomllib.loads(text)["name"] if "\n" in text else text for text in (mine, other)]
        words = f"two scenes: {names[0]} (result) and {names[1]} (reference)"
        return [words] if names[0] != names[1] else []
    tables = [dotted_values(tomllib.loads(text)) for text in (mine, other)]
    differ = [
        f"{key} ({tables[0].get(key, 'none')}, {tables[1].get(key, 'none')})"
        for key in sorted(tables[0].keys() | tables[1].keys())
        if tables[0].get(key) != tables[1].get(key) and not key.startswith("run.")
    ]
    more = f" and {len(differ) - MOST} more keys" if len(differ) > MOST else ""
    words = f"the scenes (result, reference) differ in {', '.join(differ[:MOST])}{more}"
    return [words] if differ else []


def _off_sheet(share: float, of_result: bool, align: str, left_out: Mapping[str, int]) -> list[str]:
    """Warn where little of the two sheets is compared."""
    tried = {"none": "shift", "shift": "rigid"}.get(align)
    remedy = f'try --align {tried} (align="{tried}"), or check' if tried else "check"
    of = "the result's area is off the reference", "the reference is off the result"
    words = (
        f"{100 * (1 - share):.0f} % of {of[not of_result]} and left out: {remedy} its place, its"
    )
    words = f"{words} unit (--scale) and how far points may be off (--within)"
    if left_out and of_result:  # the reference has a hole there, another place does not help
        words = f"{words.split(':')[0]}: of its file {counted(left_out)} were not used"
    return [words] if share < ON_SHEET else []
