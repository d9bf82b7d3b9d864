"""Scene files: what is read, what it becomes, and that every mistake is told in one line."""

import pickle
import subprocess
import sys
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import get_args, get_type_hints

import jsonschema
import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose, assert_array_equal

import quasiform
from quasiform.checks import InputError
from quasiform.console import cli
from quasiform.scenes.scene_file import (
    FOLDER,
    Gripper,
    Region,
    SceneFile,
    Support,
    SurfaceFile,
    Where,
    built_in,
    json_schema,
    load,
    scene_toml,
)
from quasiform.scenes.scene_parts import SYMMETRIES
from quasiform.schema import STANDINGS
from quasiform.tools.part import SHAPES
from quasiform.tools.shapes import (
    Placed,
    Plane,
    ball,
    bar,
    box_punch,
    opening,
    regular_polygon,
    round_opening,
    round_punch,
    tetrahedron_punch,
)

BASE = """\
travel = 40.0

[blank]
shape = "rectangle"
length = 300.0
width = 200.0

[tools.punch]
shape = "round punch"
radius = 50.0

[tools.die]
shape = "round opening"
radius = 60.0
fillet = 10.0

[tools.holder]
shape = "round opening"
radius = 60.0
fillet = 10.0
mass = 5.0
"""
FULL = """\
name = "everything"
travel = { value = 40.0, unit = "mm", standing = "measured" }
symmetry = "none"
gravity = true
law = "best-fit"

[blank]
shape = "disc"
radius = { value = 150.0, standing = "stated" }
centre = [10.0, -5.0]
orientation = { value = -30.0, unit = "deg", standing = "exact" }
size = 7.5
mesh = "free"

[[blank.holes]]
shape = "disc"
radius = 20.0
centre = [60.0, 0.0]

[[blank.holes]]
shape = "rectangle"
length = 30.0
width = 10.0

[[blank.holes]]
shape = "polygon"
points = [[-50, 40], [-20, 40], [-35, 70]]

[tools.stamp]
role = "punch"
shape = "box punch"
length = 100.0
width = 80.0
edge_radius = 10.0
friction = { value = 0.2, unit = "1", standing = "peer" }
z = -2.5
place = [3.0, 4.0]

[tools.die]
shape = "box opening"
length = 110.0
width = 90.0
corner_radius = 15.0
fillet = 10.0

[tools.ring]
role = "holder"
shape = "plane"
force = { value = 100.0, unit = "N", standing = "inferred" }
mass = 2.0
tilt = false
friction = 0

[[supports]]
side = "-x"
clamp = true

[[supports]]
box = [-10, -20, 10, 20]
fix = "zx"

[[grippers]]
side = "+y"
tension = { value = 50.0, unit = "N", standing = "assumed" }

[[grippers]]
centre = [1.0, 2.0]
radius = 30.0
direction = [3.0, -4.0]
stiffness = 0.5

[areas]
left = { centre = [-40.0, 0.0], radius = 8.0, unit = "mm", standing = "assumed" }
right = { centre = [40.0, 0.0], radius = 9.0 }

[increments]
largest = 2.0
rows = 4.0

[outputs]
pictures = false
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(text, path="mine.toml"):
    Path(path).write_text(text, encoding="utf-8")
    return load(path)


def same_shape(shape, expected):
    """Whether two shapes have the same distances."""
    points = np.random.default_rng(0).uniform(-100.0, 100.0, (500, 3))
    return np.allclose(shape.distance(points)[0], expected.distance(points)[0], atol=1e-9)


# The built-in scenes


def test_built_in_scenes_are_those_of_the_paper():
    assert built_in() == ["box", "hemisphere", "tetrahedron"]
    for name in built_in():
        assert load(name).name == name


def numbers_with_standing(table, where=""):
    """Dotted names of all tables with a standing."""
    found = {}
    for key, value in table.items():
        if isinstance(value, dict):
            if "standing" in value:
                found[where + key] = value["standing"]
            else:
                found |= numbers_with_standing(value, f"{where}{key}.")
    return found


@pytest.mark.parametrize("name", built_in())
def test_every_number_of_a_built_in_scene_has_its_standing(name):
    with (FOLDER / f"{name}.toml").open("rb") as file:
        table = tomllib.load(file)
    scene = load(name)
    assert scene.standings == numbers_with_standing(table)
    assert set(scene.standings.values()) <= set(STANDINGS)
    plain = [table, table["blank"], *table["tools"].values()]
    bare = [key for part in plain for key, value in part.items() if type(value) in (int, float)]
    assert bare == []
    assert {f"areas.{area}" for area in ("green", "blue", "pink")} <= set(scene.standings)


@pytest.mark.parametrize("name", built_in())
def test_tools_of_a_built_in_scene(name):
    scene = load(name)
    punch, die, holder = scene.tools
    assert [tool.name for tool in scene.tools] == ["punch", "die", "blank holder"]
    assert [tool.role for tool in scene.tools] == ["punch", "die", "holder"]
    assert [tool.motion for tool in scene.tools] == ["driven", "fixed", "free"]
    assert holder.mass == 5.0
    assert punch.mass == die.mass == holder.force == 0.0
    assert all(tool.friction is tool.z is tool.tilt is None for tool in scene.tools)
    shapes = {
        "hemisphere": (round_punch(75.0), round_opening(80.0, 10.0)),
        "tetrahedron": (
            tetrahedron_punch(265.0, 160.0, 20.0),
            opening(regular_polygon(3, 200.0), 25.0, 10.0),
        ),
        "box": (
            box_punch(100.0, 100.0, 10.0),
            opening([[-55, -55], [55, -55], [55, 55], [-55, 55]], 15.0, 10.0),
        ),
    }[name]
    assert same_shape(punch.shape, shapes[0])
    assert same_shape(die.shape, shapes[1])
    assert same_shape(holder.shape, Placed(shapes[1], np.diag([1.0, 1.0, -1.0])))
    assert scene.outline.equals(shapely.box(-155, -155, 155, 155))
    assert scene.travel == {"hemisphere": 75.0, "tetrahedron": 80.0, "box": 50.0}[name]
    assert (scene.orientation, scene.size, scene.mesh, scene.law) == (0.0, None, "fibre", "locking")
    assert (scene.gravity, scene.symmetry, scene.supports, scene.grippers) == (
        False,
        "auto",
        (),
        (),
    )
    assert (scene.increment, scene.rows) == (None, None)  # of the blank
    assert scene.outputs == {"pictures": True, "increments": True}


def test_a_copy_of_a_built_in_scene_reads_the_same(here):
    text = (FOLDER / "box.toml").read_text(encoding="utf-8")
    copied, original = read(text, "my-box.toml"), load("box")
    for field in fields(SceneFile):
        if field.name not in ("tools", "source"):  # shapes are compared above
            assert getattr(copied, field.name) == getattr(original, field.name), field.name


# What is read


def test_a_plain_file_takes_every_default():
    scene = read(BASE)
    assert scene.name == "mine"
    assert scene.travel == 40.0
    assert scene.outline.equals(shapely.box(-150, -100, 150, 100))
    assert scene.standings == {}
    punch, die, holder = scene.tools
    assert same_shape(punch.shape, round_punch(50.0))
    assert same_shape(die.shape, round_opening(60.0, 10.0))
    assert (holder.name, holder.mass, holder.tilt) == ("blank holder", 5.0, None)


def test_everything_that_can_be_said_is_read():
    scene = read(FULL)
    assert (scene.name, scene.travel, scene.symmetry) == ("everything", 40.0, "none")
    assert (scene.gravity, scene.law) == (True, "best-fit")
    assert (scene.orientation, scene.size, scene.mesh) == (-30.0, 7.5, "free")
    assert (scene.increment, scene.rows) == (2.0, 4.0)
    assert scene.outputs == {"pictures": False, "increments": True}
    assert scene.areas == {"left": ((-40.0, 0.0), 8.0), "right": ((40.0, 0.0), 9.0)}
    assert scene.supports == (
        Support(Where(side="-x"), "xyz", True),
        Support(Where(box=(-10.0, -20.0, 10.0, 20.0)), "zx", False),
    )
    assert scene.grippers == (
        Gripper(Where(side="+y"), (0.0, 1.0), tension=50.0),
        Gripper(Where(centre=(1.0, 2.0), radius=30.0), (0.6, -0.8), stiffness=0.5),
    )
    stamp, die, ring = scene.tools
    assert (stamp.name, stamp.role, stamp.motion) == ("stamp", "punch", "driven")
    assert (stamp.friction, stamp.z, stamp.place) == (0.2, -2.5, (3.0, 4.0))
    assert (ring.name, ring.motion, ring.tilt, ring.friction) == ("ring", "free", False, 0.0)
    assert (ring.mass, ring.force) == (2.0, 100.0)
    assert (die.friction, die.z, die.place, die.tilt) == (None, None, (0.0, 0.0), None)
    assert scene.standings == {
        "travel": "measured",
        "blank.radius": "stated",
        "blank.orientation": "exact",
        "tools.stamp.friction": "peer",
        "tools.ring.force": "inferred",
        "grippers 1.tension": "assumed",
        "areas.left": "assumed",
    }


def test_blank_with_holes():
    outline = read(FULL).outline
    assert_allclose(outline.centroid.coords[0], (10.0, -5.0), atol=5.0)
    assert outline.bounds == pytest.approx((-140.0, -155.0, 160.0, 145.0))
    assert len(outline.interiors) == 3
    disc, rectangle, triangle = (shapely.Polygon(ring) for ring in outline.interiors)
    assert disc.centroid.coords[0] == pytest.approx((60.0, 0.0), abs=1e-6)
    assert disc.area == pytest.approx(np.pi * 20**2, rel=1e-3)
    assert rectangle.equals(shapely.box(-15, -5, 15, 5))
    assert triangle.equals(shapely.Polygon([(-50, 40), (-20, 40), (-35, 70)]))


def test_blank_from_a_file_beside_the_scene(here):
    (here / "sub").mkdir()
    Path("sub/outline.csv").write_text("x,y\n0,0\n10,0\n10,20\n", encoding="utf-8")
    blank = '[blank]\nshape = "file"\nfile = "outline.csv"\nscale = 2.0\ncentre = [-10.0, 0.0]\n'
    text = blank.join([BASE[: BASE.index("[blank]")], BASE[BASE.index("[tools.punch]") :]])
    scene = read(text, "sub/mine.toml")
    assert scene.outline.equals(shapely.Polygon([(-10, 0), (10, 0), (10, 40)]))


def test_paths_are_relative_to_the_file(here):
    (here / "sub").mkdir()
    tool = '[tools.punch]\nfile = "punch.stl"\nscale = 1000.0\nflip = true\nrotate = [0, 90, 0]\n'
    tool += "origin = [1, 2, 3]\nspacing = 1.5\n"
    text = BASE.replace('[tools.punch]\nshape = "round punch"\nradius = 50.0\n', tool)
    text = 'law = "cloth.toml"\n' + text
    scene = read(text, "sub/mine.toml")
    assert scene.tools[0].shape == SurfaceFile(
        Path("sub/punch.stl"), 1000.0, True, (0.0, 90.0, 0.0), (1.0, 2.0, 3.0), 1.5
    )
    assert Path(scene.law) == Path("sub/cloth.toml")
    own = text.replace(
        'shape = "rectangle"\nlength = 300.0\nwidth = 200.0\n', 'mesh = "m.msh"\nmesh_scale = 1e3\n'
    )
    scene = read(own, "sub/mine.toml")
    assert (scene.mesh, scene.mesh_scale) == (Path("sub/m.msh"), 1000.0)
    assert scene.outline.is_empty  # the mesh brings its own


NUMBERS = {"radius": 40.0, "length": 50.0, "width": 45.0, "height": 60.0, "base_edge": 90.0}
NUMBERS |= {"edge_radius": 5.0, "corner_radius": 6.0, "fillet": 7.0, "edge": 80.0, "azimuth": -25.0}
SQUARE = np.array([[-25, -22.5], [25, -22.5], [25, 22.5], [-25, 22.5]])
BUILT = {
    "round punch": round_punch(40.0),
    "box punch": box_punch(50.0, 45.0, 5.0),
    "tetrahedron punch": tetrahedron_punch(90.0, 60.0, 5.0, -25.0),
    "round opening": round_opening(40.0, 7.0),
    "box opening": opening(SQUARE, 6.0, 7.0),
    "triangle opening": opening(regular_polygon(3, 80.0, -25.0), 6.0, 7.0),
    "ball": ball(40.0),
    "bar": bar(40.0),
    "plane": Plane(),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_is_built_from_its_numbers(shape):
    role = "punch" if "punch" in shape else "die"
    tool = f'[tools.extra]\nrole = "{role}"\nshape = "{shape}"\n'
    tool += "".join(f"{key} = {NUMBERS[key]}\n" for key in SHAPES[shape][1])
    extra = read(BASE + tool).tools[-1]
    assert same_shape(extra.shape, BUILT[shape])
    if "azimuth" in SHAPES[shape][1]:
        without = read(BASE + tool.replace("azimuth = -25.0\n", "")).tools[-1]
        assert not same_shape(without.shape, BUILT[shape])
        assert read(BASE + tool.replace("-25.0", "0.0")).tools[-1].shape.sharpest > 0


def test_a_holder_faces_down():
    tool = read(BASE).tools[-1].shape
    d, n, _ = tool.distance(np.array([[100.0, 0.0, -3.0]]))
    assert d == 3.0
    assert_array_equal(n, [[0.0, 0.0, -1.0]])


@pytest.mark.parametrize(
    ("words", "motion", "tilt"),
    [
        ("", "free", None),
        ("tilt = true\n", "free", True),
        ("tilt = false\n", "free", False),
        ('motion = "free"\n', "free", None),
    ],
)
def test_motion_of_a_holder(words, motion, tilt):
    holder = read(BASE + words).tools[-1]
    assert (holder.motion, holder.tilt) == (motion, tilt)


def test_a_holder_at_a_fixed_gap_has_no_mass():
    holder = read(BASE.replace("mass = 5.0", 'motion = "fixed"\nz = 1.3')).tools[-1]
    assert (holder.motion, holder.mass, holder.z) == ("fixed", 0.0, 1.3)


def test_a_part_of_the_blank():
    points = np.array([[-10, -5], [0, 0], [10, 5], [10, -5], [9.99, 4], [-10, 0]], dtype=float)
    bounds = (-10.0, -5.0, 10.0, 5.0)
    for where, numbers in (
        (Where(side="+x"), [2, 3]),
        (Where(side="-x"), [0, 5]),
        (Where(side="+y"), [2]),
        (Where(side="-y"), [0, 3]),
        (Where(box=(-1.0, -1.0, 10.0, 4.0)), [1, 4]),
        (Where(centre=(10.0, 0.0), radius=5.0), [2, 3, 4]),
        (Where(centre=(0.0, 0.0), radius=0.1), [1]),
    ):
        assert_array_equal(np.flatnonzero(where.nodes(points, bounds)), numbers)


# Written back, and described to an editor

NEW = (Path(quasiform.__file__).parent / "console" / "new.toml").read_text(encoding="utf-8")
TEXTS = {
    **{name: (FOLDER / f"{name}.toml").read_text(encoding="utf-8") for name in built_in()},
    "new": NEW,
    "all of new": NEW.replace("\n#: ", "\n"),
    "plain": BASE,
    "everything": FULL,
    "own mesh": BASE.replace(
        'shape = "rectangle"\nlength = 300.0\nwidth = 200.0', 'mesh = "/m.msh"\nmesh_scale = 10.0'
    ),
    "surface": BASE.replace(
        'shape = "round punch"\nradius = 50.0', 'file = "/a.stl"\nrotate = [0, 90, 0]'
    ).replace("travel", 'law = "/cloth.toml"\ntravel'),
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_scene_that_is_written_reads_the_same(name):
    scene = read(TEXTS[name])
    text = scene_toml(scene)
    again = read(text, "again.toml")
    assert again == scene
    assert hash(again) == hash(scene)
    assert again.outline.equals_exact(scene.outline, 0.0)
    assert scene_toml(again) == text
    assert tomllib.loads(text)["outputs"].keys() == {"pictures", "increments"}  # defaults too


def test_a_force_over_the_travel_is_read_and_written():
    text = BASE.replace("mass = 5.0", "mass = 5.0\nforce = [[0, 10], [20.5, 30]]")
    scene = read(text)
    assert scene.tools[2].force == ((0.0, 10.0), (20.5, 30.0))
    assert read(scene_toml(scene), "again.toml") == scene
    assert hash(scene)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        ("[]", "expected two rows or more"),
        ("[[0, 10]]", "expected two rows or more"),
        ("[[5, 10], [5, 20]]", "of rising travel from 0"),
        ("[[-1, 10], [5, 20]]", "of rising travel from 0"),
        ("[[0, 10], [nan, 20]]", "of rising travel from 0"),
        ("[[0, 10], [true, 20]]", "of rising travel from 0"),
        ("[[0, 10, 3], [1, 2, 3]]", r"\[travel in mm, N\]"),
        ("[0, 10]", r"\[travel in mm, N\]"),
        ("[[0, 10], [5, -1]]", "force must be a number of at least zero, got -1"),
        ("[[0, 10], [5, inf]]", "force must be a number of at least zero, got inf"),
        ("[[0, 10], [5, 0]]\nmass = 0", "needs a mass or a force, over the whole travel"),
    ],
)
def test_a_force_over_the_travel_that_cannot_be_is_refused(force, message):
    text = BASE.replace("mass = 5.0", f"mass = 5.0\nforce = {force}")
    text = text.replace("mass = 5.0\n", "") if "mass = 0" in force else text
    with pytest.raises(InputError, match=message):
        read(text)


def test_a_scene_is_plain_data():
    scene = read(FULL)
    copy = pickle.loads(pickle.dumps(scene))
    assert copy == scene
    assert replace(scene, travel=30.0) != scene
    ring = Region.of(scene.outline)
    assert ring.polygon.equals(scene.outline)
    own = replace(scene, tools=[replace(scene.tools[0], geometry=ball(3.0))])
    assert own.tools[0].shape.radius == 3.0
    with pytest.raises(InputError, match="stamp: a shape of your own cannot be written"):
        scene_toml(own)


@pytest.mark.parametrize("name", TEXTS)
def test_a_scene_fits_the_json_schema(name):
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(tomllib.loads(TEXTS[name]), schema)
    jsonschema.validate(tomllib.loads(scene_toml(read(TEXTS[name]))), schema)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("radius = 50.0", "radios = 50.0"),
        ("radius = 50.0", "radius = -50.0"),
        ("radius = 50.0", "radius = { value = 50.0 }"),
        ("round punch", "round bunch"),
        ("mass = 5.0", "mass = '5'"),
        ("travel = 40.0", ""),
        ("travel = 40.0", "travel = 40.0\nsymmetry = 'non'"),
    ],
)
def test_a_mistake_does_not_fit_the_json_schema(old, new):
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(BASE.replace(old, new)), json_schema())


def test_the_json_schema_says_units_and_defaults():
    schema = json_schema()
    assert schema["properties"]["travel"]["description"].endswith("; mm")
    assert schema["properties"]["symmetry"]["default"] == "auto"
    # the same words as the option and the argument
    assert tuple(schema["properties"]["symmetry"]["enum"]) == SYMMETRIES
    option, _ = get_args(get_type_hints(cli.Scene)["symmetry"])
    assert get_args(option) == SYMMETRIES
    for word in SYMMETRIES:
        assert quasiform.forming(size=31, symmetry=word).parameters["symmetry"] == word
    with pytest.raises(InputError, match="symmetry must be 'auto', 'half' or 'none', got 'all'"):
        quasiform.forming(size=31, symmetry="all")
    punch = schema["$defs"]["round_punch"]
    assert punch["properties"]["mass"]["description"].endswith("; kg")
    assert set(punch["required"]) == {"shape", "radius"}


def test_schemas_load_only_where_a_file_is_read():
    code = "import sys, quasiform; assert 'pydantic' not in sys.modules"
    subprocess.run(
        [sys.executable, "-c", code], check=True, cwd=Path(quasiform.__file__).parents[1]
    )


# What is refused

RECTANGLE = 'shape = "rectangle"\nlength = 300.0\nwidth = 200.0\n'
HOLE = '[[blank.holes]]\nshape = "disc"\nradius = 20.0\n'
SUPPORT = '[[supports]]\nside = "+x"\nfix = "z"\n'
GRIPPER = '[[grippers]]\nside = "+x"\ntension = 5.0\n'
AREA = "[areas]\ngreen = { centre = [0.0, 0.0], radius = 8.0 }\n"
REFUSED = {
    # old text (or "" to append), new text, words
    "no table": ("[blank]", "[blnk]", ["unknown key 'blnk'", "did you mean 'blank'?"]),
    "no blank": (BASE[: BASE.index("[tools")], "travel = 40.0\n", ["table [blank] missing"]),
    "no tools": (BASE[BASE.index("[tools") :], "", ["table [tools] missing"]),
    "blank no table": (
        BASE[: BASE.index("[tools")],
        "travel = 40.0\nblank = 5\n",
        ["table [blank] missing"],
    ),
    "no travel": ("travel = 40.0", "", ["travel missing"]),
    "travel zero": ("travel = 40.0", "travel = 0", ["travel must be a positive number, got 0"]),
    "travel true": ("travel = 40.0", "travel = true", ["travel must be a positive number"]),
    "travel text": ("travel = 40.0", "travel = '40'", ["travel must be a positive number", "'40'"]),
    "travel inf": ("travel = 40.0", "travel = inf", ["travel must be a positive number, got inf"]),
    "no toml": ("travel = 40.0", "travel = = 40.0", ["line 1"]),
    "twice": ("travel = 40.0", "travel = 40.0\ntravel = 40.0", ["line 2"]),
    "top key": ("travel = 40.0", "travel = 40.0\ngraviti = true", ["'graviti'", "'gravity'?"]),
    "gravity": ("travel = 40.0", "travel = 40.0\ngravity = 1", ["gravity = 1", "true or false"]),
    "symmetry": (
        "travel = 40.0",
        "travel = 40.0\nsymmetry = 'non'",
        ["symmetry = 'non'", "did you mean 'none'?"],
    ),
    "law": ("travel = 40.0", "travel = 40.0\nlaw = 5", ["law = 5", "a preset or the path"]),
    "blank key": (
        "width = 200.0",
        "widht = 200.0",
        ["[blank] unknown key 'widht'", "did you mean 'width'?"],
    ),
    "blank shape": (
        'shape = "rectangle"',
        'shape = "rectangel"',
        ["[blank] shape = 'rectangel'", "did you mean 'rectangle'?"],
    ),
    "blank no shape": (
        'shape = "rectangle"',
        "",
        ["[blank] shape missing", "rectangle, disc, polygon, file"],
    ),
    "blank shape number": ('shape = "rectangle"', "shape = 3", ["[blank] shape = 3", "one of"]),
    "blank number": ("width = 200.0", "", ["[blank] width missing"]),
    "blank negative": ("width = 200.0", "width = -2", ["[blank] width must be a positive", "-2"]),
    "blank of another shape": (
        "width = 200.0",
        "width = 200.0\nradius = 9.0",
        ["[blank]", "radius"],
    ),
    "disc": (RECTANGLE, 'shape = "disc"', ["[blank] radius missing"]),
    "polygon": (RECTANGLE, 'shape = "polygon"', ["[blank] points missing"]),
    "polygon points": (
        RECTANGLE,
        'shape = "polygon"\npoints = [[0, 0], [1, 2]]',
        ["an outline needs three points, got 2"],
    ),
    "polygon crossed": (
        RECTANGLE,
        'shape = "polygon"\npoints = [[0, 0], [10, 10], [10, 0], [0, 10]]',
        ["crosses itself at (5, 5)"],
    ),
    "outline file": (
        RECTANGLE,
        'shape = "file"\nfile = "nowhere.dxf"',
        ["nowhere.dxf", "No such file"],
    ),
    "outline path": (
        RECTANGLE,
        'shape = "file"\nfile = 5',
        ["[blank] file = 5", "expected the path of a file"],
    ),
    "centre": (
        "width = 200.0",
        "width = 200.0\ncentre = [1.0]",
        ["[blank] centre = [1.0]", "expected 2 numbers"],
    ),
    "size": (
        "width = 200.0",
        "width = 200.0\nsize = 0",
        ["[blank] size must be a positive number"],
    ),
    "orientation": (
        "width = 200.0",
        "width = 200.0\norientation = nan",
        ["[blank] orientation must be a number"],
    ),
    "mesh": (
        "width = 200.0",
        "width = 200.0\nmesh = 'fiber'",
        ["[blank] mesh = 'fiber'", "did you mean 'fibre'?"],
    ),
    "mesh with shape": (
        "width = 200.0",
        "width = 200.0\nmesh = 'own.msh'",
        ["[blank] mesh is a file", "leave out shape"],
    ),
    "mesh scale": (
        "width = 200.0",
        "width = 200.0\nmesh_scale = 2.0",
        ["mesh_scale goes with a mesh from a file"],
    ),
    "own mesh, key": (
        RECTANGLE,
        'mesh = "own.msh"\nmesh_scal = 2.0\n',
        ["[blank] unknown key 'mesh_scal'", "did you mean 'mesh_scale'?"],
    ),
    "hole outside": ("", HOLE + "centre = [190.0, 0.0]", ["hole 1 near (190, 0)", "inside"]),
    "hole key": ("", HOLE + "center = [50.0, 0.0]", ["[blank.holes 1] unknown key 'center'"]),
    "hole from a file": (
        "",
        HOLE.replace("disc", "file"),
        ["[blank.holes 1] unknown key 'radius'", "file"],
    ),
    "hole, second": ("", HOLE + HOLE.replace("20.0", "-1"), ["[blank.holes 2] radius must be"]),
    "holes no tables": (
        "width = 200.0",
        "width = 200.0\nholes = 3",
        ["blank.holes", "[[blank.holes]]"],
    ),
    "tool no table": (
        "[tools.punch]",
        "[tools]\npunch = 4\n[tools.x]",
        ["tools.punch = 4: expected a table [tools.punch]"],
    ),
    "tool key": (
        "radius = 50.0",
        "radius = 50.0\nradios = 1",
        ["[tools.punch] unknown key 'radios'", "did you mean 'radius'?"],
    ),
    "tool shape": (
        'shape = "round punch"',
        'shape = "round bunch"',
        ["[tools.punch] shape = 'round bunch'", "did you mean 'round punch'?"],
    ),
    "tool no shape": ('shape = "round punch"', "", ["[tools.punch] shape missing", "ball, bar"]),
    "tool number": ("radius = 50.0", "", ["[tools.punch] radius missing"]),
    "tool bad number": (
        "radius = 50.0",
        "radius = 'big'",
        ["[tools.punch] radius must be a positive number, got 'big'"],
    ),
    "tool of another shape": (
        "radius = 50.0",
        "radius = 50.0\nedge_radius = 3.0",
        ["[tools.punch] unknown key 'edge_radius'"],
    ),
    "impossible shape": (
        '"round punch"\nradius = 50.0',
        '"box punch"\nlength = 50.0\nwidth = 9.0\nedge_radius = 5.0',
        ["[tools.punch] width must exceed twice the edge_radius 5 mm, got 9"],
    ),
    "role": (
        "[tools.punch]",
        "[tools.stamp]",
        ["[tools.stamp] role missing", "punch, die, holder"],
    ),
    "bad role": (
        "radius = 50.0",
        "radius = 50.0\nrole = 'pnch'",
        ["[tools.punch] role = 'pnch'", "did you mean 'punch'?"],
    ),
    "motion": (
        "radius = 50.0",
        "radius = 50.0\nmotion = 'drive'",
        ["[tools.punch] motion = 'drive'", "did you mean 'driven'?"],
    ),
    "nothing driven": ("radius = 50.0", "radius = 50.0\nmotion = 'fixed'", ["no tool is driven"]),
    "friction": (
        "radius = 50.0",
        "radius = 50.0\nfriction = -0.1",
        ["[tools.punch] friction must be a number of at least zero, got -0.1"],
    ),
    "place": (
        "radius = 50.0",
        "radius = 50.0\nplace = ['a', 2]",
        ["[tools.punch] place = ['a', 2]", "expected 2 numbers"],
    ),
    "z": (
        "radius = 50.0",
        "radius = 50.0\nz = 'high'",
        ["[tools.punch] z must be a number", "'high'"],
    ),
    "mass of a punch": (
        "radius = 50.0",
        "radius = 50.0\nmass = 2.0",
        ["[tools.punch] mass, force"],
    ),
    "force of a die": (
        "mass = 5.0",
        'mass = 5.0\n[tools.die2]\nrole = "die"\nshape = "plane"\nforce = 3.0',
        ["[tools.die2] mass, force and tilt belong to a tool with motion = 'free'"],
    ),
    "tilt of a punch": (
        "radius = 50.0",
        "radius = 50.0\ntilt = true",
        ["[tools.punch] mass, force and tilt belong"],
    ),
    "no load": ("mass = 5.0", "", ["[tools.holder] a free tool needs a mass or a force"]),
    "mass": ("mass = 5.0", "mass = nan", ["[tools.holder] mass must be", "nan"]),
    "tilt": ("mass = 5.0", "mass = 5.0\ntilt = 'no'", ["[tools.holder] tilt = 'no'", "true or f"]),
    "standing": (
        "mass = 5.0",
        "mass = { value = 5.0, unit = 'kg', standing = 'sure' }",
        ["tools.holder.mass: standing must be one of", "'sure'"],
    ),
    "no standing": (
        "mass = 5.0",
        "mass = { value = 5.0, unit = 'kg' }",
        ["tools.holder.mass: standing must be one of measured, stated", "got None"],
    ),
    "unit": (
        "mass = 5.0",
        "mass = { value = 5.0, unit = 'g', standing = 'assumed' }",
        ["tools.holder.mass: unit must be 'kg', got 'g'"],
    ),
    "unit of a length": (
        "radius = 50.0",
        "radius = { value = 5.0, unit = 'cm', standing = 'assumed' }",
        ["tools.punch.radius: unit must be 'mm', got 'cm'"],
    ),
    "value key": (
        "mass = 5.0",
        "mass = { valeu = 5.0, unit = 'kg', standing = 'assumed' }",
        ["[tools.holder.mass] unknown key 'valeu'", "did you mean 'value'?"],
    ),
    "no value": (
        "mass = 5.0",
        "mass = { unit = 'kg', standing = 'assumed' }",
        ["[tools.holder] mass must be", "None"],
    ),
    "file and shape": (
        "radius = 50.0",
        "file = 'a.stl'",
        ["[tools.punch] unknown key 'shape'"],
    ),
    "flip": (
        'shape = "round punch"\nradius = 50.0',
        "file = 'a.stl'\nflip = 1",
        ["[tools.punch] flip = 1", "true or false"],
    ),
    "rotate": (
        'shape = "round punch"\nradius = 50.0',
        "file = 'a.stl'\nrotate = [1, 2]",
        ["[tools.punch] rotate = [1, 2]", "expected 3 numbers"],
    ),
    "rotate by one angle": (
        'shape = "round punch"\nradius = 50.0',
        "file = 'a.stl'\nrotate = 180.0",
        ["[tools.punch] rotate = 180.0", "angles in degrees about x, y and z", "[180, 0, 0]"],
    ),
    "origin": (
        'shape = "round punch"\nradius = 50.0',
        "file = 'a.stl'\norigin = 200",
        ["[tools.punch] origin = 200", "the point of the file in mm", "[200, 100, 0]"],
    ),
    "misspelt role": (
        "[tools.holder]",
        "[tools.hodler]",
        ["[tools.hodler] did you mean [tools.holder]?", "role = 'punch', 'die' or 'holder'"],
    ),
    "supports no tables": ("travel = 40.0", "travel = 40.0\nsupports = 5", ["[[supports]]"]),
    "support key": ("", SUPPORT + "clmp = true", ["[supports 1] unknown key 'clmp'", "'clamp'?"]),
    "support nowhere": ("", '[[supports]]\nfix = "z"', ["[supports 1] give one of side, box"]),
    "support twice": ("", SUPPORT + "box = [0, 0, 1, 1]", ["[supports 1] give one of side, box"]),
    "support, second": ("", SUPPORT + '[[supports]]\nside = "+x"', ["[supports 2] fix = None"]),
    "fix": ("", SUPPORT.replace('"z"', '"xw"'), ["[supports 1] fix = 'xw'", "letters xyz"]),
    "side": ("", SUPPORT.replace("+x", "left"), ["[supports 1] side = 'left'", "+x, -x, +y, -y"]),
    "support box": (
        "",
        SUPPORT.replace('side = "+x"', "box = [1, 2, 3]"),
        ["[supports 1] box = [1, 2, 3]", "expected 4 numbers"],
    ),
    "support side and radius": ("", SUPPORT + "radius = 9.0", ["[supports 1]", "radius"]),
    "support radius": (
        "",
        SUPPORT.replace('side = "+x"', "centre = [1, 2]"),
        ["[supports 1] radius missing"],
    ),
    "gripper key": ("", GRIPPER + "pull = 3", ["[grippers 1] unknown key 'pull'"]),
    "gripper load": (
        "",
        GRIPPER.replace("tension = 5.0", ""),
        ["[grippers 1] needs a tension or a stiffness"],
    ),
    "gripper tension": (
        "",
        GRIPPER.replace("5.0", "-5.0"),
        ["[grippers 1] tension must be", "-5.0"],
    ),
    "gripper direction": (
        "",
        GRIPPER + "direction = [0.0, 0.0]",
        ["[grippers 1] direction must not be zero"],
    ),
    "area key": ("", AREA.replace("radius", "radios"), ["[areas.green] unknown key 'radios'"]),
    "area no table": (
        "",
        "[areas]\ngreen = 5",
        ["areas.green = 5: expected a table [areas.green]"],
    ),
    "area centre": ("", AREA.replace("[0.0, 0.0]", "5"), ["[areas.green] centre = 5"]),
    "area no centre": ("", "[areas]\ngreen = { radius = 8.0 }", ["[areas.green] centre"]),
    "area standing": ("", AREA.replace(" }", ", standing = 'x' }"), ["areas.green: standing"]),
    "area unit": ("", AREA.replace(" }", ", unit = 'm' }"), ["areas.green", "unit must be 'mm'"]),
    "increments": ("", "[increments]\nlargst = 2.0", ["[increments] unknown key 'largst'"]),
    "largest": ("", "[increments]\nlargest = 0.0", ["[increments] largest must be a positive"]),
    "outputs": (
        "",
        "[outputs]\npicture = true",
        ["[outputs] unknown key 'picture'", "'pictures'?"],
    ),
    "outputs no flag": ("", "[outputs]\npictures = 'no'", ["[outputs] pictures = 'no'"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_mistake_is_told_in_one_line_that_names_file_table_and_key(case):
    old, new, words = REFUSED[case]
    assert old in BASE
    with pytest.raises(InputError) as refusal:
        read(BASE.replace(old, new) if old else f"{BASE}\n{new}\n")
    message = str(refusal.value)
    assert message.startswith("mine.toml: ")
    assert "\n" not in message
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("hemispere", ["unknown scene 'hemispere'", "did you mean 'hemisphere'?", ".toml file"]),
        ("tetra", ["unknown scene 'tetra'", "did you mean 'tetrahedron'?"]),
        ("cone", ["unknown scene 'cone'", "box, hemisphere, tetrahedron"]),
        ("", ["unknown scene ''"]),
        ("nowhere.toml", ["nowhere.toml", "No such file"]),
        ("folder.toml", ["folder.toml", "directory"]),
        ("bytes.toml", ["bytes.toml", "utf-8"]),
    ],
)
def test_a_scene_that_cannot_be_read_is_refused(here, name, words):
    (here / "folder.toml").mkdir()
    (here / "bytes.toml").write_bytes(b"travel = \xff\xfe")
    with pytest.raises(InputError) as refusal:
        load(name)
    assert [word for word in words if word not in str(refusal.value)] == []


PLACES = {
    "": "name travel symmetry gravity law blank tools supports grippers areas increments outputs",
    "blank": "shape length centre size orientation mesh mesh_scale holes",
    "tools": "punch die holder",
    "tools.punch": "shape radius role motion friction mass z place tilt file rotate spacing",
    "tools.holder": "shape fillet role motion mass force tilt",
    "supports": "side box centre fix clamp plies",
    "grippers": "side direction tension stiffness plies",
    "areas": "green",
    "increments": "largest rows",
    "outputs": "pictures increments",
}
NONSENSE = ["5", "-1e200", "'x'", "''", "[]", "[1, 2]", "[[]]", "{}", "true", "nan", "1979-05-27"]


@pytest.mark.parametrize(
    ("table", "key"), [(table, key) for table, keys in PLACES.items() for key in keys.split()]
)
def test_nonsense_is_refused_but_never_a_traceback(table, key):
    """Every value in every place is either read or refused with one line."""
    head = f"[[{table}]]" if table in ("supports", "grippers") else f"[{table}]" * bool(table)
    lines = BASE.splitlines()
    if table == "tools":
        lines = [line for line in lines if line != f"[tools.{key}]"]
    at = lines.index(head) + 1 if head in lines else 0 if not head else len(lines)
    start = lines[:at] if head in lines or not head else [*lines, head]
    rest = [line for line in lines[at:] if not line.startswith((f"{key} =", f"[{key}]"))]
    refused = []
    for value in NONSENSE:
        try:
            read("\n".join([*start, f"{key} = {value}", *rest]))
        except InputError as error:
            refused.append(str(error))
    assert len(refused) > 3 or key == "name"
    assert [r for r in refused if not r.startswith("mine.toml: ") or "\n" in r] == []
