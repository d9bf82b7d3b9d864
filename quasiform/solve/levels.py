"""Mesh continuation: the path on a mesh that resolves the fillets, its end carried to finer ones.

The path is followed on a mesh of at most half the smallest fillet: on a coarser one the punch force
rises in stairs, one row of nodes after the other. On each finer mesh only the end is solved, the
last of it as a small increment with an energy balance of its own. It starts from the unknowns of
the coarser mesh, interpolated by cubics (Clough and Tocher) on the flat sheet. Each term with
memory carries its state over itself: friction starts from the last increment of the path, so that
every point presses in the direction in which it really slides.

Friction remembers the path. How much the end hangs on the mesh of the path is measured one level
further up: an end that is carried to the mesh of the path, beside the path's own. It is part of the
estimate (`path_gap`); where it is large, the path is followed on the finer mesh too. So it is where
the end is not found, as when a sheet buckles differently on a finer mesh. The meshes of a run need
not be nested.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np

from ..checks import InputError, check_number
from ..energy.term import Standing
from ..model import Model
from ..net.transfer import smoothly
from ..potential import Memory
from ..result.run import Result, State
from ..unknowns import Field, FloatArray
from .dependence import coarse_runs
from .equilibrium import Equilibrium
from .increments import Callback, follow, report
from .journal import Journal
from .linear import NotConvergedError
from .run import Run, Settings

GAP = 0.05  # of the force, and
GAP_DEG = 1.0  # degrees of p99: a larger gap, and the path is followed on the finest mesh too
LAST = 1 / 16  # of an increment, followed on each finer mesh
MOST = 100  # Newton iterations of one solve on a finer mesh, before the path is followed there
FINEST = 16  # of the size asked for, when refining to an accuracy
CARRIED = 5.0  # mm: length of the last increment that friction starts from, at least a row


def solve(
    model: Model,
    callback: Callback | None = None,
    increment: float | None = None,
    method: Literal["newton", "relaxation"] = "newton",
    linear: str = "auto",
    tolerance: float = 1e-4,
    convex: Literal["on demand", "always", "never"] = "on demand",
    estimate: bool = True,
    perturbation: float = 0.0,
    seed: int = 0,
    out: str | Path | Journal | None = None,
    resume: bool = False,
) -> Result:
    """Follow the travel of a model to its end.

    Parameters
    ----------
    model : Model
    callback : callable, optional
        Called with the `Progress` after each increment. It stops the run there by returning True,
        or the reason as a text. What it changes of the model's terms counts from the next
        increment on.
        If it has a method `stage`, that is called with a text on what follows the travel.
    increment : float, optional
        Size of the increments in units of the travel; the model's own choice if not given.
        A history row is kept for each; else rows fall on the model's round values.
    method : "newton" or "relaxation"
        "relaxation" solves every increment by dynamic relaxation alone.
    linear : str
        Linear solver: "auto", "pardiso" or "superlu".
    tolerance : float
        Sum of the nodal residuals relative to the driving force.
    convex : "on demand", "always" or "never"
        When the convex tangent takes the place of the exact one.
    estimate : bool
        Solve the model on two coarser meshes too; the differences are the error estimate. Also
        solve it on the coarsest with another in-plane bending (`Result.in_plane`).
    perturbation : float
        Noise on every node at the start of every increment's solve, mm (standard deviation): what
        changes with it is one of several states.
    seed : int
        Of the noise.
    out : path or Journal, optional
        Folder in which the run is recorded increment by increment; a run that was killed is
        continued from there.
    resume : bool
        Continue the run of this model in `out`.

    Returns
    -------
    Result
        With `status` "completed", or "stopped" and the `reason`.

    Raises
    ------
    InputError
        For a bad setting, for a folder that cannot be written or holds a result already, and with
        `resume` for one that holds no such run.
    """
    settings = Settings(increment, method, linear, tolerance, convex, perturbation, seed)
    if resume and (out is None or isinstance(out, Journal)):
        raise InputError("resume needs the folder of a run as `out`")
    journal = out if isinstance(out, Journal) or out is None else Journal(out, resume=resume)
    result = follow(model, settings, callback, journal)
    if estimate and not result.reason:
        result.judge(coarse_runs(result, settings, callback))
    if journal:
        journal.close(result)
    return result


def refine(
    model: Model,
    callback: Callback | None = None,
    accuracy: float | None = None,
    increment: float | None = None,
    linear: str = "auto",
    tolerance: float = 1e-4,
    out: str | Path | Journal | None = None,
    resume: bool = False,
) -> Result:
    """Solve the end of a model on its mesh, and the way there on a coarser one.

    Parameters
    ----------
    model : Model
        Its size is that of the end state; with `accuracy`, that of the first mesh to be judged.
    accuracy : float, optional
        Halve the size until the estimated error of the 99th percentile of the shear angle is
        below it, degrees.
    callback, increment, linear, tolerance, out, resume : optional
        As in `solve`, relative tolerance and increment in mm; the path is called back and recorded.

    Returns
    -------
    Result
        With the path as its `path`, and the coarser levels in its estimate. Where a finer mesh
        fails or an accuracy is not reached, the last level that was completed, with the `reason`.
        A model that was changed by hand after it was built is solved on its own mesh, without an
        estimate.

    Raises
    ------
    InputError
        For bad numbers, and for the folder as in `solve`.
    """
    if accuracy is not None:
        check_number("accuracy", accuracy)
    if resume and (out is None or isinstance(out, Journal)):
        raise InputError("resume needs the folder of a run as `out`")
    clock = time.perf_counter()
    settings = Settings(increment, linear=linear, tolerance=tolerance)
    journal = out if isinstance(out, Journal) or out is None else Journal(out, resume=resume)
    clock -= journal.recorded.get("elapsed", 0.0) if journal else 0.0
    result = _refined(model, callback, accuracy, settings, journal)
    _check_accuracy(result, accuracy)
    result.wall_s = time.perf_counter() - clock
    if journal:
        journal.close(result)
    return result


def _refined(
    model: Model,
    callback: Callback | None,
    accuracy: float | None,
    settings: Settings,
    journal: Journal | None,
) -> Result:
    """Level by level, with the estimate."""
    models = [model]
    while not model.changed and 2 * models[0].size <= model.coarsest * (
        1 + 1e-9
    ):  # worth following the path there
        try:
            models.insert(0, model.recipe.build(2 * models[0].size, like=model))
        except InputError:  # too coarse for the blank
            break
    if journal and len(models) > 1:
        journal.goal = f" on a mesh of {models[0].size:g} mm, the way to one of {model.size:g} mm"
    path = follow(models[0], settings, callback, journal)
    levels, last = [path], _last_increment(path)
    coarser = [] if path.reason else coarse_runs(path, settings, callback)
    waiting = models[1:]
    while not levels[-1].reason:
        levels[-1].judge([*coarser, *levels[:-1]])
        size = levels[-1].model.size / 2
        if not waiting and size >= model.size / FINEST and _worth_refining(levels[-1], accuracy):
            with suppress(InputError):  # the user's own mesh has one size only
                waiting = [model.recipe.build(size, like=model)]
        if not waiting:
            break
        finer = waiting.pop(0)
        report(callback, f"the end on a mesh of {finer.size:g} mm")
        try:
            result, path, last = _carry(levels[-1], finer, last, path, callback, settings)
        except KeyboardInterrupt:
            levels[-1].reason = f"interrupted on a mesh of {finer.size:g} mm"
            break
        if result.reason:  # what was completed is not lost
            levels[-1].reason = f"on a mesh of {finer.size:g} mm: {result.reason}"
            break
        levels.append(result)
    result = levels[-1]
    if result.path and coarser:
        gap = _path_gap(coarser[0], result, settings, callback)
        if not result.reason and _matters(gap, result):
            report(
                callback, f"friction's path matters: followed on a mesh of {result.model.size:g} mm"
            )
            followed = follow(result.model, settings, callback)
            followed.add_work(result)
            if not followed.reason:
                result, gap = followed, dict.fromkeys(gap, 0.0)
                levels[-1] = result
                result.rescues["path followed on the finer mesh"] = 1
        result.path_gap = gap
        result.in_plane, result.notes = levels[0].in_plane, levels[0].notes
    result.judge([*coarser, *levels[:-1]])
    return result


def _path_gap(
    coarse: Result, result: Result, settings: Settings, callback: Callback | None
) -> dict[str, float]:
    """What the end on the path's mesh hangs on the mesh of the path, by quantity."""
    path = result.path
    report(callback, f"friction's path: the end carried from {coarse.model.size:g} mm")
    carried, *_ = _carry(coarse, path.model, _last_increment(coarse), coarse, None, settings)
    result.add_work(carried)
    ends = carried.quantities, path.quantities
    return {name: abs(ends[0][name] - ends[1][name]) for name in ends[0] if name in ends[1]}


