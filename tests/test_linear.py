"""Linear solvers: one solution from all of them, negative pivots counted, little fill."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from quasiform.checks import InputError
from quasiform.energy.contact import Contact
from quasiform.energy.membrane import Membrane
from quasiform.fabric import Fabric
from quasiform.net.blank import rectangle
from quasiform.potential import Potential
from quasiform.solve.linear import SingularMatrixError, linear_solver, nested_dissection
from quasiform.tools.shapes import Plane, Tool
from quasiform.unknowns import Unknowns


class System:
    """A stretched membrane that rests on a floating plate, held along one edge."""

    def __init__(self, size=5.0):
        blank = rectangle(80.0, 60.0, size)
        n = len(blank.nodes)
        held = np.isclose(blank.nodes[:, 0], -40.0)
        free = np.append(np.repeat(~held, 3), True)
        unknowns, memory = Unknowns(), (None, None)
        sheet = unknowns.sheet(blank, Fabric(), 3)
        plate = Contact(sheet, Tool("plate", Plane()), unknowns.add("plate", 1).dofs)
        potential = Potential([Membrane(sheet), plate], free, memory)
        z = np.random.default_rng(0).uniform(0.3, 0.49, n)
        x = np.append(np.column_stack([1.02 * blank.nodes, z]).ravel(), 0.0)
        self.pattern = potential.pattern
        self.values, _ = potential.hessian(x, memory, convex=True)
        self.points = unknowns.places()[free]
        self.b = np.random.default_rng(1).normal(size=len(self.points))

    def solver(self, name):
        if name == "pardiso":
            pytest.importorskip("pymklpardiso")
        return linear_solver(name, self.pattern, self.points)

    def matrix(self, values):
        p = self.pattern
        upper = csr_array((values, p.indices, p.indptr), shape=p.shape).toarray()
        return upper + np.triu(upper, 1).T

    @property
    def graph(self):
        """Symmetric sparsity pattern."""
        return csr_array(self.matrix(np.ones(self.pattern.nnz)))

    @property
    def diagonal(self):
        """Places of the diagonal in the values: the first of each row of an upper triangle."""
        return self.pattern.indptr[:-1]


@pytest.fixture(scope="module")
def system():
    return System()


every_solver = pytest.mark.parametrize("name", ["superlu", "pardiso"])


@every_solver
def test_solvers_agree(system, name):
    """Also with a second set of values, and for several right-hand sides."""
    solver = system.solver(name)
    assert solver.name == name
    stiffer = system.values.copy()
    stiffer[system.diagonal] *= 1.5
    for values in (system.values, stiffer):
        K = system.matrix(values)
        assert solver.factor(values) == 0
        for b in (system.b, np.roll(system.b, 7)):
            exact = np.linalg.solve(K, b)
            before = b.copy()
            assert_allclose(solver.solve(b), exact, rtol=0, atol=1e-5 * np.abs(exact).max())
            assert_array_equal(b, before)


@every_solver
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_negative_eigenvalues_are_counted(system, name, count):
    values = system.values.copy()
    some = np.linspace(10, len(system.b) - 1, 5).astype(int)[:count]
    values[system.diagonal[some]] -= 1e5
    K = system.matrix(values)
    assert (np.linalg.eigvalsh(K) < 0).sum() == count
    solver = system.solver(name)
    assert solver.factor(values) == count
    exact = np.linalg.solve(K, system.b)
    assert_allclose(solver.solve(system.b), exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def test_singular_matrix_is_refused(system):
    with pytest.raises(SingularMatrixError):
        system.solver("superlu").factor(0 * system.values)


def test_nested_dissection_is_a_permutation_with_rigid_motions_last(system):
    order = nested_dissection(system.graph, system.points)
    assert_array_equal(np.sort(order), np.arange(len(system.points)))
    assert order[-1] == len(system.points) - 1
    nowhere = np.full((3, 2), np.nan)
    assert_array_equal(nested_dissection(csr_array(np.eye(3)), nowhere), [0, 1, 2])


def test_nested_dissection_has_less_fill_than_the_natural_order():
    system = System(size=2.5)
    K = csr_array(system.matrix(system.values))

    def fill(order):
        factor = splu(
            K[order][:, order].tocsc(),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return factor.L.nnz

    dissected = fill(nested_dissection(system.graph, system.points))
    assert dissected < 0.9 * fill(np.arange(len(system.b)))  # along lines: a band matrix already
    assert dissected < 0.2 * fill(np.random.default_rng(0).permutation(len(system.b)))


def test_unknown_solver_is_refused_with_a_suggestion(system):
    with pytest.raises(InputError, match=r"unknown linear solver 'paradiso': .* 'pardiso'\?"):
        system.solver("paradiso")


def test_missing_pardiso_is_named_or_replaced(system, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymklpardiso", None)
    arguments = system.pattern, system.points
    with pytest.raises(InputError, match=r"'pardiso' is not installed: pip install"):
        linear_solver("pardiso", *arguments)
    assert linear_solver("auto", *arguments).name == "superlu"


def test_auto_takes_pardiso_where_it_is_installed(system):
    pytest.importorskip("pymklpardiso")
    assert system.solver("auto").name == "pardiso"
