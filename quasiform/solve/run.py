"""One run: where it is, the states kept, the energy account, and the ladder of rescues.

A state is found by the first rung of a ladder that leads there: Newton's method with the convex
tangent where the exact one is not positive definite, a shorter increment, proximal steps, dynamic
relaxation. The last two only bring a state near: it is always solved by the equations of the model
alone.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..checks import InputError, check_number
from ..energy.pressure import PRESSURE_FORCE
from ..potential import Memory
from ..result.run import Result, State
from ..unknowns import FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError, SlidesOffError
from .newton import downhill, minimise, predict, settle, weakest_mode
from .proximal import creep
from .relaxation import relax
from .sensitivity import Track
from .weight_steps import load_factors, with_weight

MOST_RELAXED = 60_000  # iterations of a run by dynamic relaxation alone
SADDLES = 8  # tries to leave saddles, each with twice the stride of the last
WEIGHED = 5e-3  # of the work to come: what an increment may miss by the trapezoidal rule
LOADS = 1e-2  # of the work of loads: where the travel does less, the balance is relative to it
NOISE = 1e-4  # of the loads times the thickness: the least that it is relative to

Rung = tuple[str, Callable[["Run", float], FloatArray]]  # its name, and what it does


@dataclass(frozen=True)
class Settings:
    """How a model is solved; see `solve`."""

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


class TooCoarseError(ArithmeticError):
    """An increment over which the trapezoidal rule misses the work."""


@dataclass
class Account:
    """Where a run is with its energy, and how it came there; all of it goes into a checkpoint."""

    force: float = 0.0  # driving force at the last state, N
    stored: float = 0.0  # energy there, mJ
    work: float = 0.0  # done by the travel, mJ; where tools go back, there and back
    given: float = 0.0  # that of loads: from the flat sheet on, and as they change, mJ
    gap: float = 0.0  # what the balance misses of all this work, mJ
    damped: float = 0.0  # what the rescues took up, mJ
    increments: int = 0
    rescues: dict[str, int] = field(default_factory=dict)  # uses of each rung
    parted: float = 0.0  # mm: the largest motion of a node when a saddle was left
    snaps: list[dict[str, float]] = field(default_factory=list)  # where the sheet jumped
    missed: tuple[float, float] = (-np.inf, np.inf)  # target and gap of one that was too coarse
    collapse: dict[str, Any] | None = None  # where a triangle first collapsed
    ended: str = ""  # why there is no way on from here

    def count(self, rung: str) -> None:
        self.rescues[rung] = self.rescues.get(rung, 0) + 1


class Run:
    """One run of a model: the state it has come to, the states kept, and the energy account."""

    def __init__(self, equations: Equilibrium, settings: Settings) -> None:
        self.equations, self.settings, self.model = equations, settings, equations.model
        self.x, self.travel, self.states = self.model.x0, 0.0, list[State]()
        self.memory: Memory = equations.memory  # committed
        self.account, self.tries = Account(), SADDLES
        self.track = Track()

    def start(self) -> FloatArray:
        """Equilibrium before any travel (a holder settling on the sheet)."""
        x0 = self.model.x0
        if not self.model.resting:
            return x0.copy()
        x = self._shaken(x0.copy())
        if self.settings.method == "relaxation":
            x = self._relaxed(x, 0.0)
            memory = self.equations.potential.commit(x, self.equations.memory)
        else:
            self.equations.begin(x0, 0.0)
            try:
                x, memory = self._solve(x)
            except SlidesOffError:
                self.back()
                x, memory = self._solve(stuck_first(self, 0.0))
            except NotConvergedError:
                self.back()
                if len(load_factors(self.model)):
                    with suppress(NotConvergedError):
                        x = with_weight(self.equations, self.settle, self.back)
                        self.account.count("weight in steps")
                        return x
                    self.back()
                self.account.count("dynamic relaxation")
                x, memory = self._solve(self._relaxed(x0, 0.0, 1e-2, 5000))
        self._accept(x, memory)
        return x

    def open(self, x: FloatArray, travel: float = 0.0) -> None:
        """Begin the energy account at the start, or where a run takes over."""
        self.x, self.travel = x, travel
        self.account.force, self.account.stored = self._force_and_energy(x, self.memory)
        loads = [term for term in self.model.terms if term.load]
        given = sum(t.total(self.model.x0, None) - t.total(x, None) for t in loads)
        self.account.given = abs(float(given))

    def _reference(self, work: float) -> float:
        """What a gap in the balance is relative to, mJ; `work` is that of the travel."""
        least = NOISE * self.equations.least_energy
        return max(abs(work), LOADS * self.account.given, least)

    def settle(self, x: FloatArray) -> FloatArray:
        """Find the equilibrium near x and commit it."""
        x, memory = self._solve(x)
        self._accept(x, memory)
        return x

    def advance(self, target: float, rungs: list[Rung], weigh: bool) -> None:
        """Bring the state to the travel `target` and commit it.

        The rungs are tried in order where Newton's method fails. With `weigh` an increment over
        which the energy balance is open by too much raises TooCoarseError.
        """
        account, s = self.account, self.travel
        saddles, damped = account.rescues.get("saddle left", 0), account.damped
        self.equations.begin(self.x, target)
        moved, memory = self._climb(target, rungs)
        force, stored = self._force_and_energy(moved, memory)
        work, given = self.equations.works(self.x, self.memory, moved)
        lost = self.equations.potential.dissipated(self.memory, memory, moved)
        gap = work + given - (stored - account.stored) - lost
        # at the end there will be at least the work so far in proportion to the travel
        expected = (abs(account.work) + abs(work)) * self.model.travel / target
        coarse = abs(gap) > WEIGHED * self._reference(expected)
        tried, missed = account.missed
        if coarse and weigh:
            account.damped, account.missed = damped, (target, gap)
            raise TooCoarseError
        # what a jump releases does not fall with the increment as the error of the rule does
        jumped = target <= tried and gap > 0.5 * missed > 0
        jumped |= account.rescues.get("saddle left", 0) > saddles or account.damped > damped
        # over a longer increment the gap is the error of the rule as well
        short = target - s <= self.model.increment / 16 * (1 + 1e-6)
        if coarse and jumped and short and gap > 0:
            account.snaps.append({"from_mm": s, "to_mm": target, "released_mJ": gap})
        else:
            account.gap += gap
        self.x, self.travel, account.force, account.stored = moved, target, force, stored
        if self.model.strokes:  # tools that go back give work back
            self.equations.peak = max(self.equations.peak, abs(force))
            work = abs(work)
        account.work += work
        account.given += abs(given)
        account.increments += 1
        self._accept(moved, memory)
        if account.collapse is None:
            account.collapse = self.model.collapsed(moved, target)

    def back(self) -> None:
        """Undo what a failed increment has changed."""
        self.equations.travel = self.travel
        self.equations.take(self.memory)

    def _accept(self, x: FloatArray, memory: Memory) -> None:
        self.equations.accept(x, memory)
        self.memory = memory
        self.track.increments.append((self.equations.travel, x))

    def _climb(self, target: float, rungs: list[Rung]) -> tuple[FloatArray, Memory]:
        """Newton's method, then each rung with Newton's method after it; see `_solve`."""
        x, equations = self.x, self.equations
        if self.settings.method == "relaxation":
            if equations.relaxed > MOST_RELAXED:
                raise NotConvergedError(
                    f"dynamic relaxation alone has used {MOST_RELAXED} iterations"
                )
            still, x = np.zeros_like(x), self._relaxed(x, target)
            return self._leave_saddles(x, lambda x: relax(equations, x, still)[0])
        try:
            with equations.tangent.counted_as("prediction"):
                x = predict(equations, x, target)
            if equations.turns:
                equations.refresh(x)
            return self._solve(self._shaken(x))
        except SlidesOffError as error:
            failed, rungs = error, [("friction stuck first", stuck_first)]
        except NotConvergedError as error:
            failed = error
        damped = self.account.damped
        for name, rung in rungs:
            self.back()
            self.account.damped = damped
            self.account.count(name)
            with suppress(NotConvergedError), equations.tangent.counted_as("rescue"):
                return self._solve(rung(self, target))
        self.account.damped = damped
        raise failed

    def _relaxed(self, x: FloatArray, target: float, *limits: float) -> FloatArray:
        self.equations.travel = target
        motion = self.equations.motion_to(x, target)
        x, damped = relax(self.equations, self._shaken(x), motion, *limits)
        if limits:  # as a rescue
            self.account.damped += damped
        return x

    def _shaken(self, x: FloatArray) -> FloatArray:
        """Add the perturbation; each increment has its own noise."""
        if not self.settings.perturbation:
            return x
        seeds = [self.settings.seed, round(5e6 * self.equations.travel / self.model.rows)]
        noise = np.random.default_rng(seeds).normal(size=len(x))
        loose = self.equations.free & self.model.unknowns.at_nodes()
        shaken = x + self.settings.perturbation * np.where(loose, noise, 0.0)
        return x if self.model.turned_over(x, shaken) else shaken

    def _solve(self, x: FloatArray) -> tuple[FloatArray, Memory]:
        """Find the equilibrium near x: its unknowns, and its committed states."""
        settled = partial(settle, self.equations)
        return self._leave_saddles(settled(x), settled)

    def _leave_saddles(
        self, x: FloatArray, settled: Callable[[FloatArray], FloatArray]
    ) -> tuple[FloatArray, Memory]:
        """Follow negative curvature down until the exact tangent is positive definite.

        The tangent is that of the committed states, which the certificate judges. Near a limit
        point the way down is flat and curved. After the last try the saddle is kept; the
        certificate says so.
        """
        equations = self.equations
        for i in range(self.tries + 1):
            equations.check_slide(x)
            lagged = equations.memory
            equations.take(equations.potential.commit(x, lagged))
            negative, _ = equations.factor(x, False)
            if not negative or i == self.tries:
                break
            self.account.count("saddle left")
            mode = weakest_mode(equations)
            equations.take(lagged)
            saddle, stride = x, 1e-3 * 2**i
            with equations.tangent.counted_as("saddle"):
                x = settled(downhill(equations, x, mode, stride))
            self.account.parted = max(self.account.parted, float(np.abs(x - saddle).max()))
        return x, equations.memory

    def _force_and_energy(self, x: FloatArray, memory: Memory) -> tuple[float, float]:
        force = self.equations.force(self.equations.gradient(x))
        return force, self.equations.potential.energy(x, memory)

    def reported(self) -> tuple[float, dict[str, float]]:
        """Driving force of the whole, N, that of a pressure if nothing else drives; measures."""
        model, force = self.model, self.account.force / self.model.share
        measures = {name: measure(self.x) for name, measure in model.measures.items()}
        driven = not model.pressures or model.prescribed(self.travel)[1].any()
        return force if driven else measures.get(PRESSURE_FORCE, force), measures

    def keep(self) -> None:
        (force, measures), solves = self.reported(), self.equations.tangent.factorisations
        self.states.append(State(self.travel, self.x.copy(), force, solves, measures))

    def result(self, reason: str, wall: float) -> Result:
        """Result of the states kept, the last of them the end."""
        equations, account, tangent = self.equations, self.account, self.equations.tangent
        x = self.states[-1].x
        g = equations.gradient(x)
        own = {"convex tangent": tangent.convex_taken, "friction continued": equations.continued}
        return Result(
            model=self.model,
            states=list(self.states),
            memory=self.memory,
            track=self.track,
            reason=reason,
            wall_s=wall,
            linear_solves=tangent.factorisations,
            factorisations={f"{self.model.size:.3g} mm": tangent.factorisations},
            purposes=dict(tangent.counts),
            increments=account.increments,
            rescues=account.rescues | {rung: times for rung, times in own.items() if times},
            residual=equations.residual(g, certified=True),
            settings=asdict(self.settings) | {"linear": tangent.solver.name},
            energy_balance=abs(account.gap) / self._reference(account.work),
            energy=account.stored,
            stabilisation=account.damped / max(abs(account.stored), 1e-12),
            parted=account.parted,
            snaps=account.snaps,
            negative_pivots=equations.certify(x),
            collapse=account.collapse,
        )


def proximal(run: Run, target: float) -> FloatArray:
    """Creep to near the equilibrium at the travel `target`."""
    x, damped = creep(run.equations, predict(run.equations, run.x, target))
    run.account.damped += damped
    return x


def stuck_first(run: Run, target: float) -> FloatArray:
    """Take normal forces from a stuck state: smaller ones would let a sheet slide off."""
    equations = run.equations
    x = run.x + equations.motion_to(run.x, target)
    equations.travel = target
    equations.refresh(x)
    equations.stick()
    x = minimise(equations, x, equations.goal)
    equations.refresh(x)
    return x


def dynamic_relaxation(run: Run, target: float) -> FloatArray:
    """Relax to near the equilibrium at the travel `target`."""
    return run._relaxed(run.x, target, 1e-2, 5000)
