"""The cost of one iteration of Newton's method, and how much of it the linear solver takes."""

from __future__ import annotations

import time
from typing import Any

import quasiform as qf
from quasiform.solve import tangent
from quasiform.solve.increments import follow
from quasiform.solve.run import Settings

from ..tables import markdown_table

SIZES = {10.0: 2.5, 5.0: 1.8, 2.5: 1.4}  # size, mm: largest ratio that the project aims at
FACTORISATIONS = 300  # of each run that are timed
HEAD = ["size mm", "dofs", "set-up s", "factor + solve ms", "iteration ms", "ratio", "bar"]


class Timed:
    """A linear solver that adds up the processor time of its calls, s, and ends the run."""

    def __init__(self, solver: Any) -> None:
        self.solver, self.name = solver, solver.name
        self.seconds, self.count, self.begun, self.ended = 0.0, -1, 0.0, 0.0

    def factor(self, values: Any) -> int:
        if self.ended:  # of the certificate of where it stopped
            return self.solver.factor(values)
        if self.count == FACTORISATIONS:
            self.ended = time.process_time()
            raise KeyboardInterrupt
        self.count += 1
        negative = self._timed(self.solver.factor, values)
        if self.count == 0:  # this one was analysed too
            self.seconds, self.begun = 0.0, time.process_time()
        return negative

    def solve(self, b: Any) -> Any:
        return self._timed(self.solver.solve, b)

    def _timed(self, function: Any, argument: Any) -> Any:
        start = time.process_time()
        try:
            return function(argument)
        finally:
            self.seconds += time.process_time() - start


def one(size: float) -> list[float]:
    """A row of the table: the hemisphere at 0° from its first factorisation on, in one run."""
    make, solvers = tangent.linear_solver, list[Timed]()

    def timed(*given: Any) -> Timed:
        solvers.append(Timed(make(*given)))
        return solvers[-1]

    model = qf.forming("hemisphere", size=size)
    tangent.linear_solver = timed
    start = time.process_time()
    try:
        follow(model, Settings())
    finally:
        tangent.linear_solver = make
    (solver,) = solvers
    ended = solver.ended or time.process_time()  # a run of fewer factorisations
    linear = 1e3 * solver.seconds / solver.count
    whole = 1e3 * (ended - solver.begun) / solver.count
    dofs = int((~model.fixed).sum())
    return [size, dofs, solver.begun - start, linear, whole, whole / linear, SIZES[size]]


def table() -> str:
    """A Markdown table by size; of what is timed, everything but the first factorisation."""
    one(max(SIZES))  # loads what is compiled
    rows = [[f"{value:.4g}" for value in one(size)] for size in SIZES]
    return markdown_table(HEAD, rows)
