"""Derivatives of the reported numbers by the parameters of a model, along the path of a run.

An increment solves R(x; m, p) = g(x, refresh(x, m; p); p) = 0 with the states m that the last one
has committed, and commits m' = commit(x, refresh(x, m; p); p). Beside the run, a neighbour with the
parameter p + h is followed over the same increments: from the x of the run

    K δx = -[R(x; m + δm, p + h) - R(x; m, p)],   K = ∂g/∂x + ∂g/∂m ∂refresh/∂x,

and again from x + δx where that leaves a residual. Its own terms commit its states. K is the whole
tangent, not symmetric where there is friction: one or two factorisations an increment (the first
brings x to R = 0), and one or two back-substitutions a parameter. The recipe builds the model with
p + h, so every number in it is a parameter.

Derivatives are those within a branch: the points that touch, stick and slip stay the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..checks import InputError, suggestion
from ..model import Model
from ..potential import Memory, Potential
from ..result.certificate import buckled_away, certify, one_of_many
from ..result.outcome import Outcome
from ..unknowns import FloatArray, IntArray
from .linear import linear_solver, mirrored
from .parameters import CLOSE, STEP, Parameter, named, parameters, with_value

LEFT = 1e-4  # of the first step of a neighbour: after a shorter one nothing is evaluated anew
MOST = 4  # steps of a neighbour in an increment
ROUND_OFF = 1e-12  # mm, of unknowns
NEWTON, NEAR = 8, 1e-6  # factorisations an increment at most, and the step in mm that ends them
FAR = 1.0  # mm: a step as long does not end nearby
RATE = 1e-4  # mm of travel, by which the rate of motion is found
JUMPED = 0.15  # of the motion in an increment: what the rates at both ends may miss of it


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the numbers of a run by parameters.

    Parameters
    ----------
    parameters : dict of name to Parameter
        With their values and standings.
    derivatives : dict of parameter to dict of output to float
        At the end, in the unit of the output per unit of the parameter.
    along : dict of parameter to dict of column to array
        The same of the columns of the history, a value for each of its rows.
    """

    parameters: dict[str, Parameter]
    derivatives: dict[str, dict[str, float]]
    along: dict[str, dict[str, FloatArray]]

    def table(self) -> dict[str, list[Any]]:
        """Columns, one row a parameter and output; `pandas.DataFrame` takes it.

        `by_percent` is the change of the output by 1 % of the parameter.
        """
        names = "parameter", "value", "standing", "output", "derivative", "by_percent"
        rows = [
            (p.name, p.value, p.standing, output, rate, 0.01 * p.value * rate)
            for p in self.parameters.values()
            for output, rate in self.derivatives[p.name].items()
        ]
        return {name: [row[i] for row in rows] for i, name in enumerate(names)}

    def errors(self, given: Mapping[str, float]) -> dict[str, dict[str, float]]:
        """Change of each output by what each parameter is uncertain by, in its own unit."""
        by = {named(self.parameters, name).name: error for name, error in given.items()}
        outputs = next(iter(self.derivatives.values()), {})
        return {
            output: {name: abs(self.derivatives[name][output] * e) for name, e in by.items()}
            for output in outputs
        }


