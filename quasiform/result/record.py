"""A run and its folder: summary, history and formed sheets along the travel, written and read.

`summary.json` carries the number of its `format`. Folders of version 0.1.0 have none; they are
converted as they are read: there `certified` was true or a text of reasons.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import FORMAT, InputError, force_column, naming
from .files import SCENE
from .plies import apart, in_one, one_of, summary_of_ply
from .sheet import FormedSheet, read_sheets

if TYPE_CHECKING:
    from ..model import Model

FloatArray = np.ndarray
NEEDED = {"point_fields": ("displacement",), "cell_fields": ("shear_angle", "warp", "weft")}


class Sheets(Sequence[FormedSheet]):
    """Formed sheets by travel (mm, ascending), each loaded by its number when it is asked for."""

    def __init__(self, travels: Sequence[float], load: Callable[[int], FormedSheet]) -> None:
        self.travels = tuple(travels)
        self._load = lru_cache(maxsize=2)(load)  # more would fill the memory

    def __len__(self) -> int:
        return len(self.travels)

    def __getitem__(self, at: Any) -> Any:
        numbers = range(len(self))[at]
        if isinstance(numbers, range):
            return Sheets([self.travels[k] for k in numbers], lambda k: self[numbers[k]])
        return self._load(numbers)


@dataclass(frozen=True, eq=False)
class Record:
    """A run as its folder holds it.

    Parameters
    ----------
    summary : dict
        Contents of `summary.json`.
    history : dict of heading to (k,) array
        Columns of `history.csv`, the travel first.
    sheets : Sheets
        Those that were written, by travel; the end is the last one.
    folder : path or None
        None for a run that is not saved.
    model : Model or None
        What was solved; None for a run read from its folder.
    gripped : (n,) bool array or None
        Nodes of the last sheet that are held in all directions.
    stacks : Sheets or None
        All plies of each travel in one sheet, where there are several: what is written.
    ply : int
        Of a stack: the number of the ply of the sheets and of the summary; 0 where all are shown.
    """

    summary: dict[str, Any]
    history: Mapping[str, FloatArray]
    sheets: Sheets
    folder: Path | None = None
    model: Model | None = field(default=None, repr=False)
    gripped: np.ndarray | None = field(default=None, repr=False)
    stacks: Sheets | None = field(default=None, repr=False)
    ply: int = 1

    @classmethod
    def read(cls, folder: str | Path, ply: int = 1) -> Record:
        """Read the folder of a run; a mesh is read when it is asked for.

        Of a stack the sheets are those of one ply, or of all (0). InputError names the file and its
        defect.
        """
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder")
        summary = _read_summary(folder / "summary.json")
        files = sheet_files(folder)
        travels = [summary["reached_mm"] if s is None else s for s, _ in files]
        sheets = Sheets(travels, lambda k: _own_sheet(files[k][1], travels[k], ply))
        history = _read_history(folder / "history.csv")
        return cls(summary_of_ply(summary, ply), history, sheets, folder, ply=ply)

    @classmethod
    def of(cls, source: Any) -> Record:
        """Return the record of a run: itself, that of a `Result`, or that of a folder."""
        if isinstance(source, str | Path):
            return cls.read(source)
        return source if isinstance(source, cls) else source.record

    @property
    def name(self) -> str:
        """Name of the folder, or of the case where there is none."""
        return str(self.summary["case"]) if self.folder is None else self.folder.resolve().name

    @property
    def case(self) -> str:
        """Name of the case."""
        return str(self.summary.get("case", self.name))

    @property
    def parameters(self) -> dict[str, Any]:
        """What the user gave."""
        return self.summary["parameters"]

    @property
    def scene(self) -> str:
        """Name or file of its scene, wherever the working folder is.

        That is the scene in its folder; InputError where that has none. Versions before 0.2 wrote
        none; theirs is looked for where it was when the run was made, then beside the run's folder,
        in it, and from here.
        """
        if self.folder is not None and (self.folder / SCENE).is_file():
            return str(self.folder / SCENE)
        if self.folder and not str(self.summary.get("version", "0.1")).startswith("0.1"):
            raise InputError(f"{self.folder}: no {SCENE}, so its scene is not known")
        given, recorded = str(self.parameters["scene"]), self.parameters.get("scene_file")
        if self.folder is None or not given.endswith(".toml"):
            return given
        places = [Path(recorded)] if isinstance(recorded, str) else []
        places += [self.folder.resolve().parent / given, self.folder / given, Path(given)]
        for path in places:
            if path.is_file():
                return str(path)
        looked = ", ".join(dict.fromkeys(str(path.parent) for path in places))
        raise InputError(f"{self.folder}: its scene {given} is in none of {looked}")

    @property
    def resolved(self) -> str:
        """Its scene as TOML with every default, or what is known: its name or file."""
        if self.folder is not None and (self.folder / SCENE).is_file():
            return (self.folder / SCENE).read_text(encoding="utf-8")
        from ..scenes.resolved import resolved  # pydantic

        text = resolved(self.model, {}) if self.model is not None else ""
        return text or str(self.parameters.get("scene_file") or self.parameters.get("scene", ""))

    @property
    def sheet(self) -> FormedSheet:
        """The last of its sheets."""
        return self.sheets[-1]

    @property
    def travel(self) -> float:
        """Travel of its last sheet, mm."""
        return self.sheets.travels[-1]

    @property
    def goal(self) -> float:
        """End of the travel: what was asked for, as far as it is known, or what was reached."""
        given = self.parameters
        asked = given.get("travel", given.get("displacement", 0.0))
        return max(float(self.model.travel if self.model else asked), self.travel) or 1.0

    @property
    def travel_name(self) -> str:
        """Column of the travel in the history."""
        return next(iter(self.history), "travel_mm")

    @property
    def forces(self) -> FloatArray | None:
        """Driving forces of the history, N, or mJ by a load factor; None without them."""
        # those of version 0.1.0 are called force_N by a load factor too
        found = (self.history.get(name) for name in (force_column(self.travel_name), "force_N"))
        return next((column for column in found if column is not None), None)

    @property
    def force_unit(self) -> str:
        """N, or mJ where a load factor is the travel."""
        return force_column(self.travel_name).rpartition("_")[2]

    @property
    def force(self) -> float:
        """Driving force at its last sheet, interpolated in the history; nan without one."""
        if self.forces is None:
            return np.nan
        return float(np.interp(self.travel, self.history[self.travel_name], self.forces))

    @property
    def at_end(self) -> bool:
        """Whether its last sheet is that of the summary."""
        return self.travel == self.summary["reached_mm"]

    @property
    def certified(self) -> bool:
        """Whether the end of the run is certified, and its last sheet is the end."""
        return self.at_end and self.summary["certified"]

    @property
    def reasons(self) -> list[str]:
        """Why its last sheet is not certified."""
        if not self.at_end:
            return ["not the end of the run, which alone is checked"]
        return [] if self.certified else self.summary["certificate"]["reasons"] or ["unknown"]

    @property
    def limits(self) -> list[str]:
        """What limits the trust in its last sheet, the worst first."""
        return [*self.reasons, *(self.summary["trust"] if self.at_end else ())]

    @property
    def in_plane(self) -> bool:
        """Whether the run is a plane problem."""
        if self.model is not None:
            return self.model.sheet.dim == 2
        return not (self.has_tools or np.ptp(self.sheet.points[:, 2]) > 0)

    @property
    def has_tools(self) -> bool:
        """Whether tools form the sheet."""
        return "max_penetration_mm" in self.summary

    @property
    def layer(self) -> dict[str, Any]:
        """What `parameters.plies` has of its ply, the first where all are shown; empty without."""
        layers, number = self.parameters.get("plies") or (), max(self.ply, 1)
        return layers[number - 1] if len(layers) >= number else {}

    @property
    def ply_name(self) -> str:
        """Number, count and orientation of its ply; empty where there is one, or all are shown."""
        count = len(self.summary.get("plies", ()))
        turn = f" at {self.layer['orientation']:g}°" if "orientation" in self.layer else ""
        return f"ply {self.ply} of {count}{turn}" if count and self.ply else ""

    @property
    def fabric(self) -> dict[str, Any]:
        """Parameters of the fabric as in `summary.json`: name, thickness (mm), shear, ..."""
        if self.model is not None:
            return dict(vars(self.model.sheets[max(self.ply, 1) - 1].fabric))
        both = self.layer.get("fabric"), self.parameters.get("fabric")
        return next((given for given in both if isinstance(given, dict)), {})

    @property
    def fabric_name(self) -> str:
        """Name of the fabric."""
        return str(self.fabric.get("name", "unknown fabric"))

    @cached_property
    def areas(self) -> dict[str, tuple[tuple[float, float], float]]:
        """Centre and radius of the named areas on the flat sheet, mm; none where not known."""
        if self.model is not None:
            return dict(self.model.areas)
        if isinstance(self.parameters.get("scene"), str):
            from ..scenes import scene_file  # pydantic

            with suppress(InputError):
                return dict(scene_file.load(self.scene).areas)
        return {}

    @property
    def locking(self) -> float | None:
        """Shear angle at which the fabric locks, degrees; None for a law without locking."""
        shear = self.fabric.get("shear") or {}
        return _locking(shear if isinstance(shear, Mapping) else vars(shear))

    def of_ply(self, ply: int) -> Record:
        """Return the run with the sheets of another ply; InputError if there is none."""
        if self.folder is not None:
            return Record.read(self.folder, ply)
        stacks = self.stacks or self.sheets
        sheets = Sheets(stacks.travels, lambda k: one_of(stacks[k], ply))
        summary = summary_of_ply(self.summary, ply)
        return replace(self, summary=summary, sheets=sheets, gripped=None, ply=ply)

    @property
    def plies(self) -> list[Record]:
        """The run with the sheets of each ply, from the punch down; itself without a stack."""
        numbers = range(1, 1 + len(self.summary.get("plies", ())))
        return [self if k == self.ply else self.of_ply(k) for k in numbers] or [self]

    def upto(self, state: int) -> Record:
        """Return the run up to one of its sheets."""
        count = range(len(self.sheets))[state] + 1
        return self if count == len(self.sheets) else replace(self, sheets=self.sheets[:count])

    def near(self, travel: float) -> Record:
        """Return the run up to its sheet nearest to a travel, mm."""
        return self.upto(int(np.abs(np.subtract(self.sheets.travels, travel)).argmin()))

    def write(self, folder: str | Path, since: int = 0, increments: bool = True) -> None:
        """Write all but the pictures; sheets from number `since` on, without `increments` none."""
        _write(self, Path(folder), since, increments)


def _locking(shear: Mapping[str, Any]) -> float | None:
    """Angle, degrees, at which a shear law locks; None for a law without locking."""
    onset = shear.get("I_lo")
    locks = onset is not None and shear.get("C_lo") and 0 < onset < 1
    return float(np.degrees(np.arcsin(onset))) if locks else None


def _write(record: Record, folder: Path, since: int, increments: bool) -> None:
    """Write a record as `Record.write` does."""
    end, stacks = record.sheets[-1], record.stacks or record.sheets
    summary = json.dumps(record.summary, indent=2, allow_nan=False, default=np.generic.item)
    (folder / "summary.json").write_text(summary + "\n", encoding="utf-8")
    columns = np.column_stack(list(record.history.values()))
    _write_table(folder / "history.csv", record.history, columns, "%.8g")
    loops = [np.column_stack([np.full(len(p), k), p]) for k, p in enumerate(end.outline)]
    heading = ["loop", "x_mm", "y_mm", "z_mm"]
    _write_table(folder / "outline.csv", heading, np.vstack(loops), "%.6g")
    collection = ET.Element("VTKFile", type="Collection", version="0.1")
    series = ET.SubElement(collection, "Collection")
    for number, travel in enumerate(record.sheets.travels if increments else ()):
        name = f"increment_{number:04d}.vtu"
        if number >= since:
            stacks[number].write(folder / name)
        ET.SubElement(series, "DataSet", timestep=f"{travel:.8g}", part="0", file=name)
    ET.ElementTree(collection).write(folder / "result.pvd", xml_declaration=True)
    if increments and since < len(record.sheets):  # the last one is the end
        copyfile(folder / name, folder / "result.vtu")
    else:
        stacks[-1].write(folder / "result.vtu")
    for ply in range(1, 1 + len(record.summary.get("plies", ()))):
        one_of(stacks[-1], ply).write(folder / f"ply_{ply}.vtu")


def _read_summary(path: Path) -> dict[str, Any]:
    """Contents of a `summary.json`, in today's format."""
    if not path.exists():
        raise InputError(f"{path.parent}: no result: it has no summary.json")
    kinds = {"reached_mm": int | float, "parameters": dict, "error_estimate": dict}
    with naming(path):
        try:
            summary = json.loads(path.read_text(encoding="utf-8"))
            if not all(isinstance(summary.get(key), kind) for key, kind in kinds.items()):
                raise ValueError(f"expected {', '.join(kinds)}")
        except (ValueError, AttributeError) as error:  # no JSON, or no table
            raise InputError(f"not the summary of a run: {error}") from error
        given = summary.get("format", 1)
        if given not in (1, FORMAT):
            raise InputError(f"of format {given}; this version reads formats 1 and {FORMAT}")
    return summary if given == FORMAT else _of_first_format(summary)


