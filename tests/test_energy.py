"""Every energy term: derivatives, symmetry, convexity, purity, invariance; then its own values.

A term is tested by being listed in `FREE`, `ON_TOOLS` or `HELD`.
"""

import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quasiform.energy.bending import Bending, PatchBending
from quasiform.energy.contact import (
    BLEND,
    SAG,
    Contact,
    at_edges,
    at_nodes,
    moment,
    share,
    surrounds,
)
from quasiform.energy.diaphragm import Diaphragm
from quasiform.energy.friction import STICK, Friction
from quasiform.energy.gripper import Grip
from quasiform.energy.membrane import Membrane, PairedMembrane
from quasiform.energy.pressure import Pressure, PressureAtEdge, free_edges
from quasiform.energy.slip import (
    SlipBending,
    SlippingMembrane,
    SlipResistance,
    SlipWidth,
    Together,
)
from quasiform.energy.softening import Softening
from quasiform.energy.term import Term, compiled
from quasiform.energy.weight import GRAVITY, SheetWeight, ToolForce, ToolWeight
from quasiform.fabric import Fabric, MomentCurve, Slip, ThreeStageLaw
from quasiform.net.blank import rectangle, rotation
from quasiform.potential import Potential
from quasiform.tools.shapes import (
    Placed,
    Plane,
    Rounded,
    Tool,
    ball,
    bar,
    box_punch,
    flipped,
    opening,
    regular_polygon,
    round_opening,
    round_punch,
    tetrahedron_punch,
)
from quasiform.unknowns import Unknowns

MU = 0.157
# fibres so soft that the shear stiffness shows beside theirs, and all four laws different
FABRIC = replace(
    Fabric.preset("best-fit"),
    warp=ThreeStageLaw(C_ini=2.0, S_ini=0.1, C_mid=0.3, dS_mid=0.2, C_lo=5.0, I_lo=0.2),
    weft=ThreeStageLaw(C_ini=0.7, S_ini=0.05, C_mid=0.2, dS_mid=0.1, C_lo=3.0, I_lo=0.3),
    bending_warp=3.4,
    bending_weft=1.9,
    in_plane_bending=0.2,
)
E = BLEND * FABRIC.thickness  # e, mm
ROUND = replace(FABRIC, in_plane_bending=1.0)
SOFTENS = replace(  # within the curvatures of a sheet that is `deformed`
    FABRIC,
    moment_warp=MomentCurve((0.005, 0.02, 0.05), (0.017, 0.04, 0.06)),
    moment_weft=MomentCurve((0.01, 0.03, 0.04), (0.019, 0.03, 0.035)),
)
SLIPPERY = replace(FABRIC, slip=Slip(0.05, 0.1, 5.0))
STIFF = Fabric.preset("locking")
SHAPES = {
    "plane": Plane(),
    "sphere": ball(30.0),
    "cylinder": bar(20.0),
    "punch": round_punch(25.0),
    "opening": round_opening(30.0, 8.0),
    "holder": flipped(round_opening(30.0, 8.0)),
    "box punch": box_punch(50.0, 40.0, 6.0),
    "tetrahedron": tetrahedron_punch(80.0, 60.0, 8.0, 20.0),
    "box opening": opening([[-30, -20], [30, -20], [30, 20], [-30, 20]], 12.0, 6.0),
    "triangle holder": flipped(opening(regular_polygon(3, 80.0, 20.0), 15.0, 7.0)),
    "placed": Placed(
        tetrahedron_punch(80.0, 60.0, 8.0),
        Rotation.from_rotvec([0.4, -0.7, 1.0]).as_matrix(),
        (5.0, -3.0, 2.0),
    ),
}
# turns (degrees) and motions along which a tool does not change; any turn if it is not listed
SYMMETRIES = {
    "cylinder": (0.0, (0.0, 11.0, 4.0)),
    "box punch": (180.0, (0.0, 0.0, 4.0)),
    "tetrahedron": (120.0, (0.0, 0.0, 4.0)),
    "box opening": (180.0, (0.0, 0.0, 4.0)),
    "triangle holder": (120.0, (0.0, 0.0, 4.0)),
    "placed": (0.0, (0.0, 0.0, 4.0)),
}
TILTING = ["sphere", "punch", "holder", "tetrahedron", "triangle holder"]
BETWEEN = ["plane", "cylinder", "opening", "box punch", "placed"]
DOME = Placed(ball(100.0), np.eye(3), (0.0, 0.0, -90.0))
BLANKS = {
    "aligned": rectangle(40.0, 30.0, 8.0),
    "cut": rectangle(40.0, 30.0, 8.0, orientation=30.0),
    "quarter": rectangle(80.0, 60.0, 8.0, mirror=("x", "y")),
}


@dataclass
class Case:
    """A term at x, with its state, where at least the share `active` of its stencils acts.

    `prescribed` counts the last local degrees of freedom, if these are never solved for.
    """

    term: Any
    x: np.ndarray
    active: float = 1.0
    prescribed: int = 0
    state: Any = None

    @property
    def dofs(self):
        return self.term.stencils(self.state)

    def energy(self, x):
        return self.term.energy(x, self.state)

    def gradient(self, x):
        return self.term.gradient(x, self.state)

    def hessian(self, x, convex):
        return self.term.hessian(x, self.state, convex)

    def refreshed(self, x):
        return replace(self, state=self.term.refresh(x, self.state))

    def committed(self, x):
        return replace(self, state=self.term.commit(x, self.state))


def sheet_of(blank, fabric=FABRIC, dim=3):
    """A sheet whose positions are the first unknowns."""
    return Unknowns().sheet(blank, fabric, dim)


def rubbing(contact, start, x=None, active=1.0):
    """Friction anchored at the start of a run, at x."""
    term = Friction(contact)
    return Case(term, start if x is None else x, active, state=term.initial(start))


def flat(blank, dim=3, rigid=0):
    """The state at rest: nodes in the plane z = 0, tool heights zero."""
    return np.append(np.pad(blank.nodes, ((0, 0), (0, dim - 2))).ravel(), np.zeros(rigid))


def deformed(blank, dim=3, seed=0):
    """Fibres stretched and compressed by up to 15 %, sheared by up to 40°, and bent."""
    rng = np.random.default_rng(seed)
    F = np.eye(dim)[:, :2] + [[0.0, 0.3], [0.2, 0.0], [0.0, 0.1]][:dim]
    return (blank.nodes @ F.T + rng.uniform(-0.7, 0.7, (len(blank.nodes), dim))).ravel()


def in_pieces(blank):
    """Triangles that share no nodes, so that the middles of all edges can be chosen."""
    nodes = blank.nodes[blank.triangles].reshape(-1, 2)
    return replace(blank, nodes=nodes, triangles=np.arange(len(nodes)).reshape(-1, 3))


def with_points_at(contact, places, rigid):
    """The state in which the points of the sheet are at `places` (m, 3): weights · x = places."""
    points, n = contact.points, len(contact.sheet.blank.nodes)
    x = np.empty((n, 3))
    for c in range(3):
        W = np.zeros((n, n))
        np.add.at(W, (np.arange(n)[:, None], points.nodes), points.weights[:, :, c])
        x[:, c] = np.linalg.solve(W, places[:, c])
    return np.append(x.ravel(), rigid)


def turn_of(tilts, lever):
    """(3, 3) turn of a tilting tool, Rx(a/L) Ry(b/L)."""
    return Rotation.from_euler("XY", np.divide(tilts, lever)).as_matrix()


@cache
def around(shape, n):
    """Places (n, 3) near a tool, with their distance and normal."""
    points = np.random.default_rng(0).uniform(-50.0, 50.0, (60 * n, 3))
    d, normal, _ = shape.distance(points)
    near = (d > -5.0) & (d < 10.0) & (np.linalg.norm(points[:, :2], axis=1) > 5.0)
    near = np.flatnonzero(near)[:n]
    return points[near], d[near], normal[near]


def touching(contact, rigid=(0.0,), deepest=0.3):
    """Points strewn over the whole surface of a tool, from clear of it to `deepest` inside."""
    n = len(contact.area)
    points, d, normal = around(contact.tool.shape, n)
    p = np.random.default_rng(1).uniform(-0.1, deepest, n)
    places = points + (contact.reach - p - d)[:, None] * normal
    if contact.tool.tilts:
        places = places @ turn_of(rigid[1:], contact.lever).T
    origin = np.array([*contact.tool.place, rigid[0]])
    return with_points_at(contact, origin + places, rigid)


def membrane(blank, dim, fabric=FABRIC):
    blank = BLANKS[blank]
    return Case(Membrane(sheet_of(blank, fabric, dim)), deformed(blank, dim))


def diaphragm(blank="aligned", *given):
    blank = BLANKS[blank]
    return Case(Diaphragm(sheet_of(blank), 1.2, *given), deformed(blank))


def slipping(kind, blank, dim):
    """Slip of about 0.5 mm, so that some nodes slide; permanent slip that is neither zero."""
    blank, unknowns = BLANKS[blank], Unknowns()
    sheet = unknowns.sheet(blank, SLIPPERY, dim)
    slip = unknowns.add("slip", dim, places=blank.nodes, areas=blank.node_areas)
    term, rng = kind(sheet, slip), np.random.default_rng(3)
    x = np.append(deformed(blank, dim), rng.normal(0.0, 0.5, slip.dofs.size))
    state = term.initial(x)
    if state is not None:
        parts = rng.normal(0.0, 0.3, (len(blank.nodes), 2))
        state = term.refresh(x, replace(state, parts=parts))
    return Case(term, x, state=state)


