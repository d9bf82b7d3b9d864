"""The energies once more as plain scikit-fem forms: residuals and tangents agree to round-off."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import csr_array, diags_array, eye_array, kron
from skfem import (
    Basis,
    BilinearForm,
    ElementLineP1,
    ElementTriP1,
    ElementVector,
    InteriorFacetBasis,
    LinearForm,
    asm,
)

from quasiform.energy.bending import Bending
from quasiform.energy.contact import BLEND, Contact, at_edges, at_nodes
from quasiform.energy.membrane import Membrane
from quasiform.fabric import Fabric
from quasiform.net.blank import rectangle
from quasiform.potential import Potential
from quasiform.tools.shapes import Tool, ball
from quasiform.unknowns import Unknowns

BLANKS = {
    "aligned": rectangle(60.0, 40.0, 8.0),
    "at 45": rectangle(60.0, 40.0, 7.0, orientation=45.0),
    "cut": rectangle(60.0, 40.0, 8.0, orientation=30.0),
}
every_blank = pytest.mark.parametrize("blank", BLANKS.values(), ids=BLANKS)
CENTROID = np.full((2, 1), 1 / 3), np.array([0.5])
CORNERS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.full(3, 1 / 6)
MIDDLES = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5]]), np.full(3, 1 / 6)


def deformed(blank, dim):
    """Positions (flat vector) of a sheet stretched, compressed, sheared and, in space, bent."""
    noise = np.random.default_rng(0).uniform(-0.6, 0.6, (len(blank.nodes), dim))
    F = np.eye(dim)[:, :2] + [[0.02, 0.3], [0.1, 0.0], [0.0, 0.2]][:dim]
    return (blank.nodes @ F.T + noise).ravel()


def assembled(term, x):
    """Gradient and full Hessian of a term, as `Potential` sums them."""
    memory = (None,)
    potential = Potential([term], np.ones(len(x), dtype=bool), memory)
    values, _ = potential.hessian(x, memory, convex=False)
    p = potential.pattern
    upper = csr_array((values, p.indices, p.indptr), shape=p.shape).toarray()
    return potential.gradient(x, memory), upper + np.triu(upper, 1).T


def assert_same(actual, oracle):
    assert np.abs(oracle).max() > 0
    assert_allclose(actual, oracle, rtol=0, atol=1e-10 * np.abs(oracle).max())


def dot(u, v):
    """u·v of two vector fields."""
    return np.einsum("i...,i...", u, v)


@every_blank
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", ["best-fit", "locking"])
def test_membrane(blank, dim, law):
    """R(v) = ∫ t0 Σ W_k' δI_k(v) and its derivative, with F = ∇x and I_k of F a0, F b0."""
    fabric = Fabric.preset(law)
    t0, warp, weft, shear = fabric.thickness, fabric.warp, fabric.weft, fabric.shear
    basis = Basis(blank.mesh, ElementVector(ElementTriP1(), dim), quadrature=CENTROID)

    def fibres(gradient):
        return (np.einsum("ij...,j->i...", gradient, fibre) for fibre in (blank.warp, blank.weft))

    @LinearForm
    def residual(v, w):
        (a, b), (va, vb) = fibres(w["x_prior"].grad), fibres(v.grad)
        first4, first6, first8 = (
            warp.stress(dot(a, a), 1),
            shear.stress(dot(a, b)),
            weft.stress(dot(b, b), 1),
        )
        return t0 * (
            first4 * 2 * dot(a, va) + first6 * (dot(a, vb) + dot(b, va)) + first8 * 2 * dot(b, vb)
        )

    @BilinearForm
    def tangent(u, v, w):
        (a, b), (ua, ub), (va, vb) = (fibres(f.grad) for f in (w["x_prior"], u, v))
        I4, I6, I8 = dot(a, a), dot(a, b), dot(b, b)
        material = (
            warp.stiffness(I4, 1) * 4 * dot(a, ua) * dot(a, va)
            + shear.stiffness(I6) * (dot(a, ub) + dot(b, ua)) * (dot(a, vb) + dot(b, va))
            + weft.stiffness(I8, 1) * 4 * dot(b, ub) * dot(b, vb)
        )
        geometric = (
            warp.stress(I4, 1) * 2 * dot(ua, va)
            + shear.stress(I6) * (dot(ua, vb) + dot(ub, va))
            + weft.stress(I8, 1) * 2 * dot(ub, vb)
        )
        return t0 * (material + geometric)

    x = deformed(blank, dim)
    prior = basis.interpolate(x)
    g, H = assembled(Membrane(Unknowns().sheet(blank, fabric, dim)), x)
    assert_same(g, residual.assemble(basis, x_prior=prior))
    assert_same(H, tangent.assemble(basis, x_prior=prior).toarray())


