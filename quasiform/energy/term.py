"""What an energy is: pure functions of the unknowns and a state that the run owns.

    dofs                           (n_stencils, n_local)            numbers in x
    energy(x, state)               (n_stencils,)                    mJ
    gradient(x, state)             (n_stencils, n_local)            N
    hessian(x, state, convex)      (n_stencils, n_local, n_local)   N/mm, symmetric

Evaluating changes nothing. A term with memory has a state, a frozen dataclass of arrays:

    initial(x)                     -> state    at the start of a run; None: no memory
    refresh(x, state)              -> state    lagged values, between Newton's solves
    through_refresh(x, before, state)          what `refresh` adds to the Hessian, for sensitivities
    commit(x, state)               -> state    after a converged increment
    dissipated(before, after, x)   -> float    mJ lost between two committed states, the last at x
    carried(state, old, new)       -> state    onto another mesh

Reset, rejected increment, checkpoint, transfer to a finer mesh and energy account are written once,
in `solve`, for every term with these functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ..checks import InputError
from ..net.transfer import interpolated
from ..unknowns import FloatArray, IntArray, Unknowns

try:
    from .. import compiled
except ImportError:  # the extra `fast` is not installed
    compiled = None  # type: ignore[assignment]


class Term:
    """One energy of the sum, without memory unless it says otherwise."""

    kernels: Any = compiled  # compiled loops over stencils; None: numpy alone
    name: str = "term"
    dofs: IntArray
    quadratic: bool = False  # the Hessian is the same everywhere: it is summed once
    load: bool = False  # its energy is what a load has left to give
    # few stencils act at a time: `active(x, state)` gives their numbers, and `hessian` takes these
    # as a last argument `rows`
    selective: bool = False
    foresees: bool = False  # `hessian` takes the `stress` that `foreseen_stress(x, dx)` returned
    # terms of one such name that act on the same stencils are added together by `add_hessians`
    together: str = ""
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

    def total(self, x: FloatArray, state: Any) -> float:
        """Energy of all stencils, mJ."""
        return float(self.energy(x, state).sum())

    def add_gradient(self, out: FloatArray, x: FloatArray, state: Any) -> None:
        """Add the gradient to `out` (n_dofs,), N."""
        dofs, forces = self.stencils(state), self.gradient(x, state)
        if self.kernels:
            self.kernels.add_forces(out, dofs, np.ascontiguousarray(forces))
        else:
            out += np.bincount(dofs.ravel(), forces.ravel(), minlength=len(out))

    def add_hessian(
        self,
        values: FloatArray,
        x: FloatArray,
        state: Any,
        convex: bool,
        slots: IntArray,
        stress: FloatArray | None = None,
    ) -> None:
        """Add upper triangles to values at slots (n_stencils, n_pairs), those at ~slot twice."""
        rows: IntArray | slice = slice(None)
        if self.selective:
            rows = self.active(x, state)  # type: ignore[attr-defined]
        chosen = [rows] if self.selective else [stress] if self.foresees else []
        H = np.ascontiguousarray(self.hessian(x, state, convex, *chosen))
        if self.kernels:
            rows = rows if self.selective else np.arange(len(H))
            self.kernels.add_stiffness(values, rows, slots, H)
            return
        i, j = np.triu_indices(k := H.shape[1])
        upper, slots = H.reshape(len(H), k * k).take(i * k + j, axis=1), slots[rows]
        if (twice := slots < 0).any():
            upper[twice] *= 2.0
            slots = np.where(twice, ~slots, slots)
        values += np.bincount(slots.ravel(), upper.ravel(), minlength=len(values))

    def add_hessians(
        self, values: FloatArray, x: FloatArray, states: Sequence, *given: Any, **stress: Any
    ) -> None:
        """Add those of terms that go `together`, pairs of term and state; see `add_hessian`."""
        for term, state in states:
            term.add_hessian(values, x, state, *given, **stress)

    def initial(self, x: FloatArray) -> Any:
        """State at the start of a run, at x (n_dofs,): a frozen dataclass of arrays, or None."""
        return None

    def refresh(self, x: FloatArray, state: Any) -> Any:
        """State with lagged values taken from x, between two solves of Newton's method."""
        return state

    def through_refresh(
        self, x: FloatArray, before: Any, state: Any
    ) -> tuple[IntArray, FloatArray] | None:
        """Derivative (r, k, k) of the gradient through state = refresh(x, before), and its rows."""
        # not symmetric in general; None where it is zero
        if type(self).refresh is Term.refresh:
            return None
        raise InputError(f"term '{self.name}' has lagged values, but no `through_refresh`")

    def commit(self, x: FloatArray, state: Any) -> Any:
        """State after a converged increment that ends at x."""
        return state

    def dissipated(self, before: Any, after: Any, x: FloatArray) -> float:
        """Energy lost between two committed states, the last one at x, mJ."""
        return 0.0

    def carried(self, state: Any, old: Standing | None, new: Standing) -> Any:
        """Carry a state to another mesh: arrays with one row a stencil are interpolated."""
        if state is None or old is None:
            return self.initial(new.x)
        values = {f.name: getattr(state, f.name) for f in fields(state)}
        by_stencil = {
            name: interpolated(old.places, value, new.places)
            for name, value in values.items()
            if isinstance(value, np.ndarray) and len(value) == len(old.places)
        }
        return replace(state, **by_stencil)


