"""The command line: what it refuses, what it writes, what it says, how it exits."""

import ast
import csv
import inspect
import io
import json
import pickle
import pydoc
import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import asdict, replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull

import quasiform as qf
from quasiform.console.cli import main
from quasiform.console.progress import LiveProgress, progress
from quasiform.draw import plot
from quasiform.scenes import scene_file
from quasiform.solve import asked, levels

ROOT = Path(__file__).parents[1]
OAT = ["oat", "--size", "40", "--displacement", "5"]
FORM = ["form", "hemisphere", "--size", "38", "--travel", "5"]
PICTURES = {"shear_angle.png", "history.png", "doubt.png"}
FILES = set("summary.json history.csv outline.csv result.vtu result.pvd".split()) | PICTURES
FIELDS = set(
    "shear_angle warp weft E11 E22 S12 shear_stability doubt contact_pressure displacement".split()
)
KEYS = set(
    "case version parameters status reached_mm reason wall_s linear_solves increments nodes "
    "triangles dofs model force_N shear_angle_deg error_estimate equilibrium doubtful_share".split()
)
FORM_KEYS = KEYS | set(
    "draw_in_mm areas max_penetration_mm chord_penetration_mm fibre_strain_max collapse rescues "
    "certified resting_tools wrinkles".split()
)
OAT_COLUMNS = (
    "displacement_mm force_N shear_angle_center_deg shear_angle_max_deg E11_center E22_center "
    "linear_solves force_error_N".split()
)
FORM_COLUMNS = (
    "travel_mm force_N holder_force_N shear_angle_max_deg draw_in_mm linear_solves".split()
)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty working directory for every test."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def undrawn(monkeypatch):
    """Write placeholders for the pictures, where a test is about other things."""

    def save(result, folder):
        for name in PICTURES:
            Path(folder, name).write_bytes(b"")

    monkeypatch.setattr(plot, "save_pictures", save)


@pytest.fixture
def unsolved(monkeypatch):
    """Fail where a test's input is not refused before the solve."""

    def solve(*arguments, **named):
        raise AssertionError("solved")

    monkeypatch.setattr(asked, "solve", solve)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def squeezed(text):
    """Text with one space where there are several."""
    return re.sub(" +", " ", text)


def assert_refused(capsys, argv, *words):
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("quasiform: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert [word for word in words if word not in err] == []


# Wrong input


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", ["expected a command: oat or form"]),
        ("oats", ['Unknown command "oats"', 'Did you mean "oat"?']),
        ("form", ["SCENE requires an argument"]),
        ("form hemispere", ["unknown scene 'hemispere'", "did you mean 'hemisphere'?"]),
        ("form missing.toml", ["missing.toml", "No such file"]),
        ("oat --law loking", ["unknown law 'loking'", "did you mean 'locking'?"]),
        ("oat --law missing.toml", ["missing.toml", "No such file"]),
        ("oat --linear superl", ["--linear", "'superl'", "did you mean 'superlu'?"]),
        ("form hemisphere --symmetry non", ["--symmetry", "'non'", "did you mean 'none'?"]),
        ("oat --sise 5", ["unknown option '--sise'", "did you mean '--size'?"]),
        ("oat --sym 5", ["unknown option '--sym'", "expected one of --angle"]),
        ("oat --dis 5", ["unknown option '--dis'"]),
        ("oat 5", ["unexpected argument '5'"]),
        ("oat --size", ["--size requires an argument"]),
        ("oat --angle 20", ["angle must lie between 26.6 and 63.4", "got 20"]),
        ("oat --angle 70", ["angle must lie between 26.6 and 63.4", "got 70"]),
        ("oat --size 161", ["size must not exceed the width 160", "got 161"]),
        ("form hemisphere --size 39", ["size must not exceed an eighth", "got 39"]),
        ("form hemisphere --travel 76", ["travel must not exceed 75 mm", "got 76"]),
        ("oat --out=", ["--out", "expected the name of a file or folder"]),
    ],
)
def test_wrong_words_are_refused(capsys, here, line, words):
    assert_refused(capsys, line.split(), *words)
    assert list(here.iterdir()) == []


