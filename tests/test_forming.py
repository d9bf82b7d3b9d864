"""Forming scenes: symmetry, tilting holders, loads, refusals, and results in the user's axes."""

import csv
from dataclasses import replace
from functools import cache

import meshio
import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull

import quasiform as qf
from quasiform.energy import contact as contacts
from quasiform.energy.bending import Bending
from quasiform.energy.gripper import Grip
from quasiform.energy.weight import GRAVITY, SheetWeight, ToolWeight
from quasiform.net import outline
from quasiform.net.blank import rotation
from quasiform.net.edges import edge_points
from quasiform.result import measures
from quasiform.result.measures import percentile
from quasiform.scenes import scene_file
from quasiform.scenes.scene_file import (
    Form,
    Gripper,
    Region,
    SceneFile,
    Support,
    SurfaceFile,
    Where,
)
from quasiform.tools.shapes import (
    Plane,
    ball,
    box_punch,
    flipped,
    opening,
    round_opening,
    tetrahedron_punch,
)

SLIPPERY = replace(qf.Fabric(), friction=0.0)


def changed(scene="hemisphere", tools=None, **parts):
    """A built-in scene with other parts; `tools` gives the parts of tools by their name."""
    file = scene_file.load(scene)
    tools = tools or {}
    return replace(file, tools=[replace(t, **tools.get(t.name, {})) for t in file.tools], **parts)


def turned_by(file, angle):
    """The scene about a round tool, turned about z: its outline, its fibres and its areas."""
    R = rotation(angle)
    return replace(
        file,
        blank=Region.of(shapely.affinity.rotate(file.outline, angle, origin=(0, 0))),
        orientation=file.orientation + angle,
        areas={name: (tuple(R @ c), radius) for name, (c, radius) in file.areas.items()},
    )


def solved(scene, travel, size=20.0, **given):
    return qf.solve(qf.forming(scene, size=size, travel=travel, **given), estimate=False)


cached = cache(solved)


def formed(**given):
    """A run of the hemisphere, which several tests look at."""
    return cached("hemisphere", **{"travel": 15.0, "orientation": 0.0, "symmetry": "auto", **given})


def tilting(**given):
    """A run of the tetrahedron, on which the blank holder tilts."""
    return cached("tetrahedron", **{"travel": 6.0, "size": 25.0, "symmetry": "auto", **given})


def p99(result):
    return percentile(np.abs(result.shear_angle), result.blank.areas, 0.99)


def words_of(scene):
    return "\n".join(f"{entry}: {why}" for entry, why in scene.description)


def rigid(result, name="blank holder"):
    """Height and tilts (radians) of a tool at the end."""
    contact = next(c for c in result.model.contacts if c.tool.name == name)
    height, *tilts = result.states[-1].x[contact.tool_dofs]
    return height, np.array(tilts) / contact.lever


# Symmetry


def assert_same(part, whole):
    """Check a part of a sheet, unfolded, against the whole of it."""
    assert part.certified.converged
    assert whole.certified.converged
    assert abs(p99(part) - p99(whole)) < 1e-4
    assert part.force == pytest.approx(whole.force, rel=1e-6)
    assert part.draw_in == pytest.approx(whole.draw_in, rel=1e-5, abs=1e-8)
    areas = [[mean or 0.0 for mean in result.areas.values()] for result in (part, whole)]
    assert areas[0] == pytest.approx(areas[1], rel=1e-5)
    holder_force = [result.history["holder_force_N"][-1] for result in (part, whole)]
    assert holder_force[0] == pytest.approx(holder_force[1], rel=1e-5)
    assert part.blank.areas.sum() == pytest.approx(whole.blank.areas.sum())
    # place by place: the shear angle and its sign, and the deformed positions
    for of, points in (
        (lambda r: r.shear_angle[:, None], lambda r: r.blank.centroids),
        (lambda r: r.positions(), lambda r: r.blank.nodes),
    ):
        order = [np.lexsort(points(r).round(4).T) for r in (part, whole)]
        places = [points(r)[o] for r, o in zip((part, whole), order, strict=True)]
        assert_allclose(*places, atol=1e-3)
        values = [of(r)[o] for r, o in zip((part, whole), order, strict=True)]
        assert_allclose(*values, atol=1e-4)


def test_half_and_whole_agree_in_a_frame_that_is_turned():
    half = formed(orientation=45.0, symmetry="half")
    assert half.model.sheet.blank.mirror == ("x",)
    assert half.model.sheet.turn == 45.0
    assert "a half: " in words_of(half.model)
    assert_same(half, formed(orientation=45.0, symmetry="none"))


@pytest.mark.parametrize("orientation", [0.0, 45.0])
def test_quarter_and_whole_agree(orientation):
    quarter = formed(orientation=orientation)
    whole = formed(orientation=orientation, symmetry="none")
    assert len(whole.model.sheet.blank.triangles) == 4 * len(quarter.model.sheet.blank.triangles)
    assert "a quarter: blank, fibres and tools are mirrored at the planes across the warp and " in (
        words_of(quarter.model)
    )
    assert "the whole blank: symmetry is switched off" in words_of(whole.model)
    assert p99(whole) > 1.0
    assert_same(quarter, whole)


def test_half_and_whole_agree_with_a_holder_that_tilts():
    half, whole = tilting(), tilting(symmetry="none")
    assert half.model.sheet.blank.mirror == ("y",)
    assert len(whole.model.sheet.blank.triangles) == 2 * len(half.model.sheet.blank.triangles)
    assert "a half: blank, fibres and tools are mirrored at the plane along the warp; " in (
        words_of(half.model)
    )
    assert_same(half, whole)
    tilts = [result.resting_tools()["blank holder"]["tilt_deg"] for result in (half, whole)]
    assert tilts[0] == pytest.approx(tilts[1], rel=1e-3, abs=1e-12)
    assert tilts[0][0] == 0.0