class Quadratic(Term):
    """A quadratic energy without memory: a sum over the sheet takes one product with a matrix."""

    quadratic = True

    @cached_property
    def _at_zero(self) -> tuple[csr_array, FloatArray, float]:
        """Hessian, gradient and energy at zero, over the unknowns up to the last one here."""
        i, n = self.dofs, int(self.dofs.max()) + 1
        zero, g, shape = np.zeros(n), np.zeros(n), (*i.shape, i.shape[1])
        places = [np.broadcast_to(of, shape).ravel() for of in (i[:, :, None], i[:, None])]
        H = csr_array((self.hessian(zero, None, False).ravel(), places), shape=(n, n))
        H.eliminate_zeros()
        super().add_gradient(g, zero, None)
        return H, g, super().total(zero, None)

    def changed(self) -> None:
        """Sum anew: the Hessian has been replaced by another one."""
        self.__dict__.pop("_at_zero", None)

    def product(self, x: FloatArray) -> FloatArray:
        """(n_dofs,) product of the Hessian with a motion."""
        H = self._at_zero[0]
        return np.append(H @ x[: H.shape[0]], np.zeros(len(x) - H.shape[0]))

    def total(self, x: FloatArray, state: None) -> float:
        _, g, constant = self._at_zero
        return float(x[: len(g)] @ g + 0.5 * (x @ self.product(x))) + constant

    def add_gradient(self, out: FloatArray, x: FloatArray, state: None) -> None:
        g = self._at_zero[1]
        out[: len(g)] += g
        out += self.product(x)


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


def frozen(x: FloatArray) -> FloatArray:
    """Return an array that nobody can change: a copy, unless x is one."""
    if x.flags.writeable or not x.flags.owndata:
        x = x.copy()
        x.flags.writeable = False
    return x


def same(a: FloatArray, b: FloatArray) -> bool:
    """Whether two arrays of unknowns (n_dofs,) are equal."""
    return a is b or bool((Term.kernels.same if Term.kernels else np.array_equal)(a, b))


def check_state(term: Term, state: Any, *before: Any) -> Any:
    """Return a state; InputError if it is none that a run can keep, after the one `before` it."""
    if before and type(state) is not type(before[0]):
        raise InputError(
            f"term '{term.name}': its state was {type(before[0]).__name__} and became "
            f"{type(state).__name__}: `initial` must return what `commit` does"
        )
    if state is None or (is_dataclass(state) and not isinstance(state, type)):
        return state
    raise InputError(
        f"term '{term.name}': its state must be a frozen dataclass of arrays or None, "
        f"got {type(state).__name__}"
    )


def check_term(term: Any, x: FloatArray) -> Any:
    """Return the initial state of a term; InputError if its arrays have other shapes than named."""
    if not isinstance(term, Term):
        raise InputError(f"a term of a model must be a Term, got {type(term).__name__}")
    state = check_state(term, term.initial(x))
    dofs = np.asarray(term.stencils(state))
    if dofs.ndim != 2 or dofs.dtype.kind not in "iu":
        raise InputError(
            f"term '{term.name}': dofs must be whole numbers, (n_stencils, n_local), got "
            f"{dofs.dtype} of shape {dofs.shape}"
        )
    if dofs.size and not 0 <= dofs.min() <= dofs.max() < len(x):
        raise InputError(
            f"term '{term.name}': dofs must lie between 0 and {len(x) - 1}, "
            f"got {dofs.min()} to {dofs.max()}"
        )
    m, k = dofs.shape
    rows = [term.active(x, state)] if term.selective else []  # type: ignore[attr-defined]
    found = {
        "energy": ((m,), term.energy(x, state)),
        "gradient": ((m, k), term.gradient(x, state)),
        "hessian": ((len(rows[0]) if rows else m, k, k), term.hessian(x, state, False, *rows)),
    }
    for name, (shape, values) in found.items():
        if np.shape(values) != shape:
            raise InputError(
                f"term '{term.name}': its {name} must be of shape {shape}, got {np.shape(values)}"
            )
    return state