def test_a_refusal_is_one_line_whatever_was_given(capsys):
    assert_refused(capsys, ["oat", "--law", "two\nlines"], "unknown law 'two lines'")


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize("value", ["-5", "0", "nan", "inf", "five", "1e999", ""])
@pytest.mark.parametrize(
    "line",
    [
        *(f"oat --{name}" for name in ("length", "width", "displacement", "size", "increment")),
        *(f"form hemisphere --{name}" for name in ("travel", "size", "increment")),
    ],
)
def test_no_positive_number_is_refused(capsys, here, line, value):
    *argv, option = line.split()
    assert_refused(
        capsys, [*argv, option, value], f"{option}: expected a positive number, got '{value}'"
    )
    assert list(here.iterdir()) == []


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize("value", ["nan", "inf", "left"])
@pytest.mark.parametrize("line", ["oat --angle", "form hemisphere --orientation"])
def test_no_angle_is_refused(capsys, line, value):
    expected = f"{line.split()[-1]}: expected a number of degrees, got '{value}'"
    assert_refused(capsys, [*line.split(), value], expected)


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("thicknes = 1.0", ["unknown key 'thicknes'", "did you mean 'thickness'?"]),
        ("[shear]\nC_inni = 1.0", ["[shear]", "unknown key 'C_inni'", "did you mean 'C_ini'?"]),
        ("[shear]\nC_ini = -1.0", ["[shear]", "C_ini must be a positive number", "-1.0"]),
        ("[shear]\nC_ini = 'stiff'", ["[shear]", "C_ini must be a positive number", "'stiff'"]),
        ("thickness = = 1", ["line 1"]),
    ],
)
def test_a_wrong_law_file_is_refused(capsys, here, text, words):
    Path("mine.toml").write_text(text, encoding="utf-8")
    assert_refused(capsys, ["oat", "--law", "mine.toml"], "mine.toml: ", *words)
    assert [path.name for path in here.iterdir()] == ["mine.toml"]


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[tools.punch]",
            "[tools.punch]\nradios = 1",
            ["[tools.punch]", "unknown key 'radios'", "'radius'?"],
        ),
        ("[areas]", "[aeras]", ["unknown key 'aeras'", "did you mean 'areas'?"]),
        ("value = 5.0", "value = -5.0", ["[tools.holder] mass must be", "-5.0"]),
        ("value = 5.0", "value = nan", ["[tools.holder] mass must be", "nan"]),
        ("value = 5.0", "valeu = 5.0", ["[tools.holder.mass]", "unknown key 'valeu'", "'value'?"]),
        ('"kg", standing = "assumed"', '"kg", standing = "sure"', ["tools.holder.mass", "'sure'"]),
        ('"round punch"', '"round bunch"', ["[tools.punch]", "did you mean 'round punch'?"]),
        ("value = 310.0", "value = 100.0", ["does not reach under the blank holder"]),
        ("value = 80.0", "value = 60.0", ["punch and die leave 0.00 mm"]),
    ],
)
def test_a_wrong_scene_file_is_refused(capsys, old, new, words):
    text = (scene_file.FOLDER / "hemisphere.toml").read_text(encoding="utf-8")
    assert old in text
    Path("mine.toml").write_text(text.replace(old, new), encoding="utf-8")
    about_the_file = not any("leave" in word or "reach" in word for word in words)
    argv = ["form", "mine.toml", "--size", "12"]
    assert_refused(capsys, argv, *["mine.toml: "] * about_the_file, *words)


@pytest.mark.usefixtures("unsolved")
def test_an_unwritable_out_is_refused_before_the_solve(capsys, here):
    Path("file").write_text("mine", encoding="utf-8")
    assert_refused(capsys, [*OAT, "--out", "file"], "cannot write to file: it is not a folder")
    assert_refused(capsys, [*OAT, "--out", "file/sub"], "cannot write to file/sub: ")
    assert contents(here) == {"file": b"mine"}


