"""Files as other programs write them, and scenes that cannot be solved.

Right values are exact: they follow from the geometry that a test writes. The kinds of files are
those that users met.
"""

from collections import Counter
from dataclasses import replace

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

import quasiform as qf
from quasiform import InputError
from quasiform.meshes.shells import read_shells
from quasiform.net.free_mesh import own_mesh
from quasiform.net.outline import read_drawing
from quasiform.result.sheet import read_sheets
from quasiform.scenes import scene_file
from quasiform.solve.equilibrium import Equilibrium
from quasiform.tools.grid import from_file
from quasiform.tools.surface_file import read_surface, read_with_notes

pytest.importorskip("igl")
DIE = '[tools.die]\nshape = "round opening"\nradius = 60.0\nfillet = 8.0\n'
SHEET = '[blank]\nshape = "rectangle"\nlength = 200.0\nwidth = 200.0\nsize = 10.0\n'


def dome(rings=12, sides=24, radius=50.0):
    """A closed half ball, its flat side up at z = 0: (289, 3) vertices and 574 triangles."""
    theta = np.radians(np.linspace(0, 90, rings + 1)[1:])[:, None]
    phi = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack(
        np.broadcast_arrays(
            np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)
        ),
        axis=-1,
    )
    points = radius * np.vstack([[[0.0, 0, -1]], ring.reshape(-1, 3)])
    number = 1 + np.arange(rings * sides).reshape(rings, sides)
    after = np.roll(number, -1, axis=1)
    faces = [[0, b, a] for a, b in zip(number[0], after[0], strict=True)]
    for k in range(rings - 1):
        for a, b, c, d in zip(number[k], after[k], after[k + 1], number[k + 1], strict=True):
            faces += [[a, b, c], [a, c, d]]
    faces += [[number[-1, 0], a, b] for a, b in zip(number[-1, 1:-1], number[-1, 2:], strict=True)]
    return points, np.array(faces)


def area(vertices, triangles):
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def volume(vertices, triangles):
    return np.linalg.det(vertices[triangles]).sum() / 6


def scene(folder, tool, blank=SHEET, die=DIE):
    text = f'name = "case"\ntravel = 20.0\n{blank}\n[tools.punch]\n{tool}\n{die}'
    (folder / "scene.toml").write_text(text)
    return qf.forming(folder / "scene.toml")


def described(model):
    return "\n".join(f"{what}: {why}" for what, why in model.description)


# Dialects of OBJ, STL and OFF


def obj(points, faces, v="v {:.9g} {:.9g} {:.9g}", f="f {} {} {}", head=""):
    rows = [v.format(*p) for p in points] + [f.format(*(face + 1)) for face in faces]
    return "\n".join([head, *rows, ""])


def obj_dialects():
    points, faces = dome()
    back = faces - len(points) - 1
    mixed = [
        row
        for face in faces
        for row in (*("v {:.9g} {:.9g} {:.9g}".format(*points[k]) for k in face), "f -3 -2 -1")
    ]
    return {
        "comment": obj(points, faces, f="f {} {} {} # face"),
        "continued": obj(points, faces, f="f {} {} \\\n {}"),
        "latin": obj(points, faces, head="# K\xfcche"),
        "negative": obj(points, back, f="f {} {} {}"),
        "negative_between": "\n".join(mixed),
        "colours": obj(points, faces, v="v {:.9g} {:.9g} {:.9g} 0.5 0.5 0.5"),
        "weights": obj(points, faces, v="v {:.9g} {:.9g} {:.9g} 1.0"),
        "few_normals": obj(
            points, faces, f="f {}/1/1 {}/2/1 {}/1/1", head="vt 0 0\nvt 1 0\nvn 0 0 1"
        ),
    }


@pytest.mark.parametrize("dialect", obj_dialects())
def test_every_dialect_of_obj_is_the_same_dome(tmp_path, dialect):
    (tmp_path / "tool.obj").write_bytes(obj_dialects()[dialect].encode("latin-1"))
    surface = read_surface(tmp_path / "tool.obj")
    assert (len(surface[0]), len(surface[1])) == (289, 574)
    assert_allclose([area(*surface), volume(*surface)], [area(*dome()), volume(*dome())], rtol=1e-6)
    assert_allclose(area(*surface), 23350, atol=0.5)


