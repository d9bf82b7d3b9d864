"""A run read back from the folder it was written to, for pictures of it.

`Saved` has what `plot.py` and `view.py` ask of a `Result`, under the same names, from `result.pvd`
with its increments (or `result.vtu`), `history.csv` and `summary.json` alone; nothing is solved
and no scene is built, but for the cuts through the tools.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError
from ..comparison.mesh_file import Fields, read_fields
from ..comparison.read import locking_angle, scene_of, series
from ..energy.contact import Contact
from ..net.blank import Blank, rotation
from ..scenes.forming import forming
from .measures import percentile

FloatArray = np.ndarray
NEEDED = {"by_point": ("displacement",), "by_triangle": ("shear_angle", "warp", "weft", "doubt")}
DOUBTS = ("beyond_identified_range", "unstable_in_shear", "collapsed", "rovings_may_slip")
CUT = 161  # points a side of the grid on which a tool is cut


@dataclass(frozen=True)
class SavedFabric:
    """What a summary tells of the fabric."""

    name: str


@dataclass(frozen=True)
class SavedScene:
    """What the files tell of the scene.

    Parameters
    ----------
    name : str
    fabric : SavedFabric
    dim : int
        2 for a plane problem, 3 in space.
    contacts : bool
        Whether there are tools.
    travel : float
        Goal, as far as it is known: else the travel that was reached.
    travel_name : str
        Column of the travel in the history.
    """

    name: str
    fabric: SavedFabric
    dim: int
    contacts: bool
    travel: float
    travel_name: str


@dataclass(frozen=True)
class SavedState:
    """A state along the travel, and the file of its mesh."""

    travel: float
    file: Path


@dataclass(frozen=True, eq=False)
class Saved:
    """A run in a folder; what is asked for without a state is that of the last one.

    Parameters
    ----------
    folder : path
    summary : dict
        Contents of `summary.json`.
    history : dict of heading to (n,) array
        Columns of `history.csv`, the travel first.
    states : tuple of SavedState
        Those whose meshes were written, by travel.
    """

    folder: Path
    summary: dict[str, Any]
    history: dict[str, FloatArray]
    states: tuple[SavedState, ...]

    @property
    def label(self) -> str:
        """Name of the folder, by which results of one case are told apart."""
        return self.folder.resolve().name

    def at(self, state: int) -> Saved:
        """Return the run up to a state."""
        count = range(len(self.states))[state] + 1
        return self if count == len(self.states) else replace(self, states=self.states[:count])

    def near(self, travel: float) -> Saved:
        """Return the run up to its state nearest to a travel."""
        return self.at(int(np.abs([s.travel - travel for s in self.states]).argmin()))

    @cached_property
    def _fields(self) -> Fields:
        path = self.states[-1].file
        fields = read_fields(path)[-1]
        for where, names in NEEDED.items():
            for name in names:
                if name not in getattr(fields, where):
                    raise InputError(f"{path}: no field '{name}': not a result of this program")
        return fields

    @cached_property
    def scene(self) -> SavedScene:
        """What is known of the scene."""
        parameters, end = self.summary["parameters"], self._fields.points
        return SavedScene(
            name=str(self.summary.get("case", self.label)),
            fabric=SavedFabric(str(parameters.get("law", "fabric not told"))),
            dim=3 if np.ptp(end[:, 2]) > 0 or "max_penetration_mm" in self.summary else 2,
            contacts="max_penetration_mm" in self.summary,
            travel=float(
                parameters.get("travel", parameters.get("displacement", self.states[-1].travel))
            ),
            travel_name=next(iter(self.history), "travel_mm"),
        )

    @cached_property
    def blank(self) -> Blank:
        """The whole flat blank, its fibres from where their formed directions were when flat."""
        fields = self._fields
        X = (fields.points - fields.by_point["displacement"])[:, :2]
        legs = fields.points[fields.triangles[:, 1:]] - fields.points[fields.triangles[:, :1]]
        flat = X[fields.triangles[:, 1:]] - X[fields.triangles[:, :1]]
        F = np.linalg.solve(flat, legs).transpose(0, 2, 1)  # (m, 3, 2)
        fibres = []
        for family in ("warp", "weft"):
            formed = fields.by_triangle[family][:, :, None]
            rest = (np.linalg.pinv(F) @ formed)[:, :, 0].mean(0)
            fibres.append(rest / np.linalg.norm(rest))
        mesh = self.summary["parameters"].get("mesh", "fibre")
        pairs = None if mesh == "fibre" else np.empty((0, 2), dtype=int)
        return Blank(X, fields.triangles, *fibres, pairs=pairs)

    def positions(self, state: int = -1) -> FloatArray:
        """(n_nodes, 3) positions of the whole sheet, mm."""
        return self.at(state)._fields.points

    def cell_fields(self, state: int = -1) -> dict[str, FloatArray]:
        """Fields by triangle, as in `Result.cell_fields`."""
        return self.at(state)._fields.by_triangle

    def doubts(self, state: int = -1) -> dict[str, np.ndarray]:
        """Triangles whose shear angle should not be trusted, by reason; bool (n_triangles,)."""
        bits = self.cell_fields(state)["doubt"].ravel().astype(int)
        return {reason: bits >> k & 1 > 0 for k, reason in enumerate(DOUBTS)}

    @cached_property
    def shear_angle(self) -> FloatArray:
        """(n_triangles,) signed shear angle, degrees."""
        return self._fields.by_triangle["shear_angle"].ravel()

    @property
    def sound(self) -> FloatArray:
        """|Shear angle| of the triangles that have not collapsed, degrees."""
        return np.abs(self.shear_angle)[~self.doubts()["collapsed"]]

    @property
    def force(self) -> float:
        """Driving force, N, interpolated in the history; nan where there is none."""
        if "force_N" not in self.history:
            return np.nan
        travel = self.history[self.scene.travel_name]
        return float(np.interp(self.states[-1].travel, travel, self.history["force_N"]))

    @property
    def certified(self) -> bool | str:
        """Whether the end was certified, or why not."""
        if not self.at_end:
            return "only the end of a run is"
        return self.summary.get("certified", "not told")

    @property
    def at_end(self) -> bool:
        """Whether its last state is that of the summary."""
        return self.states[-1].travel == self.summary["reached_mm"]

    @property
    def locking(self) -> float | None:
        """Shear angle at which the fabric locks, degrees; None for a law without locking."""
        return locking_angle(self.summary["parameters"])

    @property
    def row(self) -> dict[str, str]:
        """Key numbers by name, for a table of several results; those of the end at the end only."""
        gamma, area, summary = np.abs(self.shear_angle), self.blank.areas, self.summary
        row = {
            "case": self.scene.name,
            "fabric": self.scene.fabric.name,
            "size_mm": _number(summary["parameters"].get("size"), "g"),
            "travel_mm": _number(self.states[-1].travel, ".4g"),
            "force_N": _number(self.force, ".4g"),
            "shear_angle_max_deg": _number(gamma.max(), ".2f"),
            "shear_angle_p99_deg": _number(percentile(gamma, area, 0.99), ".2f"),
            "shear_angle_mean_deg": _number(area @ gamma / area.sum(), ".2f"),
        }
        if self.at_end:
            draw_in = summary.get("draw_in_mm") or {}
            row |= {
                "shear_angle_error_deg": _number(
                    summary["error_estimate"].get("shear_angle_deg"), ".2g"
                ),
                "draw_in_mm": _number(np.mean(list(draw_in.values())) if draw_in else None, ".2f"),
                "certified": "yes" if self.certified is True else "no",
            }
        row["linear_solves"] = _number(summary.get("linear_solves"), "g")
        row["wall_s"] = _number(summary.get("wall_s"), ".1f")
        return row


def _number(value: Any, form: str) -> str:
    known = isinstance(value, int | float) and np.isfinite(value)
    return format(value, form) if known else "-"


def read(folder: str | Path) -> Saved:
    """Read the folder of a run; meshes are read when they are asked for.

    Raises
    ------
    InputError
        Naming the file and its defect.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    path = folder / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        kinds = {"reached_mm": int | float, "parameters": dict, "error_estimate": dict}
        if not all(isinstance(summary.get(key), kind) for key, kind in kinds.items()):
            raise ValueError(f"expected {', '.join(kinds)}")
    except FileNotFoundError as error:
        raise InputError(f"{folder}: no result: it has no summary.json") from error
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except (ValueError, AttributeError) as error:  # no JSON, or no table
        raise InputError(f"{path}: not the summary of a run: {error}") from error
    increments, single = folder / "result.pvd", folder / "result.vtu"
    if increments.exists() and b"<DataSet" in increments.read_bytes():
        states = tuple(SavedState(*entry) for entry in series(increments))
    elif single.exists():
        states = (SavedState(float(summary["reached_mm"]), single),)
    else:
        raise InputError(f"{folder}: no result: neither result.pvd with its increments nor .vtu")
    return Saved(folder, summary, _history(folder / "history.csv"), states)