def bending_of_layers(blank, clamp=False, dim=3):
    """With the bending that it adds to, which is what is semi-definite."""
    blank, unknowns = BLANKS[blank], Unknowns()
    sheet = unknowns.sheet(blank, FABRIC, dim)
    slip = unknowns.add("slip", dim, places=blank.nodes, areas=blank.node_areas)
    clamped = np.isclose(blank.nodes[:, 0], blank.nodes[:, 0].min()) if clamp else None
    x = np.append(deformed(blank, dim), np.random.default_rng(3).normal(0.0, 0.5, slip.dofs.size))
    return Bending(sheet, clamped), SlipBending(Bending(sheet, clamped), slip), x


def across_fibres():
    """A mesh at 17 degrees to the fibres: pairs of triangles by cell, but for two left alone."""
    blank = rectangle(42.0, 30.0, 6.0)
    cells = np.arange(len(blank.triangles)).reshape(-1, 2)
    pairs = np.vstack([cells[1:], np.repeat(cells[0], 2).reshape(2, 2)])
    R = rotation(17.0)
    return replace(blank, warp=R[:, 0], weft=R[:, 1], pairs=pairs)


def paired_membrane(dim):
    blank = across_fibres()
    return Case(PairedMembrane(sheet_of(blank, FABRIC, dim)), deformed(blank, dim))


def patch_bending():
    blank = across_fibres()
    return Case(PatchBending(sheet_of(blank)), deformed(blank))


def bending(blank, clamp=False, fabric=FABRIC):
    blank = BLANKS[blank]
    clamped = np.isclose(blank.nodes[:, 0], blank.nodes[:, 0].min()) if clamp else None
    return Case(Bending(sheet_of(blank, fabric), clamped), deformed(blank))


def softening(blank, clamp=False):
    linear = bending(blank, clamp, SOFTENS)
    return replace(linear, term=Softening(linear.term))


def contact(name, sort="at nodes", tilts=False):
    """With a tool that tilts, it has tilted already and stands beside the z axis."""
    blank = BLANKS["aligned"] if sort == "at nodes" else in_pieces(BLANKS["aligned"])
    tool = Tool("tool", SHAPES[name], friction=MU)
    rigid = [0.0]
    dofs = 3 * len(blank.nodes) + np.arange(3 if tilts else 1)
    if tilts:
        tool = replace(tool, motion="free", mass=1.0, place=(4.0, -7.0), tilts=True)
    points = at_nodes(blank) if sort == "at nodes" else at_edges(blank)
    term = Contact(sheet_of(blank), tool, dofs, points)
    if tilts:
        rigid = [3.0, 0.12 * term.lever, -0.09 * term.lever]
    return Case(term, touching(term, rigid), active=0.5)


def turned_less(contact, moves):
    """Moves (n_dofs,) of a state with tilts that are small beside its small blank."""
    if contact.tool.tilts:
        moves[-2:] *= contact.lever / 100.0
    return moves


def friction(name, sort="at nodes", tilts=False):
    """Anchored where the points touch, then moved about the limit of stick."""
    normal = contact(name, sort, tilts)
    moved = normal.x + turned_less(
        normal.term, np.random.default_rng(1).uniform(-6.0, 6.0, len(normal.x))
    )
    return rubbing(normal.term, normal.x, moved, active=0.5)


def gripper():
    blank = BLANKS["aligned"]
    nodes = np.flatnonzero(np.isclose(blank.nodes[:, 0], 20.0))
    shares = blank.node_areas[nodes] / blank.node_areas[nodes].sum()
    start = np.pad(blank.nodes[nodes], ((0, 0), (0, 1)))
    e = np.array([0.6, 0.0, 0.8])
    return Case(Grip(sheet_of(blank), nodes, shares, start, e, 12.0, 3.0), deformed(blank))


def sheet_weight():
    blank = BLANKS["aligned"]
    term = SheetWeight(sheet_of(blank), 0.02, 3 * len(blank.nodes))
    return Case(term, np.append(deformed(blank), 0.7), prescribed=1)


def pressure(blank="cut", edge=False, p=0.3):
    """With a free edge that has moved since its last refresh."""
    blank = BLANKS[blank]
    term = Pressure(sheet_of(blank), 3 * len(blank.nodes), 2.0)
    x = np.append(deformed(blank), p)
    if not edge:
        return Case(term, x, prescribed=1)
    term = PressureAtEdge(term)
    return Case(term, x, prescribed=1, state=term.initial(np.append(deformed(blank, seed=1), p)))


def tool_weight():
    return Case(ToolWeight(2.5, 1), np.array([0.0, 12.0]))


def tool_force():
    return Case(ToolForce(1, 2, 3.0, "force"), np.array([0.0, 12.0, 40.0]), prescribed=1)


FREE = {
    "membrane in the plane": lambda: membrane("aligned", 2),
    "membrane in the plane, cut": lambda: membrane("cut", 2),
    "membrane in the plane, stiff": lambda: membrane("aligned", 2, STIFF),
    "membrane in space": lambda: membrane("aligned", 3),
    "membrane in space, cut": lambda: membrane("cut", 3),
    "paired membrane in the plane": lambda: paired_membrane(2),
    "paired membrane in space": lambda: paired_membrane(3),
    "diaphragm": lambda: diaphragm(),
    "diaphragm, cut, compressible, stretched": lambda: diaphragm("cut", 0.4, 1.3),
    "patch bending": patch_bending,
    "bending": lambda: bending("aligned"),
    "bending, cut": lambda: bending("cut"),
    "softening": lambda: softening("aligned"),
    "softening, cut": lambda: softening("cut"),
    "bending alike in every direction": lambda: bending("aligned", fabric=ROUND),
    "slipping membrane in the plane": lambda: slipping(SlippingMembrane, "cut", 2),
    "slipping membrane in space": lambda: slipping(SlippingMembrane, "aligned", 3),
    "width of slip": lambda: slipping(SlipWidth, "cut", 3),
}
SIMPLE = {
    f"{term.__name__}, {name}": lambda term=term, name=name: term(name)
    for term in (contact, friction)
    for name in SHAPES
}
ON_TOOLS = SIMPLE | {
    f"{term.__name__} {words}, {name}": (
        lambda term=term, name=name, sort=sort, tilts=tilts: term(name, sort, tilts)
    )
    for term in (contact, friction)
    for words, sort, tilts, names in (
        ("between nodes", "between", False, BETWEEN),
        ("with a tilting tool", "at nodes", True, TILTING),
        ("between nodes with a tilting tool", "between", True, ["triangle holder"]),
    )
    for name in names
}
HELD = {
    "bending, clamped": lambda: bending("aligned", clamp=True),
    "bending, mirrored": lambda: bending("quarter"),
    "softening, clamped": lambda: softening("aligned", clamp=True),
    "bending alike in every direction, clamped": lambda: bending("aligned", True, ROUND),
    "slip in the plane": lambda: slipping(SlipResistance, "cut", 2),
    "slip in space": lambda: slipping(SlipResistance, "aligned", 3),
    "layers on each other": lambda: slipping(
        lambda *both: Together(SlippingMembrane(*both)), "cut", 3
    ),
    "slip, mirrored": lambda: slipping(SlipResistance, "quarter", 3),
    "weight of the sheet": sheet_weight,
    "force on a tool": tool_force,
    "weight of a tool": tool_weight,
    "pressure": pressure,
    "pressure at the edge": lambda: pressure(edge=True),
    "gripper": gripper,
}
CASES = {**FREE, **ON_TOOLS, **HELD}


@pytest.fixture(params=CASES)
def case(request):
    return CASES[request.param]()