@pytest.mark.parametrize(
    ("scene", "orientation", "mirror", "words"),
    [
        ("hemisphere", 0, ("x", "y"), "a quarter"),
        ("hemisphere", -45, ("x", "y"), "a quarter"),
        ("hemisphere", 44.9, (), "no plane along the fibres mirrors it"),
        ("box", 0, ("x", "y"), "a quarter"),
        ("tetrahedron", 0, ("y",), "at the plane along the warp"),
        ("tetrahedron", 90, ("x",), "at the plane across the warp"),
        ("tetrahedron", 45, (), "the whole blank: no plane along the fibres mirrors it"),
    ],
)
def test_mirror_planes_of_the_built_in_scenes(scene, orientation, mirror, words):
    made = qf.forming(scene, orientation, size=30)
    assert made.sheet.blank.mirror == mirror
    assert words in words_of(made)
    assert made.share == 0.5 ** len(mirror)


ROUND_DIE = scene_file.load("hemisphere").tools[1:]


@pytest.mark.parametrize(
    ("punch", "place", "outlined", "mirror"),
    [
        (ball(30.0), (0.0, 0.0), None, ("x", "y")),
        (ball(30.0), (20.0, 0.0), None, ("y",)),
        (ball(10.0), (0.0, 30.0), None, ("x",)),
        (ball(5.0), (30.0, 5.0), None, ()),
        (tetrahedron_punch(265.0, 160.0, 20.0), (0.0, 0.0), None, ("y",)),
        (tetrahedron_punch(265.0, 160.0, 20.0, 90.0), (0.0, 0.0), None, ("x",)),
        (tetrahedron_punch(265.0, 160.0, 20.0, 20.0), (0.0, 0.0), None, ()),
        (box_punch(90.0, 60.0, 10.0), (0.0, 0.0), None, ("x", "y")),
        (ball(30.0), (0.0, 0.0), outline.rectangle(310, 280, (5.0, 0.0)), ("y",)),
        (ball(30.0), (0.0, 0.0), outline.polygon([(-170, -150), (170, -150), (0, 180)]), ("x",)),
        (
            ball(30.0),
            (0.0, 0.0),
            outline.with_holes(outline.rectangle(310, 310), [outline.disc(10.0, (0.0, 120.0))]),
            ("x",),
        ),
    ],
)
def test_a_mirror_plane_maps_outline_and_every_tool_onto_itself(punch, place, outlined, mirror):
    file = changed(travel=20.0)
    low = punch.distance(np.array([[0.0, 0.0, -500.0]]))[0][0] - 500.0  # of its lowest point, -z
    driven = replace(file.tools[0], geometry=punch, place=place, z=1.004 - low)
    blank = Region.of(outlined) if outlined else file.blank
    file = replace(file, tools=[driven, *ROUND_DIE], blank=blank)
    assert qf.forming(file, size=20).sheet.blank.mirror == mirror


@pytest.mark.parametrize(
    ("dx", "mirror", "words"),
    [
        (0.02, ("x", "y"), "tools are mirrored within 0.04 mm at the planes across the warp and"),
        (0.2, ("y",), "across the warp the punch differs by 0.4 mm (0.05 allowed)"),
    ],
)
def test_a_nearly_mirrored_tool_is_mirrored_or_named(dx, mirror, words):
    file = changed(travel=20.0)
    punch = replace(file.tools[0], place=(dx, 0.0))
    made = qf.forming(replace(file, tools=[punch, *file.tools[1:]]), size=30)
    assert made.sheet.blank.mirror == mirror
    assert words in words_of(made)


def test_a_sharp_tool_says_its_radius_the_size_that_resolves_it_and_the_cost():
    words = words_of(qf.forming("hemisphere", size=20))
    assert "smallest radius 10 mm, of the die: a size of at most 5 resolves it" in words
    assert "at about 28 times the time of an iteration" in words  # (2 · 20 / 10) ** 2.4
    assert "smallest radius" not in words_of(qf.forming("hemisphere", size=5))


def test_supports_and_grippers_ask_for_the_whole():
    for part in (
        {"supports": [Support(Where(side="+x"), "z")]},
        {"grippers": [Gripper(Where(side="+x"), (1.0, 0.0), 5.0)]},
    ):
        scene = qf.forming(changed(**part), size=30)
        assert scene.sheet.blank.mirror == ()
        assert "the whole blank: mirror planes are not sought with supports" in words_of(scene)


# Results in the user's axes


def test_a_blank_at_45_degrees_is_the_square_of_the_user():
    result = formed(orientation=45.0)
    assert result.model.sheet.turn == 45.0
    assert_allclose(np.abs(result.model.sheet.blank.warp), [1.0, 0.0], atol=1e-12)
    blank = result.blank
    assert_allclose(blank.nodes.min(0), -155.0)
    assert_allclose(blank.nodes.max(0), 155.0)
    assert blank.areas.sum() == pytest.approx(310.0**2)
    c = np.sqrt(0.5)
    assert_allclose(blank.warp, [c, c])
    assert_allclose(blank.weft, [-c, c])
    flat = result.positions(0)
    assert_allclose(flat[:, :2], blank.nodes, atol=1e-9)
    assert_allclose(
        [result.model.edges[side].flat for side in ("+x", "-x", "+y", "-y")],
        [[155, 0], [-155, 0], [0, 155], [0, -155]],
        atol=1e-9,
    )
    fields = result.sheet_at(0).cell_fields
    assert_allclose(fields["warp"], np.broadcast_to([c, c, 0.0], fields["warp"].shape), atol=1e-6)
    # the corners, along warp and weft, are drawn in; the middles of the sides are not
    corner = np.linalg.norm(blank.nodes, axis=1).argmax()
    moved = result.sheet.point_fields["displacement"][corner]
    assert -moved @ np.append(blank.nodes[corner], 0.0) / np.hypot(155, 155) > 0.5
    assert max(result.draw_in.values()) < 0.05


