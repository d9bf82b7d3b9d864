"""The values of the keys that are best, by runs one after the other.

Sobol' points are spread over the ranges first. From the best of them on, COBYQA
(`scipy.optimize`) follows quadratic models of the aim and of the limits through its runs, without
derivatives. Values are rounded, so that a search that is started again takes its finished runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from ..checks import number
from ..result.summary import error_column
from ..toml_file import dotted_values
from .answer import Answer, Row, Solve, numbers, shortfall
from .plan import Job, Plan
from .questions import Optimise

DIGITS = 6  # of a value relative to its range
FIRST = 0.2  # of the ranges: step of the search at its start
FEASIBLE = 1e-3  # of a limit: by how much it may be exceeded
WORSE = 1.0  # times the range of the aim: what a run without an output counts more than the worst


class EnoughError(Exception):
    """All runs that a search may have are done."""


class _Search:
    """Runs of a search, each solved once."""

    def __init__(self, plan: Plan, solve: Solve) -> None:
        self.plan, self.solve, self.asked = plan, solve, plan.study.optimise
        self.rows = dict(zip((job.id for job in plan.jobs), solve(plan.jobs), strict=True))

    def job(self, u: Sequence[float]) -> Job:
        """The run at a point of the unit cube."""
        points = np.clip(np.round(u, DIGITS), 0.0, 1.0).tolist()
        keys = self.plan.study.values.items()
        values = {name: key.at(v) for (name, key), v in zip(keys, points, strict=True)}
        return self.plan.described(values)

    def at(self, u: Sequence[float]) -> tuple[float, list[float]]:
        """Aim and limits at a point of the unit cube; the run is solved if it is new."""
        if (job := self.job(u)).id not in self.rows:
            if len(self.plan.jobs) >= self.asked.runs:
                raise EnoughError
            self.plan.jobs.append(job)
            self.rows[job.id] = self.solve([job])[0]
        return self.judged(self.rows[job.id])

    def judged(self, row: Row) -> tuple[float, list[float]]:
        """Aim, and by how much the limits are exceeded; bad values where there is no output."""
        if found := aim(self.asked, row):
            return found
        known = [aim(self.asked, other) for other in self.rows.values()]
        aims = [value[0] for value in known if value]
        worst = max(aims) + WORSE * (np.ptp(aims) or abs(max(aims)) or 1.0)
        return float(worst), [1.0] * len(self.asked.limits)

    def best(self, converged: bool = False) -> tuple[Job, Row] | None:
        """The run with the best aim within the limits; else that which exceeds them least."""

        def rank(pair: tuple[Job, Row]) -> tuple[float, float]:
            value, over = self.judged(pair[1])
            excess = max(over, default=0.0)
            return max(excess, 0.0) * (excess > FEASIBLE), value

        runs = [(job, self.rows[job.id]) for job in self.plan.jobs]
        known = [
            (job, row)
            for job, row in runs
            if aim(self.asked, row)
            and (row["summary"]["certificate"]["converged"] or not converged)
        ]
        return min(known, key=rank, default=None)


def aim(asked: Optimise, row: Row) -> tuple[float, list[float]] | None:
    """What is to be small, and by how much each limit is exceeded relative to it.

    None without the outputs.
    """
    names = list(asked.target or [asked.least or asked.most])
    found = numbers(row, [*names, *asked.limits])
    if found is None:
        return None
    values, limited = np.array(found[: len(names)]), found[len(names) :]
    over = [
        (value - limit) / (abs(limit) or 1.0)
        for value, limit in zip(limited, asked.limits.values(), strict=True)
    ]
    if asked.target:
        wanted = np.array(list(asked.target.values()))
        return float(np.sqrt(np.mean((values / wanted - 1.0) ** 2))), over
    return float(-values[0] if asked.most else values[0]), over


def answer(plan: Plan, solve: Solve) -> Answer:
    """Search, and say which run is best."""
    from scipy.optimize import NonlinearConstraint, minimize

    search, asked = _Search(plan, solve), plan.study.optimise
    if not any(aim(asked, row) for row in search.rows.values()):
        return Answer([*shortfall([*search.rows.values()]), "no run to start the search from"])
    first, scale = search.best()[0], np.ptp(aims(search)) or 1.0
    limits = NonlinearConstraint(lambda u: search.at(u)[1], -np.inf, 0.0)
    with suppress(EnoughError):
        minimize(
            lambda u: search.at(u)[0] / scale,
            _place(plan, first),
            method="COBYQA",
            bounds=[(0.0, 1.0)] * len(plan.study.values),
            constraints=limits if asked.limits else (),
            options={"initial_tr_radius": FIRST, "final_tr_radius": asked.tolerance},
        )
    return _found(search, first)


def aims(search: _Search) -> list[float]:
    """Aims of the runs in their order."""
    return [search.judged(search.rows[job.id])[0] for job in search.plan.jobs]


def _place(plan: Plan, job: Job) -> list[float]:
    """Point of the unit cube that a run is at."""
    from scipy.optimize import brentq

    keys = plan.study.values.items()
    return [brentq(lambda u, k=k, n=n: k.at(u) - job.values[n], 0.0, 1.0) for n, k in keys]


def _found(search: _Search, first: Job) -> Answer:
    plan, asked = search.plan, search.asked
    (job, row), count = search.best(), len(plan.jobs)
    names = list(asked.target or [asked.least or asked.most])
    over = max(search.judged(row)[1], default=0.0)
    lines = shortfall(list(search.rows.values()))
    lines.append(f"best of {count} runs: {_shown(job, row, [])}")
    for name, value in zip(names, numbers(row, names), strict=True):
        error = dotted_values(row["summary"]).get(error_column(name))
        words = f"{name} {number(value)}" + (f" ± {number(error, 2)} mesh" if error else "")
        begun = numbers(search.rows[first.id], [name])[0]
        words += f", {number(asked.target[name])} wanted" if asked.target else ""
        words += f"; {number(begun)} in the best of the first {asked.start} runs"
        if error and 0 < abs(begun - value) < error:
            words += ", a difference within the mesh error"
        lines.append(words)
    for name, limit in asked.limits.items():
        lines.append(f"{name} {number(numbers(row, [name])[0])}, at most {limit:g} wanted")
    if over > FEASIBLE:
        lines.append("no run keeps all limits: this one exceeds them least")
    at = dict(zip(job.values, _place(plan, job), strict=True))
    if ends := [key for key, u in at.items() if min(u, 1 - u) < asked.tolerance]:
        lines.append(f"at the end of the range of {', '.join(ends)}: a wider range may be better")
    if not row["summary"]["certificate"]["converged"]:
        other = search.best(converged=True)
        words = "none is" if other is None else f"the best that is: {_shown(*other, names)}"
        lines.append(f"this run is not converged; {words}")
    words = " and ".join(names)
    words = "relative deviation from the target" if asked.target else words
    values = [-a if asked.most else a for a in aims(search)]
    kept = [max(search.judged(search.rows[j.id])[1], default=0.0) <= FEASIBLE for j in plan.jobs]
    index = [j.id for j in plan.jobs].index(job.id)
    columns = {key: [j.values[key] for j in plan.jobs] for key in plan.keys}
    picture = "search", (words, values, kept, index, asked.start, columns)
    return Answer(lines, {}, {"optimise.png": picture})


def _shown(job: Job, row: Row, names: Sequence[str]) -> str:
    """Values of the keys of a run, and some of its outputs."""
    entries = [*job.values.items(), *zip(names, numbers(row, names), strict=True)]
    return f"{', '.join(f'{name} = {number(v, 5)}' for name, v in entries)} (run {job.id})"