def arrays(value):
    """Every array in a value."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, tuple):
        return [array for item in value for array in arrays(item)]
    return []


def contents(*things):
    """Every array in terms and states, but for what a term keeps of its last evaluation."""
    kept = [
        value
        for thing in things
        if thing is not None
        for name, value in vars(thing).items()
        if name != "_last"
    ]
    return [array.copy() for value in kept for array in arrays(value)]


def along(f, x, d, h=1e-6):
    """Central difference of f along d."""
    return (f(x + h * d) - f(x - h * d)) / (2 * h)


def directions(x, count=6):
    return np.random.default_rng(2).uniform(-1.0, 1.0, (count, len(x)))


# All terms


def test_shapes_and_symmetry(case):
    x = case.x
    n, local = case.dofs.shape
    assert case.dofs.min() >= 0
    assert case.dofs.max() < len(x)
    assert case.energy(x).shape == (n,)
    assert case.gradient(x).shape == (n, local)
    for convex in (True, False):
        H = case.hessian(x, convex)
        assert H.shape == (n, local, local)
        assert_allclose(H, H.transpose(0, 2, 1), rtol=0, atol=1e-12 * np.abs(H).max())


def test_term_is_active(case):
    g = case.gradient(case.x)
    assert (np.abs(case.energy(case.x)) > 0).mean() >= case.active
    assert (np.abs(g).max(1) > 1e-6 * np.abs(g).max()).mean() >= case.active


def test_gradient_is_the_derivative_of_the_energy(case):
    x = case.x
    g = case.gradient(x)
    for d in directions(x):
        slope = (g * d[case.dofs]).sum(1)
        assert_allclose(along(case.energy, x, d), slope, rtol=0, atol=1e-6 * np.abs(g).max())


def test_hessian_is_the_derivative_of_the_gradient(case):
    x = case.x
    H = case.hessian(x, False)
    for d in directions(x):
        slope = (H @ d[case.dofs][:, :, None])[:, :, 0]
        assert_allclose(
            along(case.gradient, x, d), slope, rtol=0, atol=1e-6 * max(np.abs(H).max(), 1e-3)
        )


def test_convex_hessian_is_positive_semi_definite(case):
    H = case.hessian(case.x, True)
    H = H[:, : H.shape[1] - case.prescribed, : H.shape[1] - case.prescribed]
    assert np.linalg.eigvalsh(H).min() >= -1e-12 * np.abs(H).max()


def test_evaluation_is_pure(case):
    term, x = case.term, case.x
    before, x_before = contents(term, case.state), x.copy()
    first = [case.energy(x), case.gradient(x), case.hessian(x, True), case.hessian(x, False)]
    kept = [value.copy() for value in first]
    other = x + 0.1
    for value in (case.energy(other), case.gradient(other), case.hessian(other, False)):
        value += 1.0  # a view of the memory would show
    again = [case.energy(x), case.gradient(x), case.hessian(x, True), case.hessian(x, False)]
    for a, b, c in zip(first, kept, again, strict=True):
        assert_array_equal(a, b)
        assert_array_equal(a, c)
    assert_array_equal(x, x_before)
    for a, b in zip(before, contents(term, case.state), strict=True):
        assert_array_equal(a, b)


def test_refresh_and_commit_return_new_states_and_change_nothing(case):
    """Neither the term nor the old state nor x; and twice the same gives the same."""
    term, state, x = case.term, case.state, case.x
    before, x_before = contents(term, state), x.copy()
    other = x + 0.1
    for function in (term.refresh, term.commit):
        new = [function(place, state) for place in (x, other, x)]
        if state is None:
            assert new == [None] * 3
            continue
        for a, b in zip(contents(new[0]), contents(new[2]), strict=True):
            assert_array_equal(a, b)
        assert any((a != b).any() for a, b in zip(contents(state), contents(new[1]), strict=True))
        assert all(one is not state for one in new)
    assert_array_equal(x, x_before)
    for a, b in zip(before, contents(term, state), strict=True):
        assert_array_equal(a, b)


def test_a_term_loses_no_energy_where_its_state_stays(case):
    assert case.term.dissipated(case.state, case.state, case.x) == 0.0


@pytest.mark.parametrize("make", FREE.values(), ids=FREE)
def test_rigid_motion_costs_no_energy_and_turns_the_forces(make):
    case = make()
    dim = case.term.sheet.dim
    Q = Rotation.from_rotvec([0, 0, 2.0] if dim == 2 else [0.7, -1.1, 2.0]).as_matrix()[:dim, :dim]
    moved = (case.x.reshape(-1, dim) @ Q.T + [30.0, -20.0, 10.0][:dim]).ravel()
    E, g = case.energy(case.x), case.gradient(case.x)
    assert_allclose(case.energy(moved), E, rtol=0, atol=1e-10 * E.max())
    turned = (g.reshape(len(g), -1, dim) @ Q.T).reshape(g.shape)
    assert_allclose(case.gradient(moved), turned, rtol=0, atol=1e-10 * np.abs(g).max())
    assert_allclose(g.reshape(len(g), -1, dim).sum(1), 0, atol=1e-10 * np.abs(g).max())


def sheet_moved(x, Q, shift):
    """The nodes turned by Q and moved by `shift`, the tool moved along z with them."""
    return np.append((x[:-1].reshape(-1, 3) @ Q.T + shift).ravel(), x[-1] + shift[2])


@pytest.mark.parametrize("name", SIMPLE)
def test_sheet_moving_with_the_tool_or_along_its_symmetry_costs_no_energy(name):
    """The anchors of friction are moved along: it is built anew from the moved start."""
    case = SIMPLE[name]()
    there = case
    angle, shift = SYMMETRIES.get(name.split(", ")[1], (75.0, (0.0, 0.0, 4.0)))
    Q = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    if isinstance(case.term, Friction):
        start = touching(case.term.contact)
        there = rubbing(case.term.contact, sheet_moved(start, Q, shift))
    E, g = case.energy(case.x), case.gradient(case.x)
    moved = sheet_moved(case.x, Q, shift)
    assert_allclose(there.energy(moved), E, rtol=0, atol=1e-10 * E.max())
    nodal = (g[:, :-1].reshape(len(g), -1, 3) @ Q.T).reshape(len(g), -1)
    turned = np.column_stack([nodal, g[:, -1]])
    assert_allclose(there.gradient(moved), turned, rtol=0, atol=1e-10 * np.abs(g).max())
    with_tool = sheet_moved(case.x, np.eye(3), np.array([0.0, 0.0, -3.0]))
    assert_allclose(case.energy(with_tool), E, rtol=0, atol=1e-10 * E.max())


@pytest.mark.parametrize("name", [name for name in ON_TOOLS if "tilting" in name])
def test_sheet_tilting_with_the_tool_costs_no_energy_and_turns_the_forces(name):
    """Also with friction: its anchors ride with the tool."""
    case = ON_TOOLS[name]()
    term, x = case.term, case.x
    contact = getattr(term, "contact", term)
    tool, lever = contact.tool, contact.lever
    new = np.array([-2.0, -0.15 * lever, 0.25 * lever])  # height and tilts
    Q = turn_of(new[1:], lever) @ turn_of(x[-2:], lever).T
    before, after = np.array([*tool.place, x[-3]]), np.array([*tool.place, new[0]])
    moved = np.append(((x[:-3].reshape(-1, 3) - before) @ Q.T + after).ravel(), new)
    E, g = case.energy(x), case.gradient(x)
    assert_allclose(case.energy(moved), E, rtol=0, atol=1e-10 * E.max())
    turned = (g[:, :-3].reshape(len(g), -1, 3) @ Q.T).reshape(len(g), -1)
    scale = np.abs(g).max()
    assert_allclose(case.gradient(moved)[:, :-3], turned, rtol=0, atol=1e-10 * scale)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("blank", BLANKS.values(), ids=BLANKS)
def test_flat_sheet_is_at_rest(blank, dim):
    x = flat(blank, dim)
    clamped = blank.nodes[:, 0] == blank.nodes[:, 0].min()
    terms = [Membrane(sheet_of(blank, STIFF, dim))]
    if dim == 3:
        terms += [Bending(sheet_of(blank, STIFF)), Bending(sheet_of(blank, STIFF), clamped)]
    for term in terms:
        assert term.energy(x).max() < 1e-20
        assert np.abs(term.gradient(x)).max() < 1e-8


@pytest.mark.parametrize(
    "build",
    [
        lambda blank: Membrane(sheet_of(blank)),
        lambda blank: Bending(sheet_of(blank)),
        lambda blank: Contact(sheet_of(blank), Tool("plate", Plane()), 3 * len(blank.nodes)),
        lambda blank: Contact(
            sheet_of(blank), Tool("plate", Plane()), 3 * len(blank.nodes), at_edges(blank)
        ),
        lambda blank: Contact(sheet_of(blank), Tool("dome", DOME), 3 * len(blank.nodes)),
        lambda blank: Contact(
            sheet_of(blank), Tool("dome", DOME), 3 * len(blank.nodes), at_edges(blank)
        ),
    ],
    ids=[
        *("membrane", "bending", "contact", "contact between nodes"),
        *("contact with a dome", "contact with a dome between nodes"),
    ],
)
def test_quarter_holds_a_quarter_of_the_energy(build):
    """Of a sheet deformed with the mirror planes of its blank."""
    part = BLANKS["quarter"]
    whole, source, sign, _, _ = part.unfolded()
    x = deformed(part).reshape(-1, 3)
    x[:, :2][np.isclose(part.nodes, 0.0)] = 0.0
    height = 1.5
    quarter = build(part).energy(np.append(x, height)).sum()
    assert quarter > 0
    assert_allclose(build(whole).energy(np.append(x[source] * sign, height)).sum(), 4 * quarter)


@pytest.mark.parametrize("points", [at_nodes, at_edges])
def test_half_holds_half_of_the_force_and_moment_of_a_tool_that_tilts_in_its_plane(points):
    part = rectangle(80.0, 60.0, 8.0, mirror=("y",))
    whole, source, sign, _, _ = part.unfolded()
    x = deformed(part).reshape(-1, 3)
    x[np.isclose(part.nodes[:, 1], 0.0), 1] = 0.0
    plate = Tool("plate", Plane(), motion="free", mass=1.0, place=(5.0, 0.0), tilts=True)
    rigid = [1.5, 0.0, 2.0]
    half, both = (
        Contact(sheet_of(blank), plate, 3 * len(blank.nodes) + np.arange(3), points(blank))
        .gradient(np.append(positions, rigid))[:, -3:]
        .sum(0)
        for blank, positions in ((part, x), (whole, x[source] * sign))
    )
    assert_allclose(both[[0, 2]], 2 * half[[0, 2]])
    assert np.abs(half[[0, 2]]).min() > 1.0
    assert abs(both[1]) < 1e-9 * np.abs(both).max()


# The sum


@pytest.mark.parametrize("fabric", [FABRIC, ROUND], ids=["bending", "quadratic bending"])
def test_potential_sums_its_terms_over_shared_degrees_of_freedom(fabric):
    blank = BLANKS["aligned"]
    height = 3 * len(blank.nodes)
    unused = height + 1  # keeps its place on the diagonal
    tool = Tool("punch", SHAPES["punch"], motion="driven")
    terms = [
        Membrane(sheet_of(blank)),
        Bending(sheet_of(blank, fabric)),
        Contact(sheet_of(blank), tool, height),
    ]
    x = np.append(deformed(blank), [0.5, 0.0])
    free = np.ones(len(x), dtype=bool)
    free[[0, 1, 5, height]] = False
    memory = tuple(term.initial(x) for term in terms)
    potential = Potential(terms, free, memory)
    assert_allclose(potential.energy(x, memory), sum(term.energy(x).sum() for term in terms))
    d, motion = directions(x, 2)
    g = potential.gradient(x, memory)
    slope = along(lambda x: potential.energy(x, memory), x, d)
    assert_allclose(slope, g @ d, rtol=1e-7)

    def forces(x):
        return potential.gradient(x, memory)

    motion[free] = 0.0
    values, load = potential.hessian(x, memory, False, motion)
    K = potential.pattern.copy()
    K.data = values
    assert (K.tocoo().row <= K.tocoo().col).all()
    assert_array_equal(K.indices[K.indptr[:-1]], np.arange(free.sum()))
    assert free[unused]
    K = K.toarray() + np.triu(K.toarray(), 1).T
    scale = np.abs(K).max()
    slope = along(forces, x, np.where(free, d, 0.0))[free]
    assert_allclose(K @ d[free], slope, rtol=0, atol=1e-6 * scale)
    slope = along(forces, x, motion)[free]
    assert np.abs(slope).max() > 1e-3 * scale
    assert_allclose(load, slope, rtol=0, atol=1e-6 * scale)
    assert not potential.hessian(x, memory, False)[1].any()


def pressed_at_mirror_planes():
    """Nodes on a mirror plane are averaged with the same neighbour on both sides."""
    blank = BLANKS["quarter"]
    term = Contact(sheet_of(blank), Tool("plate", Plane()), 3 * len(blank.nodes))
    return Case(term, flat(blank, rigid=1))


@pytest.mark.parametrize("make", [pressed_at_mirror_planes, lambda: paired_membrane(3)])
def test_a_stencil_that_holds_a_degree_of_freedom_twice_is_summed_in_full(make):
    term, x = make().term, make().x
    potential = Potential([term], np.ones(len(x), dtype=bool), (None,))
    K = potential.pattern.copy()
    K.data = potential.hessian(x, (None,), False)[0]
    full = np.zeros((len(x), len(x)))
    np.add.at(full, (term.dofs[:, :, None], term.dofs[:, None]), term.hessian(x, None, False))
    assert_allclose(K.toarray(), np.triu(full), rtol=0, atol=1e-12 * np.abs(full).max())


class Whole(Term):
    """A term whose Hessian cannot be asked for some stencils only."""

    def __init__(self, term):
        self.name, self.dofs = term.name, term.dofs
        self.energy, self.gradient, self.hessian = term.energy, term.gradient, term.hessian


@pytest.mark.parametrize("convex", [True, False])
@pytest.mark.parametrize("name", ON_TOOLS)
def test_stencils_that_do_not_act_are_left_out_without_loss(name, convex):
    """Assembled from the active stencils and from all of them, with the load of a motion."""
    case = ON_TOOLS[name]()
    term, x = case.term, case.x
    assert term.selective
    assert not Whole(term).selective
    rows = term.active(x, case.state)
    assert 0 < len(rows) < len(term.dofs)
    left_out = np.setdiff1d(np.arange(len(term.dofs)), rows)
    full = case.hessian(x, convex)
    assert not full[left_out].any()
    assert_array_equal(full[rows], term.hessian(x, case.state, convex, rows))
    free = np.ones(len(x), dtype=bool)
    free[[2, 7, 10, 11, len(x) - 1]] = False
    motion = np.where(free, 0.0, directions(x, 1)[0])
    motion[-1] = -0.3
    memory = (case.state,)
    chosen, whole = (Potential([t], free, memory) for t in (term, Whole(term)))
    assert_array_equal(chosen.pattern.indices, whole.pattern.indices)
    for a, b in zip(
        *(sums.hessian(x, memory, convex, motion) for sums in (chosen, whole)), strict=True
    ):
        assert_allclose(a, b, rtol=0, atol=1e-13 * np.abs(b).max())


@pytest.mark.skipif(compiled is None, reason="needs numba")
def test_compiled_loops_agree_with_plain_ones(case, monkeypatch):
    """Energies, forces and stiffnesses, by stencil and summed; friction with its contact."""
    term, terms, memory = case.term, [case.term], (case.state,)
    if isinstance(term, Friction):
        terms, memory = [term.contact, term], (None, case.state)
    sums = Potential(terms, np.ones(len(case.x), dtype=bool), memory)

    def evaluated(x):
        yield term.energy(x, case.state)
        yield term.gradient(x, case.state)
        yield sums.gradient(x, memory)
        if isinstance(term, Friction):
            yield np.array(term.slide(x, case.state))
        for convex in (True, False):
            yield term.hessian(x, case.state, convex)
            yield sums.hessian(x, memory, convex)[0]

    for x in (case.x, case.x + 0.05 * directions(case.x, 1)[0]):
        fast = list(evaluated(x))
        with monkeypatch.context() as patch:
            patch.setattr(Term, "kernels", None)
            patch.setattr(Rounded, "kernels", None)
            for other in (x + 1.0, x + 2.0):  # so that nothing is kept of x
                list(evaluated(other))
            for a, b in zip(fast, evaluated(x), strict=True):
                assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max())


@pytest.mark.skipif(compiled is None, reason="needs numba")
def test_loops_are_compiled_where_no_folder_can_be_written_to():
    code = """
