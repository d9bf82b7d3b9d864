"""One side of a comparison from a run, a folder, or another code's or a measured file.

================================  ================================================================
folder, .pvd                      a run of this program, or one that left the same files
.vtu .vtk .xdmf                   a formed mesh; with a field of the shear angle or displacements
.inp                              Abaqus mesh; `values`: CSV of angles or u1, u2, u3 by label
.csv .txt .dat with an angle      points with angles, at flat or formed coordinates
.csv .txt .dat without            a contour: the outline seen along z, x, y[, z] a row
================================  ================================================================

Every sheet gets the shear angle as its point field `shear_angle`, and where it is known by triangle
as its cell field of that name. A value by triangle is brought to the nodes as the mean of the
triangles around, weighted by area: a linear triangle sees the shear best at a place that is not its
centroid, and the mean hides where.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import InputError, check_number, suggestion
from ..meshes.inp_file import read_inp
from ..meshes.shells import Shells, counted
from ..net.blank import rotation
from ..result.record import Record, Sheets, series, sheet_files
from ..result.sheet import KINDS, FormedSheet, read_sheets, readable
from ..tables import name_of, read_table
from .mapping import ANGLE, SLIPS

if TYPE_CHECKING:
    from ..result.run import Result

FloatArray = np.ndarray
TABLES = (".csv", ".txt", ".dat")
SAME = 1e-3  # travels nearer than this share of the travel are one
FLAT = 1e-6  # of the size: a sheet thinner than this is flat
DISPLACEMENTS = {"displacement", "displacements", "u", "disp", "deplacement"}
NO_FIELD = "none"
PLACES = ("x", "y", "z", "x0", "y0")
HISTORY = ("travel", "force", "kinetic", "internal")


@dataclass(frozen=True)
class Reading:
    """How a file is read where it does not say so itself."""

    field: str | None = None  # name of that of the angle; "none": the mesh is for its form only
    angle: str = "shear"  # or "between": the angle between the fibres, 90° - γ
    radians: bool = False
    signed: bool = False  # keep the sign of γ
    orientation: float = 0.0  # of the warp to x, degrees, to find γ from displacements
    values: str | Path | None = None  # CSV by node or element label that goes with an .inp file
    coordinates: str | None = None  # what those of the file are: "formed" or "flat"
    scale: float = 1.0  # mm per unit of its lengths
    travel: float | None = None  # of its last state, mm; times of a series are in proportion
    history: str | Path | None = None  # CSV of travel, force, energies, in place of the folder's
    force_factor: float = 1.0  # of forces and energies: 4 where they are those of a quarter
    ply: int | None = None  # of a run of a stack, from the punch down

    def __post_init__(self) -> None:
        for name, known in (("angle", ("shear", "between")), ("coordinates", ("formed", "flat"))):
            value = getattr(self, name)
            if value not in (*known, Reading.__dataclass_fields__[name].default):
                one, other = known
                raise InputError(f"{name} must be '{one}' or '{other}', got {value!r}")
        check_number("scale", self.scale)
        check_number("force_factor", self.force_factor)
        if self.travel is not None:
            check_number("reference_travel", self.travel, zero_allowed=True)

    @property
    def column(self) -> str:
        """Heading of the angle in a table; empty where it is found by its usual names."""
        return "" if self.field in (None, NO_FIELD) else self.field

    def gamma(self, values: FloatArray) -> FloatArray:
        """Shear angle in degrees, with or without its sign, from the values of a file."""
        values = np.asarray(values, dtype=float).ravel()
        values = np.degrees(values) if self.radians else values
        values = 90.0 - values if self.angle == "between" else values
        return values if self.signed else np.abs(values)


@dataclass(frozen=True, eq=False)
class Side:
    """Sheets along the travel, with their history."""

    name: str
    sheets: Sheets  # by travel, mm; a single one at None where it is not known
    history: Mapping[str, FloatArray] = field(default_factory=dict)  # columns `HISTORY`
    areas: Mapping[str, tuple[tuple[float, float], float]] = field(default_factory=dict)  # discs
    notes: tuple[str, ...] = ()  # how it was read
    scene: str = ""  # of a run; empty where it is not known
    locking: float | None = None  # shear angle at which its fabric locks, degrees
    ply: str = ""  # which one of a stack it is, before the words of `at`

    @property
    def end(self) -> float | None:
        """Travel of its last sheet, mm."""
        return self.sheets.travels[-1]

    def at(self, travel: float | None) -> tuple[FormedSheet, str]:
        """Sheet at a travel, interpolated between two on one mesh; and how it was found."""
        if travel is None or self.end is None:
            return self.sheets[-1], "its only state"
        s = np.array(self.sheets.travels, dtype=float)
        near = int(np.abs(s - travel).argmin())
        if abs(s[near] - travel) <= SAME * max(abs(travel), 1.0):
            return self.sheets[near], f"its state at {s[near]:.6g} mm"
        if not s[0] <= travel <= s[-1]:
            own = f"has {s[0]:g} to {s[-1]:g} mm" if len(s) > 1 else f"is at {s[0]:g} mm"
            own = f"ends at {s[-1]:g} mm" if travel > s[-1] else own
            words = f"travels do not overlap: it {own}, asked for {travel:g} mm"
            raise InputError(f"{self.name}: {words}")
        i = int(np.searchsorted(s, travel))
        before, after = self.sheets[i - 1], self.sheets[i]
        one_mesh = len(before.triangles) and np.array_equal(before.triangles, after.triangles)
        if not (one_mesh and len(before.places) == len(after.places)):
            words = f"its nearest state, at {s[near]:.6g} mm (the mesh changes on the way)"
            return self.sheets[near], words
        share = (travel - s[i - 1]) / (s[i] - s[i - 1])

        def mixed(p: Any, q: Any) -> Any:
            """Between two arrays, or two tables of them."""
            if isinstance(p, Mapping):
                return {name: mixed(p[name], q[name]) for name in p if name in q}
            return None if p is None else (1 - share) * p + share * q

        names = ("points", "point_fields", "cell_fields")
        between = {name: mixed(getattr(before, name), getattr(after, name)) for name in names}
        words = f"interpolated between {s[i - 1]:.6g} and {s[i]:.6g} mm"
        return replace(before, **between, travel=travel), words


def read_side(source: Result | Record | str | Path, reading: Reading) -> Side:
    """Read one side; InputError names the file and its defect, or the choice to be made."""
    if not isinstance(source, str | Path):
        return _of_record(Record.of(source), reading)
    path = Path(source)
    kind = path.suffix.lower()
    if reading.values is not None and kind != ".inp":
        raise InputError(f"{path}: values by label belong to an .inp file, not to {kind or path}")
    if path.is_dir():
        side = _of_folder(path, reading)
    elif kind == ".pvd":
        side = _of_files(path.stem, series(path), reading)
    elif kind == ".inp":
        side = _of_sheets(path.stem, [_of_inp(path, reading)], reading, path)
    elif kind in KINDS:
        side = _of_sheets(path.stem, read_sheets(path), reading, path)
    elif kind in TABLES:
        side = _of_table(path, reading)
    elif not path.exists():
        raise InputError(f"{path}: no such file or folder")
    else:
        known = ", ".join(["a folder", ".pvd", *KINDS, ".inp", *TABLES])
        raise InputError(f"{path}: unknown kind of file '{kind}': expected one of {known}")
    history = side.history
    if reading.history is not None:
        history = _history(read_table(Path(reading.history)))
        if len(history) < 2:
            raise InputError(f"{reading.history}: expected columns such as travel_mm and force_N")
    factor = dict.fromkeys(HISTORY, reading.force_factor) | {"travel": 1.0}
    side = replace(side, history={k: factor[k] * v for k, v in history.items()})
    if side.end is None and "travel" in history:
        travel = float(history["travel"][-1])
        side = replace(side, sheets=Sheets([travel], side.sheets.__getitem__))
    return side


def _history(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Columns of a history that are known here, by their names here; without gaps."""
    found = {}
    for heading, column in columns.items():
        name, factor = name_of(heading)
        if name in HISTORY:
            found[name] = factor * np.atleast_1d(column)
    whole = np.isfinite(list(found.values())).all(0) if found else slice(None)
    return {name: column[whole] for name, column in found.items()}


