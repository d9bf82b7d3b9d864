"""What is read off a sheet: draw-in at the outline, percentiles, where the shear is in doubt."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact
from quasiform.energy.membrane import Membrane
from quasiform.fabric import Fabric, ThreeStageLaw
from quasiform.model import Model
from quasiform.net import outline
from quasiform.net.blank import cut, rectangle, rotation
from quasiform.net.edges import disc, edge_points
from quasiform.result.measures import percentile, shear_gradient, waves
from quasiform.result.stability import local_waves, shear_stability
from quasiform.tools.shapes import Plane, Tool
from quasiform.unknowns import Unknowns

OUTWARD = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
L_SHAPE = outline.polygon([(-60, -40), (60, -40), (60, -10), (5, -10), (5, 40), (-60, 40)])
FAR_L = [(-60, -40), (60, -40), (60, -10), (-20, -10), (-20, 40), (-60, 40)]
BLANKS = {
    "rectangle": (rectangle(120.0, 80.0, 7.0), (60, 60, 40, 40)),
    "cut": (rectangle(120.0, 80.0, 7.0, orientation=30.0), (60, 60, 40, 40)),
    "beside the origin": (rectangle(120.0, 80.0, 7.0, centre=(200.0, 30.0)), (60, 60, 40, 40)),
    "disc": (cut(outline.disc(50.0), 7.0, 20.0), (50, 50, 50, 50)),
    "L": (cut(L_SHAPE, 7.0), (5, 60, 40, 40)),
    "L, its middle outside": (cut(outline.polygon(FAR_L), 7.0), (0, 60, 0, 40)),
    "ring": (
        cut(outline.with_holes(outline.disc(50.0), [outline.disc(30.0)]), 7.0),
        (50, 50, 50, 50),
    ),
}
every_blank = pytest.mark.parametrize("name", BLANKS)


def membrane_of(blank, fabric):
    return Membrane(Unknowns().sheet(blank, fabric, 3))


def positions(blank):
    return np.pad(blank.nodes, ((0, 0), (0, 1)))


@every_blank
def test_edge_points_are_the_outermost_on_both_axes(name):
    blank, reach = BLANKS[name]
    middle = 0.5 * (blank.nodes.min(0) + blank.nodes.max(0))
    edges = edge_points(blank)
    assert set(edges) == {side for side, r in zip(OUTWARD, reach, strict=True) if r}
    for (side, outward), r in zip(OUTWARD.items(), reach, strict=True):
        if not r:
            continue
        edge = edges[side]
        assert_allclose(edge.inward, np.negative(outward), atol=1e-12)
        assert_allclose(edge.flat, middle + r * np.array(outward), atol=0.6)
        assert_allclose(edge.shares.sum(), 1.0)
        assert (edge.shares >= 0).all()
        assert_allclose(edge.shares @ blank.nodes[edge.nodes], edge.flat)
        assert edge.draw_in(positions(blank)) == pytest.approx(0.0, abs=1e-12)


@every_blank
def test_draw_in_is_the_inward_motion(name):
    blank, _ = BLANKS[name]
    shrunk = positions(blank) * [0.9, 0.8, 1.0] + [3.0, -2.0, -50.0]
    for side, edge in edge_points(blank).items():
        axis, sign = "xy".index(side[1]), 1.0 if side[0] == "+" else -1.0
        expected = sign * ((0.1, 0.2)[axis] * edge.flat[axis] - (3.0, -2.0)[axis])
        assert edge.draw_in(shrunk) == pytest.approx(expected)
        assert edge.draw_in(shrunk[:, :2]) == pytest.approx(expected)


@pytest.mark.parametrize("turn", [90.0, 30.0, -45.0])
@every_blank
def test_edge_points_turn_with_the_blank(name, turn):
    blank, _ = BLANKS[name]
    R = rotation(turn)
    straight, turned = edge_points(blank), edge_points(blank.turned(turn), turn)
    assert set(straight) == set(turned)
    moved = blank.nodes @ [[0.9, 0.1], [0.0, 0.8]]
    for side, edge in straight.items():
        assert_allclose(turned[side].inward, R @ edge.inward, atol=1e-12)
        assert_allclose(turned[side].flat, R @ edge.flat, atol=1e-6)
        assert turned[side].draw_in(moved @ R.T) == pytest.approx(edge.draw_in(moved), abs=1e-6)


def test_percentile_weighs_by_area():
    values, areas = np.array([5.0, 1.0, 3.0]), np.array([1.0, 8.0, 1.0])
    assert percentile(values, areas, 0.5) == 1.0
    assert percentile(values, areas, 0.79) == 1.0
    assert percentile(values, areas, 0.85) == 3.0
    assert percentile(values, areas, 0.99) == 5.0
    assert percentile(values, areas, 1.0) == 5.0
    assert percentile(np.array([7.0]), np.array([0.1]), 0.99) == 7.0
    many = np.random.default_rng(0).normal(size=5000)
    assert percentile(many, np.ones(5000), 0.9) == pytest.approx(np.quantile(many, 0.9), abs=2e-3)


def test_disc_takes_triangles_by_their_centroid():
    blank = rectangle(120.0, 80.0, 2.0)
    inside = disc(blank, (20.0, -10.0), 15.0)
    assert_array_equal(inside, np.linalg.norm(blank.centroids - [20.0, -10.0], axis=1) <= 15.0)
    assert blank.areas[inside].sum() == pytest.approx(np.pi * 15**2, rel=0.02)
    assert not disc(blank, (200.0, 0.0), 15.0).any()


def sheared(blank, warp=0.0, weft=0.0, gamma=0.0):
    """Fibres along x and y stretched by `warp` and `weft`, sheared by `gamma` degrees."""
    g = np.radians(gamma)
    F = np.array([[1.0 + warp, 0.0, 0.0], (1.0 + weft) * np.array([np.sin(g), np.cos(g), 0.0])])
    return (blank.nodes @ F).ravel()


@pytest.mark.parametrize("law", ["locking", "best-fit"])
@pytest.mark.parametrize("gamma", [10.0, 35.0, 50.0])
@pytest.mark.parametrize(
    ("warp", "weft"), [(0.0, 1e-3), (1e-3, 0.0), (-2e-4, 1e-3), (1e-3, -2e-4), (1e-6, 1e-6)]
)
def test_shear_stability_is_the_least_curvature_of_the_energy_by_a_turn_of_a_fibre(
    law, gamma, warp, weft
):
    """d²W/dε² of f_a + ε m and f_b + ε m', the normals in the plane; by differences."""
    blank = rectangle(40.0, 30.0, 8.0)
    fabric = Fabric.preset(law)
    membrane, x = membrane_of(blank, fabric), sheared(blank, warp, weft, gamma)
    f = membrane.fibres(x)

    def energy(a, b):
        I4, I6, I8 = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1)
        W = fabric.warp.energy(I4, 1.0) + fabric.weft.energy(I8, 1.0)
        return W + fabric.shear.energy(I6)

    h, curvatures = 1e-4, []
    for i in (0, 1):
        fibre, other = f[:, i], f[:, 1 - i]
        m = other - (other * fibre).sum(1)[:, None] / (fibre**2).sum(1)[:, None] * fibre
        m /= np.linalg.norm(m, axis=1)[:, None]
        along = [energy(fibre + step * m, other) for step in (h, 0.0, -h)]
        curvatures.append((along[0] - 2 * along[1] + along[2]) / h**2)
    assert_allclose(shear_stability(membrane, x), np.min(curvatures, axis=0), rtol=2e-4, atol=1e-4)
    if warp != weft:
        assert np.argmin(curvatures, axis=0).max() == (weft < warp)


