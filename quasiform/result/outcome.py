"""The states that a run went through, and what is read off them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..energy.plies import slip_between
from ..model import Model
from ..net.blank import Blank
from ..net.edges import disc
from ..net.transfer import interpolated
from . import measures
from .plies import between_plies, in_one
from .sheet import FormedSheet

FloatArray = np.ndarray


@dataclass(frozen=True)
class State:
    """One converged increment: travel, x, driving force of the whole (N), work so far, measures.

    Where a load factor is the travel, the force is the work of the load by it, mJ.
    """

    travel: float
    x: FloatArray
    force: float
    linear_solves: int
    measures: dict[str, float]


@dataclass(repr=False)
class Outcome:
    """A finished or stopped run; `Result` documents it, and adds the verdict and the files."""

    model: Model
    states: list[State]
    reason: str
    wall_s: float
    linear_solves: int
    settings: dict[str, Any]
    increments: int
    rescues: dict[str, int]
    residual: float
    energy_balance: float
    negative_pivots: int | None
    stabilisation: float = 0.0
    parted: float = 0.0
    snaps: list[dict[str, float]] = field(default_factory=list)
    collapse: dict[str, Any] | None = None
    estimate: dict[str, float | None] = field(default_factory=dict)
    energy: float = 0.0
    lower: float = 0.0
    path_gap: dict[str, float] = field(default_factory=dict)
    in_plane: dict[str, dict[str, float]] = field(default_factory=dict)
    shear_angle_error: FloatArray | None = None
    force_errors: FloatArray | None = None
    spread: dict[str, dict[str, float | bool]] = field(default_factory=dict)
    path: Outcome | None = None
    last: FloatArray | None = None
    factorisations: dict[str, int] = field(default_factory=dict)
    purposes: dict[str, int] = field(default_factory=dict)
    memory: tuple[Any, ...] = ()
    track: Any = None
    notes: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if not self.estimate:
            self.estimate = {"shear_angle_deg": None, self.model.force_name: None}

    def add_work(self, other: Outcome, failed: int = 0) -> None:
        """Add the factorisations of another run, and of a failed try on this mesh."""
        counts = Counter(self.factorisations)
        counts.update({f"{self.model.size:.3g} mm": failed})
        counts.update(other.factorisations)
        self.factorisations = dict(counts)

    @property
    def status(self) -> str:
        """Return "completed" or "stopped"."""
        return "stopped" if self.reason else "completed"

    @cached_property
    def plies(self) -> list[Outcome]:
        """The run seen with one ply each, from the punch down; itself where there is one only."""
        views = self.model.plies
        if len(views) == 1:
            return [self]
        own = [self.shear_angle_error, *[None] * (len(views) - 1)]
        return [
            replace(self, model=view, shear_angle_error=error)
            for view, error in zip(views, own, strict=True)
        ]

    @cached_property
    def first(self) -> Model:
        """The model seen with its first ply, of which the fields are."""
        return self.model.plies[0]

    @property
    def blank(self) -> Blank:
        """The whole flat blank in the user's axes (mirrored where a part was modelled)."""
        return self.model.sheet.whole[0]

    @property
    def force(self) -> float:
        """Driving force (punch or grip) at the end, N, or work of a load by its factor, mJ."""
        return self.states[-1].force

    @property
    def description(self) -> list[tuple[str, str]]:
        """What is modelled and what was left out, and why."""
        if self.path is None:
            return [*self.model.description, *self.notes]
        why = (
            f"only the end is solved at {self.model.size:.3g} mm; the forces along the travel come "
            "from there (--size keeps one mesh)"
        )
        followed = (f"path on a mesh of {self.path.model.size:.3g} mm", why)
        return [*self.model.description, *self.notes, followed]

    @property
    def followed(self) -> list[tuple[Outcome, int]]:
        """Where the states along the travel are: those of the path, and the end on this mesh."""
        path = self.path or self
        return [*((path, i) for i in range(len(path.states) - 1)), (self, len(self.states) - 1)]

    @property
    def history(self) -> dict[str, FloatArray]:
        """Columns by name, one row an increment; `pandas.DataFrame(result.history)` takes it."""
        travel, rows = self.model.travel_name, [run.states[i] for run, i in self.followed]
        columns = {travel: [s.travel for s in rows]}
        columns[self.model.force_name] = [s.force for s in rows]
        for name in self.model.measures:
            columns[name] = [s.measures[name] for s in rows]
        columns["linear_solves"] = [s.linear_solves for s in rows]
        if self.force_errors is not None:
            columns[f"force_error_{self.model.force_name.rpartition('_')[2]}"] = list(
                self.force_errors
            )
        if self.path is not None:
            columns["size_mm"] = [*[self.path.model.size] * (len(rows) - 1), self.model.size]
        return {name: np.array(values) for name, values in columns.items()}

    def positions(self, state: int = -1) -> FloatArray:
        """(n_nodes, 3) positions of the whole sheet, mm."""
        return self.model.sheet.whole_positions(self.states[state].x)

    def shear_angles(self, state: int = -1) -> FloatArray:
        """(n_triangles,) signed shear angle of the whole sheet, degrees."""
        return measures.shear_angle(self.first, self.states[state].x)

    @property
    def shear_angle(self) -> FloatArray:
        """(n_triangles,) signed shear angle at the end, degrees."""
        return self.shear_angles()

    def sheet_at(self, state: int = -1) -> FormedSheet:
        """Formed sheet of a state, with the fields by triangle and by node."""
        now, end = self.states[state], state in (-1, len(self.states) - 1)
        error = self.shear_angle_error if end else None
        return measures.formed(self.first, now.x, now.travel, error)

    @property
    def sheet(self) -> FormedSheet:
        """Formed sheet at the end; of a stack the first ply."""
        return self.sheet_at()

    @property
    def diaphragm(self) -> FormedSheet | None:
        """The diaphragm at the end with its `thickness`, mm; None without one."""
        return measures.formed_diaphragm(self.model, self.states[-1].x, self.states[-1].travel)

    def stack_at(self, state: int = -1) -> FormedSheet:
        """All plies of a state in one formed sheet with the field `ply`; the sheet if it is one."""
        plies = [ply.sheet_at(state) for ply in self.plies]
        if len(plies) > 1:
            between = between_plies(self.model, self.states[state].x)
            plies = [
                replace(ply, point_fields={**ply.point_fields, **more})
                for ply, more in zip(plies, between, strict=True)
            ]
        return in_one(plies)

    @property
    def flange_lift(self) -> float:
        """How far the sheet leaves the flat faces of fixed tools at the end, mm."""
        return measures.flange_lift(self.model, self.states[-1].x)

    @property
    def wrinkles(self) -> dict[str, float | None]:
        """How far the sheet leaves flat faces (mm), its largest curvature (1/mm), and its waves.

        The waves of each family of fibres off punch and die: how many lines, their wavelength (mm).
        """
        found = measures.wrinkles(self.first, self.states[-1].x)
        return {"flange_lift_mm": self.flange_lift} | found

    def resting_tools(self) -> dict[str, dict[str, float | list[float]]]:
        """Lift (mm) and tilt (degrees) of each free tool, or the moment its guide takes (N mm)."""
        return measures.resting_tools(self.model, self.states[-1].x, self.states[0].x)

    @property
    def draw_in(self) -> dict[str, float]:
        """Inward motion of the middle of each edge at the end, mm, by direction."""
        positions = self.positions()
        return {name: edge.draw_in(positions) for name, edge in self.model.edges.items()}

    @property
    def areas(self) -> dict[str, float | None]:
        """Mean |shear angle| of each named area at the end, degrees; None without a triangle."""
        means: dict[str, float | None] = {}
        for name, (centre, radius) in self.model.areas.items():
            inside = disc(self.blank, centre, radius)
            weight, gamma = self.blank.areas[inside], np.abs(self.shear_angle[inside])
            means[name] = float(weight @ gamma / weight.sum()) if inside.any() else None
        return means

    @property
    def quantities(self) -> dict[str, float]:
        """Numbers of the end state whose error is estimated, by name."""
        gamma, areas = np.abs(self.shear_angle), self.blank.areas
        found = {
            "shear_angle_deg": measures.percentile(gamma, areas, 0.99),
            self.model.force_name: self.force,
            "shear_angle_mean_deg": float(areas @ gamma / areas.sum()),
        }
        found |= {f"area_{name}_deg": value for name, value in self.areas.items() if value}
        found |= {f"draw_in_{name}_mm": value for name, value in self.draw_in.items()}
        for k, ply in enumerate(self.plies[1:], 2):
            of_ply = {n: v for n, v in ply.quantities.items() if n != self.model.force_name}
            found |= {f"ply_{k}_{name}": value for name, value in of_ply.items()}
        return found | {f"slip_{name}_mm": slip for name, slip in self.slip_between_plies.items()}

    @property
    def slip_between_plies(self) -> dict[str, float]:
        """99th percentile of the slip between two plies at the end, mm, by their numbers (1_2)."""
        start, end = self.model.x0, self.states[-1].x
        named = self.model.named_pairs.items()
        return {name: slip_between(start, pair, end) for name, pair in named}

    def shear_angle_at(self, points: FloatArray) -> FloatArray:
        """(n,) shear angle at (n, 2) points of the flat sheet, degrees; beyond it, the nearest."""
        at_nodes = measures.nodal(self.blank, self.shear_angle)
        return interpolated(self.blank.nodes, at_nodes, points)