def _of_first_format(summary: dict[str, Any]) -> dict[str, Any]:
    """Summary in today's format from one of version 0.1.0."""
    given, many = summary.get("certified"), summary.get("one_of_many")
    reasons = given.split("; ") if isinstance(given, str) else []
    unsolved = [r for r in reasons if r.startswith("residual") or "pivots" in r or "balance" in r]
    return summary | {
        "format": FORMAT,
        "certified": given is True,
        "certificate": {"converged": not unsolved, "reasons": reasons},
        "trust": [f"one of many states: {many}"] if many else [],
        "factorisations": {},
    }


def _read_history(path: Path) -> dict[str, FloatArray]:
    """Columns of a `history.csv` by heading; none without the file."""
    if not path.exists():
        return {}
    with naming(path):
        try:
            heading = path.read_text(encoding="utf-8").splitlines()[0].split(",")
            columns = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
            return dict(zip(heading, columns.T, strict=True))
        except (ValueError, IndexError) as error:
            raise InputError(f"not a history of this program: {error}") from error


def sheet_files(folder: Path) -> list[tuple[float | None, Path]]:
    """Travels and files of the sheets in a folder; a single one has no travel of its own."""
    increments, single = folder / "result.pvd", folder / "result.vtu"
    if increments.exists() and b"<DataSet" in increments.read_bytes():
        return series(increments)
    if single.exists():
        return [(None, single)]
    raise InputError(f"{folder}: no result: neither result.pvd with its increments nor .vtu")


def series(path: Path) -> list[tuple[float, Path]]:
    """Times (travels) and files that a .pvd file names, by time."""
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


def _own_sheet(path: Path, travel: float, ply: int) -> FormedSheet:
    """Sheet in a file of this program: one of its plies."""
    with naming(path):
        sheet = one_of(read_sheets(path)[-1], ply)
        for where, names in NEEDED.items():
            for name in names:
                if name not in getattr(sheet, where):
                    raise InputError(f"no field '{name}': not a result of this program")
        return replace(in_one([own.with_flat() for _, own in apart(sheet)]), travel=travel)


def _write_table(path: Path, heading: Iterable[str], rows: FloatArray, form: str) -> None:
    """Write a CSV file with the line ends of RFC 4180."""
    look = {"delimiter": ",", "newline": "\r\n", "comments": "", "encoding": "utf-8"}
    np.savetxt(path, rows, fmt=form, header=",".join(heading), **look)
