"""What the numbers of a run depend on: the mesh, and in-plane bending.

The mesh: the same run on a coarser one, and its end carried to a finer one. In-plane bending: the
run on the coarser mesh again, with another value, unless that hardly adds to the energy.
"""

from __future__ import annotations

from dataclasses import replace

from ..checks import InputError
from ..energy.bending import Bending
from ..fabric import Fabric
from ..result.run import Result
from .carry import carry
from .increments import Callback, Progress, follow, report
from .linear import NotConvergedError
from .run import Settings

COARSER, FINER = 1.4, 0.5  # sizes of the other meshes
HIGHER = 0.01  # more energy on a finer mesh, and its end is another state
OTHER = 10 / 3  # times the in-plane bending: the other value
MOST_WORK = (
    5.0  # times the factorisations of a run: beyond that the same on another mesh is stopped
)
LITTLE = 2e-3  # of the energy: what the other value may add without a run of its own
INTERRUPTED = "interrupted while the error of the mesh was estimated"
CHANGED = (
    "error of the mesh not estimated",
    "the model was changed by hand, or has no recipe (Model.including makes a change part of it)",
)


def coarser_run(
    result: Result, settings: Settings, callback: Callback | None, vary: bool = True
) -> list[Result]:
    """Run of the same model on a coarser mesh; no run where none can be built or completed.

    Unless `vary` is off, the model is solved there with another in-plane bending too, and the
    result keeps what changes (`Outcome.in_plane`) and all the work. A model that was changed by
    hand has no coarser mesh; a note says so. An interruption ends the result with its reason.
    """
    if result.model.changed:
        result.notes.append(CHANGED)
        return []
    try:
        model = result.model.recipe.build(COARSER * result.model.size, like=result.model)
        within = report(callback, f"error of the mesh: the same at {model.size:.3g} mm")
        coarse = follow(model, settings, _bounded(within, result), partial=False)
        _note_stop(result, coarse)
        result.add_work(coarse)
        if vary and not coarse.reason:
            _vary_in_plane(result, coarse, settings, callback)
    except InputError:  # too coarse to be built, or the user's own mesh
        return []
    except KeyboardInterrupt:
        result.reason = INTERRUPTED
        return []
    return [coarse]


def finer_end(
    result: Result, settings: Settings, callback: Callback | None, saddles: bool = False
) -> Result | None:
    """End of a result on a finer mesh; None where none can be built, or its end is not found.

    Without `saddles` it may be one: enough for an estimate, not for a result.

    Without memory in the model, as in a plane test, the path is followed where a carried end fails.
    Between bands that friction has put in place, a carried end may find another state. It is
    recognised by its energy: that of the same state changes by less from mesh to mesh.
    """
    if result.model.changed or result.reason:
        return None
    try:
        model = result.model.recipe.build(FINER * result.model.size, like=result.model)
        within = report(callback, f"error of the mesh: the end at {model.size:.3g} mm")
        try:
            finer = carry(result, model, settings, saddles)
        except NotConvergedError as error:
            result.factorisations[f"{model.size:.3g} mm"] = error.work
            if any(state is not None for state in result.memory):
                result.notes.append(("end not found on a finer mesh", str(error)))
                return None
            # no path to remember
            finer = follow(model, settings, _bounded(within, result), partial=False)
            _note_stop(result, finer)
    except InputError:
        return None
    except KeyboardInterrupt:
        result.reason = INTERRUPTED
        return None
    result.add_work(finer)
    if finer.energy > (1 + HIGHER) * result.energy:
        more = 100 * (finer.energy / result.energy - 1)
        why = (
            f"{more:.1f} % more energy at {model.size:.3g} mm; the error is that to a coarser mesh"
        )
        result.notes.append(("end on a finer mesh is another state", why))
        return None
    return finer


def _bounded(callback: Callback | None, result: Result) -> Callback:
    """A callback that stops a run which takes many times the work of the result itself."""
    most = MOST_WORK * result.linear_solves

    def step(progress: Progress) -> bool | str | None:
        stop = callback(progress) if callback else None
        return stop or (
            progress.linear_solves > most and f"{MOST_WORK:g} times the work of the run"
        )

    return step


def _note_stop(result: Result, other: Result) -> None:
    if other.reason:
        entry = f"the same on a mesh of {other.model.size:.3g} mm did not reach the end"
        result.notes.append((entry, f"{other.reason}; it is not part of the error of the mesh"))


def _vary_in_plane(
    result: Result, coarse: Result, settings: Settings, callback: Callback | None
) -> None:
    """Solve a coarse model with another in-plane bending, and keep both values of its numbers."""
    model, given = coarse.model, dict(coarse.model.recipe.given)
    if len(model.sheets) > 1:
        return
    r = model.sheet.fabric.in_plane_bending
    bends = [term for term in model.terms if isinstance(term, Bending)]
    if not (bends and model.contacts and 0 < r < 1 and isinstance(given.get("fabric"), Fabric)):
        return
    other = min(OTHER * r, 1.0)
    # to first order
    rate = sum(term.by_in_plane(coarse.states[-1].x) for term in bends)
    if (other - r) * rate < LITTLE * coarse.energy:
        return
    within = report(callback, f"the same with an in-plane bending of {other:g}")
    given["fabric"] = replace(given["fabric"], in_plane_bending=other)
    recipe = replace(model.recipe, given=tuple(sorted(given.items())))
    varied = follow(recipe.build(model.size, like=model), settings, within, partial=False)
    result.add_work(varied)
    if not varied.reason:
        ends = coarse.quantities, varied.quantities
        result.in_plane = {
            name: {f"{r:g}": ends[0][name], f"{other:g}": ends[1][name]}
            for name in ends[0]
            if name in ends[1]
        }
