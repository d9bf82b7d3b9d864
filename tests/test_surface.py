"""Tools from surface files: readers, checks, and a distance with its own derivatives."""

import pickle
import re
import signal
import sys
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

from quasiform.checks import InputError
from quasiform.scenes.forming import forming
from quasiform.scenes.room import smallest_radius
from quasiform.tools.grid import check_surface, from_file, surface_grid
from quasiform.tools.mending import oriented, rims_of, without_slivers
from quasiform.tools.surface_file import SurfaceFile, read_surface

pytest.importorskip("igl")

R = 20.0
BOX = np.array([-30.0] * 3), np.array([30.0] * 3)
H_STEP = 1e-5


def ball(n=60, radius=R):
    """Vertices and triangles of a sphere between n parallels and 2n meridians, facing outwards."""
    theta, phi = np.linspace(0, np.pi, n + 1)[1:-1, None], np.arange(2 * n) * np.pi / n
    ring = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1
    )
    vertices = radius * np.vstack([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    i, j = np.arange(2 * n), np.roll(np.arange(2 * n), -1)
    triangles = [np.stack([i, j, 0 * i + len(vertices) - 2], 1)]
    for row in range(n - 2):
        a, b = row * 2 * n + i, row * 2 * n + j
        triangles += [np.stack([a, a + 2 * n, b], 1), np.stack([b, a + 2 * n, b + 2 * n], 1)]
    last = (n - 2) * 2 * n
    triangles.append(np.stack([last + i, 0 * i + len(vertices) - 1, last + j], 1))
    return vertices, np.vstack(triangles)


def block(low=(-20, -20, -20), high=(20, 20, 20)):
    """A closed box of twelve triangles."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    vertices = np.array(low) + vertices * np.subtract(high, low)
    return vertices, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def plate(n=8, half=20.0):
    """An open square at z = 0, facing up."""
    x = np.linspace(-half, half, n + 1)
    vertices = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((n + 1, n + 1))], -1)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a = i * (n + 1) + j
    b, c, d = a + n + 1, a + n + 2, a + 1
    return vertices.reshape(-1, 3), np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


@pytest.fixture(scope="module")
def ball_grid():
    return surface_grid(*ball(), *BOX, 2.0)


@pytest.fixture(scope="module")
def plate_grid():
    return surface_grid(*plate(), *BOX, 2.0)


def differences(function, points):
    steps = H_STEP * np.eye(3)
    return np.stack([function(points + s) - function(points - s) for s in steps], -1) / (2 * H_STEP)


# ------------------------------------------------------------------------------------ distance


@pytest.mark.parametrize("name", ["ball_grid", "plate_grid"])
def test_normal_and_curvature_are_the_derivatives_of_the_distance(name, request):
    grid = request.getfixturevalue(name)
    points = np.random.default_rng(1).uniform(-60.0, 60.0, (4000, 3))
    kink = np.minimum(np.abs(points - grid.low), np.abs(points - grid.high)).min(1)
    points = points[kink > 1e-3]
    assert 100 < ((points > grid.low) & (points < grid.high)).all(1).sum() < 3900
    d, n, H = grid.distance(points)
    assert d.shape == (len(points),)
    assert_allclose(differences(lambda x: grid.distance(x)[0], points), n, atol=1e-8)
    assert_allclose(differences(lambda x: grid.distance(x)[1], points), H, atol=2e-5)
    assert np.abs(H).max() > 0.01
    assert np.linalg.norm(n, axis=1).max() < grid.steepest
    assert (H == H.transpose(0, 2, 1)).all()


def test_ball_is_that_of_the_closed_form(ball_grid):
    m = np.random.default_rng(2).normal(size=(4000, 3))
    m /= np.linalg.norm(m, axis=1)[:, None]
    above = np.linspace(-2.0, 2.0, len(m))
    d, n, H = ball_grid.distance((R + above)[:, None] * m)
    chord = R * (1 - np.cos(np.pi / 60) * np.cos(np.pi / 120))
    assert_allclose(d, above, atol=1.5 * chord)
    assert_allclose(n, m, atol=0.025)
    exact = (np.eye(3) - m[:, :, None] * m[:, None, :]) / (R + above)[:, None, None]
    assert np.abs(H - exact).max() < 0.5 / R
    assert np.abs(H - exact).mean() < 0.1 / R
    vertices, triangles = ball()
    assert np.abs(ball_grid.distance(vertices[triangles].mean(1))[0]).max() < chord


def test_faces_of_a_box_are_flat_and_its_edges_are_rounded():
    grid = surface_grid(*block(), [-30, -30, -25], [30, 30, 30], 2.0)
    x, y, z = np.meshgrid(np.linspace(-8, 8, 7), np.linspace(-7, 8, 6), np.linspace(19, 23, 9))
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    d, n, H = grid.distance(points)
    assert_allclose(d, points[:, 2] - 20, atol=2e-3)
    assert_allclose(n, np.broadcast_to([0, 0, 1], n.shape), atol=2e-3)
    assert_allclose(H, 0, atol=2e-3)
    edge = np.stack([np.linspace(-10, 10, 50), 0 * x.ravel()[:50] + 20, 0 * x.ravel()[:50] + 20], 1)
    d, n, _ = grid.distance(edge)
    assert np.abs(d).max() < 0.3 * grid.spacing
    assert_allclose(n[:, 1], n[:, 2], atol=0.2)


def test_error_falls_with_the_spacing():
    surface = ball(80)
    m = np.random.default_rng(3).normal(size=(2000, 3))
    m /= np.linalg.norm(m, axis=1)[:, None]
    mean = []
    for spacing in (8.0, 4.0):
        n = surface_grid(*surface, *BOX, spacing).distance(R * m)[1]
        mean.append(np.linalg.norm(n - m, axis=1).mean())
    assert mean[1] < mean[0] / 4


def test_distance_goes_on_outside_the_box_and_stays_clear(ball_grid):
    m = np.random.default_rng(4).normal(size=(500, 3))
    m /= np.linalg.norm(m, axis=1)[:, None]
    far = 200.0 * m
    d, n, _ = ball_grid.distance(far)
    assert (d > 100.0).all()
    assert (np.einsum("pi,pi->p", n, m) > 0.8).all()
    for side in (ball_grid.low, ball_grid.high):
        for axis in range(3):
            at = np.zeros((2, 3))
            at[:, axis] = side[axis] + np.array([-1e-9, 1e-9])
            d, _, _ = ball_grid.distance(at)
            assert_allclose(d[0], d[1], atol=1e-8)


def test_grid_covers_the_tool_or_the_box_whichever_is_smaller():
    high = np.array([500.0, 500.0, 0.0])
    grid = surface_grid(*ball(), [-500.0] * 3, high, 3.0, reach=300.0)
    assert_allclose(grid.box, [[-R - 15] * 3, [R + 15, R + 15, 0.0]], atol=0.1)
    across = np.array([[R - 1, 0, 0], [R, 0, 0], [0, R + 1, 0]])  # where the box cuts the tool
    assert_allclose(grid.distance(across)[0], [-1, 0, 1], atol=0.01)


def test_distance_leaves_the_points_alone_and_takes_none(ball_grid):
    points = np.random.default_rng(5).uniform(-60.0, 60.0, (100, 3))
    before = points.copy()
    first, second = ball_grid.distance(points), ball_grid.distance(points)
    assert (points == before).all()
    for a, b in zip(first, second, strict=True):
        assert (a == b).all()
    assert [a.shape for a in ball_grid.distance(np.empty((0, 3)))] == [(0,), (0, 3), (0, 3, 3)]


def test_grid_is_the_same_again_and_after_pickling(ball_grid):
    again = surface_grid(*ball(), *BOX, 2.0)
    copy = pickle.loads(pickle.dumps(ball_grid))
    points = np.random.default_rng(6).uniform(-40.0, 40.0, (100, 3))
    for other in (again, copy):
        assert (other.coefficients == ball_grid.coefficients).all()
        for a, b in zip(other.distance(points), ball_grid.distance(points), strict=True):
            assert (a == b).all()


# -------------------------------------------------------------------------------- open surfaces


def test_open_plate_has_a_body_below_that_ends_at_its_rim(plate_grid):
    at = [[1, 2, 3], [1, 2, -3], [1, 2, -6], [26, 1, 1], [26, 1, -8], [24, 24, 0], [17, 0, -9]]
    expected = [3, -3, -6, np.hypot(6, 1), 6, 4 * np.sqrt(2), -3]
    d, n, _ = plate_grid.distance(np.array(at, dtype=float))
    assert_allclose(d, expected, atol=0.05)
    assert_allclose(n[:3], [[0, 0, 1]] * 3, atol=0.02)
    assert_allclose(n[4], [1, 0, 0], atol=0.02)  # beside the wall below the rim


def test_flip_turns_an_open_surface_round(tmp_path):
    vertices, triangles = plate()
    meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "plate.stl", binary=True)
    point = np.array([[1.0, 2.0, 3.0]])
    for flip, sign in ((False, 1), (True, -1)):
        grid = from_file(tmp_path / "plate.stl", *BOX, flip=flip)
        assert_allclose(grid.distance(point)[0], 3.0 * sign, atol=1e-3)
        assert grid.spacing == 2.0


def test_holes_count_only_where_the_sheet_can_be():
    holed = without(plate(4), [5, 21])  # a square of 10 mm
    check_surface(*holed, [1, -30, -5], [30, 30, 5])
    with pytest.raises(InputError, match=r"^a hole of 4 edges, 10 mm across, around \(-5, -5, 0\)"):
        check_surface(*holed, [-30, -30, -5], [30, 30, 5])


def test_one_open_end_is_no_hole():
    vertices, triangles = block()
    cap = triangles[(vertices[triangles][:, :, 2] > -20).any(1)]
    check_surface(vertices, cap)
    d, _, _ = surface_grid(vertices, cap, [-30, -30, -10], [30, 30, 30], 2.0).distance(
        np.array([[0, 0, 24.0], [0, 0, 17.0], [24, 0, 0], [18, 0, 0]])
    )
    assert_allclose(d, [4, -3, 4, -2], atol=0.01)


# --------------------------------------------------------------------------------------- checks


def turned(surface, rows):
    vertices, triangles = surface
    triangles = triangles.copy()
    triangles[rows] = triangles[rows][:, ::-1]
    return vertices, triangles


def without(surface, rows):
    return surface[0], np.delete(surface[1], rows, axis=0)


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ((np.zeros((3, 3)), np.empty((0, 3), int)), "^no triangles$"),
        ((np.eye(3), np.array([[0, 1, 3]])), "a triangle refers to a vertex that is not there"),
        (
            (np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), np.array([[0, 1, 2]])),
            "1 vertices are not finite numbers",
        ),
        (
            turned(ball(8), slice(40, 41)),
            r"3 edges between triangles with opposite normals, one at",
        ),
        (
            (plate()[0], np.vstack([plate()[1], plate()[1][:1]])),
            r"^2 edges shared by more than two triangles, one at \(.*\) mm",
        ),
        (turned(ball(8), slice(None)), "the normals point inwards: set flip = true"),
        (without(ball(8), [100]), r"a hole of 3 edges, .* mm across, around \(.* mm: close it"),
    ],
)
def test_defects_are_named(surface, message):
    with pytest.raises(InputError, match=message) as refusal:
        check_surface(*surface)
    assert "\n" not in str(refusal.value)


def test_message_on_inverted_normals_knows_of_flip():
    with pytest.raises(InputError, match="set flip = false"):
        check_surface(*turned(ball(8), slice(None)), flip=True)


@pytest.mark.parametrize(
    ("size", "scale", "message"),
    [
        (
            150e-3,
            1.0,
            r"0.15 mm across \(scale = 1\) .* 310 mm: is the file in metres. set scale =",
        ),
        (150e-3, 1.0, r"set scale = 1000 \(150 mm\)$"),
        (150e-3, 0.001, r"is the file in mm. set scale = 1 \(150 mm\)"),
        (150e3, 1.0, r"1.5e[+]05 mm .* 310 mm: is the file in micrometres. set scale = 0.001 "),
        (150e6, 1e6, r"is the file in mm. set scale = 1 \(150 mm\)$"),
        (70e3, 1e6, r"is the file in metres. set scale = 1000 \(70 mm\)$"),  # not in micrometres
        (70 / 25.4, 1.0, r"is the file in inches. set scale = 25.4 \(70 mm\), or in centimetres"),
        (1e-7, 1.0, "check scale, the mm per unit of the file$"),
    ],
)
def test_wrong_units_are_noticed(size, scale, message):
    with pytest.raises(InputError, match=message):
        check_surface(*ball(8, size / 2), reach=310.0, scale=scale)
    check_surface(*ball(8, 75.0), reach=310.0)


@pytest.mark.parametrize(
    ("surface", "low", "spacing", "message"),
    [
        (
            ball(8),
            (100, 100, 100),
            2.0,
            r"nowhere near the sheet, it spans \(-20, -20, -20\) mm to",
        ),
        (ball(8), (-30, -30, -30), 0.01, "grid of .* nodes: set spacing = 0.09. or more"),
        (ball(8), (-30, -30, -30), -1.0, "spacing must be a positive number, got -1"),
        (block(low=(-20, -20, 19.2)), (-30, -30, -30), 2.0, "that a grid of 2 mm cannot show"),
    ],
)
def test_grid_that_cannot_be_is_refused(surface, low, spacing, message):
    with pytest.raises(InputError, match=message):
        surface_grid(*surface, np.array(low), np.add(low, 60), spacing)


def test_missing_libigl_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "igl", None)
    with pytest.raises(InputError, match=r"needs libigl: pip install 'quasiform\[surface\]'"):
        surface_grid(*ball(8), *BOX, 4.0)


# -------------------------------------------------------------------------------------- readers


def volume(vertices, triangles):
    return np.linalg.det(vertices[triangles]).sum() / 6


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("tool.stl", {"binary": False}),
        ("tool.stl", {"binary": True}),
        ("tool.off", {}),
        ("tool.STL", {"binary": True, "file_format": "stl"}),
        ("tool.obj", {}),
        ("tool.ply", {"binary": False}),
        ("tool.ply", {"binary": True}),
        ("tool.vtu", {}),
        ("tool.vtk", {"binary": True}),
        ("tool.msh", {"file_format": "gmsh22", "binary": False}),
        ("tool.msh", {"file_format": "gmsh", "binary": True}),
    ],
)
def test_every_mesh_format_is_read(tmp_path, capfd, name, options):
    vertices, triangles = block()
    meshio.Mesh(vertices, [("triangle", triangles.astype(np.int32))]).write(
        tmp_path / name, **options
    )
    capfd.readouterr()
    before = sorted(tmp_path.iterdir())
    vertices, triangles = read_surface(tmp_path / name, scale=0.5)
    assert vertices.shape == (8, 3)
    assert triangles.shape == (12, 3)
    assert_allclose(volume(vertices, triangles), 20.0**3, rtol=1e-6)
    assert sorted(tmp_path.iterdir()) == before
    assert capfd.readouterr() == ("", "")


def test_what_meshio_tells_is_not_passed_on(tmp_path, capfd, monkeypatch):
    def talkative(_):
        print("reading")
        warnings.warn("reading", stacklevel=1)
        return meshio.Mesh(block()[0], [("triangle", block()[1])])

    monkeypatch.setattr(meshio.vtu, "read", talkative)
    (tmp_path / "tool.vtu").touch()
    assert len(read_surface(tmp_path / "tool.vtu")[1]) == 12
    assert capfd.readouterr() == ("", "")


def test_quadrilaterals_are_split_and_other_cells_ignored(tmp_path):
    points = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [3, 0, 0], [0, 0, 9]]
    cells = [("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 4, 2]]), ("line", [[0, 5]])]
    meshio.Mesh(np.array(points, float), cells).write(tmp_path / "tool.vtu")
    vertices, triangles = read_surface(tmp_path / "tool.vtu")
    assert vertices.shape == (5, 3)  # the line's end is gone
    assert triangles.shape == (3, 3)
    normals = np.cross(*np.diff(vertices[triangles], axis=1).transpose(1, 0, 2))
    assert_allclose(normals.sum(0), [0, 0, 5])
    check_surface(vertices, triangles)


HEXAGON = [(2.0, 0, 0), (1, 2, 0), (-1, 2, 0), (-2, 0, 0), (-1, -2, 0), (1, -2, 0)]


@pytest.mark.parametrize("name", ["tool.ply", "tool.vtu", "tool.vtk"])
def test_polygons_are_split(tmp_path, name):
    cells = [("polygon", [[0, 1, 2, 3, 4, 5]]), ("triangle", [[0, 5, 6]])]
    points = np.array([*HEXAGON, (2.0, -2.0, 0.0)])
    meshio.Mesh(points, cells).write(tmp_path / name)
    vertices, triangles = read_surface(tmp_path / name)
    assert (len(vertices), len(triangles)) == (7, 5)
    normals = np.cross(*np.diff(vertices[triangles], axis=1).transpose(1, 0, 2))
    assert_allclose(normals.sum(0) / 2, [0, 0, 13], atol=1e-6)


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3 4 5 6",
        "f 1/1 2/1 3/1 4/1 5/1 6/1 # a comment",
        "f 1//1 2//1 3//1 \\\n4//1 5//1 6//1",
        "f -6 -5 -4 -3 -2 -1\nv 9 9 9",
        "f 1/1/1 2/1/1 3/1/1 4/1/1\nf 1 4 5 6",
    ],
)
def test_dialects_of_obj(tmp_path, faces):
    points = "".join(f"v {x} {y} {z} 1.0\n" for x, y, z in HEXAGON)
    text = f"# für Blech\nmtllib none.mtl\n{points}vt 0 0\nvn 0 0 1\n{faces}\n"
    (tmp_path / "tool.obj").write_text(text, encoding="latin-1")
    vertices, triangles = read_surface(tmp_path / "tool.obj")
    assert (len(vertices), len(triangles)) == (6, 4)
    normals = np.cross(*np.diff(vertices[triangles], axis=1).transpose(1, 0, 2))
    assert_allclose(normals.sum(0) / 2, [0, 0, 12])


def test_binary_stl_without_its_count_or_with_more_behind_it(tmp_path):
    vertices, triangles = block()
    meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "tool.stl", binary=True)
    content = (tmp_path / "tool.stl").read_bytes()
    for other in (content + b"more", content[:80] + b"\0\0\0\0" + content[84:]):
        (tmp_path / "tool.stl").write_bytes(other)
        assert_allclose(volume(*read_surface(tmp_path / "tool.stl")), 40.0**3)


def test_near_vertices_are_merged_and_degenerate_triangles_dropped(tmp_path):
    vertices, triangles = ball(8)
    soup = vertices[triangles].reshape(-1, 3)
    soup += np.random.default_rng(7).uniform(-1e-6, 1e-6, soup.shape)
    faces = np.vstack([np.arange(len(soup)).reshape(-1, 3), [[0, 1, 1]]])
    meshio.Mesh(soup, [("triangle", faces)]).write(tmp_path / "tool.vtu")
    merged, kept = read_surface(tmp_path / "tool.vtu")
    assert (len(merged), len(kept)) == (len(vertices), len(triangles))
    check_surface(merged, kept)


def test_placement_scales_moves_then_turns_about_x_then_y_then_z(tmp_path):
    vertices, triangles = block(low=(0, 0, 0), high=(1, 2, 3))
    meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "tool.vtu")
    file = SurfaceFile(tmp_path / "tool.vtu", 10.0, False, (90, 0, 90), (10.0, 0.0, 0.0))
    vertices, _, _ = file.placed()
    # x: y -> z, z -> -y; then z: x -> y, y -> -x
    assert_allclose(vertices.min(0), [0, -10, 0], atol=1e-9)
    assert_allclose(vertices.max(0), [30, 0, 20], atol=1e-9)


def test_placement_of_the_how_to(tmp_path):
    """The punch of docs/how-to/own-part.md: its tip comes to the origin, its base above it."""
    points = np.array([[200.0, 100, 40], [235, 100, 0], [200, 130, 0]])
    meshio.Mesh(points / 25.4, [("triangle", [[0, 1, 2]])]).write(tmp_path / "tool.vtu")
    file = SurfaceFile(tmp_path / "tool.vtu", 25.4, False, (180, 0, 0), (200, 100, 40))
    vertices, _, _ = file.placed()
    assert_allclose(sorted(vertices.tolist()), [[0, -30, 40], [0, 0, 0], [35, 0, 40]], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("none.stl", None, "none.stl: No such file"),
        ("tool.dwg", "", "tool.dwg: unknown kind of surface '.dwg': expected one of .stl, .obj"),
        ("empty.stl", "", "empty.stl: no triangles"),
        ("junk.stl", "this is not a surface", "junk.stl: not a readable .stl file: could not"),
        ("junk.vtu", "<a>", "junk.vtu: not a readable .vtu file: ReadError"),
        ("junk.ply", "ply", "junk.ply: not a readable .ply file: no end_header"),
        ("junk.msh", 'SystemCall "touch x";', "junk.msh: not a readable .msh file"),
        ("cut.stl", b"\0" * 80 + b"\2\0\0\0" + b"\xdf" * 60, "cut off, 1 triangles of the 2 that"),
        ("cut.stl", "solid\n facet normal 0 0 1\n  outer loop\n   vertex", "cut off, without ends"),
        ("tool.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "an element refers to a node"),
        ("tool.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "an element refers to a node"),
        ("tool.obj", "v 0 0\n", "tool.obj: not a readable .obj file: not enough values"),
        ("tool.stl", "solid\nfacet\nvertex 0 0,0 1\nendsolid", "not a readable .stl file: string"),
    ],
)
def test_unreadable_files_are_refused_by_name(tmp_path, capfd, name, text, message):
    if text is not None:
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message) as refusal:
        from_file(tmp_path / name, *BOX)
    assert str(refusal.value).startswith(str(tmp_path))
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr() == ("", "")


def test_errors_of_the_surface_name_the_file(tmp_path):
    vertices, triangles = turned(ball(8), slice(None))
    meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "tool.vtu")
    with pytest.raises(InputError, match=r"tool.vtu: the normals point inwards: set flip = true"):
        from_file(tmp_path / "tool.vtu", *BOX)
    assert from_file(tmp_path / "tool.vtu", *BOX, 4.0, flip=True).distance(BOX[:1])[0] > 0


# ---------------------------------------------------------------------------------------- repairs


def cap(n=24, half=(20.0, 18.0), depth=20.0):
    """The lower half of an ellipsoid, open above, facing outwards."""
    vertices, triangles = ball(n, 1.0)
    kept = (vertices[triangles][:, :, 2] < 1e-9).all(1)
    used, triangles = np.unique(triangles[kept], return_inverse=True)
    return vertices[used] * [*half, depth], triangles.reshape(-1, 3)


def noisy(surface):
    """Each triangle with corners of its own, up to 1e-4 mm off: 3e-6 of the diagonal."""
    soup = surface[0][surface[1]].reshape(-1, 3)
    soup = soup + np.random.default_rng(8).uniform(-1e-4, 1e-4, soup.shape)
    return soup, np.arange(len(soup)).reshape(-1, 3)


def flipped_here_and_there(surface):
    return turned(surface, np.random.default_rng(9).choice(len(surface[1]), 30, replace=False))


def without_one(surface):
    return without(surface, [len(surface[1]) // 2])


def without_two_that_touch(surface):
    """Two triangles are missing that share a vertex only."""
    triangles = surface[1]
    at = len(triangles) // 2
    shared = np.isin(triangles, triangles[at]).sum(1)
    return without(surface, [at, np.flatnonzero(shared == 1)[0]])


def slivers(surface):
    """A vertex on one side of an edge, a flat triangle on another, and a triangle twice."""
    vertices, triangles = surface
    (a, b, c), (e, f, g) = triangles[len(triangles) // 2], triangles[len(triangles) // 3]
    vertices = np.vstack([vertices, vertices[[a, b]].mean(0), vertices[[e, f]].mean(0)])
    m, k = len(vertices) - 2, len(vertices) - 1
    triangles = without((vertices, triangles), [len(triangles) // 2, len(triangles) // 3])[1]
    more = [[a, m, c], [m, b, c], [e, k, g], [k, f, g], [e, f, k], triangles[5]]
    return vertices, np.vstack([triangles, more])


def off_the_edge(surface):
    """A flat triangle whose middle corner is 1e-5 of the size beside the edge it lies on."""
    vertices, triangles = slivers(surface)
    vertices[-1] *= 1.0 + 5e-6
    return vertices, triangles


DEFECTS = {
    noisy: ("vertices up to 0.0003 mm from another merged with it", 3e-4),
    flipped_here_and_there: ("30 triangles turned round", 1e-9),
    without_one: ("a hole of 3 edges around", 1e-9),
    without_two_that_touch: ("2 holes of up to 3 edges, one around", 1e-9),
    slivers: ("2 slivers removed", 1e-9),
    off_the_edge: ("2 slivers removed", 2e-4),
}


@pytest.mark.parametrize("surface", [ball(16), cap()], ids=["closed", "open"])
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_mended_surface_has_the_distance_of_the_clean_one(tmp_path, surface, defect):
    points = np.random.default_rng(10).uniform(-25.0, 25.0, (3000, 3))
    d, words = [], []
    for vertices, triangles in (surface, defect(surface)):
        meshio.Mesh(vertices, [("triangle", triangles)]).write(tmp_path / "tool.vtu")
        vertices, triangles, repairs = SurfaceFile(tmp_path / "tool.vtu").placed()
        d.append(surface_grid(vertices, triangles, *BOX, 4.0).distance(points)[0])
        words.append("; ".join(repairs))
    report, most = DEFECTS[defect]
    assert words[0] == ""
    assert report in words[1]
    # where the sheet meets the tool: above its rim (z = 0) the open one goes on as a wall that
    # leans with the normals there, so that noise grows with the distance from the rim
    near = (np.abs(d[0]) < 5.0) & (points[:, 2] < 0.0)
    assert near.sum() > 500
    assert np.abs(d[0] - d[1])[near].max() < most


def test_a_defect_of_which_nothing_is_known_is_refused_with_a_remedy(tmp_path):
    vertices, triangles = ball(16)
    fin = np.append(vertices, [[0.0, 0.0, 40.0]], axis=0)
    beside = np.flatnonzero(vertices[triangles].mean(1)[:, 0] > 0.92 * R)  # 4 % of the area
    for name, surface, message in (
        ("fin", (fin, np.vstack([triangles, [[*triangles[40][:2], len(vertices)]]])), "1 edge "),
        ("hole", without((vertices, triangles), beside), "a hole of .* mm across, around"),
    ):
        path = tmp_path / f"{name}.vtu"
        meshio.Mesh(surface[0], [("triangle", surface[1])]).write(path)
        with pytest.raises(InputError, match=f"{message}.*mend it in CAD, MeshLab or Blender"):
            from_file(path, *BOX, 4.0)


# ------------------------------------------------------------------------------- tools of a scene


SCENE = """
travel = 15.0
[blank]
shape = "disc"
radius = 60.0
size = 6.0
[tools.punch]
file = "punch.vtu"
{punch}
[tools.die]
shape = "round opening"
radius = 25.0
fillet = 5.0
"""


def described(folder, punch="", surface=None):
    """What the model says of a punch from a file."""
    vertices, triangles = cap() if surface is None else surface
    meshio.Mesh(vertices, [("triangle", triangles)]).write(folder / "punch.vtu")
    (folder / "part.toml").write_text(SCENE.format(punch=punch))
    model = forming(str(folder / "part.toml"))
    return "\n".join(f"{entry}: {why}" for entry, why in model.description if "punch.vtu" in entry)


def test_the_model_tells_extents_triangles_and_the_point_next_to_the_sheet(tmp_path):
    words = described(tmp_path, "spacing = 4.0\nplace = [1.0, 2.0]")
    assert words == (
        f"punch from punch.vtu: 40 x 36 x 20 mm, {len(cap()[1])} triangles, its middle at (1, 2), "
        "its lowest point at (1, 2), on the sheet"
    )
    words = described(tmp_path, "spacing = 4.0\nz = 23.004", without_one(cap()))
    assert "at (0, 0), 2 mm over the upper face of the sheet" in words
    assert "\npunch.vtu repaired: a hole of 3 edges around" in words


@pytest.mark.parametrize(
    ("punch", "expected"),
    [
        ("", ""),
        ("rotate = [170, 0, 20]", r"upside down\? rotate = \[-10, 0, -20\]"),
        (
            "scale = 0.15",
            r"6 mm wide \(scale = 0.15\) in an opening of about .* mm\? set scale = 1 ",
        ),
    ],
)
def test_the_model_warns_of_a_punch_that_looks_wrong(tmp_path, punch, expected):
    words = described(tmp_path, f"spacing = 4.0\n{punch}")
    assert re.search(expected, words)
    assert ("warning, punch.vtu" in words) == bool(expected)


@pytest.mark.parametrize("x", [-101, 101])
def test_a_punch_just_beside_the_sheet_never_meets_it(tmp_path, x):
    with pytest.raises(InputError, match=rf"the punch never meets .* its middle is at \({x}, 0\)"):
        described(tmp_path, f"spacing = 4.0\nplace = [{x}, 0]")


def test_the_suggested_turn_puts_an_upside_down_punch_right(tmp_path):
    upside_down = cap()[0] * [1, -1, -1], cap()[1]
    words = described(tmp_path, "spacing = 4.0\nrotate = [10, 5, 20]", upside_down)
    line = re.search(r"rotate = \[.*\]", words)[0]
    words = described(tmp_path, f"spacing = 4.0\n{line}", upside_down)
    assert "warning" not in words
    assert "on the sheet" in words


@pytest.mark.parametrize(
    ("punch", "message"),
    [
        (
            "flip = true",
            r"punch.vtu: its normals point away from the sheet: inside out\? flip = false",
        ),
        (
            "origin = [0, 20, 0]",
            r"middle of the punch is at \(0, -20\).* origin = \[0, 0, 0\] brings",
        ),
        (
            "origin = [200, 100, 0]",
            r"x -220 to -180, y -118 to -82 .* origin = \[0, 0, 0\] puts it",
        ),
        (
            "place = [0, 200]\nrotate = [0, 0, 90]",
            r"origin = \[200, 0, 0\] puts it over the middle",
        ),
        (
            "z = 3.0",
            r"starts inside the punch: check its z, 21 puts it on the sheet, or set flip = t",
        ),
        ("scale = 0.01", r"0.4 mm across .* beside a sheet of 120 mm"),
    ],
)
def test_a_punch_that_cannot_be_is_refused_with_the_line_that_mends_it(tmp_path, punch, message):
    with pytest.raises(InputError, match=message):
        described(tmp_path, f"spacing = 4.0\n{punch}")


def test_a_flat_sheet_deep_inside_a_punch_is_found_however_short_the_travel(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "SCENE", SCENE.replace("travel = 15.0", "travel = 2.0"))
    with pytest.raises(InputError, match="starts inside the punch: check its z, 21 puts"):
        described(tmp_path, "spacing = 4.0\nz = 3.0")


# ------------------------------------------------------------------------------------------ CAD


@pytest.fixture
def gmsh(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    return pytest.importorskip("gmsh")


@pytest.mark.parametrize("name", ["tool.step", "tool.STP", "tool.iges", "tool.brep"])
def test_cad_formats_are_meshed(gmsh, tmp_path, capfd, name):
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addBox(0, 0, 0, 30, 20, 10)
    gmsh.model.occ.addCylinder(15, 10, 9, 0, 0, 6, 5)
    gmsh.model.occ.fuse([(3, 1)], [(3, 2)])
    gmsh.model.occ.synchronize()
    gmsh.write(name.lower())
    gmsh.finalize()
    Path(name.lower()).rename(name)
    Path(f"{name}.opt").write_text('SystemCall "touch run";')
    capfd.readouterr()
    before, handler = sorted(tmp_path.iterdir()), signal.getsignal(signal.SIGINT)
    vertices, triangles = read_surface(name)
    check_surface(vertices, triangles)
    assert_allclose(volume(vertices, triangles), 6000 + 5 * np.pi * 25, rtol=1e-3)
    assert_allclose(vertices.max(0) - vertices.min(0), [30, 20, 15], atol=1e-6)
    assert capfd.readouterr() == ("", "")
    assert sorted(tmp_path.iterdir()) == before
    assert signal.getsignal(signal.SIGINT) is handler
    assert not gmsh.isInitialized()


def test_step_in_metres_becomes_mm(gmsh):
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    gmsh.model.occ.addBox(0, 0, 0, 0.03, 0.02, 0.01)
    gmsh.model.occ.synchronize()
    gmsh.write("tool.step")
    gmsh.finalize()
    assert_allclose(read_surface("tool.step")[0].max(0), [30, 20, 10], atol=1e-6)


def written(name, *shapes):
    """Write shapes of gmsh, made by functions of its OpenCASCADE kernel, to a file."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    for shape in shapes:
        shape(gmsh.model.occ)
    gmsh.model.occ.synchronize()
    gmsh.write(name)
    gmsh.finalize()


def test_cad_gives_a_distance_and_leaves_no_file(gmsh, tmp_path, capfd):
    written("tool.brep", lambda occ: occ.addSphere(0, 0, 0, 20))
    Path("tool.brep.opt").write_text('SystemCall "touch run";')
    before = sorted(tmp_path.iterdir())
    capfd.readouterr()
    grid = from_file("tool.brep", *BOX, 4.0)
    assert_allclose(grid.distance(np.array([[0.0, 15.0, 20.0]]))[0], 5.0, atol=0.05)
    assert sorted(tmp_path.iterdir()) == before
    assert capfd.readouterr() == ("", "")


def test_faces_of_any_sense_are_turned_outwards(gmsh):
    def tetrahedron(occ):
        for corner in ((0, 0, 0), (9, 0, 0), (0, 9, 0), (0, 0, 9)):
            occ.addPoint(*corner)
        for ends in ((1, 2), (2, 3), (3, 1), (1, 4), (2, 4), (3, 4)):
            occ.addLine(*ends)
        for lines in ((1, 2, 3), (1, 5, -4), (2, 6, -5), (4, -6, 3)):
            occ.addPlaneSurface([occ.addCurveLoop(lines)])

    written("tool.brep", tetrahedron)
    vertices, triangles = read_surface("tool.brep")
    check_surface(vertices, triangles)
    assert_allclose(volume(vertices, triangles), 9**3 / 6)


def test_geo_is_a_program_and_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tool.geo").write_text('SystemCall "touch run";')
    with pytest.raises(InputError, match=r"tool.geo: unknown kind of surface '.geo': expected one"):
        read_surface("tool.geo")
    assert [path.name for path in tmp_path.iterdir()] == ["tool.geo"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("tool.brep", "", "tool.brep: gmsh cannot read it"),
        ("tool.step", "junk", "tool.step: gmsh cannot read it"),
        ("tool.igs", "junk", "tool.igs: gmsh cannot read it"),
        ("tool.brep", "junk", "tool.brep: gmsh cannot read it"),
    ],
)
def test_unreadable_cad_is_refused_and_gmsh_is_ready_again(gmsh, capfd, name, text, message):
    Path(name).write_text(text)
    for _ in range(2):
        with pytest.raises(InputError, match=message) as refusal:
            read_surface(name)
        assert "\n" not in str(refusal.value)
    assert capfd.readouterr() == ("", "")
    assert not gmsh.isInitialized()
    written("good.brep", lambda occ: occ.addSphere(0, 0, 0, 20))
    check_surface(*read_surface("good.brep"))


def test_gmsh_in_use_is_left_alone(gmsh):
    written("tool.brep", lambda occ: occ.addSphere(0, 0, 0, 20))
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        with pytest.raises(InputError, match="gmsh is in use by the calling program"):
            read_surface("tool.brep")
        assert gmsh.isInitialized()
    finally:
        gmsh.finalize()


def test_missing_trimesh_is_reported(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    (tmp_path / "tool.stl").write_text("")
    with pytest.raises(
        InputError, match=r"an .stl file needs trimesh: pip install 'quasiform\[surface\]'"
    ):
        read_surface(tmp_path / "tool.stl")


def test_missing_gmsh_is_reported(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    (tmp_path / "tool.step").write_text("")
    with pytest.raises(
        InputError, match=r"a .step file needs gmsh: pip install 'quasiform\[cad\]'"
    ):
        read_surface(tmp_path / "tool.step")


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("corner", range(3))
def test_sliver_at_the_last_vertex_is_taken_out(corner, flip):
    """Its longest edge is on the rim, and no edge sorts behind it."""
    x = np.array([[0.0, 0, 0], [0, 1, 0], [1 - 1e-7, 0.5, 0], [1, 0, 0], [1, 1, 0]])
    triangles = np.array([[0, 3, 2], [0, 2, 1], [1, 2, 4], [3, 4, 2]])
    triangles[3] = np.roll(triangles[3], corner)
    if flip:
        triangles = triangles[:, ::-1]
    kept, taken = without_slivers(x, triangles.copy(), 1e-5)
    assert (len(kept), taken) == (3, 1)


def test_text_file_with_letters_in_its_name(tmp_path):
    path = tmp_path / "punch.stl"
    corners = "".join(f"vertex {x} {y} 0\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    facet = f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
    path.write_text(f"solid Stempel für Blech\n{facet}endsolid\n", encoding="utf-8")
    assert len(read_surface(path)[1]) == 1


def test_the_longest_rim_comes_first_wherever_it_lies():
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = np.vstack([square + np.array([1000.0, 0, 0]), 10 * square])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    first, second = rims_of(vertices, triangles)
    assert set(first.tolist()) == {4, 5, 6, 7}
    assert set(second.tolist()) == {0, 1, 2, 3}


def test_a_closed_surface_is_turned_outwards_whatever_the_sense_of_most_triangles():
    pytest.importorskip("igl")
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    outwards = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    inwards = outwards[:, ::-1].copy()
    one_turned = np.vstack([outwards[:1], inwards[1:]])
    for triangles in (outwards, inwards, one_turned):
        corners = vertices[oriented(vertices, triangles)]
        assert np.linalg.det(corners - vertices.mean(0)).sum() > 0


@pytest.mark.parametrize(("middle", "refused"), [(0.0, True), (20.0, False)])
def test_a_hole_is_refused_where_only_the_middle_of_its_edge_is_in_the_box(middle, refused):
    x, y = (c.ravel() for c in np.meshgrid(10.0 * np.arange(4), 10.0 * np.arange(4)))
    vertices = np.column_stack([x - 15, y - 5, 0 * x])
    cells = [4 * j + i for j in range(3) for i in range(3) if (i, j) != (1, 1)]
    triangles = np.array([t for c in cells for t in ((c, c + 1, c + 5), (c, c + 5, c + 4))])
    box = np.array([middle, 5.0, 0.0]) + np.array([[-1.0], [1.0]])  # between two corners
    if refused:
        with pytest.raises(InputError, match="a hole of 4 edges"):
            check_surface(vertices, triangles, *box)
    else:
        check_surface(vertices, triangles, *box)


def test_the_rim_of_a_solid_that_no_sheet_meets_is_not_its_smallest_radius(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    angle = np.linspace(-np.pi / 2, 0.0, 40)
    profile = np.vstack([40 * np.c_[np.cos(angle), np.sin(angle)], [[0.0, 0.0]]])
    trimesh.creation.revolve(profile, sections=96).export(tmp_path / "ball.stl")
    (tmp_path / "ball.toml").write_text(
        'name = "ball"\ntravel = 40\n[blank]\nshape = "disc"\nradius = 90\nsize = 45\n'
        '[tools.punch]\nfile = "ball.stl"\n[tools.die]\nshape = "round opening"\n'
        "radius = 45\nfillet = 100\n"
    )
    model = forming(tmp_path / "ball.toml", size=20)
    (read,) = model.tools[1].values()
    punch = next(c.tool for c in model.contacts if c.tool.name == "punch")
    # 1.7 mm at the rim; a grid of 2 mm bends the ball of 40 mm a little more beside it
    assert 25 < smallest_radius(punch, {"punch": read}) < 42