def _matters(gap: dict[str, float], result: Result) -> bool:
    return gap["force_N"] > GAP * abs(result.force) or gap["shear_angle_deg"] > GAP_DEG


def _worth_refining(result: Result, accuracy: float | None) -> bool:
    """Whether an accuracy is asked for, not reached yet, and can be judged."""
    if accuracy is None or result.collapse:
        return False
    error = result.estimate["shear_angle_deg"]
    return result.path is None if error is None else error > accuracy


def _check_accuracy(result: Result, accuracy: float | None) -> None:
    """Give the reason where an accuracy that was asked for is not reached."""
    if accuracy is None or result.reason:
        return
    error, size = result.estimate["shear_angle_deg"], result.model.size
    wanted = f"accuracy of {accuracy:g} degrees"
    if error is None:
        result.reason = f"{wanted}: no estimate of the error"
    elif error > accuracy:
        result.reason = f"{wanted} not reached: estimated {error:.2g} at a size of {size:g} mm"


def _last_increment(path: Result) -> FloatArray:
    """(n_dofs,) motion of all unknowns over the last increment of a path, mm."""
    return path.states[-1].x - _before(path).x


def _before(path: Result) -> State:
    """State from which the last increment of a path leads to its end."""
    end = path.states[-1].travel
    rows = [s for s in path.states if s.travel <= end - CARRIED * (1 - 1e-9)]
    return (rows or path.states)[-1 if rows else 0]