import numpy as np
from numba.core import caching
caching.CacheImpl._locator_classes = []
from quasiform import compiled
assert compiled.same(np.ones(3), np.ones(3))
assert not compiled.same.stats.cache_path
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", [name for name in ON_TOOLS if name.startswith("contact")])
def test_no_point_that_touches_is_overlooked_as_it_moves(name):
    """Steps of all lengths: what acts is what touches where every point is evaluated."""
    case, rng = ON_TOOLS[name](), np.random.default_rng(6)
    term, start, few = case.term, case.x, 0
    for step in 10.0 ** rng.uniform(-4.0, 1.0, 40):
        x = start + rng.uniform(-step, step, len(start))
        few += len(term._within_reach(term._at(x))) < len(term.dofs)
        assert_array_equal(term.active(x), np.flatnonzero(term.penetration(x) > 0.0))
    assert few > 10


# Membrane


def stretched(blank, stretch, dim=3):
    return (stretch * flat(blank, dim).reshape(-1, dim)).ravel()


def test_membrane_energy_of_a_homogeneous_deformation():
    """t0 A [W4 + W6 + W8] with the fibres at 20° to the axes."""
    blank = rectangle(40.0, 30.0, 7.0, orientation=20.0)
    axes = np.column_stack([blank.warp, blank.weft])
    gamma = np.radians(35.0)
    fibres = np.array([[1.02, 0.98 * np.sin(gamma)], [0.0, 0.98 * np.cos(gamma)], [0.0, 0.0]])
    x = (blank.nodes @ (fibres @ axes.T).T).ravel()
    term = Membrane(sheet_of(blank))
    W = (
        FABRIC.warp.energy(1.02**2, 1.0)
        + FABRIC.weft.energy(0.98**2, 1.0)
        + FABRIC.shear.energy(1.02 * 0.98 * np.sin(gamma))
    )
    assert_allclose(term.energy(x).sum(), FABRIC.thickness * 1200.0 * W)
    assert_allclose(np.degrees(term.shear_angle(x)), 35.0)
    S12 = FABRIC.shear.stress(1.02 * 0.98 * np.sin(gamma))
    S11, S22 = 2 * FABRIC.warp.stress(1.02**2, 1.0), 2 * FABRIC.weft.stress(0.98**2, 1.0)
    S = [[S11, S12], [S12, S22]]
    assert_allclose(term.stress(x), np.broadcast_to(S, (len(blank.triangles), 2, 2)))


@pytest.mark.parametrize("poisson", [0.5, 0.3])
def test_diaphragm_is_linear_elastic_in_plane_stress_at_small_strains(poisson):
    blank, h = BLANKS["cut"], 1e-4
    term = Diaphragm(sheet_of(blank), 1.2, poisson)

    def energy(F):
        x = np.pad(blank.nodes @ np.asarray(F).T, ((0, 0), (0, 1))).ravel()
        return term.energy(x).sum() / term.volume.sum()

    C = 1.2 / (1 - poisson**2)
    assert energy(np.diag([1 + h, 1.0])) == pytest.approx(0.5 * C * h**2, rel=1e-3)
    assert energy(np.diag([1 + h, 1 - poisson * h])) == pytest.approx(0.6 * h**2, rel=1e-3)
    shear = 0.5 * 1.2 / (2 * (1 + poisson)) * h**2
    assert energy([[1.0, h], [0.0, 1.0]]) == pytest.approx(shear, rel=1e-3)


def test_diaphragm_is_neo_hookean_at_large_stretches():
    """Nominal stress under equal biaxial stretch, E/3 (λ - λ⁻⁵); and what a prestretch is."""
    blank, stretch, h = BLANKS["cut"], 2.0, 1e-5
    term, sheet = Diaphragm(sheet_of(blank), 1.2), np.pad(blank.nodes, ((0, 0), (0, 1)))
    ends = [term.energy((s * sheet).ravel()).sum() for s in (stretch - h, stretch + h)]
    nominal = np.diff(ends)[0] / (2 * h) / term.volume.sum() / 2
    assert nominal == pytest.approx(0.4 * (stretch - stretch**-5), rel=1e-6)
    larger = replace(blank, nodes=stretch * blank.nodes)
    term = Diaphragm(sheet_of(larger), 1.2, 0.5, stretch)
    start = np.pad(larger.nodes, ((0, 0), (0, 1))).ravel()
    assert term.energy(start).sum() == pytest.approx(np.mean(ends), rel=1e-6)