def test_a_missing_linear_solver_is_refused_without_a_trace(capsys, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymklpardiso", None)
    assert main([*OAT, "--linear", "pardiso"]) == 2
    assert "pip install 'quasiform[fast]'" in capsys.readouterr().err
    assert list(here.iterdir()) == []


@pytest.mark.usefixtures("unsolved")
def test_a_model_too_large_for_the_memory_is_refused(capsys, monkeypatch):
    def too_large(*arguments):
        raise MemoryError

    monkeypatch.setattr(qf, "off_axis_tension", too_large)
    assert_refused(capsys, OAT, "not enough memory", "larger --size")


# Results


@pytest.mark.usefixtures("unsolved")
@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (
            OAT,
            [
                "oat-45: 77 nodes, 128 triangles, 134 dofs",
                "bending of warp and weft lines in the plane: in_plane_bending is 0.03",
            ],
        ),
        (FORM, ["hemisphere-0: 25 nodes, 32 triangles", "a quarter: ", "weight of the sheet left"]),
        (
            "form box --size 20".split(),
            [
                "box-0: 81 nodes, 128 triangles",
                "travel 50 mm",
                "a quarter: ",
                "nodes and mid-edges",
            ],
        ),
        (
            "form tetrahedron --size 30".split(),
            ["tetrahedron-0: ", "travel 80 mm", "a half: ", "at the plane along the warp;"],
        ),
        (
            "form tetrahedron --size 30 --orientation 45".split(),
            ["tetrahedron-45: ", "the whole blank: no plane along the fibres mirrors it"],
        ),
        ([*FORM, "--symmetry", "none"], ["81 nodes, 128 triangles", "symmetry is switched off"]),
        ([*FORM, "--symmetry", "half"], ["45 nodes, 64 triangles", "a half: "]),
        ([*FORM, "--law", "best-fit"], ["fabric: MD600 best-fit"]),
    ],
)
def test_a_dry_run_tells_the_model_and_writes_nothing(capsys, here, argv, words):
    assert main([*argv, "--dry-run", "--out", "out"]) == 0
    out, err = capsys.readouterr()
    assert [word for word in words if word not in out] == []
    assert out.startswith("building the model of " if argv[0] == "form" else "oat-")
    assert "writing" not in out
    assert err == ""
    assert list(here.iterdir()) == []


