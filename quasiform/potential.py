"""The sum of the energy terms over the free unknowns, in one sparsity pattern."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from .energy.term import Term, check_state
from .unknowns import FloatArray, IntArray

Memory = tuple[Any, ...]  # the states of all terms, in their order; owned by a run


@dataclass(frozen=True, eq=False)
class _Share:
    """Where the Hessians of a term go: by stencil if few act at a time, else as the sum of all."""

    dofs: IntArray
    slots: IntArray | None = None  # (n_stencils, n_pairs) places in the pattern
    counts: IntArray | None = None  # 2 where two unknowns of a stencil are one
    total: csr_array | None = None


class Potential:
    """The sum of the terms over the free unknowns (n_dofs,) bool, whose states set the pattern."""

    def __init__(self, terms: Sequence[Term], free: np.ndarray, memory: Memory) -> None:
        self.terms, self.free = list(terms), free
        self._number = np.where(free, np.cumsum(free) - 1, -1)
        self._n = int(free.sum())
        self._keys = np.empty(0, dtype=np.int64)
        self._lay_out([term.stencils(s) for term, s in zip(self.terms, memory, strict=True)])

    def follow(self, memory: Memory) -> bool:
        """Take over changed stencils; whether the pattern had to be rebuilt for them."""
        tables = [term.stencils(s) for term, s in zip(self.terms, memory, strict=True)]
        if all(new is share.dofs for new, share in zip(tables, self._shares, strict=True)):
            return False
        pattern = self.pattern
        self._lay_out(tables)
        return self.pattern is not pattern

    def _lay_out(self, tables: list[IntArray]) -> None:
        """Find the places of all stencils in the pattern, which grows where it lacks one."""
        n = self._n
        pairs = [self._pairs(dofs) for dofs in tables]
        wanted = [key.ravel() for key, _ in pairs]
        diagonal = np.arange(n) * (n + 1)
        keys, slots = np.unique(
            np.concatenate([*wanted, diagonal, [n * n], self._keys]), return_inverse=True
        )
        if len(keys) > len(self._keys):
            nnz = len(keys) - 1
            indptr = np.searchsorted(keys, np.arange(n + 1) * n)
            self._keys = keys
            self.pattern = csr_array((np.zeros(nnz), keys[:-1] % n, indptr), shape=(n, n))
        dofs = np.concatenate([table.T.ravel() for table in tables])
        ones, local = np.ones(len(dofs)), np.arange(len(dofs))
        self._sum_of_gradients = csr_array((ones, (dofs, local)), (len(self.free), len(dofs)))
        self._constant = np.zeros(len(keys))
        self._shares: list[_Share] = []
        for term, table, (key, counts) in zip(self.terms, tables, pairs, strict=True):
            own, slots = slots[: key.size].reshape(key.shape), slots[key.size :]
            if term.selective:
                self._shares.append(_Share(table, own.astype(np.int32), counts))
                continue
            m, k = table.shape
            i, j = np.triu_indices(k)
            place = (i * k + j) * m + np.arange(m)[:, None]  # in an array with the stencils last
            entries = counts.ravel().astype(float), (own.ravel(), place.ravel())
            total = csr_array(entries, shape=(len(keys), k * k * m))
            if term.quadratic:
                H = term.hessian(np.zeros(len(self.free)), None, False)
                self._constant += total @ H.T.ravel()
            self._shares.append(_Share(table, total=None if term.quadratic else total))

    def _pairs(self, dofs: IntArray) -> tuple[IntArray, IntArray]:
        """Key of each pair of a stencil's unknowns, and how often it counts on the diagonal."""
        i, j = np.triu_indices(dofs.shape[1])
        a, b = self._number[dofs[:, i]], self._number[dofs[:, j]]
        low, high = np.minimum(a, b), np.maximum(a, b)
        key = np.where(low < 0, self._n**2, low * self._n + high)  # prescribed: a last slot
        # where two of a stencil are one unknown, H_ij and H_ji fall on its diagonal
        return key, np.where((a == b) & (i != j), 2, 1).astype(np.int8)

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

    def energy(self, x: FloatArray, memory: Memory) -> float:
        """Total energy, mJ."""
        return float(sum(t.energy(x, s).sum() for t, s in zip(self.terms, memory, strict=True)))

    def gradient(self, x: FloatArray, memory: Memory) -> FloatArray:
        """(n_dofs,) derivative by all unknowns, N; zero on the free ones at rest."""
        return self._sum_of_gradients @ np.concatenate(
            [t.gradient(x, s).T.ravel() for t, s in zip(self.terms, memory, strict=True)]
        )

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
        values = self._constant.copy()
        load = np.zeros(len(x))
        for term, state, share in zip(self.terms, memory, self._shares, strict=True):
            dofs = share.dofs
            if share.slots is not None:
                rows = term.active(x, state)
                if not len(rows):
                    continue
                H, dofs = term.hessian(x, state, convex, rows), dofs[rows]
                k = dofs.shape[1]
                i, j = np.triu_indices(k)
                upper = share.counts[rows] * H.reshape(len(rows), -1).take(i * k + j, axis=1)
                np.add.at(values, share.slots[rows].ravel(), upper.ravel())
            elif share.total is not None:
                H = term.hessian(x, state, convex, *([stress] if term.foresees else []))
                values += share.total @ H.T.ravel()
            elif motion is not None:  # what is quadratic is in the constant
                H = term.hessian(x, state, convex)
            if motion is not None and (moved := motion[dofs]).any():
                push = (H @ moved[:, :, None])[:, :, 0]
                load += np.bincount(dofs.ravel(), push.ravel(), minlength=len(x))
        return values[:-1], load[self.free]
