"""The end of a run on another mesh: interpolated, then solved.

It starts from the unknowns of the run, interpolated by cubics (Clough and Tocher) on the flat
sheet. Each term with memory carries its state over itself: friction starts from the last increment
of the run, so that every point presses in the direction in which it really slides. The last of the
way is followed as a small increment, with an energy balance of its own. The meshes need not be
nested.
"""

from __future__ import annotations

import time

import numpy as np

from ..checks import InputError, interruptible
from ..energy.term import Standing
from ..model import Model
from ..net.transfer import beside_slits, smoothly
from ..potential import Memory
from ..result.run import Result, State
from ..unknowns import Field, FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError
from .run import Run, Settings

MOST = 100  # Newton iterations of one solve
LAST = 1 / 16  # of an increment, followed on the other mesh


@interruptible()
def carry(source: Result, model: Model, settings: Settings, saddles: bool = True) -> Result:
    """Solve the end of a result on the mesh of another model of the same recipe.

    Without `saddles` a saddle is not left, which is enough for an estimate. The result has the way
    there as its `path`. NotConvergedError, with the `work` that it took, if the end is not found.
    """
    clock, path = time.perf_counter(), source.path or source
    equations = Equilibrium(model, settings.linear, settings.tolerance, max_iterations=MOST)
    run, end = Run(equations, settings), source.states[-1].travel
    if not saddles:
        run.tries = 0
    # friction starts from the last increment, at least a row
    rows = [s for s in path.states if s.travel <= end - model.increment * (1 - 1e-9)]
    row = (rows or path.states)[-1 if rows else 0]
    start, last = _start(model, path), source.last
    last = path.states[-1].x - row.x if last is None else last
    try:
        x, before = transferred(source, model, last)
        step = min(LAST * model.increment, end)
        if end > row.travel:
            x = x - step / (end - row.travel) * (x - before)
        equations.travel = end - step
        if model.strokes:
            equations.peak = max(abs(state.force) for state in path.states) * model.share
        x = np.where(model.fixed, model.prescribed(end - step)[0], x)
        run.memory = carried(source, model, last, x, before)
        equations.take(run.memory)
        run.open(run.settle(x), end - step)
        run.advance(end, [], weigh=False)
        if lost := model.lost(run.x):
            raise NotConvergedError(lost)
    except NotConvergedError as error:
        error.work = equations.tangent.factorisations
        raise
    run.account.collapse = path.collapse or run.account.collapse
    run.states = [State(0.0, start, 0.0, 0, {n: m(start) for n, m in model.measures.items()})]
    run.keep()
    result = run.result("", time.perf_counter() - clock)
    result.path, result.last = path, run.x - before
    result.stabilisation, result.snaps = path.stabilisation, path.snaps
    result.parted = max(result.parted, path.parted)
    result.increments = path.increments + 1
    return result


def transferred(coarse: Result, model: Model, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interpolate the end of a result on another mesh of the same model, by its last increment.

    The unknowns at the end and one increment earlier, (n_dofs,) arrays, mm.
    """
    old, end = coarse.model, coarse.states[-1]
    x, dx = model.x0.copy(), np.zeros_like(model.x0)
    for field in model.unknowns.fields:
        theirs = old.unknowns[field.name]
        if field.places is None:
            _check_same(field, theirs)
            x[field.dofs], dx[field.dofs] = theirs.of(end.x), theirs.of(last)
            continue
        both = np.hstack([theirs.of(end.x) - theirs.of(old.x0), theirs.of(last)])
        found = smoothly(theirs.places, both, field.places)
        for their_sheet, sheet in zip(old.sheets, model.sheets, strict=True):
            if field.places is sheet.blank.nodes:
                near, beside = beside_slits(their_sheet.blank, both, sheet.blank)
                found[near] = beside
        moved, increment = np.hsplit(found, 2)
        x[field.dofs] += moved
        dx[field.dofs] = np.where(model.fixed[field.dofs], 0.0, increment)
    x = np.where(model.fixed, model.prescribed(end.travel)[0], x)
    return x, x - dx


def carried(
    coarse: Result, model: Model, last: FloatArray, x: FloatArray, before: FloatArray
) -> Memory:
    """Bring the states of the terms to another mesh, each by its own rule; see `transferred`."""
    old, end = coarse.model, coarse.states[-1]
    known: dict[str, list[Standing]] = {}  # several terms may have one name: in their order
    for term, state in zip(old.terms, coarse.memory, strict=True):
        was = Standing(term, old.unknowns, state, end.x, end.x - last)
        known.setdefault(term.name, []).append(was)
    states = []
    for term in model.terms:
        was = known[term.name].pop(0) if known.get(term.name) else None
        now = Standing(term, model.unknowns, None, x, before)
        states.append(term.carried(was and was.state, was, now))
    return tuple(states)


def _start(model: Model, path: Result) -> FloatArray:
    """(n_dofs,) start of the travel, with the resting tools where the path had them."""
    x = model.x0.copy()
    for field in model.unknowns.fields:
        if field.places is None:
            theirs = path.model.unknowns[field.name]
            _check_same(field, theirs)
            x[field.dofs] = theirs.of(path.states[0].x)
    return x


def _check_same(field: Field, theirs: Field) -> None:
    """Refuse to copy a field without places that has another size on another mesh."""
    if field.dofs.shape != theirs.dofs.shape:
        raise InputError(
            f"field '{field.name}' has {len(theirs.dofs)} unknowns on a coarser mesh and "
            f"{len(field.dofs)} here: give it places, so that it can be interpolated"
        )