def assert_complete(folder, keys, columns):
    """Check the files of a run against the contract and against each other."""
    names = set(contents(folder))
    increments = sorted(name for name in names if name.startswith("increment_"))
    assert names - {"scene.toml"} == FILES | set(increments)
    assert ("scene.toml" in names) == ("draw_in_mm" in keys)
    with (folder / "outline.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["loop", "x_mm", "y_mm", "z_mm"]
    assert rows[0] == rows[-1]
    assert len(rows) > 8

    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert keys - set(summary) == set()
    assert summary["case"] == folder.name
    assert summary["status"] == "completed"
    assert summary["reason"] == ""
    assert summary["reached_mm"] == 5.0
    assert set(summary["shear_angle_deg"]) == {"max", "p99", "mean"}
    assert set(summary["error_estimate"]) == {"shear_angle_deg", "force_N", "path_deg", "path_N"}
    assert {"residual_relative", "energy_balance_relative"} <= set(summary["equilibrium"])
    assert summary["shear_angle_deg"]["max"] > 0

    with (folder / "history.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == columns
    history = np.array(rows, dtype=float)
    assert_allclose(history[[0, -1], 0], [0.0, 5.0])
    assert_allclose(history[-1, 1], summary["force_N"], rtol=1e-6)

    sets = ET.parse(folder / "result.pvd").getroot().findall("Collection/DataSet")
    assert [entry.get("file") for entry in sets] == increments
    assert_allclose([float(entry.get("timestep")) for entry in sets], history[:, 0])
    for name in ("result.vtu", *increments):
        mesh = meshio.read(folder / name)
        assert FIELDS - set(mesh.point_data) - set(mesh.cell_data) == set()
        assert mesh.points.shape[1] == 3
    mesh = meshio.read(folder / "result.vtu")
    gamma = mesh.cell_data["shear_angle"][0]
    assert len(gamma) == len(mesh.cells_dict["triangle"])
    assert_allclose(np.abs(gamma).max(), summary["shear_angle_deg"]["max"])
    for family in ("warp", "weft"):
        assert_allclose(np.linalg.norm(mesh.cell_data[family][0], axis=1), 1.0)
    for picture in PICTURES:
        assert (folder / picture).read_bytes().startswith(b"\x89PNG")
    return summary, mesh


def test_oat_writes_every_file_into_a_new_folder(capsys, here):
    assert main(OAT) == 0
    out, err = capsys.readouterr()
    assert out.startswith("writing to oat-45\n")
    summary, mesh = assert_complete(here / "oat-45", KEYS, OAT_COLUMNS)
    assert len(mesh.cells_dict["triangle"]) == summary["triangles"] == 128
    # in the middle γ follows the pure-shear kinematics sin γ = (1 + u/(l0 - w0))² - 1, but for the
    # little that the fibres give
    sin_gamma = np.sin(np.radians(summary["shear_angle_deg"]["max"]))
    assert_allclose(sin_gamma, (1 + 5 / 160) ** 2 - 1, rtol=2e-3)
    assert "completed at 5 of 5 mm" in out
    rows = squeezed(out)
    assert f" force {summary['force_N']:.4g} ±" in rows
    assert " trust no limit was found" in rows
    assert "certified" not in rows
    work = ", ".join(f"{times} at {mesh}" for mesh, times in summary["factorisations"].items())
    assert f" factorisations {work} (" in rows
    assert " converged yes" in rows
    assert [name for name in FILES if name not in out] == []
    coarser = "error of the mesh: the same at 56 mm"
    lines = err.splitlines()
    assert sum(line.startswith("travel ") for line in lines) == summary["increments"]
    start = lines.index(coarser)
    assert lines[start - 1].startswith("travel 5 of 5, ")
    assert all(line.startswith(f"{coarser}: travel ") for line in lines[start + 1 : -1])
    assert lines[-2].startswith(f"{coarser}: travel 5 of 5, ")
    assert lines[-1] == "error of the mesh: the end at 20 mm"

    first = contents(here / "oat-45")
    assert main(OAT) == 0
    assert capsys.readouterr().out.startswith("writing to oat-45-2\n")
    assert contents(here / "oat-45") == first
    assert {path.name for path in here.iterdir()} == {"oat-45", "oat-45-2"}


def test_form_writes_every_file_into_out(capsys, here):
    assert main([*FORM, "--increment", "2", "--out", "a/hemisphere-0"]) == 0
    out, _ = capsys.readouterr()
    assert out.startswith("writing to a/hemisphere-0\n")
    summary, mesh = assert_complete(here / "a/hemisphere-0", FORM_KEYS, FORM_COLUMNS)
    assert len(mesh.cells_dict["triangle"]) == 4 * summary["triangles"] == 128
    assert set(summary["draw_in_mm"]) == {"+x", "-x", "+y", "-y"}
    assert set(summary["areas"]) == {"green", "blue", "pink"}
    assert summary["parameters"]["orientation"] == 0.0
    assert " draw-in +x " in squeezed(out)
    assert " areas green " in squeezed(out)
    assert len(list((here / "a/hemisphere-0").glob("increment_*.vtu"))) == 4  # at 0, 2, 4 and 5
    assert [path.name for path in here.iterdir()] == ["a"]


def test_options_reach_the_scene_and_the_solver(here, monkeypatch):
    given = []

    def solve(scene, callback, estimate, increment, linear, out):
        given.append((scene, increment, linear, estimate))
        raise KeyboardInterrupt

    monkeypatch.setattr(asked, "solve", solve)
    qf.Fabric(name="mine").save("mine.toml")
    numbers = "--angle 50 --length 300 --width 120 --displacement 7 --size 60"
    assert main(f"oat {numbers} --law mine.toml --increment 3 --linear superlu".split()) == 3
    turned = "--orientation 45 --size 31 --travel 9 --symmetry none --law best-fit"
    assert main(f"form hemisphere {turned} --no-estimate".split()) == 3
    (oat, *oat_solver), (form, *form_solver) = given
    assert oat.parameters.pop("fabric") == asdict(oat.sheet.fabric)
    assert oat.parameters == {
        **{"angle": 50, "length": 300, "width": 120, "displacement": 7, "size": 60},
        "law": "mine",
        "mesh": "fibre",
    }
    assert oat_solver == [3, "superlu", True]
    assert (
        form.parameters.items()
        >= {
            **{"scene": "hemisphere", "orientation": 45, "size": 31, "travel": 9},
            **{"symmetry": "none", "law": "MD600 best-fit"},
        }.items()
    )
    assert form_solver == [None, "auto", False]


MINE = """\
name = "my tool"
travel = 2.0
law = "best-fit"
symmetry = "none"

[blank]
shape = "disc"
radius = 150.0
orientation = 90.0
size = 37.0

[tools.punch]
shape = "round punch"
radius = 75.0

[tools.die]
shape = "round opening"
radius = 80.0
fillet = 10.0

[tools.holder]
shape = "round opening"
radius = 80.0
fillet = 10.0
mass = 5.0

[increments]
largest = 1.0
rows = 1.0

[outputs]
pictures = false
increments = false
"""


def test_a_sheet_that_friction_cannot_hold_ends_with_status_3(capsys, here):
    pull = "box = [100, -150, 150, 150]\ndirection = [1, 0]\ntension = 40.0"
    Path("mine.toml").write_text(f"{MINE}[[grippers]]\n{pull}\n", encoding="utf-8")
    assert main("form mine.toml --size 30 --travel 1 --out pulled".split()) == 3
    reason = "at the start: slides off: friction cannot hold it"
    assert f"stopped at 0 of 1 mm: {reason}\n" in capsys.readouterr().out
    assert json.loads(Path("pulled/summary.json").read_text())["reason"] == reason


def test_what_the_command_leaves_out_is_taken_from_the_file(monkeypatch):
    scenes = []

    def solve(scene, *arguments, **named):
        scenes.append(scene)
        raise KeyboardInterrupt

    monkeypatch.setattr(asked, "solve", solve)
    monkeypatch.setattr(asked, "refine", solve)
    Path("mine.toml").write_text(MINE, encoding="utf-8")
    assert main(["form", "mine.toml"]) == 3
    given = "--orientation 0 --law locking --size 30 --travel 1 --symmetry auto"
    assert main(["form", "mine.toml", *given.split()]) == 3
    file, line = scenes
    told = [
        [scene.parameters[key] for key in ("orientation", "law", "size", "travel", "symmetry")]
        for scene in scenes
    ]
    assert told[0] == [90.0, "MD600 best-fit", 37.0, 2.0, "none"]
    assert told[1] == [0.0, "MD600 locking", 30.0, 1.0, "auto"]
    assert (file.sheet.blank.mirror, line.sheet.blank.mirror) == ((), ("x", "y"))
    assert file.parameters["scene"] == "mine.toml"


def test_a_file_says_which_outputs_it_wants(capsys, here):
    Path("mine.toml").write_text(MINE, encoding="utf-8")
    assert main(["form", "mine.toml"]) == 0
    out, _ = capsys.readouterr()
    assert out.startswith("writing to my-tool-90\n")
    assert set(contents(here / "my-tool-90")) == (FILES | {"scene.toml"}) - PICTURES
    (told,) = re.findall(r"files in my-tool-90: (.*)", out)  # and no others are told
    assert {name for name in FILES if name in told} == FILES - PICTURES
    assert "increment_" not in Path("my-tool-90/result.pvd").read_text(encoding="utf-8")
    with Path("my-tool-90/history.csv").open(encoding="utf-8", newline="") as file:
        history = list(csv.DictReader(file))
    assert [float(row["travel_mm"]) for row in history] == [0.0, 1.0, 2.0]
    summary = json.loads(Path("my-tool-90/summary.json").read_text(encoding="utf-8"))
    assert set(summary["draw_in_mm"]) == {"+x", "-x", "+y", "-y"}
    assert "tilt_deg" in summary["resting_tools"]["blank holder"]


@pytest.mark.usefixtures("undrawn")
def test_an_existing_result_is_refused_and_stays(capsys, here):
    assert main([*OAT, "--out", "out"]) == 0
    before = contents(here / "out")
    capsys.readouterr()
    assert_refused(capsys, [*FORM, "--out", "out"], "out holds a result already", "--force")
    assert contents(here / "out") == before


@pytest.mark.parametrize("name", [*sorted(FILES), "increment_0003.vtu"])
@pytest.mark.usefixtures("unsolved")
def test_a_part_of_a_result_is_not_overwritten_either(capsys, here, name):
    Path("out").mkdir()
    Path("out", name).write_text("mine", encoding="utf-8")
    assert_refused(capsys, [*OAT, "--out", "out"], "out holds a result already", name)
    assert contents(here / "out") == {name: b"mine"}


def test_force_replaces_the_result_and_nothing_else(here):
    assert main([*OAT, "--increment", "1", "--out", "out"]) == 0
    Path("out", "notes.txt").write_text("mine", encoding="utf-8")
    before = contents(here / "out")
    assert "increment_0005.vtu" in before
    assert main([*OAT[:-1], "4", "--increment", "2", "--out", "out", "--force"]) == 0
    after = contents(here / "out")
    assert set(before) - set(after) == {f"increment_000{i}.vtu" for i in (3, 4, 5)}
    assert {name for name in after if after[name] == before[name]} <= {
        "notes.txt",
        "increment_0000.vtu",  # the flat sheet in both
    }
    assert after["notes.txt"] == b"mine"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("place", ["solve", "save"])
def test_an_interrupted_run_leaves_what_was_there(capsys, here, monkeypatch, place):
    def interrupted(*arguments, **named):
        raise KeyboardInterrupt

    assert main([*OAT, "--out", "out"]) == 0
    before = contents(here / "out")
    monkeypatch.setattr(
        *((asked, "solve") if place == "solve" else (qf.Result, "summary")), interrupted
    )
    capsys.readouterr()
    assert main([*OAT, "--out", "out", "--force"]) == 3
    assert (
        "quasiform: interrupted: only what was written before is kept\n" in capsys.readouterr().err
    )
    assert contents(here / "out") == before
    assert main([*OAT, "--out", "new/folder"]) == 3
    assert [path.name for path in here.iterdir()] == ["out"]


def test_a_failing_picture_does_not_cost_the_numbers(here, monkeypatch):
    def failing(result, folder):
        raise ZeroDivisionError

    monkeypatch.setattr(plot, "save_pictures", failing)
    with pytest.raises(ZeroDivisionError):
        main([*OAT, "--out", "out"])
    assert {"summary.json", "history.csv", "result.vtu", "result.pvd"} <= set(
        contents(here / "out")
    )


def test_a_full_disk_is_told_in_one_line(capsys, monkeypatch):
    def full(result, folder, since=0):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(qf.Result, "write", full)
    assert main([*OAT, "--out", "out"]) == 3
    said = capsys.readouterr().out
    assert "stopped at 0 of 5 mm: cannot write to out: No space left on device\n" in said


@pytest.mark.usefixtures("undrawn")
def test_a_stopped_run_is_written_says_so_and_exits_3(capsys, monkeypatch):
    solve = qf.solve

    def stopped(scene, *arguments, **named):
        collapse = {"travel_mm": 4.5, "at": [1.0, -2.0], "shear_angle_deg": 85.5, "triangles": 2}
        result = replace(solve(scene), reason="the sheet is torn", collapse=collapse)
        result.save(named["out"].folder)
        return result

    monkeypatch.setattr(asked, "solve", stopped)
    assert main([*OAT, "--out", "out"]) == 3
    out = squeezed(capsys.readouterr().out)
    assert "stopped at 5 of 5 mm: the sheet is torn" in out
    assert " collapse from 4.5 mm on, first at X = (1.0, -2.0) mm, 85.5 deg" in out
    assert " trust limited: stopped early; collapsed from 4.5 mm on" in out
    assert FILES <= set(contents(Path("out")))
    summary = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))
    assert summary["status"] == "stopped"
    assert summary["reason"] == "the sheet is torn"