def _of_record(record: Record, reading: Reading) -> Side:
    if reading.ply and record.summary.get("plies"):
        record = record.of_ply(reading.ply)
    where = record.folder or "the result"
    return replace(
        _of_sheets(record.name, record.sheets, reading, where),
        history=_history(record.history),
        areas=record.areas,
        scene=record.resolved,
        locking=record.locking,
        ply=record.ply_name and f"{record.ply_name}, ",
    )


def _of_folder(folder: Path, reading: Reading) -> Side:
    """Side from a run's folder, or from one of another code with the same files but no summary."""
    if (folder / "summary.json").exists():
        return _of_record(Record.read(folder), reading)
    reading = replace(reading, coordinates=reading.coordinates or "formed")
    side = _of_files(folder.resolve().name, sheet_files(folder), reading)
    history = folder / "history.csv"
    return replace(side, history=_history(read_table(history))) if history.exists() else side


def _of_files(name: str, files: list[tuple[float | None, Path]], reading: Reading) -> Side:
    states = Sheets([time for time, _ in files], lambda k: read_sheets(files[k][1])[-1])
    return _of_sheets(name, states, reading, files[-1][1])


def _of_sheets(name: str, states: Sequence[FormedSheet], reading: Reading, where: object) -> Side:
    """Side of sheets as they stand in files; refusals name `where` they are from."""
    last, notes = _understood(states[-1], reading, where)

    def load(number: int) -> FormedSheet:
        end = number == len(states) - 1
        return last if end else _understood(states[number], reading, where)[0]

    # times are travels if nothing else is said
    times = states.travels if isinstance(states, Sheets) else [s.travel for s in states]
    if reading.travel is not None and len(times) > 1:
        if not times[-1]:
            raise InputError("the last state of the series is at time zero")
        times = [time * reading.travel / times[-1] for time in times]
    elif reading.travel is not None:
        times = [reading.travel]
    return Side(name, Sheets(times, load), _history(states[-1].loose), notes=notes)


