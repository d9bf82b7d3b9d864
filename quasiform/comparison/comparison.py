"""What two sheets differ in at equal travel: shear angle, outline, force, areas.

The difference is result minus reference. Where the reference has triangles it lives at the result's
nodes, weighted by the area they stand for; where it is points only, at these, all alike. What each
sheet has of its own (mean, percentile, maximum, means over areas) is of its triangles, as in
summary.json, where both are known by triangle and compared whole; else of what is compared.
Outlines are compared seen along z, at points a millimetre apart on both: their mean distance from
the other one, and the largest (Hausdorff's). Forces are compared over the common travel, on the
travels of both histories.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import meshio
import numpy as np
import shapely
from scipy.integrate import trapezoid

from ..checks import InputError, check_keys, check_number
from ..result.files import replaced
from ..result.measures import percentile
from ..result.run import Result
from ..result.summary import package_version
from .mapping import WAYS, carried, on_surface, way
from .place import aligned, unfolded
from .read import Reading, read_run
from .sheet import SAME, Run, Sheet

FloatArray = np.ndarray
FILES = ("compare.json", "compare.csv", "difference.vtu", "difference.png", "compare.md")
STANDINGS = ("measured", "stated", "exact", "peer", "prototype", "inferred", "assumed", "own")
ALIGN = ("none", "shift", "rigid")
STEP = 1.0  # mm between the points of an outline
ON_SHEET = 0.9  # of the reference: with less of it on the result they are hardly in one place
SAME_BLANK = 0.02  # of their area: flat blanks that differ by more are two
FEW = 10  # points in an area: with fewer their mean says little
EARLY = 0.05  # of the largest internal energy: before, its ratio to the kinetic one says nothing


@dataclass(frozen=True)
class Row:
    """One quantity of both.

    Parameters
    ----------
    quantity, unit, standing : str
        The standing is the reference's.
    result, reference : float or None
    difference : float
        Result minus reference, or their distance where neither has a value of its own.
    band : float, optional
        What |difference| may be.
    over : str
        How many triangles or points of result and reference a mean over an area is of.
    """

    quantity: str
    unit: str
    result: float | None
    reference: float | None
    difference: float | None
    standing: str
    band: float | None = None
    over: str = ""

    @property
    def held(self) -> bool | None:
        """Whether the band is held; None without one."""
        if self.band is None or self.difference is None:
            return None
        return bool(abs(self.difference) <= self.band)


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
    sheets : (Sheet, Sheet)
        As they were compared, the reference in its place.
    field : Sheet or None
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
    sheets: tuple[Sheet, Sheet]
    field: Sheet | None = None
    gamma: FloatArray | None = None
    forces: FloatArray | None = None
    locking: tuple[float, ...] = ()

    @property
    def held(self) -> bool:
        """Whether every band was held; true without bands."""
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
        lines = [f"{'':<{width}}{'result':>12}{'reference':>12}{'difference':>12}"]
        for row in self.rows:
            cells = "".join(
                f"{'' if v is None else format(v, '.4g'):>12}"
                for v in (row.result, row.reference, row.difference)
            )
            band = "" if row.band is None else f"  {_verdict(row)} (band {row.band:g})"
            over = f"  {row.over}" if row.over else ""
            lines.append(f"{row.quantity:<{width}}{cells} {row.unit:<4}{over}{band}".rstrip())
        return "\n".join(lines)

    def save(self, out: str | Path, *, force: bool = False) -> Path:
        """Write compare.json, compare.csv, compare.md, difference.vtu and difference.png.

        Parameters
        ----------
        out : path
            Folder; made if missing.
        force : bool
            Replace an existing comparison.

        Raises
        ------
        InputError
            If the folder holds a comparison already and `force` is not set, or cannot be written.
        """
        from .picture import draw

        with replaced(out, force=force, names=FILES) as folder:
            content = {
                "result": self.names[0],
                "reference": self.names[1],
                "version": package_version(),
                "travel_mm": self.travel,
                "held": self.held,
                "notes": self.notes,
                "rows": [asdict(row) | {"held": row.held} for row in self.rows],
            }
            text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
            (folder / "compare.json").write_text(text + "\n", encoding="utf-8")
            with (folder / "compare.csv").open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                names = ("quantity", "result", "reference", "difference", "unit", "standing")
                writer.writerow([*names, "band", "held", "over"])
                for row in self.rows:
                    values = (row.result, row.reference, row.difference)
                    numbers = ["" if v is None else f"{v:.8g}" for v in values]
                    band = ["", ""] if row.held is None else [f"{row.band:g}", _verdict(row)]
                    writer.writerow(
                        [row.quantity, *numbers, row.unit, row.standing, *band, row.over]
                    )
            (folder / "compare.md").write_text(self.markdown(), encoding="utf-8")
            if self.field is not None:
                self._mesh().write(folder / "difference.vtu")
            draw(self, folder / "difference.png")
        return Path(out)

    def markdown(self) -> str:
        """Return the comparison as Markdown."""
        lines = [
            f"# {self.names[0]} beside {self.names[1]}",
            "",
            "| quantity | result | reference | difference | unit | standing | band | over |",
            "|-|-|-|-|-|-|-|-|",
        ]
        for row in self.rows:
            values = (row.result, row.reference, row.difference)
            cells = ["" if v is None else f"{v:.4g}" for v in values]
            band = "" if row.held is None else f"{row.band:g}: {_verdict(row)}"
            words = [
                row.quantity.replace("|", r"\|"),
                *cells,
                row.unit,
                row.standing,
                band,
                row.over,
            ]
            lines.append(f"| {' | '.join(words)} |")
        picture = ["", "![difference](difference.png)"]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes), *picture, ""])

    def _mesh(self) -> meshio.Mesh:
        sheet = self.field
        if sheet.triangles is None:
            cells = [("vertex", np.arange(len(sheet.places))[:, None])]
        else:
            cells = [("triangle", sheet.triangles)]
        result, reference = self.gamma
        fields = {
            "shear_angle_difference": result - reference,
            "shear_angle_result": result,
            "shear_angle_reference": reference,
        }
        return meshio.Mesh(sheet.places, cells, point_data=fields)


def _verdict(row: Row) -> str:
    return "held" if row.held else "MISSED"


def compare(
    result: Result | str | Path,
    reference: Result | str | Path,
    *,
    standing: str = "peer",
    travel: float | None = None,
    by: str = "auto",
    within: float | None = None,
    align: str = "none",
    mirror: Sequence[str] = (),
    areas: dict[str, tuple[tuple[float, float], float]] | None = None,
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
    _check(standing, by, align, mirror, within, travel, (band_angle, band_outline, band_force))
    if "reference_travel" in reading:
        reading["travel"] = reading.pop("reference_travel")
    check_keys(reading, Reading.__dataclass_fields__, "compare")
    how = Reading(**reading)
    mine = read_run(result, Reading(signed=how.signed))
    other = read_run(reference, how)
    goal, notes = _common_travel(mine, other, travel)
    sheet, words = mine.at(goal)
    theirs, their_words = other.at(goal)
    notes += [f"result: {words}", f"reference: {their_words}", *other.notes]
    if mirror:
        theirs = unfolded(theirs, tuple(mirror), how.signed)
        notes.append(f"reference unfolded at {' and '.join(f'{p} = 0' for p in mirror)}")
    if align != "none":
        theirs, words = aligned(theirs, sheet, align == "rigid")
        notes.append(f"reference {words}")
    warnings = _other_blank(sheet, theirs)
    if mine.scene and other.scene and mine.scene != other.scene:
        notes.append(f"two scenes: {mine.scene} (result) and {other.scene} (reference)")
    rows: list[Row] = []
    field = gamma = None
    if sheet.gamma is not None and theirs.gamma is not None:
        matched = way(by, sheet, theirs)
        field, gamma, share = _fields(sheet, theirs, matched, within)
        whose = ("result", "the area") if field is sheet else ("reference", "them")
        notes.append(
            f"matched {WAYS[matched]}, at the {whose[0]}'s points; {100 * share:.1f} % of "
            f"{whose[1]} compared"
        )
        if share < ON_SHEET:
            warnings.append(_off_sheet(share, field is sheet, align))
        whole = share > 1 - 1e-9 and not warnings
        whole &= sheet.by_triangle is not None and theirs.by_triangle is not None
        own = [sheet.own(), theirs.own()] if whole else _compared(field, gamma)
        notes.append(
            "differences at points, where a sheet of triangles has the mean of those around; "
            "means, percentile, maxima and areas "
            + (
                "of each sheet's own triangles, as in summary.json (there of |γ| at the end)"
                if whole
                else "at the points compared alone: not those of summary.json"
            )
        )
        rows += _angle_rows(own, field, gamma, how.signed, standing, band_angle)
        named = mine.areas if areas is None else areas
        rows += _area_rows(
            own, named, standing, band_angle, notes, "triangle" if whole else "point"
        )
    rows += _outline_rows(sheet, theirs, standing, band_outline)
    forces = _common_forces(mine, other, goal)
    if forces is not None:
        rows += _force_rows(forces, standing, band_force)
    for name, run in (("result", mine), ("reference", other)):
        rows += _energy_rows(name, run, goal, standing)
    if not rows:
        raise InputError(
            f"{other.name}: nothing in common to compare: no field of γ, outline or force"
        )
    for asked, missing, what in (
        (band_angle, gamma is None, "shear angle"),
        (band_outline, not any("outline" in row.quantity for row in rows), "outline"),
        (band_force, forces is None, "force"),
    ):
        if asked is not None and missing:
            raise InputError(f"{other.name}: a band for the {what}, but there is none to compare")
    names = mine.name, other.name
    if (
        names[0] == names[1]
        and not isinstance(result, Result)
        and not isinstance(reference, Result)
    ):
        names = str(result), str(reference)
    notes = [*(f"warning: {words}" for words in warnings), *notes]
    locking = tuple(run.locking for run in (mine, other) if run.locking)
    both = (sheet, theirs)
    return Comparison(names, tuple(rows), tuple(notes), goal, both, field, gamma, forces, locking)


def _check(
    standing: str,
    by: str,
    align: str,
    mirror: Sequence[str],
    within: float | None,
    travel: float | None,
    bands: Sequence[float | None],
) -> None:
    for name, value, known in (
        ("standing", standing, STANDINGS),
        ("by", by, ("auto", *WAYS)),
        ("align", align, ALIGN),
    ):
        if value not in known:
            raise InputError(f"{name} must be one of {', '.join(known)}, got {value!r}")
    if not set(mirror) <= {"x", "y"} or len(set(mirror)) < len(mirror):
        raise InputError(f"mirror must be x, y or both, got {mirror!r}")
    names = ("band_angle", "band_outline", "band_force")
    given = {"within": within, "travel": travel, **dict(zip(names, bands, strict=True))}
    for name, value in given.items():
        if value is not None:
            check_number(name, value, zero_allowed=True)


def _common_travel(mine: Run, other: Run, travel: float | None) -> tuple[float | None, list[str]]:
    """Travel at which both are compared, and a note on where it is from.

    Raises
    ------
    InputError
        Where a run is not known at that travel.
    """
    ends = [run.travels[-1] for run in (mine, other)]
    if travel is None:
        known = [end for end in ends if end is not None]
        travel = min(known) if known else None
    if travel is None:
        return None, ["no travel is known: the last states are compared"]
    notes = [f"compared at {travel:.6g} mm of travel"]
    for run, end in zip((mine, other), ends, strict=True):
        if end is None:
            notes.append(f"{run.name} names no travel: taken to be at {travel:.6g} mm")
            continue
        if end < travel - SAME * max(abs(travel), 1.0):
            raise InputError(
                f"{run.name}: travels do not overlap: it ends at {end:g} mm, asked for {travel:g}"
            )
    return travel, notes


def _fields(
    sheet: Sheet, theirs: Sheet, by: str, within: float | None
) -> tuple[Sheet, FloatArray, float]:
    """Where the difference lives, both shear angles there, and the share that is compared."""
    if theirs.triangles is not None:
        field, gamma = sheet, np.stack([sheet.gamma, carried(theirs, sheet, by, within)[0]])
    else:
        field, gamma = theirs, np.stack([carried(sheet, theirs, by, within)[0], theirs.gamma])
        if field.flat is None and sheet.flat is not None:  # for the means over areas
            field = replace(field, flat=on_surface(sheet.flat, sheet, field.points)[0])
    compared = np.isfinite(gamma).all(0)
    if not compared.any():
        raise InputError(
            "no point of the reference lies on the result: is it in the same place and unit? "
            "(align, scale)"
        )
    weights = field.weights
    gamma = np.where(compared, gamma, np.nan)
    return field, gamma, float(weights[compared].sum() / weights.sum())


def _other_blank(sheet: Sheet, theirs: Sheet) -> list[str]:
    """Warn where the flat sheets do not cover the same."""
    blanks = sheet.blank, theirs.blank
    if None in blanks:
        return []
    share = blanks[0].symmetric_difference(blanks[1]).area / blanks[0].union(blanks[1]).area
    if share <= SAME_BLANK:
        return []
    sizes = []
    for blank in blanks:
        x0, y0, x1, y1 = blank.bounds
        sizes.append(f"{x1 - x0:.4g} x {y1 - y0:.4g} mm around ({(x0 + x1) / 2 + 0.0:.3g}, ")
        sizes[-1] += f"{(y0 + y1) / 2 + 0.0:.3g})"
    return [
        f"the flat blanks differ on {100 * share:.0f} % of what they cover (result {sizes[0]}, "
        f"reference {sizes[1]}): another part, another place (--align), a part of it (--mirror) or "
        "another unit (--scale)?"
    ]


def _off_sheet(share: float, of_result: bool, align: str) -> str:
    """Warn that little of the two sheets is compared."""
    tried = {"none": "shift", "shift": "rigid"}.get(align)
    remedy = f'try --align {tried} (align="{tried}"), or check' if tried else "check"
    of = (
        "the result's area is off the reference" if of_result else "the reference is off the result"
    )
    return (
        f"{100 * (1 - share):.0f} % of {of} and left out: {remedy} its place, its unit (--scale) "
        "and how far points may be off (--within)"
    )


def _compared(field: Sheet, gamma: FloatArray) -> list[tuple[FloatArray, ...]]:
    """Shear angles, areas and flat places of both at the points that are compared."""
    compared = np.isfinite(gamma[0])
    flat = None if field.flat is None else field.flat[compared]
    return [(values[compared], field.weights[compared], flat) for values in gamma]


def _angle_rows(
    own: list[tuple[FloatArray, ...]],
    field: Sheet,
    gamma: FloatArray,
    signed: bool,
    standing: str,
    band: float | None,
) -> list[Row]:
    compared = np.isfinite(gamma[0])
    (mine, theirs), w = gamma[:, compared], field.weights[compared]
    word = "γ" if signed else "|γ|"
    off = mine - theirs
    far = np.abs(off)

    def mean(values: FloatArray, w: FloatArray = w) -> float:
        return float(w @ values / w.sum())

    def of_both(name: str, a: float, b: float) -> Row:
        return Row(f"{name} of {word}", "deg", a, b, a - b, standing)

    p95 = percentile(far, w, 0.95)
    words = f"difference of {word}"
    return [
        of_both("mean", *(mean(v, areas) for v, areas, _ in own)),
        of_both("99th percentile", *(percentile(v, areas, 0.99) for v, areas, _ in own)),
        of_both("maximum", *(float(v.max()) for v, *_ in own)),
        Row(f"{words}, mean", "deg", None, None, mean(off), standing),
        Row(f"{words}, mean absolute", "deg", None, None, mean(far), standing),
        Row(f"{words}, root mean square", "deg", None, None, mean(off**2) ** 0.5, standing),
        Row(f"{words}, 95th percentile", "deg", None, None, p95, standing, band),
        Row(f"{words}, largest", "deg", None, None, float(far.max()), standing),
    ]


def _area_rows(
    own: list[tuple[FloatArray, ...]],
    areas: dict[str, tuple[tuple[float, float], float]],
    standing: str,
    band: float | None,
    notes: list[str],
    what: str,
) -> list[Row]:
    if any(flat is None for *_, flat in own):
        if areas:
            notes.append("no means over areas: flat coordinates are not known there")
        return []
    rows, few = [], []
    for name, (centre, radius) in areas.items():
        means, counts = [], []
        for values, weights, flat in own:
            inside = np.linalg.norm(flat - np.asarray(centre), axis=1) <= radius
            counts.append(int(inside.sum()))
            if inside.any():
                w = weights[inside]
                means.append(float(w @ np.abs(values[inside]) / w.sum()))
        if not min(counts):
            notes.append(f"area {name}: no {what} of both lies in it")
            continue
        a, b = means
        over = " and ".join(map(str, dict.fromkeys(counts))) + f" {what}" + "s" * (max(counts) > 1)
        rows.append(Row(f"mean |γ| in area {name}", "deg", a, b, a - b, standing, band, over))
        if min(counts) < FEW:
            few.append(f"{name} ({over})")
    if few:
        notes.append(f"means of few say little of an area: {', '.join(few)}")
    return rows


def _outline_rows(sheet: Sheet, theirs: Sheet, standing: str, band: float | None) -> list[Row]:
    mine, other = sheet.outline, theirs.outline
    if mine is None or other is None:
        return []
    ways = [(other, mine)]
    if other.is_closed:  # else a part of the outline was measured
        ways.append((mine, other))
    found, largest = [], 0.0
    for one, goal in ways:
        along = shapely.line_interpolate_point(one, np.arange(0.0, one.length, STEP))
        found.append(shapely.distance(along, goal))
        corners = shapely.points(shapely.get_coordinates(one))
        largest = max(largest, found[-1].max(), shapely.distance(corners, goal).max())
    mean = float(np.mean(np.concatenate(found)))
    rows = [
        Row("distance of the outlines, mean", "mm", None, None, mean, standing),
        Row("distance of the outlines, largest", "mm", None, None, float(largest), standing, band),
    ]
    if mine.is_closed and other.is_closed:
        a, b = (1e-2 * shapely.Polygon(line).area for line in (mine, other))
        rows.append(Row("area within the outline", "cm²", a, b, a - b, standing))
    return rows


def _common_forces(mine: Run, other: Run, travel: float | None) -> FloatArray | None:
    """(3, k) common travels and the forces of both there; one column where it is one number."""
    if not all({"travel", "force"} <= set(run.history) for run in (mine, other)):
        return None
    curves = []
    for run in (mine, other):
        order = np.argsort(run.history["travel"], kind="stable")
        curves.append(np.stack([run.history[name][order] for name in ("travel", "force")]))
    low = max(curve[0, 0] for curve in curves)
    high = min(curve[0, -1] for curve in curves)
    slack = SAME * max(abs(high), 1.0)
    if travel is not None:
        high = min(high, travel)
    if low > high + slack:
        raise InputError(
            f"travels do not overlap: the force of {mine.name} is known from {curves[0][0, 0]:g} "
            f"to {curves[0][0, -1]:g} mm, that of {other.name} from {curves[1][0, 0]:g} to "
            f"{curves[1][0, -1]:g} mm"
        )
    s = np.concatenate([curve[0] for curve in curves])
    s = np.unique(np.concatenate([s[(s >= low) & (s <= high)], [high]]))
    return np.stack([s, *(np.interp(s, *curve) for curve in curves)])


def _force_rows(forces: FloatArray, standing: str, band: float | None) -> list[Row]:
    s, mine, theirs = forces
    a, b = float(mine[-1]), float(theirs[-1])
    rows = [Row(f"force at {s[-1]:.6g} mm", "N", a, b, a - b, standing)]
    if b:
        percent = 100 * (a / b - 1)
        rows.append(Row("force at the end, relative", "%", None, None, percent, standing, band))
    largest = float(np.abs(theirs).max())
    if len(s) > 1 and largest:
        mean_square = trapezoid((mine - theirs) ** 2, s) / (s[-1] - s[0])
        percent = float(100 * np.sqrt(mean_square) / largest)
        words = "force along the travel, root mean square of the largest"
        rows.append(Row(words, "%", None, None, percent, standing, band))
    return rows


def _energy_rows(name: str, run: Run, travel: float | None, standing: str) -> list[Row]:
    """Ratio of kinetic to internal energy of an explicit run, at the end and at its largest."""
    if not {"kinetic", "internal"} <= set(run.history):
        return []
    kinetic, internal = run.history["kinetic"], run.history["internal"]
    known = internal > EARLY * internal.max()
    if travel is not None and "travel" in run.history:
        known &= run.history["travel"] <= travel * (1 + SAME)
    if not known.any():
        return []
    ratio = 100 * kinetic[known] / internal[known]
    rows = []
    for words, value in (("at the end", ratio[-1]), ("at most", ratio.max())):
        both = {name: float(value)}
        quantity = f"kinetic by internal energy of the {name}, {words}"
        rows.append(Row(quantity, "%", both.get("result"), both.get("reference"), None, standing))
    return rows