@pytest.mark.usefixtures("undrawn")
def test_the_error_estimate_is_told_if_there_is_one(capsys, monkeypatch):
    estimate, solve = {"shear_angle_deg": 0.25, "force_N": 112.3}, qf.solve
    estimate["shear_angle_mean_deg"] = 0.0
    monkeypatch.setattr(
        asked, "solve", lambda scene, *_, **__: replace(solve(scene), estimate=estimate)
    )
    assert main(OAT) == 0
    told = capsys.readouterr().out
    assert "± 110 N" in told
    assert "± 0.25, mean" in told
    assert "± 0 deg" in told


# Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def terminal_on_stderr(monkeypatch):
    """Put a terminal of 90 columns in the place of stderr, and return it."""
    for name, value in {"TERM": "xterm", "COLUMNS": "90", "LINES": "20"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stderr", Terminal())
    return sys.stderr


STEP = qf.Progress(
    travel=20.0, goal=80.0, residual=2e-5, force=1.0, contacts=7, linear_solves=9, elapsed=65.0
)
WORDS = "travel 20 of 80, 1:05 elapsed, about 16:15 left, residual 2.0e-05, 7 contacts"


def test_progress_is_a_line_in_a_log(capsys):
    progress(STEP)
    progress(replace(STEP, travel=80.0, contacts=0, elapsed=3725.4))
    assert capsys.readouterr().err.splitlines() == [
        WORDS,
        "travel 80 of 80, 1:02:05 elapsed, residual 2.0e-05",
    ]


def test_progress_is_a_bar_on_a_terminal(monkeypatch):
    terminal = terminal_on_stderr(monkeypatch)
    progress(STEP)
    progress(replace(STEP, travel=80.0))
    plain = re.sub(r"\x1b\[[0-9;]*m", "", terminal.getvalue())
    first, last = plain.split("\r", 1)
    assert WORDS in first
    assert last.endswith("\n")
    assert set(last.split(" ")[0]) == {"━"}
    assert len(first) == len(last.rstrip("\n")) == 89  # nothing of the first is left over


def test_the_live_bar_gives_the_cursor_back(capsys, monkeypatch):
    def failing(scene, callback, *arguments, **named):
        callback(STEP)
        raise KeyboardInterrupt

    monkeypatch.setattr(asked, "solve", failing)
    terminal = terminal_on_stderr(monkeypatch)
    assert main(OAT) == 3
    drawn = terminal.getvalue()
    assert "travel 20 of 80" in drawn
    assert drawn.index("\x1b[?25l") < drawn.index("\x1b[?25h") < drawn.index("interrupted")


def test_the_live_bar_is_lines_in_a_log(capsys):
    with LiveProgress(80.0) as callback:
        callback(STEP)
        callback.stage("the end on a mesh of 5 mm")
    assert capsys.readouterr().err == f"{WORDS}\nthe end on a mesh of 5 mm\n"


# Installed, and as printed in README.md


def run(*argv):
    command = [sys.executable, "-m", "quasiform", *argv]
    beside = Path(qf.__file__).parents[1]  # the code under test, wherever another is installed
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=beside)


