"""Error of the mesh, estimated from the same model on coarser meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy as sp  # its parts load when they are used

from ..net.edges import disc
from .measures import nodal
from .outcome import Outcome

FloatArray = np.ndarray
SAFETY = 1.25
COARSE = 3.0  # the same where there are two meshes only, too coarse for the fillets


def judged(result: Outcome, coarser: Sequence[Outcome], finer: Outcome | None = None) -> Outcome:
    """Return a result with the error of its mesh, from the same model on other meshes.

    The coarsest comes first. The end on a finer mesh is preferred where there is one. The result
    stays without an estimate where the other model is another one (a user has added terms or
    changed the travel) or stopped early, or where one of the two has collapsed. What the end
    depends on the mesh of the path (`path_gap`) is part of the estimate.
    """
    levels = [result]
    for coarse in reversed(coarser):
        if not _comparable(result, coarse):
            break
        levels.append(coarse)
    if finer is not None and not (finer.reason or finer.collapse):
        levels = [finer, *levels]
    if len(levels) < 2 or result.reason or result.collapse:
        return result
    sizes, values = [level.model.size for level in levels], [level.quantities for level in levels]
    own, coarsest = levels.index(result), result.model.coarsest
    alone = COARSE if 0 < coarsest * (1 + 1e-6) < result.model.size else SAFETY
    estimate = {
        name: float(discretisation_error([v[name] for v in values], sizes, own, alone))
        + result.path_gap.get(name, 0.0)
        for name in values[0]
        if all(name in v for v in values)
    }
    blank = result.blank
    fields = [level.shear_angle_at(blank.nodes) for level in levels]
    fields[own] = nodal(blank, result.shear_angle)
    error = discretisation_error(fields, sizes, own, alone)[blank.triangles].mean(1)
    along, force = _force_errors(result, levels), result.model.force_name
    if len(levels) == 2 and not own:
        first_order = np.abs(fields[0] - fields[1]) / (sizes[1] / sizes[0] - 1.0)
        for name, least in _differences(result, first_order).items():
            if name in estimate:  # not that of an area that is not sheared
                estimate[name] = max(estimate[name], least)
        if along is not None:
            estimate[force] = max(estimate[force], float(along[-1]))
    if along is not None:
        along[-1] = estimate[force]
    return replace(result, estimate=estimate, shear_angle_error=error, force_errors=along)


def _differences(result: Outcome, nodes: FloatArray) -> dict[str, float]:
    """Mean error of the shear angle by quantity, degrees, from that at the nodes (n_nodes,).

    Two meshes alone may agree by chance in a percentile or a mean: such a number is not better
    than the shear angle that it is made of.
    """
    blank = result.blank
    local, areas = nodes[blank.triangles].mean(1), blank.areas
    inside = {f"area_{name}_deg": disc(blank, *at) for name, at in result.model.areas.items()}
    inside |= dict.fromkeys(("shear_angle_deg", "shear_angle_mean_deg"), np.ones(len(areas), bool))
    return {
        name: float(areas[part] @ local[part] / areas[part].sum())
        for name, part in inside.items()
        if part.any()
    }


def _force_errors(result: Outcome, levels: Sequence[Outcome]) -> FloatArray | None:
    """(n_rows,) error of the force in each row of the history, N; None without a coarser path."""
    path = result.path or result
    along = [path, *(level for level in levels if level.model.size > path.model.size)]
    if len(along) < 2:
        return None
    travel = [run.states[i].travel for run, i in result.followed]
    forces = []
    for run in along:
        at = [s.travel for s in run.states]
        curve = sp.interpolate.PchipInterpolator(at, [s.force for s in run.states])
        forces.append(curve(np.clip(travel, at[0], at[-1])))
    error = discretisation_error(forces, [run.model.size for run in along])
    beside = np.pad(error, 1, mode="edge")
    wide = np.maximum.reduce([beside[:-2], error, beside[2:]])  # two curves may cross in a row
    return np.where(np.asarray(travel) > 0, wide, error)  # at rest nothing has happened yet


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


def discretisation_error(
    values: Sequence[FloatArray | float],
    sizes: Sequence[float],
    own: int = 0,
    alone: float = SAFETY,
) -> FloatArray | float:
    """Error of the mesh from the same quantity on meshes of ascending sizes, the finest first.

    `values` holds at least two numbers or (n,) arrays; the error is that of number `own`, 0 or 1.

    With one mesh that is finer, of half the size, the difference d to it shows the error:
    5/4 d (1 + r + r²), with the safety factor of the grid convergence index [1]_ and the factor r
    by which differences fall when the size is halved. r follows from the difference d' to the next
    coarser mesh: for the order p and its ratio of sizes ρ, d/d' = (1 - 2⁻ᵖ)/(ρᵖ - 1) and r = 2⁻ᵖ,
    with p between zero (where a boundary layer is not resolved yet, differences do not fall for a
    while) and one (contact reaches no more). Where two meshes happen to agree, a quarter of what d'
    says at second order, d'/(ρ² - 1), is used.

    Without one, the difference d of the two finest is continued by the factor r = d/d' by which it
    fell from the one before, over three more halvings of the mesh: error = 5/4 d (r + r² + ...).
    d' is that of the second mesh to the one nearest to ρ times its size. r is at least 1/ρ² (second
    order) and at most one: where a boundary layer is not resolved yet, differences do not fall for
    a while. Where two meshes happen to agree, d'/ρ² is used. Two meshes alone have no r:
    d/(ρ - 1) with the safety factor `alone`; [1]_ puts it at 3 where little is known of the order.

    References
    ----------
    .. [1] P. J. Roache, Journal of Fluids Engineering 116 (1994) 405-413.
    """
    steps = np.abs(np.diff(np.stack([np.asarray(v) for v in values]), axis=0))
    ratios = np.divide(sizes[1:], sizes[:-1])
    if own:
        last, r = steps[0], 0.5
        if len(steps) > own:
            before, ratio = np.maximum(steps[own], 1e-300), ratios[own]
            p = np.linspace(1.0, 1e-3, 50)
            r = np.interp(last / before, (1 - 0.5**p) / (ratio**p - 1), 0.5**p)
            last = np.maximum(last, before / (ratio**2 - 1) / 4)
        return (SAFETY * last * (1 + r + r**2))[()]
    last, ratio = steps[0], ratios[0]
    if len(values) == 2:
        return (alone * last / (ratio - 1.0))[()]
    third = 2 + int(np.argmin(np.abs(np.log(np.array(sizes[2:]) / (ratio * sizes[1])))))
    before = np.abs(np.subtract(values[1], values[third]))
    lowest = ratio**-2.0
    last = np.maximum(last, before * lowest)
    r = np.clip(np.divide(last, before, out=np.ones_like(last), where=before > 0), lowest, 1.0)
    count = max(round(np.log(8.0) / np.log(ratio)), 1)
    return (SAFETY * last * sum(r**k for k in range(1, count + 1)))[()]
