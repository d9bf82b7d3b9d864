"""What a run leaves: the states along the travel, the fields derived from them, and the files."""

from __future__ import annotations

import csv
import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from .blank import Blank
from .files import replaced
from .measure import disc, percentile
from .scene import Scene

FloatArray = np.ndarray
CERTIFIED_RESIDUAL = 1e-3
CERTIFIED_BALANCE = 1e-2
CERTIFIED_PENETRATION = 0.03  # of the thickness


@dataclass(frozen=True)
class State:
    """One converged increment: travel, x, driving force of the whole (N), work so far, measures."""

    travel: float
    x: FloatArray
    force: float
    linear_solves: int
    measures: dict[str, float]


@dataclass
class Result:
    """A finished or stopped run.

    Parameters
    ----------
    scene : Scene
    states : list of State
        The start first, the end last.
    reason : str
        Why the run stopped early; empty if it reached its goal.
    wall_s : float
        Time of the solve alone.
    linear_solves, increments : int
    settings : dict
        How it was solved: increment, method, tolerance, convex, linear.
    rescues : dict of rung to count
    residual : float
        Sum of the nodal residuals at the end relative to the driving force, lags refreshed.
    energy_balance : float
        |work in - stored - dissipated| / work in.
    negative_pivots : int or None
        Of the exact tangent at the end; None where the linear solver does not tell.
    collapse : dict or None
        Where and when a triangle first passed 85 degrees or turned over.
    estimate : dict
        `shear_angle_deg` (p99) and `force_N`: differences between this mesh and one twice as
        coarse, which at first-order convergence is the error of this one; None if not estimated.
    """

    scene: Scene
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
    collapse: dict[str, Any] | None = None
    estimate: dict[str, float | None] = field(
        default_factory=lambda: {"shear_angle_deg": None, "force_N": None}
    )

    @property
    def status(self) -> str:
        """Return "completed" or "stopped"."""
        return "stopped" if self.reason else "completed"

    @cached_property
    def _unfolding(self) -> tuple[Blank, Any, Any, Any, Any]:
        return self.scene.blank.unfolded()

    @property
    def blank(self) -> Blank:
        """The whole flat blank (mirrored where a part was modelled)."""
        return self._unfolding[0]

    def positions(self, state: int = -1) -> FloatArray:
        """(n_nodes, 3) positions of the whole sheet, mm."""
        _, source, sign, _, _ = self._unfolding
        part = self.scene.positions(self.states[state].x)
        return np.pad(part, ((0, 0), (0, 3 - part.shape[1])))[source] * sign

    def shear_angles(self, state: int = -1) -> FloatArray:
        """(n_triangles,) signed shear angle of the whole sheet, degrees."""
        _, _, _, source, sign = self._unfolding
        return np.degrees(self.scene.membrane.shear_angle(self.states[state].x))[source] * sign

    @property
    def shear_angle(self) -> FloatArray:
        """(n_triangles,) signed shear angle at the end, degrees."""
        return self.shear_angles()

    @property
    def force(self) -> float:
        """Driving force (punch or grip) at the end, N."""
        return self.states[-1].force

    @property
    def history(self) -> dict[str, FloatArray]:
        """Columns by name, one row an increment (goes straight into a pandas DataFrame)."""
        travel = self.scene.travel_name
        columns = {
            travel: [s.travel for s in self.states],
            "force_N": [s.force for s in self.states],
        }
        for name in self.scene.measures:
            columns[name] = [s.measures[name] for s in self.states]
        columns["linear_solves"] = [s.linear_solves for s in self.states]
        return {name: np.array(values) for name, values in columns.items()}

    def cell_fields(self, state: int = -1) -> dict[str, FloatArray]:
        """Fields by triangle: shear_angle (degrees), warp, weft (unit vectors), E11, E22, S12."""
        blank, membrane = self.blank, self.scene.membrane
        _, _, _, source, sign = self._unfolding
        x = self.states[state].x
        I4, _, I8 = membrane.invariants(x)
        positions = self.positions(state)
        legs = positions[blank.triangles[:, 1:]] - positions[blank.triangles[:, :1]]
        flat = blank.nodes[blank.triangles[:, 1:]] - blank.nodes[blank.triangles[:, :1]]
        F = np.einsum("nik,nij->nkj", legs, np.linalg.inv(flat).transpose(0, 2, 1))
        unit = [f / np.linalg.norm(f, axis=1)[:, None] for f in (F @ blank.warp, F @ blank.weft)]
        return {
            "shear_angle": self.shear_angles(state),
            "warp": unit[0],
            "weft": unit[1],
            "E11": (0.5 * (I4 - 1.0))[source],
            "E22": (0.5 * (I8 - 1.0))[source],
            "S12": membrane.stress(x)[source, 0, 1] * sign,
        }

    def point_fields(self, state: int = -1) -> dict[str, FloatArray]:
        """Fields by node: displacement (mm) and contact_pressure (MPa, summed over the tools)."""
        _, source, _, _, _ = self._unfolding
        X = np.pad(self.blank.nodes, ((0, 0), (0, 1)))
        if self.scene.dim == 3:
            X[:, 2] = self.scene.positions(self.scene.x0)[source, 2]
        pressure = np.zeros(len(self.scene.blank.nodes))
        for contact in self.scene.contacts:
            pressure += contact.pressure(self.states[state].x)
        return {
            "displacement": self.positions(state) - X,
            "contact_pressure": pressure[source],
        }

    @property
    def max_penetration(self) -> float:
        """Deepest penetration into a tool at the end, mm, at the nodes, where contact acts."""
        depths = [c.penetration(self.states[-1].x).max() for c in self.scene.contacts]
        return float(max([0.0, *depths]))

    @property
    def chord_penetration(self) -> float:
        """Deepest penetration at the middle of an element edge, mm: how far chords cut fillets."""
        x, facets = self.states[-1].x, self.scene.blank.mesh.facets.T
        depths = []
        for contact in self.scene.contacts:
            middle = contact.relative(x)[facets].mean(1)
            depths.append((contact.offset - contact.tool.shape.distance(middle)[0]).max())
        return float(max([0.0, *depths]))

    @property
    def draw_in(self) -> dict[str, float]:
        """Inward motion of the middle of each edge at the end, mm, by direction."""
        positions = self.scene.positions(self.states[-1].x)
        return {name: edge.draw_in(positions) for name, edge in self.scene.edges.items()}

    @property
    def areas(self) -> dict[str, float | None]:
        """Mean |shear angle| of each named area at the end, degrees; None without a triangle."""
        means: dict[str, float | None] = {}
        for name, (centre, radius) in self.scene.areas.items():
            inside = disc(self.blank, centre, radius)
            weight = self.blank.areas[inside]
            gamma = np.abs(self.shear_angle[inside])
            means[name] = float(weight @ gamma / weight.sum()) if inside.any() else None
        return means

    @property
    def certified(self) -> bool | str:
        """True, or the reasons why the end state is not certified."""
        doubts = []
        if self.reason:
            doubts.append("stopped early")
        if not self.residual < CERTIFIED_RESIDUAL:
            doubts.append(f"residual {self.residual:.1e} of the driving force")
        if self.negative_pivots is None:
            doubts.append("no pivots from the linear solver")
        elif self.negative_pivots:
            doubts.append(f"{self.negative_pivots} negative pivots of the tangent")
        if self.max_penetration > CERTIFIED_PENETRATION * self.scene.fabric.thickness:
            doubts.append(f"penetration {self.max_penetration:.3f} mm at a node")
        if self.energy_balance > CERTIFIED_BALANCE:
            doubts.append(f"energy balance open by {100 * self.energy_balance:.1f} %")
        if self.collapse:
            doubts.append(f"collapsed from {self.collapse['travel_mm']:.4g} mm on")
        return "; ".join(doubts) if doubts else True

    def compare_with_coarser(self, coarse: Result) -> None:
        """Set `estimate` from the same scene on a coarser mesh.

        Left open where the coarse scene is another one (a user has added terms or changed the
        travel), stopped early, or where one of the two has collapsed.
        """
        same = [term.name for term in self.scene.terms] == [t.name for t in coarse.scene.terms]
        same = same and self.scene.fixed.sum() >= coarse.scene.fixed.sum()
        same = same and self.states[-1].travel == coarse.states[-1].travel
        if not same or coarse.reason or self.reason or coarse.collapse or self.collapse:
            return
        p99 = [
            percentile(np.abs(result.shear_angle), result.blank.areas, 0.99)
            for result in (self, coarse)
        ]
        self.estimate = {
            "shear_angle_deg": abs(p99[0] - p99[1]),
            "force_N": abs(self.force - coarse.force),
        }

    def summary(self) -> dict[str, Any]:
        """Contents of `summary.json`."""
        scene, blank = self.scene, self.blank
        gamma = np.abs(self.shear_angle)
        I4, _, I8 = scene.membrane.invariants(self.states[-1].x)
        summary: dict[str, Any] = {
            "case": scene.name,
            "version": package_version(),
            "parameters": scene.parameters,
            "status": self.status,
            "reached_mm": self.states[-1].travel,
            "reason": self.reason,
            "wall_s": round(self.wall_s, 3),
            "linear_solves": self.linear_solves,
            "solver": self.settings,
            "increments": self.increments,
            "nodes": len(scene.blank.nodes),
            "triangles": len(scene.blank.triangles),
            "dofs": int((~scene.fixed).sum()),
            "model": [f"{entry}: {why}" for entry, why in scene.model],
            "force_N": self.force,
            "shear_angle_deg": {
                "max": float(gamma.max()),
                "p99": percentile(gamma, blank.areas, 0.99),
                "mean": float(blank.areas @ gamma / blank.areas.sum()),
            },
            "error_estimate": self.estimate,
            "equilibrium": {
                "residual_relative": self.residual,
                "energy_balance_relative": self.energy_balance,
                "negative_pivots": self.negative_pivots,
            },
            "fibre_strain_max": float(np.sqrt(max(I4.max(), I8.max())) - 1.0),
            "collapse": self.collapse,
            "rescues": self.rescues,
            "certified": self.certified,
        }
        if scene.contacts:
            summary |= {
                "max_penetration_mm": self.max_penetration,
                "chord_penetration_mm": self.chord_penetration,
                "draw_in_mm": self.draw_in,
                "areas": self.areas,
            }
        return _finite(summary)

    def save(self, out: str | Path, *, force: bool = False, pictures: bool = True) -> Path:
        """Write summary.json, history.csv, result.vtu, result.pvd and the pictures.

        Parameters
        ----------
        out : path
            Folder; made if missing.
        force : bool
            Replace an existing result.
        pictures : bool

        Raises
        ------
        InputError
            If the folder holds a result already and `force` is not set, or cannot be written.
        """
        with replaced(out, force=force) as folder:
            self._write(folder)
        if pictures:  # last: the numbers of a long run shall not depend on them
            from .plot import save_pictures

            save_pictures(self, Path(out))
        return Path(out)

    def _write(self, folder: Path) -> None:
        summary = json.dumps(self.summary(), indent=2, allow_nan=False)
        (folder / "summary.json").write_text(summary + "\n", encoding="utf-8")
        with (folder / "history.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            history = self.history
            writer.writerow(history)
            for row in zip(*history.values(), strict=True):
                writer.writerow([f"{value:.8g}" for value in row])
        collection = ET.Element("VTKFile", type="Collection", version="0.1")
        series = ET.SubElement(collection, "Collection")
        for i, state in enumerate(self.states):
            name = f"increment_{i:04d}.vtu"
            self._mesh(i).write(folder / name)
            ET.SubElement(series, "DataSet", timestep=f"{state.travel:.8g}", part="0", file=name)
        ET.ElementTree(collection).write(folder / "result.pvd", xml_declaration=True)
        self._mesh(-1).write(folder / "result.vtu")

    def _mesh(self, state: int) -> meshio.Mesh:
        cells = {name: [values] for name, values in self.cell_fields(state).items()}
        return meshio.Mesh(
            self.positions(state),
            [("triangle", self.blank.triangles)],
            point_data=self.point_fields(state),
            cell_data=cells,
        )


def _finite(content: Any) -> Any:
    """Replace numbers that are not finite by None, which JSON can hold."""
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, float) and not np.isfinite(content):
        return None
    return content


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("quasiform")
    except PackageNotFoundError:
        return "not installed"