@pytest.mark.parametrize("orientation", [90.0, -45.0])
def test_tools_are_turned_into_the_axes_of_the_model(orientation):
    """The distance of a place of the user's is the same, seen from the model."""
    azimuth = 0.0 if orientation == 90.0 else 135.0  # an edge of the punch stays on a mirror plane
    place = rotation(azimuth) @ [20.0, 0.0]
    tip = tetrahedron_punch(150.0, 160.0, 20.0, azimuth)
    file = changed(tools={"punch": {"geometry": tip, "place": tuple(place)}})
    scene = qf.forming(file, orientation, size=30, travel=20.0)
    assert scene.sheet.turn == orientation
    assert len(scene.sheet.blank.mirror) == 1
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-120.0, 120.0, (500, 2)), rng.uniform(-30.0, 30.0, 500)])
    seen = points.copy()
    seen[:, :2] = points[:, :2] @ rotation(scene.sheet.turn)
    assert_allclose(scene.sheet.to_user(seen[:, :2]), points[:, :2], atol=1e-9)
    for part, contact in zip(file.tools, scene.contacts, strict=False):
        tool = contact.tool
        assert tool.name == part.name
        d = part.shape.distance(points - [*part.place, 0.0])[0]
        assert_allclose(tool.shape.distance(seen - [*tool.place, 0.0])[0], d, atol=1e-9)


def test_turning_everything_about_a_round_punch_changes_nothing_but_the_axes():
    file = turned_by(scene_file.load("hemisphere"), 30.0)
    straight, turned = formed(travel=3.0), solved(file, travel=3.0)
    assert turned.force == pytest.approx(straight.force, rel=1e-9)
    edges = edge_points(turned.blank, 30.0)  # on the blank's own axes
    draw_in = {name: edge.draw_in(turned.positions()) for name, edge in edges.items()}
    assert draw_in == pytest.approx(straight.draw_in, rel=1e-6)
    assert turned.areas == pytest.approx(straight.areas, rel=1e-6)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    assert_allclose(turned.positions(), straight.positions() @ turn_z(c, s), atol=1e-6)
    assert_allclose(turned.blank.nodes[:, 0].max(), 155 * (c + s))


def turn_z(c, s):
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def test_outline_is_closed_and_runs_around_the_sheet(tmp_path):
    result = formed(orientation=45.0)
    (loop,) = result.sheet.outline
    assert_array_equal(loop[0], loop[-1])
    assert len(np.unique(loop, axis=0)) == len(loop) - 1
    (flat,) = result.sheet_at(0).outline
    assert shapely.Polygon(flat[:, :2]).equals_exact(outline.rectangle(310, 310), 1e-6) or (
        shapely.Polygon(flat[:, :2]).symmetric_difference(outline.rectangle(310, 310)).area < 1e-6
    )
    assert shapely.LinearRing(loop[:, :2]).is_ccw
    folder = result.save(tmp_path / "out", pictures=False)
    with (folder / "outline.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["loop", "x_mm", "y_mm", "z_mm"]
    assert_allclose(np.array(rows, dtype=float)[:, 1:], loop, rtol=1e-5, atol=1e-5)


# Discs


def test_draw_in_of_a_disc_by_direction():
    disc = solved(changed(blank=Region("disc", (150.0,))), travel=5.0)
    assert disc.model.sheet.blank.mirror == ("x", "y")
    assert set(disc.draw_in) == {"+x", "-x", "+y", "-y"}
    for name, edge in disc.model.edges.items():
        axis, sign = "xy".index(name[1]), 1.0 if name[0] == "+" else -1.0
        place = np.zeros(2)
        place[axis] = 150.0 * sign
        assert_allclose(edge.flat, place, atol=0.1)
        assert_allclose(edge.inward, -place / 150.0, atol=1e-12)
    assert disc.draw_in["+x"] == disc.draw_in["-x"] > 0.05
    assert disc.draw_in["+y"] == disc.draw_in["-y"] > 0.05
    # fibres along x and y carry the edge with them there; between them shear lets it stay
    diagonal = np.linalg.norm(disc.blank.nodes - 150.0 * np.sqrt(0.5), axis=1).argmin()
    moved = disc.sheet.point_fields["displacement"][diagonal]
    assert np.linalg.norm(moved) < 0.5 * disc.draw_in["+x"]


def test_a_hole_keeps_its_outline_and_takes_a_mirror_plane_away():
    hole = outline.disc(12.0, (125.0, 0.0))
    file = changed(blank=Region.of(outline.with_holes(outline.disc(150.0), [hole])))
    result = solved(file, travel=2.0)
    assert result.model.sheet.blank.mirror == ("y",)
    outer, hole = result.sheet.outline
    assert_array_equal(hole[0], hole[-1])
    assert shapely.Polygon(hole[:, :2]).area == pytest.approx(np.pi * 12**2, rel=0.2)
    assert shapely.Polygon(outer[:, :2]).contains(shapely.Polygon(hole[:, :2]))
    assert result.draw_in["+x"] != pytest.approx(result.draw_in["-x"], rel=1e-6)
    assert result.draw_in["+y"] == pytest.approx(result.draw_in["-y"], rel=1e-6)


# Meshes and tools from files


def own_mesh(path, blank, **parts):
    """A scene on the mesh of a blank, written in metres."""
    points = np.pad(blank.nodes / 1000.0, ((0, 0), (0, 1)))
    meshio.write(path, meshio.Mesh(points, [("triangle", blank.triangles)]))
    return changed(mesh=path, mesh_scale=1000.0, blank=None, **parts)


def test_a_mesh_along_the_fibres_from_a_file_gives_the_same_answer(tmp_path):
    cut = solved("hemisphere", travel=1.0, size=30.0, symmetry="none")
    own = solved(own_mesh(tmp_path / "mesh.vtu", cut.model.sheet.blank), travel=1.0, size=None)
    assert own.model.sheet.blank.pairs is None
    assert own.force == pytest.approx(cut.force, rel=1e-9)
    assert own.draw_in == pytest.approx(cut.draw_in, rel=1e-6, abs=1e-12)
    assert qf.refine(own.model).estimate == {"shear_angle_deg": None, "force_N": None}
    with pytest.raises(qf.InputError, match="a mesh of its own"):
        own.model.recipe.build(60.0, like=own.model)


def test_meshes_that_do_not_follow_the_fibres_are_told(tmp_path):
    blank = qf.forming(size=30, symmetry="none").sheet.blank
    for file in (
        changed(mesh="free"),
        changed(mesh="free", orientation=30.0),
        own_mesh(tmp_path / "mesh.vtu", blank, orientation=30.0),
    ):
        scene = qf.forming(file, size=30)
        assert scene.sheet.blank.pairs is not None
        assert scene.sheet.blank.mirror == ()
        assert scene.share == 1.0
        assert scene.sheet.blank.areas.sum() == pytest.approx(310.0**2)
        assert "fibre strains shared by pairs of triangles" in words_of(scene)
        assert "a quarter" not in words_of(scene)
        c, s = rotation(scene.parameters["orientation"])[:, 0]
        assert_allclose(scene.sheet.to_user(scene.sheet.blank.warp), [c, s], atol=1e-12)


def test_a_punch_from_a_file_forms_as_the_one_in_closed_form(tmp_path, monkeypatch):
    """A ball of facets, on a coarse grid, beside the exact one."""
    steps = np.linspace(0.0, 2 * np.pi, 48, endpoint=False), np.linspace(0.0, np.pi, 25)[1:-1]
    around, down = (grid.ravel() for grid in np.meshgrid(*steps))
    corners = np.column_stack(
        [np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)]
    )
    corners = np.vstack([corners, [[0, 0, 1], [0, 0, -1]]])
    path = tmp_path / "ball.stl"
    meshio.write(path, meshio.Mesh(corners, [("triangle", outward(ConvexHull(corners)))]))
    file = SurfaceFile(path, scale=75.0, spacing=5.0)
    # the program does not know that the surface is a ball
    monkeypatch.setattr(contacts, "share", lambda tool, size: contacts.LENGTH)
    results = [
        solved(changed(tools={"punch": {"geometry": shape}}), travel=1.0, size=30.0)
        for shape in (file, scene_file.load("hemisphere").tools[0].shape)
    ]
    assert results[0].force == pytest.approx(results[1].force, rel=5e-3)
    assert p99(results[0]) == pytest.approx(p99(results[1]), rel=5e-3)


