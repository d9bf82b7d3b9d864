"""How probable wrinkles, locking and limited trust are; which branches a sheet ends in.

Shares of runs with Wilson's intervals (`scipy.stats.binomtest`), which take the runs as
independent. Runs from perturbed starts at the same values are grouped into branches: end states
are of one branch if their nodes are less than a distance apart (root mean square).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..checks import number
from .answer import Answer, Row, Solve, completed, numbers, shortfall
from .plan import Plan
from .run import START

STATES: dict[str, Callable[[Row], bool]] = {  # the first that is true is shown in a picture
    "not completed": lambda row: not completed(row),
    "not converged": lambda row: not row["summary"]["certificate"]["converged"],
    "wrinkled": lambda row: row["wrinkled"],
    "locked": lambda row: row["locked"],
}
LIMITED = {
    "one of many states": lambda row: bool(row["summary"]["one_of_many"]),
    "trust limited": lambda row: bool(row["summary"]["trust"]),
}
GOOD = "good"


def answer(plan: Plan, solve: Solve, fields: Callable[[str], Any]) -> Answer:
    """Shares, the process window where it is asked for, and the branches of perturbed starts."""
    robust, rows = plan.study.robust, solve(plan.jobs)
    states = STATES | {
        f"{output} > {limit:g}": partial(_exceeds, output=output, limit=limit)
        for output, limit in robust.limits.items()
    }
    lines, shares = shortfall(rows), _shares(rows, states | LIMITED, robust.confidence)
    for name, n, of, low, high in zip(*shares.values(), strict=True):
        lines.append(f"{name}: {n} of {of} runs, {100 * low:.3g} to {100 * high:.3g} %")
    shown = [next((name for name, so in states.items() if so(row)), GOOD) for row in rows]
    tables, pictures = {"robust.csv": shares}, {}
    if robust.window:
        places = [[job.values[key] for key in robust.window] for job in plan.jobs]
        if all(isinstance(value, int | float) for place in places for value in place):
            order = [GOOD, *reversed(states)]
            pictures["window.png"] = "window", (robust.window, places, shown, order, shares)
    if robust.starts:
        tables["branches.csv"], more = branches(plan, rows, fields)
        lines += more
    return Answer(lines, tables, pictures)


def _exceeds(row: Row, output: str, limit: float) -> bool:
    found = numbers(row, [output])
    return bool(found and found[0] > limit)


def _shares(
    rows: Sequence[Row], states: dict[str, Callable[[Row], bool]], confidence: float
) -> dict[str, list[Any]]:
    """How many runs are in each state, of how many, and the interval of its probability."""
    from scipy.stats import binomtest

    table: dict[str, list[Any]] = {name: [] for name in ("state", "runs", "of", "low", "high")}
    for name, so in states.items():
        known = rows if name == "not completed" else [row for row in rows if completed(row)]
        n = sum(map(so, known))
        low, high = 0.0, 1.0
        if known:
            low, high = binomtest(n, len(known)).proportion_ci(confidence, method="wilson")
        entry = name, n, len(known), float(low), float(high)
        for column, value in zip(table.values(), entry, strict=True):
            column.append(value)
    return table


def branches(
    plan: Plan, rows: Sequence[Row], fields: Callable[[str], Any]
) -> tuple[dict[str, list[Any]], list[str]]:
    """Group the end states at each place: their share, energy, and one run of each."""
    from scipy.cluster.hierarchy import fcluster, linkage

    study, starts = plan.study, plan.study.robust.starts
    keys = [key for key in plan.keys if key != START]
    table: dict[str, list[Any]] = {
        name: []
        for name in (*keys, "branch", "runs", "of", "energy_mJ", *study.columns, "start", "run")
    }
    lines = []
    for first in range(0, len(rows), starts):
        ended = [
            (job, row)
            for job, row in list(zip(plan.jobs, rows, strict=True))[first : first + starts]
            if completed(row)
        ]
        if not ended:
            continue
        x = np.array([fields(job.id)["points"] for job, _ in ended])
        flat = x.reshape(len(x), -1) / np.sqrt(x.shape[1])  # a distance is a root mean square
        label = np.ones(1, dtype=int)
        if len(ended) > 1:
            label = fcluster(linkage(flat, "average"), study.robust.apart, "distance")
        found = []
        for branch, _ in Counter(label.tolist()).most_common():
            members = [ended[i] for i in np.flatnonzero(label == branch)]
            job, row = min(members, key=lambda pair: pair[1]["energy_mJ"])
            energies = [row["energy_mJ"] for _, row in members]
            found.append((min(energies), max(energies), len(members), job, row))
        for k, (low, high, count, job, row) in enumerate(found, 1):
            values = [job.values[key] for key in keys], numbers(row, study.columns) or []
            entry = *values[0], k, count, len(ended), low, *values[1], job.values[START], job.id
            for column, value in zip(table.values(), entry, strict=True):
                column.append(value)
            at = ", ".join(f"{key} {value}" for key, value in zip(keys, values[0], strict=True))
            energy = " to ".join(dict.fromkeys((number(low), number(high))))
            words = f"branch {k}{f' at {at}' * bool(at)}: {count} of {len(ended)} runs"
            least = " (the least)" if low == min(other[0] for other in found) else ""
            lines.append(f"{words}, stored energy {energy} mJ{least}, as run {job.id}")
    return table, lines
