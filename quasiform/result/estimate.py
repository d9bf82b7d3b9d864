"""Error of the mesh, estimated from the same model on coarser meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .measures import nodal
from .outcome import Outcome

FloatArray = np.ndarray


def judged(result: Outcome, coarser: Sequence[Outcome]) -> Outcome:
    """Return a result with the error of its mesh, from the same model on coarser meshes.

    The coarsest comes first, each is of twice the size of the next. It stays without an estimate
    where the coarse model is another one (a user has added terms or changed the travel) or stopped
    early, or where one of the two has collapsed.
    """
    levels = [result]
    for coarse in reversed(coarser):
        if not _comparable(result, coarse):
            break
        levels.append(coarse)
    if len(levels) < 2 or result.reason or result.collapse:
        return result
    values = [level.quantities for level in levels]
    estimate = {
        name: float(discretisation_error([v[name] for v in values]))
        for name in values[0]
        if all(name in v for v in values)
    }
    blank = result.blank
    fields = [nodal(blank, result.shear_angle)]
    fields += [level.shear_angle_at(blank.nodes) for level in levels[1:]]
    error = discretisation_error(fields)[blank.triangles].mean(1)
    return replace(result, estimate=estimate, shear_angle_error=error)


def _comparable(fine: Outcome, coarse: Outcome) -> bool:
    names = [
        [term.name for term in result.model.terms if "between" not in term.name]
        for result in (fine, coarse)
    ]
    return (
        names[0] == names[1]
        and fine.model.fixed.sum() >= coarse.model.fixed.sum()
        and fine.states[-1].travel == coarse.states[-1].travel
        and not (coarse.reason or coarse.collapse)
    )


def discretisation_error(values: Sequence[FloatArray | float]) -> FloatArray | float:
    """Error of the mesh from the same quantity on meshes that double in size, finest first.

    The differences between the levels are continued by the ratio r of the last two, over three
    more halvings: error = 5/4 d (r + r² + r³), with the safety factor of the grid convergence
    index [1]_. r is kept between a quarter (second order) and two: where a boundary layer is not
    resolved yet, differences grow for a while. Where two levels happen to agree, the quarter of the
    difference before is used. Two levels alone have no ratio: the error is twice their
    difference.

    `values` holds at least two numbers or (n,) arrays.

    References
    ----------
    .. [1] P. J. Roache, Journal of Fluids Engineering 116 (1994) 405-413.
    """
    last = np.abs(np.subtract(values[0], values[1]))
    if len(values) == 2:
        return 2.0 * last
    before = np.abs(np.subtract(values[1], values[2]))
    last = np.maximum(last, before / 4)
    r = np.clip(np.divide(last, before, out=np.ones_like(last), where=before > 0), 0.25, 2.0)
    return (1.25 * last * (r + r**2 + r**3))[()]
