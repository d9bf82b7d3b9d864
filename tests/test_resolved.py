"""The scene in a result's folder, and other values for keys of a scene."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

import quasiform as qf
from quasiform.checks import InputError
from quasiform.console.cli import main
from quasiform.energy.weight import GRAVITY
from quasiform.scenes.overrides import overridden
from quasiform.scenes.resolved import resolved
from quasiform.scenes.scene_file import FOLDER, built_in, load
from quasiform.theory import heavy_elastica
from quasiform.toml_file import toml_text

NEW = Path(qf.__file__).parent / "console" / "new.toml"


def file_of(model):
    return dict(model.recipe.given)["file"]


@pytest.mark.parametrize("name", [*built_in(), "new"])
def test_a_resolved_scene_is_read_back_to_an_equal_scene(tmp_path, name):
    source = name if name != "new" else str(tmp_path / "new.toml")
    if name == "new":
        Path(source).write_text(NEW.read_text("utf-8"), "utf-8")
    changes = {"fabric.friction": 0.2, "increments.rows": 4.0}
    model = qf.forming(source, 45, size=25.0, travel=20.0, overrides=changes)
    text = resolved(model, {"increment": 2.5, "one_mesh": True})
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    again = qf.forming(str(tmp_path / "scene.toml"))
    assert resolved(again, {}) == text
    assert again.sheet.fabric == model.sheet.fabric
    assert (again.x0 == model.x0).all()
    assert again.name == model.name
    first, second = file_of(model), file_of(again)
    same = {"orientation": 45.0, "size": 25.0, "travel": 20.0, "law": model.sheet.fabric}
    same["increment"] = model.increment
    run = {"increment": 2.5, "one_mesh": True, "linear": "auto", "estimate": True, "draft": False}
    standings = {k: v for k, v in first.standings.items() if k != "travel"}
    assert second == replace(first, **same, run=run, standings=standings)


@pytest.fixture(scope="module")
def formed(tmp_path_factory):
    """Folder of a short run whose punch is a file, started by the command."""
    here = tmp_path_factory.mktemp("formed")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=75.0)
    ball.export(here / "ball.stl")
    text = (FOLDER / "hemisphere.toml").read_text("utf-8")
    punch = '[tools.punch]\nfile = "ball.stl"\nspacing = 8.0\n'
    start, end = text.index("[tools.punch]"), text.index("[tools.die]")
    (here / "part.toml").write_text(text[:start] + punch + text[end:], "utf-8")
    words = [str(here / "part.toml"), "--size", "30", "--travel", "4", "--no-estimate"]
    change = ["--set", "tools.holder.mass=8", "--set", "outputs.pictures=false"]
    assert main(["form", *words, *change, "--out", str(here / "out")]) == 0
    return here


def test_the_scene_of_a_result_repeats_it(formed, capsys):
    again = formed / "again"
    assert main(["form", str(formed / "out" / "scene.toml"), "--out", str(again)]) == 0
    assert (again / "scene.toml").read_text() == (formed / "out" / "scene.toml").read_text()
    for name in ("history.csv", "outline.csv"):  # the grid of the punch ends where the travel does
        tables = [
            np.loadtxt(folder / name, delimiter=",", skiprows=1)
            for folder in (formed / "out", again)
        ]
        assert_allclose(*tables, rtol=1e-6, atol=1e-6)
    assert main(["compare", str(again), str(formed / "out"), "--out", str(formed / "c")]) == 0
    assert "differ in" not in capsys.readouterr().out


def test_a_result_holds_what_was_run(formed):
    scene = tomllib.loads((formed / "out" / "scene.toml").read_text())
    assert scene["tools"]["holder"]["mass"] == 8.0
    assert scene["run"] == {
        "linear": "auto",
        "one_mesh": True,
        "estimate": False,
        "draft": False,
    }
    summary = json.loads((formed / "out" / "summary.json").read_text())
    files = [str(formed / name) for name in ("ball.stl", "part.toml")]
    assert list(summary["files"]) == files
    assert scene["files"].items() <= summary["files"].items()
    assert list(scene["files"]) == [str(formed / "ball.stl")]


def test_the_scene_of_a_draft_repeats_the_draft(tmp_path):
    words = ["--travel", "4", "--set", "outputs.pictures=false", "--no-estimate"]
    first, second = tmp_path / "a", tmp_path / "b"
    scene = ["hemisphere", "--size", "15", "--draft"]
    assert main(["form", *scene, *words, "--out", str(first)]) == 0
    assert main(["form", str(first / "scene.toml"), "--out", str(second)]) == 0
    for name in ("history.csv", "scene.toml"):
        assert (second / name).read_text() == (first / name).read_text()
    kept = json.loads((second / "summary.json").read_text())
    assert kept["triangles"] == json.loads((first / "summary.json").read_text())["triangles"]


def test_compare_lists_the_keys_in_which_two_scenes_differ(formed, capsys):
    words = [str(formed / "out" / "scene.toml"), "--set", "tools.holder.mass=5"]
    assert main(["form", *words, "--out", str(formed / "lighter")]) == 0
    both = [str(formed / "lighter"), str(formed / "out")]
    main(["compare", *both, "--out", str(formed / "d")])
    assert "differ in tools.holder.mass (5.0, 8.0)" in capsys.readouterr().out


def test_a_tool_that_has_changed_is_refused(formed, tmp_path, capsys):
    text = (formed / "out" / "scene.toml").read_text().replace(str(formed), str(tmp_path))
    (tmp_path / "scene.toml").write_text(text)
    trimesh.creation.icosphere(subdivisions=3, radius=74.0).export(tmp_path / "ball.stl")
    assert main(["form", str(tmp_path / "scene.toml"), "--dry-run"]) == 2
    error = capsys.readouterr().err
    assert "ball.stl has changed since this scene was written; remove [files]" in error


def test_resume_names_the_tool_that_has_changed(formed, tmp_path):
    trimesh.creation.icosphere(subdivisions=2, radius=75.0).export(tmp_path / "ball.stl")
    text = (formed / "part.toml").read_text()
    (tmp_path / "part.toml").write_text(text)
    stop = {"estimate": False, "out": tmp_path / "out", "callback": lambda progress: True}
    model = qf.forming(str(tmp_path / "part.toml"), size=30, travel=4)
    assert qf.solve(model, **stop).status == "stopped"
    trimesh.creation.icosphere(subdivisions=3, radius=75.0).export(tmp_path / "ball.stl")
    with pytest.raises(InputError, match=r"ball\.stl has changed since that run"):
        qf.solve(
            qf.Journal(tmp_path / "out", resume=True).model(), out=tmp_path / "out", resume=True
        )


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("tools.holder.mas", "unknown key 'mas': did you mean 'mass'?"),
        ("tools.holdr.mass", "there is no 'holdr' in the scene: did you mean 'holder'?"),
        ("grippers.1.box", "no 'grippers' in the scene: expected one of blank, tools, areas"),
        ("tool.holder.mass", "there is no 'tool' in the scene: did you mean 'tools'?"),
        ("travl", "unknown key 'travl': did you mean 'travel'?"),
        ("fabric.frictoin", "unknown key 'frictoin': did you mean 'friction'?"),
        ("fabric.shear.C_in", "unknown key 'C_in': did you mean 'C_ini'?"),
        ("name.far", "'name' is a value, not a table"),
        ("run.acuracy", "unknown key 'acuracy': did you mean 'accuracy'?"),
    ],
)
def test_a_misspelt_key_is_refused_with_a_suggestion(key, words):
    with pytest.raises(InputError) as refused:
        qf.forming("hemisphere", overrides={key: 8.0})
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("run.seeds", "x", "seeds must be a whole number, got 'x'"),
        ("run.seeds", True, "seeds must be a whole number, got True"),
        ("run.seeds", 0, "seeds must be at least 1, got 0"),
        ("run.seeds", 5000, "seeds must not exceed 1000, got 5000"),
        ("blank.shape", "x", "shape = 'x': expected one of rectangle, disc, polygon, file"),
        ("tools.punch.shape", "x", "shape = 'x': expected one of round punch, box punch, "),
        ("blank.holes.1.radius", 3.0, "there is no 'holes' in the scene"),
    ],
)
def test_a_value_that_cannot_be_is_refused_in_plain_words(key, value, words):
    with pytest.raises(InputError) as refused:
        qf.forming("hemisphere", overrides={key: value})
    assert words in str(refused.value)


def test_every_key_of_a_scene_can_be_given():
    changes = {"tools.holder.mass": 8.0, "orientation": 30, "blank.length": 300.0}
    model = qf.forming("hemisphere", size=25, overrides=changes | {"fabric.shear.I_lo": 0.8})
    holder = next(part for part in file_of(model).tools if part.role == "holder")
    assert (holder.mass, file_of(model).orientation) == (8.0, 30.0)
    assert model.sheet.fabric.shear.I_lo == 0.8
    assert "tools.holder.mass" not in file_of(model).standings  # it was assumed
    soft = qf.forming("hemisphere", law="best-fit", overrides={"fabric.friction": 0.1}, size=25)
    assert soft.sheet.fabric == replace(qf.Fabric.preset("best-fit"), friction=0.1)


def test_scenes_as_objects_take_other_values_too():
    scene = load("hemisphere")
    model = qf.forming(scene, size=25, overrides={"tools.punch.radius": 70.0})
    assert file_of(model).tools[0].geometry.numbers == (70.0,)


def test_entries_of_lists_are_counted_from_one():
    table = {"supports": [{"side": "-x"}, {"side": "+x"}]}
    assert overridden(table, {"supports.2.side": "+y"})["supports"][1] == {"side": "+y"}
    assert table["supports"][1] == {"side": "+x"}
    with pytest.raises(InputError, match="expected a number from 1 to 2, got '3'"):
        overridden(table, {"supports.3.side": "+y"})
    with pytest.raises(InputError, match="expected a number from 1 to 2, got '0'"):
        overridden(table, {"supports.0.side": "+y"})


def test_a_result_is_a_table_in_a_notebook():
    result = qf.solve(qf.off_axis_tension(size=40, displacement=5), estimate=False)
    page = result._repr_html_()
    assert page.startswith("<table><tr><th>oat-45</th><th>completed</th>")
    assert f"<td>force_N</td><td>{result.force:.4g} N</td>" in page
    assert callable(result.summary)


def dome(path):
    """An open surface: a hemisphere of 40 mm on a plane, its normals up."""
    x = np.linspace(-80.0, 80.0, 81)
    r = np.hypot(*np.meshgrid(x, x, indexing="ij"))
    z = np.where(r < 60, 15 * (1 + np.cos(np.pi * r / 60)), 0.0)
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), z], axis=-1).reshape(-1, 3)
    first = (np.arange(80)[:, None] * 81 + np.arange(80)).ravel()
    corners = [np.add.outer(corner, first) for corner in ([0, 81, 1], [82, 1, 81])]
    trimesh.Trimesh(points, np.hstack(corners).T, process=False).export(path)


MATCHED = """
travel = 30.2
[blank]
shape = "rectangle"
length = 120.0
width = 120.0
[tools.punch]
file = "dome.stl"
flip = true
offset = 1.2
[tools.die]
file = "dome.stl"
z = 0.0
"""


def test_matched_tools_from_one_surface_have_the_gap_of_their_offset(tmp_path):
    dome(tmp_path / "dome.stl")
    # the die's top is the first to touch: it stands 30 mm over the plane
    text = MATCHED.replace("z = 0.0", "z = -30.0").replace("travel = 30.2", "travel = 31.0")
    (tmp_path / "scene.toml").write_text(text)
    model = qf.forming(str(tmp_path / "scene.toml"), size=15, overrides={"travel": 29.0})
    punch, die = model.tools[0]
    x = np.linspace(-50.0, 50.0, 23)
    points = np.stack([*np.meshgrid(x, x), np.full((23, 23), -30.0)], axis=-1).reshape(-1, 3)
    for _ in range(4):  # onto the die
        points[:, 2] -= die.gap(points)
    closed = punch.height + 30.0  # where both are in the axes of the file
    gap = punch.gap(points, -closed)
    assert_allclose(gap, 1.2, atol=0.05)
    assert "moved by 1.2 mm into the tool" in str(model.description)
    assert "warning" not in str(model.description)
    assert punch.height == pytest.approx(model.sheet.fabric.thickness - 1.2, abs=1e-6)


def test_a_notch_is_a_hole_across_the_edge():
    hole = {"shape": "disc", "radius": 20.0, "centre": [155.0, 0.0]}
    model = qf.forming("hemisphere", size=25, overrides={"blank.holes": [hole]})
    assert 310**2 - model.sheet.whole[0].areas.sum() == pytest.approx(np.pi * 200, rel=0.3)
    strip = {"shape": "rectangle", "length": 400.0, "width": 20.0}
    with pytest.raises(InputError, match=r"hole 1 near \(0, 0\) divides the blank"):
        qf.forming("hemisphere", size=25, overrides={"blank.holes": [strip]})
    far = hole | {"centre": [200.0, 0.0]}
    with pytest.raises(InputError, match="a notch is a hole that crosses the edge"):
        qf.forming("hemisphere", size=25, overrides={"blank.holes": [far]})


def test_a_gripper_with_a_box_pulls_away_from_the_nearest_side():
    box = {"box": [140.0, -30.0, 155.0, 30.0], "tension": 10.0}
    model = qf.forming("hemisphere", size=25, overrides={"grippers": [box]})
    (grip,) = [term for term in model.terms if type(term).__name__ == "Grip"]
    pull = grip.gradient(model.x0).sum(0) if hasattr(grip, "gradient") else None
    assert_allclose(-np.reshape(pull, (-1, 3)).sum(0), [10.0, 0.0, 0.0], atol=1e-9)
    middle = box | {"box": [-20.0, -20.0, 20.0, 20.0]}
    with pytest.raises(InputError, match="direction missing: it is not at a side of the blank"):
        qf.forming("hemisphere", size=25, overrides={"grippers": [middle]})


@pytest.mark.parametrize("key", ["layers", "blank.layers"])
def test_what_is_not_modelled_is_said_as_such(key):
    with pytest.raises(InputError, match="is not possible: layers are given"):
        qf.forming("hemisphere", overrides={key: 2})


OVERHANG = {
    "gravity": True,
    "symmetry": "none",
    "blank": {"shape": "disc", "radius": 250.0},
    "tools": {"punch": {"shape": "plane", "z": -300.0}},
    "supports": [{"centre": [0.0, 0.0], "radius": 90.0, "fix": "xyz"}],
}


def test_a_sheet_that_overhangs_starts_from_an_equilibrium_under_its_weight(tmp_path):
    (tmp_path / "disc.toml").write_text(toml_text({"travel": 5.0, **OVERHANG}))
    model = qf.forming(str(tmp_path / "disc.toml"), size=20.0)
    result = qf.solve(model, estimate=False)
    assert (result.reason, result.rescues["weight in steps"]) == ("", 1)
    # the travel does no work here: the balance is relative to that of the weight
    assert (result.force, result.snaps) == (0.0, [])
    assert result.energy_balance < 1e-6
    assert result.certified.converged
    fabric, length = model.sheet.fabric, 160.0
    weight = 1e-6 * GRAVITY * fabric.areal_weight
    for end, stiffness in (((250, 0), fabric.bending_warp), ((0, 250), fabric.bending_weft)):
        drop = length * heavy_elastica(weight * length**3 / stiffness)[1]  # 96.8 and 91.6 mm
        node = np.linalg.norm(result.blank.nodes - end, axis=1).argmin()
        assert_allclose(-result.positions()[node, 2], drop, rtol=0.04)


def test_a_strip_clamped_in_a_grip_hangs_as_the_heavy_elastica(tmp_path):
    """The overhang of the disc in a strip, k = 8; the grip is a clamped part of the strip."""
    fabric = qf.Fabric()
    length = (8.0 * fabric.bending_warp / (1e-6 * GRAVITY * fabric.areal_weight)) ** (1 / 3)
    size = length / 20  # 8.3 mm
    blank = {"shape": "rectangle", "length": length + 4 * size, "width": 8.1 * size}
    blank |= {"centre": [0.5 * length - 2 * size, 0.0], "size": 0.98 * size}
    grip = {"box": [-5 * size, -100.0, 1e-3, 100.0], "clamp": True}
    table = {"travel": 5.0, "gravity": True, "blank": blank, "tools": OVERHANG["tools"]}
    (tmp_path / "strip.toml").write_text(toml_text(table | {"supports": [grip]}))
    result = qf.solve(qf.forming(str(tmp_path / "strip.toml")), estimate=False)
    assert result.certified.converged
    x, drop, _ = heavy_elastica(8.0)
    end = result.positions()[result.blank.nodes[:, 0] > length - 1e-6].mean(0)
    assert_allclose([end[0], -end[2]], [length * x, length * drop], rtol=0.005)
