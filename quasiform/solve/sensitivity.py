"""Derivatives of the reported numbers by the parameters of a model, along the path of a run.

An increment solves R(x; m, p) = g(x, refresh(x, m; p); p) = 0 with the states m that the last one
has committed, and commits m' = commit(x, refresh(x, m; p); p). Beside the run, a neighbour with the
parameter p + h is followed over the same increments: from the x of the run

    K δx = -[R(x; m + δm, p + h) - R(x; m, p)],   K = ∂g/∂x + ∂g/∂m ∂refresh/∂x,

and again from x + δx where h is not small beside what is left of R. Its states are those that its
own terms commit. K is the whole tangent, not symmetric where there is friction: one factorisation
an increment, and one back-substitution a parameter. The recipe builds the model with p + h, so
every number in it is a parameter.

Derivatives are those within a branch: the points that touch, stick and slip stay the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..checks import InputError, suggestion
from ..model import Model
from ..potential import Memory, Potential
from ..result.certificate import LIFTED, certify
from ..result.outcome import Outcome, State
from ..unknowns import FloatArray, IntArray
from .linear import linear_solver, mirrored
from .parameters import Parameter, named, parameters, with_value

STEP = 3e-5  # h relative to the value of a parameter
LEFT = 1e-4  # of δx, or this much in mm times h: what a neighbour may miss
MOST = 3  # steps of a neighbour in an increment


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the numbers of a run by parameters.

    Parameters
    ----------
    parameters : dict of name to Parameter
        With their values and standings.
    outputs : dict of name to float
        The numbers at the end.
    derivatives : dict of parameter to dict of output to float
        At the end, in the unit of the output per unit of the parameter.
    along : dict of parameter to dict of column to array
        The same of the columns of the history, a value for each of its rows.
    size : float
        Of the mesh, mm.
    """

    parameters: dict[str, Parameter]
    outputs: dict[str, float]
    derivatives: dict[str, dict[str, float]]
    along: dict[str, dict[str, FloatArray]]
    size: float

    def table(self) -> dict[str, list[Any]]:
        """Columns, a row for each parameter and output; `pandas.DataFrame` takes it.

        `percent_per_percent` is the change of the output in percent by 1 % of the parameter.
        """
        rows = [
            (p.name, p.value, p.standing, output, value, rate, rate * p.value / value)
            for p in self.parameters.values()
            for output, rate in self.derivatives[p.name].items()
            if (value := self.outputs[output])
        ]
        names = "parameter", "value", "standing", "output", "at", "derivative"
        columns = zip(*rows, strict=True) if rows else [()] * 7
        return dict(zip((*names, "percent_per_percent"), map(list, columns), strict=True))


@dataclass
class Track:
    """The converged increments of a run: travel and unknowns of each, in their order."""

    increments: list[tuple[float, FloatArray]] = field(default_factory=list)

    def sensitivity(
        self, result: Outcome, chosen: Iterable[str] | None, outputs: Iterable[str] | None
    ) -> Sensitivity:
        """Derivatives of a result of this track; see `Result.sensitivity`."""
        if why := self.refused(result):
            raise InputError(f"no sensitivities: {why}")
        known, base = parameters(result.model), result.model
        asked = [named(known, name) for name in chosen or ()]
        asked = asked if chosen is not None else [p for p in known.values() if p.listed]
        steps = {p: STEP * p.value for p in asked}
        others = [with_value(base, p.name, p.value + h) for p, h in steps.items()]
        run, *beside = runs = [_Run.begin(model) for model in (base, *others)]
        wanted, rows = {s.travel for s in result.states}, list[list[dict[str, float]]]()
        if not base.resting:
            rows.append([one.columns(0.0) for one in runs])
        tangent = _WholeTangent(base, run.memory, result.settings["linear"])
        for travel, x in self.increments:
            _follow(travel, x, run, beside, tangent)
            if travel in wanted and (travel or x is result.states[0].x):
                rows.append([one.columns(travel) for one in runs])
        ends = [one.numbers(result, travel) for one in runs]
        names = self._outputs(ends[0], outputs)
        rates, along = {}, {}
        for i, (p, h) in enumerate(steps.items(), 1):
            rates[p.name] = {n: (ends[i][n] - ends[0][n]) / h for n in names}
            along[p.name] = {
                n: np.array([(row[i][n] - row[0][n]) / h for row in rows]) for n in rows[0][0]
            }
        values = {name: ends[0][name] for name in names}
        return Sensitivity({p.name: p for p in asked}, values, rates, along, base.size)

    @staticmethod
    def _outputs(known: dict[str, float], chosen: Iterable[str] | None) -> list[str]:
        chosen = list(known) if chosen is None else list(chosen)
        for name in chosen:
            if name not in known:
                raise InputError(f"unknown output '{name}': {suggestion(name, known)}")
        return chosen

    def refused(self, result: Outcome) -> str:
        """Why there are no derivatives of a result; empty where there are."""
        if result.reason:
            return f"the run was not completed: {result.reason}"
        if result.model.changed:
            return "the model was changed by hand (Model.including makes a change part of it)"
        if result.snaps:
            at = f"{result.snaps[0]['to_mm']:.4g} mm"
            return f"the sheet jumped to another state near {at}: the path has no derivative there"
        if result.parted > LIFTED * result.model.sheet.fabric.thickness:
            return (
                f"the sheet became unstable and buckled away by {result.parted:.2g} mm: which way "
                "does not depend on parameters alone"
            )
        if result.stabilisation:
            return "a rescue of the solver brought the sheet to another state on the way"
        verdict = certify(result)
        if not verdict.converged:
            return f"the run is not converged: {verdict}"
        if sum(travel > 0 for travel, _ in self.increments) != result.increments:
            return "the run was continued from a record, which does not hold all increments"
        return ""