def _understood(
    sheet: FormedSheet, reading: Reading, where: object
) -> tuple[FormedSheet, tuple[str, ...]]:
    """Sheet with its places and its shear angle, and how these were found."""
    chosen = None if reading.field == NO_FIELD else _field(sheet, reading, where)
    sheet, notes = _placed(sheet, reading, where)
    notes += [f"left out of the file: {counted(sheet.left_out)}"] * bool(sheet.left_out)
    by_point, whole, values = {}, {}, None
    if chosen is not None:
        kind, name = chosen
        values = reading.gamma(getattr(sheet, kind)[name])
        notes.append(f"angle from the {kind.removesuffix('_fields')} field '{name}'")
        if kind == "point_fields":
            by_point, values = {ANGLE: values}, None
    elif reading.field != NO_FIELD and sheet.points is not None and sheet.flat is not None:
        values = sheet.sheared(rotation(reading.orientation).T)
        values = values if reading.signed else np.abs(values)
        words = "angle worked out from the displacements, warp at"
        notes.append(f"{words} {reading.orientation:g}° to x")
    if values is not None:  # by triangle
        by_point = {ANGLE: sheet.at_nodes(values)}
        whole = {ANGLE: values} if np.isfinite(values).all() else {}
    slid = {k: np.ravel(v) for k, v in sheet.point_fields.items() if k in SLIPS.values()}
    by_point |= {name: reading.scale * np.abs(values) for name, values in slid.items()}
    return replace(sheet, point_fields=by_point, cell_fields=whole), tuple(notes)


def _placed(sheet: FormedSheet, reading: Reading, where: object) -> tuple[FormedSheet, list[str]]:
    """Sheet with formed and flat positions from those in the file and the displacements; notes."""
    points = reading.scale * sheet.points
    flat = None if sheet.flat is None else reading.scale * sheet.flat
    name = next((n for n in sheet.point_fields if n.casefold() in DISPLACEMENTS), None)
    if flat is not None or name is None:
        if flat is None and reading.coordinates == "flat":
            points, flat = None, points[:, :2]
        return replace(sheet, points=points, flat=flat), []
    moved = reading.scale * np.asarray(sheet.point_fields[name], dtype=float)
    moved = np.pad(moved.reshape(len(points), -1), ((0, 0), (0, 3)))[:, :3]
    if lost := (~np.isfinite(moved).all(1)).sum():
        raise InputError(f"{where}: {lost} nodes have no displacement")
    given, notes = reading.coordinates, []
    if given is None:
        size = np.ptp(points, axis=0).max()
        bent = np.ptp(points[:, 2]), np.ptp((points - moved)[:, 2])
        given = "flat" if bent[0] < FLAT * size < bent[1] else "formed"
        notes.append(f"its points are taken as the {given} ones")
    fields = {**sheet.point_fields, "displacement": moved}
    points = points + moved if given == "flat" else points
    sheet = replace(sheet, points=points, point_fields=fields)
    try:
        return sheet.with_flat(), notes
    except InputError:
        return sheet, [*notes, "its undeformed sheet is not flat, so it has no flat coordinates"]


