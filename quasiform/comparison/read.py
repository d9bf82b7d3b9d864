"""A run from a `Result`, a folder, or another code's or a measured file.

================================  ================================================================
folder, .pvd                      a run of this program, or one that left the same files
.vtu .vtk .xdmf                   a formed mesh; with a field of the shear angle or displacements
.inp                              Abaqus mesh; `values`: CSV of angles or u1, u2, u3 by label
.csv .txt .dat with an angle      points with angles, at flat or formed coordinates
.csv .txt .dat without            a contour: the outline seen along z, x, y[, z] a row
================================  ================================================================
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError, check_number, suggestion
from ..result.run import Result
from ..scenes import scene_file
from ..tables import name_of, read_table
from .mesh_file import READERS, Fields, read_fields
from .sheet import Run, Sheet, at_nodes, sheared

FloatArray = np.ndarray
TABLES = (".csv", ".txt", ".dat")
FLAT = 1e-6  # of the size: a sheet thinner than this is flat
DISPLACEMENTS = {"displacement", "displacements", "u", "disp", "deplacement"}
NO_FIELD = "none"
PLACES = ("x", "y", "z", "x0", "y0")
HISTORY = ("travel", "force", "kinetic", "internal")


@dataclass(frozen=True)
class Reading:
    """How a file is to be read where it does not tell by itself.

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

    def gamma(self, values: FloatArray) -> FloatArray:
        """Shear angle in degrees, with or without its sign, from the values of a file."""
        values = np.degrees(values) if self.radians else values
        values = 90.0 - values if self.angle == "between" else values
        return values if self.signed else np.abs(values)


def read_run(source: Result | str | Path, reading: Reading | None = None) -> Run:
    """Read a run.

    Raises
    ------
    InputError
        Naming the file and its defect, or the choice to be made.
    """
    reading = reading or Reading()
    if isinstance(source, Result):
        return _of_result(source, reading)
    path = Path(source)
    kind = path.suffix.lower()
    if path.is_dir():
        run = _of_folder(path, reading)
    elif kind == ".pvd":
        run = _of_series(path, reading)
    elif kind in READERS or kind == ".inp":
        values = None if reading.values is None else Path(reading.values)
        named = "" if reading.field in (None, NO_FIELD) else reading.field
        run = _of_fields(path, read_fields(path, values, named if values else ""), reading)
    elif kind in TABLES:
        run = _of_table(path, reading)
    elif not path.exists():
        raise InputError(f"{path}: no such file or folder")
    else:
        known = ", ".join(["a folder", ".pvd", *READERS, ".inp", *TABLES])
        raise InputError(f"{path}: unknown kind of file '{kind}': expected one of {known}")
    if reading.history is not None:
        run = replace(run, history=_history(Path(reading.history), True))
    if run.travels == (None,) and "travel" in run.history:
        run = replace(run, travels=(float(run.history["travel"][-1]),))
    factor = dict.fromkeys(("force", "kinetic", "internal"), reading.force_factor)
    scaled = {name: factor.get(name, 1.0) * column for name, column in run.history.items()}
    return replace(run, history=scaled)


def _of_result(result: Result, reading: Reading) -> Run:
    followed = result.followed

    def state(number: int) -> Sheet:
        run, i = followed[number]
        gamma = reading.gamma(run.shear_angles(i))
        x, blank = run.positions(i), run.blank
        values = at_nodes(gamma, np.pad(blank.nodes, ((0, 0), (0, 1))), blank.triangles)
        return Sheet(x, blank.nodes, blank.triangles, values, by_triangle=gamma)

    history, parameters = result.history, result.scene.parameters
    return Run(
        result.scene.name,
        tuple(run.states[i].travel for run, i in followed),
        state,
        {"travel": history[result.scene.travel_name], "force": history["force_N"]},
        dict(result.scene.areas),
        scene=str(parameters.get("scene_file") or parameters.get("scene", "")),
        locking=locking_angle(parameters),
    )


def _of_folder(folder: Path, reading: Reading) -> Run:
    series, single = folder / "result.pvd", folder / "result.vtu"
    reading = replace(reading, coordinates=reading.coordinates or "formed")
    if series.exists() and b"<DataSet" in series.read_bytes():
        run = _of_series(series, reading)
    elif single.exists():
        run = _of_fields(single, read_fields(single), reading)
    else:
        raise InputError(f"{folder}: no result: neither result.pvd with its increments nor .vtu")
    history = folder / "history.csv"
    name = folder.resolve().name
    run = replace(run, name=name, history=_history(history) if history.exists() else {})
    summary = folder / "summary.json"
    if summary.exists():
        try:
            content = json.loads(summary.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"{summary}: not readable: {error}") from error
        parameters = content.get("parameters")
        parameters = parameters if isinstance(parameters, dict) else {}
        run = replace(
            run,
            areas=_areas(parameters, folder),
            scene=str(parameters.get("scene_file") or parameters.get("scene", "")),
            locking=locking_angle(parameters),
        )
        if run.travels == (None,) and isinstance(content.get("reached_mm"), int | float):
            run = replace(run, travels=(float(content["reached_mm"]),))
    return run


