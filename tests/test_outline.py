"""Outlines: built, and read from drawings, meshes, surfaces and tables; refusals by their words."""

import meshio
import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose

from quasiform.checks import InputError
from quasiform.net import outline


def same(shape, other, off=0.02):
    """Whether the boundaries are nowhere further apart than `off`, mm, holes included."""
    assert len(shape.interiors) == len(other.interiors)
    return shapely.hausdorff_distance(shape.boundary, other.boundary, densify=0.01) < off


@pytest.fixture
def drawing():
    """An empty drawing in mm and its model space."""
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.new(units=ezdxf.units.MM)
    return drawing, drawing.modelspace()


def read(drawing, tmp_path, scale=1.0):
    path = tmp_path / "blank.dxf"
    drawing.saveas(path)
    return outline.read_outline(path, scale)


# Built


@pytest.mark.parametrize("radius", [0.5, 60.0, 150.0, 2000.0])
def test_disc_is_a_polygon_near_it(radius):
    disc = outline.disc(radius, centre=(3.0, -2.0))
    corners = shapely.get_coordinates(disc) - [3.0, -2.0]
    assert_allclose(np.linalg.norm(corners, axis=1), radius, rtol=1e-12)
    chords = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    assert radius - np.sqrt(radius**2 - chords.max() ** 2 / 4) < 4e-5 * radius
    assert disc.exterior.is_ccw


def test_rectangle_and_polygon():
    box = outline.rectangle(40.0, 20.0, centre=(5.0, 0.0))
    assert box.bounds == (-15.0, -10.0, 25.0, 10.0)
    clockwise = [(-15, -10), (-15, 10), (25, 10), (25, -10), (-15, -10)]
    assert outline.polygon(clockwise).equals(box)
    assert outline.polygon(clockwise).exterior.is_ccw


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: outline.disc(-1.0), "radius must be a positive number"),
        (lambda: outline.rectangle(1.0, float("nan")), "width must be a positive number"),
        (lambda: outline.polygon([(0, 0), (1, 1)]), "needs three points, got 2"),
        (lambda: outline.polygon([(0, 0), (1, "a"), (3, 3)]), "must be a list of"),
        (
            lambda: outline.polygon([(0, 0), (9, 9), (9, 0), (0, 9)]),
            r"crosses itself at \(4.5, 4.5",
        ),
        (lambda: outline.polygon([(0, 0), (9, 9), (18, 18)]), "encloses no area"),
        (lambda: outline.polygon([(0, 0, 0), (9, 9, 0), (9, 0, 0)]), "must be a list of"),
    ],
)
def test_what_is_no_outline_is_refused(build, message):
    with pytest.raises(InputError, match=message):
        build()


def test_holes():
    box = outline.rectangle(40.0, 20.0)
    holes = [outline.disc(4.0, (-10.0, 0.0)), outline.disc(4.0, (10.0, 0.0))]
    plate = outline.with_holes(box, holes)
    assert len(plate.interiors) == 2
    assert plate.area == pytest.approx(box.area - 2 * holes[0].area)
    with pytest.raises(InputError, match=r"hole 2 near \(-8, 0\) does not lie inside"):
        outline.with_holes(box, [holes[0], outline.disc(4.0, (-8.0, 0.0))])
    with pytest.raises(InputError, match="hole 1 near"):  # it touches the edge
        outline.with_holes(box, [outline.disc(4.0, (16.0, 0.0))])
    notched = outline.with_holes(box, [outline.disc(4.0, (20.0, 0.0))])
    assert notched.area == pytest.approx(box.area - holes[0].area / 2, rel=1e-3)
    assert not notched.interiors


# Drawings


def test_every_kind_of_curve(drawing, tmp_path):
    drawing, space = drawing
    space.add_line((0, 0), (100, 0))
    space.add_arc((100, 50), 50, -90, 90)  # a bulge on the right
    space.add_lwpolyline([(100, 100, 0), (40, 100, 0), (0, 100, 0)], format="xyb")
    space.add_spline([(0, 100), (-10, 60), (-10, 40), (0, 0)])
    space.add_circle((30, 30), 10)
    space.add_ellipse((90, 60), major_axis=(20, 0), ratio=0.5)
    space.add_polyline2d([(20, 60), (40, 60), (40, 80), (20, 80)], close=True)
    space.add_text("sheet 1")
    plate = read(drawing, tmp_path)
    assert plate.exterior.is_ccw
    areas = sorted(shapely.Polygon(hole).area for hole in plate.interiors)
    assert_allclose(areas, [100 * np.pi, 400.0, 200 * np.pi], rtol=2e-3)
    assert plate.bounds[2] == pytest.approx(150.0, abs=0.02)
    assert plate.exterior.distance(shapely.Point(-10.0, 60.0)) < 0.02