def outward(hull):
    """Triangles of a hull, turned so that their normals point outwards."""
    triangles = hull.simplices.copy()
    legs = hull.points[triangles[:, 1:]] - hull.points[triangles[:, :1]]
    inward = np.einsum("ij,ij->i", np.cross(legs[:, 0], legs[:, 1]), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward, ::-1]
    return triangles


# Tools that rest on the sheet


def test_the_holder_tilts_on_the_tetrahedron_and_stays_level_on_the_hemisphere():
    _, level = rigid(formed(symmetry="none"))
    _, tilted = rigid(tilting(symmetry="none"))
    assert np.abs(level).max() < 1e-14
    assert abs(tilted[1]) > 1e-8
    assert abs(tilted[0]) < 1e-12


def test_a_tilt_that_is_suppressed_is_told_as_a_moment():
    """About the axis, and with the sign, of the tilt that is left free elsewhere."""
    level = changed("tetrahedron", {"blank holder": {"tilt": False}})
    held = solved(level, travel=6.0, size=25.0)
    free = tilting()
    entry = held.resting_tools()["blank holder"]
    assert set(entry) == {"lift_mm", "held_moment_Nmm"}
    about_x, about_y = entry["held_moment_Nmm"]
    assert abs(about_y) > 1.0
    assert about_x == 0.0
    tilt = free.resting_tools()["blank holder"]["tilt_deg"]
    assert np.sign(about_y) == np.sign(tilt[1])
    assert set(free.resting_tools()["blank holder"]) == {"lift_mm", "tilt_deg"}


def test_weight_and_force_of_a_holder_add_up_in_every_part():
    file = changed(tools={"blank holder": {"mass": 5.0, "force": 30.0}})
    whole = 5.0e3 * GRAVITY + 30.0
    for symmetry, share in (("auto", 0.25), ("none", 1.0)):
        scene = qf.forming(file, size=30, symmetry=symmetry)
        (weight,) = (term for term in scene.terms if isinstance(term, ToolWeight))
        assert weight.force == pytest.approx(share * whole)
        assert scene.share == share
        assert weight.name == "weight of the blank holder"
    result = solved(file, travel=1.0, size=30.0)
    assert result.history["holder_force_N"] == pytest.approx(whole, rel=1e-3)


