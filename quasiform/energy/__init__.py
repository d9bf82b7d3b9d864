"""Energy terms, one file an energy, and their sum.

A term is a plain object with a fixed table of degrees of freedom and the energies, gradients and
Hessians of its stencils::

    dofs                  (n_stencils, n_local)            numbers into x, fixed for the whole run
    energy(x)             (n_stencils,)                    mJ
    gradient(x)           (n_stencils, n_local)            N
    hessian(x, convex)    (n_stencils, n_local, n_local)   N/mm, symmetric

x is the flat vector of node positions followed by the rigid degrees of freedom (tool heights, load
factors). Evaluating changes nothing. A term with memory also has `refresh(x)` (lagged values,
between Newton solves) and `commit(x)` (after a converged increment).
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
        number = np.where(free, np.cumsum(free) - 1, -1)
        n = int(free.sum())
        keys, self._kept = [], []
        for term in terms:
            local = number[term.dofs]
            rows = np.repeat(local[:, :, None], local.shape[1], axis=2).ravel()
            columns = np.repeat(local[:, None, :], local.shape[1], axis=1).ravel()
            kept = np.flatnonzero((rows >= 0) & (columns >= rows))  # upper triangle
            self._kept.append(kept)
            keys.append(rows[kept].astype(np.int64) * n + columns[kept])
        diagonal = np.arange(n, dtype=np.int64) * (n + 1)
        unique, inverse = np.unique(np.concatenate([*keys, diagonal]), return_inverse=True)
        self._slots = np.split(inverse, np.cumsum([len(k) for k in keys]))[:-1]
        self._selective = [isinstance(term, Selective) for term in terms]
        for i, term in enumerate(terms):
            if self._selective[i]:  # by stencil; what is not kept goes to a last slot
                slots = np.full(term.dofs.size * term.dofs.shape[1], len(unique))
                slots[self._kept[i]] = self._slots[i]
                self._slots[i] = slots.reshape(len(term.dofs), -1).astype(np.int32)
        indptr = np.searchsorted(unique, np.arange(n + 1, dtype=np.int64) * n)
        self.pattern = csr_array((np.zeros(len(unique)), unique % n, indptr), shape=(n, n))

    def energy(self, x: FloatArray) -> float:
        """Total energy, mJ."""
        return float(sum(term.energy(x).sum() for term in self.terms))

    def gradient(self, x: FloatArray) -> FloatArray:
        """(n_dofs,) derivative by all degrees of freedom, N; zero on the free ones at rest."""
        g = np.zeros(len(x))
        for term in self.terms:
            g += np.bincount(term.dofs.ravel(), term.gradient(x).ravel(), minlength=len(x))
        return g

    def hessian(
        self, x: FloatArray, convex: bool, motion: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Upper triangle of the free Hessian in the fixed pattern, and its product with a motion.

        Parameters
        ----------
        x : (n_dofs,) array, mm
        convex : bool
            Take the nearby positive semi-definite Hessian of each term.
        motion : (n_dofs,) array, mm, optional
            A motion of the prescribed degrees of freedom.

        Returns
        -------
        values : (nnz,) array, N/mm
            Data for `pattern` (upper triangle, CSR).
        load : (n_free,) array, N
            Change of the free forces under `motion`; zeros without one.
        """
        values = np.zeros(self.pattern.nnz)
        load = np.zeros(len(x))
        for term, selective, kept, slots in zip(
            self.terms, self._selective, self._kept, self._slots, strict=True
        ):
            dofs = term.dofs
            if selective:
                rows = term.active(x)
                if not len(rows):
                    continue
                H, dofs = term.hessian(x, convex, rows), dofs[rows]
                new = np.bincount(slots[rows].ravel(), H.ravel(), minlength=len(values) + 1)
                values += new[:-1]
            else:
                H = term.hessian(x, convex)
                values += np.bincount(slots, H.reshape(-1)[kept], minlength=len(values))
            if motion is not None and (moved := motion[dofs]).any():
                push = (H @ moved[:, :, None])[:, :, 0]
                load += np.bincount(dofs.ravel(), push.ravel(), minlength=len(x))
        return values, load[self.free]
