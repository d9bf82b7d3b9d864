"""Stacks of plies: the energy between two plies, exact cases, scenes, refusals and results."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator

import quasiform as qf
from quasiform import theory
from quasiform.console import terminal
from quasiform.console.cli import main
from quasiform.draw import plot, view
from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact
from quasiform.energy.friction import STICK
from quasiform.energy.membrane import Membrane
from quasiform.energy.plies import PlyContact, PlyFriction
from quasiform.energy.stitches import Stitches
from quasiform.energy.weight import GRAVITY, SheetWeight, ToolWeight
from quasiform.recipe import Recipe
from quasiform.result.assumed import assumed
from quasiform.result.certificate import _not_reported
from quasiform.result.measures import max_ply_penetration
from quasiform.result.plies import between_plies
from quasiform.result.record import Record
from quasiform.result.sheet import FormedSheet
from quasiform.scenes.fabric_tests import hanging_strip
from quasiform.scenes.stack import joined
from quasiform.solve.tangent import Tangent
from quasiform.studies.run import _row
from quasiform.tools.shapes import Plane, flipped
from quasiform.unknowns import Unknowns

FABRIC = qf.Fabric()
SLIT = [[60.0, 0.0], [155.0, 0.0]]
T0 = FABRIC.thickness


# The energy


def on_a_dome(radius=100.0, size=8.0, turn=45.0):
    """Two plies of other fibre directions on a dome, pressed a little into each other."""
    unknowns = Unknowns()
    plies = [
        unknowns.sheet(qf.rectangle(60.0, 50.0, size, angle), FABRIC, 3, 0.0, name)
        for name, angle in (("ply 1", 0.0), ("ply 2", turn))
    ]
    x = np.zeros(unknowns.size)
    for ply, r in zip(plies, (radius + 0.98 * T0, radius), strict=True):
        X = ply.blank.nodes
        far, about = np.linalg.norm(X, axis=1) / radius, np.arctan2(X[:, 1], X[:, 0])
        flat = [np.cos(about) * np.sin(far), np.sin(about) * np.sin(far), np.cos(far)]
        x[ply.dofs] = r * np.column_stack(flat)
    return plies, x


def terms_on_a_dome():
    (above, below), x = on_a_dome()
    contacts = PlyContact(above, below, True), PlyContact(below, above, False)
    rng = np.random.default_rng(0)
    moved = x + rng.normal(scale=0.02, size=len(x))
    trial = moved + rng.normal(scale=0.02, size=len(x))
    frictions = [PlyFriction(contact, 0.3) for contact in contacts]
    states = [term.refresh(moved, term.initial(x)) for term in (*contacts, *frictions)]
    return list(zip((*contacts, *frictions), states, strict=True)), trial, (above, below)


@pytest.mark.parametrize("k", range(4))
def test_derivatives_are_exact_for_fixed_pairs(k):
    cases, x, _ = terms_on_a_dome()
    term, state = cases[k]
    assert len(term.active(x, state)) > 5
    d, h = np.random.default_rng(1).normal(size=len(x)), 1e-6
    ends = [x + h * d, x - h * d]
    difference = np.subtract(*(term.energy(end, state).sum() for end in ends)) / (2 * h)
    slope = (term.gradient(x, state) * d[state.dofs]).sum()
    assert slope == pytest.approx(difference, rel=1e-6, abs=1e-9)
    H = term.hessian(x, state, False)
    change = np.subtract(*(term.gradient(end, state) for end in ends)) / (2 * h)
    product = np.einsum("mij,mj->mi", H, d[state.dofs])
    assert_allclose(product, change, atol=1e-6 * np.abs(change).max())
    assert_allclose(H, H.transpose(0, 2, 1), atol=1e-9)
    assert np.linalg.eigvalsh(term.hessian(x, state, True)).min() > -1e-9


@pytest.mark.parametrize("k", range(4))
def test_forces_of_ply_on_ply_are_equal_and_opposite(k):
    cases, x, plies = terms_on_a_dome()
    term, state = cases[k]
    g = np.zeros(len(x))
    term.add_gradient(g, x, state)
    of_each = [g[ply.dofs].sum(0) for ply in plies]
    assert np.abs(of_each).max() > 1e-2
    assert_allclose(of_each[0], -of_each[1], rtol=0, atol=1e-10 * np.abs(g).sum())


def test_plies_that_turn_together_do_not_slide():
    (above, below), x = on_a_dome()
    friction = PlyFriction(PlyContact(above, below, True), 0.3)
    state = friction.initial(x)
    c, s = np.cos(0.1), np.sin(0.1)
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    turned = (x.reshape(-1, 3) @ R.T).ravel()
    state = friction.refresh(turned, state)
    assert (state.limit > 0).any()
    # what is left is due to the angle between facets: far less than the lever's 0.1 mm
    assert friction.slide(turned, state) < 0.02


def test_pairs_of_a_dome_have_the_smooth_gap():
    """The gap between nodes and the smooth surface is that of the two spheres."""
    (above, below), x = on_a_dome(size=5.0)
    for contact in (PlyContact(above, below, True), PlyContact(below, above, False)):
        pairs = contact.pairs(x)
        inner = np.abs(contact.places).max(1) < 15.0
        p = contact.penetration(x, pairs)[inner]
        assert_allclose(p, 0.02 * T0, atol=2e-3)
        assert pairs.rise[inner].max() > 0.05  # flat triangles alone are off by that


@pytest.mark.parametrize("crest", [1.0, -1.0])
def test_both_plies_see_the_same_gap_on_a_short_wave(crest):
    """Nodes a little beside the crest of a wave of four elements, on kinks of both nets."""
    unknowns, size, k, height = Unknowns(), 5.0, 2 * np.pi / 20.0, 0.5 * crest
    plies = [unknowns.sheet(qf.rectangle(60.0, 30.0, size), FABRIC, 3, 0.0, n) for n in ("a", "b")]
    x = np.zeros(unknowns.size)
    for ply, beside, up in zip(plies, (0.0, 0.15), (0.98 * T0, 0.0), strict=True):
        X, Y = ply.blank.nodes[:, 0] + beside, ply.blank.nodes[:, 1]
        slope = -height * k * np.sin(k * X)
        n = np.column_stack([-slope, np.zeros_like(X), np.ones_like(X)])
        n /= np.linalg.norm(n, axis=1)[:, None]
        x[ply.dofs] = np.column_stack([X, Y, height * np.cos(k * X)]) + up * n
    above, below = plies
    for contact in (PlyContact(above, below, True), PlyContact(below, above, False)):
        X, Y = contact.places.T
        at_crest = (np.abs(np.cos(k * X)) > 0.99) & (np.abs(X) < 25.0) & (np.abs(Y) < 10.0)
        p = contact.penetration(x, contact.pairs(x))[at_crest]
        # 0.015 with the kinks of the triangles at the nodes
        assert_allclose(p, 0.02 * T0, rtol=0, atol=9e-3)


def test_a_node_without_a_ply_under_it_has_no_force():
    unknowns = Unknowns()
    wide = unknowns.sheet(qf.rectangle(80.0, 40.0, 8.0), FABRIC, 3, 0.0, "ply 1")
    small = unknowns.sheet(qf.rectangle(40.0, 40.0, 8.0), FABRIC, 3, 0.0, "ply 2")
    contact = PlyContact(wide, small, True)
    x = np.zeros(unknowns.size)
    for ply, z in ((wide, 0.9 * T0), (small, 0.0)):
        x[ply.dofs] = np.column_stack([ply.blank.nodes, np.full(len(ply.dofs), z)])
    touching = contact.active(x, contact.initial(x))
    assert_array_equal(np.sort(touching), np.flatnonzero(np.abs(wide.blank.nodes[:, 0]) < 20.5))


# Exact cases


def pulled_out(mass, friction, pull, increment=0.25):
    """A ply that is pulled, as a whole, from between two others under a plate with weight."""
    unknowns, load = Unknowns(), 1e3 * GRAVITY * mass
    sizes = (140.0, 60.0, 0.0), (100.0, 50.0, 45.0), (140.0, 60.0, 0.0)
    plies = [
        unknowns.sheet(qf.rectangle(a, b, 10.0, turn), FABRIC, 3, 0.0, f"ply {k}")
        for k, (a, b, turn) in enumerate(sizes, 1)
    ]
    plates = [
        (plies[2], qf.Tool("table", Plane(), friction=0.0)),
        (plies[0], qf.Tool("plate", flipped(Plane()), 3 * T0, "free", 0.0, mass)),
    ]
    contacts = [Contact(ply, tool, unknowns.add(tool.name, 1).dofs) for ply, tool in plates]
    x0, fixed, drive = unknowns.start(*plies)
    for k, ply in enumerate(plies):
        x0[ply.dofs[:, 2]] = (2.5 - k) * T0
        fixed[ply.dofs[:, :2]] = True
    x0[contacts[1].tool_dofs], fixed[contacts[0].tool_dofs] = 3 * T0, True
    drive[plies[1].dofs[:, 0]] = 1.0
    between = [PlyContact(plies[i], plies[k], i < k) for i, k in ((0, 1), (1, 0), (1, 2), (2, 1))]
    terms = [kind(ply) for ply in plies for kind in (Membrane, Bending)]
    terms += [*contacts, *between, *(PlyFriction(c, friction) for c in between if friction)]
    terms.append(ToolWeight(load, int(contacts[1].tool_dofs[0])))
    model = {"name": "pull", "unknowns": unknowns, "sheets": plies, "terms": terms, "x0": x0}
    model |= {"fixed": fixed, "drive": drive, "travel": pull, "increment": increment}
    return qf.Model(rows=increment, resting=load, **model)


def test_ply_pulled_from_between_two_others():
    result = qf.solve(pulled_out(5.0, 0.3, 2.0), estimate=False)
    assert result.status == "completed"
    assert result.force == pytest.approx(theory.strip_friction(0.3, 5.0), rel=0.01)
    assert result.energy_balance < 0.01


def test_ply_sticks_below_the_limit():
    """Up to its limit friction is the elastic stick of both faces, and nothing is lost."""
    pull = 1e-3
    result = qf.solve(pulled_out(5.0, 0.3, pull, increment=pull / 4), estimate=False)
    forces = result.history["force_N"]
    assert_allclose(np.diff(forces[1:]), forces[2] - forces[1], rtol=1e-3)
    # two faces, with half the weight of the nodes of each ply: those of the outer plies stand for
    # more than the pulled area
    stiffness = 2 * STICK * FABRIC.compaction * 100.0 * 50.0
    assert np.diff(forces)[-1] * 4 / pull == pytest.approx(stiffness, rel=0.05)
    for term, state in zip(result.model.terms, result.memory, strict=True):
        if isinstance(term, PlyFriction):
            force = np.linalg.norm(term.force(result.states[-1].x, state), axis=1)
            assert 0.0 < force.max()
            assert (force < state.limit)[state.limit > 0].mean() > 0.98  # but for a corner


def hanging_pair(length, load, size=4.0):
    """A cantilever of two plies without friction, whose upper ply alone has weight."""
    single = hanging_strip(size, None, FABRIC, length=length, load=load, width=20.0, family="warp")
    blank, unknowns = single.sheet.blank, Unknowns()
    plies = [unknowns.sheet(blank, FABRIC, 3, 0.0, f"ply {k}") for k in (1, 2)]
    factor = unknowns.add("load factor of the weight", 1)
    clamped = np.abs(blank.nodes[:, 0]) < 1e-9 * length
    x0, fixed, drive = unknowns.start(*plies)
    terms = []
    for ply, z in zip(plies, (T0, 0.0), strict=True):
        x0[ply.dofs[:, 2]] = z
        fixed[ply.dofs[clamped]] = True
        terms += [Membrane(ply), Bending(ply, clamped)]
    fixed[factor.dofs], drive[factor.dofs] = True, 1.0
    terms += [PlyContact(plies[0], plies[1], True), PlyContact(plies[1], plies[0], False)]
    terms.append(SheetWeight(plies[0], load, int(factor.dofs[0, 0])))
    given = {name: getattr(single, name) for name in ("travel", "increment", "rows", "dead_load")}
    given |= {"unknowns": unknowns, "sheets": plies, "terms": terms, "x0": x0, "fixed": fixed}
    return qf.Model(name="pair", drive=drive, travel_name="load_factor", **given)


def test_two_plies_that_slip_freely_bend_with_two_stiffnesses():
    length, k = 120.0, 4.0
    load = k * 2 * FABRIC.bending_warp / length**3
    result = qf.solve(hanging_pair(length, load), estimate=False)
    assert result.status == "completed"
    drop = theory.heavy_elastica(k)[1] * length
    for ply, z in zip(result.model.sheets, (T0, 0.0), strict=True):
        end = ply.positions(result.states[-1].x)[ply.blank.nodes[:, 0] > length - 1e-6]
        assert z - end[:, 2].mean() == pytest.approx(drop, rel=0.01)


def test_two_joined_plies_bend_with_the_stretch_of_their_fibres():
    two, C = joined(FABRIC, 2), 4000.0
    B = 2 * FABRIC.bending_warp + C * T0**3 / 2
    assert two.bending_warp == pytest.approx(B, rel=1e-12)
    assert (two.thickness, two.areal_weight) == (2 * T0, 2 * FABRIC.areal_weight)
    length, k = 300.0, 4.0
    strip = {"length": length, "load": k * B / length**3, "width": 40.0, "family": "warp"}
    result = qf.solve(hanging_strip(10.0, None, two, **strip), estimate=False)
    end = result.positions()[result.blank.nodes[:, 0] > length - 1e-6]
    assert -end[:, 2].mean() == pytest.approx(theory.heavy_elastica(k)[1] * length, rel=0.01)


# Stitches


def sewn(slack=0.1):
    """Two flat plies on each other, sewn at three points; the stitches and where all nodes are."""
    unknowns = Unknowns()
    plies = [
        unknowns.sheet(qf.rectangle(60.0, 50.0, 10.0, angle), FABRIC, 3, 0.0, name)
        for name, angle in (("ply 1", 0.0), ("ply 2", 30.0))
    ]
    x = np.zeros(unknowns.size)
    for ply, z in zip(plies, (T0, 0.0), strict=True):
        x[ply.dofs] = np.column_stack([ply.blank.nodes, np.full(len(ply.blank.nodes), z)])
    points = np.array([[0.0, 0.0], [11.0, -7.0], [-20.0, 13.0]])
    threads = Stitches(*plies, points, np.array([2.0, 5.0, 10.0]), np.full(3, T0 + slack))
    return threads, plies, x


@pytest.mark.parametrize("away", [(0.3, 0.4, 0.0), (0.0, 0.0, 0.5)])
def test_a_stitch_pulls_from_its_length_on(away):
    threads, (above, _), x = sewn()
    assert threads.energy(x).sum() == 0.0
    x[above.dofs] += away
    longer = np.linalg.norm(np.add(away, (0.0, 0.0, T0))) - T0 - 0.1
    assert_allclose(threads.energy(x), 0.5 * np.array([2.0, 5.0, 10.0]) * longer**2, rtol=1e-9)
    assert threads.largest_force(x) == pytest.approx(10.0 * longer, rel=1e-9)
    g = np.zeros(len(x))
    threads.add_gradient(g, x, None)
    assert np.linalg.norm(g[above.dofs].sum(0)) == pytest.approx(17.0 * longer, rel=1e-9)


def test_stitches_have_exact_derivatives_and_no_force_on_the_whole():
    threads, _, x = sewn()
    rng, h = np.random.default_rng(0), 1e-6
    x = x + rng.normal(scale=0.3, size=len(x))
    assert 0 < (threads.energy(x) > 0).sum()
    d = rng.normal(size=len(x))
    ends = [x + h * d, x - h * d]
    slope = np.subtract(*(threads.energy(end) for end in ends)) / (2 * h)
    local = d[threads.dofs]
    assert_allclose((threads.gradient(x) * local).sum(1), slope, rtol=1e-6, atol=1e-9)
    change = np.subtract(*(threads.gradient(end) for end in ends)) / (2 * h)
    H = threads.hessian(x, None, False)
    assert_allclose(np.einsum("mij,mj->mi", H, local), change, rtol=1e-5, atol=1e-6)
    assert np.linalg.eigvalsh(H).min() > -1e-9
    forces = threads.gradient(x).reshape(3, 6, 3)
    assert_allclose(forces.sum(1), 0.0, atol=1e-12)


def test_plies_that_turn_together_do_not_pull_their_stitches():
    threads, plies, x = sewn()
    turn = qf.scenes.forming.rotation(40.0)
    for ply in plies:
        x[ply.dofs[:, ::2]] = x[ply.dofs[:, ::2]] @ turn  # about y
    assert threads.energy(x).sum() == 0.0


def test_a_ply_that_is_pulled_out_stretches_its_stitch():
    """Without friction: the force of the thread, which leans over by 2 mm in a thickness."""
    model = pulled_out(5.0, 0.0, 2.0)
    above, pulled, _ = model.sheets
    place, stiffness, length = np.array([[5.0, 0.0]]), np.array([4.0]), np.array([T0])
    model.terms.append(Stitches(above, pulled, place, stiffness, length))
    result = qf.solve(model, estimate=False)
    gap = np.ptp([s.positions(result.states[-1].x)[:, 2].mean() for s in (above, pulled)])
    expected = 4.0 * (np.hypot(2.0, gap) - T0) * 2.0 / np.hypot(2.0, gap)
    assert result.status == "completed"
    # at the stitch the plies bend a little
    assert result.force == pytest.approx(expected, rel=5e-3)


# Scenes


def stitched(points=((0.0, 0.0),), joined=False, **keys):
    seam = {"points": [list(point) for point in points], **keys}
    return {"orientation": 0.0, "joined": joined, "stitches": [seam]}


def test_stitches_of_a_scene():
    line = stitched(points=[[-50.0, 0.0], [50.0, 0.0]], spacing=20.0, stiffness=3.0, slack=0.2)
    line["stitches"].append({"points": [[0.0, 30.0]]})
    model = stacked([0, line])
    assert model.share == 1.0  # no mirror planes
    (threads,) = (term for term in model.terms if isinstance(term, Stitches))
    assert_allclose(threads.stiffness, [3.0] * 6 + [10.0])
    assert_allclose(threads.length, [T0 + 0.2] * 6 + [T0])
    assert "plies 2.stitches 2.stiffness" in assumed(model)
    assert "plies 2.stitches 1.stiffness" not in assumed(model)
    assert "7 threads" in dict(model.description)["stitches between ply 1 and ply 2"]
    again = Recipe.read(model.recipe.written()).build()
    (same,) = (term for term in again.terms if isinstance(term, Stitches))
    assert_array_equal(same.dofs, threads.dofs)
    assert_array_equal(same.length, threads.length)


def stacked(plies, size=30.0, travel=2.0, **given):
    return qf.forming("hemisphere", size=size, travel=travel, plies=plies, **given)


def test_identical_joined_plies_are_one_sheet_of_twice_the_membrane():
    pair = stacked([0, {"joined": True}], 25.0, 10.0)
    assert len(pair.sheets) == 1
    assert {c.compaction for c in pair.contacts} == {2 * FABRIC.compaction}
    assert pair.share == 0.25  # mirror planes as for one sheet
    alone = qf.forming("hemisphere", size=25.0, travel=10.0, law=joined(FABRIC, 2))
    ends = [qf.solve(model, estimate=False) for model in (pair, alone)]
    assert ends[0].force == pytest.approx(ends[1].force, rel=0.005)
    assert "1 and 2 are one sheet" in dict(pair.description)["plies from the punch down"]


def test_one_ply_is_the_scene_without_plies():
    models = [stacked([0], travel=5.0), qf.forming("hemisphere", size=30.0, travel=5.0)]
    ends = [qf.solve(model, estimate=False) for model in models]
    assert_array_equal(ends[0].states[-1].x, ends[1].states[-1].x)


def test_only_planes_of_the_whole_stack_are_kept():
    assert stacked([0, 90]).share == 0.25
    assert stacked([0, 45]).share == 1.0
    assert stacked([45, -45]).share == 0.25


def test_plies_lie_on_each_other_at_the_start_and_meet_the_tools_that_they_can():
    model = stacked([0, 90, 0])
    heights = [ply.positions(model.x0)[:, 2].mean() for ply in model.sheets]
    assert_allclose(-np.diff(heights), T0, rtol=0.01)
    pairs = {(c.sheet.name, c.tool.name) for c in model.contacts}
    assert pairs == {("ply 1", "punch"), ("ply 1", "blank holder"), ("ply 3", "die")}
    assert [(a.sheet.name, b.sheet.name) for a, b in model.ply_pairs] == [
        ("ply 1", "ply 2"),
        ("ply 2", "ply 3"),
    ]
    assert any("left out: ply 1 with ply 3" in entry for entry, _ in model.description)


def test_rims_of_plies_at_an_angle_come_free_and_meet_all_tools_and_plies():
    model = stacked([0, 45, 90])
    pairs = {(c.sheet.name, c.tool.name) for c in model.contacts}
    assert len(pairs) == 9
    names = [(a.sheet.name, b.sheet.name) for a, b in model.ply_pairs]
    assert names == [("ply 1", "ply 2"), ("ply 1", "ply 3"), ("ply 2", "ply 3")]


def test_plies_are_soft_at_first_and_then_as_stiff_as_on_a_tool():
    (above, below), _ = on_a_dome(size=25.0)
    contact = PlyContact(above, below, True)
    k, e, soft = above.fabric.compaction, 0.05 / 1.004 * T0, 0.03
    assert contact.loft == pytest.approx(0.2 * T0)
    p = np.array([-0.1, 0.1 * T0, 0.2 * T0, 0.3 * T0])
    exact = [0.0, soft * k * (p[1] - e / 2), soft * k * (p[2] - e / 2)]
    exact += [soft * k * (p[3] - e / 2) + k * (0.1 * T0 - e / 2)]
    assert_allclose(contact.pressure(p), exact, rtol=1e-9)


def test_the_stiffness_bound_is_that_of_pressed_plies():
    """By D - K, which is not negative for the diagonal D; K reaches it if all moves along n."""
    (above, below), x = on_a_dome()
    contact, x = PlyContact(above, below, True), x.copy()
    x[above.dofs[:, 2]] -= 0.5 * T0
    K = contact.hessian(x, contact.initial(x), True)
    D = contact.stiffness_bound(x)
    least = np.linalg.eigvalsh(D[:, :, None] * np.eye(12) - K)[:, 0] / D.max(1)
    assert least.min() == pytest.approx(0.0, abs=1e-9)


def test_round_off_in_an_orientation_is_no_angle():
    for angle, at_an_angle in ((-1e-12, False), (90.0 - 1e-9, False), (89.0, True)):
        words = dict(stacked([0, angle], size=31.0).description)
        assert ("plies at an angle to each other" in words) == at_an_angle


def test_the_certificate_judges_the_depth_beyond_the_soft_one():
    (above, below), x = on_a_dome(size=4.0)
    contacts = PlyContact(above, below, True), PlyContact(below, above, False)
    model = SimpleNamespace(ply_pairs=[contacts])
    x = x.copy()
    for extra, depth in ((0.0, 0.0), (0.21 * T0, 0.03 * T0)):  # on a dome they overlap by 0.02 t
        x[above.dofs[:, 2]] -= extra
        found = max_ply_penetration(model, x)
        assert found == pytest.approx(depth, abs=4e-3)


def test_a_tool_is_as_many_times_stiffer_as_plies_press_on_it():
    one, two = stacked([0]), stacked([0, 90])
    assert {c.compaction for c in one.contacts} == {one.sheets[0].fabric.compaction}
    assert {c.compaction for c in two.contacts} == {2 * one.sheets[0].fabric.compaction}


def test_a_ply_that_is_not_covered_meets_the_punch_too():
    small = {"blank": {"shape": "disc", "radius": 120.0}}
    model = stacked([small, 45], size=25.0)
    assert {c.sheet.name for c in model.contacts if c.tool.name == "punch"} == {"ply 1", "ply 2"}


def test_a_pass_of_a_stack_is_at_most_five_steps_of_newtons_method(monkeypatch):
    """Farther on its pairs are those of another place."""
    passes, restart, step = [], Tangent.restart, Tangent.step

    def begun(tangent):
        passes.append(0)
        restart(tangent)

    def stepped(tangent, *given):
        passes[-1] += 1
        return step(tangent, *given)

    monkeypatch.setattr(Tangent, "restart", begun)
    monkeypatch.setattr(Tangent, "step", stepped)
    assert qf.solve(stacked([0, 45], size=31.0, travel=5.0), estimate=False).status == "completed"
    assert max(passes) == 5


def test_a_coefficient_between_plies_that_is_not_given_is_assumed():
    model = stacked([0, 45])
    assert "plies 2.friction" in assumed(model)
    again = Recipe.read(model.recipe.written()).build()
    assert assumed(again) == assumed(model)
    given = {"orientation": 45.0, "friction": {"value": 0.2, "standing": "measured"}}
    model = stacked([0, given])
    assert model.parameters["standings"]["plies 2.friction"] == "measured"
    assert {term.friction for term in model.terms if isinstance(term, PlyFriction)} == {0.2}


@pytest.mark.parametrize(
    ("plies", "words"),
    [
        ([0, {"offset": [400.0, 0.0]}], "plies 2.* does not overlap the ply above it"),
        ([0, {"orientation": 45, "joined": True}], "another orientation"),
        ([{"joined": True}, 0], "there is no ply above it"),
        ([0, {"angle": 3}], "angle"),
        ([0, {"law": "nothing"}], r"\[plies 2\] unknown law"),
        ([0, {"fabric": {"thickness": -1.0}}], r"\[plies 2.fabric\] .*thickness"),
        ([0] * 13, "at most 12 plies"),
        ([stitched(), 0], r"\[plies 1\] stitches: there is no ply above it"),
        ([0, stitched(points=[[200.0, 0.0]])], r"\[plies 2\] a stitch lies outside the ply"),
        ([0, stitched(points=[])], "stitches 1.* has no points"),
        ([0, stitched(spacing=5.0)], "a line of two points"),
        ([0, stitched(points=[[0.0, 0.0], [9.0, 0.0]], spacing=1e-4)], "1 to 10,000 stitches"),
        ([0, stitched(stiffness=0.0)], "stiffness must be a positive number"),
        ([0, stitched(joined=True)], "no stitches of their own"),
    ],
)
def test_stacks_that_cannot_be_formed(plies, words):
    with pytest.raises(qf.InputError, match=words):
        stacked(plies)


def test_what_is_not_possible_with_plies():
    slipping = replace(FABRIC, slip=qf.Slip(0.05, 0.1, 5.0))
    with pytest.raises(qf.InputError, match="slip of the rovings"):
        stacked([0, 45], law=slipping)
    with pytest.raises(qf.InputError, match="mesh = 'fibre'"):
        stacked([0, 45], overrides={"mesh": "free"})


def test_plies_of_like_directions_need_twice_the_force_of_one():
    """Without friction, of which the holder's weight makes one part only: the same net twice."""
    smooth = {f"tools.{tool}.friction": 0.0 for tool in ("punch", "die", "holder")}
    plies = [0, {"orientation": 90, "friction": 0.0}]
    stack = qf.solve(stacked(plies, 20.0, 20.0, overrides=smooth), estimate=False)
    one = qf.forming("hemisphere", size=20.0, travel=20.0, overrides=smooth)
    alone = qf.solve(one, estimate=False)
    assert stack.certified.converged
    assert stack.force == pytest.approx(2.0 * alone.force, rel=0.01)
    assert stack.draw_in == pytest.approx(alone.draw_in, abs=0.05)
    assert_allclose(*(ply.shear_angle.max() for ply in stack.plies), rtol=0.05)


