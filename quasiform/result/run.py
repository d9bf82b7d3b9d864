"""What a run leaves: the states along the travel, the fields derived from them, and the files."""

from __future__ import annotations

import csv
import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from ..energy.bending import Bending
from ..energy.contact import LEVER, moment
from ..model import COLLAPSE, Model
from ..net.blank import Blank
from .files import replaced
from .measures import (
    SLIP_GRADIENT,
    disc,
    discretisation_error,
    percentile,
    shear_gradient,
    shear_stability,
    waves,
)

FloatArray = np.ndarray
CERTIFIED_RESIDUAL = 1e-3
CERTIFIED_BALANCE = 1e-2
CERTIFIED_PENETRATION = 0.03  # of the thickness
ROBUST = {"robust": True}  # a quantity that no perturbed start has questioned
LIFTED = 0.1  # of the thickness: a flange that is lifted further has wrinkled


@dataclass(frozen=True)
class State:
    """One converged increment: travel, x, driving force of the whole (N), work so far, measures."""

    travel: float
    x: FloatArray
    force: float
    linear_solves: int
    measures: dict[str, float]


@dataclass(repr=False)
class Result:
    """A finished or stopped run.

    Parameters
    ----------
    model : Model
    states : list of State
        The start first, the end last.
    reason : str
        Why the run stopped early; empty if it reached its goal.
    wall_s : float
        Time of the solve alone, s.
    linear_solves, increments : int
        How many it took: a count in units of the finest mesh.
    settings : dict
        How it was solved: increment, method, linear, tolerance, convex, perturbation, seed.
    rescues : dict of rung to count
        What Newton's method alone did not do; see `solve.increments`.
    residual : float
        Sum of the nodal residuals at the end relative to the driving force, lags refreshed.
    energy_balance : float
        |work in - stored - dissipated| relative to the work in.
    negative_pivots : int or None
        Of the exact tangent at the end; None where the linear solver does not tell.
    stabilisation : float
        Work of the rescues (proximal steps, dynamic relaxation) on the way relative to the energy
        stored at the end. Their forces are in no state.
    snaps : list of dict
        Where the sheet jumped to another state, and the energy this released, estimated from the
        open balance of that increment: from_mm, to_mm, released_mJ.
    collapse : dict or None
        Where and when a triangle first passed 85 degrees or turned over.
    solve_s : float
        Time of one linear solve, s.
    estimate : dict
        Error of the mesh of each of the `quantities`, above all `shear_angle_deg` (of the 99th
        percentile) and `force_N`, from coarser meshes (`measure.discretisation_error`); None if
        not estimated.
    shear_angle_error : (n_triangles,) array or None
        The same of the shear angle, degrees.
    spread : dict
        Scatter of the `quantities` over perturbed starts, where it was asked for (`solve.spread`).
    path : Result or None
        Where only the end was solved on this mesh: the way there on a coarser one.
    """

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
    snaps: list[dict[str, float]] = field(default_factory=list)
    collapse: dict[str, Any] | None = None
    estimate: dict[str, float | None] = field(
        default_factory=lambda: {"shear_angle_deg": None, "force_N": None}
    )
    solve_s: float = 0.0
    shear_angle_error: FloatArray | None = None
    spread: dict[str, dict[str, float | bool]] = field(default_factory=dict)
    path: Result | None = None
    memory: tuple[Any, ...] = ()
    factorisations: dict[str, int] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)

    def add_work(self, other: Result, failed: int = 0) -> None:
        """Add the factorisations of another run, and of a failed try on this mesh."""
        own = f"{self.model.size:g} mm"
        counts = self.factorisations | {own: self.factorisations.get(own, 0) + failed}
        for mesh, count in other.factorisations.items():
            counts[mesh] = counts.get(mesh, 0) + count
        self.factorisations = counts

    def __repr__(self) -> str:
        end = self.states[-1]
        return (
            f"<Result {self.model.name}: {self.status} at {end.travel:.4g} of "
            f"{self.model.travel:.4g}, {len(self.model.sheet.blank.triangles)} triangles, "
            f"{end.force:.4g} N>"
        )

    @property
    def status(self) -> str:
        """Return "completed" or "stopped"."""
        return "stopped" if self.reason else "completed"

    @property
    def blank(self) -> Blank:
        """The whole flat blank in the user's axes (mirrored where a part was modelled)."""
        return self.model.sheet.whole[0]

    def positions(self, state: int = -1) -> FloatArray:
        """(n_nodes, 3) positions of the whole sheet, mm."""
        return self.model.sheet.whole_positions(self.states[state].x)

    def shear_angles(self, state: int = -1) -> FloatArray:
        """(n_triangles,) signed shear angle of the whole sheet, degrees."""
        _, _, _, source, sign = self.model.sheet.whole
        return np.degrees(self.model.membrane.shear_angle(self.states[state].x))[source] * sign

    @property
    def shear_angle(self) -> FloatArray:
        """(n_triangles,) signed shear angle at the end, degrees."""
        return self.shear_angles()

    @property
    def force(self) -> float:
        """Driving force (punch or grip) at the end, N."""
        return self.states[-1].force

    @property
    def description(self) -> list[tuple[str, str]]:
        """What is modelled and what was left out, and why."""
        if self.path is None:
            return [*self.model.description, *self.notes]
        why = (
            f"only the end is solved at {self.model.size:g} mm; the forces along the travel come "
            "from there (--size keeps one mesh)"
        )
        return [*self.model.description, *self.notes, (f"path on a mesh of {self.path.model.size:g} mm", why)]

    @property
    def followed(self) -> list[tuple[Result, int]]:
        """Where the states along the travel are: those of the path, and the end on this mesh."""
        path = self.path or self
        return [*((path, i) for i in range(len(path.states) - 1)), (self, len(self.states) - 1)]

    @property
    def rows(self) -> list[State]:
        """States along the travel."""
        return [result.states[i] for result, i in self.followed]

    @property
    def history(self) -> dict[str, FloatArray]:
        """Columns by name, one row an increment (goes straight into a pandas DataFrame)."""
        travel, rows = self.model.travel_name, self.rows
        columns = {travel: [s.travel for s in rows], "force_N": [s.force for s in rows]}
        for name in self.model.measures:
            columns[name] = [s.measures[name] for s in rows]
        columns["linear_solves"] = [s.linear_solves for s in rows]
        if self.path is not None:
            sizes = [self.path.model.size] * (len(rows) - 1)
            columns["size_mm"] = [*sizes, self.model.size]
        return {name: np.array(values) for name, values in columns.items()}

    def cell_fields(self, state: int = -1) -> dict[str, FloatArray]:
        """Fields by triangle: shear_angle (degrees), warp, weft (unit vectors), E11, E22, S12."""
        blank, membrane = self.blank, self.model.membrane
        _, _, _, source, sign = self.model.sheet.whole
        x = self.states[state].x
        I4, _, I8 = membrane.invariants(x)
        positions = self.positions(state)
        legs = positions[blank.triangles[:, 1:]] - positions[blank.triangles[:, :1]]
        flat = blank.nodes[blank.triangles[:, 1:]] - blank.nodes[blank.triangles[:, :1]]
        F = np.einsum("nik,nij->nkj", legs, np.linalg.inv(flat).transpose(0, 2, 1))
        unit = [f / np.linalg.norm(f, axis=1)[:, None] for f in (F @ blank.warp, F @ blank.weft)]
        end = state in (-1, len(self.states) - 1)
        error = {"shear_angle_error": self.shear_angle_error} if end else {}
        return {name: field for name, field in error.items() if field is not None} | {
            "shear_angle": self.shear_angles(state),
            "warp": unit[0],
            "weft": unit[1],
            "E11": (0.5 * (I4 - 1.0))[source],
            "E22": (0.5 * (I8 - 1.0))[source],
            "S12": membrane.stress(x)[source, 0, 1] * sign,
            "shear_stability": shear_stability(membrane, x)[source],
            "doubt": sum(
                2**bit * flag.astype(float) for bit, flag in enumerate(self.doubts(state).values())
            ),
        }

    def doubts(self, state: int = -1) -> dict[str, np.ndarray]:
        """Triangles whose shear angle should not be trusted, by reason; bool (n_triangles,) each.

        The cell field `doubt` adds 1, 2, 4, 8 for these in order.

        Parameters
        ----------
        state : int
            Which increment; the last one by default.
        """
        x, blank = self.states[state].x, self.blank
        _, _, _, source, _ = self.model.sheet.whole
        gamma = np.abs(self.shear_angles(state))
        return {
            "beyond_identified_range": gamma > self.model.sheet.fabric.shear_range,
            "unstable_in_shear": shear_stability(self.model.membrane, x)[source] < 0,
            "collapsed": gamma > np.degrees(COLLAPSE),
            "rovings_may_slip": shear_gradient(blank, gamma) > SLIP_GRADIENT,
        }

    def outline(self, state: int = -1) -> list[FloatArray]:
        """Closed outline of the deformed blank, then those of its holes; (n, 3) points each, mm."""
        positions = self.positions(state)
        return [positions[loop] for loop in self.blank.outline]

    @property
    def flange_lift(self) -> float:
        """How far the sheet leaves the flat faces of fixed tools at the end, mm."""
        x, lift = self.states[-1].x, 0.0
        for contact in self.model.contacts:
            if contact.tool.motion == "fixed":
                d, n, _ = contact.distance(contact.relative(x))
                above = np.abs(n[:, 2]) > 0.99
                if above.any():
                    lift = max(lift, float((d - contact.reach - contact.points.sag)[above].max()))
        return lift

    @property
    def wrinkles(self) -> dict[str, float | None]:
        """How far the sheet leaves flat faces (mm), its largest curvature (1/mm), and its waves.

        The waves of each family of fibres off punch and die: how many lines, their wavelength (mm).
        """
        scene, x = self.model, self.states[-1].x
        found: dict[str, float | None] = {"flange_lift_mm": self.flange_lift}
        for term in scene.terms:
            if not isinstance(term, Bending):
                continue
            kappa = term.curvature(x)
            found["largest_curvature_1_per_mm"] = float(np.abs(kappa).max())
            at_nodes = np.full((len(scene.sheet.blank.nodes), 2), np.nan)
            at_nodes[term.nodes[:, 0]] = kappa
            for contact in scene.contacts:
                if contact.tool.motion != "free":
                    at_nodes[contact.nodal_force(x) > 0] = np.nan
            blank, source, *_ = scene.sheet.whole
            for f, family in enumerate(("warp", "weft")):
                lines, wavelength = waves(blank.nodes, getattr(blank, family), at_nodes[source, f])
                found[f"waving_{family}_lines"] = lines
                found[f"{family}_wavelength_mm"] = wavelength
        return found

    def resting_tools(self) -> dict[str, dict[str, float | list[float]]]:
        """Lift (mm) and tilt (degrees) of each free tool, or the moment its guide takes (N mm)."""
        scene, x = self.model, self.states[-1].x
        found = {}
        for contact in scene.contacts:
            tool, dofs = contact.tool, contact.tool_dofs
            if tool.motion != "free":
                continue
            entry = found.setdefault(
                tool.name, {"lift_mm": float(x[dofs[0]] - self.states[0].x[dofs[0]])}
            )
            if tool.tilts:
                tilt = np.degrees(scene.sheet.to_user(x[dofs[1:]]) / LEVER)
                entry["tilt_deg"] = tilt.tolist()
            else:
                turning = moment(contact, x) / scene.share
                for axis, plane in enumerate("xy"):
                    if plane in scene.sheet.blank.mirror:
                        turning[1 - axis] = 0.0
                turning = scene.sheet.to_user(turning) + entry.get("held_moment_Nmm", np.zeros(2))
                entry["held_moment_Nmm"] = turning.tolist()
        return found

    def point_fields(self, state: int = -1) -> dict[str, FloatArray]:
        """Fields by node: displacement (mm) and contact_pressure (MPa, summed over the tools)."""
        _, source, _, _, _ = self.model.sheet.whole
        X = np.pad(self.blank.nodes, ((0, 0), (0, 1)))
        if self.model.sheet.dim == 3:
            X[:, 2] = self.model.sheet.positions(self.model.x0)[source, 2]
        force = np.zeros(len(self.model.sheet.blank.nodes))
        for contact in self.model.contacts:
            force += contact.nodal_force(self.states[state].x)
        pressure = force / self.model.sheet.blank.node_areas
        return {
            "displacement": self.positions(state) - X,
            "contact_pressure": pressure[source],
        }

    @property
    def max_penetration(self) -> float:
        """Deepest penetration into a tool at the end, mm, at the nodes, where contact acts."""
        depths = [c.penetration(self.states[-1].x).max() for c in self.model.contacts]
        return float(max([0.0, *depths]))

    @property
    def chord_penetration(self) -> float:
        """Deepest penetration at the middle of an element edge, mm: how far chords cut fillets."""
        x, facets = self.states[-1].x, self.model.sheet.blank.mesh.facets.T
        depths = []
        for contact in self.model.contacts:
            arm = self.model.sheet.positions(x)[facets].mean(1) - contact.origin(x)
            middle = contact.in_tool_frame(x, arm)
            depths.append(0.5 * self.model.sheet.fabric.thickness - contact.distance(middle)[0].min())
        return float(max([0.0, *depths]))

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
        deepest = CERTIFIED_PENETRATION * self.model.sheet.fabric.thickness
        if self.max_penetration > deepest:
            doubts.append(
                f"penetration {self.max_penetration:.4f} mm at a node, {deepest:.4f} allowed"
            )
        if self.energy_balance > CERTIFIED_BALANCE:
            doubts.append(
                f"energy balance open by {100 * self.energy_balance:.1f} %, "
                f"{100 * CERTIFIED_BALANCE:g} % allowed"
            )
        if self.collapse:
            doubts.append(f"collapsed from {self.collapse['travel_mm']:.4g} mm on")
        given, own = self.settings.get("increment"), self.model.increment
        if given and self.model.frictions and given > own * (1 + 1e-6):
            doubts.append(f"friction follows its path in increments of {own:g} mm, not {given:g}")
        scatter = [name for name in self.quantities if not self.spread.get(name, ROBUST)["robust"]]
        if scatter:
            doubts.append(f"perturbed starts scatter in {', '.join(scatter)}")
        elif self.wrinkled and not self.spread:
            doubts.append("wrinkled, one of many states: perturbed starts tell what is robust")
        return "; ".join(doubts) if doubts else True

    @property
    def wrinkled(self) -> bool:
        """Whether the flange is lifted and waves; on a coarse mesh it lifts beside a fillet too."""
        if self.flange_lift <= LIFTED * self.model.sheet.fabric.thickness:
            return False
        return any(self.wrinkles[f"waving_{family}_lines"] for family in ("warp", "weft"))

    @property
    def one_of_many(self) -> str:
        """Why the state found is one of several, in words; empty where nothing tells so."""
        signs = []
        if saddles := self.rescues.get("saddle left", 0):
            signs.append(f"{saddles} saddle{'s were' if saddles > 1 else ' was'} left on the way")
        if self.snaps:
            signs.append(
                f"the sheet jumped {len(self.snaps)} time{'s' * (len(self.snaps) > 1)}, first near "
                f"{self.snaps[0]['to_mm']:.4g} mm"
            )
        lift = self.flange_lift
        if lift > LIFTED * self.model.sheet.fabric.thickness:
            signs.append(f"the flange lifts by {lift:.2f} mm")
        if scattered := [name for name, entry in self.spread.items() if not entry["robust"]]:
            signs.append(f"perturbed starts scatter in {', '.join(scattered)}")
        return "; ".join(signs)

    @property
    def quantities(self) -> dict[str, float]:
        """Numbers of the end state whose error is estimated, by name."""
        gamma, areas = np.abs(self.shear_angle), self.blank.areas
        found = {
            "shear_angle_deg": percentile(gamma, areas, 0.99),
            "force_N": self.force,
            "shear_angle_mean_deg": float(areas @ gamma / areas.sum()),
        }
        found |= {f"area_{name}_deg": value for name, value in self.areas.items() if value}
        return found | {f"draw_in_{name}_mm": value for name, value in self.draw_in.items()}

    def judge(self, coarser: list[Result]) -> None:
        """Estimate the error of the mesh from the same scene on coarser ones, coarsest first.

        Left open where the coarse scene is another one (a user has added terms or changed the
        travel), stopped early, or where one of the two has collapsed.

        Parameters
        ----------
        coarser : list of Result
            Each of twice the size of the next.
        """
        levels = [self]
        for coarse in reversed(coarser):
            if not self._comparable(coarse):
                break
            levels.append(coarse)
        if len(levels) < 2 or self.reason or self.collapse:
            return
        values = [level.quantities for level in levels]
        self.estimate = {
            name: float(discretisation_error([v[name] for v in values]))
            for name in values[0]
            if all(name in v for v in values)
        }
        fields = [self.nodal_shear_angle]
        fields += [level.shear_angle_at(self.blank.nodes) for level in levels[1:]]
        at_nodes = discretisation_error(fields)
        self.shear_angle_error = at_nodes[self.blank.triangles].mean(1)

    def _comparable(self, coarse: Result) -> bool:
        names = [
            [term.name for term in scene.terms if "between" not in term.name]
            for scene in (self.model, coarse.model)
        ]
        return (
            names[0] == names[1]
            and self.model.fixed.sum() >= coarse.model.fixed.sum()
            and self.states[-1].travel == coarse.states[-1].travel
            and not (coarse.reason or coarse.collapse)
        )

    @property
    def nodal_shear_angle(self) -> FloatArray:
        """(n_nodes,) shear angle as the mean of the triangles around a node, degrees."""
        blank = self.blank
        around = blank.triangles.ravel()
        weight = np.repeat(blank.areas, 3)
        total = np.bincount(around, weight * np.repeat(self.shear_angle, 3), len(blank.nodes))
        return total / np.bincount(around, weight, len(blank.nodes))

    def shear_angle_at(self, points: FloatArray) -> FloatArray:
        """(n,) shear angle at (n, 2) points of the flat sheet, degrees; beyond it, the nearest."""
        values, nodes = self.nodal_shear_angle, self.blank.nodes
        found = LinearNDInterpolator(nodes, values)(points)
        outside = np.isnan(found)
        found[outside] = NearestNDInterpolator(nodes, values)(points[outside])
        return found

    def summary(self) -> dict[str, Any]:
        """Contents of `summary.json`."""
        scene, blank = self.model, self.blank
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
            "path_size_mm": None if self.path is None else self.path.model.size,
            "nodes": len(scene.sheet.blank.nodes),
            "triangles": len(scene.sheet.blank.triangles),
            "dofs": int((~scene.fixed).sum()),
            "model": [f"{entry}: {why}" for entry, why in self.description],
            "force_N": self.force,
            "shear_angle_deg": {
                "max": float(gamma.max()),
                "p99": percentile(gamma, blank.areas, 0.99),
                "mean": float(blank.areas @ gamma / blank.areas.sum()),
            },
            "error_estimate": {
                name: self.estimate[name] for name in ("shear_angle_deg", "force_N")
            },
            "estimated_errors": self.estimate,
            "equilibrium": {
                "residual_relative": self.residual,
                "energy_balance_relative": self.energy_balance,
                "negative_pivots": self.negative_pivots,
            },
            "fibre_strain_max": float(np.sqrt(max(I4.max(), I8.max())) - 1.0),
            "collapse": self.collapse,
            "rescues": self.rescues,
            "stabilisation_work_relative": self.stabilisation,
            "snaps": self.snaps,
            "one_of_many": self.one_of_many or None,
            "spread": self.spread or None,
            "certified": self.certified,
        }
        area = blank.areas
        summary["doubtful_share"] = {
            reason: float(area @ flag / area.sum()) for reason, flag in self.doubts().items()
        }
        if scene.contacts:
            summary |= {
                "max_penetration_mm": self.max_penetration,
                "chord_penetration_mm": self.chord_penetration,
                "draw_in_mm": self.draw_in,
                "areas": self.areas,
                "resting_tools": self.resting_tools(),
                "wrinkles": self.wrinkles,
            }
        return _finite(summary)

    def save(self, out: str | Path, *, force: bool = False, pictures: bool | None = None) -> Path:
        """Write summary.json, history.csv, outline.csv, result.vtu, result.pvd and the pictures.

        Parameters
        ----------
        out : path
            Folder; made if missing.
        force : bool
            Replace an existing result.
        pictures : bool, optional
            Whether to draw the pictures; the scene's own choice if not given.

        Raises
        ------
        InputError
            If the folder holds a result already and `force` is not set, or cannot be written.
        """
        with replaced(out, force=force) as folder:
            self.write(folder)
        if (
            self.model.outputs["pictures"] if pictures is None else pictures
        ):  # last: the numbers of a long run shall not depend on them
            self.draw(Path(out))
        return Path(out)

    def draw(self, folder: Path) -> None:
        """Draw the pictures into an existing folder."""
        from ..draw.plot import save_pictures

        save_pictures(self, folder)

    def write(self, folder: Path, since: int = 0) -> None:
        """Write all but the pictures into an existing folder.

        Parameters
        ----------
        folder : path
        since : int
            First of the states along the travel whose mesh is written.
        """
        table = self.summary()
        summary = json.dumps(table, indent=2, allow_nan=False, default=np.generic.item)
        (folder / "summary.json").write_text(summary + "\n", encoding="utf-8")
        with (folder / "history.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            history = self.history
            writer.writerow(history)
            for row in zip(*history.values(), strict=True):
                writer.writerow([f"{value:.8g}" for value in row])
        with (folder / "outline.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["loop", "x_mm", "y_mm", "z_mm"])
            for number, loop in enumerate(self.outline()):
                writer.writerows([number, *(f"{c:.6g}" for c in point)] for point in loop)
        collection = ET.Element("VTKFile", type="Collection", version="0.1")
        series = ET.SubElement(collection, "Collection")
        followed = self.followed if self.model.outputs["increments"] else []
        for number, (result, i) in enumerate(followed):
            name, travel = f"increment_{number:04d}.vtu", result.states[i].travel
            if number >= since:
                result._mesh(i).write(folder / name)
            ET.SubElement(series, "DataSet", timestep=f"{travel:.8g}", part="0", file=name)
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
    if isinstance(content, list | tuple):
        return [_finite(entry) for entry in content]
    if isinstance(content, float) and not np.isfinite(content):
        return None
    return content


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("quasiform")
    except PackageNotFoundError:
        return "not installed"