@every_blank
def test_bending(blank):
    """With the in-plane curvature resisted in full: ½ Σ A B |[x']/h|², jumps of the slope.

    ∫ v ds gives the half lengths h of the lines about a node, h_warp h_weft the area A.
    """
    fabric = Fabric(in_plane_bending=1.0)

    @LinearForm
    def length(v, w):
        return v

    @BilinearForm
    def jump(u, v, w):
        i, j = w.idx
        return (-1.0) ** (i + j) * w.weight * u.grad[0] * v.grad[0]

    n = len(blank.nodes)
    lines = [blank.fibre_lines(family) for family in ("warp", "weft")]
    halves = np.zeros((2, n))
    for line, half in zip(lines, halves, strict=True):
        basis = Basis(line, ElementLineP1())
        half[: basis.N] = length.assemble(basis)  # the last nodes may lie on no such line
    K = csr_array((n, n))
    for line, half, B in zip(
        lines, halves, (fabric.bending_warp, fabric.bending_weft), strict=True
    ):
        sides = [InteriorFacetBasis(line, ElementLineP1(), side=side) for side in (0, 1)]
        nodes = line.facets[0, sides[0].find]
        weight = B * halves[:, nodes].prod(0) / half[nodes] ** 2
        jumps = csr_array(asm(jump, sides, sides, weight=weight[:, None]))
        jumps.resize((n, n))
        K = K + jumps
    K = kron(K, np.eye(3)).toarray()

    term = Bending(Unknowns().sheet(blank, fabric, 3))
    for x in (deformed(blank, 3), deformed(blank, 3) ** 2 / 30.0):
        g, H = assembled(term, x)
        assert_same(H, K)
        assert_same(g, K @ x)
        assert_allclose(term.energy(x).sum(), 0.5 * x @ K @ x)


def averaging(blank):
    """(n, n) sparse 1 - Σ L/24: L is the graph Laplacian of the fibre lines, ends left out."""

    @BilinearForm
    def laplacian(u, v, w):
        return w.h * u.grad[0] * v.grad[0]

    n = len(blank.nodes)
    W = eye_array(n, format="csr")
    for family in ("warp", "weft"):
        line = blank.fibre_lines(family)
        L = csr_array(laplacian.assemble(Basis(line, ElementLineP1())))
        L.resize((n, n))
        inner = np.bincount(line.t.ravel(), minlength=n) == 2
        W = W - diags_array(inner / 24.0) @ L
    return kron(W, np.eye(3)).tocsr()


@every_blank
@pytest.mark.parametrize("at", [at_nodes, at_edges])
def test_contact(blank, at):
    """R(v) = -∫ φ'(p) n·v with the corners or the middles of edges as quadrature points.

    At the corners the sheet is the averaged one, x = W x_nodes and v = W v_nodes.
    """
    fabric = Fabric()
    k, e = fabric.compaction, BLEND * fabric.thickness
    sphere = ball(100.0)
    quadrature, W, sag = CORNERS, averaging(blank), 0.0
    if at is at_edges:
        quadrature, W = MIDDLES, eye_array(3 * len(blank.nodes), format="csr")
        corners = blank.nodes[blank.triangles]
        sag = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2) / 8
    basis = Basis(blank.mesh, ElementVector(ElementTriP1(), 3), quadrature=quadrature)

    def distance(x):
        """d, n and its derivative at x, with the components in front."""
        d, n, curvature = sphere.distance(x.reshape(3, -1).T)
        shape = x.shape[1:]
        return (
            d.reshape(shape),
            np.moveaxis(n, 0, -1).reshape(3, *shape),
            np.moveaxis(curvature, 0, -1).reshape(3, 3, *shape),
        )

    @LinearForm
    def residual(v, w):
        d, n, _ = distance(np.asarray(w["x_prior"]))
        p = np.maximum(fabric.thickness / 2 - d - sag, 0)
        return -k * np.where(p < e, p**2 / (2 * e), p - e / 2) * dot(n, v)

    @BilinearForm
    def tangent(u, v, w):
        d, n, curvature = distance(np.asarray(w["x_prior"]))
        p = np.maximum(fabric.thickness / 2 - d - sag, 0)
        normal = k * np.minimum(p / e, 1) * dot(n, u) * dot(n, v)
        bent = np.einsum("ij...,i...,j...", curvature, u, v)
        return normal - k * np.where(p < e, p**2 / (2 * e), p - e / 2) * bent

    # resting on top of the sphere, up to 0.3 mm inside (deeper by what an edge may sag)
    depth = np.random.default_rng(1).uniform(-0.1, 0.3, len(blank.nodes)) + np.mean(sag)
    height = 100.0 + fabric.thickness / 2 - depth
    x = np.column_stack([blank.nodes, np.sqrt(height**2 - (blank.nodes**2).sum(1))]).ravel()
    prior = basis.interpolate(W @ x)
    sheet = Unknowns().sheet(blank, fabric, 3)
    term = Contact(sheet, Tool("sphere", sphere), len(x), at(blank))
    assert 0.2 < (term.penetration(np.append(x, 0.0)) > 0).mean() < 1.0
    g, H = assembled(term, np.append(x, 0.0))
    assert_same(g[:-1], W.T @ residual.assemble(basis, x_prior=prior))
    oracle = W.T @ csr_array(tangent.assemble(basis, x_prior=prior)) @ W
    assert_same(H[:-1, :-1], oracle.toarray())