def stl(head="solid dome", tail="endsolid dome", end="endloop", colour=""):
    points, faces = dome()
    rows = [head]
    for face in faces:
        rows += ["facet normal 0 0 0", colour, "outer loop"]
        rows += ["vertex {:.9g} {:.9g} {:.9g}".format(*points[k]) for k in face]
        rows += [end, "endfacet"]
    return "\n".join([*rows, tail, ""])


def binary(head=b"", count=None, tail=b""):
    points, faces = dome()
    rows = np.zeros(len(faces), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = points[faces]
    number = len(faces) if count is None else count
    return head.ljust(80) + np.uint32(number).tobytes() + rows.tobytes() + tail


STL = {
    "capitals": stl().upper().encode(),
    "two_bodies": stl("SOLID a", "ENDSOLID b").upper().encode(),
    "colours": stl(colour="color 0.1 0.2 0.3").encode(),
    "end_loop": stl(end="end loop").encode(),
    "latin": stl("solid K\xfcche", "endsolid K\xfcche").encode("latin-1"),
    "count_zero": binary(count=0),
    "solid_and_tail": binary(b"solid x", tail=b"ab"),
    "tail": binary(tail=b"more behind the last triangle"),
}


@pytest.mark.parametrize("dialect", STL)
def test_every_dialect_of_stl_is_the_same_dome(tmp_path, dialect):
    pytest.importorskip("trimesh")
    (tmp_path / "tool.stl").write_bytes(STL[dialect])
    surface = read_surface(tmp_path / "tool.stl")
    assert len(surface[1]) == 574
    assert_allclose([area(*surface), volume(*surface)], [area(*dome()), volume(*dome())], rtol=1e-5)


def capped(sides=32, concave=False):
    """A prism whose two caps are polygons: points and faces of any number of corners."""
    phi = 2 * np.pi * np.arange(sides) / sides
    radius = np.where(concave & (np.arange(sides) % 2 == 1), 20.0, 40.0)
    ring = np.column_stack([radius * np.cos(phi), radius * np.sin(phi)])
    points = np.vstack([np.pad(ring, ((0, 0), (0, 1)), constant_values=z) for z in (0.0, 40.0)])
    n = np.arange(sides)
    walls = np.column_stack([n, np.roll(n, -1), np.roll(n, -1) + sides, n + sides])
    return points, [n[::-1].tolist(), (n + sides).tolist(), *walls.tolist()]


def write_faces(path, points, faces):
    """Write polygons as OBJ, OFF, or what meshio writes."""
    if path.suffix == ".obj":
        rows = ["v {} {} {}".format(*p) for p in points]
        rows += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    elif path.suffix == ".off":
        rows = ["OFF", f"{len(points)} {len(faces)} 0", *("{} {} {}".format(*p) for p in points)]
        rows += [f"{len(face)} " + " ".join(map(str, face)) + " 255 0 0" for face in faces]
    elif path.suffix == ".ply":
        rows = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
        rows += [f"property double {c}" for c in "xyz"] + [f"element face {len(faces)}"]
        rows += ["property list uchar int vertex_indices", "end_header"]
        rows += ["{} {} {}".format(*p) for p in points]
        rows += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    else:
        kinds = {3: "triangle", 4: "quad"}
        cells = [(kinds.get(len(face), "polygon"), [face]) for face in faces]
        meshio.Mesh(points, cells).write(path)
        return
    path.write_text("\n".join([*rows, ""]))


@pytest.mark.parametrize("concave", [False, True])
@pytest.mark.parametrize("kind", ["obj", "off", "ply", "vtu", "vtk"])
def test_caps_of_many_corners_are_split(tmp_path, kind, concave):
    points, faces = capped(concave=concave)
    write_faces(path := tmp_path / f"tool.{kind}", points, faces)
    surface = read_surface(path)
    assert len(surface[1]) == 2 * 30 + 64
    a, b = points[:32, :2].T, np.roll(points[:32, :2], -1, axis=0).T
    base = 0.5 * (a[0] * b[1] - a[1] * b[0]).sum()
    side = np.linalg.norm(a - b, axis=0).sum()
    assert_allclose(volume(*surface), 40 * base)
    assert_allclose(area(*surface), 2 * base + 40 * side)  # no triangle lies over a notch
    grid = from_file(path, np.full(3, -60.0), np.full(3, 60.0), spacing=4.0)
    inside = grid.distance(np.array([[0.0, 0, 20], [0, 0, -5], [55, 0, 20]]))[0]
    assert_allclose(inside[1:], [5, 15], atol=0.1)
    assert inside[0] < -10


# Rows in are rows used and rows reported, by kind

NODES = {"triangle": 3, "triangle6": 6, "quad": 4, "quad8": 8, "quad9": 9, "polygon": 6}
NODES |= {"line": 2, "vertex": 1, "tetra": 4, "hexahedron": 8, "wedge": 6, "hexahedron20": 20}
SOLID = {"line", "vertex", "tetra", "hexahedron", "wedge", "hexahedron20"}
INP = {"S3": 3, "STRI65": 6, "S6": 6, "S4R": 4, "S8R": 8, "S9R5": 9, "M3D4R": 4, "CPS4": 4}
INP |= {"T3D2": 2, "B31": 2, "B32": 3, "C3D4": 4, "C3D8R": 8, "C3D20R": 20}
INP_SOLID = {"T3D2", "B31", "B32", "C3D4", "C3D8R", "C3D20R"}


def corner_ring(n, at):
    """Places of the n nodes of an element: its corners around `at`, then other nodes."""
    corners = {3: 3, 6: 3, 4: 4, 8: 4, 9: 4}.get(n, n)
    phi = 2 * np.pi * np.arange(n) / corners + 0.3
    ring = np.column_stack([np.cos(phi), np.sin(phi), np.zeros(n)])
    ring[corners:] *= 0.5
    return ring + at


def random_mesh(rng, kinds, least=1):
    """Counts by kind; points and (kind, nodes) of elements that touch nowhere."""
    names = rng.permutation(list(kinds))[: rng.integers(least, len(kinds) + 1)]
    points, cells, count = [], [], Counter()
    for name in names.tolist():
        for _ in range(int(rng.integers(1, 4))):
            n = kinds[name]
            ring = corner_ring(6 if name == "polygon" else n, [5.0 * len(cells), 0, 0])
            if name == "polygon":  # six corners
                phi = 2 * np.pi * np.arange(6) / 6
                ring = np.column_stack([np.cos(phi), np.sin(phi), 0 * phi])
                ring += [5.0 * len(cells), 0, 0]
            cells.append((name, np.arange(len(ring)) + sum(map(len, points))))
            points.append(ring)
            count[name] += 1
    return count, np.vstack(points), cells


def write_inp(path, points, cells, rng):
    """Write an .inp file, at random with commas at the ends of lines as cgx does."""
    comma, rows = "," * int(rng.integers(2)), ["*Heading", " a part", "*Node"]
    rows += [f"{k}, {x}, {y}, {z}{comma}" for k, (x, y, z) in enumerate(points, 1)]
    for label, (kind, nodes) in enumerate(cells, 1):
        numbers = [str(label), *(str(k + 1) for k in nodes)]
        lines = [", ".join(numbers[i : i + 12]) for i in range(0, len(numbers), 12)]
        rows += [f"*ELEMENT, TYPE={kind}, ELSET=E", ",\n".join(lines) + comma]
    path.write_text("\n".join([*rows, "*STEP", "*END STEP", ""]))


def reported(notes):
    """Counts by kind in the notes of a tool."""
    words = [note.split(": ")[1] for note in notes if note.startswith("left out")]
    pairs = [part.split(" ", 1) for part in ", ".join(words).split(", ") if part]
    return {kind: int(number) for number, kind in pairs if "nodes" not in kind}


def without_nodes(left_out):
    return {kind: n for kind, n in left_out.items() if "nodes" not in kind}


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("kind", ["vtu", "vtk", "inp"])
def test_rows_in_are_rows_used_and_rows_reported(tmp_path, kind, seed):
    rng = np.random.default_rng(seed)
    kinds, solid = (INP, INP_SOLID) if kind == "inp" else (NODES, SOLID)
    count, points, cells = random_mesh(rng, kinds)
    path = tmp_path / f"mesh.{kind}"
    if kind == "inp":
        write_inp(path, points, cells, rng)
    else:
        meshio.Mesh(points, [(name, [nodes.tolist()]) for name, nodes in cells]).write(path)
    surface = {name: n for name, n in count.items() if name not in solid}
    left = {name: n for name, n in count.items() if name in solid}
    corners = {"polygon": 6, "S9R5": 4, "STRI65": 3, "S6": 3, "triangle6": 3}
    sizes = {name: corners.get(name, 3 if kinds[name] == 3 else 4) for name in surface}
    triangles = sum(n * (sizes[name] - 2) for name, n in surface.items())
    if not surface:
        for read in (read_surface, read_shells):
            with pytest.raises(InputError, match=r"no triangles.*holds \d"):
                read(path)
        return
    _, faces, notes = read_with_notes(path, 1.0)
    assert (len(faces), reported(notes)) == (triangles, left)
    if set(surface) != {"polygon"}:
        shells = read_shells(path)
        many = surface.pop("polygon", 0)
        assert len(shells.elements) == sum(surface.values())
        more = {"polygons of more than 4 corners": many} if many else {}
        assert without_nodes(shells.left_out) == left | more
    if kind != "inp":
        (sheet,) = read_sheets(path)
        assert (len(sheet.triangles), without_nodes(sheet.left_out)) == (triangles, left)


@pytest.mark.parametrize("kind", ["obj", "off", "ply"])
def test_rows_of_polygon_files(tmp_path, kind):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        sizes = rng.integers(3, 8, 5)
        faces = [list(range(k, k + n)) for k, n in zip(np.cumsum([0, *sizes]), sizes, strict=False)]
        rings = [
            [np.cos(2 * np.pi * k / n) + 5 * i, np.sin(2 * np.pi * k / n), 0.0]
            for i, n in enumerate(sizes)
            for k in range(n)
        ]
        write_faces(path := tmp_path / f"mesh.{kind}", np.array(rings), faces)
        if kind == "obj":
            path.write_text(path.read_text() + "l 1 2 3\np 1\n")
        _, triangles, notes = read_with_notes(path, 1.0)
        assert len(triangles) == (sizes - 2).sum()
        assert reported(notes) == ({"lines": 1, "points": 1} if kind == "obj" else {})


# Targets of an export: shells of Abaqus and CalculiX

TARGET = """*NODE
{}
*ELEMENT, TYPE=S4, ELSET=E
1, 1, 2, 5, 4,
2, 2, 3, 6, 5{}
3, 4, 5, 8, 7,
4, 5, 6, 9, 8{}
"""
GRID = "\n".join(
    f"{3 * j + i + 1}, {105 + 10 * i}, {10 * j - 10}, 0.502" for j in range(3) for i in range(3)
)
PART = TARGET.format(GRID, "", "").replace(" 4,\n", " 4\n").replace(" 7,\n", " 7\n")


@pytest.mark.parametrize("ends", [("", ""), (",", ",")])
def test_element_lines_may_end_in_a_comma(tmp_path, ends):
    (tmp_path / "shell.inp").write_text(TARGET.format(GRID, *ends))
    shells = read_shells(tmp_path / "shell.inp")
    assert shells.elements.tolist() == [1, 2, 3, 4]
    assert shells.nodes[shells.corners[1]].tolist() == [2, 3, 6, 5]


@pytest.mark.parametrize(
    ("instance", "first"),
    [
        ("", [105, -10, 0.502]),
        ("0., 0., 20.\n", [105, -10, 20.502]),
        ("0., 10., 0.\n0., 0., 0., 0., 0., 1., 90.\n", [0, 105, 0.502]),
    ],
)
def test_a_part_is_read_where_its_instance_is(tmp_path, instance, first):
    text = f"*Heading\n*Part, name=P\n{PART}*End Part\n*Assembly, name=A\n"
    text += f"*Instance, name=P-1, part=P\n{instance}*End Instance\n"
    text += "*Node\n1, 9., 9., 9.\n*End Assembly\n"  # a reference point
    (tmp_path / "shell.inp").write_text(text)
    shells = read_shells(tmp_path / "shell.inp")
    assert len(shells.elements) == 4
    assert_allclose(shells.points[0], first, atol=1e-12)
    assert shells.left_out == {"nodes of other parts": 1}
    (tmp_path / "shell.inp").write_text(text.replace("*End Assembly", "*Instance, name=Q, part=P"))
    with pytest.raises(InputError, match="the part P is placed twice"):
        read_shells(tmp_path / "shell.inp")


# A user's own mesh is examined


def plate(n=20, size=10.0):
    """Nodes of a square of n x n quadrilaterals around the origin, and these."""
    line = size * (np.arange(n + 1) - n / 2)
    x, y = np.meshgrid(line, line)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return points, np.column_stack([first, first + 1, first + n + 2, first + n + 1])


def own(tmp_path, points, *cells):
    meshio.Mesh(points, list(cells)).write(tmp_path / "own.vtu")
    return own_mesh(tmp_path / "own.vtu", 30.0)


def halves():
    """Two halves of a plate, and the first node of the second."""
    points, quads = plate()
    left = points[quads].mean(1)[:, 0] < 0
    return points, quads[left], quads[~left] + len(points)


def test_halves_without_common_nodes_are_sewn_together(tmp_path):
    points, left, right = halves()
    blank = own(tmp_path, np.vstack([points, points]), ("quad", np.vstack([left, right])))
    assert len(blank.nodes) == 441
    assert len(blank.outline) == 1
    assert_allclose(blank.areas.sum(), 4e4)
    assert "21 nodes merged with another at their place" in blank.notes


@pytest.mark.parametrize(
    ("shift", "message"),
    [
        ([20.0, 0, 0], "in 2 pieces that share no edges"),
        ([0.0, 5.0, 0], "nodes lie on the side of an element"),
        ([-10.0, 0, 0], "is there twice, also as element"),
        ([-15.0, 5.0, 0], "in 2 pieces that overlap"),
    ],
)
def test_a_mesh_that_is_not_one_sheet_is_refused(tmp_path, shift, message):
    points, left, right = halves()
    both = np.vstack([points, points + shift])
    with pytest.raises(InputError, match=message):
        own(tmp_path, both, ("quad", np.vstack([left, right])))


def test_defects_of_elements_are_named_by_their_number(tmp_path):
    points, quads = plate()
    for wrong, message in (
        (quads[6][[0, 2, 1, 3]], "element 7 has no area or is crossed"),
        ([*quads[6][:3], 440], "element 7 near .* crossed or concave"),
        (quads[5], "element 7 near .* is there twice, also as element 6"),
    ):
        bad = quads.copy()
        bad[6] = wrong
        with pytest.raises(InputError, match=message):
            own(tmp_path, points, ("quad", bad))
    overlapping = [[0, 1, 22], [0, 1, 23]]
    with pytest.raises(InputError, match="elements overlap at the edge"):
        own(tmp_path, points, ("triangle", overlapping))


def test_a_node_without_an_element_is_ignored(tmp_path):
    points, quads = plate()
    blank = own(tmp_path, np.vstack([points, [[0.0, 0.0, 50.0]]]), ("quad", quads))
    assert len(blank.nodes) == 441
    assert blank.notes == ("left out: 1 nodes without an element",)


def test_elements_of_second_order_keep_their_place(tmp_path):
    """16 of 400 quadrilaterals have eight nodes: today's hole of 40 x 40 mm is filled."""
    points, quads = plate()
    middle = (np.abs(points[quads].mean(1)[:, :2]) < 20).all(1)
    corners = points[quads[middle]]
    sides = 0.5 * (corners + np.roll(corners, -1, axis=1))
    more = len(points) + np.arange(4 * middle.sum()).reshape(-1, 4)
    eight = np.hstack([quads[middle], more])
    cells = ("quad", quads[~middle]), ("quad8", eight)
    blank = own(tmp_path, np.vstack([points, sides.reshape(-1, 3)]), *cells)
    assert middle.sum() == 16
    assert (len(blank.nodes), len(blank.triangles), len(blank.outline)) == (441, 800, 1)
    assert_allclose(blank.areas.sum(), 4e4)
    assert blank.notes == ("of 16 elements of second order the corners are taken",)


def test_the_model_reports_a_mesh_of_its_own(tmp_path):
    points, left, right = halves()
    mesh = meshio.Mesh(np.vstack([points, points]), [("quad", np.vstack([left, right]))])
    mesh.write(tmp_path / "own.vtu")
    model = scene(tmp_path, 'shape = "round punch"\nradius = 40.0', '[blank]\nmesh = "own.vtu"')
    assert "blank from own.vtu: 200 x 200 mm" in described(model)
    assert "own.vtu: 21 nodes merged" in described(model)


# Drawings


def drawing(path, state="off", units=4):
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new(setup=True)
    document.header["$INSUNITS"] = units
    space = document.modelspace()
    layer = document.layers.add("FRAME")
    if state:
        getattr(layer, {"off": "off", "frozen": "freeze"}[state])()
    ply = [(-150, -100), (150, -100), (150, 100), (-150, 100)]
    space.add_lwpolyline(ply, close=True, dxfattribs={"layer": "CUT"})
    frame = [(-600, -400), (600, -400), (600, 400), (-600, 400)]
    space.add_lwpolyline(frame, close=True, dxfattribs={"layer": "FRAME"})
    space.add_text("ply 1")
    space.add_linear_dim(base=(0, 130), p1=(-150, 100), p2=(150, 100)).render()
    document.saveas(path)


@pytest.mark.parametrize("state", ["off", "frozen"])
def test_a_frame_on_a_hidden_layer_is_no_blank(tmp_path, state):
    drawing(tmp_path / "ply.dxf", state)
    read = read_drawing(tmp_path / "ply.dxf")
    assert_allclose(read.polygon.area, 300 * 200)
    left = f"left out: 1 LWPOLYLINE on layer FRAME ({state}), 1 TEXT, 1 DIMENSION"
    assert read.notes == ("drawn on layer CUT (1 lines)", left)


def test_a_layer_can_be_chosen(tmp_path):
    drawing(tmp_path / "ply.dxf", "")
    blank = '[blank]\nshape = "file"\nfile = "ply.dxf"\nsize = 20.0\n'
    punch = 'shape = "round punch"\nradius = 40.0'
    with pytest.raises(InputError, match=r"never meets the sheet.*has a hole"):
        scene(tmp_path, punch, blank)  # the frame with the ply as a hole
    model = scene(tmp_path, punch, blank + 'layer = "cut"\n')
    assert "blank from ply.dxf: 300 x 200 mm, 6e+04 mm²" in described(model)
    written = scene_file.scene_toml(scene_file.load(str(tmp_path / "scene.toml")))
    assert 'layer = "cut"' in written
    with pytest.raises(InputError, match="no lines on layer 'CUTS': did you mean 'CUT'"):
        read_drawing(tmp_path / "ply.dxf", layer="CUTS")


def test_a_header_of_inches_over_a_drawing_in_mm_gets_a_warning(tmp_path):
    """300 x 200 drawn are 7620 x 5080 mm by the header, beside a punch of 80 mm."""
    drawing(tmp_path / "ply.dxf", "off", units=1)
    blank = '[blank]\nshape = "file"\nfile = "ply.dxf"\nsize = 200.0\n'
    words = described(scene(tmp_path, 'shape = "round punch"\nradius = 40.0', blank))
    assert "blank from ply.dxf: 7620 x 5080 mm" in words
    assert "the header says inches; if it is drawn in mm, set scale = 0.03937008" in words
    assert_allclose(read_drawing(tmp_path / "ply.dxf", 0.03937008).polygon.area, 6e4, rtol=1e-6)


# Tools of several bodies, with defects, upside down


def box(low, high):
    points = np.array(
        [
            [x, y, z]
            for x in (low[0], high[0])
            for y in (low[1], high[1])
            for z in (low[2], high[2])
        ],
        dtype=float,
    )
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return points, np.array([half for a, b, c, d in quads for half in ([a, b, c], [a, c, d])])


def written(path, *bodies):
    points = np.vstack([body[0] for body in bodies])
    first = np.cumsum([0, *(len(body[0]) for body in bodies[:-1])])
    faces = np.vstack([body[1] + k for body, k in zip(bodies, first, strict=True)])
    meshio.Mesh(points, [("triangle", faces)]).write(path)


def test_bodies_in_each_other_are_united(tmp_path):
    """Over the dome's upper face a box: the distance is the smaller of both, which is exact."""
    written(tmp_path / "tool.vtu", dome(24, 48), box([-20.0, -20, -20], [20, 20, 20]))
    grid = from_file(tmp_path / "tool.vtu", np.full(3, -80.0), np.full(3, 80.0))
    points = np.array([[0.0, 0, -60], [0, 0, 25], [40, 0, 10], [35, 35, -40]])
    exact = [10, 5, 10, np.linalg.norm([35, 35, 40]) - 50]
    assert_allclose(grid.distance(points)[0], exact, atol=0.15)
    assert grid.distance(np.array([[0.0, 0, 0], [0, 0, -20], [0, 0, 10]]))[0].max() < 0
    model = scene(tmp_path, 'file = "tool.vtu"')
    assert (
        "tool.vtu repaired: bodies in each other united: 2 triangles inside left out"
        in described(model)
    )


def test_a_thin_wall_asks_for_a_finer_grid(tmp_path):
    written(tmp_path / "tool.vtu", box([-40.0, -0.2, 0], [40, 0.2, 40]))
    with pytest.raises(InputError, match=r"of 2 mm cannot show.* set spacing = 0\.5 or less"):
        from_file(tmp_path / "tool.vtu", np.full(3, -80.0), np.full(3, 80.0))


def test_a_defect_far_from_the_sheet_is_a_note(tmp_path):
    """An edge of three triangles 300 mm over the sheet is accepted, one at the sheet is not."""
    points, faces = dome()
    points = points + np.array([0.0, 0, 50])
    fin = np.array([[0.0, 0, 300], [20, 0, 300], [10, 0, 320], [10, 10, 320], [10, -10, 320]])
    wrong = [[0, 1, 2], [0, 1, 3], [1, 0, 4]]
    written(tmp_path / "tool.vtu", (points, faces), (fin, np.array(wrong)))
    words = described(scene(tmp_path, 'file = "tool.vtu"'))
    assert "1 edge shared by more than two triangles, one at (10, 0, 300) mm: away from" in words
    written(tmp_path / "tool.vtu", (points, faces), (fin - [0, 0, 290], np.array(wrong)))
    with pytest.raises(InputError, match="shared by more than two triangles"):
        scene(tmp_path, 'file = "tool.vtu"')


def test_a_closed_punch_on_its_flat_side_looks_upside_down(tmp_path):
    points, faces = dome()
    written(tmp_path / "tool.vtu", (points * [1, -1, -1], faces))
    words = described(scene(tmp_path, 'file = "tool.vtu"'))
    assert (
        "flat base towards the sheet and narrows upwards: upside down? rotate = [180, 0, 0]"
        in words
    )
    assert "warning" not in described(scene(tmp_path, 'file = "tool.vtu"\nrotate = [180, 0, 0]'))
    written(tmp_path / "tool.vtu", box([-30.0, -30, 0], [30, 30, 40]))  # flat on both sides
    assert "upside down" not in described(scene(tmp_path, 'file = "tool.vtu"'))


# Scenes that are not mechanical, and small ones


def test_a_punch_that_never_meets_the_sheet_is_refused(tmp_path):
    punch = 'shape = "round punch"\nradius = 30.0'
    hole = 'holes = [{ shape = "disc", radius = 45.0 }]\n'
    words = (
        r"never meets the sheet: within 20 mm .* 15\.\d mm; its middle is at \(0, 0\), .* a hole"
    )
    with pytest.raises(InputError, match=words):
        scene(tmp_path, punch, SHEET + hole)
    with pytest.raises(InputError, match=r"never meets .* the sheet lies at x 200 to 400, y -100"):
        scene(tmp_path, punch, SHEET + "centre = [300.0, 0.0]\n")
    assert scene(tmp_path, punch, SHEET + hole.replace("45", "25"))


def test_a_punch_that_never_meets_the_sheet_may_be_in_inches(tmp_path):
    sides = [(-30.0, -10.0), (10.0, 30.0)]  # inches: 508 mm apart, on both sides of the sheet
    written(tmp_path / "pan.vtu", *(box([a, -20, 0], [b, 20, 25]) for a, b in sides))
    words = r"never meets .*; the tool is 1524 mm across: is its file in another unit \(scale\)\?"
    with pytest.raises(InputError, match=words):
        scene(tmp_path, 'file = "pan.vtu"\nscale = 25.4')


def test_a_sheet_that_nothing_holds_is_refused(tmp_path):
    punch = 'shape = "round punch"\nradius = 30.0'
    with pytest.raises(InputError, match="nothing holds the sheet under the punch: there is no"):
        scene(tmp_path, punch, die="")
    with pytest.raises(InputError, match="it does not reach the die"):
        scene(
            tmp_path, punch, SHEET.replace("200.0", "80.0"), DIE.replace("fillet = 8", "fillet = 5")
        )
    support = '[[supports]]\nside = "+x"\nfix = "xyz"\n'
    assert scene(tmp_path, punch, die=support)


@pytest.mark.parametrize("size", [20.0, 5.0])
def test_an_unloaded_sheet_is_an_equilibrium(tmp_path, size):
    """Punch and die without a holder: the travel goes on from zero, as the force of zero allows."""
    corners = "[[-130,-99],[130,-99],[160,-70],[171,-30],[171,30],[160,70],[130,99],[-130,99],"
    corners += "[-160,70],[-171,30],[-171,-30],[-160,-70]]"
    blank = f'symmetry = "none"\n[blank]\nshape = "polygon"\npoints = {corners}\nsize = {size}\n'
    die = DIE.replace("60.0", "40.0")
    model = scene(tmp_path, 'shape = "round punch"\nradius = 30.0', blank, die)
    model = qf.forming(tmp_path / "scene.toml", travel=0.5)
    equations = Equilibrium(model)
    assert equations.residual(equations.gradient(model.x0), True) < equations.tolerance
    result = qf.solve(model, estimate=False)
    assert result.status == "completed"
    assert 0 < result.force < 0.1


def scaled(folder, s):
    """The built-in hemisphere without its holder, all lengths times s, and the thickness."""
    (folder / "scene.toml").write_text(
        f'name = "h"\ntravel = {60 * s}\n[blank]\nshape = "rectangle"\nlength = {310 * s}\n'
        f'width = {310 * s}\nsize = {10 * s}\n[tools.punch]\nshape = "round punch"\n'
        f'radius = {75 * s}\n[tools.die]\nshape = "round opening"\nradius = {80 * s}\n'
        f"fillet = {10 * s}\n"
    )
    return scene_file.load(str(folder / "scene.toml")), s * 1.004


@pytest.mark.parametrize("s", [0.01, 0.1, 1.0, 10.0])
def test_room_between_tools_does_not_depend_on_the_unit(tmp_path, s):
    file, thickness = scaled(tmp_path, s)
    fabric = replace(qf.Fabric.preset("locking"), thickness=thickness)
    assert qf.forming(file, law=fabric).sheet.blank.size == pytest.approx(10 * s, rel=0.1)
    with pytest.raises(InputError, match=r"leave .* mm for a sheet of"):
        qf.forming(file, law=replace(fabric, thickness=20 * s))
