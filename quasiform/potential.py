"""The sum of the energy terms over the free unknowns, in one sparsity pattern."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from .energy.term import Quadratic, Term, check_state, frozen, same
from .unknowns import FloatArray, IntArray

Memory = tuple[Any, ...]  # the states of all terms, in their order; owned by a run


@dataclass(frozen=True, eq=False)
class _Share:
    """Where the Hessians of a term go."""

    dofs: IntArray
    slots: IntArray  # (n_stencils, n_pairs) places in the pattern, ~place where it counts twice


class Potential:
    """The sum of the terms over the free unknowns (n_dofs,) bool, whose states set the pattern."""

    def __init__(self, terms: Sequence[Term], free: np.ndarray, memory: Memory) -> None:
        self.terms, self.free = list(terms), free
        self._number = np.where(free, np.cumsum(free) - 1, -1)
        self._n = int(free.sum())
        self._last = np.empty(0)
        self._keys, self._constant = np.empty(0, dtype=np.int64), np.zeros(1)
        self._shares: list[_Share] = []
        self._lay_out([term.stencils(s) for term, s in zip(self.terms, memory, strict=True)])
        self._groups, self._changed = self._group(), False

    def renewed(self, memory: Memory) -> Potential:
        """The same without what stencils have left in the pattern; itself if none has changed."""
        return Potential(self.terms, self.free, memory) if self._changed else self

    def follow(self, memory: Memory) -> bool:
        """Take over changed stencils; whether the pattern had to be rebuilt for them."""
        tables = [term.stencils(s) for term, s in zip(self.terms, memory, strict=True)]
        if all(new is share.dofs for new, share in zip(tables, self._shares, strict=True)):
            return False
        pattern = self.pattern
        self._lay_out(tables)
        self._groups, self._changed = self._group(), True
        return self.pattern is not pattern

    def _lay_out(self, tables: list[IntArray]) -> None:
        """Find the places of all stencils in the pattern, which grows where it lacks one.

        Rows of tables that stay keep their places; a pattern that has grown has moved them.
        """
        n, slots, changed = self._n, {id(s.dofs): s.slots for s in self._shares}, {}
        for i, dofs in enumerate(tables):
            if id(dofs) in slots:  # friction has the table of its contact
                continue
            rows, old = np.arange(len(dofs)), self._shares[i] if self._shares else None
            if old is not None and old.dofs.shape == dofs.shape:
                rows, slots[id(dofs)] = np.flatnonzero((dofs != old.dofs).any(1)), old.slots
            else:
                slots[id(dofs)] = np.zeros((len(dofs), comb(dofs.shape[1] + 1, 2)), np.int32)
            changed[id(dofs)] = rows, *self._pairs(dofs[rows])
        wanted = [key[key >= 0] for _, key, _ in changed.values()]
        own = np.empty(0, dtype=np.int64) if self._shares else np.arange(n) * (n + 1)
        wanted = np.sort(np.concatenate([*wanted, own]))  # faster than `unique`, which hashes
        wanted = wanted[np.diff(wanted, prepend=-1) > 0]
        places = np.searchsorted(self._keys, wanted)
        missing = wanted[~_holds(self._keys, wanted, places)]
        if len(missing) or not self._shares:
            keys = np.insert(self._keys, np.searchsorted(self._keys, missing), missing)
            moved = np.append(np.searchsorted(keys, self._keys), len(keys)).astype(np.int32)
            for of, old in slots.items():
                slots[of] = np.where(old < 0, ~moved[np.where(old < 0, ~old, 0)], moved[old])
            constant = np.zeros(len(keys) + 1)
            constant[moved] = self._constant
            indptr = np.searchsorted(keys, np.arange(n + 1) * n)
            self._keys, self._constant = keys, constant
            self.pattern = csr_array((np.zeros(len(keys)), keys % n, indptr), shape=(n, n))
        for of, (rows, *pair) in changed.items():
            slots[of] = slots[of].copy()
            slots[of][rows] = self._slots(*pair)
        first = not self._shares
        self._shares = [_Share(dofs, slots[id(dofs)]) for dofs in tables]
        if not first:
            return
        self._constant, at_rest = np.zeros(len(self._keys) + 1), np.zeros(len(self.free))
        for term, share in zip(self.terms, self._shares, strict=True):
            if term.quadratic:
                term.add_hessian(self._constant, at_rest, None, False, share.slots)

    def _group(self) -> list[list[int]]:
        """Numbers of the terms that are not quadratic, those together that go together."""
        groups: dict[Any, list[int]] = {}
        for i, (term, share) in enumerate(zip(self.terms, self._shares, strict=True)):
            if not term.quadratic:
                group = (id(share.dofs), term.together) if term.together else i
                groups.setdefault(group, []).append(i)
        return list(groups.values())

    def _pairs(self, dofs: IntArray) -> tuple[IntArray, np.ndarray]:
        """Key of each pair of a stencil's unknowns, and whether the two are one unknown."""
        i, j = np.triu_indices(dofs.shape[1])
        number = self._number[dofs]
        a, b = number[:, i], number[:, j]
        low, high = np.minimum(a, b), np.maximum(a, b)
        key = np.where(low < 0, -1, low * self._n + high)  # -1: prescribed
        return key, (a == b) & (i != j)

    def _slots(self, key: IntArray, twice: np.ndarray) -> IntArray:
        """Places of keys in the pattern; the last place of all for what is prescribed.

        Where two unknowns of a stencil are one, H_ij and H_ji fall on its diagonal: ~place.
        """
        places = np.searchsorted(self._keys, key.ravel()).astype(np.int32).reshape(key.shape)
        places[key < 0] = len(self._keys)
        return np.where(twice, ~places, places)

    def refresh(self, x: FloatArray, memory: Memory) -> Memory:
        return tuple(t.refresh(x, s) for t, s in zip(self.terms, memory, strict=True))

    def commit(self, x: FloatArray, memory: Memory) -> Memory:
        """States after a converged increment that ends at x."""
        states = zip(self.terms, memory, strict=True)
        return tuple(check_state(t, t.commit(x, s), s) for t, s in states)

    def dissipated(self, before: Memory, after: Memory, x: FloatArray) -> float:
        """Energy lost between two committed states, the last at x, mJ."""
        states = zip(self.terms, before, after, strict=True)
        return float(sum(t.dissipated(b, a, x) for t, b, a in states))

    def _known(self, x: FloatArray) -> FloatArray:
        """A frozen copy of x, the last one where that is equal: terms then compare no numbers."""
        if not same(self._last, x):
            self._last = frozen(x)
        return self._last

    def energy(self, x: FloatArray, memory: Memory) -> float:
        """Total energy, mJ."""
        x = self._known(x)
        return sum(t.total(x, s) for t, s in zip(self.terms, memory, strict=True))

    def gradient(self, x: FloatArray, memory: Memory) -> FloatArray:
        """(n_dofs,) derivative by all unknowns, N; zero on the free ones at rest."""
        x, g = self._known(x), np.zeros(len(x))
        for term, state in zip(self.terms, memory, strict=True):
            term.add_gradient(g, x, state)
        return g

    def hessian(
        self,
        x: FloatArray,
        memory: Memory,
        convex: bool,
        motion: FloatArray | None = None,
        stress: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Upper triangle of the free Hessian, and its product with a motion.

        The first are data (nnz,) for `pattern` (CSR), N/mm; with `convex` of the nearby positive
        semi-definite Hessian of each term, with `stress` of the terms that foresee one. The second
        is the change of the free forces (n_free,), N, under a motion (n_dofs,) of the prescribed
        unknowns; zeros without one.
        """
        x, values = self._known(x), self._constant.copy()
        for members in self._groups:
            states = [(self.terms[i], memory[i]) for i in members]
            first, slots = states[0][0], self._shares[members[0]].slots
            foreseen = {"stress": stress} if first.foresees else {}
            first.add_hessians(values, x, states, convex, slots, **foreseen)
        if motion is None:
            return values[:-1], np.zeros(self._n)
        load = np.zeros(len(x))
        for term, state, share in zip(self.terms, memory, self._shares, strict=True):
            if isinstance(term, Quadratic):
                load += term.product(motion)
            elif (moved := motion[share.dofs]).any():
                foreseen = {"stress": stress} if term.foresees else {}
                H = term.hessian(x, state, convex, **foreseen)
                push = (H @ moved[:, :, None])[:, :, 0]
                load += np.bincount(share.dofs.ravel(), push.ravel(), minlength=len(x))
        return values[:-1], load[self.free]


def _holds(keys: IntArray, wanted: IntArray, places: IntArray) -> np.ndarray:
    """Whether keys, sorted, hold each that is wanted, which would be put at these places."""
    if not len(keys):
        return np.zeros(len(wanted), dtype=bool)
    return keys[np.minimum(places, len(keys) - 1)] == wanted
