"""About how long a run will take, before it is started.

One Newton step of the model is timed here and now, on each mesh that will be solved; how many
there will be is what runs of the built-in scenes took. That count is the rough part: a sheet that
buckles takes many times as many as one that does not, which nobody can know before.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..checks import InputError
from ..model import Model
from ..result.certificate import too_coarse, too_long
from ..scenes.forming import FINE as RESOLVES
from ..solve import levels
from ..solve.dependence import COARSER, FINER
from ..solve.equilibrium import Equilibrium, NotConvergedError

if TYPE_CHECKING:
    from ..studies.plan import Job, Plan

# factorisations for each largest increment of the travel, geometric means of runs: 9 of hemisphere,
# tetrahedron and box at sizes of 5 to 20 mm (17 to 107), 3 of off-axis tension (6 to 17)
WITH_TOOLS, IN_PLANE = 36.0, 9.0
CARRIED = 62.0  # for the end on a finer mesh (34 to 194)
COST = 1.5  # time of a factorisation in a run, with all that belongs to it, by that timed here
LEAST, MOST = 0.3, 6.0  # of the expected time: between them lay those runs
TIMED, LONG = 3, 0.1  # steps that are timed, fewer where they take so many seconds


class Mesh(NamedTuple):
    """A mesh that will be solved: its size, mm, unknowns, linear solves, and s for each."""

    size: float
    dofs: int
    solves: float
    seconds: float


def meshes(
    model: Model,
    one_mesh: bool,
    linear: str = "auto",
    seeds: int | None = 0,
    increment: float | None = None,
    estimate: bool | str = True,
) -> tuple[Mesh, ...] | None:
    """Meshes that a run will solve; None where the model has no tangent at its start.

    With `one_mesh` the whole path is on the model's mesh, as `solve` does, else its end only, as
    `refine` does; `seeds` perturbed runs of the path come after it. Increment (mm) and estimate are
    those of `solve`.
    """
    increments = model.travel / max(increment or 0.0, model.increment)
    path = (WITH_TOOLS if model.contacts else IN_PLANE) * max(increments, 1.0)
    models = [model] if one_mesh else levels.meshes(model)
    solves = [path * (1 + (seeds or 0)), *[CARRIED] * (len(models) - 1)]
    with suppress(InputError):  # too coarse for the blank, or the user's own mesh
        if estimate and not model.changed:
            again = 2 if model.contacts and estimate is True else 1  # in-plane bending
            others = [(COARSER, again * path)]
            others += [(FINER, CARRIED)] * (len(models) == 1 and estimate is True)
            for ratio, count in others:
                models.append(model.recipe.build(ratio * models[0].size, like=model))
                solves.append(count)
    try:
        return tuple(
            Mesh(one.size, int((~one.fixed).sum()), count, COST * _step(one, linear))
            for one, count in zip(models, solves, strict=True)
        )
    except NotConvergedError:
        return None


def words(found: tuple[Mesh, ...] | None) -> str:
    """Return the expected time as text."""
    if found is None:
        return "not known: the model has no tangent at its start"
    seconds = sum(mesh.solves * mesh.seconds for mesh in found)
    *first, last = (f"{mesh.size:.3g}" for mesh in found)
    sizes = f"{', '.join(first)} and {last}" if first else last
    return (
        f"about {duration(seconds)} on this machine as busy as it is now, up to "
        f"{duration(MOST * seconds)} where the sheet buckles; meshes: {sizes} mm"
    )


def limits(model: Model, options: Mapping[str, Any]) -> list[str]:
    """What will keep a run from a certificate, as far as it is known before."""
    found, radius = [], model.coarsest / RESOLVES
    size = max(sheet.blank.size for sheet in model.sheets)
    if 0 < radius and too_coarse(size, radius):
        found.append(
            f"a mesh of {size:.3g} mm is too coarse for the smallest radius of the tools, "
            f"{radius:.3g} mm, if the sheet bends over it: half of it is allowed"
        )
    if longer := too_long(model, options["increment"]):
        found.append(longer)
    return found


def asked(model: Model, options: Mapping[str, Any]) -> tuple[Mesh, ...] | None:
    """Meshes of a run with the options of `solve.asked`, as `meshes`."""
    names = "one_mesh", "linear", "seeds", "increment", "estimate"
    return meshes(model, *(options[name] for name in names))


def study(plan: Plan, jobs: Sequence[Job], rows: Mapping[str, Any]) -> str:
    """Return how many runs a study has still to solve, and how long they will take, as text."""
    impossible = sum(bool(job.error) for job in plan.jobs)
    text = f"{len(plan.jobs)} runs" + f", {impossible} of them impossible" * bool(impossible)
    text += f", {len(jobs)} to solve"
    if (search := plan.study.optimise or plan.study.trim) is not None:
        text += f" first, {search.runs} in all at most"
    if not jobs:
        return text
    taken = [row["cpu_s"] for row in rows.values() if row.get("cpu_s")]
    seconds = float(np.mean(taken)) if taken else None
    if seconds is None:
        model, options = plan.first
        found = asked(model, options)
        seconds = sum(mesh.solves * mesh.seconds for mesh in found) if found else None
    if seconds is None:
        return f"{text}; the time is not known: the first model has no tangent at its start"
    hours = len(jobs) * seconds / 3600
    source = f"as {len(taken)} that are finished" if taken else "as the first"
    ends = "" if taken else f" ({hours * LEAST:.2g} to {hours * MOST:.2g})"
    return f"{text}: about {hours:.2g} processor hours{ends}, {duration(seconds)} a run, {source}"


def duration(seconds: float) -> str:
    """Return a time as text, no sharper than it is known.

    Examples
    --------
    >>> [duration(s) for s in (0.03, 4.4, 57, 312, 9000)]
    ['less than 1 s', '4 s', '60 s', '5 min', '2.5 h']
    """
    if seconds < 1:
        return "less than 1 s"
    if seconds < 90:
        return f"{round(seconds) if seconds < 10 else 10 * round(seconds / 10)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _step(model: Model, linear: str) -> float:
    """Time of one Newton step at the start of a model, s."""
    equations = Equilibrium(model, linear)
    taken: list[float] = []
    while len(taken) < TIMED and sum(taken) < LONG:
        # another state, or the last factor would serve
        x = model.x0 + 1e-9 * len(taken) * equations.free
        clock = time.perf_counter()
        equations.factor(x, True)
        g = equations.potential.gradient(x, equations.memory)
        equations.tangent.solve(g[equations.free])
        for term, state in zip(model.terms, equations.memory, strict=True):
            term.energy(x, state)
        taken.append(time.perf_counter() - clock)
    return float(np.median(taken))