# Results


@pytest.fixture(scope="module")
def formed():
    plies = [0, {"orientation": 45.0, "friction": 0.2}]
    return qf.solve(stacked(plies, 25.0, 5.0), estimate=False, increment=1.25)


def test_a_stack_is_solved(formed):
    assert formed.status == "completed"
    figures = formed.certified.figures
    assert figures["residual_relative"] < 1e-3
    assert figures["ply_penetration_mm"] < 0.03
    assert 0.01 < figures["slip_between_plies_1_2_mm"] < 1.0
    assert formed.linear_solves < 200  # 155; 251 with a fixed share of the normal forces


def test_folder_of_a_stack(formed, tmp_path):
    formed.save(tmp_path / "out", pictures=False)
    record = Record.read(tmp_path / "out")
    assert len(record.summary["plies"]) == 2
    whole = formed.stack_at()
    for k, own in enumerate(formed.sheets.values(), 1):
        read = Record.read(tmp_path / "out", ply=k).sheet
        assert_allclose(read.points, own.points, atol=1e-9)
        assert_array_equal(read.triangles, own.triangles)
        assert (tmp_path / "out" / f"ply_{k}.vtu").is_file()
        assert (whole.cell_fields["ply"] == k).sum() == len(own.triangles)
    assert {"ply_2_draw_in_mm", "slip_1_2_mm"} <= set(record.history)
    of_second = Record.read(tmp_path / "out", ply=2)
    assert of_second.summary["shear_angle_deg"] == record.summary["plies"][1]["shear_angle_deg"]
    assert (record.ply_name, of_second.ply_name) == ("ply 1 of 2 at 0°", "ply 2 of 2 at 45°")
    assert of_second.fabric["thickness"] == T0
    for k, fibres in enumerate(qf.export(formed, "csv", tmp_path / "csv").plies, 1):
        again = qf.export(tmp_path / "out", "csv", tmp_path / f"csv{k}").plies[k - 1]
        assert_allclose(again.warp, fibres.warp, atol=1e-9)
        assert (again.ply, again.fabric["thickness"]) == (k, fibres.fabric["thickness"])
    everything = Record.read(tmp_path / "out", ply=0).sheet
    assert_allclose(everything.points, whole.points, atol=1e-9)
    assert_allclose(everything.flat, whole.flat, atol=1e-9)
    with pytest.raises(qf.InputError, match="no ply 3 of 2"):
        Record.read(tmp_path / "out", ply=3)
    again = qf.forming(str(tmp_path / "out" / "scene.toml"))
    assert again.parameters["plies"] == formed.model.parameters["plies"]