@dataclass
class Track:
    """The converged increments of a run: travel and unknowns of each, in their order."""

    increments: list[tuple[float, FloatArray]] = field(default_factory=list)

    def sensitivity(
        self, result: Outcome, chosen: Iterable[str] | None, outputs: Iterable[str] | None
    ) -> Sensitivity:
        """Derivatives of a result of this track; see `Result.sensitivity`."""
        if why := self._refused(result):
            raise InputError(f"no sensitivities: {why}")
        base, known = result.model, parameters(result.model)
        asked = [p for p in known.values() if p.listed]
        asked = asked if chosen is None else [named(known, name) for name in chosen]
        step = CLOSE if base.contacts else STEP
        steps = {p.name: step * p.value for p in asked}
        others = [with_value(base, p.name, p.value + steps[p.name]) for p in asked]
        runs = [_Run.begin(model) for model in (base, *others)]
        rows = self._followed(runs, result)
        ends = [run.numbers(result, rows[-1][i]) for i, run in enumerate(runs)]
        names = list(ends[0]) if outputs is None else list(outputs)
        if unknown := [name for name in names if name not in ends[0]]:
            raise InputError(f"unknown output '{unknown[0]}': {suggestion(unknown[0], ends[0])}")
        rates, along = {}, {}
        for i, (name, h) in enumerate(steps.items(), 1):
            rates[name] = {n: (ends[i][n] - ends[0][n]) / h for n in names}
            along[name] = {n: np.array([(r[i][n] - r[0][n]) / h for r in rows]) for n in rows[0][0]}
        return Sensitivity({p.name: p for p in asked}, rates, along)

    def _followed(self, runs: list[_Run], result: Outcome) -> list[list[dict[str, float]]]:
        """Columns of the history of each run in the states of a result; the runs are at its end."""
        run, tangent = runs[0], _WholeTangent(runs[0].model, runs[0].memory, result.settings)
        wanted, last = {state.travel for state in result.states}, None
        columns = {0.0: [one.columns(0.0) for one in runs]}
        for travel, x in self.increments:
            rate = _follow(travel, x, runs, tangent)
            if last and travel > last[0]:
                _check_motion(run.model, last, (travel, x, rate))
            last = travel, x, rate
            if travel in wanted:
                columns[travel] = [one.columns(travel) for one in runs]
        return [columns[state.travel] for state in result.states]

    def _refused(self, result: Outcome) -> str:
        """Why there are no derivatives of a result; empty where nothing speaks against them."""
        if result.reason:
            return f"the run was not completed: {result.reason}"
        if result.model.changed:
            return "the model was changed by hand (Model.including makes a change part of it)"
        if result.model.strokes or result.model.pressures:
            return "tools with a stroke and pressures are not followed"
        if result.snaps:
            at = f"{result.snaps[0]['to_mm']:.4g} mm"
            return f"the sheet jumped to another state near {at}: there the path has no derivative"
        if buckled_away(result):
            words = f"the sheet became unstable and buckled away, by {result.parted:.2g} mm"
            return f"{words}: there the path has no derivative"
        if result.stabilisation:
            return "a rescue of the solver brought the sheet to another state"
        if result.spread and (many := one_of_many(result)):
            return many
        if not (verdict := certify(result)).converged:
            return f"the run is not converged: {verdict}"
        if sum(travel > 0 for travel, _ in self.increments) != result.increments:
            return "the run was continued from a record, which does not hold all increments"
        return ""


At = tuple[FloatArray, Memory, FloatArray]


@dataclass
class _Run:
    """Where a model has come to beside a run."""

    model: Model
    x: FloatArray
    memory: Memory

    @staticmethod
    def begin(model: Model) -> _Run:
        memory = tuple(term.initial(model.x0) for term in model.terms)
        return _Run(model, model.x0, memory)

    def at(self, x: FloatArray) -> At:
        """x, states with lagged values from there, and the gradient (n_dofs,), N."""
        states = zip(self.model.terms, self.memory, strict=True)
        lagged = tuple(term.refresh(x, state) for term, state in states)
        return x, lagged, self._gradient(x, lagged)

    def _gradient(self, x: FloatArray, memory: Memory) -> FloatArray:
        g = np.zeros(len(x))
        for term, state in zip(self.model.terms, memory, strict=True):
            term.add_gradient(g, x, state)
        return g

    def commit(self, x: FloatArray, lagged: Memory) -> None:
        """Come to x."""
        states = zip(self.model.terms, lagged, strict=True)
        self.x, self.memory = x, tuple(term.commit(x, state) for term, state in states)

    def force(self, travel: float) -> float:
        """Driving force of the whole with the committed states, N."""
        model, (_, rate) = self.model, self.model.prescribed(travel)
        g = self._gradient(self.x, self.memory)
        return float(np.where(model.fixed, rate, 0.0) @ g) / model.share

    def columns(self, travel: float) -> dict[str, float]:
        """Columns of the history."""
        measures = {name: measure(self.x) for name, measure in self.model.measures.items()}
        return {self.model.force_name: self.force(travel)} | measures

    def numbers(self, result: Outcome, columns: dict[str, float]) -> dict[str, float]:
        """Numbers at the end: the quantities of a result, and the columns of its history."""
        force = columns[self.model.force_name]
        end = replace(result.states[-1], x=self.x, force=force)
        return replace(result, model=self.model, states=[end]).quantities | columns


def _follow(travel: float, x: FloatArray, runs: list[_Run], tangent: _WholeTangent) -> FloatArray:
    """Bring a run and those beside it over an increment that ends at x; the rate of motion there.

    The rate (n_dofs,) is the derivative of x by the travel.
    """
    run, *beside = runs
    free, (place, rate) = tangent.free, run.model.prescribed(travel)
    x, lagged, g = _polished(run, x, tangent)
    moved = np.where(free, 0.0, RATE * rate)
    moved[free] = -tangent.solve((run.at(x + moved)[2] - g)[free])
    run.commit(x, lagged)
    starts = [x + np.where(free, 0.0, r.model.prescribed(travel)[0] - place) for r in beside]
    _bring(beside, starts, g, tangent)
    return moved / RATE