def _areas(
    parameters: dict[str, Any], folder: Path
) -> dict[str, tuple[tuple[float, float], float]]:
    """Named areas of the scene that a result is of; none where it is not known or turned."""
    if not isinstance(parameters.get("scene"), str) or parameters.get("turn"):
        return {}
    with suppress(InputError):
        return dict(scene_file.load(scene_of(parameters, folder)).areas)
    return {}


def scene_of(parameters: dict[str, Any], folder: Path) -> str:
    """Name or file of the scene that a result is of, wherever the working folder is.

    A file is looked for where it was when the run was made, then where it was named from: beside
    the result's folder and in it (they may have moved together), and from here.

    Parameters
    ----------
    parameters : dict
        Of the run's summary.
    folder : path
        The result's.

    Raises
    ------
    InputError
        If it is in none of these places.
    """
    given = str(parameters.get("scene"))
    if not given.endswith(".toml"):
        return given
    recorded = parameters.get("scene_file")
    places = [Path(recorded)] if isinstance(recorded, str) else []
    places += [folder.resolve().parent / given, folder / given, Path(given)]
    for path in places:
        if path.is_file():
            return str(path)
    looked = ", ".join(dict.fromkeys(str(path.parent) for path in places))
    raise InputError(f"{folder}: its scene {given} is in none of {looked}")


def locking_angle(parameters: dict[str, Any]) -> float | None:
    """Shear angle at which the fabric of a run locks, degrees; None for a law without locking."""
    fabric = parameters.get("fabric")
    shear = (fabric.get("shear") if isinstance(fabric, dict) else None) or {}
    onset = shear.get("I_lo")
    locks = onset is not None and shear.get("C_lo") and 0 < onset < 1
    return float(np.degrees(np.arcsin(onset))) if locks else None


def series(path: Path) -> list[tuple[float, Path]]:
    """Times (travels) and files that a .pvd file names, in their order.

    Raises
    ------
    InputError
        If it is not readable, or names no file.
    """
    try:
        found = [
            (float(entry.get("timestep", "nan")), path.parent / entry.get("file", ""))
            for entry in ET.parse(path).iter("DataSet")
        ]
    except (OSError, ET.ParseError, ValueError) as error:
        raise InputError(f"{path}: not a readable .pvd file: {error}") from error
    if not found:
        raise InputError(f"{path}: it names no file")
    return sorted(found, key=lambda entry: entry[0])


def _of_series(path: Path, reading: Reading) -> Run:
    found = series(path)

    def state(number: int) -> Sheet:
        return _sheet(found[number][1], read_fields(found[number][1])[-1], reading)[0]

    notes = _sheet(found[-1][1], read_fields(found[-1][1])[-1], reading)[1]
    return Run(path.stem, _travels([time for time, _ in found], reading), state, notes=notes)


def _travels(times: list[float | None], reading: Reading) -> tuple[float | None, ...]:
    """Travels of states from their times, which are travels if nothing else is said."""
    if len(times) == 1 and (times[0] is None or reading.travel is not None):
        return (reading.travel,)
    if reading.travel is None:
        return tuple(times)
    if not times[-1]:
        raise InputError("the last state of the series is at time zero")
    return tuple(time * reading.travel / times[-1] for time in times)


def _of_fields(path: Path, states: list[Fields], reading: Reading) -> Run:
    last, notes = _sheet(path, states[-1], reading)

    def state(number: int) -> Sheet:
        return last if number == len(states) - 1 else _sheet(path, states[number], reading)[0]

    history = {}
    for heading, value in states[-1].loose.items():
        name, factor = name_of(heading)
        if name in HISTORY:
            history[name] = np.array([factor * value])
    travels = _travels([one.time for one in states], reading)
    return Run(path.stem, travels, state, history, notes=notes)


def _sheet(path: Path, fields: Fields, reading: Reading) -> tuple[Sheet, tuple[str, ...]]:
    """Sheet of one state, and how it was understood."""
    notes = []
    points, moved = reading.scale * fields.points, None
    name = next((n for n in fields.by_point if n.casefold() in DISPLACEMENTS), None)
    if name is not None:
        moved = reading.scale * np.asarray(fields.by_point[name], dtype=float)
        moved = np.pad(moved.reshape(len(points), -1), ((0, 0), (0, 3)))[:, :3]
    formed, flat = _formed_and_flat(path, points, moved, reading, notes)
    triangles = fields.triangles
    gamma = by_triangle = None
    chosen = None if reading.field == NO_FIELD else _field(path, fields, reading)
    if chosen is not None:
        where, name = chosen
        values = reading.gamma(np.asarray(getattr(fields, where)[name], dtype=float).ravel())
        notes.append(f"angle from the {where.replace('by_', '')} field '{name}'")
        gamma = values
        if where == "by_triangle":
            places = formed if flat is None else np.pad(flat, ((0, 0), (0, 1)))
            gamma = at_nodes(values, places, triangles)
            by_triangle = values if np.isfinite(values).all() else None
    elif reading.field != NO_FIELD and formed is not None and flat is not None:
        values = sheared(flat, formed, triangles, reading.orientation)
        values = values if reading.signed else np.abs(values)
        by_triangle = values
        gamma = at_nodes(values, np.pad(flat, ((0, 0), (0, 1))), triangles)
        notes.append(
            f"angle worked out from the displacements, warp at {reading.orientation:g}° to x"
        )
    return Sheet(formed, flat, triangles, gamma, by_triangle=by_triangle), tuple(notes)


