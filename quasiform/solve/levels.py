"""Mesh continuation: the path on a coarse mesh, its end carried to finer ones.

With friction as mild as that of a fabric the end state hardly remembers the path, so that a coarse
mesh may find the way. On each finer mesh only the end is solved. It starts from the positions of
the coarser one, interpolated by cubics (Clough and Tocher) on the flat sheet. Friction starts from
the last increment of the path: every point slips from where it would have been one increment
earlier, and so presses in the direction in which it really slides; what a point bears is
interpolated too, until the contact forces of the finer mesh are found.

The meshes of a run need not be nested. Where the end is not found this way, as when a sheet buckles
differently on a finer mesh, the path is followed there too, and the result says so.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import (
    CloughTocher2DInterpolator,
    LinearNDInterpolator,
    NearestNDInterpolator,
    RBFInterpolator,
)

from ..checks import InputError, check_number
from ..energy.contact import Contact
from ..model import Scene
from ..result.run import Result, State
from .increments import ESTIMATING, Callback, Run, Settings, follow, tell
from .journal import Journal
from .newton import Equilibrium, NotConvergedError

FloatArray = np.ndarray
MOST = 100  # Newton iterations of one solve on a finer mesh, before the path is followed there
FINEST = 16  # of the size asked for, when refining to an accuracy
CARRIED = 5.0  # mm: length of the last increment that friction starts from, at least a row


def refine(
    scene: Scene,
    callback: Callback | None = None,
    accuracy: float | None = None,
    increment: float | None = None,
    linear: str = "auto",
    tolerance: float = 1e-4,
    out: str | Path | Journal | None = None,
    resume: bool = False,
) -> Result:
    """Solve the end of a scene on its mesh, and the way there on a coarser one.

    Parameters
    ----------
    scene : Scene
        Its size is that of the end state; with `accuracy`, that of the first mesh to be judged.
    callback : callable, optional
        Told the `Progress` of the path, which it may stop, as in `solve`.
    accuracy : float, optional
        Halve the size until the estimated error of the 99th percentile of the shear angle is
        below it, degrees.
    increment : float, optional
        Of the path, mm.
    linear : str
        Linear solver.
    tolerance : float
        Sum of the nodal residuals relative to the driving force.
    out : path or Journal, optional
        Folder in which the path is recorded increment by increment, and the result at the end.
    resume : bool
        Carry on the run of this scene in `out`.

    Returns
    -------
    Result
        With the path as its `path`, and the coarser levels in its estimate. Where a finer mesh
        fails or an accuracy is not reached, the last level that was completed, with the `reason`.
        A scene that was changed after it was made is solved on its own mesh.

    Raises
    ------
    InputError
        For bad numbers, and for the folder as in `solve`.
    """
    if accuracy is not None:
        check_number("accuracy", accuracy)
    clock = time.perf_counter()
    settings = Settings(increment, linear=linear, tolerance=tolerance)
    journal = out if isinstance(out, Journal) or out is None else Journal(out, resume=resume)
    clock -= journal.held.get("elapsed", 0.0) if journal else 0.0
    if _rebuilt_alike(scene):
        result = _refined(scene, callback, accuracy, settings, journal)
    else:
        result = follow(scene, settings, callback, journal)
    _say_whether_accurate(result, accuracy)
    result.wall_s = time.perf_counter() - clock
    if journal:
        journal.close(result)
    return result


def _refined(
    scene: Scene,
    callback: Callback | None,
    accuracy: float | None,
    settings: Settings,
    journal: Journal | None,
) -> Result:
    """Level by level, with the estimate."""
    scenes = [scene]
    while 2 * scenes[0].size <= scene.coarsest * (1 + 1e-9):
        try:
            scenes.insert(0, scene.resized(2 * scenes[0].size))
        except InputError:  # too coarse for the blank
            break
    if journal and len(scenes) > 1:
        journal.goal = f" on a mesh of {scenes[0].size:g} mm, the way to one of {scene.size:g} mm"
    path = follow(scenes[0], settings, callback, journal)
    levels, last = [path], _last_increment(path)
    waiting = scenes[1:]
    while not levels[-1].reason:
        size = levels[-1].scene.size / 2
        if not waiting and size >= scene.size / FINEST and _worth_refining(levels, accuracy):
            waiting = [scene.resized(size)]
        if not waiting:
            break
        finer = waiting.pop(0)
        tell(callback, f"the end on a mesh of {finer.size:g} mm")
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
    result.judge(levels[:-1])
    if len(levels) == 1 and not result.reason:
        tell(callback, f"error of the mesh: the same at {2 * scene.size:g} mm")
        try:
            result.judge([follow(scene.resized(2 * scene.size), settings, partial=False)])
        except InputError:  # too coarse to be built: the result stands without an estimate
            pass
        except KeyboardInterrupt:
            result.reason = ESTIMATING
    return result


def _rebuilt_alike(scene: Scene) -> bool:
    """Whether the scene at other sizes is the same one: nobody has changed it since it was made."""
    if scene.resized is None:
        return False
    fresh = scene.resized(scene.size)
    return (
        [term.name for term in scene.terms] == [term.name for term in fresh.terms]
        and scene.travel == fresh.travel
        and scene.fabric == fresh.fabric
        and np.array_equal(scene.fixed, fresh.fixed)
        and np.array_equal(scene.x0, fresh.x0)
    )


def _worth_refining(levels: list[Result], accuracy: float | None) -> bool:
    """Whether an accuracy is asked for, not reached yet, and can be judged."""
    if accuracy is None or levels[-1].collapse:
        return False
    levels[-1].judge(levels[:-1])
    error = levels[-1].estimate["shear_angle_deg"]
    return len(levels) == 1 if error is None else error > accuracy


def _say_whether_accurate(result: Result, accuracy: float | None) -> None:
    """Give the reason where an accuracy that was asked for is not reached."""
    if accuracy is None or result.reason:
        return
    error = result.estimate["shear_angle_deg"]
    if error is None:
        result.reason = f"accuracy of {accuracy:g} degrees: no estimate of the error"
    elif error > accuracy:
        result.reason = (
            f"accuracy of {accuracy:g} degrees not reached: estimated {error:.2g} at a size of "
            f"{result.scene.size:g} mm"
        )


@dataclass(frozen=True)
class _Motion:
    """Motion of a sheet over the last increment of its path, (n_dofs,) mm."""

    scene: Scene
    dx: FloatArray


def _last_increment(path: Result) -> _Motion:
    end = path.states[-1]
    rows = [s for s in path.states if s.travel <= end.travel - CARRIED * (1 - 1e-9)]
    return _Motion(path.scene, end.x - (rows[-1] if rows else path.states[0]).x)


def _carry(
    coarse: Result,
    scene: Scene,
    last: _Motion,
    path: Result,
    callback: Callback | None,
    settings: Settings,
) -> tuple[Result, Result, _Motion]:
    """Solve the end of a scene from that of a coarser one; the path too where that fails.

    Returns the result, the path behind it and its last increment.
    """
    clock = time.perf_counter()
    equilibrium = Equilibrium(scene, settings.linear, settings.tolerance, max_iterations=MOST)
    equilibrium.travel = coarse.states[-1].travel
    run = Run(equilibrium, settings)
    start = _start(scene, path)
    try:
        x, before = transferred(coarse, scene, last)
        x = run.settle(x)
        if scene.lost(x):
            raise NotConvergedError(scene.lost(x), x, np.inf)
    except NotConvergedError:
        tell(callback, f"its end was not found: the path on a mesh of {scene.size:g} mm")
        result = follow(scene, settings, callback)
        result.rescues["path followed on the finer mesh"] = 1
        _add_work(result, coarse, equilibrium.linear_solves)
        return result, result, _last_increment(result)
    run.open(x, equilibrium.travel)
    run.collapse = path.collapse or scene.collapsed(x, equilibrium.travel)
    run.states = [State(0.0, start, 0.0, 0, {n: m(start) for n, m in scene.measures.items()})]
    run.keep()
    result = run.result("", time.perf_counter() - clock)
    result.path, result.energy_balance = path, path.energy_balance
    result.stabilisation, result.snaps = path.stabilisation, path.snaps
    result.increments = path.increments + 1
    _add_work(result, coarse, 0)
    return result, path, _Motion(scene, x - before)


def _add_work(result: Result, coarse: Result, failed: int) -> None:
    """Add the linear solves of the coarser levels, by their time, and their rescues."""
    ratio = coarse.solve_s / result.solve_s if result.solve_s else 1.0
    result.linear_solves += failed + coarse.linear_solves * ratio
    result.states[-1] = replace(result.states[-1], linear_solves=result.linear_solves)
    result.rescues = {
        rung: result.rescues.get(rung, 0) + coarse.rescues.get(rung, 0)
        for rung in [*coarse.rescues, *result.rescues]
    }


def transferred(coarse: Result, scene: Scene, last: _Motion) -> tuple[FloatArray, FloatArray]:
    """Carry the end of a result to another mesh of the same scene.

    Parameters
    ----------
    coarse : Result
    scene : Scene
        Its friction takes over from that of the result.
    last : _Motion
        Over the last increment.

    Returns
    -------
    x, before : (n_dofs,) arrays, mm
        Positions at the end, and one increment earlier.
    """
    old, end = coarse.scene, coarse.states[-1]
    X, Y, n = old.blank.nodes, scene.blank.nodes, old.n_nodal
    moved = old.positions(end.x) - old.positions(old.x0)
    increment = old.positions(last.dx)
    fields = np.column_stack([moved, increment])
    values = CloughTocher2DInterpolator(X, fields)(Y)
    outside = np.isnan(values).any(1)  # a finer outline bulges beyond the coarser polygon
    if outside.any():
        values[outside] = RBFInterpolator(X, fields, neighbors=20, degree=1)(Y[outside])
    x, dx = scene.x0.copy(), np.zeros_like(scene.x0)
    x[: scene.n_nodal] += values[:, : scene.dim].ravel()
    dx[: scene.n_nodal] = values[:, scene.dim :].ravel()
    x[scene.n_nodal :], dx[scene.n_nodal :] = end.x[n:], last.dx[n:]
    x = np.where(scene.fixed, scene.prescribed(end.travel)[0], x)
    dx[: scene.n_nodal][scene.fixed[: scene.n_nodal]] = 0.0
    known = {term.name: term for term in old.frictions}
    for term in scene.frictions:
        pressure = np.zeros(len(term.limit))
        if term.name in known:
            rubbing = known[term.name]
            flat, per_area = _flat(rubbing.contact, old), rubbing.limit / rubbing.contact.area
            there = _flat(term.contact, scene)
            pressure = LinearNDInterpolator(flat, per_area)(there)
            outside = np.isnan(pressure)
            pressure[outside] = NearestNDInterpolator(flat, per_area)(there[outside])
        term.adopt(x, x - dx, pressure > 0, pressure * term.contact.area)
    return x, x - dx


def _flat(contact: Contact, scene: Scene) -> FloatArray:
    """(m, 2) places of the contact points on the flat sheet, mm."""
    points = contact.points
    return (points.weights[:, :, :2] * scene.blank.nodes[points.nodes]).sum(1)


def _start(scene: Scene, path: Result) -> FloatArray:
    """(n_dofs,) start of the travel, with the resting tools where the path had them."""
    x = scene.x0.copy()
    x[scene.n_nodal :] = path.states[0].x[path.scene.n_nodal :]
    return x
