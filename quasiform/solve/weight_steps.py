"""The weight of a sheet, applied in steps before the travel.

A sheet that overhangs droops far, and Newton's method does not find that state from the flat one.
So the load factor q of the weight rises from 0 to 1; a step that fails is halved, one that is easy
is followed by one twice as long.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..energy.weight import SheetWeight
from ..model import Model
from ..unknowns import FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError

FIRST, SHORTEST = 0.02, 1e-4  # of the weight
EASY = 40  # factorisations of a step


def load_factors(model: Model) -> np.ndarray:
    """Numbers of the load factors in x that keep their value over the travel."""
    dofs = {int(t.dofs[0, 1]) for t in model.terms if isinstance(t, SheetWeight)}
    return np.array([dof for dof in dofs if model.x0[dof]], dtype=int)


def with_weight(
    equations: Equilibrium,
    settle: Callable[[FloatArray], FloatArray],
    back: Callable[[], None],
) -> FloatArray:
    """Return the equilibrium under the whole weight.

    `settle` finds the equilibrium near x and commits it; `back` undoes what it did where it fails.

    Raises
    ------
    NotConvergedError
        If the shortest step fails; it says how much of the weight the sheet carries.
    """
    model, tangent = equations.model, equations.tangent
    x, q, step, factors = model.x0.copy(), 0.0, FIRST, load_factors(model)
    while q < 1.0:
        trial, before = x.copy(), tangent.factorisations
        target = min(q + step, 1.0)
        trial[factors] = target * model.x0[factors]
        equations.begin(x, 0.0)
        try:
            x, q = settle(trial), target
        except NotConvergedError as error:
            back()
            step *= 0.5
            if step < SHORTEST:
                words = f"at {100 * q:.3g} % of the sheet's weight: {error}"
                raise NotConvergedError(words) from error
        else:
            step *= 2.0 if tangent.factorisations - before < EASY else 1.0
    return x