def test_the_module_runs_as_a_program():
    done = run(*OAT, "--dry-run")
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.startswith("oat-45: 77 nodes")
    refused = run("oat", "--size", "nan")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("quasiform: ")
    assert refused.stderr.endswith("--size: expected a positive number, got 'nan'\n")


def test_help_and_version_exit_0(capsys):
    for option in ("--version", "--help"):
        assert main([option]) == 0
        assert capsys.readouterr().out.strip()


def blocks(language, page="README.md"):
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


@pytest.mark.usefixtures("unsolved")
def test_the_commands_of_the_readme_are_accepted(capsys, here):
    pytest.importorskip("igl")
    part = blocks("toml", "docs/how-to/own-part.md")[0]
    campaign = blocks("toml", "docs/how-to/own-fabric.md")[0]
    (here / "my-part.toml").write_text(part, encoding="utf-8")
    u = np.linspace(0.0, 30.0, 40)
    table = "\n".join(["u [mm];F [N]", *(f"{a:.4f};{4 * a**0.5:.4f}" for a in u)])
    for name in ("my-test", "oat-1", "oat-2", "oat-3"):
        (here / f"{name}.csv").write_text(table, encoding="utf-8")
    rows = [f"{k};{a:.4f};{4e-3 * a**0.5:.7f}" for k, a in enumerate(u)]
    (here / "frame.csv").write_text("\n".join(["no;Way (mm);F", *rows]), encoding="utf-8")
    moments = "curvature [1/m],moment [N]\n2.39,0.2849\n8.86,0.344\n17.7,0.375\n"
    (here / "moment.csv").write_text(moments, encoding="utf-8")
    (here / "my-fabric.toml").write_text(campaign, encoding="utf-8")
    a, z = np.radians(np.arange(0, 360, 10)), np.radians(np.arange(-80, 81, 10))
    ring = np.stack(
        np.broadcast_arrays(
            np.cos(a) * np.cos(z[:, None]), np.sin(a) * np.cos(z[:, None]), np.sin(z)[:, None]
        ),
        axis=-1,
    )
    ball = ConvexHull(np.vstack([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]]))
    turned = np.linalg.det(ball.points[ball.simplices]) < 0
    ball.simplices[turned] = ball.simplices[turned][:, ::-1]
    meshio.write(
        here / "punch.stl", meshio.Mesh(50.0 * ball.points, [("triangle", ball.simplices)])
    )
    pages = ("README.md", "docs/reference/command-line.md")
    lines = [line for page in pages for block in blocks("sh", page) for line in block.splitlines()]
    commands = [
        match[1]
        for line in lines
        if (match := re.search(r"\bquasiform ((oat|form|identify).*)", line))
    ]
    assert len(commands) >= 10
    for command in [*commands, "identify my-fabric.toml"]:
        words = shlex.split(command.replace("--dry-run", ""))
        assert main([*words, "--dry-run"]) == 0, capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_the_script_of_the_readme_runs(monkeypatch):
    (script,) = blocks("python")
    (recorded,) = blocks("python", "docs/how-to/python.md")
    solved = []

    def small(scene, callback=None, out=None, resume=False):
        assert resume in (False, out == "run/")
        solved.append(scene.name)
        assert callback is None or callable(callback)
        return qf_solve(qf.off_axis_tension(size=40, displacement=1), callback)

    qf_solve = qf.solve
    monkeypatch.setattr(qf, "solve", small)
    monkeypatch.setattr(qf, "refine", lambda scene, accuracy: small(scene))
    names = {}
    exec(script, names)
    exec(recorded, names)
    assert solved == ["oat-45", "hemisphere-45", "hemisphere-0", "tetrahedron-0"]
    assert FILES <= set(contents(Path("out")))


