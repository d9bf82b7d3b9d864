"""The cost of one iteration of Newton's method, and how much of it the linear solver takes."""

from __future__ import annotations

import time
from typing import Any

import quasiform as qf
from quasiform.solve.increments import follow
from quasiform.solve.run import Settings

from ..tables import markdown_table

SIZES = {10.0: 2.5, 5.0: 1.8, 2.5: 1.4}  # size, mm: largest ratio that the project aims at
FACTORISATIONS = 300  # of each run that are timed
HEAD = ["size mm", "dofs", "set-up s", "factor + solve ms", "iteration ms", "ratio", "bar"]


class Timed:
    """A linear solver that adds up the seconds of its calls."""

    def __init__(self, solver: Any) -> None:
        self.solver, self.name, self.seconds = solver, solver.name, 0.0

    def factor(self, values: Any) -> int:
        return self._timed(self.solver.factor, values)

    def solve(self, b: Any) -> Any:
        return self._timed(self.solver.solve, b)

    def _timed(self, function: Any, argument: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(argument)
        finally:
            self.seconds += time.perf_counter() - start


def one(size: float) -> list[float]:
    """A row of the table: the hemisphere at 0° from its first increment on, in one run."""
    from quasiform.solve import tangent

    make, solvers = tangent.linear_solver, list[Timed]()

    def timed(*given: Any) -> Timed:
        solvers.append(Timed(make(*given)))
        return solvers[-1]

    marks: list[tuple[float, float, int]] = []

    def callback(progress: Any) -> bool:
        linear = sum(solver.seconds for solver in solvers)
        marks.append((time.perf_counter(), linear, progress.linear_solves))
        return progress.linear_solves > FACTORISATIONS

    model = qf.forming("hemisphere", size=size)
    tangent.linear_solver = timed
    start = time.perf_counter()
    try:
        follow(model, Settings(), callback)
    finally:
        tangent.linear_solver = make
    (begun, *first), (ended, *last) = marks[0], marks[-1]
    count = last[1] - first[1]
    linear, whole = 1e3 * (last[0] - first[0]) / count, 1e3 * (ended - begun) / count
    dofs = int((~model.fixed).sum())
    return [size, dofs, begun - start, linear, whole, whole / linear, SIZES[size]]


def table() -> str:
    """A Markdown table by size; what is timed is everything between two increments."""
    rows = [[f"{value:.4g}" for value in one(size)] for size in SIZES]
    return markdown_table(HEAD, rows)