def _history(path: Path) -> dict[str, FloatArray]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            heading, *rows = csv.reader(file)
        columns = np.array([[float(cell) for cell in row] for row in rows])
        return dict(zip(heading, columns.T, strict=True))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{path}: not a history of this program: {error}") from error


def tool_cuts(run: Saved) -> tuple[dict[str, tuple[FloatArray, ...]], str]:
    """Cut the tools of a forming run at the height of the sheet's plane, or below it for a die.

    The scene is built again from its name or file, which must be where it was.

    Returns
    -------
    cuts : dict of words to (x (n,), y (n,), distance (n, n))
        Signed distance from each tool on a grid in the user's axes, mm: zero on its surface.
    why_not : str
        Why they are not known; empty if they are, or if there are none.
    """
    if not run.scene.contacts:
        return {}, ""
    parameters = run.summary["parameters"]
    try:
        scene = forming(
            scene_of(parameters, run.folder),
            parameters["orientation"],
            size=parameters["size"],
            turn=parameters["turn"],
        )
    except (InputError, KeyError, TypeError) as error:
        return {}, f"the scene is not there any more: {' '.join(str(error).split())}"
    X, travel = run.blank.nodes, run.states[-1].travel
    low, high = X.min(0), X.max(0)
    x, y = (np.linspace(low[i], high[i], CUT) for i in (0, 1))
    plan = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ rotation(scene.turn)
    cuts = {}
    for contact in scene.contacts:
        words, z, moved = _height(contact, travel)
        tool = contact.tool
        points = np.column_stack([plan, np.full(len(plan), z)])
        d = tool.shape.distance(points - [*tool.place, tool.height - moved])[0]
        if words and d.min() < 0 < d.max():
            cuts[words] = x, y, d.reshape(CUT, CUT)
    return cuts, ""


def _height(contact: Contact, travel: float) -> tuple[str, float, float]:
    """What is cut in words ("" for nothing), at which z, and how far the tool has moved down."""
    tool = contact.tool
    if tool.motion == "driven":
        return f"{tool.name}, cut at z = 0", 0.0, travel
    if tool.motion == "fixed":
        z = -0.5 * travel
        return f"{tool.name}, cut at z = {z:.3g} mm", z, 0.0
    return "", 0.0, 0.0  # a holder lies over the sheet, as the die under it
