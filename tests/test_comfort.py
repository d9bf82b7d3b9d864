"""New scenes, the doctor, the expected time, completion by the shell, time left."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import quasiform as qf
from quasiform.checks import number
from quasiform.comparison import comparison
from quasiform.console import cli, doctor, forecast, terminal
from quasiform.console.cli import main
from quasiform.console.progress import _words
from quasiform.fabric import PRESETS
from quasiform.handover import fibres, handover
from quasiform.identification import campaign, fit
from quasiform.result import certificate
from quasiform.result.record import Record
from quasiform.result.summary import package_version
from quasiform.scenes import scene_file
from quasiform.solve import linear
from quasiform.solve.linear import SuperLU


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


# New


def test_a_new_scene_runs_as_it_is_written(capsys):
    assert main(["new", "my part.toml"]) == 0
    assert main(["form", "my part.toml", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "my-part-0: 625 nodes" in out
    assert "NAME" not in Path("my part.toml").read_text(encoding="utf-8")
    result = qf.solve(qf.forming("my part.toml", size=20, travel=10), estimate=False)
    assert (result.status, result.areas.keys()) == ("completed", {"corner"})


def test_all_that_is_left_out_of_a_new_scene_may_be_switched_on(here):
    main(["new", "part.toml"])
    text = (here / "part.toml").read_text(encoding="utf-8")
    assert text.count("\n#: ") == 22
    (here / "all.toml").write_text(text.replace("\n#: ", "\n"), encoding="utf-8")
    file = scene_file.load("all.toml")
    assert (file.gravity, file.symmetry, len(file.outline.interiors)) == (True, "none", 1)
    assert [len(file.supports), len(file.grippers)] == [1, 1]
    assert qf.forming("all.toml", size=20).travel == 40


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("new", "FILE requires an argument"),
        ("new part", "expected the name of a .toml file"),
        ("new there.toml", "there already"),
        ("new none/part.toml", "cannot write to none/part.toml: No such file"),
        ("new part.toml --forse", "did you mean '--force'?"),
        ("schema now", "unexpected argument 'now'"),
        ("doctor now", "unexpected argument 'now'"),
    ],
)
def test_refusals(here, capsys, line, words):
    (here / "there.toml").write_text("mine")
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert words in err
    assert (here / "there.toml").read_text() == "mine"
    assert main(["new", "there.toml", "--force"]) == 0


# Doctor


def test_doctor_tells_each_part_in_a_line(capsys):
    assert main(["doctor"]) == 0
    found = dict(
        re.split(r"  +", line, maxsplit=1) for line in capsys.readouterr().out.splitlines()
    )
    assert found["quasiform"] == package_version()
    solvers = [state for name, state in found.items() if name.startswith("linear solver")]
    assert sum("is used" in state for state in solvers) == 1
    assert found["linear solver superlu"].startswith("works")
    used = qf.solve(qf.off_axis_tension(size=40, displacement=1), estimate=False).settings["linear"]
    assert "is used" in found[f"linear solver {used}"]


def test_doctor_tells_what_is_missing_or_broken(monkeypatch):
    def broken(name, *rest):
        if name == "pardiso":
            raise OSError("libmkl_rt.so.2:\ncannot open")
        return solver(name, *rest)

    solver = doctor.linear_solver
    monkeypatch.setattr(doctor, "linear_solver", broken)
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    monkeypatch.setenv("MKL_NUM_THREADS", "3")
    found = dict(doctor.examine())
    words = "missing or broken: the fastest; libmkl_rt.so.2: cannot open; pip install"
    assert found["linear solver pardiso"] == f"{words} 'quasiform[fast]'"
    assert "is used" in found["linear solver superlu"]
    assert found["MKL_NUM_THREADS"] == "3"
    assert found["plotly"].endswith("pip install 'quasiform[report]'")
    assert found["ffmpeg"].startswith("missing")


def test_doctor_names_a_remedy_once(monkeypatch):
    def absent(*given):
        raise ImportError

    monkeypatch.setattr(linear.Pardiso, "__init__", absent)
    told = dict(doctor.examine())["linear solver pardiso"]
    words = "missing or broken: the fastest; linear solver 'pardiso' is not installed"
    assert told == f"{words}: pip install 'quasiform[fast]'"


def test_doctor_does_not_trust_a_wrong_solution(monkeypatch):
    solve = SuperLU.solve
    monkeypatch.setattr(SuperLU, "solve", lambda self, b: -solve(self, b))
    assert "its solution is wrong" in dict(doctor.examine())["linear solver superlu"]


# Numbers in words


@pytest.mark.parametrize(("lines", "words"), [(1, "1 line to cut"), (2, "2 lines to cut")])
def test_lines_to_cut(monkeypatch, capsys, lines, words):
    pattern = SimpleNamespace(
        **{"name": "part", "trim": [None] * lines, "area": 2.0, "notices": (), "files": ("a",)},
        save=lambda folder, force: None,
    )
    monkeypatch.setattr(Record, "read", lambda folder: SimpleNamespace(plies=[None]))
    monkeypatch.setattr(qf, "flat_pattern", lambda *given, **named: pattern)
    assert main(["export", "x", "--trim", "edge", "--out", "out"]) == 0
    assert f"\npart: {words}, 2 mm² inside\n" in capsys.readouterr().out


# What a dry run warns of


@pytest.mark.parametrize(("share", "coarse"), [(0.505, False), (0.515, True)])
def test_a_dry_run_warns_where_the_certificate_refuses(monkeypatch, share, coarse):
    result = qf.solve(qf.forming(size=31, travel=1.0), estimate=False)
    radius = result.blank.size / share
    monkeypatch.setattr(certificate, "bent_radius", lambda *given: radius)
    said = [reason for reason in certificate.certify(result).reasons if "too coarse" in reason]
    model = replace(result.model, coarsest=forecast.RESOLVES * radius)
    warned = [words for words in forecast.limits(model, {"increment": None}) if "coarse" in words]
    assert (len(said), len(warned)) == (coarse, coarse)


# Expected time


def planned(scene, one_mesh, **named):
    found = forecast.meshes(scene, one_mesh, **named)
    return [(mesh.size, mesh.dofs, mesh.solves) for mesh in found]


def test_expected_meshes_are_those_that_are_solved(monkeypatch):
    monkeypatch.setattr(forecast, "_step", lambda *given: 1.0)
    sizes = 12, 24, 16.8, 6
    models = [qf.forming("hemisphere", size=size, travel=10) for size in sizes]
    whole, dofs = models[0], [(~one.fixed).sum() for one in models]
    path = 2 * forecast.WITH_TOOLS
    # the same twice on a coarser mesh, for the error and for in-plane bending, and a finer end
    others = [(pytest.approx(16.8), dofs[2], 2 * path), (6, dofs[3], forecast.CARRIED)]
    assert planned(whole, True) == [(12, dofs[0], path), *others]
    assert planned(whole, False) == planned(whole, True)  # it is too coarse for a path of its own
    assert planned(whole, True, seeds=2)[0][2] == 3 * path
    assert planned(whole, True, estimate=False) == [(12, dofs[0], path)]
    draft = [(12, dofs[0], path / 2), (pytest.approx(16.8), dofs[2], path / 2)]
    assert planned(whole, True, increment=10.0, estimate="coarse") == draft
    scene = whole.including(lambda model: setattr(model, "coarsest", 24.0))
    found = planned(scene, False)
    assert found[0] == (pytest.approx(24), dofs[1], path)
    assert found[1] == (12, dofs[0], forecast.CARRIED)
    assert found[2][2] == 2 * path
    assert planned(scene, False, seeds=1)[0][2] == 2 * path
    strip = qf.off_axis_tension(size=20, displacement=20)
    assert planned(strip, True)[0][2] == 4 * forecast.IN_PLANE


def test_expected_time_is_solves_by_their_time(capsys, monkeypatch):
    found = (forecast.Mesh(5, 100, 40, 0.5), forecast.Mesh(10, 30, 100, 0.1))
    monkeypatch.setattr(forecast, "meshes", lambda *given: found)
    assert main(["form", "hemisphere", "--size", "30", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "expected time: about 30 s on this machine" in out
    assert "up to 3 min where the sheet buckles; meshes: 5 and 10 mm\n" in out


def test_a_dry_run_warns_of_what_keeps_a_run_from_its_certificate(capsys):
    assert main(["form", "hemisphere", "--size", "6", "--increment", "10", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "a mesh of 6 mm is too coarse for the smallest radius of the tools, 10 mm" in out
    assert "warning: friction follows its path in increments of 5 mm, not 10" in out
    assert main(["form", "hemisphere", "--size", "4.9", "--increment", "5", "--dry-run"]) == 0
    assert "warning" not in capsys.readouterr().out


def test_expected_time_may_not_be_known(monkeypatch):
    def singular(*given):
        raise forecast.NotConvergedError("no stiffness")

    monkeypatch.setattr(forecast.Equilibrium, "factor", singular)
    found = forecast.meshes(qf.off_axis_tension(size=40), True)
    assert forecast.words(found).startswith("not known")


def test_a_dry_run_leaves_the_scene_as_it_was():
    scene = qf.forming("hemisphere", size=30, travel=5)
    before = scene.x0.copy()
    forecast.meshes(scene, True)
    assert (scene.x0 == before).all()
    (one, other) = (
        qf.solve(s, estimate=False) for s in (scene, qf.forming("hemisphere", size=30, travel=5))
    )
    assert one.force == other.force


# Completion, and what there is to choose from

PROGRAM = f'quasiform() {{ {sys.executable} -m quasiform "$@"; }}'


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("fo", ["form"]),
        ("form h", ["hemisphere"]),
        ("form my", ["my.toml"]),
        ("form hemisphere --or", ["--orientation"]),
        ("form hemisphere --linear s", ["superlu"]),
        ("form hemisphere --law ", ["locking", "best-fit", "my.toml"]),
        ("oat --or", []),
        ("oat --size ", []),
        ("plot --animate ", ["gif", "mp4"]),
    ],
)
def test_bash_completes(here, words, expected):
    (here / "my.toml").write_text("")
    (here / "script").write_text(cli.app.generate_completion(shell="bash"))
    given = ["quasiform", *words.split(" ")]
    quoted = " ".join(f"'{word}'" for word in given)
    asked = f"{PROGRAM}; source ./script; COMP_WORDS=({quoted}); COMP_CWORD={len(given) - 1}; "
    done = subprocess.run(
        ["bash", "-c", asked + '_quasiform; printf "%s\\n" "${COMPREPLY[@]}"'],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(Path(qf.__file__).parents[1])},
    )
    assert done.stderr == ""
    assert done.stdout.split() == expected


def test_completion_is_installed_for_the_shell(here, monkeypatch):
    monkeypatch.setenv("HOME", str(here))
    assert Path.home() == here
    assert main(["--install-completion", "--shell", "bash"]) == 0
    (script,) = here.rglob("completions/quasiform")
    assert "_quasiform()" in script.read_text()
    assert str(script) in (here / ".bashrc").read_text()


CHOICES = {
    ("oat", "linear"): linear.NAMES,
    ("form", "linear"): linear.NAMES,
    ("identify", "method"): campaign.METHODS,
    ("identify", "kind"): [*campaign.KINDS, *campaign.OF_BENDING],
    ("identify", "algorithm"): fit.ALGORITHMS,
    ("compare", "align"): comparison.ALIGN,
    ("compare", "standing"): comparison.STANDINGS,
    ("export", "to"): handover.FORMATS,
    ("export", "axis"): fibres.AXES,
}


@pytest.mark.parametrize(("command", "option"), CHOICES)
def test_choices_are_those_of_the_room(command, option):
    """They are written into the command line, so that its help loads nothing."""
    options = cli.app[command].assemble_argument_collection()
    (found,) = [argument for argument in options if argument.name == f"--{option}"]
    assert set(found.get_choices(force=True)) == set(CHOICES[command, option])


@pytest.mark.parametrize("words", [["form", ""], ["form", "hemisphere", "--law", ""]])
def test_names_that_are_completed_are_those_of_the_room(capsys, words):
    assert main(["__complete", *words]) == 0
    _, found = capsys.readouterr().out.split("\x1fbegin")
    assert set(found.split()) == set(PRESETS if "--law" in words else scene_file.built_in())


@pytest.mark.parametrize("command", [name for name in cli.app if not name.startswith("-")])
def test_every_option_has_a_help_text(capsys, command):
    assert main([command, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"Usage: quasiform {command}")
    options = cli.app[command].assemble_argument_collection(parse_docstring=True)
    missing = [a.name for a in options if a.show and a.name != "*" and not a.parameter.help]
    assert missing == []


def test_the_schema_of_a_scene_is_printed(capsys):
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"blank", "tools", "travel"} <= set(schema["properties"])


# What is printed


def test_numbers_are_printed_as_people_write_them():
    found = [number(x, 2) for x in (112.3, 0.01234, 123456.0, 8.0, 0.0)]
    assert found == ["110", "0.012", "120000", "8", "0"]


def test_a_table_keeps_its_cells_whole_in_a_pipe():
    long = "a [bold]word[/bold] :smile: " * 20
    lines = terminal.table([("one", 1, long.strip()), ("three", 22, "x")], indent=2).splitlines()
    assert lines == [f"  one    1   {long.strip()}", "  three  22  x"]


# The validation suite


def suite(folder):
    """A clone with a suite of its own."""
    (folder / "validation").mkdir(parents=True)
    (folder / "pyproject.toml").write_text("")
    (folder / "validation" / "__init__.py").write_text("")
    (folder / "validation" / "run.py").write_text("def validate(*given, **named): return 1")


def test_the_suite_of_a_clone_is_run(here, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.split(".")[0] == "validation"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(cli, "__file__", str(here / "site" / "quasiform" / "console" / "cli.py"))
    assert main(["validate", "--quick"]) == 2
    said = capsys.readouterr().err
    assert said == (
        "quasiform: the validation suite is part of the source tree: run it from a clone\n"
    )
    suite(here / "site")  # beside the package
    assert main(["validate", "--quick"]) == 1
    path = list(sys.path)
    suite(here)  # where the command is run
    for name in ("validation", "validation.run"):
        monkeypatch.delitem(sys.modules, name)
    assert main(["validate"]) == 1
    assert Path(sys.modules["validation.run"].__file__) == here / "validation" / "run.py"
    assert sys.path == path
    for name in ("validation", "validation.run"):
        monkeypatch.delitem(sys.modules, name)


# Time left


def test_time_left_runs_down_between_two_increments():
    step = qf.Progress(40.0, 80.0, 1e-5, 1.0, 0, 9, 60.0)
    assert "1:00 elapsed, about 3:00 left" in _words(step)  # the time grows as the square
    assert "1:30 elapsed, about 2:30 left" in _words(step, 30.0)
    assert "about 0:00 left" in _words(step, 300.0)
    assert "left" not in _words(replace(step, travel=19.0))  # too early to tell
    assert "left" not in _words(replace(step, travel=80.0))