def test_any_ply_is_compared(formed, tmp_path):
    """With itself as the stack has it and as its own file has it, and with a sheet of the other."""
    formed.save(tmp_path / "out", pictures=False)
    second = formed.summary()["plies"][1]["shear_angle_deg"]["mean"]
    for reference, ply in ((tmp_path / "out", "reference: ply 2 of 2 at 45°, "), ("ply_2.vtu", "")):
        found = qf.compare(formed, tmp_path / "out" / reference, ply=2)
        assert found["mean of |γ|"].result == pytest.approx(second, rel=0.02)
        assert np.nanmax(np.abs(found.difference)) < 1e-6
        assert any(note.startswith("result: ply 2 of 2 at 45°, ") for note in found.notes)
        assert any(note.startswith(ply) for note in found.notes)
    first = qf.compare(formed, tmp_path / "out")
    assert any(note.startswith("result: ply 1 of 2 at 0°, ") for note in first.notes)
    with pytest.raises(qf.InputError, match="no ply 3 of 2"):
        qf.compare(formed, formed, ply=3)
    with pytest.raises(qf.InputError, match="no ply 2: it is not a stack"):
        qf.compare(tmp_path / "out" / "ply_1.vtu", formed, ply=2)


def test_slip_and_thickness_between_plies_are_fields(formed):
    """On a dome that is pressed: two plies thick where they touch, one where they are parted."""
    stack = formed.stack_at().point_fields
    slid = np.concatenate(
        [c.slid(formed.model.x0, formed.states[-1].x) for c in formed.model.ply_contacts]
    )
    assert_allclose(stack["slip_1_2"], np.nan_to_num(slid), atol=1e-12)
    (above, below), x = on_a_dome()
    model = replace(formed.model, sheets=[above, below], x0=x)
    model.terms = [PlyContact(above, below, True), PlyContact(below, above, False)]
    fields = between_plies(model, x)
    own = [t0_over_area(ply, x) for ply in (above, below)]
    middle = np.abs(above.blank.nodes).max(1) < 15.0
    assert_allclose(fields[0]["stack_thickness"][middle], sum(map(np.mean, own)), rtol=0.02)
    x[above.dofs[:, 2]] += 0.2 * T0
    parted = between_plies(model, x)[0]["stack_thickness"]
    assert_allclose(parted, own[0], rtol=1e-9)


