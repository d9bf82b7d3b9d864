"""What a run leaves: the states along the travel, the verdict on its end, and the files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError
from .certificate import Certificate, certify, one_of_many, unit
from .estimate import judged
from .files import SCENE, replaced
from .outcome import Outcome, State
from .plies import one_of
from .record import Record, Sheets
from .sheet import FormedSheet
from .summary import summarise

__all__ = ["Result", "State"]


@dataclass(repr=False)
class Result(Outcome):
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
        How many it took: a count on the finest mesh.
    settings : dict
        How it was solved: increment, method, linear, tolerance, convex, perturbation, seed.
    rescues : dict of rung to count
        What Newton's method alone did not do; see `solve.increments`.
    residual : float
        Sum of the nodal residuals at the end relative to the driving force, lags refreshed.
    energy_balance : float
        |work in - stored - dissipated| relative to the work in.
    negative_pivots : int or None
        Of the exact tangent at the end; None where the linear solver does not count them.
    stabilisation : float
        Work of the rescues (proximal steps, dynamic relaxation) on the way relative to the energy
        stored at the end. Their forces are in no state.
    parted : float
        Largest motion of a node when a saddle was left on the way, mm.
    snaps : list of dict
        Where the sheet jumped to another state, and the energy this released, estimated from the
        open balance of that increment: from_mm, to_mm, released_mJ.
    collapse : dict or None
        Where and when a triangle first passed 85 degrees or turned over.
    energy, lower : float
        Stored at the end, and how much less the lowest state of perturbed starts has, mJ.
    path_gap : dict
        By how much each of the `quantities` depends on the mesh of the path; part of the estimate.
        Empty where the path was followed on this mesh.
    estimate : dict
        Error of the mesh of each of the `quantities`, above all `shear_angle_deg` (of the 99th
        percentile) and `force_N` (`load_work_mJ` by a load factor), from other meshes
        (`estimate.discretisation_error`); None if not estimated.
    in_plane : dict of quantity to dict
        Its values with two numbers for the in-plane bending, on a coarse mesh; empty if unknown.
    shear_angle_error : (n_triangles,) array or None
        The same of the shear angle, degrees.
    force_errors : (n_rows,) array or None
        The same of the force in each row of the history, N.
    spread : dict
        Scatter of the `quantities` over perturbed starts, where it was asked for (`solve.spread`).
    path : Result or None
        Where only the end was solved on this mesh: the way there on a coarser one.
    last : (n_dofs,) array or None
        Motion over the last increment, where only the end was solved on this mesh, mm.
    factorisations : dict of mesh to count
        Numeric factorisations by mesh, such as {"10 mm": 295, "5 mm": 27}.
    purposes : dict of purpose to count
        Those of the way on this mesh: prediction, balance (the first solution of an increment),
        friction (the passes after it), saddle, check (of the pivots), rescue, refused; "convex"
        where the exact tangent was not positive definite.
    memory : tuple
        States of the terms at the end.
    track : solve.sensitivity.Track or None
        Its converged increments.
    notes : list of (entry, reason)
        What else to say of how it was solved.
    """

    def __repr__(self) -> str:
        end = self.states[-1]
        return (
            f"<Result {self.model.name}: {self.status} at {end.travel:.4g} of "
            f"{self.model.travel:.4g}, {len(self.model.sheet.blank.triangles)} triangles, "
            f"{end.force:.4g} {self.model.force_name.rpartition('_')[2]}>"
        )

    def _repr_html_(self) -> str:
        """Key numbers as a table, for notebooks."""
        head = f"<tr><th>{escape(self.model.name)}</th><th>{self.status}</th><th>± mesh</th></tr>"
        columns = [self.table()[name] for name in ("quantity", "value", "estimated_error", "unit")]
        rows = [
            f"<tr><td>{escape(name)}</td><td>{value:.4g} {of}</td>"
            f"<td>{'' if error is None else f'{error:.2g}'}</td></tr>"
            for name, value, error, of in zip(*columns, strict=True)
        ]
        worth = escape(self.reason or str(self.certified))
        return f"<table>{head}{''.join(rows)}</table><p>{worth}</p>"

    @property
    def certified(self) -> Certificate:
        """Whether the end state is certified, with the reasons why not and the figures."""
        return certify(self)

    @property
    def one_of_many(self) -> str:
        """Why the state found is one of several; empty where nothing shows so."""
        return one_of_many(self)

    def table(self) -> dict[str, list[Any]]:
        """Key numbers as columns: quantity, value, estimated_error, unit.

        `pandas.DataFrame(result.table())` takes it.
        """
        found = self.quantities
        return {
            "quantity": list(found),
            "value": list(found.values()),
            "estimated_error": [self.estimate.get(name) for name in found],
            "unit": [unit(name).strip() for name in found],
        }

    def sensitivity(
        self, parameters: Iterable[str] | None = None, outputs: Iterable[str] | None = None
    ) -> Any:
        """Derivatives of the numbers of the run by parameters, along its path.

        Where only the end was solved on this mesh, those of the path, on its mesh.

        Parameters
        ----------
        parameters : iterable of str, optional
            Dotted names as in `overrides` (`fabric.friction`, `tools.holder.mass`), or their last
            parts; all numbers of the fabric, the tools and the grippers if not given.
        outputs : iterable of str, optional
            Of the `quantities` and the columns of the history; all if not given.

        Returns
        -------
        solve.sensitivity.Sensitivity

        Raises
        ------
        InputError
            For unknown names, and where the run has no derivative: it was stopped, is not
            converged, or the sheet jumped or buckled on the way.
        """
        run = self.path or self
        if len(self.plies) > 1:
            raise InputError("no sensitivities with several plies")
        if run.track is None:
            raise InputError("no sensitivities: this result holds no increments")
        return run.track.sensitivity(run, parameters, outputs)

    def parameter_errors(
        self, given: Mapping[str, float], found: Any = None
    ) -> dict[str, dict[str, float | None]]:
        """What is known of the error of each of the `quantities`: of the mesh, and by parameters.

        Parameters
        ----------
        given : dict of parameter to float
            What each is uncertain by (a standard deviation, say), in its own unit.
        found : solve.sensitivity.Sensitivity, optional
            Of this run, where it is known already.

        Returns
        -------
        dict by quantity
            `value`, `mesh` (None if not estimated), the change by each parameter, and `total`, the
            root of the sum of their squares: errors count as small and independent.

        Raises
        ------
        InputError
            As `sensitivity` does.
        """
        parts = (found or self.sensitivity(given, self.quantities)).errors(given)
        table = {}
        for name, value in self.quantities.items():
            mesh, by = self.estimate.get(name), parts[name]
            total = float(np.hypot.reduce([mesh or 0.0, *by.values()]))
            table[name] = {"value": value, "mesh": mesh, **by, "total": total}
        return table

    def judge(self, coarser: list[Result], finer: Result | None = None) -> None:
        """Estimate the error of the mesh from results on others, as `estimate.judged` does."""
        better = judged(self, coarser, finer)
        self.estimate, self.shear_angle_error = better.estimate, better.shear_angle_error
        self.force_errors = better.force_errors

    def summary(self) -> dict[str, Any]:
        """Contents of `summary.json`."""
        return summarise(self, self.certified)

    @property
    def sheets(self) -> dict[str, FormedSheet]:
        """Formed sheets at the end by name: `sheet`, or `ply 1`, `ply 2`, ..."""
        stack = self.stack_at()
        return {ply.model.sheet.name: one_of(stack, k) for k, ply in enumerate(self.plies, 1)}

    @property
    def gripped(self) -> np.ndarray:
        """(n_nodes,) bool array: nodes of the whole sheet that are held in all directions."""
        sheet = self.model.sheet
        return self.model.fixed[sheet.dofs].all(1)[sheet.whole[1]]

    @property
    def record(self) -> Record:
        """The run as its folder holds it, for pictures, comparison and hand-over."""
        followed = self.followed
        travels = [run.states[i].travel for run, i in followed]
        sheets = Sheets(travels, lambda k: followed[k][0].sheet_at(followed[k][1]))
        more: dict[str, Any] = {"model": self.model, "gripped": self.gripped}
        if len(self.plies) > 1:
            more["stacks"] = Sheets(travels, lambda k: followed[k][0].stack_at(followed[k][1]))
        return Record(self.summary(), self.history, sheets, **more)

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
        # pictures last: the numbers of a long run shall not depend on them
        if self.model.outputs["pictures"] if pictures is None else pictures:
            self.draw(Path(out))
        return Path(out)

    def draw(self, folder: Path) -> None:
        """Draw the pictures into an existing folder."""
        from ..draw import plot

        plot.save_pictures(self.record, folder)

    def write(self, folder: Path, since: int = 0) -> None:
        """Write all but the pictures, meshes from number `since` on, into an existing folder."""
        self.record.write(folder, since, increments=self.model.outputs["increments"])
        if self.diaphragm:
            self.diaphragm.write(folder / "diaphragm.vtu")
        from ..scenes.resolved import resolved  # pydantic

        run = {"increment": self.settings.get("increment"), "one_mesh": self.path is None}
        if text := resolved(self.model, run):
            (folder / SCENE).write_text(text, encoding="utf-8")
