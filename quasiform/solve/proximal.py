"""Proximal steps: the creep of a damped sheet, from a state that Newton's method cannot leave.

Each step minimises

    E(x) + m/2 Σ w |x - a|²,    a the state before the step, w the area of a node

an implicit Euler step of a sheet on a viscous bed. m falls as steps succeed and rises as they fail,
and the steps end when the forces of the bed are below a tolerance. The state is then solved once
more without it, so that neither its energy nor its stiffness stays in a result.

Reference: R. T. Rockafellar (1976) "Monotone operators and the proximal point algorithm", SIAM J.
Control Optim. 14, 877-898.
"""

from __future__ import annotations

import numpy as np

from ..energy.term import Term
from ..unknowns import FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError
from .newton import minimise

FIRST, LEAST, MOST = 1e-3, 1e-7, 1.0  # m, of the compaction stiffness; friction's stick is 0.01
STEPS = 60
ITERATIONS = 40  # of Newton's method in one step
ENOUGH = 1e-2  # forces of the bed, relative to the driving force


class Bed(Term):
    """The quadratic term m/2 Σ w (x - anchor)² over all unknowns, with weights w (n_dofs,), mm²."""

    name = "proximal bed"

    def __init__(self, weights: FloatArray) -> None:
        self.dofs = np.arange(len(weights))[:, None]
        self.weights, self.m, self.anchor = weights, 0.0, np.zeros_like(weights)

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return 0.5 * self.m * self.weights * (x - self.anchor) ** 2

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return (self.m * self.weights * (x - self.anchor))[:, None]

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        return (self.m * self.weights)[:, None, None]


def creep(equilibrium: Equilibrium, x: FloatArray) -> tuple[FloatArray, float]:
    """Creep from x to near an equilibrium at the present travel; it and the work of the bed, mJ.

    Raises NotConvergedError where the bed does not fade within `STEPS`, or no m is large enough.
    """
    bed, model = Bed(equilibrium.model.unknowns.areas()), equilibrium.model
    k = max(sheet.fabric.compaction for sheet in model.sheets)
    bed.m, work, force = FIRST * k, 0.0, np.inf
    with equilibrium.with_term(bed):
        for _ in range(STEPS):
            bed.anchor = x
            try:
                x = minimise(equilibrium, x, ENOUGH, ITERATIONS)
            except NotConvergedError:
                if bed.m >= MOST * k:
                    raise
                bed.m *= 10.0
                continue
            push = bed.gradient(x)[:, 0]
            work += float(push @ (x - bed.anchor))
            force = equilibrium.residual(push, driven=equilibrium.gradient(x))
            equilibrium.refresh(x)
            if force < ENOUGH and bed.m <= 1e-2 * FIRST * k:
                return x, work
            bed.m = max(bed.m / 3.0, LEAST * k)
    raise NotConvergedError(
        f"proximal steps: forces of {force:.1e} of the driving force left after {STEPS}"
    )
