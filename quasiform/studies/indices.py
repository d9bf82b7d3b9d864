"""Sobol' indices: which share of the variance of an output comes from which key.

With the outputs f of the runs A, B and AB_i (A with key i from B) and V their variance, the first
order index is S_i = <f_B (f_AB_i - f_A)> / V (Saltelli 2010, table 2 b), the total one
T_i = <(f_A - f_AB_i)²> / 2V (Jansen), as in `scipy.stats.sobol_indices`, which takes a power of 2
of groups only. A group with a run that was not completed is left out.

References: A. Saltelli et al., Computer Physics Communications 181 (2010) 259-270.
"""

from __future__ import annotations

import numpy as np

from ..checks import number
from .answer import Answer, Solve, numbers, shortfall
from .plan import Plan

RESAMPLES = 1000
LEAST = 0.5  # of the groups that must be complete

FloatArray = np.ndarray


def answer(plan: Plan, solve: Solve) -> Answer:
    """Indices of each output, with bootstrap intervals; none where too few groups are complete."""
    study, rows = plan.study, solve(plan.jobs)
    found = [numbers(row, study.columns) for row in rows]
    size = len(study.values) + 2
    groups = [found[i : i + size] for i in range(0, len(found), size)]
    whole = [group for group in groups if None not in group]
    lines = shortfall(rows)
    if len(whole) < len(groups):
        lines.append(
            f"{len(whole)} of {len(groups)} groups of runs are complete and used: the indices are "
            "those of the part of the ranges where runs are completed"
        )
    if len(whole) < LEAST * len(groups):
        return Answer([*lines, "no indices: too few groups of runs are complete"])
    f = np.array(whole).transpose(2, 1, 0)  # output, run of the group, group
    table: dict[str, list] = {
        name: [] for name in ("output", "key", "order", "index", "low", "high")
    }
    for output, values in zip(study.columns, f, strict=True):
        if np.ptp(values) == 0:
            lines.append(f"{output} is the same in all runs")
            continue
        first, total = indices(values)
        ends = _interval(values, study.sobol.confidence, study.seed)
        for i, key in enumerate(study.values):
            for k, order in enumerate(("first", "total")):
                entry = output, key, order, (first, total)[k][i], ends[0][k][i], ends[1][k][i]
                for column, value in zip(table.values(), entry, strict=True):
                    column.append(value if isinstance(value, str) else float(value))
        words = (
            f"{key} {number(first[i], 2)} ({number(ends[0][0][i], 2)} to "
            f"{number(ends[1][0][i], 2)}), total {number(total[i], 2)}"
            for i, key in sorted(enumerate(study.values), key=lambda pair: -total[pair[0]])
        )
        lines.append(f"{output}: share of the variance by {'; '.join(words)}")
    picture = "indices", (table, len(whole), study.sobol.confidence)
    return Answer(lines, {"sobol.csv": table}, {"sobol.png": picture} if table["key"] else {})


def indices(f: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and total order (n_keys, ...) of outputs (n_keys + 2, ..., n_groups): A, B, AB_i."""
    f = f - f[:2].mean(axis=(0, -1), keepdims=True)[0]
    A, B, *AB = f
    V = np.var(f[:2], axis=(0, -1))
    first = np.stack([(B * (mixed - A)).mean(-1) for mixed in AB]) / V
    total = np.stack([((A - mixed) ** 2).mean(-1) for mixed in AB]) / (2 * V)
    return first, total


def _interval(f: FloatArray, confidence: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Ends (2, n_keys) of the intervals: percentiles over groups drawn with replacement."""
    rng = np.random.default_rng(seed)
    drawn = rng.integers(f.shape[-1], size=(RESAMPLES, f.shape[-1]))
    found = np.array(indices(f[:, drawn]))  # order, key, resample
    ends = np.quantile(found, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=-1)
    return ends[0], ends[1]
