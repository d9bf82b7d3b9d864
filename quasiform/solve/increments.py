"""Load increments: predict, Newton, rescue, commit.

The travel is followed in increments that shrink when a solve fails and grow again when it is easy.
A state is found by the first rung of a ladder that carries there: Newton's method with the convex
tangent where the exact one is not positive definite, a shorter increment, proximal steps, dynamic
relaxation. The last two only bring a state near: it is always solved by the equations of the scene
alone. Where the shortest increment fails on every rung, the run stops and says where and why, with
everything up to there kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..checks import InputError, check_number
from ..energy.friction import Friction
from ..model import Scene
from ..result.run import Result, State
from .journal import Journal
from .newton import Equilibrium, NotConvergedError
from .proximal import creep
from .relaxation import relax

FloatArray = np.ndarray
SHORTEST = 1 / 64  # of the largest increment
SHORTEST_RELAXED = 1 / 8  # the same of dynamic relaxation alone, which gains little by it
CREEPING = 1 / 4  # of the largest increment: from there on down proximal steps are tried
MOST_RELAXED = 60_000  # iterations of a run by dynamic relaxation alone
MOST_INCREMENTS = 10_000
ESTIMATING = "interrupted while the error of the mesh was estimated"
WEIGHED = 5e-3  # of the work to come: what an increment may miss by the trapezoidal rule


@dataclass(frozen=True)
class Progress:
    """What a callback is told after each increment.

    Parameters
    ----------
    travel, goal : float
        Where the run is and where it ends, mm (or the load factor).
    residual : float
        Sum of the nodal residuals relative to the driving force.
    force : float
        Driving force of the whole, N.
    contacts : int
        Points of the sheet that touch a tool.
    linear_solves : float
        So far; a count.
    elapsed : float
        Time so far, s.
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


Callback = Callable[[Progress], bool | str | None]


def tell(callback: Callback | None, stage: str) -> None:
    """Tell what follows the travel, in words, to a callback that has a method `stage` for it."""
    if hasattr(callback, "stage"):
        callback.stage(stage)


@dataclass(frozen=True)
class Settings:
    """How a scene is solved; see `solve`."""

    increment: float | None = None
    method: str = "newton"
    linear: str = "auto"
    tolerance: float = 1e-4
    convex: str = "on demand"
    perturbation: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in ("newton", "relaxation"):
            raise InputError(f"unknown method '{self.method}': expected 'newton' or 'relaxation'")
        if self.increment is not None:
            check_number("increment", self.increment)
        check_number("tolerance", self.tolerance)
        check_number("perturbation", self.perturbation, zero_allowed=True)
        if not isinstance(self.seed, int) or self.seed < 0:
            raise InputError(f"seed must be a whole number of at least zero, got {self.seed!r}")
        if self.convex not in ("on demand", "always", "never"):
            raise InputError(
                f"convex must be 'on demand', 'always' or 'never', got {self.convex!r}"
            )