def _polished(run: _Run, x: FloatArray, tangent: _WholeTangent) -> At:
    """Newton's method to where lagged values are those of x itself; the tangent is that there.

    A run leaves a residual, and anchors friction at its iterates. Where Newton's method does not
    end nearby, x is kept.
    """
    here = end = run.at(x)
    for _ in range(NEWTON):
        tangent.factor(end[0], run.memory, end[1])
        step = tangent.solve(end[2][tangent.free])
        length = np.abs(step).max(initial=0.0)
        if length < NEAR:
            return end
        if not length < FAR:
            break
        near = end[0].copy()
        near[tangent.free] -= step
        end = run.at(near)
    tangent.factor(x, run.memory, here[1])
    return here


def _bring(
    runs: list[_Run], starts: list[FloatArray], wanted: FloatArray, tangent: _WholeTangent
) -> None:
    """Solve for the free gradient `wanted` (n_dofs,) in each run, from where it starts; commit."""
    free, ends = tangent.free, [run.at(x) for run, x in zip(runs, starts, strict=True)]
    left = np.arange(len(runs))
    enough = np.zeros(len(runs))
    for _ in range(MOST):
        if not len(left):
            break
        steps = tangent.solve(np.stack([(ends[i][2] - wanted)[free] for i in left], axis=1))
        for i, step in zip(left, steps.T, strict=True):
            x = ends[i][0].copy()
            x[free] -= step
            ends[i] = x, *ends[i][1:]
        longest = np.abs(steps).max(axis=0, initial=0.0)
        left = left[longest > enough[left]]  # the last step of the others is too short to matter
        for i in left:
            ends[i] = runs[i].at(ends[i][0])
        enough = enough if enough.any() else LEFT * longest + ROUND_OFF
    for run, (x, lagged, _) in zip(runs, ends, strict=True):
        run.commit(x, lagged)


End = tuple[float, FloatArray, FloatArray]  # of an increment: travel, unknowns, rate of motion


def _check_motion(model: Model, start: End, end: End) -> None:
    """Refuse an increment whose motion is not that of the rates at both ends (trapezoidal rule)."""
    (s, x, rate), (s_end, x_end, rate_end) = start, end
    nodes = model.unknowns.at_nodes()
    motion = (x_end - x)[nodes]
    missed = motion - 0.5 * (s_end - s) * (rate + rate_end)[nodes]
    most = float(np.abs(missed).max())
    smooth = np.linalg.norm(missed) <= JUMPED * np.linalg.norm(motion)
    if not smooth and most > model.sheet.fabric.thickness:
        raise InputError(
            f"no sensitivities: between {s:.4g} and {s_end:.4g} mm of travel the sheet moved by up "
            f"to {most:.2g} mm that its rates of motion at both ends do not explain: it jumped or "
            f"turned to another state (smaller increments show which, a run to {s:.4g} mm has them)"
        )


class _WholeTangent:
    """The exact tangent with what lagged values add to it; not symmetric."""

    def __init__(self, model: Model, memory: Memory, settings: dict[str, Any]) -> None:
        self.model, self.linear, self.free = model, settings["linear"], ~model.fixed
        self.potential = Potential(model.terms, self.free, memory)
        self.number = np.where(self.free, np.cumsum(self.free) - 1, -1)
        self._lay_out()

    def _lay_out(self) -> None:
        self.pattern, self.source = mirrored(self.potential.pattern)
        n = self.pattern.shape[0]
        rows = np.repeat(np.arange(n), np.diff(self.pattern.indptr))
        self.keys = rows * n + self.pattern.indices
        self.slots: dict[int, IntArray] = {}
        places = self.model.unknowns.places()[self.free]
        self.solver = linear_solver(self.linear, self.pattern, places, symmetric=False)

    def _slots_of(self, dofs: IntArray) -> IntArray:
        """(n_stencils, k, k) places of a stencil's pairs in the pattern, the last: prescribed."""
        if (known := self.slots.get(id(dofs))) is None:
            number = self.number[dofs]
            i, j = number[:, :, None], number[:, None, :]
            known = np.searchsorted(self.keys, i * self.pattern.shape[0] + j)
            known = self.slots[id(dofs)] = np.where((i < 0) | (j < 0), len(self.keys), known)
        return known

    def factor(self, x: FloatArray, before: Memory, lagged: Memory) -> None:
        """Factorise at x with lagged values that were refreshed from the states `before`."""
        if self.potential.follow(lagged):
            self._lay_out()
        values = np.append(self.potential.hessian(x, lagged, False)[0][self.source], 0.0)
        slots, more = [], []
        for term, b, state in zip(self.model.terms, before, lagged, strict=True):
            if (found := term.through_refresh(x, b, state)) is not None:
                slots.append(self._slots_of(term.stencils(state))[found[0]].ravel())
                more.append(found[1].ravel())
        if slots:
            values += np.bincount(np.concatenate(slots), np.concatenate(more), len(values))
        self.solver.factor(values[:-1])

    def solve(self, b: FloatArray) -> FloatArray:
        return self.solver.solve(b)
