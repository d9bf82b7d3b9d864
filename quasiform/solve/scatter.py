"""What is robust about a state: the same model solved again with noise on every increment.

A sheet that wrinkles, bands or snaps has many states of equilibrium, and which one is found hangs
on what no model knows. Quantities that scatter within the estimated error of the mesh are robust;
the others are one sample. A large error of the mesh makes nothing robust: nothing is judged then.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..checks import check_number
from ..result.certificate import small
from ..result.run import Result
from .increments import Callback, follow, report
from .run import Settings

AMPLITUDE = 0.01 / 1.004  # of the thickness


def spread(
    result: Result,
    seeds: Sequence[int] = (1, 2, 3),
    amplitude: float | None = None,
    callback: Callback | None = None,
) -> dict[str, dict[str, float | bool]]:
    """Solve a model again from perturbed starts, and keep the scatter in the result.

    Where only the end was solved on the finest mesh, the path on the coarser one is repeated.

    Parameters
    ----------
    result : Result
        Its `spread` and `lower` are set.
    seeds : sequence of int
        One more run each.
    amplitude : float, optional
        Standard deviation of the noise on the nodes, mm; by default 1 % of the thickness.
    callback : callable, optional
        Its methods `stage` and `step` are called as in `solve`.

    Returns
    -------
    dict by quantity
        `low` and `high` over all runs, the unperturbed one too; `stopped`, how many did not reach
        the end and are left out; `judged`: whether the estimated error of the mesh is small (5 % of
        the value, 2 degrees, 0.1 of the thickness, or 0.2 % of the loads that rest on the sheet);
        and `robust`: judged, and half the range is within this error (within 1 % where there is no
        estimate).
    """
    if amplitude is None:
        amplitude = AMPLITUDE * result.model.sheets[0].fabric.thickness
    check_number("amplitude", amplitude)
    base = result.path or result
    known = {"increment", "method", "linear", "tolerance", "convex"}
    given = {name: value for name, value in base.settings.items() if name in known}
    runs = [base]
    for i, seed in enumerate(seeds, 1):
        within = report(callback, f"perturbed start {i} of {len(seeds)}")
        settings = Settings(**given, perturbation=amplitude, seed=seed)
        runs.append(follow(base.model, settings, within, partial=False))
    ended = [run for run in runs if run.states[-1].travel == base.states[-1].travel]
    waves = [{k: v for k, v in run.wrinkles.items() if v is not None} for run in ended]
    found = [run.quantities | more for run, more in zip(ended, waves, strict=True)]
    table = {}
    for name in found[0]:
        values = [quantities[name] for quantities in found if name in quantities]
        low, high = min(values), max(values)
        error = result.estimate.get(name)
        allowed = 0.01 * max(abs(low), abs(high)) if error is None else error
        judged = allowed <= small(result.model, name, result.quantities.get(name, high))
        table[name] = {
            "low": low,
            "high": high,
            "judged": bool(judged),
            "robust": bool(judged and len(values) == len(found) and 0.5 * (high - low) <= allowed),
            "stopped": len(runs) - len(ended),
        }
    result.spread, result.lower = table, base.energy - min(run.energy for run in ended)
    return table