def _length(path: Result) -> float:
    return path.states[-1].travel - _before(path).travel


def _carry(
    coarse: Result,
    model: Model,
    last: FloatArray,
    path: Result,
    callback: Callback | None,
    settings: Settings,
) -> tuple[Result, Result, FloatArray]:
    """Solve the end of a model from that of a coarser one; the path too where that fails.

    The result, the path behind it and its last increment.
    """
    clock = time.perf_counter()
    equations = Equilibrium(model, settings.linear, settings.tolerance, max_iterations=MOST)
    equations.travel = coarse.states[-1].travel
    run = Run(equations, settings)
    start = _start(model, path)
    try:
        x, before = transferred(coarse, model, last)
        end, step = equations.travel, LAST * min(model.increment, model.travel)
        if length := _length(path):
            x = x - step / length * (x - before)
        equations.travel = end - step
        x = np.where(model.fixed, model.prescribed(end - step)[0], x)
        run.memory = carried(coarse, model, last, x, before)
        equations.take(run.memory)
        run.open(run.settle(x), end - step)
        run.advance(end, [], weigh=False)
        if lost := model.lost(run.x):
            raise NotConvergedError(lost)
    except NotConvergedError:
        report(callback, f"its end was not found: the path on a mesh of {model.size:g} mm")
        path = result = follow(model, settings, callback)
        result.rescues["path followed on the finer mesh"] = 1
        last, failed = _last_increment(result), equations.tangent.factorisations
    else:
        run.account.collapse = path.collapse or run.account.collapse
        run.states = [State(0.0, start, 0.0, 0, {n: m(start) for n, m in model.measures.items()})]
        run.keep()
        result = run.result("", time.perf_counter() - clock)
        result.path = path
        result.stabilisation, result.snaps = path.stabilisation, path.snaps
        result.increments = path.increments + 1
        last, failed = run.x - before, 0
    result.add_work(coarse, failed)
    result.rescues = {
        rung: result.rescues.get(rung, 0) + coarse.rescues.get(rung, 0)
        for rung in [*coarse.rescues, *result.rescues]
    }
    return result, path, last


def transferred(coarse: Result, model: Model, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bring the end of a result to another mesh of the same model, by its last increment.

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
        moved, increment = np.hsplit(smoothly(theirs.places, both, field.places), 2)
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