def test_continuous_integration_runs_the_test_command_of_the_readme():
    (pattern,) = re.findall(r"grep -E -- '(.+)' README\.md", (ROOT / ".ci/run").read_text())
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (command,) = [line for line in text.splitlines() if re.search(pattern, line)]
    assert command == (
        "python3 -m venv .venv && .venv/bin/pip install '.[test]' && .venv/bin/python -m pytest"
    )


# What is loaded


def loaded(code):
    """Modules that are there after some code, in a process of its own."""
    code += "\nimport sys; print(*sys.modules, file=sys.stderr)"
    beside = Path(qf.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=beside
    )
    return set(done.stderr.split())


def test_the_package_loads_when_it_is_used():
    none = {"numpy", "scipy", "skfem", "matplotlib", "meshio", "pandas", "shapely", "rich"}
    assert not loaded("import quasiform") & none
    assert not loaded("import quasiform as qf; dir(qf); qf.InputError") & none
    command = "from quasiform.console.cli import main; main({})"
    for words in (["--help"], ["form", "--help"], ["oat", "--sise", "5"], ["--version"]):
        assert not loaded(command.format(words)) & (none - {"rich"}), words
    dry = loaded(command.format(["form", "hemisphere", "--size", "30", "--dry-run"]))
    assert not dry & {"matplotlib", "pandas", "scipy.integrate", "quasiform.comparison"}