def _formed_and_flat(
    path: Path,
    points: FloatArray,
    moved: FloatArray | None,
    reading: Reading,
    notes: list[str],
) -> tuple[FloatArray | None, FloatArray | None]:
    """Formed and flat positions from those in the file and the displacements."""
    if moved is None:
        if reading.coordinates == "flat":
            return None, points[:, :2]
        return points, None
    if not np.isfinite(moved).all():
        lost = len(moved) - np.isfinite(moved).all(1).sum()
        raise InputError(f"{path}: {lost} nodes have no displacement")
    given = reading.coordinates
    if given is None:
        size = np.ptp(points, axis=0).max()
        bent = np.ptp(points[:, 2]), np.ptp((points - moved)[:, 2])
        given = "flat" if bent[0] < FLAT * size < bent[1] else "formed"
        notes.append(f"its points are taken as the {given} ones")
    formed, rest = (points + moved, points) if given == "flat" else (points, points - moved)
    if np.ptp(rest[:, 2]) > 1e-3 * np.ptp(rest, axis=0).max():
        notes.append("its undeformed sheet is not flat, so it has no flat coordinates")
        return formed, None
    return formed, rest[:, :2]


def _field(path: Path, fields: Fields, reading: Reading) -> tuple[str, str] | None:
    """Where the angle is: ("by_point" or "by_triangle", name)."""
    scalars = {
        (where, name): None
        for where in ("by_triangle", "by_point")
        for name, values in getattr(fields, where).items()
        if np.ndim(values) == 1 or np.shape(values)[1:] == (1,)
    }
    names = [name for _, name in scalars]
    if reading.field is not None:
        for key in scalars:
            if key[1] == reading.field or (reading.values and key[1] == "angle"):
                return key
        present = f": {suggestion(reading.field, names)}" if names else ""
        raise InputError(f"{path}: no field '{reading.field}'{present} ({_present(fields)})")
    for key in scalars:
        if name_of(key[1])[0] == "angle":
            return key
    displaced = any(name.casefold() in DISPLACEMENTS for name in fields.by_point)
    if names and not displaced:
        raise InputError(
            f"{path}: no field of a shear angle known by its name: choose one with field=... "
            f"(--field), or 'none' ({_present(fields)})"
        )
    return None


def _present(fields: Fields) -> str:
    """Fields in a file, in words."""
    return "; ".join(
        f"{words} fields: {', '.join(names) if names else 'none'}"
        for words, names in (("cell", fields.by_triangle), ("point", fields.by_point))
    )


def _of_table(path: Path, reading: Reading) -> Run:
    named = "" if reading.field in (None, NO_FIELD) else reading.field
    table = read_table(path, named)
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
    travels = (reading.travel,)
    if "angle" not in table or reading.field == NO_FIELD:
        if plan is None or len(plan) < 3:
            raise InputError(f"{path}: a contour needs three points x, y (and a field an angle)")
        ring = np.vstack([plan, plan[:1]]) if _closes(plan) else plan
        return Run(path.stem, travels, lambda _: Sheet(contour=shapely.LineString(ring)))
    if flat is None and reading.coordinates == "flat":
        flat, formed = plan, None
    elif flat is None and formed is None:
        raise InputError(
            f"{path}: are x and y flat or formed coordinates? say coordinates = 'flat', or name "
            "the columns x0, y0 (flat) or x, y, z (formed)"
            if reading.coordinates is None
            else f"{path}: formed coordinates need x, y and z"
        )
    sheet = Sheet(formed, flat, gamma=reading.gamma(table["angle"]))
    return Run(path.stem, travels, lambda _: sheet)


def _closes(plan: FloatArray) -> bool:
    """Whether a polyline's ends are as near to each other as its points are."""
    steps = np.linalg.norm(np.diff(plan, axis=0), axis=1)
    gap = float(np.linalg.norm(plan[-1] - plan[0]))
    return 0 < gap <= 3 * max(float(np.median(steps)), 1e-9)


def _history(path: Path, needed: bool = False) -> dict[str, FloatArray]:
    """Columns of a history that are known here."""
    table = read_table(path)
    known = {k: v for k, v in table.items() if k in HISTORY}
    if needed and len(known) < 2:
        raise InputError(f"{path}: expected columns such as travel_mm and force_N")
    whole = np.isfinite(list(known.values())).all(0) if known else slice(None)
    return {name: column[whole] for name, column in known.items()}