@pytest.mark.parametrize("symmetry", ["auto", "none"])
def test_the_force_on_a_holder_may_change_over_the_travel(symmetry):
    """Linear between its rows, constant beyond; its work is in the energy balance."""
    rows = [[0.0, 0.0], [10.0, 2000.0], [15.0, 500.0]]
    changes = {"tools.holder.force": rows, "increments.largest": 1.0, "increments.rows": 1.0}
    scene = qf.forming(size=38, travel=20.0, symmetry=symmetry, overrides=changes)
    result = qf.solve(scene, estimate=False)
    assert result.status == "completed"
    travel = result.history["travel_mm"]
    expected = 5.0e3 * GRAVITY + np.interp(travel, *np.transpose(rows))
    assert_allclose(result.history["holder_force_N"], expected, rtol=1e-3)
    assert result.energy_balance < 0.01
    assert result.snaps == []
    assert "2000 N at 10 mm" in words_of(scene)


def test_a_changing_force_is_carried_to_another_mesh():
    changes = {"tools.holder.force": [[0.0, 10.0], [4.0, 300.0]], "tools.holder.mass": 0.0}
    result = qf.solve(qf.forming(size=15, travel=4.0, overrides=changes))
    assert result.estimate["force_N"] is not None
    assert result.history["holder_force_N"] == pytest.approx([10.0, 300.0], rel=1e-3)


def test_the_sheet_starts_in_balance_with_the_holder():
    for scene in (qf.forming(size=20), qf.forming("tetrahedron", size=20)):
        g = np.zeros(len(scene.x0))
        for term in scene.terms:
            forces = term.gradient(scene.x0, term.initial(scene.x0))
            g += np.bincount(term.dofs.ravel(), forces.ravel(), len(g))
        free = np.where(scene.fixed, 0.0, g)
        assert np.abs(free[~scene.unknowns.at_nodes()]).max() < 0.02 * scene.resting
        assert np.abs(free).sum() < 0.5 * scene.resting


def test_a_holder_that_loses_the_sheet_ends_the_run():
    """A narrow sheet is drawn from under one side of a holder."""
    scene = qf.forming("tetrahedron", size=20)
    x = scene.x0.copy()
    assert scene.lost(x) == ""
    holder = next(c for c in scene.contacts if c.tool.motion == "free")
    x[holder.tool_dofs[0]] += 5.0
    assert scene.lost(x) == "the sheet no longer surrounds the weight of the blank holder"
    x[holder.tool_dofs[2]] = np.radians(10.1) * holder.lever
    assert scene.lost(x) == "the blank holder tilts by more than 10 degrees"


# Loads and supports


def test_without_friction_nothing_holds_the_sheet_but_its_middle():
    half, whole = (
        tilting(law=SLIPPERY, symmetry=symmetry, travel=3.0) for symmetry in ("auto", "none")
    )
    for result in (half, whole):
        assert "friction left out: its coefficient is zero" in words_of(result.model)
        assert "middle of the sheet fixed in the plane" in words_of(result.model)
        assert result.model.frictions == []
        assert result.certified.converged
    assert_same(half, whole)
    assert "middle of the sheet" not in words_of(qf.forming(law=SLIPPERY, size=30))
    assert 0 < whole.force < tilting().force


def test_friction_of_a_tool_stands_over_that_of_the_fabric():
    file = changed(tools={"die": {"friction": 0.0}, "punch": {"friction": 0.3}})
    scene = qf.forming(file, size=30)
    assert {f.contact.tool.name: f.contact.tool.friction for f in scene.frictions} == {
        "punch": 0.3,
        "blank holder": scene.sheet.fabric.friction,
    }


def test_gravity_acts_on_the_modelled_part():
    result = solved(changed(gravity=True), travel=3.0, size=15.5)
    (weight,) = (term for term in result.model.terms if isinstance(term, SheetWeight))
    total = 1e-6 * GRAVITY * 600.0 * 310.0**2
    assert weight.force.sum() == pytest.approx(0.25 * total)
    assert result.certified.converged
    assert "weight of the sheet left out" not in words_of(result.model)
    without = solved("hemisphere", travel=3.0, size=15.5)
    assert f"weight of the sheet left out: {total:.2g} N beside the 49" in words_of(without.model)
    # it helps the punch, by what lies over the opening at most
    assert 0 < without.force - result.force < np.pi * 90**2 / 310**2 * total
    middle = np.linalg.norm(result.blank.nodes, axis=1).argmin()
    assert result.states[-1].x[result.model.unknowns["load factor of the weight"].dofs] == 1.0
    assert result.positions()[middle, 2] == pytest.approx(without.positions()[middle, 2], abs=0.05)


HELD = {
    # a flat sheet between two smooth plates, with the punch beside it
    "punch": {"geometry": ball(5.0), "place": (0.0, 300.0)},
    "die": {"geometry": Plane(), "friction": 0.0},
    "blank holder": {"geometry": flipped(Plane()), "friction": 0.0, "force": 200.0, "mass": 0.0},
}


@cache
def pulled(tension, stiffness, orientation=0.0):
    file = changed(
        tools=HELD,
        blank=Region("rectangle", (160.0, 80.0)),
        supports=[Support(Where(side="-x"), "xy")],
        grippers=[Gripper(Where(side="+x"), (1.0, 0.0), tension, stiffness)],
    )
    fabric = qf.Fabric(compaction=100.0)  # stiff: the slope of the die's fillet carries nothing
    return solved(file, travel=2.0, size=10.0, orientation=orientation, law=fabric)


def reaction(result):
    """(3,) force of the supports at the left edge on the sheet, N."""
    scene = result.model
    x = result.states[-1].x
    g = np.zeros(len(x))
    for term, state in zip(scene.terms, result.memory, strict=True):
        g += np.bincount(term.dofs.ravel(), term.gradient(x, state).ravel(), len(g))
    left = np.isclose(scene.sheet.blank.nodes[:, 0], -80.0)
    return scene.sheet.positions(g)[left].sum(0)