def t0_over_area(ply, x):
    sheet = FormedSheet(ply.positions(x), ply.blank.triangles, ply.blank.nodes)
    return sheet.at_nodes(T0 / sheet.area_ratio)


def test_the_view_of_a_stack_has_all_plies_and_a_choice(formed, tmp_path):
    pytest.importorskip("plotly")
    whole = formed.record.of_ply(0)
    assert len(view.figure(whole).data[0].i) == len(formed.stack_at().triangles)
    page = view.save(whole, tmp_path / "view.html").read_text(encoding="utf-8")
    assert '<select id="ply"><option value="0">all</option>' in page
    assert page.count("<option>") == 2
    numbers = view._Numbers()
    content = view._content(whole, numbers)
    assert {"slip_1_2", "stack_thickness"} < {name for name, *_ in content["fields"]}
    assert len(content["meshes"][0]["lines"]["outline"]) == 2
    assert 'id="ply"' not in view.save(formed.record, tmp_path / "one.html").read_text("utf-8")


def test_a_stopped_run_of_a_stack_is_continued_as_it_was(formed, tmp_path):
    plies = [0, {"orientation": 45.0, "friction": 0.2}]
    given = {"estimate": False, "increment": 1.25, "out": tmp_path}
    stopped = qf.solve(stacked(plies, 25.0, 5.0), callback=lambda p: p.travel > 2.0, **given)
    assert stopped.status == "stopped"
    end = qf.solve(stacked(plies, 25.0, 5.0), resume=True, **given)
    assert_array_equal(end.states[-1].x, formed.states[-1].x)


