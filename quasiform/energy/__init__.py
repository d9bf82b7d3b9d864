"""Energy terms, one file an energy, and their sum.

A term is a plain object with a fixed table of degrees of freedom and the energies, gradients and
Hessians of its stencils::

    dofs                  (n_stencils, n_local)            numbers into x, fixed for the whole run
    energy(x)             (n_stencils,)                    mJ
    gradient(x)           (n_stencils, n_local)            N
    hessian(x, convex)    (n_stencils, n_local, n_local)   N/mm, symmetric

x is the flat vector of node positions followed by the rigid degrees of freedom (tool heights, load
factors). Evaluating changes nothing. A term with memory also has `refresh(x)` (lagged values,
between Newton solves) and `commit(x)` (after a converged increment); with `memory()`, which returns
all that it remembers as arrays by name, and `recall(memory)`, a run that was killed can be carried
on. A term whose Hessian is the same everywhere may say so, `quadratic = True`: it is then evaluated
and summed once. Gradients and Hessians that are kept with the stencils as the last axis in memory
are summed without a copy.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from scipy.sparse import csr_array

FloatArray = np.ndarray


class Term(Protocol):
    """One energy of the sum."""

    name: str
    dofs: np.ndarray

    def energy(self, x: FloatArray) -> FloatArray: ...
    def gradient(self, x: FloatArray) -> FloatArray: ...
    def hessian(self, x: FloatArray, convex: bool) -> FloatArray: ...


@runtime_checkable
class Remembering(Protocol):
    """A term with memory."""

    def refresh(self, x: FloatArray) -> None: ...
    def commit(self, x: FloatArray) -> None: ...


@runtime_checkable
class Selective(Protocol):
    """A term of which few stencils act at a time: `hessian` can be asked for these only."""

    def active(self, x: FloatArray) -> np.ndarray: ...
    def hessian(self, x: FloatArray, convex: bool, rows: np.ndarray) -> FloatArray: ...


@runtime_checkable
class Foreseeing(Protocol):
    """A term whose Hessian can take the stress that the last step foresaw instead of that at x."""

    def foreseen_stress(self, x: FloatArray, dx: FloatArray) -> FloatArray: ...
    def hessian(self, x: FloatArray, convex: bool, stress: FloatArray | None) -> FloatArray: ...


class Potential:
    """The sum of the energy terms over the free degrees of freedom, with a fixed sparsity pattern.

    Parameters
    ----------
    terms : list of Term
    free : (n_dofs,) bool array
        Degrees of freedom to be solved for.
    """

    def __init__(self, terms: list[Term], free: np.ndarray) -> None:
        self.terms, self.free = terms, free
        dofs = np.concatenate([term.dofs.T.ravel() for term in terms])
        ones, local = np.ones(len(dofs)), np.arange(len(dofs))
        self._sum_of_gradients = csr_array((ones, (dofs, local)), (len(free), len(dofs)))
        number = np.where(free, np.cumsum(free) - 1, -1)
        n = int(free.sum())
        keys, shares = [], []
        for term in terms:
            i, j = np.triu_indices(term.dofs.shape[1])
            a, b = number[term.dofs[:, i]], number[term.dofs[:, j]]
            key = np.minimum(a, b) * n + np.maximum(a, b)
            keys.append(np.where(np.minimum(a, b) < 0, n * n, key))  # prescribed: a last slot
            # where two of a stencil are one degree of freedom, H_ij and H_ji fall on its diagonal
            shares.append(np.where((a == b) & (i != j), 2, 1).astype(np.int8))
        diagonal = np.arange(n) * (n + 1)
        keys_of_all = np.concatenate([*(key.ravel() for key in keys), diagonal, [n * n]])
        unique, slots = np.unique(keys_of_all, return_inverse=True)
        nnz = len(unique) - 1
        indptr = np.searchsorted(unique, np.arange(n + 1) * n)
        self.pattern = csr_array((np.zeros(nnz), unique[:-1] % n, indptr), shape=(n, n))
        # where Hessians go: by stencil if few act at a time, else as the sum of all
        self._slots, self._sums = [None] * len(terms), [None] * len(terms)
        self._constant = np.zeros(nnz + 1)
        for t, (term, key, share) in enumerate(zip(terms, keys, shares, strict=True)):
            own, slots = slots[: key.size].reshape(key.shape), slots[key.size :]
            if isinstance(term, Selective):
                self._slots[t] = own.astype(np.int32), share
                continue
            m, k = term.dofs.shape
            i, j = np.triu_indices(k)
            place = (i * k + j) * m + np.arange(m)[:, None]  # in an array with the stencils last
            entries = share.ravel().astype(float), (own.ravel(), place.ravel())
            total = csr_array(entries, shape=(nnz + 1, k * k * m))
            if getattr(term, "quadratic", False):
                self._constant += total @ term.hessian(np.zeros(len(free)), False).T.ravel()
            else:
                self._sums[t] = total

    def energy(self, x: FloatArray) -> float:
        """Total energy, mJ."""
        return float(sum(term.energy(x).sum() for term in self.terms))

    def gradient(self, x: FloatArray) -> FloatArray:
        """(n_dofs,) derivative by all degrees of freedom, N; zero on the free ones at rest."""
        return self._sum_of_gradients @ np.concatenate(
            [term.gradient(x).T.ravel() for term in self.terms]
        )

    def hessian(
        self,
        x: FloatArray,
        convex: bool,
        motion: FloatArray | None = None,
        stress: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Upper triangle of the free Hessian in the fixed pattern, and its product with a motion.

        Parameters
        ----------
        x : (n_dofs,) array, mm
        convex : bool
            Take the nearby positive semi-definite Hessian of each term.
        motion : (n_dofs,) array, mm, optional
            A motion of the prescribed degrees of freedom.
        stress : array, optional
            For the terms that foresee one.

        Returns
        -------
        values : (nnz,) array, N/mm
            Data for `pattern` (upper triangle, CSR).
        load : (n_free,) array, N
            Change of the free forces under `motion`; zeros without one.
        """
        values = self._constant.copy()
        load = np.zeros(len(x))
        for term, slots, total in zip(self.terms, self._slots, self._sums, strict=True):
            dofs = term.dofs
            if slots is not None:
                rows = term.active(x)
                if not len(rows):
                    continue
                H, dofs = term.hessian(x, convex, rows), dofs[rows]
                slots, share = (table[rows] for table in slots)
                i, j = np.triu_indices(dofs.shape[1])
                upper = share * H.reshape(len(rows), -1).take(i * dofs.shape[1] + j, axis=1)
                np.add.at(values, slots.ravel(), upper.ravel())
            elif total is not None:
                foreseen = [stress] if isinstance(term, Foreseeing) else []
                H = term.hessian(x, convex, *foreseen)
                values += total @ H.T.ravel()
            elif motion is not None:  # what is quadratic is in the constant
                H = term.hessian(x, convex)
            if motion is not None and (moved := motion[dofs]).any():
                push = (H @ moved[:, :, None])[:, :, 0]
                load += np.bincount(dofs.ravel(), push.ravel(), minlength=len(x))
        return values[:-1], load[self.free]
