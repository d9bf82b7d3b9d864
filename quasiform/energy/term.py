"""What an energy is: pure functions of the unknowns and a state that the run owns.

    dofs                           (n_stencils, n_local)            numbers in x
    energy(x, state)               (n_stencils,)                    mJ
    gradient(x, state)             (n_stencils, n_local)            N
    hessian(x, state, convex)      (n_stencils, n_local, n_local)   N/mm, symmetric

Evaluating changes nothing. A term with memory has a state, a frozen dataclass of arrays:

    initial(x)                     -> state    at the start of a run; None: no memory
    refresh(x, state)              -> state    lagged values, between Newton's solves
    commit(x, state)               -> state    after a converged increment
    dissipated(before, after, x)   -> float    mJ lost between two committed states, the last at x
    carried(state, old, new)       -> state    onto another mesh

Reset, rejected increment, checkpoint, transfer to a finer mesh and energy account are written once,
in `solve`, for every term with these functions.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..net.transfer import interpolated
from ..unknowns import FloatArray, IntArray, Unknowns


class Term:
    """One energy of the sum, without memory unless it says otherwise.

    Gradients and Hessians that are kept with the stencils as the last axis in memory are summed
    without a copy.
    """

    name: str = "term"
    dofs: IntArray
    quadratic: bool = False  # the Hessian is the same everywhere: it is summed once
    # few stencils act at a time: `active(x, state)` gives their numbers, and `hessian` takes these
    # as a last argument `rows`
    selective: bool = False
    foresees: bool = False  # `hessian` takes the `stress` that `foreseen_stress(x, dx)` returned
    # fields of the state that `refresh` brings to a fixed point, and that cannot be negative: the
    # solver may extrapolate them
    mixed: tuple[str, ...] = ()

    def stencils(self, state: Any) -> IntArray:
        """(n_stencils, n_local) numbers in x; another table where the stencils change."""
        return self.dofs

    def energy(self, x: FloatArray, state: Any) -> FloatArray:
        """(n_stencils,) energies, mJ, at x (n_dofs,) with a state."""
        raise NotImplementedError

    def gradient(self, x: FloatArray, state: Any) -> FloatArray:
        """(n_stencils, n_local) derivatives by the unknowns of each stencil, N."""
        raise NotImplementedError

    def hessian(self, x: FloatArray, state: Any, convex: bool) -> FloatArray:
        """(n_stencils, n_local, n_local) second derivatives, N/mm; `convex`: semi-definite."""
        raise NotImplementedError

    def initial(self, x: FloatArray) -> Any:
        """State at the start of a run, at x (n_dofs,): a frozen dataclass of arrays, or None."""
        return None

    def refresh(self, x: FloatArray, state: Any) -> Any:
        """State with lagged values taken from x, between two solves of Newton's method."""
        return state

    def commit(self, x: FloatArray, state: Any) -> Any:
        """State after a converged increment that ends at x."""
        return state

    def dissipated(self, before: Any, after: Any, x: FloatArray) -> float:
        """Energy lost between two committed states, the last one at x, mJ."""
        return 0.0

    def carried(self, state: Any, old: Standing | None, new: Standing) -> Any:
        """Carry a state to another mesh: its arrays, one row a stencil, are interpolated.

        `old` is this term on the other mesh (None where it is not there), and `new` here.
        """
        if state is None or old is None:
            return self.initial(new.x)
        values = {f.name: getattr(state, f.name) for f in fields(state)}
        by_stencil = {
            name: interpolated(old.places, value, new.places)
            for name, value in values.items()
            if isinstance(value, np.ndarray) and len(value) == len(old.places)
        }
        return replace(state, **by_stencil)


@dataclass(frozen=True, eq=False)
class Standing:
    """A term on one mesh, at the end of a run."""

    term: Term
    unknowns: Unknowns
    state: Any
    x: FloatArray  # (n_dofs,)
    before: FloatArray  # (n_dofs,), one increment earlier

    @property
    def places(self) -> FloatArray:
        """(n_stencils, 2) mean flat place of the unknowns of each stencil, mm."""
        return np.nanmean(self.unknowns.places()[self.term.stencils(self.state)], axis=1)
