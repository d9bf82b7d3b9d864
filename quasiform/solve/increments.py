"""Load increments: the travel is followed in steps that shrink when a solve fails.

They grow again when it is easy. Where the shortest increment fails on every rung of the ladder
(`run`), the run stops and reports where and why, with everything up to there kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..checks import InputError, interruptible
from ..model import Model
from ..result.run import Result
from .equilibrium import Equilibrium
from .journal import Journal
from .linear import NotConvergedError
from .run import Run, Settings, TooCoarseError, dynamic_relaxation, proximal

SHORTEST = 1 / 64  # of the largest increment
SHORTEST_RELAXED = 1 / 8  # the same of dynamic relaxation alone, which gains little by it
CREEPING = 1 / 4  # of the largest increment: from there on down proximal steps are tried
MOST_INCREMENTS = 10_000
Callback = Callable[["Progress"], bool | str | None]


@dataclass(frozen=True)
class Progress:
    """What a callback is called with after each increment.

    Parameters
    ----------
    travel, goal : float
        Where the run is and where it ends, mm (or the load factor).
    residual, force : float
        Sum of the nodal residuals relative to the driving force; that of the whole, N (by a load
        factor the work of the load, mJ).
    contacts, linear_solves : int
        Points of the sheet that touch a tool; factorisations so far.
    elapsed : float
        s.
    measures : dict of str to float
        What the history holds by increment, such as `shear_angle_max_deg`.
    """

    travel: float
    goal: float
    residual: float
    force: float
    contacts: int
    linear_solves: int
    elapsed: float
    measures: dict[str, float] = field(default_factory=dict)


def report(callback: Callback | None, stage: str) -> Callback | None:
    """Report what follows the travel to a callback that has a method `stage`.

    Returns its method `step`, if it has one, for the increments of that stage.
    """
    if hasattr(callback, "stage"):
        callback.stage(stage)
    return getattr(callback, "step", None)


@interruptible()
def follow(
    model: Model,
    settings: Settings,
    callback: Callback | None = None,
    journal: Journal | None = None,
    partial: bool = True,
) -> Result:
    """Follow the travel on one mesh, from its start or from where a journal's run has come to.

    An interrupted run is returned as far as it came or, with `partial` off, raised.
    """
    clock = time.perf_counter()
    if settings.increment and model.travel > MOST_INCREMENTS * settings.increment:
        least = model.travel / MOST_INCREMENTS
        raise InputError(f"increment must be at least {least:g}, got {settings.increment:g}")
    run = Run(Equilibrium(model, settings.linear, settings.tolerance, settings.convex), settings)
    steps = _Steps(run)
    if journal and journal.recorded:
        steps.next, elapsed = journal.restore(run)
        clock -= elapsed
    else:
        _begin(run)

    def record() -> str:
        return journal.record(run, steps.next, time.perf_counter() - clock) if journal else ""

    try:
        with interruptible():
            reason = run.account.ended or record()
    except KeyboardInterrupt:
        if not partial:
            raise
        reason = f"interrupted at {run.travel:.4g} of {model.travel:.4g}"
    while not reason and run.travel < model.travel * (1 - 1e-12):
        s = run.travel
        try:
            with interruptible():
                reason = steps.take()
                if run.travel == s:
                    continue
                failed = record()
                reason = reason or failed
                answer = callback(_progress(run, time.perf_counter() - clock)) if callback else None
        except KeyboardInterrupt:
            if not partial:
                raise
            run.back()
            between = f"between {s:.4g} and {steps.target:.4g}"
            where = between if run.travel == s else f"at {run.travel:.4g}"
            reason = f"interrupted {where} of {model.travel:.4g}"
            break
        if answer and not reason and run.travel < model.travel * (1 - 1e-12):
            why = f": {answer}" if isinstance(answer, str) else ""
            reason = f"stopped by the callback at {run.travel:.4g} of {model.travel:.4g}{why}"
    if run.states[-1].travel < run.travel:
        run.keep()
    return run.result(reason, time.perf_counter() - clock)


def _begin(run: Run) -> None:
    """Find the start of the travel."""
    try:
        x = run.start()
    except NotConvergedError as error:
        run.account.ended = f"at the start: {error}"
        x = run.model.x0
        run.back()
    run.open(x)
    run.keep()


class _Steps:
    """The size of the increments of a run."""

    def __init__(self, run: Run) -> None:
        model, settings = run.model, run.settings
        self.run, newton = run, settings.method == "newton"
        self.largest = min(settings.increment or model.increment, model.travel)
        self.rows = settings.increment or model.rows
        self.shortest = (SHORTEST if newton else SHORTEST_RELAXED) * self.largest
        # where tools are about to touch, the first response is the most curved
        self.next = self.largest / 16 if newton and model.contacts else self.largest
        self.target = 0.0

    def take(self) -> str:
        """Take one increment, or shorten the next; the reason why there is no way on."""
        run, model, s, step = self.run, self.run.model, self.run.travel, self.next
        stage = model.next_stage(s)
        goal = float(min(self.rows * np.floor(s / self.rows * (1 + 1e-12) + 1), stage))
        self.target = goal if s + step * (1 + 1e-6) >= goal else s + step
        tangent = run.equations.tangent
        before = tangent.counts.copy()
        finest = run.settings.increment is not None or self.target - s <= self.largest / 16
        rungs = [("proximal", proximal)] * bool(step <= CREEPING * self.largest)
        rungs += [("dynamic relaxation", dynamic_relaxation)] * bool(step <= self.shortest)
        try:
            run.advance(self.target, rungs, weigh=not finest)
        except (NotConvergedError, TooCoarseError) as error:
            run.back()
            tangent.refuse(before)
            self.next = max(0.5 * min(step, self.target - s), self.shortest)
            if isinstance(error, TooCoarseError):
                return ""
            run.account.count("shorter step")
            return f"at {s:.4g} of {model.travel:.4g}: {error}" if step <= self.shortest else ""
        solves = tangent.factorisations - before.total()
        if solves <= 200:  # a snap takes as many at any step
            self.next = min((2.0 if solves <= 30 else 1.5) * step, self.largest)
        if self.target == stage < model.travel:  # what comes next may be as curved as the start
            self.next = self.largest / 16
        if self.target == goal or model.every:
            run.keep()
        if lost := model.lost(run.x):
            run.account.ended = f"at {run.travel:.4g} of {model.travel:.4g}: {lost}"
        return run.account.ended


def _progress(run: Run, elapsed: float) -> Progress:
    """How far a run has come."""
    equations, model = run.equations, run.model
    residual, (force, measures) = equations.residual(equations.gradient(run.x)), run.reported()
    contacts = sum(int((c.penetration(run.x) > 0).sum()) for c in model.contacts)
    so_far = equations.tangent.factorisations, elapsed
    return Progress(run.travel, model.travel, residual, force, contacts, *so_far, measures)