def test_a_stack_with_slits_is_stopped_continued_and_shown(tmp_path, capsys):
    words = "form hemisphere --size 30 --travel 4 --no-estimate --seeds 1".split()
    words += ["--set", "plies=[{}, {orientation = 90.0}]"]
    words += ["--set", "blank.slits=[{points = [[60.0, 0.0], [155.0, 0.0]]}]"]
    assert main([*words, "--out", str(tmp_path / "whole")]) == 0
    out = capsys.readouterr().out
    assert "slits: 1 in ply 1, 95 mm long; 1 in ply 2, 95 mm long" in out
    assert "2 ply_*.vtu, 1 shear_angle_ply_*.png" in out
    model = stacked([0, 90], 30.0, 4.0, overrides={"blank.slits": [{"points": SLIT}]})
    assert f"{2 * len(model.sheet.blank.triangles)} triangles" in out
    given = {"estimate": False, "out": tmp_path / "parts"}
    assert qf.solve(model, callback=lambda p: p.travel > 2.0, **given).status == "stopped"
    end = qf.solve(model, resume=True, **given)
    found = qf.compare(tmp_path / "whole", end, ply=2)
    assert np.abs(found.difference).max() < 1e-4
    page = view.save(end.record.of_ply(0), tmp_path / "page.html").read_text(encoding="utf-8")
    assert "slip between plies 1 and 2" in page