@pytest.mark.parametrize("orientation", [0.0, 45.0])
def test_supports_hold_what_a_gripper_pulls(orientation):
    result = pulled(100.0, 0.0, orientation)
    assert result.status == "completed"
    assert_allclose(reaction(result)[:2], [-100.0, 0.0], atol=0.01)
    assert result.draw_in["-x"] == 0.0
    assert result.draw_in["+x"] < 0


def test_a_gripper_pulls_evenly_along_its_edge():
    """The same fibre strain everywhere, S11 = T/(w t0) with a small strain."""
    result = pulled(100.0, 0.0)
    scene = result.model
    stress = scene.membrane.stress(result.states[-1].x)
    expected = 100.0 / (80.0 * scene.sheet.fabric.thickness)
    assert_allclose(scene.sheet.blank.areas @ stress[:, 0, 0] / 12800.0, expected, rtol=2e-3)
    assert_allclose(stress[:, 0, 0], expected, rtol=2e-3)
    assert_allclose(stress[:, 1, 1], 0.0, atol=2e-3 * expected)


def test_a_gripper_with_a_stiffness_yields():
    """T - K u is what the supports hold."""
    result = pulled(100.0, 1000.0)
    (grip,) = (term for term in result.model.terms if isinstance(term, Grip))
    x = result.states[-1].x
    u = (grip.tension / 100.0) @ (x[grip.dofs[:, 0]] - result.model.x0[grip.dofs[:, 0]])
    assert 0 < u < -pulled(100.0, 0.0).draw_in["+x"] * 1.5
    assert_allclose(reaction(result)[0], -(100.0 - 1000.0 * u), atol=0.01)


def test_a_pull_needs_no_holder():
    """The sheet is held in the plane z = 0 by supports and nothing rests on it."""
    punch, die, _ = scene_file.load("hemisphere").tools
    tools = [
        replace(punch, geometry=Form("ball", (5.0,)), place=(0.0, 300.0)),
        replace(die, geometry=Form("plane"), friction=0.0, z=-50.0),
    ]
    file = replace(
        changed(blank=Region("rectangle", (160.0, 80.0))),
        tools=tools,
        supports=[
            Support(Where(side="-x"), "xyz"),
            Support(Where(box=(-80.0, -40.0, 80.0, 40.0)), "z"),
        ],
        grippers=[Gripper(Where(side="+x"), (1.0, 0.0), 100.0)],
    )
    result = solved(file, travel=1.0, size=10.0)
    assert result.status == "completed"
    assert_allclose(reaction(result)[:2], [-100.0, 0.0], atol=0.01)


def test_gravity_needs_no_holder():
    """A sheet clamped at two edges over the die; its weight alone acts before the punch does."""
    file = changed(
        gravity=True, supports=[Support(Where(side=side), "xyz", True) for side in ("-x", "+x")]
    )
    file = replace(file, tools=file.tools[:2])
    scene = qf.forming(file, size=30, travel=1.0)
    total = 1e-6 * GRAVITY * 600.0 * 310.0**2
    assert scene.resting == pytest.approx(total, rel=1e-6)
    result = qf.solve(scene, estimate=False)
    assert result.status == "completed"