def test_a_flat_sheet_is_stable_in_shear_and_a_compressed_one_is_not():
    blank = rectangle(40.0, 30.0, 8.0)
    fabric = Fabric()
    membrane = membrane_of(blank, fabric)
    x = positions(blank).ravel()
    assert_allclose(shear_stability(membrane, x), fabric.shear.stiffness(0.0))
    assert (shear_stability(membrane, 0.99 * x) < 0).all()
    assert (shear_stability(membrane, 1.01 * x) > 1.0).all()


@every_blank
def test_shear_gradient_of_an_even_field_vanishes(name):
    blank, _ = BLANKS[name]
    assert_allclose(shear_gradient(blank, np.full(len(blank.triangles), 40.0)), 0.0, atol=1e-12)


@pytest.mark.parametrize("orientation", [0.0, 45.0])
def test_shear_gradient_of_a_linear_field_is_its_slope(orientation):
    """Away from the outline, in degrees by mm."""
    blank = rectangle(80.0, 80.0, 5.0, orientation)
    gradient = shear_gradient(blank, blank.centroids @ [0.3, -0.4])
    inside = (np.abs(blank.centroids) < 30.0).all(1)
    assert_allclose(gradient[inside], 0.5, rtol=1e-6)


def test_shear_gradient_of_a_band_is_its_height_over_the_size():
    """A jump by one row of cells is seen as the jump over twice the size, or less."""
    blank = rectangle(120.0, 80.0, 5.0)
    gamma = np.where(blank.centroids[:, 0] > 0, 30.0, 0.0)
    gradient = shear_gradient(blank, gamma)
    assert 30.0 / 10.0 <= gradient.max() <= 30.0 / 5.0
    assert_allclose(gradient[np.abs(blank.centroids[:, 0]) > 10.0], 0.0, atol=1e-12)


