"""Slits, darts and notches: the mesh, its energy, the scene, drawings."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

import quasiform as qf
from quasiform.checks import InputError
from quasiform.energy.bending import Bending
from quasiform.energy.contact import at_nodes
from quasiform.energy.membrane import membrane_of
from quasiform.fabric import fabric_of
from quasiform.handover.pattern import FlatPattern, cut_lines
from quasiform.net import outline as outlines
from quasiform.net.blank import GIVE, cut
from quasiform.net.transfer import beside_slits
from quasiform.result.sheet import FormedSheet, read_sheets
from quasiform.scenes import scene_file
from quasiform.scenes.scene_parts import Region, Slit
from quasiform.unknowns import Unknowns

BOX = outlines.rectangle(60.0, 40.0)
SIZE = 5.0
SLITS = {  # lines, how many nodes are doubled along the fibres (warp along x)
    "from the edge": ([[(0, 0), (30, 0)]], 6),
    "inside": ([[(-10, 0), (10, 0)]], 3),
    "in a cell": ([[(-10, 2.4), (10, 2.4)]], None),
    "at an angle": ([[(-10, 1.3), (12, 7.2)]], None),
    "bent": ([[(-10, 1.3), (2, 7.2), (5, -13)]], None),
    "over the edge": ([[(-20, -15), (35, 18.3)]], None),
    "cross": ([[(-10, 0), (10, 0)], [(0, -10), (0, 10)]], 3 + 3 + 2 - 1),
    "branches": ([[(-10, -3), (10, 4)], [(3, -8), (0, 8)], [(10, 4), (25, 5)]], None),
    "nearly closed": ([[(-3, 3), (3, 3), (3, -3), (-3, -3), (-3, 2)]], None),
}


def slit_blank(lines, orientation=0.0, shape=BOX, **more):
    lines = [np.array(line, dtype=float) for line in lines]
    return cut(shape, SIZE, orientation, through=((0.0, 0.0),), slits=lines, **more)


def test_contact_at_the_end_of_a_slit_has_its_own_place_along_the_line_that_parts():
    blank = slit_blank([[(-10, 0), (10, 0)]])
    points = at_nodes(blank)
    ends = np.flatnonzero((np.abs(blank.nodes - [10.0, 0.0]) < 1e-9).all(1))
    inner = np.flatnonzero((np.abs(blank.nodes - [15.0, 0.0]) < 1e-9).all(1))
    assert (points.weights[ends, 1:3] == 0).all()
    assert (points.weights[inner, 1:3] > 0).all()
    assert_allclose(points.weights.sum(1), 1.0)


@pytest.mark.parametrize("orientation", [0.0, 45.0, 20.0])
@pytest.mark.parametrize("case", SLITS)
def test_no_triangle_reaches_across_a_slit(case, orientation):
    lines, doubled = SLITS[case]
    blank, whole = slit_blank(lines, orientation), slit_blank([], orientation)
    assert (blank.areas > 0).all()
    assert len(blank.outline) == 1 or len(blank.outline[0]) > len(blank.outline[-1])
    if orientation == 0.0:
        assert_allclose(blank.areas.sum(), BOX.area, rtol=1e-9)
    else:  # the outline moves to meet other lines
        assert_allclose(blank.areas.sum(), whole.areas.sum(), rtol=2e-3)
    if doubled and orientation == 0.0:
        places = np.unique(blank.nodes.round(9), axis=0)
        assert len(blank.nodes) - len(places) == doubled
    slit = shapely.union_all([shapely.LineString(line) for line in lines])
    edges = shapely.linestrings(blank.nodes[blank.mesh.facets.T])
    strip = slit.buffer(2 * GIVE * SIZE, cap_style="flat")
    ends = shapely.MultiPoint([p for line in lines for p in (line[0], line[-1])]).buffer(SIZE)
    crossing = [
        edge
        for edge in edges[shapely.crosses(edges, slit)]
        if edge.difference(strip).geom_type == "MultiLineString" and not edge.intersects(ends)
    ]
    assert not crossing


def sheet_of(blank):
    unknowns = Unknowns()
    sheet = unknowns.sheet(blank, fabric_of("locking"), 3, 0.0, "sheet")
    return sheet, unknowns.start(sheet)[0]


def energy(blank, moved, y):
    """Energies of membrane and bending at positions that are a function of place and side of y."""
    sheet, x = sheet_of(blank)
    upper = np.zeros(len(blank.nodes), dtype=bool)
    upper[blank.triangles[blank.centroids[:, 1] > y]] = True
    x[sheet.dofs] = moved(blank.nodes, upper)
    return np.array([term.energy(x).sum() for term in (membrane_of(sheet), Bending(sheet))])


@pytest.mark.parametrize("y", [0.0, 1.7, -1.7])
def test_a_slit_sheet_stores_what_two_strips_store(y):
    """Up to the last cells, which hold both together and are not strained (diagonals run alike)."""
    lines = [[(-30, y), (25, y)]]

    def moved(places, upper):
        rng = np.random.default_rng(1)
        waves, phase = rng.uniform(0.0, 0.4, (2, 3, 2)), rng.uniform(0.0, 6.0, (2, 3))
        side = upper.astype(int)
        u = np.sin((waves[side] * places[:, None]).sum(2) + phase[side])
        u *= np.array([0.3, 0.3, 2.0]) * (places[:, :1] < 22.0)
        u[:, 0] += 0.02 * places[:, 0] * (places[:, 0] < 22.0)
        return np.pad(places, ((0, 0), (0, 1))) + u

    strips = [shapely.box(-30, -20, 30, y), shapely.box(-30, y, 30, 20)]
    lower, upper = (cut(part, SIZE, through=((0.0, y),)) for part in strips)
    one = cut(BOX, SIZE, through=((0.0, y),), slits=[np.array(line, float) for line in lines])
    both, apart = energy(lower, moved, y) + energy(upper, moved, y), energy(one, moved, y)
    assert (both > 1e-3).all()
    assert_allclose(apart, both, rtol=1e-12)
    assert (energy(cut(BOX, SIZE, through=((0.0, y),)), moved, y) > 1.01 * both).all()


def test_bending_at_the_end_of_a_slit_is_that_of_both_edges():
    """A cylinder across the slit stores as much as without it: no stencil is lost at its end."""
    bend = {}
    for lines in ([], [[(-10, 0), (10, 0)]]):
        sheet, x = sheet_of(slit_blank(lines))
        x[sheet.dofs[:, 2]] = 1e-3 * sheet.blank.nodes[:, 0] ** 2
        bend[len(lines)] = Bending(sheet).energy(x).sum()
    assert bend[1] == pytest.approx(bend[0], rel=1e-12)


def test_mirror_planes_of_slits():
    across = [[(20, 0), (25, 10)], [(-20, 0), (-25, 10)]]
    part = slit_blank(across, mirror=("x",))
    whole = part.unfolded()[0]
    assert_allclose(whole.areas.sum(), BOX.area, rtol=1e-9)
    through = slit_blank([[(-10, 5), (10, 5)]], mirror=("x",)).unfolded()[0]
    places = np.unique(through.nodes.round(9), axis=0)
    assert len(through.nodes) - len(places) == 3
    for lines in (across[:1], [[(0, -5), (0, 5)]]):
        with pytest.raises(InputError, match="the slits are not symmetric to x = 0: leave 'x'"):
            slit_blank(lines, mirror=("x",))


@pytest.mark.parametrize("lines", [[[(-30, 0), (10, 0)]], [[(-10, 1.3), (12, 7.2)]]])
@pytest.mark.parametrize("size", [2.5, 3.4, 8.0])
def test_values_on_another_mesh_stay_on_their_side(lines, size):
    line = np.array(lines[0], dtype=float)
    blanks = [cut(BOX, h, through=((0.0, 0.0),), slits=[line]) for h in (SIZE, size)]
    across = (line[1] - line[0])[::-1] * [-1.0, 1.0]
    side = [np.zeros(len(blank.nodes)) for blank in blanks]
    for blank, upper in zip(blanks, side, strict=True):
        upper[blank.triangles[(blank.centroids - line[0]) @ across > 0]] = 1.0
    linear = [blank.nodes @ [0.3, -0.2] for blank in blanks]
    near, found = beside_slits(blanks[0], linear[0] + 10.0 * side[0], blanks[1])
    on_slit = np.isin(near, blanks[1].doubled)
    assert on_slit.sum() == len(blanks[1].doubled) > 1
    far = np.linalg.norm(blanks[1].nodes[near, None] - line, axis=2).min(1) > SIZE + size
    expected = linear[1][near] + 10.0 * side[1][near]
    assert_allclose(found[on_slit & far], expected[on_slit & far], atol=1e-9)
    whole = cut(BOX, SIZE)
    assert not len(beside_slits(whole, whole.nodes, blanks[1])[0])


@pytest.mark.parametrize(("orientation", "doubled"), [(0.0, 2), (90.0, 2), (20.0, 0)])
def test_a_narrow_tip_of_a_dart_is_cut_and_not_closed(orientation, doubled):
    shape = outlines.with_holes(BOX, [outlines.polygon([(0, 0), (35, -1.5), (35, 1.5)])], "dart")
    closed = cut(shape, SIZE, orientation, through=((0.0, 0.0),))
    tip = cut(shape, SIZE, orientation, through=((0.0, 0.0),), open_tips=True)
    assert_allclose(tip.areas.sum(), closed.areas.sum(), rtol=1e-12)
    assert not len(closed.doubled)
    assert len(tip.doubled) == len(tip.nodes) - len(closed.nodes) + doubled // 2 == doubled
    thorn = BOX.union(shapely.Polygon([(-10, 20), (10, 20), (0, 20.2)]))
    assert len(cut(thorn, SIZE, open_tips=True).nodes) == len(cut(thorn, SIZE).nodes)


def on_cone(blank, slope):
    """Nodes of a flat disc (n, 3) on the cone that its sector closes, without stretch."""
    r, above = np.hypot(*blank.nodes.T), np.zeros(len(blank.nodes))
    np.add.at(above, blank.triangles, np.sign(blank.centroids[:, 1:]))
    angle = np.arctan2(np.abs(blank.nodes[:, 1]), -blank.nodes[:, 0]) * np.sign(above)
    turn = angle / np.cos(slope)
    x, y = -np.cos(turn), np.sin(turn)
    return r[:, None] * np.column_stack(
        [np.cos(slope) * x, np.cos(slope) * y, r * 0 + np.sin(slope)]
    )


def test_a_disc_with_the_exact_sector_cut_out_closes_to_a_cone():
    """Edges meet within .2 mm, also where the mesh moves the tip; shear is below .5 degrees."""
    slope, radius = np.radians(10.0), 60.0
    half = np.pi * (1 - np.cos(slope))
    end = 1.5 * radius * np.array([1.0, np.tan(half)])
    wedge = outlines.polygon([(0.0, 0.0), end * [1, -1], end])
    shape = outlines.with_holes(outlines.disc(radius), [wedge], "dart")
    blank = cut(shape, 2.0, through=((0.0, 0.0),), open_tips=True)
    points = on_cone(blank, slope)
    sheet = FormedSheet(points, blank.triangles, blank.nodes)
    shear = np.abs(sheet.sheared(np.eye(2)))
    assert shear.max() < 0.5
    upper = np.flatnonzero(np.abs(np.arctan2(*blank.nodes.T[::-1]) - half) < 1e-9)
    off, lower = cKDTree(blank.nodes).query(blank.nodes[upper] * [1.0, -1.0])
    assert len(upper) > 15
    assert off.max() < 1e-9
    assert np.linalg.norm(points[upper] - points[lower], axis=1).max() < 1e-9
    assert np.linalg.norm(np.diff(points[blank.doubled], axis=0)) < 0.2


# In a scene

SLIT = {"points": [[60.0, 10.0], [155.0, 10.0]]}
MIRRORED = {"points": [[-60.0, 10.0], [-155.0, 10.0]]}
DART = {"points": [[60.0, 0.0], [165.0, -20.0], [165.0, 20.0]]}


def formed(**blank):
    keys = {f"blank.{key}": value for key, value in blank.items()}
    return qf.forming("hemisphere", size=25, overrides=keys)


def test_mirror_planes_of_a_scene_with_slits():
    model = formed(slits=[SLIT, MIRRORED])
    assert model.sheet.blank.mirror == ("x",)
    description = dict(model.description)
    assert description["slits"] == "2, 190 mm long: both edges part, without contact"
    assert "along the warp the slits differ" in description["a half"]
    assert formed(slits=SLIT).sheet.blank.mirror == ()


def test_a_dart_of_a_scene():
    dart = formed(darts=[DART])
    assert dart.sheet.blank.mirror == ()
    assert "through a dart, whose tip would be closed" in str(dart.description)
    missing = 310**2 - dart.sheet.whole[0].areas.sum()
    assert missing == pytest.approx(95**2 * 20 / 105, rel=0.02)


def test_cuts_are_written_back(tmp_path):
    keys = {"blank.slits": SLIT, "blank.darts": [DART | {"centre": [0.0, -50.0]}]}
    (tmp_path / "cut.toml").write_text(scene_file.scene_toml(scene_file.load("hemisphere", keys)))
    file = scene_file.load(str(tmp_path / "cut.toml"))
    assert file.blank.slits == (Slit(((60.0, 10.0), (155.0, 10.0))),)
    assert_array_equal(file.slits[0], SLIT["points"])
    assert file.outline.area == pytest.approx(310**2 - 95**2 * 20 / 105)
    assert scene_file.scene_toml(scene_file.changed(file, {})) == scene_file.scene_toml(file)


def test_cuts_of_plies():
    stack = [{"orientation": 0.0}, {"blank": {"shape": "disc", "radius": 150.0, "slits": [SLIT]}}]
    model = qf.forming("hemisphere", size=25, plies=stack, overrides={"blank.slits": MIRRORED})
    for sheet in model.sheets:
        blank = sheet.blank
        assert len(blank.nodes) - len(np.unique(blank.nodes.round(6), axis=0)) == 4


def test_slits_move_with_a_ply():
    moved = [{}, {"offset": [0.0, 20.0]}]
    layers = qf.forming("hemisphere", size=25, plies=moved, overrides={"blank.slits": SLIT})
    assert "1 in ply 1, 95 mm long; 1 in ply 2" in dict(layers.description)["slits"]
    nodes = layers.sheets[1].blank.nodes.round(6)
    places, count = np.unique(nodes, axis=0, return_counts=True)
    assert_allclose(places[count == 2][:, 1], 30.0)


def test_joined_plies_have_the_same_slits():
    square = {"shape": "rectangle", "length": 310.0, "width": 310.0}
    other = [{}, {"joined": True, "blank": square | {"slits": [SLIT]}}]
    with pytest.raises(InputError, match=r"\[plies 2\] joined: it has another slit"):
        qf.forming("hemisphere", size=25, plies=other)


REFUSED = {
    "outside": ({"slits": {"points": [[200, 0], [265, 0]]}}, "slit 1 near .* does not lie inside"),
    "through": ({"slits": [SLIT, {"points": [[-200, 0], [265, 0]]}]}, r"slit 2 near .* divides"),
    "island": (
        {"slits": {"points": [[60, 0], [100, 0], [100, 30], [60, 30], [60, 0]]}},
        "slit 1 near .* divides the blank",
    ),
    "in a dart": ({"slits": {"points": [[90, 0], [150, 0]]}, "darts": DART}, "does not lie inside"),
    "a point": ({"slits": [{"points": [[60, 0], [60, 0]]}]}, "needs two different points"),
    "along the edge": ({"slits": {"points": [[50, 155], [0, 155], [0, 90]]}}, "along the outline"),
    "no points": ({"slits": [{}]}, r"\[blank.slits 1\] give points or a file"),
    "both": ({"slits": [SLIT | {"file": "a.dxf"}]}, "give points or a file"),
    "layer": ({"slits": [SLIT | {"layer": "A"}]}, "scale and layer go with a file"),
    "number": ({"slits": 3}, r"blank.slits: expected tables \[\[blank.slits\]\]"),
    "key": ({"slits": [{"point": []}]}, "unknown key 'point': did you mean 'points'"),
    "free": ({"slits": [SLIT], "mesh": "free"}, "slits need mesh = 'fibre'"),
    "dart through": (
        {"darts": [{"points": [[-460, 0], [165, -20], [165, 20]]}]},
        r"dart 1 near .* divides the blank",
    ),
    "dart without area": ({"darts": {"points": [[60, 0], [65, 0]]}}, "needs three points, got 2"),
    "dart without points": ({"darts": [{"pointz": []}]}, r"\[blank.darts 1\] shape missing"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_cuts_that_are_not_possible(case):
    keys, message = REFUSED[case]
    keys = {f"blank.{key}": value for key, value in keys.items()}
    with pytest.raises(InputError, match=message) as caught:
        scene_file.load("hemisphere", keys)
    assert "\n" not in str(caught.value)


def test_slits_too_near_to_each_other():
    lines = [[(-10, 0), (10, 0)], [(-10, 0.5), (10, 0.5)]]
    blank = slit_blank(lines)  # the strip between them is a column of triangles
    assert_allclose(blank.areas.sum(), BOX.area, rtol=1e-9)
    with pytest.raises(InputError, match="too near to the outline or another slit: choose"):
        slit_blank([[(-12.0, 1.3), (12.3, 12.31)], [(-12.0, 1.305), (12.3, 12.32)]])
    corner = slit_blank([[(-2.0, 18.0), (32.0, 19.95)]])  # its end moves no edge
    assert_allclose(corner.areas.sum(), BOX.area, rtol=1e-9)


# From a drawing


@pytest.fixture
def drawn(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    document.header["$INSUNITS"] = 4
    space = document.modelspace()

    def add(layer, *points, closed=True):
        space.add_lwpolyline(points, close=closed, dxfattribs={"layer": layer})

    add("OUTLINE", (-100, -100), (100, -100), (100, 100), (-100, 100))
    add("PLY2", (-80, -80), (80, -80), (80, 80), (-80, 80))
    add("SLITS", (40, 0), (70, 0), closed=False)
    add("SLITS", (70, 0.01), (90, 20), closed=False)  # the ends meet
    add("SLITS", (-40, 0), (-70, 0), closed=False)
    add("DARTS", (0, 60), (-10, 110), (10, 110))
    add("DARTS", (0, -60), (-10, -110), (10, -110))
    add("HOLES", (50, 50), (60, 50), (60, 60), (50, 60))
    add("HOLES", (-50, 50), (-40, 50), (-40, 60), (-50, 60))
    add("OPEN", (0, 60), (-10, 110), closed=False)
    add("OPEN", (0, 60), (10, 110), closed=False)
    document.saveas(tmp_path / "part.dxf")
    return tmp_path / "part.dxf"


def test_layers_of_a_drawing_by_name(drawn):
    def of(layer):
        return Region("file", (drawn, 1.0, layer))

    slits = (Slit(file=drawn, layer="slits"),)
    blank = replace(of("OUTLINE"), holes=(of("HOLES"),), darts=(of("DARTS"),), slits=slits)
    assert blank.polygon.area == pytest.approx(200**2 - 2 * 100 - 2 * 40 * 8)
    assert sorted(len(line) for line in blank.lines) == [2, 3]
    with pytest.raises(InputError, match=r"no closed loop: gap of 20 mm between"):
        _ = replace(blank, darts=(of("OPEN"),)).polygon
    with pytest.raises(InputError, match="no lines on layer 'SLIT': did you mean 'SLITS'"):
        _ = Slit(file=drawn, layer="SLIT").lines


def test_several_plies_from_one_drawing(drawn, tmp_path):
    text = """
