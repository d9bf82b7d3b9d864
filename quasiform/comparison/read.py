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
from typing import TYPE_CHECKING

import numpy as np

from ..checks import InputError, check_number, suggestion
from ..net.blank import rotation
from ..result.record import Record, Sheets, series, sheet_files
from ..result.sheet import KINDS, FormedSheet, read_sheets, readable
from ..tables import name_of, read_table
from .mapping import ANGLE
from .shells import read_inp

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
    """How a file is read where it does not say so itself.

    Parameters
    ----------
    field : str, optional
        Name of the field or column of the angle; "none" for a mesh to be taken for its form only.
    angle : "shear" or "between"
        What it is: the shear angle γ, or the angle between the fibres, 90° - γ.
    radians : bool
        Whether it is in radians.
    signed : bool
        Keep the sign of γ; |γ| otherwise.
    orientation : float
        Angle of the warp to x, degrees, where γ is worked out from the displacements.
    values : path, optional
        CSV by node or element label that goes with an .inp file.
    coordinates : "formed" or "flat", optional
        What the coordinates of a file are.
    scale : float
        mm per unit of its lengths.
    travel : float, optional
        Travel of its last state, mm; the times of a series are taken in proportion.
    history : path, optional
        CSV of travel and force, and of kinetic and internal energy, in place of a folder's own.
    force_factor : float
        Of the forces and energies: 4 where they are those of a modelled quarter.
    """

    field: str | None = None
    angle: str = "shear"
    radians: bool = False
    signed: bool = False
    orientation: float = 0.0
    values: str | Path | None = None
    coordinates: str | None = None
    scale: float = 1.0
    travel: float | None = None
    history: str | Path | None = None
    force_factor: float = 1.0

    def __post_init__(self) -> None:
        if self.angle not in ("shear", "between"):
            raise InputError(f"angle must be 'shear' or 'between', got {self.angle!r}")
        if self.coordinates not in (None, "formed", "flat"):
            raise InputError(f"coordinates must be 'formed' or 'flat', got {self.coordinates!r}")
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
    """Sheets along the travel, with their history.

    Parameters
    ----------
    name : str
    sheets : Sheets
        By travel, mm; a single one at None where it is not known.
    history : mapping of str to (k,) arrays
        travel (mm), force (N), kinetic and internal (energies, mJ), as far as they are known.
    areas : mapping of str to (centre, radius)
        Discs of the flat blank, mm.
    notes : tuple of str
        How it was read, for the report.
    scene : str
        Scene that a run is of; empty where it is not known.
    locking : float, optional
        Shear angle at which its fabric locks, degrees.
    """

    name: str
    sheets: Sheets
    history: Mapping[str, FloatArray] = field(default_factory=dict)
    areas: Mapping[str, tuple[tuple[float, float], float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    scene: str = ""
    locking: float | None = None

    @property
    def end(self) -> float | None:
        """Travel of its last sheet, mm."""
        return self.sheets.travels[-1]

    def at(self, travel: float | None) -> tuple[FormedSheet, str]:
        """Sheet at a travel, interpolated between two on one mesh; and how it was found.

        Raises
        ------
        InputError
            If the run does not reach the travel.
        """
        if travel is None or self.end is None:
            return self.sheets[-1], "its only state"
        s = np.array(self.sheets.travels, dtype=float)
        near = int(np.abs(s - travel).argmin())
        if abs(s[near] - travel) <= SAME * max(abs(travel), 1.0):
            return self.sheets[near], f"its state at {s[near]:.6g} mm"
        if not s[0] <= travel <= s[-1]:
            own = f"has {s[0]:g} to {s[-1]:g} mm" if len(s) > 1 else f"is at {s[0]:g} mm"
            raise InputError(
                f"{self.name}: travels do not overlap: it {own}, asked for {travel:g} mm"
            )
        i = int(np.searchsorted(s, travel))
        before, after = self.sheets[i - 1], self.sheets[i]
        one_mesh = len(before.triangles) and np.array_equal(before.triangles, after.triangles)
        if not (one_mesh and len(before.places) == len(after.places)):
            return self.sheets[near], (
                f"its nearest state, at {s[near]:.6g} mm (the mesh changes on the way)"
            )
        share = (travel - s[i - 1]) / (s[i] - s[i - 1])

        def mixed(p: FloatArray, q: FloatArray) -> FloatArray:
            return (1 - share) * p + share * q

        def fields(p: Mapping[str, FloatArray], q: Mapping[str, FloatArray]) -> dict:
            return {name: mixed(p[name], q[name]) for name in p if name in q}

        sheet = replace(
            before,
            points=None if before.points is None else mixed(before.points, after.points),
            point_fields=fields(before.point_fields, after.point_fields),
            cell_fields=fields(before.cell_fields, after.cell_fields),
            travel=travel,
        )
        return sheet, f"interpolated between {s[i - 1]:.6g} and {s[i]:.6g} mm"


def read_side(source: Result | Record | str | Path, reading: Reading | None = None) -> Side:
    """Read one side of a comparison.

    Raises
    ------
    InputError
        Naming the file and its defect, or the choice to be made.
    """
    reading = reading or Reading()
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
    factor = dict.fromkeys(("force", "kinetic", "internal"), reading.force_factor)
    side = replace(side, history={k: factor.get(k, 1.0) * v for k, v in history.items()})
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
    where, parameters = record.folder or "the result", record.parameters
    return replace(
        _of_sheets(record.name, record.sheets, reading, where),
        history=_history(record.history),
        areas=record.areas,
        scene=str(parameters.get("scene_file") or parameters.get("scene", "")),
        locking=record.locking,
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

    times = states.travels if isinstance(states, Sheets) else [s.travel for s in states]
    sheets = Sheets(_travels(times, reading), load)
    return Side(name, sheets, _history(states[-1].loose), notes=notes)


def _travels(times: Sequence[float | None], reading: Reading) -> tuple[float | None, ...]:
    """Travels of states from their times, which are travels if nothing else is said."""
    if len(times) == 1 and (times[0] is None or reading.travel is not None):
        return (reading.travel,)
    if reading.travel is None:
        return tuple(times)
    if not times[-1]:
        raise InputError("the last state of the series is at time zero")
    return tuple(time * reading.travel / times[-1] for time in times)


def _understood(
    sheet: FormedSheet, reading: Reading, where: object
) -> tuple[FormedSheet, tuple[str, ...]]:
    """Sheet with its places and its shear angle, and how these were found."""
    chosen = None if reading.field == NO_FIELD else _field(sheet, reading, where)
    sheet, notes = _placed(sheet, reading, where)
    by_triangle = None
    if chosen is not None:
        kind, name = chosen
        values = reading.gamma(getattr(sheet, kind)[name])
        notes.append(f"angle from the {kind.removesuffix('_fields')} field '{name}'")
        if kind == "point_fields":
            return replace(sheet, point_fields={ANGLE: values}, cell_fields={}), tuple(notes)
        by_triangle = values
    elif reading.field != NO_FIELD and sheet.points is not None and sheet.flat is not None:
        values = sheet.sheared(rotation(reading.orientation).T)
        by_triangle = values if reading.signed else np.abs(values)
        notes.append(
            f"angle worked out from the displacements, warp at {reading.orientation:g}° to x"
        )
    if by_triangle is None:
        return replace(sheet, point_fields={}, cell_fields={}), tuple(notes)
    by_point = {ANGLE: sheet.at_nodes(by_triangle)}
    whole = {ANGLE: by_triangle} if np.isfinite(by_triangle).all() else {}
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
    if not np.isfinite(moved).all():
        lost = len(moved) - np.isfinite(moved).all(1).sum()
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
    scalars = [
        (kind, name)
        for kind in ("cell_fields", "point_fields")
        for name, values in getattr(sheet, kind).items()
        if np.ndim(values) == 1 or np.shape(values)[1:] == (1,)
    ]
    names = [name for _, name in scalars]
    present = "; ".join(
        f"{words} fields: {', '.join(fields) if fields else 'none'}"
        for words, fields in (("cell", sheet.cell_fields), ("point", sheet.point_fields))
    )
    if reading.field is not None:
        for key in scalars:
            if key[1] == reading.field or (reading.values and key[1] == "angle"):
                return key
        nearest = f": {suggestion(reading.field, names)}" if names else ""
        raise InputError(f"{where}: no field '{reading.field}'{nearest} ({present})")
    for key in scalars:
        if name_of(key[1])[0] == "angle":
            return key
    if names and not any(name.casefold() in DISPLACEMENTS for name in sheet.point_fields):
        raise InputError(
            f"{where}: no field of a shear angle known by its name: choose one with field=... "
            f"(--field), or 'none' ({present})"
        )
    return None


def _of_inp(path: Path, reading: Reading) -> FormedSheet:
    """Sheet of an .inp file, with the values by label of a CSV."""
    shells = readable(path, lambda: read_inp(path))
    triangles, rows = shells.split()
    fields: dict[str, dict[str, FloatArray]] = {"node": {}, "element": {}}
    if reading.values is not None:
        table = read_table(Path(reading.values), reading.column)
        key = next((name for name in fields if name in table), None)
        if key is None:
            raise InputError(
                f"{reading.values}: no column of node or element labels ('node', 'element')"
            )
        parts = ("u1", "u2", "u3")
        columns = {k: v for k, v in table.items() if k not in (*fields, *parts)}
        if all(part in table for part in parts):
            columns["displacement"] = np.column_stack([table[part] for part in parts])
        asked = shells.nodes if key == "node" else shells.elements[rows]
        labels = list(enumerate(table[key].astype(int).tolist()))
        place = {label: row for row, label in reversed(labels)}  # the first of those that repeat
        found = np.array([place.get(label, -1) for label in asked.tolist()])
        for name, column in columns.items():
            fields[key][name] = np.concatenate([column, np.full_like(column[:1], np.nan)])[found]
    made = (shells.points, triangles, fields["node"], fields["element"])
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
    if plan is None and flat is None:
        raise InputError(f"{path}: expected columns x and y, got {', '.join(table)}")
    if "angle" not in table or reading.field == NO_FIELD:
        if plan is None or len(plan) < 3:
            raise InputError(f"{path}: a contour needs three points x, y (and a field an angle)")
        sheet = FormedSheet(contour=np.vstack([plan, plan[:1]]) if _closes(plan) else plan)
    else:
        if flat is None and reading.coordinates == "flat":
            flat, formed = plan, None
        elif flat is None and formed is None:
            raise InputError(
                f"{path}: are x and y flat or formed coordinates? say coordinates = 'flat', or "
                "name the columns x0, y0 (flat) or x, y, z (formed)"
                if reading.coordinates is None
                else f"{path}: formed coordinates need x, y and z"
            )
        angle = {ANGLE: reading.gamma(table["angle"])}
        sheet = FormedSheet(formed, flat=flat, point_fields=angle)
    return Side(path.stem, Sheets([reading.travel], lambda _: sheet), notes=notes)


def _closes(plan: FloatArray) -> bool:
    """Whether a polyline's ends are as near to each other as its points are."""
    steps = np.linalg.norm(np.diff(plan, axis=0), axis=1)
    gap = float(np.linalg.norm(plan[-1] - plan[0]))
    return 0 < gap <= 3 * max(float(np.median(steps)), 1e-9)