def solve(
    scene: Scene,
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
    """Follow the travel of a scene to its end.

    Parameters
    ----------
    scene : Scene
    callback : callable, optional
        Told the `Progress` after each increment. It stops the run there by returning True, or the
        reason in words. What it changes of the scene's terms counts from the next increment on.
        If it has a method `stage`, that is told in words what follows the travel.
    increment : float, optional
        Size of the increments in units of the travel; the scene's own choice if not given.
        A history row is kept for each; else rows fall on the scene's round values.
    method : "newton" or "relaxation"
        "relaxation" solves every increment by dynamic relaxation alone.
    linear : str
        Linear solver: "auto", "pardiso", "superlu" or "amg".
    tolerance : float
        Sum of the nodal residuals relative to the driving force.
    convex : "on demand", "always" or "never"
        When the convex tangent takes the place of the exact one.
    estimate : bool
        Solve the scene on meshes twice and, where its tools allow, four times as coarse too; the
        differences are the error estimate.
    perturbation : float
        Noise on every node at the start of every increment's solve, mm (standard deviation): what
        changes with it is one of several states.
    seed : int
        Of the noise.
    out : path or Journal, optional
        Folder in which the run is recorded increment by increment; a run that was killed is
        carried on from there.
    resume : bool
        Carry on the run of this scene in `out`.

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
    result = follow(scene, settings, callback, journal)
    if estimate and not result.reason and scene.resized:
        coarser: list[Result] = []
        try:
            for size in (2 * scene.size, 4 * scene.size):
                if size > scene.coarsest and coarser:
                    break
                tell(callback, f"error of the mesh: the same at {size:g} mm")
                coarser.insert(0, follow(scene.resized(size), settings, partial=False))
                if coarser[0].reason:
                    break
        except InputError:  # too coarse to be built: the result stands with what there is
            pass
        except KeyboardInterrupt:
            result.reason = ESTIMATING
        result.judge(coarser)
    if journal:
        journal.close(result)
    return result


def follow(
    scene: Scene,
    settings: Settings,
    callback: Callback | None = None,
    journal: Journal | None = None,
    partial: bool = True,
) -> Result:
    """Follow the travel on one mesh, from its start or from where a journal's run has come to.

    An interrupted run is returned as far as it came or, with `partial` off, raised.
    """
    clock = time.perf_counter()
    run = Run(Equilibrium(scene, settings.linear, settings.tolerance, settings.convex), settings)
    equilibrium = run.equilibrium
    if settings.increment and scene.travel > MOST_INCREMENTS * settings.increment:
        least = scene.travel / MOST_INCREMENTS
        raise InputError(f"increment must be at least {least:g}, got {settings.increment:g}")
    largest = min(settings.increment or scene.increment, scene.travel)
    rows = settings.increment or scene.rows
    shortest = (SHORTEST if settings.method == "newton" else SHORTEST_RELAXED) * largest
    reason = ""
    # where tools are about to touch, the first response is the most curved
    step = largest / 16 if settings.method == "newton" and scene.contacts else largest
    if journal and journal.held:
        step, gone = journal.restore(run)
        clock -= gone
        reason = run.ended
    else:
        try:
            x = run.start()
        except NotConvergedError as error:
            x, reason = scene.x0, f"at the start: {error}"
            run.ended = reason
            run.back_to(x, 0.0)
        run.open(x)
        run.keep()

    def record() -> None:
        nonlocal reason
        if journal:
            try:
                journal.record(run, step, time.perf_counter() - clock)
            except OSError as error:
                reason = f"cannot write to {journal.folder}: {error.strerror or error}"

    record()
    while not reason and run.travel < scene.travel * (1 - 1e-12):
        s = run.travel
        goal = float(min(rows * np.floor(s / rows * (1 + 1e-12) + 1), scene.travel))
        target = goal if s + step * (1 + 1e-6) >= goal else s + step
        before = equilibrium.linear_solves
        finest = settings.increment is not None or target - s <= largest / 16
        rungs = [proximal] * bool(step <= CREEPING * largest)
        rungs += [dynamic_relaxation] * bool(step <= shortest)
        try:
            run.advance(target, rungs, weigh=not finest)
        except (NotConvergedError, _TooCoarseError) as error:
            run.back_to(run.x, s)
            if isinstance(error, NotConvergedError):
                run.count("shorter step")
                if step <= shortest:
                    reason = f"at {s:.4g} of {scene.travel:.4g}: {error}"
            step = max(0.5 * min(step, target - s), shortest)
            continue
        except KeyboardInterrupt:
            if not partial:
                raise
            run.back_to(run.x, run.travel)
            reason = f"interrupted between {s:.4g} and {target:.4g} of {scene.travel:.4g}"
            break
        s = run.travel
        if lost := scene.lost(run.x):
            reason = run.ended = f"at {s:.4g} of {scene.travel:.4g}: {lost}"
        solves = equilibrium.linear_solves - before
        if solves <= 200:  # a snap takes as many at any step
            step = min((2.0 if solves <= 30 else 1.5) * step, largest)
        if s == goal:
            run.keep()
        try:
            record()
            told = callback(run.progress(time.perf_counter() - clock)) if callback else None
        except KeyboardInterrupt:
            reason = f"interrupted at {s:.4g} of {scene.travel:.4g}"
            break
        if told and not reason and s < scene.travel * (1 - 1e-12):
            words = f": {told}" if isinstance(told, str) else ""
            reason = f"stopped by the callback at {s:.4g} of {scene.travel:.4g}{words}"
    if run.states[-1].travel < run.travel:
        run.keep()
    return run.result(reason, time.perf_counter() - clock)


class _TooCoarseError(ArithmeticError):
    """An increment over which the trapezoidal rule misses the work."""


@dataclass(frozen=True)
class Entry:
    """Energy account of an equilibrium state."""

    travel: float
    force: float
    stored: float
    rubbing: list[tuple[FloatArray, FloatArray]]  # force and place of the nodes on each tool


class Run:
    """One run: where it is, the states kept, work, friction losses, rescues, certificate."""

    def __init__(self, equilibrium: Equilibrium, settings: Settings) -> None:
        self.equilibrium, self.settings, self.scene = equilibrium, settings, equilibrium.scene
        self.x, self.travel, self.states = self.scene.x0, 0.0, list[State]()
        self.rescues: dict[str, int] = {}
        self.increments = 0
        self.work = self.gap = self.damped = 0.0
        self.snaps: list[dict[str, float]] = []
        self.doubt = (-np.inf, np.inf)  # target and gap of an increment that was too coarse
        self.collapse: dict[str, Any] | None = None
        self.ended = ""  # why there is no way on from here, for a run that is carried on too

    def count(self, rung: str) -> None:
        self.rescues[rung] = self.rescues.get(rung, 0) + 1

    def start(self) -> FloatArray:
        """Equilibrium before any travel (a holder settling on the sheet)."""
        x = self.scene.x0.copy()
        for term in self.scene.frictions:  # of an earlier run on this scene
            term.reset(x)
        if self.scene.resting:
            x = self._shaken(x)
            if self.settings.method == "relaxation":
                x = self._relaxed(x, 0.0)
            else:
                try:
                    x = self._solve(x)
                except NotConvergedError:
                    self.back_to(self.scene.x0, 0.0)
                    self.count("dynamic relaxation")
                    x = self._solve(self._relaxed(self.scene.x0, 0.0, 1e-2, 5000))
            self.equilibrium.accept(x)
        return x

    def open(self, x: FloatArray, s: float = 0.0) -> None:
        """Open the books at the start, or where a run takes over."""
        self.x, self.travel, self.entry = x, s, self._entry(x, s)

    def reopen(
        self, travel: float, force: float, stored: float, rubbing: dict[str, FloatArray]
    ) -> None:
        """Put the last entry of the books back as a journal has kept it."""
        tools = range(len(self.scene.frictions))
        rubbed = [(rubbing[f"{i} force"], rubbing[f"{i} place"]) for i in tools]
        self.entry = Entry(travel, force, stored, rubbed)

    def settle(self, x: FloatArray) -> FloatArray:
        """Find the equilibrium near x and commit it.

        Raises
        ------
        NotConvergedError
        """
        x = self._solve(x)
        self.equilibrium.accept(x)
        return x

    def advance(self, target: float, rungs: list[Rung], weigh: bool) -> None:
        """Carry the state to the travel `target` and commit it.

        Parameters
        ----------
        target : float
        rungs : list of functions (run, target) to x
            What to try, in order, where Newton's method fails.
        weigh : bool
            Refuse an increment over which the energy balance is open by too much.

        Raises
        ------
        NotConvergedError
        _TooCoarseError
        """
        s = self.travel
        saddles, damped = self.rescues.get("saddle left", 0), self.damped
        moved = self._climb(target, rungs)
        entry = self._entry(moved, target)
        work, gap = self._work(entry)
        # at the end there will be at least the work so far in proportion to the travel
        expected = (abs(self.work) + abs(work)) * self.scene.travel / target
        coarse = abs(gap) > WEIGHED * expected
        tried, missed = self.doubt
        if coarse and weigh:
            self.damped, self.doubt = damped, (target, gap)
            raise _TooCoarseError
        # what a jump releases does not fall with the increment as the error of the rule does
        jumped = target <= tried and gap > 0.5 * missed > 0
        jumped |= self.rescues.get("saddle left", 0) > saddles or self.damped > damped
        # over a longer increment the gap is the error of the rule as well
        short = target - s <= self.scene.increment / 16 * (1 + 1e-6)
        if coarse and jumped and short and gap > 0:
            self.snaps.append({"from_mm": s, "to_mm": target, "released_mJ": gap})
        else:
            self.gap += gap
        self.x, self.travel, self.entry = moved, target, entry
        self.work += work
        self.increments += 1
        self.equilibrium.accept(moved)
        if self.collapse is None:
            self.collapse = self.scene.collapsed(moved, target)

    def _climb(self, target: float, rungs: list[Rung]) -> FloatArray:
        """Newton's method, then each rung with Newton's method after it."""
        x, s = self.x, self.travel
        if self.settings.method == "relaxation":
            if self.equilibrium.relaxed > MOST_RELAXED:
                raise NotConvergedError(
                    f"dynamic relaxation alone has used {MOST_RELAXED} iterations", x, np.inf
                )
            still = np.zeros_like(x)
            return self._leave_saddles(
                self._relaxed(x, target), lambda x: relax(self.equilibrium, x, still)[0]
            )
        try:
            return self._solve(self._shaken(self.equilibrium.predict(x, target)))
        except NotConvergedError as error:
            failed = error
        damped = self.damped
        for rung in rungs:
            self.back_to(x, s)
            self.damped = damped
            self.count(rung.__name__.replace("_", " "))
            with suppress(NotConvergedError):
                return self._solve(rung(self, target))
        self.damped = damped
        raise failed

    def _relaxed(self, x: FloatArray, target: float, *limits: float) -> FloatArray:
        self.equilibrium.travel = target
        motion = self.equilibrium.motion_to(x, target)
        x, damped = relax(self.equilibrium, self._shaken(x), motion, *limits)
        if limits:  # as a rescue
            self.damped += damped
        return x

    def _shaken(self, x: FloatArray) -> FloatArray:
        """Add the perturbation; each increment has its own noise."""
        if not self.settings.perturbation:
            return x
        noise = np.random.default_rng(
            [self.settings.seed, round(1e6 * self.equilibrium.travel)]
        ).normal(size=len(x))
        loose = ~self.scene.fixed & (np.arange(len(x)) < self.scene.n_nodal)
        shaken = x + self.settings.perturbation * np.where(loose, noise, 0.0)
        return x if self.equilibrium.turns_over(x, shaken) else shaken

    def _solve(self, x: FloatArray) -> FloatArray:
        return self._leave_saddles(self.equilibrium.settle(x), self.equilibrium.settle)

    def back_to(self, x: FloatArray, s: float) -> None:
        """Undo what a failed increment has lagged."""
        self.equilibrium.travel = s
        for term in self.scene.remembering:
            term.refresh(x)

    def _leave_saddles(
        self, x: FloatArray, settle: Callable[[FloatArray], FloatArray], tries: int = 8
    ) -> FloatArray:
        """Follow negative curvature down until the exact tangent is positive definite.

        Near a limit point the way down is flat and curved, and each try takes twice the stride of
        the last. After `tries` the saddle is kept; the certificate tells.
        """
        equilibrium = self.equilibrium
        if not equilibrium.solver.inertia:
            return x
        for i in range(tries):
            negative, _ = equilibrium.factor(x, convex=False)
            if not negative:
                break
            self.count("saddle left")
            x = settle(equilibrium.downhill(x, 1e-3 * 2**i))
        return x

    def _entry(self, x: FloatArray, s: float) -> Entry:
        scene = self.scene
        return Entry(
            travel=s,
            force=self.equilibrium.force(self.equilibrium.potential.gradient(x)),
            stored=float(
                sum(t.energy(x).sum() for t in scene.terms if not isinstance(t, Friction))
            ),
            rubbing=[(t.force(x), t.contact.relative(x)) for t in scene.frictions],
        )

    def _work(self, now: Entry) -> tuple[float, float]:
        """Work done since the last entry by the trapezoidal rule, and what the balance misses."""
        last = self.entry
        work = 0.5 * (last.force + now.force) * (now.travel - last.travel)
        rubbed = sum(
            float((0.5 * (f0 + f1) * (p1 - p0)).sum())
            for (f0, p0), (f1, p1) in zip(last.rubbing, now.rubbing, strict=True)
        )
        return work, work - (now.stored - last.stored) - rubbed

    def keep(self) -> None:
        """Keep the present state."""
        self.states.append(
            State(
                self.travel,
                self.x.copy(),
                self.entry.force / self.scene.share,
                self.equilibrium.linear_solves,
                {name: measure(self.x) for name, measure in self.scene.measures.items()},
            )
        )

    def progress(self, elapsed: float) -> Progress:
        """Tell how far the run has come."""
        return Progress(
            self.travel,
            self.scene.travel,
            self.equilibrium.residual(self.equilibrium.potential.gradient(self.x)),
            self.entry.force / self.scene.share,
            sum(int((c.penetration(self.x) > 0).sum()) for c in self.scene.contacts),
            self.equilibrium.linear_solves,
            elapsed,
            {name: measure(self.x) for name, measure in self.scene.measures.items()},
        )

    def result(self, reason: str, wall: float) -> Result:
        """Result of the states kept, the last of them the end."""
        x, equilibrium = self.states[-1].x, self.equilibrium
        g = equilibrium.potential.gradient(x)
        own = {
            "convex tangent": equilibrium.convex_taken,
            "friction carried on": equilibrium.carried_on,
        }
        return Result(
            scene=self.scene,
            states=list(self.states),
            reason=reason,
            wall_s=wall,
            linear_solves=equilibrium.linear_solves,
            increments=self.increments,
            rescues=self.rescues | {rung: times for rung, times in own.items() if times},
            residual=equilibrium.residual(g, certified=True),
            solve_s=equilibrium.solve_s / max(equilibrium.linear_solves, 1),
            settings=asdict(self.settings) | {"linear": equilibrium.solver.name},
            energy_balance=abs(self.gap) / max(abs(self.work), 1e-12),
            stabilisation=self.damped / max(abs(self.entry.stored), 1e-12),
            snaps=self.snaps,
            negative_pivots=equilibrium.certify(x),
            collapse=self.collapse,
        )


Rung = Callable[[Run, float], FloatArray]


def proximal(run: Run, target: float) -> FloatArray:
    """Creep to near the equilibrium at the travel `target`."""
    x, damped = creep(run.equilibrium, run.equilibrium.predict(run.x, target))
    run.damped += damped
    return x


def dynamic_relaxation(run: Run, target: float) -> FloatArray:
    """Relax to near the equilibrium at the travel `target`."""
    return run._relaxed(run.x, target, 1e-2, 5000)