@pytest.fixture(scope="module")
def unlike():
    """Two plies, the lower one of another fabric: thinner, tested and locking at small angles."""
    shear = replace(FABRIC.shear, I_lo=0.02)  # sin 1.146°
    other = replace(FABRIC, name="lower", shear=shear, shear_range=0.5, thickness=0.5)
    return qf.solve(stacked([0, {"fabric": other}], 31.0, 20.0), estimate=False)


def test_numbers_of_a_fabric_are_those_of_each_ply(unlike, tmp_path):
    unlike.save(tmp_path / "out", pictures=False)
    first = np.degrees(np.arcsin(FABRIC.shear.I_lo))
    for record in (unlike.record, Record.read(tmp_path / "out")):
        assert [ply.locking for ply in record.plies] == pytest.approx([first, 1.146], abs=1e-3)
        beyond = [ply.summary["doubtful_share"]["beyond_identified_range"] for ply in record.plies]
        assert beyond[0] == 0.0 < beyond[1]
        assert record.plies[1].summary["doubtful_share"] == {
            name: pytest.approx(float(flag @ areas / areas.sum()))
            for sheet in [record.plies[1].sheet]
            for areas in [sheet.flat_areas]
            for name, flag in sheet.doubts().items()
        }
        _, words, _ = plot.limits_of(record.of_ply(0))["beyond_identified_range"]
        assert words == f"beyond 0.5° or {FABRIC.shear_range:g}°: not tested"
        assert plot.limits_of(record)["beyond_identified_range"][1].startswith("beyond 5")
    # an error counts by the thickness of the ply, or of the thinner one of two
    names = ["draw_in_+x_mm", "ply_2_draw_in_+x_mm", "slip_1_2_mm"]
    assert [_not_reported(unlike.model, name) for name in names] == pytest.approx(
        [0.1 * T0, 0.05, 0.05]
    )


