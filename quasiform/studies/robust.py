"""How probable wrinkles, locking and limited trust are; which branches a sheet ends in.

Shares of runs with Wilson's intervals (`scipy.stats.binomtest`), which take the runs as
independent. Runs from perturbed starts at the same values are grouped into branches, by average
linkage of their end states: their distance is the root mean square of that of their nodes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
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
TRUST = "trust limited"
LIMITED = {
    "one of many states": lambda row: bool(row["summary"]["one_of_many"]),
    TRUST: lambda row: bool(row["summary"]["trust"]),
}
GOOD = "good"
NEAR = 1e-6  # mm: a node is the mirror image of another


def answer(plan: Plan, solve: Solve, fields: Callable[[str], Any]) -> Answer:
    """Shares, the process window where it is asked for, and the branches of perturbed starts."""
    robust, rows = plan.study.robust, solve(plan.jobs)
    states = STATES | {
        f"{output} > {limit:g}": partial(_exceeds, output=output, limit=limit)
        for output, limit in robust.limits.items()
    }
    good = {GOOD: lambda row: not any(so(row) for so in states.values())}
    lines = shortfall(rows)
    shares = _shares(rows, good | states | LIMITED, robust.confidence)
    for name, n, of, low, high in zip(*shares.values(), strict=True):
        lines.append(f"{name}: {n} of {of} runs, {100 * low:.3g} to {100 * high:.3g} %")
    shown = [next((name for name, so in states.items() if so(row)), GOOD) for row in rows]
    tables, pictures = {"robust.csv": shares}, {}
    if robust.window:
        places = [[job.values[key] for key in robust.window] for job in plan.jobs]
        order = [GOOD, *reversed(states)]
        limited = [completed(row) and LIMITED[TRUST](row) for row in rows]
        args = robust.window, places, shown, order, limited, shares
        pictures["window.png"] = "window", args
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
        whole = name in (GOOD, "not completed")
        known = rows if whole else [row for row in rows if completed(row)]
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
    study, starts = plan.study, plan.study.robust.starts
    keys = [key for key in plan.keys if key != START]
    names = *keys, "branch", "runs", "of", "energy_mJ", *study.columns, START, "run"
    table: dict[str, list[Any]] = {name: [] for name in names}
    lines, pairs = [], list(zip(plan.jobs, rows, strict=True))
    for first in range(0, len(rows), starts):
        ended = [pair for pair in pairs[first : first + starts] if completed(pair[1])]
        if not ended:
            continue
        values = [ended[0][0].values[key] for key in keys]
        at = ", ".join(f"{key} {value}" for key, value in zip(keys, values, strict=True))
        label, apart = _grouped([fields(job.id) for job, _ in ended], study.robust.apart)
        least = min(row["energy_mJ"] for _, row in ended)
        for k, (group, count) in enumerate(Counter(label).most_common(), 1):
            members = [pair for pair, own in zip(ended, label, strict=True) if own == group]
            job, row = min(members, key=lambda pair: pair[1]["energy_mJ"])
            energy = [f(row["energy_mJ"] for _, row in members) for f in (min, max)]
            outputs = numbers(row, study.columns) or [None] * len(study.columns)
            entry = *values, k, count, len(ended), energy[0], *outputs, job.values[START], job.id
            for column, value in zip(table.values(), entry, strict=True):
                column.append(value)
            words = f"branch {k}{f' at {at}' * bool(at)}: {count} of {len(ended)} runs"
            words += f", stored energy {' to '.join(dict.fromkeys(map(number, energy)))} mJ"
            words += " (the least)" * (energy[0] == least and len(set(label)) > 1)
            lines.append(f"{words}, as run {job.id}")
        if len(apart):
            low, high = (number(end, 2) for end in (apart.min(), apart.max()))
            lines.append(f"states of different branches are {low} to {high} mm apart")
    return table, lines


def _grouped(states: Sequence[dict[str, Any]], apart: float) -> tuple[list[int], np.ndarray]:
    """Number of the branch of each end state, and the distances (mm) of states of different ones.

    Mirror images at x = 0 and y = 0 count as the same state where the flat mesh is one of itself.
    """
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial import cKDTree
    from scipy.spatial.distance import cdist, squareform

    if len(states) < 2:
        return [1] * len(states), np.empty(0)
    flat, x = states[0]["flat"], np.array([state["points"] for state in states])
    found = []
    for flip in product((1.0, -1.0), repeat=2):
        off, index = cKDTree(flat).query(flat * flip)
        if off.max() < NEAR:
            images = x[:, index] * [*flip, 1.0]
            found.append(cdist(*(p.reshape(len(x), -1) for p in (x, images))))
    distance = np.min(found, axis=0) / np.sqrt(len(flat))
    distance = 0.5 * (distance + distance.T)
    label = fcluster(linkage(squareform(distance, checks=False), "average"), apart, "distance")
    return label.tolist(), distance[label[:, None] != label]