def test_the_solver_is_a_package_that_is_called():
    """`import quasiform.solve.newton` leaves `qf.solve(model)` as it was."""
    code = "import {}; import quasiform as qf; assert callable(qf.solve); qf.solve.newton"
    for first in ("quasiform.solve.newton", "quasiform.model", "quasiform.solve as solve"):
        assert "quasiform.solve.newton" in loaded(code.format(first))
    function = levels.solve
    assert inspect.signature(qf.solve) == inspect.signature(function)
    assert "Follow the travel of a" in pydoc.render_doc(qf.solve)
    for thing in (qf.solve, function):
        assert pickle.loads(pickle.dumps(thing)) is thing


def test_public_names_are_those_that_editors_see():
    module = ast.parse(Path(qf.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in module.body if isinstance(node, ast.If)]
    seen = {name.name: node.module for node in block.body for name in node.names}
    assert seen == qf._MODULES
    assert set(qf.__all__) <= set(dir(qf))
    assert all(callable(getattr(qf, name)) for name in qf.__all__)
    with pytest.raises(AttributeError, match="no attribute 'solv'"):
        qf.solv  # noqa: B018


# Hand-over


def test_export_hands_over_what_a_run_left(here, capsys, undrawn):
    assert main([*FORM, "--out", "run"]) == 0
    capsys.readouterr()
    assert main(["export", "run", "--to", "calculix"]) == 0
    said = capsys.readouterr().out
    assert "writing to run-calculix" in said
    assert "notes that apply to every such export are in handover.txt" in said
    assert {p.name for p in Path("run-calculix").iterdir()} == {
        *("mesh.inp", "fibres.inp", "part.inp", "handover.txt")
    }
    assert main(["export", "run", "--trim", "die", "--out", "cut"]) == 0
    assert {p.suffix for p in Path("cut").iterdir()} == {".dxf", ".svg", ".csv", ".txt"}
    assert main(["export", "hemisphere", "--deck", "--size", "38", "--out", "deck"]) == 0
    assert [p.suffix for p in Path("deck").iterdir()] == [".inp"]
    assert "not run" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["run"], "Exactly 1 of {--to, --trim, --ply-book, --deck} must be specified"),
        (["run", "--to", "calculx"], "did you mean 'calculix'?"),
        (["run", "--to", "csv"], "run: no such folder"),
        (["run", "--to", "csv", "--reference", "0,0,0"], "expected X,Y,Z of a direction"),
        (["hemispere", "--deck"], "did you mean 'hemisphere'?"),
    ],
)
def test_export_refuses_in_one_line(options, words, here, capsys):
    assert main(["export", *options]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not list(here.iterdir())