def test_what_is_said_of_a_stack_is_of_all_plies(unlike, monkeypatch):
    assert f"fabric: {FABRIC.name}, lower\n" in terminal.describe(unlike.model)
    said = terminal.report(unlike, 1.0)
    assert re.search(r"doubtful +beyond identified range \d+% of the area of ply 2\n", said)
    # the lower ply alone has locked, then it alone has waves
    assert _row(unlike)["locked"]
    for ply in unlike.plies:
        monkeypatch.setattr("quasiform.studies.run.wrinkled", lambda one, ply=ply: one is ply)
        assert _row(unlike)["wrinkled"]
    monkeypatch.setattr("quasiform.studies.run.wrinkled", lambda one: False)
    assert not _row(unlike)["wrinkled"]


def test_no_sensitivities_of_a_stack(formed):
    with pytest.raises(qf.InputError, match="several plies"):
        formed.sensitivity(["fabric.friction"])


def exact_net(radius, a, b):
    """Places on a sphere of the net of `hemisphere_net`, for a column of a and rows of b, mm."""
    places = []
    for length in a:
        start = [0.0, 0.0, np.cos(length / radius)], [np.sin(length / radius), 0.0, 0.0]
        x = radius * np.add(*start)

        def rates(s, state, length=length):
            x, T = np.split(state, 2)
            h = 1e-4
            ends = theory.hemisphere_net(length, np.array([s - h, s + h]), radius)
            bend = -np.diff(ends)[0] / (2 * h)  # geodesic curvature of the line along b
            return np.append(T, -x / radius**2 + bend * np.cross(x / radius, T))

        state = np.append(x, [0.0, 1.0, 0.0])
        path = solve_ivp(rates, (0.0, max(b)), state, rtol=1e-8, atol=1e-8, dense_output=True)
        places.append(path.sol(b)[:3].T)
    return np.array(places)