@pytest.mark.parametrize(("unit", "mm"), [("IN", 25.4), ("M", 1000.0), ("CM", 10.0), ("MM", 1.0)])
def test_units_of_a_drawing(drawing, tmp_path, unit, mm):
    drawing, space = drawing
    import ezdxf

    drawing.units = getattr(ezdxf.units, unit)
    space.add_circle((0, 0), 60 / mm)
    assert same(read(drawing, tmp_path), outline.disc(60.0))
    assert same(read(drawing, tmp_path, scale=2.0), outline.disc(120.0), 0.05)


def test_blocks_and_markings(drawing, tmp_path):
    drawing, space = drawing
    block = drawing.blocks.new("plate")
    block.add_lwpolyline([(0, 0), (80, 0), (80, 50), (0, 50)], close=True)
    block.add_line((10, 10), (20, 10))  # a marking
    space.add_blockref("plate", (5, 0))
    assert same(read(drawing, tmp_path), shapely.box(5, 0, 85, 50))


def test_lines_drawn_twice(drawing, tmp_path):
    drawing, space = drawing
    corners = [(0, 0), (80, 0), (80, 50)]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        space.add_line(start, end)
        space.add_line(end, start)
    space.add_circle((60, 20), 5)
    space.add_circle((60, 20), 5)
    plate = shapely.Polygon(corners).difference(outline.disc(5.0, (60.0, 20.0)))
    assert same(read(drawing, tmp_path), plate)


def test_ends_that_nearly_meet(drawing, tmp_path):
    drawing, space = drawing
    for start, end in (((0, 0), (80, 0.02)), ((80, 0), (80, 50)), ((80.02, 50), (0, 0))):
        space.add_line(start, end)
    assert same(read(drawing, tmp_path), shapely.Polygon([(0, 0), (80, 0), (80, 50)]), 0.03)


DEFECTS = {
    "gap": ([[(0, 0), (80, 0), (80, 50), (0.3, 0)]], r"gap of 0.3 mm between \(0(.3)?, 0\)"),
    "gap beside a hole": (
        [[(0, 0), (80, 0), (80, 50), (0, 50), (0, 2)], [(9, 9), (19, 9), (9, 19), (9, 9)]],
        "no closed loop: gap of 2 mm",
    ),
    "branch": (
        [[(0, 0), (80, 0)], [(80, 0), (80, 50), (0, 0)], [(80, 0), (90, 9), (0, 0)]],
        "lines branch at",
    ),
    "cross": ([[(0, 0), (80, 50), (80, 0), (0, 50), (0, 0)]], r"crosses itself at \(40, 25\)"),
    "beside": (
        [[(0, 0), (80, 0), (80, 50), (0, 0)], [(100, 0), (120, 0), (120, 20), (100, 0)]],
        "more than one outline",
    ),
    "island": (
        [[(k, k), (99 - k, k), (99 - k, 99 - k), (k, 99 - k), (k, k)] for k in (0, 20, 40)],
        "a loop lies inside or across another hole",
    ),
    "nothing": ([], "no lines found"),
    "too small": ([[(0, 0), (0.3, 0), (0.3, 0.3), (0, 0)]], "0.3 mm across: is it in metres"),
    "too large": ([[(0, 0), (3e5, 0), (3e5, 3e5), (0, 0)]], "across: is it in micrometres"),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defective_drawing_is_refused_in_one_line(drawing, tmp_path, defect):
    drawing, space = drawing
    lines, message = DEFECTS[defect]
    for line in lines:
        space.add_lwpolyline(line)
    with pytest.raises(InputError, match=message) as refusal:
        read(drawing, tmp_path)
    assert str(refusal.value).startswith(str(tmp_path / "blank.dxf"))
    assert "\n" not in str(refusal.value)


def test_metres_are_suggested_with_the_scale_that_repairs(drawing, tmp_path):
    drawing, space = drawing
    space.add_circle((0, 0), 0.15)
    with pytest.raises(InputError, match="set scale = 1000"):
        read(drawing, tmp_path)
    assert same(read(drawing, tmp_path, scale=1000.0), outline.disc(150.0), 0.05)


# Meshes and surfaces


def plate_with_hole():
    """A 30 x 20 mesh of squares with one left out."""
    x, y = np.meshgrid(np.linspace(0, 30, 7), np.linspace(0, 20, 5))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)])
    corner = np.array([7 * j + i for j in range(4) for i in range(6) if (i, j) != (2, 1)])
    quads = corner[:, None] + [0, 1, 8, 7]
    return points, quads


