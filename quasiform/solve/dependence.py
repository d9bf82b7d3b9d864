"""What the numbers of a run depend on: runs on coarser meshes, and with other in-plane bending."""

from __future__ import annotations

from dataclasses import replace

from ..checks import InputError
from ..energy.bending import Bending
from ..fabric import Fabric
from ..result.run import Result
from .increments import Callback, follow, report
from .run import Settings

COARSER = (2**0.5, 2.0)  # sizes of the meshes for the error, of that of the path
OTHER = 10 / 3  # times the in-plane bending: the other value
CHANGED = (
    "error of the mesh not estimated",
    "the model was changed by hand, or has no recipe (Model.including makes a change part of it)",
)


def coarse_runs(result: Result, settings: Settings, callback: Callback | None) -> list[Result]:
    """Runs of the same model on coarser meshes, as far as they can be built; the coarsest first.

    Their work is added to the result. On the coarsest the model is solved with another in-plane
    bending too, and the result keeps what changes (`Outcome.in_plane`). A model that was changed by
    hand has no coarser meshes; a note says so. An interruption ends the result with its reason.
    """
    model, coarser = result.model, list[Result]()
    if model.changed:
        result.notes.append(CHANGED)
        return coarser
    try:
        for ratio in COARSER:
            size = ratio * model.size
            report(callback, f"error of the mesh: the same at {size:.3g} mm")
            coarser.insert(0, follow(model.recipe.build(size, like=model), settings, partial=False))
            result.add_work(coarser[0])
            if coarser[0].reason:
                return coarser
        _vary_in_plane(result, coarser[0], settings, callback)
    except InputError:  # too coarse to be built: the result stands with what there is
        pass
    except KeyboardInterrupt:
        result.reason = "interrupted while the error of the mesh was estimated"
    return coarser


def _vary_in_plane(
    result: Result, coarse: Result, settings: Settings, callback: Callback | None
) -> None:
    """Solve a coarse model with another in-plane bending, and keep both values of its numbers."""
    model, given = coarse.model, dict(coarse.model.recipe.given)
    r = model.sheet.fabric.in_plane_bending
    bends = any(isinstance(term, Bending) for term in model.terms) and model.contacts
    if not (bends and 0 < r < 1 and isinstance(given.get("fabric"), Fabric)):
        return
    other = min(OTHER * r, 1.0)
    report(callback, f"the same with an in-plane bending of {other:g}")
    given["fabric"] = replace(given["fabric"], in_plane_bending=other)
    recipe = replace(model.recipe, given=tuple(sorted(given.items())))
    varied = follow(recipe.build(model.size, like=model), settings, partial=False)
    result.add_work(varied)
    if not varied.reason:
        ends = coarse.quantities, varied.quantities
        result.in_plane = {
            name: {f"{r:g}": ends[0][name], f"{other:g}": ends[1][name]}
            for name in ends[0]
            if name in ends[1]
        }
