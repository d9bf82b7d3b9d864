"""Linear solvers for the symmetric Newton systems: symbolic work once, numeric work each time.

- "pardiso": MKL PARDISO (extra `fast`), LDL' with inertia; found by itself at run time.
- "superlu": scipy's SuperLU on a nested-dissection order of the nodes, with inertia.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from ..checks import InputError, suggestion
from ..unknowns import FloatArray

NAMES = ("auto", "pardiso", "superlu")
ROUND_OFF = 1e-13  # of the diagonal: what is left of a pivot that should be zero (sheets: 1e-6)


class NotConvergedError(ArithmeticError):
    """A solve that did not reach its tolerance."""

    work = 0  # factorisations that it took, where that is counted


class SlidesOffError(NotConvergedError):
    """A sheet that slides farther than what drives it."""


class SingularMatrixError(NotConvergedError):
    """The matrix cannot be factorised: a motion without stiffness."""


def linear_solver(
    name: str,
    pattern: csr_array,
    points: FloatArray,
    held: bool = False,
    symmetric: bool = True,
) -> Pardiso | SuperLU:
    """Return the linear solver of that name (of `NAMES`) for a fixed upper-triangular pattern.

    If the matrix is not `symmetric`, the pattern is the whole one, which is.

    "auto" takes PARDISO if it is installed, else SuperLU, which orders the unknowns by their flat
    points (n, 2), mm; those without one (nan) are eliminated last. A sheet that is `held` has no
    motion without stiffness; one between tools may, until they touch it. Raises InputError for an
    unknown name, or "pardiso" where it is not installed.
    """
    if name not in NAMES:
        raise InputError(f"unknown linear solver '{name}': {suggestion(name, NAMES)}")
    if name in ("auto", "pardiso"):
        try:
            return Pardiso(pattern, symmetric)
        except (ImportError, AttributeError) as error:  # missing, or of another make
            if name == "pardiso":
                raise InputError(
                    "linear solver 'pardiso' is not installed: pip install 'quasiform[fast]'"
                ) from error
    return SuperLU(pattern, points, held, symmetric)


def mirrored(upper: csr_array) -> tuple[csr_array, np.ndarray]:
    """Whole pattern of an upper triangle, and which of its values is where."""
    n, i, j = upper.shape[0], *upper.tocoo().coords
    off = np.flatnonzero(i != j)
    rows, columns = np.concatenate([i, j[off]]), np.concatenate([j, i[off]])
    source = np.concatenate([np.arange(len(i)), off])
    order = np.lexsort((columns, rows))
    indptr = np.searchsorted(rows[order], np.arange(n + 1))
    whole = csr_array((np.zeros(len(order)), columns[order], indptr), shape=(n, n))
    return whole, source[order]


class Pardiso:
    """MKL PARDISO, indefinite: analysed once, refactorised with new values."""

    name = "pardiso"

    def __init__(self, pattern: csr_array, symmetric: bool = True) -> None:
        import pymklpardiso

        # the public class looks at every row of the pattern in Python, which takes as long as
        # several factorisations; the one below it takes the pattern as it is
        kind = pymklpardiso.MTYPE_REAL_SYM_INDEF if symmetric else pymklpardiso.MTYPE_REAL_NONSYM
        self._solver = pymklpardiso._PardisoSolver(kind, 0)
        ia, ja = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
        self._solver.set_pattern(ia=ia, ja=ja, n=pattern.shape[0])
        self._analysed = False

    def factor(self, values: FloatArray) -> int:
        """Factorise; return the number of negative pivots."""
        factor = self._solver.refactor_values if self._analysed else self._solver.factor
        try:
            factor(values)
        except RuntimeError as error:
            raise SingularMatrixError(f"the tangent is singular: {error}") from error
        self._analysed = True
        return int(self._solver.get_iparm_value(22))

    def solve(self, b: FloatArray) -> FloatArray:
        return self._solver.solve(b)


class SuperLU:
    """scipy's SuperLU without pivoting on a geometric nested-dissection order."""

    name = "superlu"

    def __init__(
        self, pattern: csr_array, points: FloatArray, held: bool = False, symmetric: bool = True
    ) -> None:
        self.held = held
        n = pattern.shape[0]
        whole, source = mirrored(pattern) if symmetric else (pattern, np.arange(pattern.nnz))
        graph = csr_array((np.ones(whole.nnz), whole.indices, whole.indptr), shape=(n, n))
        self._order = nested_dissection(graph, points)
        place = np.empty(n, dtype=int)
        place[self._order] = np.arange(n)
        rows, columns = (place[numbers] for numbers in whole.tocoo().coords)
        by_column = np.lexsort((rows, columns))
        self._source = source[by_column]
        self._indices = rows[by_column].astype(np.int32)
        self._indptr = np.searchsorted(columns[by_column], np.arange(n + 1)).astype(np.int32)
        self._factor = None

    def factor(self, values: FloatArray) -> int:
        n = len(self._order)
        matrix = csc_array((values[self._source], self._indices, self._indptr), shape=(n, n))
        try:
            options = {"SymmetricMode": True}
            self._factor = splu(matrix, "NATURAL", diag_pivot_thresh=0.0, options=options)
        except RuntimeError as error:
            raise SingularMatrixError(f"the tangent is singular: {error}") from error
        pivots = self._factor.U.diagonal()
        lost = np.abs(pivots) <= ROUND_OFF * np.abs(matrix.diagonal())
        held = self.held and lost.any()
        if held or (self._factor.perm_r != np.arange(n)).any():
            # the signs would not be the inertia
            raise SingularMatrixError("the tangent is singular: a pivot is zero")
        return int((pivots < 0).sum())

    def solve(self, b: FloatArray) -> FloatArray:
        x = np.empty_like(b)
        x[self._order] = self._factor.solve(b[self._order])
        return x


def nested_dissection(graph: csr_array, points: FloatArray, leaf: int = 64) -> np.ndarray:
    """Elimination order (n,) by recursive bisection (George 1973), separators last.

    The plane is halved by coordinate; the separator is what couples the lower half to the upper.
    Unknowns at nan are put at the very end.
    """
    rigid = np.isnan(points).any(1)
    upper = np.zeros(len(points), dtype=bool)

    def divide(part: np.ndarray) -> list[np.ndarray]:
        if len(part) <= leaf:
            return [part]
        s = points[part, np.ptp(points[part], axis=0).argmax()]
        high = s > np.median(s)
        low, above = part[~high], part[high]
        upper[above] = True
        coupled = graph[low] @ upper > 0
        upper[above] = False
        if coupled.all() or not high.any():
            return [part]
        return [*divide(low[~coupled]), *divide(above), low[coupled]]

    return np.concatenate([*divide(np.flatnonzero(~rigid)), np.flatnonzero(rigid)])
