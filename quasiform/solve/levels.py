"""Mesh continuation: the path on a mesh that resolves the fillets, its end carried to finer ones.

The path is followed on a mesh of at most half the smallest fillet: on a coarser one the punch force
rises in stairs, one row of nodes after the other. On each finer mesh only the end is solved
(`carry`).

Friction remembers the path. How much the end depends on the mesh of the path is measured one level
further up: an end that is carried to the mesh of the path, beside the path's own. It is part of the
estimate (`path_gap`); where it is large, the path is followed on the finer mesh too. So it is where
the end is not found, as when a sheet buckles differently on a finer mesh.
"""

from __future__ import annotations

import time
from contextlib import suppress
from math import ceil, log2
from pathlib import Path
from typing import Literal

from ..checks import InputError, check_number
from ..model import Model
from ..result.run import Result
from .carry import carry
from .dependence import coarser_run, finer_end
from .increments import Callback, follow, report
from .journal import Journal
from .linear import NotConvergedError
from .run import Settings

GAP = 0.05  # of the force, and
GAP_DEG = 1.0  # degrees of p99: a larger gap, and the path is followed on the finest mesh too
FINEST = 16  # of the size asked for, when refining to an accuracy


def solve(
    model: Model,
    callback: Callback | None = None,
    increment: float | None = None,
    method: Literal["newton", "relaxation"] = "newton",
    linear: str = "auto",
    tolerance: float = 1e-4,
    convex: Literal["on demand", "always", "never"] = "on demand",
    estimate: bool | Literal["coarse"] = True,
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
        If it has a method `stage`, that is called with a text on what follows the travel, and a
        method `step` with the `Progress` of each increment of that.
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
    estimate : bool or "coarse"
        Solve the model on a coarser mesh too, and its end on a finer one; the differences are the
        error estimate. Also solve it with another in-plane bending (`Result.in_plane`). With
        "coarse" the coarser mesh alone: a quick, wider estimate.
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
        coarse = estimate == "coarse"
        if journal and not coarse:  # a coarse run alone takes less than writing twice
            journal.keep(result)
        coarser = coarser_run(result, settings, callback, vary=not coarse)
        result.judge(coarser, None if coarse else finer_end(result, settings, callback))
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
    estimate: bool = True,
    perturbation: float = 0.0,
    seed: int = 0,
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
    callback, increment, linear, tolerance, estimate, perturbation, seed, out, resume : optional
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
    noise = {"perturbation": perturbation, "seed": seed}
    settings = Settings(increment, linear=linear, tolerance=tolerance, **noise)
    journal = out if isinstance(out, Journal) or out is None else Journal(out, resume=resume)
    clock -= journal.recorded.get("elapsed", 0.0) if journal else 0.0
    result = _refined(model, callback, accuracy, settings, journal, estimate)
    _check_accuracy(result, accuracy)
    result.wall_s = time.perf_counter() - clock
    if journal:
        journal.close(result)
    return result


def meshes(model: Model) -> list[Model]:
    """Return the model on the mesh of its path, on those between, and on its own.

    The path is worth a mesh of its own where that is coarser by √2 at least; each level is at most
    twice as fine as the one before.
    """
    ratio = 1.0 if model.changed else model.coarsest / model.size
    models = [model]
    if ratio > 2**0.5 - 1e-6:
        count = ceil(log2(ratio) - 1e-6)
        with suppress(InputError):  # too coarse for the blank
            for level in range(1, count + 1):
                size = model.size * ratio ** (level / count)
                models.insert(0, model.recipe.build(size, like=model))
    return models


def _refined(
    model: Model,
    callback: Callback | None,
    accuracy: float | None,
    settings: Settings,
    journal: Journal | None,
    estimate: bool,
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
        journal.goal = (
            f" on a mesh of {models[0].size:.3g} mm, the way to one of {model.size:.3g} mm"
        )
    path = follow(models[0], settings, callback, journal)
    levels = [path]
    if journal and estimate and len(models) == 1 and not path.reason:
        journal.keep(path)
    coarser = coarser_run(path, settings, callback) if estimate and not path.reason else []
    for finer in models[1:]:
        if levels[-1].reason:
            break
        report(callback, f"the end on a mesh of {finer.size:.3g} mm")
        try:
            result = _end(levels[-1], finer, callback, settings)
        except KeyboardInterrupt:
            levels[-1].reason = f"interrupted on a mesh of {finer.size:.3g} mm"
            break
        if result.reason:  # what was completed is not lost
            levels[-1].reason = f"on a mesh of {finer.size:.3g} mm: {result.reason}"
            break
        levels.append(result)
    if not estimate:
        return levels[-1]
    if journal and len(levels) > 1:
        journal.keep(levels[-1])
    remembers = any(state is not None for state in levels[-1].memory)
    if levels[-1].path and coarser and remembers and not levels[-1].reason:
        levels[-1] = _with_path_gap(coarser[0], levels[-1], settings, callback)
    while True:
        result = levels[-1]
        if result is not path:
            result.in_plane, result.notes = path.in_plane, path.notes
        finer = finer_end(result, settings, callback, saddles=accuracy is not None)
        result.judge([*coarser, *levels[:-1]], finer)
        error = result.estimate["shear_angle_deg"]
        if accuracy is None or error is None or finer is None or error <= accuracy:
            return result
        if finer.model.size < model.size / FINEST * (1 - 1e-9):
            return result
        finer.factorisations, finer.path_gap = result.factorisations, result.path_gap
        finer.rescues = _added(finer.rescues, result.rescues)
        levels.append(finer)


def _added(rescues: dict[str, int], more: dict[str, int]) -> dict[str, int]:
    return {rung: rescues.get(rung, 0) + more.get(rung, 0) for rung in [*more, *rescues]}


def _end(source: Result, model: Model, callback: Callback | None, settings: Settings) -> Result:
    """Solve the end of a model from that of a coarser one; follow the path where that fails."""
    failed = 0
    try:
        result = carry(source, model, settings)
    except NotConvergedError as error:
        report(callback, f"its end was not found: the path on a mesh of {model.size:.3g} mm")
        result, failed = follow(model, settings, callback), error.work
        result.rescues["path followed on the finer mesh"] = 1
    result.add_work(source, failed)
    result.rescues = _added(result.rescues, source.rescues)
    return result


def _with_path_gap(
    coarse: Result, result: Result, settings: Settings, callback: Callback | None
) -> Result:
    """Add what the end depends on the mesh of the path; follow the path here if that is much.

    It is measured on the mesh of the path: its own end, beside the one carried from a coarser path.
    """
    path, finest = result.path, result.model
    report(callback, f"friction's path: the end carried from {coarse.model.size:.3g} mm")
    try:
        other = carry(coarse, path.model, settings)
    except NotConvergedError as error:
        result.add_work(path, error.work)
        return result
    result.add_work(other)
    ends = other.quantities, path.quantities
    scale = 1.0 / (coarse.model.size / path.model.size - 1.0)  # as for an error of first order
    gap = {n: scale * abs(ends[0][n] - ends[1][n]) for n in ends[0] if n in ends[1]}
    if gap[finest.force_name] > GAP * abs(result.force) or gap["shear_angle_deg"] > GAP_DEG:
        report(callback, f"friction's path matters: followed on a mesh of {finest.size:.3g} mm")
        followed = follow(finest, settings, callback)
        followed.add_work(result)
        if not followed.reason:
            followed.rescues["path followed on the finer mesh"] = 1
            return followed
    result.path_gap = gap
    return result


def _check_accuracy(result: Result, accuracy: float | None) -> None:
    """Give the reason where an accuracy that was asked for is not reached."""
    if accuracy is None or result.reason:
        return
    error, size = result.estimate["shear_angle_deg"], result.model.size
    wanted = f"accuracy of {accuracy:g} degrees"
    if error is None:
        result.reason = f"{wanted}: no estimate of the error"
    elif error > accuracy:
        result.reason = f"{wanted} not reached: estimated {error:.2g} at a size of {size:.3g} mm"
