"""Load increments: predict, Newton, rescue, commit.

The travel is followed in increments that shrink when a solve fails and grow again when it is easy.
When the shortest increment fails too, dynamic relaxation is tried and its state handed back to
Newton; when that fails the run stops and says where and why, with everything up to there kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..checks import InputError, check_number
from ..energy.friction import Friction
from ..result import Result, State
from ..scene import Scene
from .newton import Equilibrium, NotConvergedError
from .relaxation import relax

FloatArray = np.ndarray
SHORTEST = 1 / 64  # of the largest increment
WEIGHED = 5e-3  # of the work to come: what an increment may miss by the trapezoidal rule


@dataclass(frozen=True)
class Progress:
    """What a callback is told after each increment."""

    travel: float
    goal: float
    residual: float
    force: float
    contacts: int
    linear_solves: int
    elapsed: float


def solve(
    scene: Scene,
    callback: Callable[[Progress], None] | None = None,
    increment: float | None = None,
    method: Literal["newton", "relaxation"] = "newton",
    linear: str = "auto",
    tolerance: float = 1e-4,
    convex: Literal["on demand", "always"] = "on demand",
    estimate: bool = True,
) -> Result:
    """Follow the travel of a scene to its end.

    Parameters
    ----------
    scene : Scene
    callback : callable, optional
        Told the `Progress` after each increment.
    increment : float, optional
        Size of the increments in units of the travel; the scene's own choice if not given.
        A history row is kept for each; else rows fall on the scene's round values.
    method : "newton" or "relaxation"
        "relaxation" solves every increment by dynamic relaxation alone.
    linear : str
        Linear solver: "auto", "pardiso", "superlu" or "amg".
    tolerance : float
        Sum of the nodal residuals relative to the driving force.
    convex : "on demand" or "always"
        When the convex tangent takes the place of the exact one.
    estimate : bool
        Solve the scene on meshes twice and, where its tools allow, four times as coarse too; the
        differences are the error estimate.

    Returns
    -------
    Result
        With `status` "completed", or "stopped" and the `reason`.

    Raises
    ------
    InputError
        For a bad increment, method or linear solver.
    """
    if method not in ("newton", "relaxation"):
        raise InputError(f"unknown method '{method}': expected 'newton' or 'relaxation'")
    if increment is not None:
        check_number("increment", increment)
    check_number("tolerance", tolerance)
    if convex not in ("on demand", "always"):
        raise InputError(f"convex must be 'on demand' or 'always', got {convex!r}")
    clock = time.perf_counter()
    equilibrium = Equilibrium(scene, linear, tolerance, convex)
    run = Run(equilibrium, method, increment)
    largest = min(increment or scene.increment, scene.travel)
    rows = increment or scene.rows
    shortest = SHORTEST * largest
    reason = ""
    states: list[State] = []
    try:
        x = run.start()
    except NotConvergedError as error:
        x, reason = scene.x0, f"at the start: {error}"
        run.back_to(x, 0.0)
    run.open(x)
    states.append(run.state(x, 0.0))
    # where tools are about to touch, the first response is the most curved
    s, step = 0.0, largest / 16 if method == "newton" and scene.contacts else largest
    while not reason and s < scene.travel * (1 - 1e-12):
        goal = float(min(rows * np.floor(s / rows * (1 + 1e-12) + 1), scene.travel))
        target = goal if s + step * (1 + 1e-6) >= goal else s + step
        before = equilibrium.linear_solves
        finest = increment is not None or target - s <= largest / 16
        try:
            x = run.advance(x, s, target, rescue=step <= shortest, weigh=not finest)
        except (NotConvergedError, _TooCoarseError) as error:
            run.back_to(x, s)
            if isinstance(error, NotConvergedError):
                run.count("shorter step")
                if step <= shortest:
                    reason = f"at {s:.4g} of {scene.travel:.4g}: {error}"
            step = max(0.5 * min(step, target - s), shortest)
            continue
        except KeyboardInterrupt:
            run.back_to(x, s)
            reason = f"interrupted between {s:.4g} and {target:.4g} of {scene.travel:.4g}"
            break
        s = target
        if lost := scene.lost(x):
            reason = f"at {s:.4g} of {scene.travel:.4g}: {lost}"
        solves = equilibrium.linear_solves - before
        if solves <= 200:  # a snap takes as many at any step
            step = min((2.0 if solves <= 30 else 1.5) * step, largest)
        if s == goal:
            states.append(run.state(x, s))
        if callback:
            progress = Progress(
                s,
                scene.travel,
                equilibrium.residual(equilibrium.potential.gradient(x)),
                run.books[-1].force / scene.share,
                sum(int((c.penetration(x) > 0).sum()) for c in scene.contacts),
                equilibrium.linear_solves,
                time.perf_counter() - clock,
            )
            try:
                callback(progress)
            except KeyboardInterrupt:
                reason = f"interrupted at {s:.4g} of {scene.travel:.4g}"
    if states[-1].travel < s:
        states.append(run.state(x, s))
    result = run.result(states, reason, time.perf_counter() - clock)
    if estimate and not reason and scene.resized:
        coarser: list[Result] = []
        settings = (None, increment, method, linear, tolerance, convex, False)
        # too coarse to be built, or interrupted: the result stands with what there is
        with suppress(InputError, KeyboardInterrupt):
            for size in (2 * scene.size, 4 * scene.size):
                if size > scene.coarsest and coarser:
                    break
                coarser.insert(0, solve(scene.resized(size), *settings))
                if coarser[0].reason:
                    break
        result.judge(coarser)
    return result


class _TooCoarseError(ArithmeticError):
    """An increment over which the trapezoidal rule misses the work."""


@dataclass(frozen=True)
class _Entry:
    """Energy account of an equilibrium state."""

    travel: float
    force: float
    stored: float
    rubbing: list[tuple[FloatArray, FloatArray]]  # force and place of the nodes on each tool


class Run:
    """The bookkeeping of one run: work, friction losses, rescues, certificate."""

    def __init__(self, equilibrium: Equilibrium, method: str, increment: float | None) -> None:
        self.equilibrium, self.method, self.increment = equilibrium, method, increment
        self.scene = equilibrium.scene
        self.rescues: dict[str, int] = {}
        self.books: list[_Entry] = []
        self.work = self.gap = 0.0
        self.collapse: dict[str, Any] | None = None

    def count(self, rung: str) -> None:
        self.rescues[rung] = self.rescues.get(rung, 0) + 1

    def start(self) -> FloatArray:
        """Equilibrium before any travel (a holder settling on the sheet)."""
        x = self.scene.x0.copy()
        for term in self.scene.frictions:  # of an earlier run on this scene
            term.reset(x)
        if self.scene.resting:
            x = self._relax(x, 0.0) if self.method == "relaxation" else self._solve(x)
            self._commit(x)
        return x

    def open(self, x: FloatArray, s: float = 0.0) -> None:
        """Open the books at the start, or where a run takes over."""
        self.books.append(self._entry(x, s))

    def settle(self, x: FloatArray) -> FloatArray:
        """Find the equilibrium near x and commit it.

        Raises
        ------
        NotConvergedError
        """
        x = self._solve(x)
        self._commit(x)
        return x

    def advance(
        self, x: FloatArray, s: float, target: float, rescue: bool, weigh: bool
    ) -> FloatArray:
        """Carry the state x at travel s to the travel `target` and commit it.

        Raises
        ------
        NotConvergedError
        _TooCoarseError
            With `weigh`, if the energy balance of the increment is open by too much.
        """
        equilibrium = self.equilibrium
        try:
            if self.method == "relaxation":
                moved = self._relax(x, target)
            else:
                moved = self._solve(equilibrium.predict(x, target))
        except NotConvergedError:
            if not rescue or self.method == "relaxation":
                raise
            self.back_to(x, s)
            self.count("dynamic relaxation")
            moved = self._solve(self._relax(x, target, 1e-2, 5000))
        entry = self._entry(moved, target)
        work, gap = self._work(entry)
        # at the end there will be at least the work so far in proportion to the travel
        expected = (abs(self.work) + abs(work)) * self.scene.travel / target
        if weigh and abs(gap) > WEIGHED * expected:
            raise _TooCoarseError
        self.books.append(entry)
        self.work += work
        self.gap += gap
        self._commit(moved)
        if self.collapse is None:
            self.collapse = self.scene.collapsed(moved, target)
        return moved

    def _relax(self, x: FloatArray, target: float, *limits: float) -> FloatArray:
        self.equilibrium.travel = target
        return relax(self.equilibrium, x, self.equilibrium.motion_to(x, target), *limits)

    def _solve(self, x: FloatArray) -> FloatArray:
        return self._leave_saddles(self.equilibrium.settle(x))

    def back_to(self, x: FloatArray, s: float) -> None:
        """Undo what a failed increment has lagged."""
        self.equilibrium.travel = s
        for term in self.scene.remembering:
            term.refresh(x)

    def _leave_saddles(self, x: FloatArray, tries: int = 3) -> FloatArray:
        """Follow negative curvature down until the exact tangent is positive definite.

        After `tries` the saddle is kept; the certificate tells.
        """
        equilibrium = self.equilibrium
        if not equilibrium.solver.inertia:
            return x
        for _ in range(tries):
            negative, _ = equilibrium.factor(x, convex=False)
            if not negative:
                break
            self.count("saddle left")
            x = equilibrium.settle(equilibrium.downhill(x))
        return x

    def _commit(self, x: FloatArray) -> None:
        for term in self.scene.remembering:
            term.commit(x)

    def _entry(self, x: FloatArray, s: float) -> _Entry:
        scene = self.scene
        return _Entry(
            travel=s,
            force=self.equilibrium.force(self.equilibrium.potential.gradient(x)),
            stored=float(
                sum(t.energy(x).sum() for t in scene.terms if not isinstance(t, Friction))
            ),
            rubbing=[(t.force(x), t.contact.relative(x)) for t in scene.frictions],
        )

    def _work(self, now: _Entry) -> tuple[float, float]:
        """Work done since the last entry by the trapezoidal rule, and what the balance misses."""
        last = self.books[-1]
        work = 0.5 * (last.force + now.force) * (now.travel - last.travel)
        rubbed = sum(
            float((0.5 * (f0 + f1) * (p1 - p0)).sum())
            for (f0, p0), (f1, p1) in zip(last.rubbing, now.rubbing, strict=True)
        )
        return work, work - (now.stored - last.stored) - rubbed

    def state(self, x: FloatArray, s: float) -> State:
        measures = {name: measure(x) for name, measure in self.scene.measures.items()}
        return State(
            s,
            x.copy(),
            self.books[-1].force / self.scene.share,
            self.equilibrium.linear_solves,
            measures,
        )

    def result(self, states: list[State], reason: str, wall: float) -> Result:
        x = states[-1].x
        g = self.equilibrium.potential.gradient(x)
        negative = None
        if self.equilibrium.solver.inertia:
            with suppress(NotConvergedError):  # a stopped run may have no tangent
                negative, _ = self.equilibrium.factor(x, convex=False)
        return Result(
            scene=self.scene,
            states=states,
            reason=reason,
            wall_s=wall,
            linear_solves=self.equilibrium.linear_solves,
            increments=len(self.books) - 1,
            rescues=self.rescues
            | (
                {"friction carried on": carried} if (carried := self.equilibrium.carried_on) else {}
            ),
            residual=self.equilibrium.residual(g, certified=True),
            solve_s=self.equilibrium.solve_s / max(self.equilibrium.linear_solves, 1),
            settings={
                "increment": self.increment,
                "method": self.method,
                "tolerance": self.equilibrium.tolerance,
                "convex": self.equilibrium.convex,
                "linear": self.equilibrium.solver.name,
            },
            energy_balance=abs(self.gap) / max(abs(self.work), 1e-12),
            negative_pivots=negative,
            collapse=self.collapse,
        )
