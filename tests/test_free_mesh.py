"""Meshes that do not follow the fibres: elements that do not lock, readers, and what is refused."""

import meshio
import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose

import quasiform as qf
from quasiform.checks import InputError
from quasiform.energy.bending import PatchBending
from quasiform.energy.membrane import Membrane, PairedMembrane, membrane_of
from quasiform.net.blank import rectangle
from quasiform.net.free_mesh import aligned_share, outline_of, own_mesh, triangulate
from quasiform.theory import OffAxisTension
from quasiform.unknowns import Unknowns

FABRIC = qf.Fabric(in_plane_bending=0.2)


def scattered(size=6.0, orientation=20.0):
    """A free triangulation without gmsh: Delaunay of a jittered grid, read as the user's own."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(3)
    x, y = (c.ravel() for c in np.meshgrid(np.arange(0, 43, size), np.arange(0, 31, size)))
    points = np.column_stack([x, y])
    inner = (x > 0) & (x < x.max()) & (y > 0) & (y < y.max())
    points[inner] += rng.uniform(-0.25, 0.25, (inner.sum(), 2)) * size
    return points, Delaunay(points).simplices


@pytest.fixture
def blank(tmp_path):
    points, triangles = scattered()
    meshio.write(tmp_path / "own.vtu", meshio.Mesh(points, [("triangle", triangles)]))
    return own_mesh(tmp_path / "own.vtu", orientation=20.0)


def sheet_of(blank, dim):
    return Unknowns().sheet(blank, FABRIC, dim)


def terms(blank):
    yield PairedMembrane(sheet_of(blank, 2)), 2
    yield PairedMembrane(sheet_of(blank, 3)), 3
    yield PatchBending(sheet_of(blank, 3)), 3


def test_derivatives_follow_the_energy(blank):
    rng = np.random.default_rng(0)
    for term, dim in terms(blank):
        n = dim * len(blank.nodes)
        x = np.pad(blank.nodes, ((0, 0), (0, dim - 2))).ravel() + rng.normal(size=n) * 0.3
        d, h = rng.normal(size=n), 1e-6

        def total(x, term=term, n=n):
            return np.bincount(term.dofs.ravel(), term.gradient(x).ravel(), minlength=n)

        slope = (term.energy(x + h * d).sum() - term.energy(x - h * d).sum()) / (2 * h)
        assert_allclose(total(x) @ d, slope, rtol=1e-6)
        H = term.hessian(x, None, False)
        push = np.bincount(
            term.dofs.ravel(), np.einsum("nij,nj->ni", H, d[term.dofs]).ravel(), minlength=n
        )
        change = (total(x + h * d) - total(x - h * d)) / (2 * h)
        assert_allclose(push, change, atol=1e-6 * np.abs(change).max())
        assert_allclose(H, H.transpose(0, 2, 1), atol=1e-9 * np.abs(H).max())
        low = np.linalg.eigvalsh(term.hessian(x, None, True)).min()
        assert low > -1e-12 * np.abs(H).max()


def test_the_foreseen_tension_of_pairs_is_the_linearised_one(blank):
    membrane, n = PairedMembrane(sheet_of(blank, 3)), 3 * len(blank.nodes)
    rng = np.random.default_rng(0)
    x = np.pad(blank.nodes, ((0, 0), (0, 1))).ravel() + rng.normal(size=n) * 0.3
    dx, h = rng.normal(size=n), 1e-6
    now = membrane.foreseen_stress(x, 0 * dx)
    ahead = membrane.foreseen_stress(x, dx)
    low, high = (membrane.foreseen_stress(x + s * h * dx, 0 * dx) for s in (-1, 1))
    rise = (high - low) / (2 * h)
    for fibre in (0, 1):
        change = (ahead - now)[fibre, fibre]
        assert_allclose(
            change, rise[fibre, fibre], rtol=1e-6, atol=1e-6 * np.abs(rise[fibre]).max()
        )


def test_rigid_motion_costs_nothing_and_area_is_shared_out(blank):
    angle = 0.7
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    x = (np.pad(blank.nodes, ((0, 0), (0, 1))) @ R.T + [3.0, -2.0, 5.0]).ravel()
    for term, dim in terms(blank):
        if dim == 3:
            assert abs(term.energy(x).sum()) < 1e-9
    volume = PairedMembrane(sheet_of(blank, 2)).whole.sum()
    assert_allclose(volume, FABRIC.thickness * 42.0 * 30.0)


def test_homogeneous_strain_is_that_of_the_plain_membrane(blank):
    F = np.array([[1.02, 0.3], [0.1, 0.97]])
    x = (blank.nodes @ F.T).ravel()
    paired, plain = PairedMembrane(sheet_of(blank, 2)), Membrane(sheet_of(blank, 2))
    assert_allclose(paired.energy(x).sum(), plain.energy(x).sum(), rtol=1e-12)
    assert_allclose(paired.shear_angle(x), plain.shear_angle(x), rtol=1e-9)


def test_quadratic_forms_have_exact_curvature(blank):
    a, b = blank.nodes @ blank.warp, blank.nodes @ blank.weft
    for form, curvature in ((a**2, (2.0, 0.0)), (b**2, (0.0, 2.0)), (a * b, (0.0, 0.0))):
        z = 1e-6 * form
        x = np.column_stack([blank.nodes, z]).ravel()
        kappa = PatchBending(sheet_of(blank, 3)).curvature(x)
        assert_allclose(kappa, np.tile(1e-6 * np.array(curvature), (len(kappa), 1)), atol=1e-9)


def test_every_triangle_is_in_one_pair(blank):
    assert (np.bincount(np.unique(blank.pairs, axis=0).ravel()) >= 1).all()
    proper = blank.pairs[blank.pairs[:, 0] != blank.pairs[:, 1]]
    assert len(np.unique(proper)) == proper.size
    assert proper.size > 0.9 * len(blank.triangles)
    assert aligned_share(blank) < 0.1
    assert type(membrane_of(sheet_of(blank, 3))) is PairedMembrane
    assert type(membrane_of(sheet_of(rectangle(20, 20, 5), 3))) is Membrane


def test_quadrilaterals_are_pairs_and_an_aligned_mesh_needs_none(tmp_path):
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
    points = np.column_stack([x.ravel(), y.ravel()])
    quads = np.array([[i, i + 1, i + 5, i + 4] for i in (0, 1, 2, 4, 5, 6)])
    meshio.write(tmp_path / "quads.vtu", meshio.Mesh(10 * points, [("quad", quads[:, ::-1])]))
    turned = own_mesh(tmp_path / "quads.vtu", orientation=30.0)
    assert len(turned.pairs) == 6
    assert_allclose(turned.areas, 50.0)
    assert_allclose(outline_of(turned).area, 600.0)
    assert own_mesh(tmp_path / "quads.vtu").pairs is None


@pytest.mark.parametrize(
    ("points", "cells", "message"),
    [
        ([[0, 0, 0], [1, 0, 0]], [("line", [[0, 1]])], "no triangles or quadrilaterals"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]], [("triangle", [[0, 1, 2]])], "not flat"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [("triangle", [[0, 1, 2]])], "element 1 has no area"),
    ],
)
def test_defects_of_a_mesh_are_named(tmp_path, points, cells, message):
    meshio.write(tmp_path / "bad.vtu", meshio.Mesh(np.array(points, dtype=float), cells))
    with pytest.raises(InputError, match=rf"bad\.vtu: .*{message}"):
        own_mesh(tmp_path / "bad.vtu")


def test_off_axis_tension_on_a_free_mesh_does_not_lock():
    pytest.importorskip("gmsh")
    for angle, displacement, band in ((45, 30.0, 0.05), (30, 10.0, 0.25)):
        scene = qf.off_axis_tension(angle, displacement=displacement, size=10.4, mesh="free")
        assert 1900 < len(scene.sheet.blank.triangles) < 2100
        result = qf.solve(scene, increment=displacement / 3, estimate=False)
        theory = OffAxisTension(320, 160, np.radians(angle))
        fabric = scene.sheet.fabric
        force = theory.force(displacement, fabric.shear.stress, fabric.thickness)
        assert_allclose(result.force, force, rtol=band)
        assert any(
            "do not follow" in why or "does not follow" in why for _, why in scene.description
        )


def test_triangulation_covers_the_outline_with_its_holes():
    pytest.importorskip("gmsh")
    outline = shapely.box(0, 0, 60, 40).difference(shapely.box(20, 10, 35, 25))
    blank = triangulate(outline, 5.0, 15.0)
    assert_allclose(blank.areas.sum(), outline.area, rtol=1e-9)
    assert_allclose(outline_of(blank).area, outline.area, rtol=1e-9)
    assert_allclose(blank.warp, [np.cos(np.radians(15)), np.sin(np.radians(15))])
