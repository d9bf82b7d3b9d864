"""The interface of the peers: problems, contenders, answers, rows.

A peer is a module with two functions:

    missing() -> str                      why it cannot run here; empty if it can
    problems(folder) -> list[Problem]     what is compared; `folder` takes meshes and decks

A contender is a function of such a module that solves the problem with one code and one setting and
returns an `Answer`. It runs in its own process (`once.py`), so that its solve time is measured
inside and its whole time outside, in the same way for all codes. Contenders of a problem alternate
(A B C A B C ...), and a row has the medians. Processor time is stored too: on a busy machine it is
more reliable than wall time.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
OURS = "quasiform"


@dataclass(frozen=True)
class Answer:
    """The result of one run of one code.

    Parameters
    ----------
    value : float
        The value on which the codes must agree: a force, N, or an error, degrees.
    angle : float
        Shear angle, degrees: at the centre (off-axis tension) or the largest.
    solve_s : float
        Time of the solve alone, measured by the code's own process, s.
    increments, iterations : int
        Increments of the load, and linear systems solved.
    more : dict, optional
        Further values by name.
    failed : str
        Why there is no answer; empty if there is.
    """

    value: float = float("nan")
    angle: float = float("nan")
    solve_s: float = float("nan")
    increments: int = 0
    iterations: int = 0
    more: dict[str, float] | None = None
    failed: str = ""


@dataclass(frozen=True)
class Contender:
    """One code with one setting on one problem.

    Parameters
    ----------
    code : str
    setting : str
        A description of its increments; contenders of equal setting are compared with each other.
    function : str
        Name of the function that solves, in the module of the peer.
    arguments : dict
        Its arguments, as JSON values.
    """

    code: str
    setting: str
    function: str
    arguments: dict[str, Any]


@dataclass(frozen=True)
class Problem:
    """A problem that several codes solve.

    Parameters
    ----------
    name : str
    module : str
        Module of the peer, below `validation.peers`.
    contenders : tuple of Contender
    least, most : float
        Range of the value in which codes agree.
    quantity : str
        Name of the value, with its unit.
    """

    name: str
    module: str
    contenders: tuple[Contender, ...]
    least: float
    most: float
    quantity: str = "force, N"


@dataclass(frozen=True)
class Row:
    """One line of the table: a contender with its answer and its times.

    `solve_s`, `whole_s` and `processor_s` (of the whole process, all its threads) are medians.
    `ratio` is the solve time divided by that of quasiform with the same setting, `best_ratio` that
    of the fastest row of a code divided by the fastest of quasiform; None if there is nothing to
    compare (only rows that agree are compared).
    """

    problem: str
    quantity: str
    code: str
    setting: str
    answer: Answer
    agrees: bool
    solve_s: float
    whole_s: float
    processor_s: float
    repeats: int
    ratio: float | None = None
    best_ratio: float | None = None

    @property
    def best(self) -> bool:
        """Whether this is the fastest row of its code."""
        return self.best_ratio is not None


def rows(problem: Problem, repeats: int = 3, report: Callable[[str], None] = print) -> list[Row]:
    """Run the contenders of a problem alternately and return their rows.

    Parameters
    ----------
    problem : Problem
    repeats : int
        Runs of each contender; one that has failed is not run again.
    report : callable
        Called with a line for each run.
    """
    found: list[list[Run]] = [[] for _ in problem.contenders]
    for turn in range(repeats):
        for contender, mine in zip(problem.contenders, found, strict=True):
            if mine and mine[-1].answer.failed:
                continue
            mine.append(run(problem.module, contender))
            answer = mine[-1].answer
            outcome = answer.failed or f"{answer.value:.5g}, solve {answer.solve_s:.3g} s"
            report(f"  {turn + 1}: {contender.code} {contender.setting}: {outcome}")
    return compared([_row(problem, *pair) for pair in zip(problem.contenders, found, strict=True)])


def _row(problem: Problem, contender: Contender, found: list[Run]) -> Row:
    answer = found[-1].answer
    return Row(
        problem.name,
        problem.quantity,
        contender.code,
        contender.setting,
        answer,
        not answer.failed and problem.least <= answer.value <= problem.most,
        statistics.median(one.answer.solve_s for one in found),
        statistics.median(one.whole_s for one in found),
        statistics.median(one.processor_s for one in found),
        len(found),
    )


def compared(table: list[Row]) -> list[Row]:
    """Fill in the ratios of one problem, among the rows that agree."""
    good = [row for row in table if row.agrees]
    same = {row.setting: row.solve_s for row in good if row.code == OURS}
    fastest: dict[str, Row] = {}
    for row in good:
        if row.code not in fastest or row.solve_s < fastest[row.code].solve_s:
            fastest[row.code] = row
    ours = fastest.get(OURS)
    return [
        replace(
            row,
            ratio=row.solve_s / same[row.setting] if row in good and row.setting in same else None,
            best_ratio=(
                row.solve_s / ours.solve_s if ours and row is fastest.get(row.code) else None
            ),
        )
        for row in table
    ]


@dataclass(frozen=True)
class Run:
    """One process: its answer, its wall time and processor time, s."""

    answer: Answer
    whole_s: float
    processor_s: float


def run(module: str, contender: Contender) -> Run:
    """Solve once in a fresh process."""
    command = [
        sys.executable,
        "-m",
        "validation.peers.once",
        module,
        contender.function,
        json.dumps(contender.arguments),
    ]
    before, clock = _processor_time(), time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    times = time.perf_counter() - clock, _processor_time() - before
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        return Run(Answer(failed=lines[-1]), *times)
    return Run(Answer(**json.loads(done.stdout.strip().splitlines()[-1])), *times)


def _processor_time() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def printed(answer: Answer) -> str:
    """An answer as one line for `run`."""
    return json.dumps(asdict(answer))