travel = 20.0
[blank]
shape = "file"
file = "part.dxf"
layer = "OUTLINE"
slits = { file = "part.dxf", layer = "SLITS" }
holes = { file = "part.dxf", layer = "HOLES" }
darts = [{ file = "part.dxf", layer = "DARTS" }]
[tools.punch]
shape = "round punch"
radius = 40.0
[tools.die]
shape = "round opening"
radius = 45.0
fillet = 5.0
[[plies]]
[[plies]]
orientation = 45.0
[plies.blank]
shape = "file"
file = "part.dxf"
layer = "PLY2"
slits = { file = "part.dxf", layer = "SLITS", centre = [0.0, -10.0] }
"""
    (tmp_path / "stack.toml").write_text(text)
    model = qf.forming(str(tmp_path / "stack.toml"), size=20.0)
    areas = [sheet.whole[0].areas.sum() for sheet in model.sheets]
    assert_allclose(areas, [200**2 - 2 * 100 - 2 * 40 * 8, 160**2], rtol=5e-3)
    assert "2 in ply 1, " in dict(model.description)["slits"]
    assert [path.name for path in scene_file.load(str(tmp_path / "stack.toml")).files()].count(
        "part.dxf"
    ) == 6


# In what is written


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A sheet in tension with slits, not solved but written like a run."""
    lines = [np.array([(0.0, 0.0), (30.0, 0.0)]), np.array([(-20.0, 5.0), (-10.0, 5.0)])]
    blank = cut(BOX, SIZE, through=((0.0, 0.0),), slits=lines)
    flat, triangles = blank.nodes, blank.triangles
    upper = np.zeros(len(flat))
    upper[triangles[blank.centroids[:, 1] > 0]] = 1.0
    points = np.column_stack([flat, 3.0 * upper * np.maximum(flat[:, 0], 0.0) / 30.0])
    fibres = [np.tile(axis, (len(triangles), 1)) for axis in np.eye(3)[:2]]
    fields = {"warp": fibres[0], "weft": fibres[1]}
    return FormedSheet(points, triangles, flat, cell_fields=fields, name="slit")


def test_a_flat_pattern_shows_slits(result, tmp_path):
    edges, slits = cut_lines(result)
    assert [shapely.Polygon(edge).area for edge in edges] == [2400.0]
    ends = sorted(sorted(map(tuple, line[[0, -1]].tolist())) for line in slits)
    assert ends == [[(-20.0, 5.0), (-10.0, 5.0)], [(0.0, 0.0), (30.0, 0.0)]]
    pattern = FlatPattern("part", edges, edges, np.eye(2), slits)
    assert pattern.area == 2400.0
    pattern.save(tmp_path / "out")
    rows = (tmp_path / "out" / "pattern.csv").read_text().split()
    assert "SLITS,1,30,0" in rows or "SLITS,0,30,0" in rows
    assert 'id="SLITS"' in (tmp_path / "out" / "pattern.svg").read_text()


def test_a_written_sheet_keeps_its_slits(result, tmp_path):
    result.write(tmp_path / "slit.vtu")
    again = read_sheets(tmp_path / "slit.vtu")[0].with_flat()
    assert len(again.loops) == 2
    assert [len(loop) for loop in again.loops] == [len(loop) for loop in result.loops]
    assert len(cut_lines(again)[1]) == 2