def test_normals_follow_the_sheet_and_turn_with_a_flip():
    blank = BLANKS["cut"]
    Q = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    x = (flat(blank).reshape(-1, 3) @ Q.T).ravel()
    normals = Membrane(sheet_of(blank)).normals(x)
    assert_allclose(normals, np.broadcast_to(Q[:, 2], normals.shape))
    mirrored = (blank.nodes * [2.0, -1.0]).ravel()
    determinants = np.full((len(normals), 1), -2.0)
    assert_allclose(
        Membrane(sheet_of(blank, FABRIC, 2)).normals(mirrored), determinants, strict=True
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_exact_and_convex_membrane_agree_in_tension(dim):
    blank = BLANKS["cut"]
    term, x = Membrane(sheet_of(blank, FABRIC, dim)), stretched(blank, 1.05, dim)
    assert_allclose(
        term.hessian(x, None, True), term.hessian(x, None, False), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_convex_membrane_projects_the_stress(dim):
    """The two Hessians differ by t0 A g' (S+ - S) g, S+ from an eigenvalue decomposition."""
    blank = BLANKS["aligned"]
    term, x = Membrane(sheet_of(blank, FABRIC, dim)), deformed(blank, dim)
    S = term.stress(x)
    values, vectors = np.linalg.eigh(S)
    assert (values.min(1) < 0).any()
    assert (values.min(1) > 0).any()
    projected = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    weighted = term.volume[:, None, None] * (projected - S)
    scalar = term.g.transpose(0, 2, 1) @ weighted @ term.g
    expected = np.einsum("nij,cd->nicjd", scalar, np.eye(dim)).reshape(len(S), 3 * dim, 3 * dim)
    actual = term.hessian(x, None, True) - term.hessian(x, None, False)
    assert_allclose(
        actual, expected, rtol=0, atol=1e-12 * np.abs(term.hessian(x, None, False)).max()
    )
    assert np.linalg.eigvalsh(term.hessian(stretched(blank, 0.9, dim), None, False)).min() < -0.1


def test_convex_stress_of_equal_pressures_vanishes():
    """S = -p 1 has no direction of its own: the geometric part is gone."""
    blank = BLANKS["aligned"]
    equal = replace(FABRIC, weft=FABRIC.warp)
    term, x = Membrane(sheet_of(blank, equal, 3)), stretched(blank, 0.9)
    H = term.hessian(x, None, True).reshape(-1, 3, 3, 3, 3)
    assert np.isfinite(H).all()
    assert_allclose(H[:, :, 2, :, 2], 0.0, atol=1e-12)


def test_membrane_energy_grows_with_the_thickness_and_bending_does_not():
    blank = BLANKS["aligned"]
    x = deformed(blank)
    thick = replace(FABRIC, thickness=2 * FABRIC.thickness)
    assert_allclose(
        Membrane(sheet_of(blank, thick, 3)).energy(x), 2 * Membrane(sheet_of(blank)).energy(x)
    )
    assert_allclose(Bending(sheet_of(blank, thick)).energy(x), Bending(sheet_of(blank)).energy(x))


# Bending

R = 30.0
LINE = 2.0  # spacing of the fibre lines
LENGTH, WIDTH = 40.0, 24.0
OUT_OF_PLANE = replace(FABRIC, in_plane_bending=0.0)


def rolled(points, radius=R):
    """A flat (n, 2) sheet rolled on a cylinder along y."""
    s, y = points.T
    return np.column_stack([radius * np.sin(s / radius), y, radius * (1 - np.cos(s / radius))])


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_cylinder_stores_half_b_over_r_squared_per_area(turn):
    """Rolled along the warp or the weft; the stencils end half a spacing before the free edges."""
    blank = rectangle(LENGTH, WIDTH, LINE, orientation=turn)
    B = OUT_OF_PLANE.bending_warp if turn == 0 else OUT_OF_PLANE.bending_weft
    E = Bending(sheet_of(blank, OUT_OF_PLANE)).energy(rolled(blank.nodes).ravel()).sum()
    area = (LENGTH - LINE) * WIDTH
    chord = np.sinc(LINE / (2 * R) / np.pi)  # the fibre lines are polygons
    assert_allclose(E, B / (2 * R**2) * area * chord**4, rtol=1e-12)
    assert_allclose(E, B / (2 * R**2) * area, rtol=1e-3)


def test_bending_energy_is_proportional_to_each_stiffness():
    blank = BLANKS["cut"]
    x = deformed(blank)
    warp, weft, both, eightfold = (
        Bending(sheet_of(blank, replace(FABRIC, bending_warp=warp, bending_weft=weft))).energy(x)
        for warp, weft in ((2.0, 0.0), (0.0, 3.0), (2.0, 3.0), (16.0, 24.0))
    )
    assert warp.min() >= 0
    assert weft.min() >= 0
    assert_allclose(both, warp + weft)
    assert_allclose(eightfold, 8 * both)


@pytest.mark.parametrize("mesh", [{}, {"orientation": 30.0}])
def test_bending_curvature_of_a_quadratic_surface_is_exact(mesh):
    """On z = (p s² + q t²)/2 + r s t along warp and weft, also between lines of uneven spacing."""
    blank = rectangle(LENGTH, WIDTH, 3.0, **mesh)
    term = Bending(sheet_of(blank, OUT_OF_PLANE))
    s, t = blank.nodes @ blank.warp, blank.nodes @ blank.weft
    p, q, r = 3e-5, -2e-5, 5e-5
    z = 0.5 * (p * s**2 + q * t**2) + r * s * t
    kappa = term.curvature(np.column_stack([blank.nodes, z]).ravel())
    bent = np.abs(kappa) > 1e-7
    assert bent.any(0).all()
    assert_allclose(kappa[:, 0][bent[:, 0]], p, rtol=1e-5)
    assert_allclose(kappa[:, 1][bent[:, 1]], q, rtol=1e-5)


def test_twist_costs_no_bending():
    blank = rectangle(LENGTH, WIDTH, LINE)
    s, t = blank.nodes.T
    saddle = np.column_stack([s, t, s * t / R]).ravel()
    rolled_up = rolled(blank.nodes).ravel()
    term = Bending(sheet_of(blank))
    assert term.energy(saddle).sum() < 1e-20 * term.energy(rolled_up).sum()


@pytest.mark.parametrize("gamma", [30.0, 50.0])
def test_curvature_follows_the_fibres_of_a_sheared_sheet(gamma):
    """Sheared flat and then rolled: κ is the curvature along each fibre where it lies now."""
    g = np.radians(gamma)
    blank = rectangle(LENGTH, WIDTH, 0.5)
    sheared = blank.nodes @ np.array([[1.0, np.sin(g)], [0.0, np.cos(g)]]).T
    term = Bending(sheet_of(blank, OUT_OF_PLANE))
    kappa = np.abs(term.curvature(rolled(sheared).ravel()))
    inside = np.isin(term.dofs[:, 0] // 3, np.flatnonzero((np.abs(blank.nodes) < 10).all(1)))
    assert_allclose(kappa[inside, 0], 1 / R, rtol=1e-3)
    assert_allclose(kappa[inside, 1], np.sin(g) ** 2 / R, rtol=1e-3)


def test_derivative_of_the_bending_by_its_in_plane_fraction():
    blank = rectangle(60.0, 40.0, 10.0)
    energies = []
    for r in (0.2, 0.5):
        term = Bending(sheet_of(blank, replace(FABRIC, in_plane_bending=r)))
        x = np.random.default_rng(2).normal(size=term.sheet.dofs.size)
        energies.append(term.energy(x).sum())
    assert term.by_in_plane(x) == pytest.approx((energies[1] - energies[0]) / 0.3, rel=1e-9)
    assert term.by_in_plane(x) > 0


def test_in_plane_curvature_is_resisted_by_its_fraction():
    """Fibres on circles in the plane: r B/(2 R²) per area of warp."""
    blank = rectangle(LENGTH, 4.0, LINE)
    s, y = blank.nodes.T
    circle = np.column_stack([(R - y) * np.sin(s / R), R - (R - y) * np.cos(s / R), 0 * s])
    weft_off = replace(FABRIC, bending_weft=0.0)
    E = Bending(sheet_of(blank, weft_off)).energy(circle.ravel()).sum()
    exact = 0.2 * FABRIC.bending_warp / (2 * R**2) * (LENGTH - LINE) * 4.0
    assert_allclose(E, exact, rtol=0.02)
    assert (
        Bending(sheet_of(blank, replace(weft_off, in_plane_bending=0.0)))
        .energy(circle.ravel())
        .max()
        == 0
    )


def test_exact_and_convex_bending_agree_on_a_flat_sheet():
    blank = BLANKS["cut"]
    term, rest = Bending(sheet_of(blank)), flat(blank)
    assert_allclose(
        term.hessian(rest, None, True), term.hessian(rest, None, False), rtol=1e-12, atol=1e-12
    )
    bent = deformed(blank)
    assert np.abs(term.hessian(bent, None, True) - term.hessian(bent, None, False)).max() > 0.01


def parabola(blank, c):
    return np.column_stack([blank.nodes, 0.5 * c * blank.nodes[:, 0] ** 2]).ravel()


def test_clamp_adds_half_a_stencil():
    """Bent to z = c x²/2: k = 2 (x1 - x0 - l t)/l² at the clamp is c too, on half the area."""
    blank = rectangle(LENGTH, WIDTH, LINE, centre=(LENGTH / 2, 0.0))
    clamped = np.isclose(blank.nodes[:, 0], 0.0)
    c = 1e-6
    free = Bending(sheet_of(blank)).energy(parabola(blank, c)).sum()
    held = Bending(sheet_of(blank), clamped)
    per_area = FABRIC.bending_warp * c**2 / 2
    assert_allclose(free, per_area * (LENGTH - LINE) * WIDTH, rtol=1e-6)
    assert_allclose(
        held.energy(parabola(blank, c)).sum(), per_area * (LENGTH - LINE / 2) * WIDTH, rtol=1e-6
    )
    at_clamp = np.isin(held.dofs[:, 0] // 3, np.flatnonzero(clamped))
    assert at_clamp.any()
    assert_allclose(held.curvature(parabola(blank, c))[at_clamp, 0], c, rtol=1e-6)
    # a sheet that leaves the clamp straight, but at a slope, is bent there alone
    tilted = np.column_stack([blank.nodes, c * blank.nodes[:, 0]]).ravel()
    kappa = held.curvature(tilted)[:, 0]
    assert_allclose(kappa[at_clamp], 2 * c / LINE, rtol=1e-6)
    assert_allclose(kappa[~at_clamp], 0.0, atol=1e-6 * c)


def test_mirror_plane_adds_half_a_stencil():
    blank = rectangle(2 * LENGTH, 2 * WIDTH, LINE, mirror=("x", "y"))
    c = 1e-6
    term = Bending(sheet_of(blank))
    per_area = FABRIC.bending_warp * c**2 / 2
    E = term.energy(parabola(blank, c)).sum()
    assert_allclose(E, per_area * (LENGTH - LINE / 2) * WIDTH, rtol=1e-6)
    bent = np.abs(term.curvature(parabola(blank, c))[:, 0]) > 0.5 * c
    centres = blank.nodes[term.dofs[bent, 0] // 3]
    assert np.isclose(centres[:, 0], 0.0).any()
    # a ridge at the plane: both halves rise at the slope c
    ridge = np.column_stack([blank.nodes, c * blank.nodes[:, 0]]).ravel()
    kappa = term.curvature(ridge)[:, 0]
    at_plane = np.isclose(blank.nodes[term.dofs[:, 0] // 3, 0], 0.0)
    assert_allclose(kappa[at_plane], 2 * c / LINE, rtol=1e-6)
    assert_allclose(kappa[~at_plane], 0.0, atol=1e-6 * c)


# Contact


def plate(p, mu=MU, tool_height=0.0):
    """A sheet pressed by p into a plate that faces up, and the state."""
    blank = BLANKS["aligned"]
    x = flat(blank, rigid=1)
    x[2:-1:3] = tool_height + FABRIC.thickness / 2 - p
    x[-1] = tool_height
    term = Contact(sheet_of(blank), Tool("plate", Plane(), friction=mu), len(x) - 1)
    return term, x


def together(term):
    """(n_local, 4): the nodes of a point moved together, and the tool's height.

    Forces times it are those on the point and on the tool, as weights sum to 1.
    """
    k = term.dofs.shape[1] // 3
    return np.block([[np.tile(np.eye(3), (k, 1)), np.zeros((3 * k, 1))], [0.0, 0.0, 0.0, 1.0]])


def on_points(term, x):
    return term.gradient(x) @ together(term)


@pytest.mark.parametrize("tool_height", [0.0, -7.0])
def test_contact_law(tool_height):
    k, e, area = FABRIC.compaction, E, 1200.0
    for p, phi, pressure in (
        (-0.01, 0.0, 0.0),
        (0.5 * e, k * e**2 / 48, k * e / 8),
        (e, k * e**2 / 6, k * e / 2),
        (4 * e, k * (8 - 2 + 1 / 6) * e**2, 3.5 * k * e),
    ):
        term, x = plate(p, tool_height=tool_height)
        assert_allclose(term.penetration(x), p)
        assert_allclose(term.pressure(x), pressure, atol=1e-15)
        assert_allclose(term.energy(x).sum(), area * phi, atol=1e-15)
        push = on_points(term, x).sum(0)
        assert_allclose(push, [0, 0, -area * pressure, area * pressure], atol=1e-12)


def test_contact_law_is_twice_differentiable_at_touch_and_at_the_end_of_the_blend():
    for p in (0.0, E):
        term, below = plate(p - 1e-9)
        _, above = plate(p + 1e-9)
        assert_allclose(term.energy(below), term.energy(above), rtol=1e-6, atol=1e-12)
        assert_allclose(term.gradient(below), term.gradient(above), rtol=1e-6, atol=1e-12)
        scale = FABRIC.compaction * term.area.max()
        assert_allclose(
            term.hessian(below, None, False),
            term.hessian(above, None, False),
            rtol=0,
            atol=1e-6 * scale,
        )


def test_depth_under_a_plate_carries_its_weight():
    term, _ = plate(0.0)
    p = term.depth_under(5.0, 1200.0)
    assert 0 < p < E
    _, x = plate(p)
    assert_allclose(on_points(term, x)[:, 3].sum(), 5.0)


def test_exact_and_convex_contact_differ_by_the_curvature_of_the_tool():
    for name in ("plane", "sphere"):
        case = contact(name)
        exact, convex = (case.term.hessian(case.x, None, flag) for flag in (False, True))
        if name == "plane":
            assert_array_equal(exact, convex)
        else:
            assert np.linalg.eigvalsh(exact).min() < -0.1
            assert np.linalg.eigvalsh(convex - exact).min() > -1e-9
            assert np.abs(convex - exact).max() > 0.1


def test_nodes_are_averaged_along_both_fibre_lines():
    """To x + (x₋ - 2 x + x₊)/24 where both neighbours are; ends of lines stay where they are."""
    blank = rectangle(40.0, 30.0, 5.0)
    points = at_nodes(blank)
    assert_allclose(points.weights.sum(1), 1.0)
    assert_array_equal(points.areas, blank.node_areas)
    assert not points.sag.any()
    s, t = blank.nodes.T
    inside = (np.abs(s) < 19.0, np.abs(t) < 14.0)
    z = 0.3 * s**2 + 0.7 * t**2  # second differences 2 · 0.3 h² and 2 · 0.7 h²
    averaged = (points.weights[:, :, 2] * z[points.nodes]).sum(1)
    h2 = 5.0**2
    assert_allclose(averaged - z, (0.6 * h2 * inside[0] + 1.4 * h2 * inside[1]) / 24, atol=1e-12)
    plane = 2.0 * s - 3.0 * t
    assert_allclose((points.weights[:, :, 2] * plane[points.nodes]).sum(1), plane, atol=1e-12)


def test_a_net_whose_averaged_nodes_lie_on_a_cylinder_has_the_length_of_its_surface():
    """To fourth order; with the nodes themselves on it, it is too short by (h/R)²/24."""
    h, radius = 5.0, 20.0
    blank = rectangle(40.0, 20.0, h)
    points = at_nodes(blank)
    angle = blank.nodes[:, 0] / radius
    inner = np.abs(blank.nodes[:, 0]) < 19.0
    circle = np.column_stack([np.sin(angle), blank.nodes[:, 1] / radius, np.cos(angle)])
    outside = radius * circle
    averaged = (points.weights * outside[points.nodes]).sum(1)
    off = np.hypot(averaged[inner, 0], averaged[inner, 2])
    assert_allclose(off, radius * (1 + (np.cos(h / radius) - 1) / 12), rtol=1e-12)
    # scaled until the points touch, each chord has the length of the arc on the tool
    chord = 2 * radius * np.sin(h / (2 * radius)) * radius / off
    assert_allclose(chord, h, rtol=(h / radius) ** 4 / 300)
    assert 2 * radius * np.sin(h / (2 * radius)) < h * (1 - 0.99 * (h / radius) ** 2 / 24)


def test_edges_touch_when_they_are_deeper_than_their_sag():
    """l/8: what a chord of length l cuts off a circle of radius l, to 7 %."""
    blank = BLANKS["cut"]
    points = at_edges(blank)
    ends = blank.nodes[points.nodes]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert_allclose(points.sag, SAG * length)
    assert_allclose(points.sag, length * (1 - np.sqrt(0.75)), rtol=0.07)
    assert_allclose(points.areas.sum(), blank.areas.sum())
    x = flat(blank, rigid=1)
    term = Contact(sheet_of(blank), Tool("plate", Plane()), len(x) - 1, points)
    for depth in (0.0, *np.quantile(points.sag, [0.1, 0.5, 0.9]) + 1e-6):
        x[2:-1:3] = FABRIC.thickness / 2 - depth
        assert_allclose(term.penetration(x), depth - points.sag)
        assert_array_equal(term.pressure(x) > 0, points.sag < depth)


@pytest.mark.parametrize("sort", ["at nodes", "between"])
@pytest.mark.parametrize("name", [name for name in SHAPES if name != "sphere"])
def test_moment_is_the_derivative_by_the_tilts(name, sort):
    given = contact(name, sort, tilts=True).term
    term = Contact(given.sheet, given.tool, given.tool_dofs, given.points)
    x = touching(term, [2.0, 0.0, 0.0])
    tilts = term.gradient(x)[:, -2:].sum(0)
    assert_allclose(moment(term, x), -term.lever * tilts, rtol=1e-9, atol=1e-9)
    assert np.abs(moment(term, x)).max() > 1.0


def test_a_tool_surrounded_by_the_sheet_under_its_face():
    """Where the points under the face of a ring lie around its origin, and where they do not."""
    ring = flipped(round_opening(10.0, 2.0))
    blank = rectangle(60.0, 60.0, 5.0)
    x = flat(blank, rigid=3)
    for place, around in (((0.0, 0.0), True), ((24.0, 0.0), True), ((35.0, 0.0), False)):
        tool = Tool("ring", ring, motion="free", mass=1.0, place=place, tilts=True)
        term = Contact(sheet_of(blank), tool, len(x) - 3 + np.arange(3))
        x[-3] = FABRIC.thickness / 2
        assert surrounds(term, x) is around
        x[-3] = 20.0  # far above the sheet
        assert surrounds(term, x) is False
    half = rectangle(60.0, 60.0, 5.0, mirror=("x",))
    x = flat(half, rigid=3)
    x[-3] = FABRIC.thickness / 2
    at_plane = replace(tool, place=(0.0, 0.0))
    for mirror, around in ((("x",), True), ((), False)):  # the part as it is, without its mirror
        part = sheet_of(replace(half, mirror=mirror))
        assert surrounds(Contact(part, at_plane, len(x) - 3 + np.arange(3)), x) is around


@pytest.mark.parametrize("name", [name for name in SHAPES if name not in ("plane", "opening")])
def test_distance_far_away_is_a_lower_bound(name):
    """Also from a shape's box on: d never exceeds the true distance, and is it where it counts."""
    shape = SHAPES[name]
    term = contact(name).term
    points = np.random.default_rng(5).uniform(-200.0, 200.0, (3000, 3))
    true, bound = shape.distance(points), term.distance(points)
    assert (bound[0] <= true[0] + 1e-9).all()
    close = true[0] < term.far_off
    assert close.any()
    for a, b in zip(true, bound, strict=True):
        assert_array_equal(a[close], b[close])
    assert (bound[0][~close] > term.far_off / 4).all()
    if getattr(shape, "box", None) is not None:
        assert (np.abs(bound[0] - true[0]) > 1.0).any()


@pytest.mark.parametrize("name", [name for name in ON_TOOLS if name.startswith("contact")])
def test_masses_from_the_stiffness_bound_make_unit_time_steps_stable(name):
    """K ≤ 4 M with masses of half the row sums of the bound."""
    case = ON_TOOLS[name]()
    mass = 0.5 * case.term.stiffness_bound(case.x)
    H = case.term.hessian(case.x, None, True)
    n = mass.shape[1]
    spare = 4 * mass[:, :, None] * np.eye(n) - H
    assert np.linalg.eigvalsh(spare).min() > -1e-9 * np.abs(H).max()


def test_evaluating_notices_that_a_state_was_changed_in_place():
    term, x = contact("sphere").term, contact("sphere").x
    first = term.energy(x), term.gradient(x), term.hessian(x, None, False)
    x[-1] += 0.05
    other = contact("sphere").term
    for value, before in zip(
        (term.energy(x), term.gradient(x), term.hessian(x, None, False)), first, strict=True
    ):
        assert (value != before).any()
    for name in ("energy", "gradient", "penetration", "relative"):
        assert_array_equal(getattr(term, name)(x), getattr(other, name)(x))


# Friction

DEPTH = 0.1
PRESSURE = FABRIC.compaction * (DEPTH - E / 2)
STICK_PER_AREA = STICK * FABRIC.compaction  # N/mm³
REACH = MU * PRESSURE / STICK_PER_AREA  # elastic slide at the limit of stick, mm


def slid(x, s, direction=(0.6, 0.8)):
    moved = x.copy()
    moved[0:-1:3] += s * direction[0]
    moved[1:-1:3] += s * direction[1]
    return moved


def test_stick_is_elastic_and_slip_is_limited():
    normal, x = plate(DEPTH)
    case = rubbing(normal, x)
    assert_allclose(case.state.limit, MU * PRESSURE * normal.area)
    assert_array_equal(case.gradient(x), 0.0)
    for s in (0.3 * REACH, 0.9 * REACH):
        force = STICK_PER_AREA * s * normal.area[:, None] * [0.6, 0.8, 0.0, 0.0]
        assert_allclose(on_points(case, slid(x, s)), force, atol=1e-12)
        assert_allclose(case.energy(slid(x, s)), 0.5 * STICK_PER_AREA * s**2 * normal.area)
    for s in (1.1 * REACH, 20 * REACH):
        force = MU * PRESSURE * normal.area[:, None] * [0.6, 0.8, 0.0, 0.0]
        assert_allclose(on_points(case, slid(x, s)), force, atol=1e-12)
        work = MU * PRESSURE * normal.area * (s - REACH / 2)
        assert_allclose(case.energy(slid(x, s)), work)


def test_a_lightly_touching_node_sticks_and_a_committed_slip_goes_on():
    for p in (DEPTH, 0.05 * DEPTH):
        normal, x = plate(p)
        case = rubbing(normal, x)
        stick = STICK_PER_AREA * normal.area[:, None, None] * np.diag([1.0, 1.0, 0.0, 0.0])
        T = together(case)
        assert_allclose(T.T @ case.hessian(x, True) @ T, stick, atol=1e-12)
        far = slid(x, 5 * REACH)
        case = case.committed(far).refreshed(far)
        along_slip, across = T @ [0.6, 0.8, 0.0, 0.0], T @ [-0.8, 0.6, 0.0, 0.0]
        assert_allclose(case.hessian(far, True) @ along_slip, 0.0, atol=1e-9)
        assert (np.abs(case.hessian(far, True) @ across).max(1) > 0.1).all()
    normal, clear = plate(-DEPTH)
    assert_array_equal(rubbing(normal, clear).hessian(clear, True), 0.0)


def test_friction_cases_hold_both_sticking_and_slipping_nodes():
    for name in ON_TOOLS:
        if not name.startswith("friction"):
            continue
        case = ON_TOOLS[name]()
        force = np.linalg.norm(case.term.force(case.x, case.state), axis=1)
        touching = case.state.limit > 0
        slipping = force[touching] > (1 - 1e-9) * case.state.limit[touching]
        assert slipping.any()
        assert not slipping.all()


def test_exact_and_convex_friction_are_the_same():
    """But for the finite turns of a tool that tilts."""
    case = friction("opening")
    assert_array_equal(case.hessian(case.x, True), case.hessian(case.x, False))
    case = friction("holder", tilts=True)
    turns = case.hessian(case.x, False) - case.hessian(case.x, True)
    assert not turns[:, :-3, :-3].any()
    assert np.abs(turns[:, -2:]).max() > 1e-3


def test_commit_moves_the_anchor_of_a_slipping_node():
    """The force stays as it is, and a step back unloads elastically."""
    normal, x = plate(DEPTH)
    case = rubbing(normal, x)
    far = slid(x, 5 * REACH)
    force = case.gradient(far)
    case = case.committed(far).refreshed(far)
    assert_allclose(case.gradient(far), force, rtol=1e-12)
    assert_allclose(case.gradient(slid(x, 4.5 * REACH)), 0.5 * force, rtol=1e-9, atol=1e-12)
    assert_allclose(case.gradient(slid(x, 4 * REACH)), 0.0, atol=1e-9)
    assert_allclose(case.gradient(slid(x, 3 * REACH)), -force, rtol=1e-9, atol=1e-12)


def test_commit_leaves_the_anchor_of_a_sticking_node():
    normal, x = plate(DEPTH)
    case = rubbing(normal, x)
    near = slid(x, 0.5 * REACH)
    case = case.committed(near).refreshed(near)
    assert_allclose(case.gradient(x), 0.0, atol=1e-12)


def test_refreshing_at_the_committed_state_undoes_what_came_since():
    case = friction("opening")
    case = case.refreshed(case.x).committed(case.x).refreshed(case.x)
    before = contents(case.state)
    ahead = case.x + np.random.default_rng(3).uniform(-0.5, 0.5, len(case.x))
    later = case.refreshed(ahead)
    assert any((a != b).any() for a, b in zip(before, contents(later.state), strict=True))
    for a, b in zip(before, contents(later.refreshed(case.x).state), strict=True):
        assert_array_equal(a, b)


def test_new_contact_is_anchored_where_it_touched():
    """From 0.1 mm clear to 0.1 mm inside while sliding by s: it has touched halfway."""
    normal, clear = plate(-DEPTH)
    _, pressed = plate(DEPTH)
    s = 0.8 * REACH
    case = rubbing(normal, clear)
    end = slid(pressed, s)
    assert_array_equal(case.gradient(end), 0.0)  # no normal force is known yet
    case = case.refreshed(end)
    force = STICK_PER_AREA * 0.5 * s * normal.area[:, None] * [0.6, 0.8, 0.0, 0.0]
    assert_allclose(on_points(case, end), force, atol=1e-9)


def test_anchor_of_new_contact_stays_while_it_slides_on():
    """Else friction would follow the node, and a sheet that has jumped would creep without end."""
    normal, clear = plate(-DEPTH)
    _, pressed = plate(DEPTH)
    case = rubbing(normal, clear)
    case = case.refreshed(slid(pressed, 0.8 * REACH))
    anchor = case.state.anchor
    further = slid(pressed, 0.9 * REACH)
    case = case.refreshed(further)
    assert_array_equal(case.state.anchor, anchor)
    force = STICK_PER_AREA * 0.5 * REACH * normal.area[:, None] * [0.6, 0.8, 0.0, 0.0]
    assert_allclose(on_points(case, further), force, atol=1e-9)
    case = case.refreshed(clear)  # it has left, and touches again elsewhere
    case = case.refreshed(slid(pressed, 2 * REACH))
    assert np.abs(case.state.anchor - anchor).max() > 0.1 * REACH


def test_node_that_left_the_tool_forgets_its_anchor():
    normal, x = plate(DEPTH)
    _, clear = plate(-DEPTH)
    case = rubbing(normal, x)
    away = slid(clear, 3.0)
    case = case.refreshed(away).committed(away).refreshed(away)
    assert_array_equal(case.energy(away), 0.0)
    back = slid(x, 3.0)
    case = case.refreshed(back)
    assert_allclose(case.gradient(back), 0.0, atol=1e-9)


def test_change_of_the_normal_force_moves_no_force_onto_a_node_that_has_not_slipped():
    normal, x = plate(DEPTH)
    case = rubbing(normal, x)
    stuck = slid(x, 0.5 * REACH)
    force = case.gradient(stuck)
    _, deeper = plate(3 * DEPTH)
    limit = case.state.limit
    case = case.refreshed(deeper)
    assert (case.state.limit > 2 * limit).all()
    assert_array_equal(case.gradient(x), 0.0)
    assert_array_equal(case.gradient(deeper), 0.0)
    assert_allclose(case.gradient(stuck), force, rtol=1e-12)


def test_anchor_rides_with_its_tool():
    """A punch that moves down past a still sheet drags at it and is held back by as much."""
    blank = BLANKS["aligned"]
    punch = Tool("punch", SHAPES["punch"], friction=MU)
    normal = Contact(sheet_of(blank), punch, 3 * len(blank.nodes))
    offset = 25.0 + FABRIC.thickness / 2 - DEPTH
    around = blank.nodes[:, 0] / offset
    shaft = np.column_stack(
        [offset * np.cos(around), offset * np.sin(around), 60 + blank.nodes[:, 1]]
    )
    x = with_points_at(normal, shaft, [0.0])
    assert_allclose(normal.penetration(x), DEPTH)
    case = rubbing(normal, x)
    down = x.copy()
    down[-1] -= 0.5 * REACH
    force = 0.5 * STICK_PER_AREA * REACH * normal.area[:, None] * [0.0, 0.0, 1.0, -1.0]
    assert_allclose(on_points(case, down), force, atol=1e-9)
    both = x - np.append(np.tile([0.0, 0.0, 2.0], len(shaft)), 2.0)
    assert_allclose(case.gradient(both), 0.0, atol=1e-9)


def test_friction_dissipates_what_slips_beyond_the_elastic_reach():
    normal, x = plate(DEPTH)
    case, lost = rubbing(normal, x), 0.0
    for s in np.linspace(0.0, 5 * REACH, 201)[1:]:
        moved = slid(x, s)
        after = case.refreshed(moved).committed(moved)
        lost += case.term.dissipated(case.state, after.state, moved)
        case = after
    exact = MU * PRESSURE * normal.area.sum() * 4 * REACH
    assert lost == pytest.approx(exact, rel=0.01)
    assert case.energy(moved).sum() == pytest.approx(exact / 8)


@pytest.mark.parametrize("name", [name for name in ON_TOOLS if name.startswith("friction")])
def test_work_against_friction_is_stored_or_dissipated(name):
    """Over a small slip, with the trapezoidal rule; the forces are those of all unknowns."""
    case = ON_TOOLS[name]()
    x = touching(case.term.contact, case.x[case.term.contact.tool_dofs] * 0)
    case = replace(case, state=case.term.initial(x))
    start, work, lost = case.energy(x).sum(), 0.0, 0.0
    step = 0.01 * np.random.default_rng(4).uniform(-1.0, 1.0, len(x))
    step = turned_less(case.term.contact, step)

    def pull(case, x):
        return (case.gradient(x) * step[case.dofs]).sum()

    for _ in range(100):
        before, x = pull(case, x), x + step
        after = case.refreshed(x).committed(x)
        work += 0.5 * (before + pull(after, x))
        lost += case.term.dissipated(case.state, after.state, x)
        case = after
    assert 0.02 * work < lost < work
    assert case.energy(x).sum() - start + lost == pytest.approx(work, rel=0.01)


# Weight


@pytest.mark.parametrize("blank", ["cut", "quarter"])
def test_pressure_is_a_force_along_the_normal_of_each_triangle(blank):
    """Also at a free edge, and of a part in its mirror planes as of the whole."""
    case, edge = pressure(blank), pressure(blank, edge=True)
    blank, x, force = BLANKS[blank], case.x, np.zeros(len(case.x))
    for axis, plane in enumerate("xy"):  # which the mirror planes keep in place
        if plane in blank.mirror:
            x[axis:-1:3][np.abs(blank.nodes[:, axis]) < 1e-9] = 0.0
    case.term.add_gradient(force, x, None)
    edge.term.add_gradient(force, x, edge.term.initial(x))
    exact, corners = np.zeros((len(blank.nodes), 3)), x[:-1].reshape(-1, 3)[blank.triangles]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for k in range(3):
        np.add.at(exact, blank.triangles[:, k], 0.3 * area / 3)
    found, free = force[:-1].reshape(-1, 3), np.ones((len(blank.nodes), 3), dtype=bool)
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            free[np.abs(blank.nodes[:, axis]) < 1e-9, axis] = False
    assert len(free_edges(blank)) > 8
    assert_allclose(found[free], exact[free], atol=1e-12 * np.abs(exact).max())


def test_work_of_a_pressure_at_a_free_edge_is_counted():
    """A flat sheet that is lifted, turned by 90 degrees and moved along: p A for each mm."""
    case = pressure("aligned", edge=True, p=0.3)
    whole, blank = pressure("aligned").term, BLANKS["aligned"]
    start = np.append(flat(blank), 0.3)
    R = Rotation.from_euler("y", 90.0, degrees=True).as_matrix()
    before = case.term.initial(start)
    stored, lost = whole.total(start, None) + case.term.total(start, before), 0.0
    for s in np.linspace(0.0, 1.0, 33)[1:]:
        R = Rotation.from_euler("y", 90.0 * s, degrees=True).as_matrix()
        moved = flat(blank).reshape(-1, 3) @ R.T + [40.0 * s**2, 0.0, 10.0 * s]
        x = np.append(moved.ravel(), 0.3)
        after = case.term.commit(x, before)
        lost += case.term.dissipated(before, after, x)
        before = after
    stored = whole.total(x, None) + case.term.total(x, before) - stored
    turn = np.linspace(0.0, 1.0, 100001)
    path = np.sin(np.pi / 2 * turn) * 80.0 * turn + np.cos(np.pi / 2 * turn) * 10.0
    work = 0.3 * whole.area * np.trapezoid(path, turn)  # n·dx of the middle
    assert stored + lost == pytest.approx(work, rel=2e-3)


def test_dead_loads():
    blank = BLANKS["aligned"]
    sheet = SheetWeight(sheet_of(blank), 0.02, 3 * len(blank.nodes))
    x = flat(blank, rigid=1)
    x[2:-1:3], x[-1] = 3.0, 0.5
    assert_allclose(sheet.energy(x).sum(), 0.5 * 0.02 * 1200.0 * 3.0)
    assert_allclose(sheet.gradient(x).sum(0), [0.5 * 0.02 * 1200.0, 0.02 * 1200.0 * 3.0])
    tool = ToolWeight(49.05, 0)
    assert_allclose(tool.gradient(np.array([2.0])), [[49.05]])
    assert_allclose(tool.energy(np.array([2.0])), [98.1])
    assert GRAVITY == 9.81e-3  # N/g


# Grippers


def test_gripper_pulls_with_its_tension_and_yields_with_its_stiffness():
    nodes, shares = np.array([1, 4, 2]), np.array([0.25, 0.25, 0.5])
    e = np.array([0.6, 0.8, 0.0])
    start = np.arange(9.0).reshape(3, 3)
    sheet = sheet_of(BLANKS["aligned"])
    term = Grip(sheet, nodes, shares, start, e, 12.0, 3.0)
    x = np.zeros(sheet.dofs.size)
    x[term.dofs] = start
    assert_allclose(term.energy(x), 0.0, atol=1e-15)
    assert_allclose(term.gradient(x), -12.0 * shares[:, None] * e)
    x[term.dofs] += 4.0 * e  # where the spring has taken up the tension
    assert_allclose(term.gradient(x), 0.0, atol=1e-12)
    assert_allclose(term.energy(x).sum(), 0.5 * 3.0 * 4.0**2 - 12.0 * 4.0)
    across = x.copy()
    across[term.dofs] += 5.0 * np.array([-0.8, 0.6, 1.0])
    assert_allclose(term.energy(across), term.energy(x))
    for convex in (True, False):
        assert_allclose(term.hessian(x, None, convex).sum(0), 3.0 * np.outer(e, e))


def test_a_dead_pull_has_no_stiffness():
    sheet, e = sheet_of(BLANKS["aligned"]), np.array([0.0, 1.0, 0.0])
    term = Grip(sheet, np.array([0]), np.ones(1), np.zeros((1, 3)), e, 7.0, 0.0)
    for y in (0.0, 50.0):
        assert_allclose(term.gradient(np.array([3.0, y, -2.0])), [[0.0, -7.0, 0.0]])
    assert not term.hessian(np.zeros(3), None, False).any()


def ball_and_fillet():
    """A square on a ball of 75 mm and on a cylinder of 10 mm, nodes at the length of the fibres."""
    blank = rectangle(20.0, 20.0, 2.0)
    x, y = blank.nodes.T
    yield blank, ball(75.0), 75.0, np.column_stack([x, y, -(x**2 + y**2) / 150.0]), 2
    yield blank, bar(10.0), 10.0, np.column_stack([x, y, -(x**2) / 20.0]), 1


def test_the_mean_place_of_the_net_and_the_length_of_its_fibres():
    """A ball lifts nodes by h²/24R in all, a fillet by h²/12r: `share` of each family of fibres."""
    h = 2.0
    for blank, shape, radius, places, bent in ball_and_fillet():
        points = at_nodes(blank, share(Tool("tool", shape, motion="driven"), h))
        mean = (points.weights * places[points.nodes]).sum(1)
        middle = np.linalg.norm(blank.nodes, axis=1).argmin()
        lowered = (places - mean)[middle, 2]
        expected = h**2 / 24 if bent == 2 else h**2 / 12
        assert lowered == pytest.approx(expected / radius, rel=1e-9)
    coarse = Tool("die", bar(3.0))
    assert share(coarse, h) == pytest.approx(1 / 24)  # nodes would jump over it


# Bending of layers that slip


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("blank", "clamp"), [("cut", False), ("aligned", True), ("quarter", False)]
)
def test_each_layer_resists_bending_in_its_plane(blank, clamp, dim):
    """Moved as they are, the layers have r B/2 |k|², the warp of x + d/2, the weft of x - d/2."""
    bending, extra, x = bending_of_layers(blank, clamp, dim)
    positions, d = np.split(x, 2)
    part = 0.5 * bending.in_plane * bending.stiffness

    def square(y, f):
        return part[:, f] * (bending._combined(y, 2)[:, f] ** 2).sum(1)

    layers = square(positions + d / 2, 0) + square(positions - d / 2, 1)
    expected = layers - square(positions, 0) - square(positions, 1)
    assert_allclose(extra.energy(x), expected, atol=1e-9 * np.abs(expected).max())
    case = Case(extra, x)
    test_gradient_is_the_derivative_of_the_energy(case)
    test_hessian_is_the_derivative_of_the_gradient(case)
    H, k = extra.hessian(x, None, False), bending.dofs.shape[1]
    H[:, :k, :k] += bending.hessian(positions, None, True)
    assert np.linalg.eigvalsh(H).min() >= -1e-12 * np.abs(H).max()