@pytest.mark.parametrize("kind", ["triangle", "quad"])
@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_rim_of_a_mesh(tmp_path, kind, suffix):
    points, quads = plate_with_hole()
    cells = quads if kind == "quad" else quads[:, [[0, 1, 2], [2, 3, 0]]].reshape(-1, 3)
    path = tmp_path / f"sheet{suffix}"
    form = {"file_format": "gmsh"} if suffix == ".msh" else {}
    meshio.Mesh(points, [(kind, cells)]).write(path, **form)
    plate = outline.read_outline(path, scale=2.0)
    whole = shapely.box(0, 0, 60, 40).difference(shapely.box(20, 10, 30, 20))
    assert same(plate, whole, 1e-9)


def test_a_bent_mesh_is_refused(tmp_path):
    points, quads = plate_with_hole()
    points[3, 2] += 5.0
    meshio.Mesh(points, [("quad", quads)]).write(tmp_path / "sheet.vtu")
    with pytest.raises(InputError, match="the surface is not flat: its z spans 5 mm"):
        outline.read_outline(tmp_path / "sheet.vtu")


def test_rim_of_a_surface(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    path = tmp_path / "disc.brep"
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addDisk(0, 0, 0, 40, 40)
    gmsh.model.occ.synchronize()
    gmsh.write(str(path))
    gmsh.finalize()
    assert same(outline.read_outline(path), outline.disc(40.0), 0.05)


# Tables


@pytest.mark.parametrize(
    "text",
    [
        "x,y\n0,0\n40,0\n40,20\n",
        "# corners\n0 0 1\n40 0 2\n\n40 20 3\n0 0 4\n",
        "0,0; 0,0\n40,0; 0,0\n40,0; 20,0",
        "\ufeffx [mm]\ty [mm]\n0\t0\n4e1\t0\n40\t20",
    ],
)
def test_table_of_corners(tmp_path, text):
    path = tmp_path / "blank.csv"
    path.write_text(text, encoding="utf-8")
    assert outline.read_outline(path).equals(shapely.Polygon([(0, 0), (40, 0), (40, 20)]))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"x,y\n0,0\n1,one\n", "line 3: column 2 is not a number: 'one'"),
        ("a.csv", b"0,0\n9,9\n", "needs three points, got 2"),
        ("a.csv", b"0,0\n9,nan\n9,0\n", "not all coordinates are finite"),
        ("a.csv", b"\xff\xfe\x00\x01", "not a text file: expected CSV in UTF-8"),
        ("a.csv", None, "No such file"),
        ("a.dxf", None, "No such file"),
        ("a.vtu", None, "No such file"),
        ("a.dxf", b"hello", "not a readable .dxf file"),
        ("a.vtu", b"hello", "not a readable .vtu file"),
        ("a.png", b"", "unknown kind of outline '.png': expected one of .dxf"),
    ],
)
def test_an_unreadable_file_is_refused_in_one_line(tmp_path, name, content, message):
    if name.endswith(".dxf"):
        pytest.importorskip("ezdxf")
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as refusal:
        outline.read_outline(tmp_path / name)
    assert str(refusal.value).count(str(tmp_path / name)) == 1
    assert "\n" not in str(refusal.value)


def test_without_ezdxf_the_extra_is_named(tmp_path, monkeypatch):
    import sys

    (tmp_path / "a.dxf").touch()
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(InputError, match=r"needs ezdxf: pip install 'quasiform\[cad\]'"):
        outline.read_outline(tmp_path / "a.dxf")