def test_exact_net_has_the_shear_angle_of_the_theory():
    R, a, b = 75.0, np.linspace(20.0, 40.0, 81), np.linspace(20.0, 40.0, 81)
    x = exact_net(R, a, b)
    u = (x[1:, :-1] - x[:-1, :-1]) / 0.25
    v = (x[:-1, 1:] - x[:-1, :-1]) / 0.25
    assert_allclose(np.linalg.norm(u, axis=2), 1.0, atol=1e-3)
    gamma = np.arcsin((u * v).sum(2))
    middle = theory.hemisphere_net(a[:-1, None] + 0.125, b[None, :-1] + 0.125, R)
    assert_allclose(gamma, middle, atol=2e-3)


def exact_places(blank, points, radius, lines):
    """(n, 3) places of flat points of a blank in the exact net on a sphere; nan beyond `lines`."""
    net = RegularGridInterpolator(
        (lines, lines), exact_net(radius, lines, lines), "cubic", bounds_error=False
    )
    fibres = np.column_stack([blank.warp, blank.weft])
    along = points @ fibres
    x = net(np.abs(along))
    x[:, :2] = (np.where(along < 0, -1.0, 1.0) * x[:, :2]) @ fibres.T
    return x


def test_plies_without_friction_slide_by_the_difference_of_their_exact_nets():
    """Each net is the exact one on the sphere of its own mean surface."""
    law = replace(qf.Fabric.preset("locking"), friction=0.0)
    plies = [0, {"orientation": 45.0, "friction": 0.0}]
    model = qf.forming("hemisphere", law=law, size=10.0, travel=25.0, plies=plies)
    result = qf.solve(model, estimate=False)
    assert result.status == "completed"
    (pair, x), t = (model.ply_pairs[0][0], result.states[-1].x), law.thickness
    radii, lines = (75.0 + 0.5 * t, 75.0 + 1.5 * t), np.linspace(0.0, 60.0, 13)
    upper, lower = (
        exact_places(sheet.blank, pair.places, R, lines) / R
        for R, sheet in zip(radii, model.sheets, strict=True)
    )
    apart = lower - np.vecdot(lower, upper)[:, None] * upper
    expected = radii[1] * np.linalg.norm(apart, axis=1)
    on_punch = next(c for c in model.contacts if c.tool.name == "punch").penetration(x) > 0
    assert on_punch.sum() > 20
    assert expected[on_punch].max() > 0.35
    assert_allclose(pair.slid(model.x0, x)[on_punch], expected[on_punch], rtol=0, atol=0.1)


@pytest.mark.parametrize("turn", [0.0, 30.0, 45.0])
def test_a_ply_without_friction_is_kept_from_turning_by_a_node_near_the_x_axis(turn):
    law = replace(qf.Fabric.preset("locking"), friction=0.0)
    plies = [0, {"orientation": turn, "friction": 0.0}, {"orientation": 20.0, "friction": 0.0}]
    model = qf.forming("hemisphere", law=law, size=10.0, plies=plies)
    sheet = model.sheets[1]
    kept = model.fixed[sheet.dofs]
    (middle,), (far,) = (np.flatnonzero(kept.sum(1) == n) for n in (2, 1))
    assert_allclose(sheet.blank.nodes[middle], 0.0, atol=1e-9)
    x, y = np.abs(sheet.blank.nodes[far])
    assert kept[far].tolist() == [False, True, False]
    assert x > 30.0
    assert y < 0.05 * x


def test_outlines_that_overlap_in_part_have_contact_where_they_do():
    model = stacked([0, {"orientation": 45.0, "offset": [100.0, 0.0]}], size=25.0)
    ((above, _),) = model.ply_pairs
    paired = above.pairs(model.x0).share
    assert paired[above.places[:, 0] > -45.0].min() > 0.5
    assert not paired[above.places[:, 0] < -65.0].any()
    tools = {c.tool.name for c in model.contacts if c.sheet.name == "ply 2"}
    assert tools == {"punch", "die", "blank holder"}  # it is not covered everywhere