def test_a_clamp_keeps_the_direction_of_the_fibres_and_a_hinge_does_not():
    where = Where(side="-x")
    for clamp in (True, False):
        scene = qf.forming(changed(supports=[Support(where, "xyz", clamp)]), size=20)
        (bending,) = (term for term in scene.terms if isinstance(term, Bending))
        left = np.flatnonzero(np.isclose(scene.sheet.blank.nodes[:, 0], -155.0))
        fixed = scene.sheet.field.of(scene.fixed)
        assert fixed[left].all()
        assert not np.delete(fixed, left, axis=0).any()
        stencils = np.isin(bending.dofs[:, 0] // 3, left)
        assert bending.constant[stencils].any() == clamp
        assert not bending.constant[~stencils].any()


def test_supports_fix_the_directions_that_they_name():
    supports = [
        Support(Where(box=(90.0, -160.0, 160.0, 160.0)), "z"),
        Support(Where(centre=(0.0, 0.0), radius=30.0), "xy"),
    ]
    scene = qf.forming(changed(supports=supports), size=20)
    fixed = scene.sheet.field.of(scene.fixed)
    inside = np.linalg.norm(scene.sheet.blank.nodes, axis=1) <= 30.0
    assert_array_equal(fixed[:, 0], inside)
    assert_array_equal(fixed[:, 1], inside)
    assert_array_equal(fixed[:, 2], scene.sheet.blank.nodes[:, 0] >= 90.0 - 1e-6)


@pytest.mark.parametrize(("fix", "more"), [("z", 3), ("x", 1), ("y", 1), ("xy", 0)])
def test_without_friction_supports_leave_the_middle_what_they_do_not_hold(fix, more):
    support = Support(Where(box=(90.0, -160.0, 160.0, 160.0)), fix)
    scene = qf.forming(changed(supports=[support]), size=20, law=SLIPPERY)
    fixed = scene.sheet.field.of(scene.fixed)
    held = scene.sheet.blank.nodes[:, 0] >= 90.0 - 1e-6
    assert all(fixed[held, "xyz".index(axis)].all() for axis in fix)
    assert fixed[~held].sum() == more
    assert ("middle of the sheet fixed in the plane" in words_of(scene)) == bool(more)


# What a result tells beside the numbers


def test_doubts_are_told_by_reason():
    result = formed()
    reasons = ["beyond_identified_range", "bands_may_form", "collapsed", "rovings_may_slip"]
    reasons += ["fibres_may_buckle", "narrow_bands"]
    doubts = result.sheet.doubts()
    assert list(doubts) == reasons
    assert all(
        flag.dtype == bool and len(flag) == len(result.shear_angle) for flag in doubts.values()
    )
    summary = result.summary()
    assert list(summary["doubtful_share"]) == reasons
    assert summary["doubtful_share"]["collapsed"] == 0.0
    # with a law known up to half a degree only, most of the sheet is doubtful
    sheet = result.model.sheet
    sheet = replace(sheet, fabric=replace(sheet.fabric, shear_range=0.5))
    narrow = replace(result.model, sheets=[sheet])
    beyond = replace(result, model=narrow).sheet.doubts()["beyond_identified_range"]
    assert_array_equal(beyond, np.abs(result.shear_angle) > 0.5)
    assert beyond.any()


def test_doubts_add_up_in_one_field(monkeypatch):
    """1, 2, 4, ... 32 in their order; a node is moved past its neighbours to have most of them.

    Waves and bands need more room than that: these three are put there by hand.
    """
    result = formed()
    marked = np.arange(len(result.shear_angle)) % np.array([[2], [3], [5]]) == 0
    local = dict(zip(("bands_may_form", "fibres_may_buckle"), marked[:2], strict=True))
    monkeypatch.setattr(measures, "local_waves", lambda *_: (local, {}))
    monkeypatch.setattr(measures, "narrow_bands", lambda *_: marked[2])
    x = result.states[0].x.copy()
    moved = np.linalg.norm(result.model.sheet.blank.nodes - 60.0, axis=1).argmin()
    x[3 * moved : 3 * moved + 2] += 20.0
    folded = replace(result, states=[*result.states[:-1], replace(result.states[-1], x=x)])
    doubts = folded.sheet.doubts()
    assert all(flag.any() and not flag.all() for flag in doubts.values())
    for name, marks in (*local.items(), ("narrow_bands", marked[2])):
        assert_array_equal(doubts[name], marks)
    field = folded.sheet.cell_fields["doubt"]
    for value, flag in zip((1, 2, 4, 8, 16, 32), doubts.values(), strict=True):
        assert_array_equal(field.astype(int) & value > 0, flag)


def test_wrinkles_of_a_sheet_that_lies_flat_under_its_holder():
    """Between die and holder there is no room: it lifts off where the fillets begin only."""
    for result in (formed(), tilting()):
        wrinkles = result.wrinkles
        waves = {f"waving_{f}_lines" for f in ("warp", "weft")}
        waves |= {f"{f}_wavelength_mm" for f in ("warp", "weft")}
        assert set(wrinkles) == {"flange_lift_mm", "largest_curvature_1_per_mm"} | waves
        assert 0.0 <= wrinkles["flange_lift_mm"] < 0.5 * result.model.sheet.fabric.thickness
        assert 1e-3 < wrinkles["largest_curvature_1_per_mm"] < 0.1


def test_wrinkles_see_a_flange_that_stands_up():
    result = formed()
    x = result.states[-1].x.copy()
    nodes = result.model.sheet.blank.nodes
    outer = np.linalg.norm(nodes, axis=1) > 140.0
    x[result.model.sheet.dofs[outer, 2]] += 3.0
    lifted = replace(result, states=[*result.states[:-1], replace(result.states[-1], x=x)])
    assert lifted.wrinkles["flange_lift_mm"] == pytest.approx(3.0, abs=0.05)


def test_summary_of_a_forming_run():
    result = tilting()
    summary = result.summary()
    assert summary["case"] == "tetrahedron-0"
    assert summary["parameters"]["scene"] == "tetrahedron"
    assert summary["parameters"]["standings"]["tools.punch.height"] == "assumed"
    assert summary["resting_tools"]["blank holder"]["tilt_deg"][1] != 0.0
    assert summary["wrinkles"] == result.wrinkles
    assert summary["model"] == words_of(result.model).splitlines()
    assert result.history["holder_force_N"] == pytest.approx(49.05, rel=1e-3)


def test_a_scene_given_as_an_object_is_called_by_its_name():
    scene = qf.forming(changed(name="mine"), size=30)
    assert scene.name == "mine-0"
    assert scene.parameters["scene"] == "mine"


# What the file says stands where the call says nothing


def test_what_the_call_leaves_out_is_taken_from_the_file():
    file = changed(
        orientation=90.0,
        size=25.0,
        law="best-fit",
        symmetry="none",
        travel=30.0,
        increment=2.0,
        rows=3.0,
        outputs={"pictures": False, "increments": False},
    )
    scene = qf.forming(file)
    assert scene.parameters["orientation"] == 90.0
    assert scene.parameters["size"] == 25.0
    assert scene.sheet.fabric.name == "MD600 best-fit"
    assert scene.parameters["symmetry"] == "none"
    assert (scene.travel, scene.increment, scene.rows) == (30.0, 2.0, 3.0)
    assert scene.outputs == {"pictures": False, "increments": False}
    given = qf.forming(file, 0.0, "locking", 30.0, 10.0, "auto")
    assert given.parameters["orientation"] == 0.0
    assert given.parameters["size"] == 30.0
    assert given.sheet.fabric.name == "MD600 locking"
    assert given.sheet.blank.mirror == ("x", "y")
    assert given.travel == 10.0


def test_the_coarser_scene_is_the_same_at_twice_the_size():
    file = changed("tetrahedron", orientation=90.0)
    scene = qf.forming(file, size=15.0, travel=10.0, law="best-fit", symmetry="none")
    coarse = scene.recipe.build(2 * scene.size, like=scene)
    for key in ("orientation", "law", "travel", "symmetry"):
        assert coarse.parameters[key] == scene.parameters[key]
    assert coarse.parameters["size"] == 30.0


def test_the_error_is_estimated_also_where_the_coarser_mesh_needs_contact_between_nodes():
    """The tetrahedron's edges of 20 mm are sharper than its elements at twice the size only."""
    result = qf.solve(qf.forming("tetrahedron", size=15.0, travel=1.0), increment=1.0)
    assert result.status == "completed"
    assert result.estimate["shear_angle_deg"] is not None
    assert result.estimate["force_N"] is not None


# What is refused


def box_file(**tools):
    return changed("box", tools)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: qf.forming("hemispere"), "unknown scene 'hemispere': did you mean 'hemisphere'?"),
        (lambda: qf.forming(travel=75.1), "travel must not exceed 75 mm in this scene, got 75.1"),
        (lambda: qf.forming("box", travel=51), "travel must not exceed 50 mm"),
        (lambda: qf.forming(travel=-1.0), "travel must be a positive number, got -1.0"),
        (lambda: qf.forming(travel="far"), "travel must be a positive number, got 'far'"),
        (
            lambda: qf.forming(size=39.0),
            "size must not exceed an eighth of the blank, 38.75, got 39",
        ),
        (lambda: qf.forming(size=0.0), "size must be a positive number, got 0.0"),
        (lambda: qf.forming(size=0.1), "triangles"),
        (
            lambda: qf.forming(orientation=np.nan),
            "orientation must be a number of degrees, got nan",
        ),
        (lambda: qf.forming(orientation="0"), "orientation must be a number of degrees, got '0'"),
        (
            lambda: qf.forming(symmetry="all"),
            "symmetry must be 'auto', 'half' or 'none', got 'all'",
        ),
        (lambda: qf.forming(law="lockin"), "unknown law 'lockin': did you mean 'locking'?"),
        (lambda: qf.forming(law=replace(SLIPPERY, bending_weft=0.0)), "needs a bending stiffness"),
        (
            lambda: qf.forming(changed(blank=Region("rectangle", (100, 100))), size=10),
            "the blank does not reach under the blank holder",
        ),
        (
            lambda: qf.forming(changed(blank=Region("rectangle", (400, 60), (0, 130))), size=7),
            "the blank does not surround the weight of the blank holder",
        ),
        (
            lambda: qf.forming(
                changed(supports=[Support(Where(box=(500, 0, 600, 9)), "z")]), size=30
            ),
            r"\[supports 1\] no node of the blank lies there",
        ),
        (
            lambda: qf.forming(
                changed(grippers=[Gripper(Where(centre=(500, 0), radius=9.0), (1, 0), 5.0)]),
                size=30,
            ),
            r"\[grippers 1\] no node of the blank lies there",
        ),
    ],
)
def test_impossible_scenes_are_refused(make, message):
    with pytest.raises(qf.InputError, match=message):
        make()