def _field(sheet: FormedSheet, reading: Reading, where: object) -> tuple[str, str] | None:
    """Where the angle is: ("point_fields" or "cell_fields", name); None to work it out."""
    both = {"cell": sheet.cell_fields, "point": sheet.point_fields}
    scalars = [
        (f"{kind}_fields", name)
        for kind, fields in both.items()
        for name, values in fields.items()
        if np.ndim(values) == 1 or np.shape(values)[1:] == (1,)
    ]
    names = [name for _, name in scalars]
    present = "; ".join(f"{k} fields: {', '.join(fields) or 'none'}" for k, fields in both.items())
    for key in scalars:
        named = key[1] == reading.field or (reading.values and key[1] == "angle")
        if named if reading.field is not None else name_of(key[1])[0] == "angle":
            return key
    if reading.field is not None:
        nearest = f": {suggestion(reading.field, names)}" if names else ""
        raise InputError(f"{where}: no field '{reading.field}'{nearest} ({present})")
    if names and not any(name.casefold() in DISPLACEMENTS for name in sheet.point_fields):
        raise InputError(
            f"{where}: no field of a shear angle known by its name: choose one with field=... "
            f"(--field), or 'none' ({present})"
        )
    return None


def _of_inp(path: Path, reading: Reading) -> FormedSheet:
    """Sheet of an .inp file, with the values by label of a CSV."""
    shells = readable(path, lambda: Shells(**read_inp(path)))
    triangles, rows = shells.split()
    fields: dict[str, dict[str, FloatArray]] = {"node": {}, "element": {}}
    if reading.values is not None:
        table = read_table(Path(reading.values), reading.column)
        key = next((name for name in fields if name in table), None)
        if key is None:
            words = "no column of node or element labels ('node', 'element')"
            raise InputError(f"{reading.values}: {words}")
        labels, first = np.unique(table.pop(key).astype(int), return_index=True)
        parts = [table.pop(name, None) for name in ("u1", "u2", "u3")]
        if all(part is not None for part in parts):
            table["displacement"] = np.column_stack(parts)
        asked = shells.nodes if key == "node" else shells.elements[rows]
        at = np.searchsorted(labels, asked).clip(max=len(labels) - 1)
        for name, column in table.items():
            known = (labels[at] == asked).reshape(-1, *[1] * (column.ndim - 1))
            fields[key][name] = np.where(known, column[first[at]], np.nan)
    made = (shells.points, triangles, fields["node"], fields["element"], shells.left_out)
    return readable(path, lambda: FormedSheet.of_surface(*made))


def _of_table(path: Path, reading: Reading) -> Side:
    table = read_table(path, reading.column)
    left = table.left_out
    notes = (f"rows without a number, left out: {left}",) if left else ()
    if "loop" in table:  # the outer outline; holes follow it
        first = table["loop"] == table["loop"][0]
        table = {name: column[first] for name, column in table.items()}
    places = [column for name, column in table.items() if name in PLACES]
    known = np.isfinite(places).all(0) if places else slice(None)
    table = {name: column[known] for name, column in table.items()}

    def columns(*names: str) -> FloatArray | None:
        if not all(name in table for name in names):
            return None
        return reading.scale * np.column_stack([table[name] for name in names])

    plan, formed, flat = columns("x", "y"), columns("x", "y", "z"), columns("x0", "y0")
    contour = "angle" not in table or reading.field == NO_FIELD
    if plan is None and flat is None:
        raise InputError(f"{path}: expected columns x and y, got {', '.join(table)}")
    if contour and (plan is None or len(plan) < 3):
        raise InputError(f"{path}: a contour needs three points x, y (and a field an angle)")
    if flat is None and reading.coordinates == "flat":
        flat, formed = plan, None
    if not contour and flat is None and formed is None:
        words = (
            "are x and y flat or formed coordinates? say coordinates = 'flat', or name the columns "
            "x0, y0 (flat) or x, y, z (formed)",
            "formed coordinates need x, y and z",
        )
        raise InputError(f"{path}: {words[reading.coordinates is not None]}")
    if contour:
        sheet = FormedSheet(contour=np.vstack([plan, plan[:1]]) if _closes(plan) else plan)
    else:
        angle = {ANGLE: reading.gamma(table["angle"])}
        sheet = FormedSheet(formed, flat=flat, point_fields=angle)
    return Side(path.stem, Sheets([reading.travel], lambda _: sheet), notes=notes)


def _closes(plan: FloatArray) -> bool:
    """Whether a polyline's ends are as near to each other as its points are."""
    steps = np.linalg.norm(np.diff(plan, axis=0), axis=1)
    gap = float(np.linalg.norm(plan[-1] - plan[0]))
    return 0 < gap <= 3 * max(float(np.median(steps)), 1e-9)