@dataclass
class _Run:
    """Where a model has come to beside a run, with its gradient there."""

    model: Model
    x: FloatArray
    memory: Memory
    g: FloatArray

    @staticmethod
    def begin(model: Model) -> _Run:
        memory = tuple(term.initial(model.x0) for term in model.terms)
        return _Run(model, model.x0, memory, np.zeros_like(model.x0))

    def lagged(self, x: FloatArray) -> Memory:
        """States with lagged values from x."""
        return tuple(t.refresh(x, s) for t, s in zip(self.model.terms, self.memory, strict=True))

    def gradient(self, x: FloatArray, lagged: Memory) -> FloatArray:
        g = np.zeros(len(x))
        for term, state in zip(self.model.terms, lagged, strict=True):
            term.add_gradient(g, x, state)
        return g

    def commit(self, x: FloatArray, lagged: Memory, g: FloatArray) -> None:
        states = zip(self.model.terms, lagged, strict=True)
        self.x, self.g, self.memory = x, g, tuple(t.commit(x, s) for t, s in states)

    def force(self, travel: float) -> float:
        """Driving force of the whole, N."""
        model, (_, rate) = self.model, self.model.prescribed(travel)
        return float(np.where(model.fixed, rate, 0.0) @ self.g) / model.share

    def columns(self, travel: float) -> dict[str, float]:
        """Columns of the history."""
        measures = {name: measure(self.x) for name, measure in self.model.measures.items()}
        return {self.model.force_name: self.force(travel)} | measures

    def numbers(self, result: Outcome, travel: float) -> dict[str, float]:
        """Numbers at the end: the quantities of a result, and the columns of its history."""
        end = State(travel, self.x, self.force(travel), 0, {})
        found = replace(result, model=self.model, states=[end]).quantities
        return found | self.columns(travel)


def _follow(
    travel: float, x: FloatArray, run: _Run, beside: list[_Run], tangent: _WholeTangent
) -> None:
    """Bring a run and those beside it over one increment that ends at x."""
    free, place = tangent.free, run.model.prescribed(travel)[0]
    lagged = run.lagged(x)
    tangent.factor(x, run.memory, lagged)
    g = run.gradient(x, lagged)
    run.commit(x, lagged, g)
    for other in beside:
        near = x + np.where(free, 0.0, other.model.prescribed(travel)[0] - place)
        step = tangent.solve((other.gradient(near, other.lagged(near)) - g)[free])
        enough = LEFT * (np.abs(step).max(initial=0.0) + STEP)
        for _ in range(MOST):
            near = near.copy()
            near[free] -= step
            lagged = other.lagged(near)
            g_near = other.gradient(near, lagged)
            step = tangent.solve((g_near - g)[free])
            if np.abs(step).max(initial=0.0) <= enough:
                break
        other.commit(near, lagged, g_near)


class _WholeTangent:
    """The exact tangent with what lagged values add to it; not symmetric."""

    def __init__(self, model: Model, memory: Memory, linear: str) -> None:
        self.model, self.linear, self.free = model, linear, ~model.fixed
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
        for term, b, state in zip(self.model.terms, before, lagged, strict=True):
            if (more := term.through_refresh(x, b, state)) is not None:
                slots = self._slots_of(term.stencils(state))[more[0]]
                values += np.bincount(slots.ravel(), more[1].ravel(), minlength=len(values))
        self.solver.factor(values[:-1])

    def solve(self, b: FloatArray) -> FloatArray:
        return self.solver.solve(b)