def test_doubts_do_not_depend_on_the_thickness():
    """Both are stresses and angles, not forces."""
    blank = rectangle(40.0, 30.0, 8.0)
    thin, thick = Fabric(), replace(Fabric(), thickness=3.0)
    x = sheared(blank, 1e-3, 2e-3, 30.0)
    assert_allclose(*(shear_stability(membrane_of(blank, fabric), x) for fabric in (thin, thick)))


# Local stability: bands of softening shear, and fibres that buckle


def sheet_in_space(length, width, size, fabric, gamma, strain, tool=False):
    """Model of a rectangle and its x: even shear and fibre strain, warp along x."""
    sheet = (unknowns := Unknowns()).sheet(rectangle(length, width, size), fabric, 3)
    terms = [Membrane(sheet), Bending(sheet)]
    if tool:
        table = Tool("table", Plane(), -fabric.thickness / 2)
        terms.append(Contact(sheet, table, unknowns.add("table", 1).dofs))
    x0, fixed, drive = unknowns.start(sheet)
    x0[sheet.dofs.size :] = -fabric.thickness / 2
    model = Model("sheet", unknowns, [sheet], terms, x0, fixed, drive, 1.0, 1.0, 1.0)
    x = x0.copy()
    x[sheet.dofs.ravel()] = sheared(sheet.blank, strain, strain, gamma)
    return model, x


def second_variation(model, x, axis, amplitude):
    """Second derivative of the energy along (n_nodes,) displacements along an axis."""
    d = np.zeros_like(x)
    d[model.sheet.dofs[:, axis]] = amplitude
    return sum(
        np.einsum("si,sij,sj", d[t.dofs], t.hessian(x, None, False), d[t.dofs]) for t in model.terms
    )


SOFT_FIBRES = ThreeStageLaw(C_ini=1.0)  # so that a band needs little length
SOFT = replace(Fabric(), warp=SOFT_FIBRES, weft=SOFT_FIBRES, in_plane_bending=0.03)


@pytest.mark.parametrize("axis", [1, 2])  # in the plane, across the warp; out of the plane
def test_only_waves_above_the_critical_wavelength_are_unstable(axis):
    name = ("band_wavelength_mm", "buckling_wavelength_mm")[axis - 1]
    model, x = sheet_in_space(600.0, 10.0, 1.0, SOFT, 40.0, -0.01)
    s, critical = model.sheet.blank.nodes[:, 0], local_waves(model, x)[1][name]
    for factor, sign in ((0.93, 1.0), (1.07, -1.0)):
        wave = np.sin(2 * np.pi * s / (factor * critical))
        assert sign * second_variation(model, x, axis, wave) > 0


def test_a_band_that_ends_needs_its_length():
    """Its ends stretch the weft; the best wave is √2 times the critical one."""
    model, x = sheet_in_space(400.0, 400.0, 8.0, SOFT, 40.0, -0.01)
    band = local_waves(model, x)[1]["band_wavelength_mm"]
    H = 0.99**2 * np.cos(np.radians(40.0)) ** 2
    least = band * np.sqrt(4.0 * H / -shear_stability(model.membrane, x)[0])
    for factor, sign in ((0.9, 1.0), (1.1, -1.0)):
        model, x = sheet_in_space(300.0, factor * least, 1.5, SOFT, 40.0, -0.01)
        X, Y = model.sheet.blank.nodes.T
        mode = np.sin(np.sqrt(2) * np.pi * X / band) * np.cos(np.pi * Y / (factor * least))
        assert sign * second_variation(model, x, 1, mode) > 0
        width = (0.75, 1.25)[sign < 0] * least  # runs are made of whole squares
        flags, _ = local_waves(*sheet_in_space(width, width, 4.0, SOFT, 40.0, -0.01))
        assert flags["bands_may_form"].any() == (sign < 0)