SQUARE = np.array([[-55.0, -55.0], [55.0, -55.0], [55.0, 55.0], [-55.0, 55.0]])


@pytest.mark.parametrize(("side", "fits"), [(107.9, True), (108.1, False), (112.0, False)])
def test_a_punch_must_leave_room_for_the_sheet_in_the_opening(side, fits):
    """110 mm - 2 x 1.004 mm is left for the punch."""
    die = opening(SQUARE, 10.0, 10.0)
    tools = {
        "punch": {"geometry": box_punch(100.0, side, 10.0)},
        "die": {"geometry": die},
        "blank holder": {"geometry": flipped(die)},
    }
    file = changed("box", tools)
    if fits:
        assert qf.forming(file, size=30).travel == 50.0
        return
    left = rf"punch and die leave {max(55 - side / 2, 0):.2f} mm for a sheet of 1.004 mm"
    with pytest.raises(qf.InputError, match=left):
        qf.forming(file, size=30)


def test_a_punch_that_does_not_reach_what_is_too_narrow_is_accepted():
    narrow = changed(tools={"die": {"geometry": round_opening(60.0, 10.0)}})
    assert qf.forming(narrow, size=30, travel=15.0).travel == 15.0
    with pytest.raises(qf.InputError, match=r"punch and die leave 0\.00 mm"):
        qf.forming(narrow, size=30)


def test_a_holder_must_leave_the_punch_through():
    holder = changed("box", {"blank holder": {"geometry": flipped(Plane())}})
    with pytest.raises(qf.InputError, match="punch and blank holder leave"):
        qf.forming(holder, size=30)


def test_a_blank_that_starts_inside_a_tool_is_refused():
    with pytest.raises(qf.InputError, match="starts inside the punch: check its z"):
        qf.forming(changed(tools={"punch": {"z": -5.0}}), size=30)


def test_tools_stand_where_the_file_says_or_at_touch():
    scene = qf.forming(size=30)
    heights = {c.tool.name: c.tool.height for c in scene.contacts}
    assert heights == {"punch": 1.004, "die": 0.0, "blank holder": 1.004}
    moved = qf.forming(changed(tools={"punch": {"z": 7.5}, "die": {"z": -3.0}}), size=30)
    heights = {c.tool.name: c.tool.height for c in moved.contacts}
    assert heights == {"punch": 7.5, "die": -3.0, "blank holder": 1.004}


def test_contact_between_nodes_is_asked_for_by_tools_sharper_than_the_mesh():
    def between(**given):
        scene = qf.forming(**given)
        return {c.tool.name for c in scene.contacts if c.points.sag.any()}, words_of(scene)

    names, words = between(size=30)
    assert names == {"die", "blank holder"}  # fillets of 10 mm; the punch has 75 mm
    assert "contact at nodes and mid-edges: a tool bends more sharply than the elements" in words
    names, words = between(size=9)
    assert names == set()
    assert "contact at nodes: no tool bends more sharply than the elements" in words
    assert between(scene="tetrahedron", size=30)[0] == {"punch", "die", "blank holder"}


def test_scene_files_are_values():
    assert isinstance(changed(), SceneFile)
    before = scene_file.load("hemisphere")
    qf.forming(before, size=30)
    assert before.standings == scene_file.load("hemisphere").standings
