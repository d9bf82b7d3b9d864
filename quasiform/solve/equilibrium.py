"""The equations of a model: gradient, residual, and the states of its terms, which the run owns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..energy.friction import Friction
from ..energy.slip import SlipResistance
from ..energy.term import Term, check_term
from ..model import Model
from ..potential import Memory, Potential
from ..unknowns import FloatArray
from .linear import NotConvergedError, SlidesOffError
from .tangent import Tangent

ROUND_OFF = 0.2  # of eps times stiffness, thickness and size: a node's force of round-off
HOLDING = 0.1  # of the tolerance where friction holds a dead load
LEFT_OVER = 2e-2  # residual that lagged values may leave to the next increment
LEFT_OVER_PLIES = 5e-2  # the same of a stack, with lagged pairs
DRAWN = 3.0  # slide along a tool by the motion that drives it
LOOSER = 30.0  # tolerance on the way where lagged values have to settle, relative to the end's


@dataclass
class Equilibrium:
    """The equations of a model, with its tangent and the present states of its terms."""

    model: Model
    linear: str = "auto"
    tolerance: float = 1e-4  # of the residual at the end of the travel
    convex: str = "on demand"  # or "always", "never": when that takes the exact one's place
    max_iterations: int = 400  # of Newton's method in one solve
    travel: float = 0.0  # where the prescribed unknowns are
    continued: int = 0  # how often they did
    relaxed: int = 0  # iterations of dynamic relaxation so far
    peak: float = 0.0  # N: largest driving force so far, where tools may go back
    driven: float = np.inf  # mm: longest prescribed motion of a node or a tool in this increment
    memory: Memory = field(init=False)
    foreseen: FloatArray | None = field(init=False, default=None)  # stress, by the last prediction

    def __post_init__(self) -> None:
        model = self.model
        self.free = ~model.fixed
        self.memory = tuple(check_term(term, model.x0) for term in model.terms)
        self.potential = Potential(model.terms, self.free, self.memory)
        places = model.unknowns.places()[self.free]
        held = not model.contacts
        self.tangent = Tangent(self.potential, places, self.linear, self.convex, held)
        self.mixed = [(i, name) for i, term in enumerate(model.terms) for name in term.mixed]
        self.mesh_size = min(sheet.blank.size for sheet in model.sheets)
        self.least_force = round_off(model) / self.tolerance
        thickness = max(sheet.fabric.thickness for sheet in model.sheets)
        self.least_energy = (model.resting + self.least_force) * thickness

    @property
    def remembers(self) -> bool:
        return any(state is not None for state in self.memory)

    @property
    def turns(self) -> bool:
        """Whether permanent slip, which turns smoothly with the fibres, is all that is lagged."""
        states = zip(self.model.terms, self.memory, strict=False)
        slid = any(isinstance(t, SlipResistance) and s.lost.any() for t, s in states)
        return slid and not (self.model.contacts or self.model.ply_contacts)

    @property
    def loaded(self) -> bool:
        """Whether loads alone drive this increment, against friction."""
        return not self.driven and bool(self.model.frictions)

    @property
    def left_over(self) -> float:
        """Residual that lagged values may leave to the next increment."""
        if self.at_end or self.model.dead_load:
            return 0.0
        return LEFT_OVER_PLIES if self.model.ply_contacts else LEFT_OVER

    def take(self, memory: Memory) -> None:
        """Take over states of the terms, and their stencils where these have changed."""
        if memory is not self.memory:
            self.tangent.follow(memory)
            self.memory = memory

    def refresh(self, x: FloatArray) -> None:
        """Take lagged values from x."""
        if self.remembers:
            self.take(self.potential.refresh(x, self.memory))

    def accept(self, x: FloatArray, memory: Memory) -> None:
        """Take over the states committed at x; the tangent is another one from there on.

        It is factorised at once, so that a run that is continued from here goes the same way.
        """
        if self.remembers:
            self.take(memory)
            self.renew()
            self.certify(x)

    def renew(self) -> None:
        """Forget stencils of the way here: a run that is continued has never met them."""
        if (potential := self.potential.renewed(self.memory)) is not self.potential:
            self.potential = potential
            self.tangent.take(potential)

    def begin(self, x: FloatArray, travel: float) -> None:
        """Begin an increment from x to `travel`, by which `check_slide` judges."""
        moved = self.model.unknowns.at_nodes()
        moved[[int(contact.tool_dofs[0]) for contact in self.model.contacts]] = True
        motion = np.abs(self.motion_to(x, travel)[moved]).max(initial=0.0)
        # a pressure may move a sheet however far
        self.driven = np.inf if self.model.pressed(travel) else float(motion)

    def check_slide(self, x: FloatArray) -> None:
        """Raise SlidesOffError where a sheet has slid along a tool farther than the motion drives.

        By the mean of what touches: single points may jump by more. A mesh size is allowed beyond
        that motion. A sheet that is clamped on one side and drawn over a punch slides along it by
        up to three times the punch's motion.
        """
        most = self.mesh_size + DRAWN * self.driven
        for term, state in zip(self.model.terms, self.memory, strict=False):
            if isinstance(term, Friction) and term.slide(x, state) > most:
                raise SlidesOffError("slides off: friction cannot hold it")

    def stick(self) -> None:
        """Let no point slip until lagged values are taken anew."""
        states = zip(self.model.terms, self.memory, strict=True)
        self.take(tuple(t.stuck(s) if isinstance(t, Friction) else s for t, s in states))

    def lagged(self) -> FloatArray:
        """All lagged values that a fixed point is sought for, after a zero."""
        return np.concatenate([[0.0], *(getattr(self.memory[i], name) for i, name in self.mixed)])

    def lag(self, values: FloatArray) -> None:
        """Put such values into the states."""
        memory, rest = list(self.memory), values[1:]
        for i, name in self.mixed:
            own, rest = np.split(rest, [len(getattr(memory[i], name))])
            memory[i] = replace(memory[i], **{name: own})
        self.take(tuple(memory))

    @contextmanager
    def with_term(self, term: Term) -> Iterator[None]:
        """Add a term of diagonal Hessian to the potential for the time being."""
        own, self.memory = self.potential, (*self.memory, None)
        self.potential = Potential([*own.terms, term], self.free, self.memory)
        self.tangent.take(self.potential)
        try:
            yield
        finally:
            self.potential, self.memory = own, self.memory[:-1]
            own.follow(self.memory)
            self.tangent.take(own)

    def gradient(self, x: FloatArray) -> FloatArray:
        """(n_dofs,) derivative of the potential with the present states, N."""
        return self.potential.gradient(x, self.memory)

    def energy(self, x: FloatArray) -> float:
        """Potential with the present states, mJ."""
        return self.potential.energy(x, self.memory)

    def energy_at(self, x: FloatArray, trial: FloatArray) -> float:
        """Energy of a trial state; infinite where a triangle has been turned over since x."""
        return np.inf if self.model.turned_over(x, trial) else self.energy(trial)

    def force(self, g: FloatArray) -> float:
        """Derivative of the potential by the travel, N (of the modelled share)."""
        _, rate = self.model.prescribed(self.travel)
        return float(np.where(self.model.fixed, rate, 0.0) @ g)

    def works(self, x: FloatArray, memory: Memory, moved: FloatArray) -> tuple[float, float]:
        """Work from committed states to the present ones at `moved`, mJ, by the trapezoidal rule.

        That of tools, of prescribed nodes and of pressures, and that of the change of other loads.
        """
        g = self.potential.gradient(x, memory) + self.gradient(moved)
        work = np.where(self.model.fixed, 0.5 * g * (moved - x), 0.0)
        pressures = [term.dof for term in self.model.pressures]
        given = float(work[[dof for dof in self.model.loads if dof not in pressures]].sum())
        return float(work.sum()) - given, given

    def residual(
        self, g: FloatArray, certified: bool = False, driven: FloatArray | None = None
    ) -> float:
        """Sum of the free nodal forces relative to the driving force, or to the dead load.

        The driving force is that of g, or of another gradient `driven`, or that of a pressure if
        it is larger. Before it has grown to 2 % of a resting tool's weight the residual is measured
        against that, unless `certified`; where tools go back, against their largest force so far.
        """
        model = self.model
        total = model.unknowns.norm(np.where(model.fixed, 0.0, g))
        if model.dead_load:
            return total / model.dead_load
        floor = self.least_force if certified else 0.02 * model.resting + self.least_force
        floor += self.peak * (1.0 if certified else 0.02)
        force = abs(self.force(g if driven is None else driven))
        return total / max(force, model.pressed(self.travel), floor)

    @property
    def at_end(self) -> bool:
        return self.travel >= self.model.travel * (1 - 1e-12)

    @property
    def goal(self) -> float:
        """Residual that is asked for: on the way a looser one where lagged values settle.

        Where friction alone holds a dead load, what the residual leaves out lets a sheet creep.
        """
        if self.mixed and self.model.dead_load:
            return self.tolerance * HOLDING * max(self.travel / self.model.travel, HOLDING)
        return self.tolerance * (1.0 if self.at_end or not self.mixed else LOOSER)

    def worst(self, g: FloatArray) -> str:
        """Where the residual is largest, for a message."""
        force, X = self.model.unknowns.largest(np.where(self.model.fixed, 0.0, g))
        X = self.model.sheets[0].to_user(X)
        return f"{force:.2g} N at X = ({X[0]:.1f}, {X[1]:.1f}) mm"

    def motion_to(self, x: FloatArray, travel: float) -> FloatArray:
        """(n_dofs,) motion of the prescribed unknowns from x to `travel`, mm."""
        return np.where(self.model.fixed, self.model.prescribed(travel)[0] - x, 0.0)

    def factor(self, x: FloatArray, convex: bool, **given: Any) -> tuple[int, FloatArray]:
        """Factorise a tangent at x; see `Tangent.factor`."""
        return self.tangent.factor(x, self.memory, convex, **given)

    def certify(self, x: FloatArray) -> int | None:
        """Negative pivots of the exact tangent at x; None if it is singular."""
        try:
            return self.factor(x, False)[0]
        except NotConvergedError:  # a stopped run may have no tangent
            return None


def round_off(model: Model) -> float:
    """Sum of the forces of round-off in an unloaded sheet, N: below it there is no residual."""
    total = 0.0
    for sheet in model.sheets:
        fabric, nodes = sheet.fabric, sheet.blank.nodes
        stiff = max(
            float(4 * law.stiffness(np.ones(1), 1.0)[0]) for law in (fabric.warp, fabric.weft)
        )
        total += len(nodes) * stiff * fabric.thickness * float(np.abs(nodes).max())
    return ROUND_OFF * np.finfo(float).eps * total