def test_runs_end_where_their_region_ends():
    """A long band has room along the weft, and a wave of it none along the warp, or the reverse."""
    for length, width in ((300.0, 8.0), (8.0, 300.0)):
        fabric = replace(SOFT, in_plane_bending=0.1)  # 19 mm, and 140 mm long
        flags, _ = local_waves(*sheet_in_space(length, width, 7.0, fabric, 40.0, -0.01))
        assert not flags["bands_may_form"].any()


@pytest.mark.parametrize(
    ("fabric", "strain", "size", "expected"),
    [
        (SOFT, -0.01, 5.0, True),
        (SOFT, -0.01, 2.0, False),  # the mesh shows them
        (replace(Fabric(), in_plane_bending=0.03), -1e-5, 5.0, False),  # no room
        (replace(Fabric(), in_plane_bending=0.0), -1e-5, 5.0, True),  # as fine as any mesh
    ],
)
def test_bands_are_flagged_where_the_mesh_does_not_show_them(fabric, strain, size, expected):
    model, x = sheet_in_space(200.0, 200.0, size, fabric, 40.0, strain)
    flags, figures = local_waves(model, x)
    assert figures["softening_share"] == pytest.approx(1.0)
    assert flags["bands_may_form"].all() == flags["bands_may_form"].any() == expected


def test_compression_without_softening_makes_no_bands():
    """Below 22 degrees shear itself is stiff: only the fibres' compression turns them."""
    model, x = sheet_in_space(80.0, 80.0, 5.0, replace(SOFT, in_plane_bending=0.0), 1.0, -0.2)
    assert (shear_stability(model.membrane, x) < 0).all()
    flags, figures = local_waves(model, x)
    assert figures["softening_share"] == 0
    assert not flags["bands_may_form"].any()


@pytest.mark.parametrize(
    ("strain", "size", "tool", "expected"),
    [
        (-1e-4, 8.0, False, True),  # 18 mm, finer than the mesh shows
        (-1e-4, 4.0, False, False),  # the mesh shows it
        (-1e-4, 8.0, True, False),  # a tool holds the sheet
        (-2e-7, 80.0, False, False),  # longer than the sheet
        (-1e-13, 80.0, False, False),  # round-off
        (1e-4, 8.0, False, False),
    ],
)
def test_compressed_fibres_are_flagged_where_they_may_buckle(strain, size, tool, expected):
    fabric = replace(Fabric(), bending_weft=1e4)  # the warp alone may buckle
    model, x = sheet_in_space(160.0, 40.0, size, fabric, 0.0, strain, tool)
    flags, figures = local_waves(model, x)
    assert flags["fibres_may_buckle"].all() == flags["fibres_may_buckle"].any() == expected
    assert not flags["bands_may_form"].any()
    if strain == -1e-4 and not tool:
        euler = 4 * np.pi**2 * 3.403 / (1.004 * 160.0**2)
        ratio = 2000.0 * (1 - (1 + strain) ** 2) / euler
        assert figures["compression_by_buckling_stress"] == pytest.approx(ratio, rel=1e-6)
        assert figures["compressed_share"] == pytest.approx(1.0)


def test_waves_lower_than_the_limit_are_not_counted():
    """A line of amplitude a and wavelength 40 mm has the curvature a (2 pi/40)^2 sin(2 pi s/40)."""
    s = np.arange(0.0, 201.0, 2.0)
    flat, along = np.c_[s, 0 * s], np.array([1.0, 0.0])
    for height, found in ((0.14, (1, 40.0)), (0.08, (0, None))):
        kappa = height * (2 * np.pi / 40) ** 2 * np.sin(2 * np.pi * s / 40)
        assert waves(flat, along, kappa) == (1, pytest.approx(40.0))
        assert waves(flat, along, kappa, 0.1) == found
    assert waves(flat, along, np.full(len(s), np.nan)) == (0, None)
