"""Studies: the same table from every place, kills, impossible runs, refusals before the first."""

import csv
import hashlib
import json
import os
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import quasiform as qf
from quasiform.console.cli import main
from quasiform.studies import plan
from quasiform.studies import run as run_module
from quasiform.toml_file import toml_text
from tests import study_cases

ROOT = Path(__file__).parents[1]
STRIP = {"kind": "oat", "size": 40.0, "estimate": False, "outputs": ["force_N"]}
FOUR = STRIP | {"vary": {"displacement": [4.0, 5.0, 6.0, 7.0]}}
OUTPUTS = ["force_N", "shear_angle_deg.p99", "draw_in_mm.+x"]
CUP = {"scene": "hemisphere", "size": 10.0, "draft": True, "travel": 10.0, "outputs": OUTPUTS}


def rows(folder):
    """Rows of the table as text, without the time that they took."""
    with (Path(folder) / "study.csv").open(encoding="utf-8") as file:
        return [{k: v for k, v in row.items() if k != "cpu_s"} for row in csv.DictReader(file)]


def lines(folder):
    return (Path(folder) / "rows.jsonl").read_text(encoding="utf-8").splitlines()


@pytest.fixture(scope="module")
def sampled(tmp_path_factory):
    """A study of formings in one process, and its folder."""
    vary = {
        "tools.holder.mass": {"from": 2.0, "to": 8.0},
        "fabric.friction": {"mean": 0.157, "std": 0.02},
        "orientation": [0.0, 45.0],
    }
    study = CUP | {"design": "sobol", "runs": 4, "seed": 3, "vary": vary}
    folder = tmp_path_factory.mktemp("study")
    return study, qf.study(study, out=folder), folder


# Where it runs


def test_table_is_what_one_run_gives(sampled):
    study, table, folder = sampled
    assert list(table)[:4] == ["run", *study["vary"]]
    assert table["status"] == ["completed"] * 4
    values = {name: table[name][2] for name in study["vary"]}
    model = qf.forming("hemisphere", size=20.0, travel=10.0, overrides=values)
    result = qf.solve(model, increment=2 * model.increment, estimate="coarse")
    assert table["force_N"][2] == pytest.approx(result.force, rel=1e-12)
    assert table["draw_in_mm.+x"][2] == pytest.approx(result.draw_in["+x"], rel=1e-12)
    assert table["estimated_errors.force_N"][2] == pytest.approx(result.estimate["force_N"])
    assert "; ".join(result.summary()["trust"]) == table["trust"][2]
    assert [row["force_N"] for row in rows(folder)] == [repr(v) for v in table["force_N"]]


def test_two_workers_and_shares_give_the_same_table(sampled, tmp_path):
    study, _, folder = sampled
    qf.study(study, workers=2, out=tmp_path / "two")
    assert rows(tmp_path / "two") == rows(folder)
    for i in (2, 1):
        part = qf.study(study, share=(i, 2), out=tmp_path / "shares")
    assert rows(tmp_path / "shares") == rows(folder)
    assert part["run"] == [row["run"] for row in rows(folder)]
    assert not (tmp_path / "shares" / "rows.jsonl").exists()


def test_dask_gives_the_same_table_and_refuses_another_version(sampled, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    study, _, folder = sampled
    monkeypatch.setenv(study_cases.FLAG, str(tmp_path / "flag"))
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        qf.study(study, scheduler=cluster.scheduler_address, out=tmp_path)
        assert rows(tmp_path) == rows(folder)
        three = {"outputs": ["force_N"], "vary": {"displacement": [5.0, 6.0, 7.0]}}
        where = {"scheduler": cluster.scheduler_address, "out": tmp_path / "mortal"}
        table = qf.study(three, case=study_cases.mortal, **where)
        assert table["status"] == ["completed"] * 3
        assert (tmp_path / "flag").exists()  # one worker has died
        monkeypatch.setattr(run_module, "package_version", lambda: "9.9")
        with pytest.raises(qf.InputError, match=r"worker tcp://.* has quasiform 0"):
            qf.study(study, scheduler=cluster.scheduler_address, out=tmp_path / "other")
    with pytest.raises(qf.InputError, match="no Dask scheduler at"):
        qf.study(study, scheduler="tcp://127.0.0.1:1", out=tmp_path / "none")


def test_files_travel_with_the_runs(tmp_path):
    scene = (ROOT / "geometries" / "hemisphere.toml").read_text(encoding="utf-8")
    head, _, tail = scene.partition("[blank]")
    blank = '[blank]\nshape = "file"\nfile = "outline.csv"\n'
    tail = tail[tail.index("[tools") :]
    ids = []
    for name, side in (("here", 200), ("there", 200), ("other", 210)):
        folder = tmp_path / name
        folder.mkdir()
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
        np.savetxt(folder / "outline.csv", corners, delimiter=",", header="x,y", comments="")
        (folder / "mine.toml").write_text(f"{head}{blank}{tail}", encoding="utf-8")
        study = CUP | {"scene": "mine.toml", "keep": True, "vary": {"tools.holder.mass": [5.0]}}
        (folder / "study.toml").write_text(toml_text(study), encoding="utf-8")
        planned = plan(folder / "study.toml")
        ids.append(planned.jobs[0].id)
    assert ids[0] == ids[1] != ids[2]  # contents count, not places
    (folder / "outline.csv").unlink()
    table = qf.study(planned, out=tmp_path / "out")
    assert table["status"] == ["completed"], table["reason"]
    kept = tmp_path / "out" / "runs" / ids[2]
    assert f'"{folder / "outline.csv"}"' in (kept / "scene.toml").read_text(encoding="utf-8")
    assert str(folder / "outline.csv") in json.loads((kept / "summary.json").read_bytes())["files"]
    assert (kept / "result.vtu").exists()


# Kills, and what is not repeated


def test_finished_runs_are_not_repeated(tmp_path):
    qf.study(FOUR, out=tmp_path)
    first = lines(tmp_path)
    more = FOUR | {"outputs": ["shear_angle_deg.max"], "vary": {"displacement": [4.0, 5.0, 8.0]}}
    table = qf.study(more, out=tmp_path, resume=True)
    assert lines(tmp_path)[:4] == first
    assert len(lines(tmp_path)) == 5
    assert all(table["shear_angle_deg.max"])  # other outputs need no other run


def apart(call, folder, **environment):
    """Table of `study_cases.call(folder)` in a process of its own: its workers are killed."""
    code = f"import json; from tests import study_cases; print(json.dumps({call}({str(folder)!r})))"
    code = code.replace(call, f"study_cases.{call}")
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_a_worker_that_dies_is_replaced(tmp_path):
    table = apart("dying", tmp_path)
    assert table["status"] == ["completed", "failed", "completed"]
    assert table["reason"][1] == "worker died"
    once = {study_cases.FLAG: str(tmp_path / "flag")}  # now it dies once
    again = apart("dying", tmp_path, **once)
    assert again == table  # a failure is a row, which is not repeated either
    again = apart("dying_again", tmp_path, **once)
    assert again["status"] == ["completed"] * 3
    assert (tmp_path / "flag").exists()
    assert len(lines(tmp_path)) == 4


def test_an_idle_worker_that_dies_is_replaced(tmp_path):
    assert apart("idle", tmp_path)["status"] == ["completed"] * 4


@pytest.mark.parametrize("finished", [0, 1, 3])
def test_a_driver_that_is_killed_loses_what_is_in_flight(finished, tmp_path):
    vary = {"displacement": [40.0, 41.0, 42.0, 43.0, 44.0]}
    study = STRIP | {"size": 16.0, "vary": vary}
    (tmp_path / "study.toml").write_text(toml_text(study), encoding="utf-8")
    command = [sys.executable, "-m", "quasiform", "study", str(tmp_path / "study.toml")]
    command += ["--workers", "2", "--out", str(tmp_path / "out")]
    path, log = tmp_path / "out" / "rows.jsonl", tmp_path / "log"
    with log.open("w") as file:
        driver = subprocess.Popen(command, cwd=ROOT, stdout=file, stderr=file)
        try:
            while driver.poll() is None:
                if log.read_text() and (path.exists() or not finished):
                    if not finished or len(lines(tmp_path / "out")) >= finished:
                        break
                time.sleep(0.01)
        finally:
            driver.kill()
            driver.wait()
    if path.exists():  # as if the kill had come while a line was written
        with path.open("ab") as file:
            file.write(b'{"run": "0123456789ab", "summ')
    assert main(command[3:]) == 0
    table = rows(tmp_path / "out")
    assert [row["status"] for row in table] == ["completed"] * 5
    whole = [line for line in lines(tmp_path / "out") if line.endswith("}")]
    assert len({json.loads(line)["run"] for line in whole}) == len(whole) == 5
    qf.study(study, out=tmp_path / "straight")
    assert rows(tmp_path / "straight") == table


def test_impossible_runs_are_rows(tmp_path):
    angles = [30.0, 33.0, 36.0, 39.0, 5.0, 45.0, 48.0, 51.0, 54.0, 57.0]
    table = qf.study(STRIP | {"displacement": 3.0, "vary": {"angle": angles}}, out=tmp_path)
    assert [k for k, status in enumerate(table["status"]) if status != "completed"] == [4]
    assert table["reason"][4].startswith("angle must lie between 26.6 and 63.4 degrees")
    assert table["angle"] == angles
    law = CUP | {"draft": True, "vary": {"fabric.thickness": [-1.0, 1.0]}}
    table = qf.study(law, out=tmp_path)
    assert table["status"] == ["failed", "completed"]
    assert "Fabric(thickness=...) must be a positive number" in table["reason"][0]


def test_a_recipe_of_a_function_is_solved_with_its_changes(tmp_path):
    study = {"outputs": ["force_N"], "vary": {"displacement": [5.0]}}
    plain = qf.study(study, out=tmp_path, case=study_cases.strip)
    stiff = qf.study(study, out=tmp_path, case=study_cases.changed)
    assert stiff["force_N"][0] > 1.5 * plain["force_N"][0]


# Refusals before the first run


REFUSED = {
    "unknown key 'outpts': did you mean 'outputs'": {"outpts": ["force_N"]},
    "vary missing": {"vary": None},
    "outputs missing": {"outputs": None},
    "unknown output 'force': did you mean 'force_N'": {"outputs": ["force"]},
    "expected one of shear_angle_deg.max": {"outputs": ["shear_angle_deg"]},
    "from must be less than to, got from = 8, to = 2": {"vary": {"angle": {"from": 8, "to": 2}}},
    "unknown key 'form': did you mean 'from'": {"vary": {"angle": {"form": 2, "to": 8}}},
    "angle needs steps": {"vary": {"angle": {"from": 40, "to": 45}}},
    "std must be positive": {"vary": {"angle": {"mean": 40, "std": -1}}},
    "write the whole name in quotes": {"vary": {"fabric": {"friction": [0.1]}}},
    "is an empty list": {"vary": {"angle": []}},
    "runs = 3 goes with design = 'lhs' or 'sobol', not 'grid'": {"runs": 3},
    "runs missing": {"design": "lhs"},
    "lists of equal length": {
        "design": "list",
        "vary": {"angle": [45.0], "displacement": [3.0, 4.0]},
    },
    "unknown key 'anlge': did you mean 'angle'": {"vary": {"anlge": [45.0]}},
    "unknown key 'fricton': did you mean 'friction'": {"vary": {"fabric.fricton": [0.1]}},
    "displacement is both varied and given": {
        "displacement": 3.0,
        "vary": {"displacement": [4.0]},
    },
    "travel does not go with kind = 'oat'": {"travel": 3.0},
    "no model for the first 2 runs: angle must lie": {"vary": {"angle": [3.0, 4.0]}},
    "unknown law 'lockin': did you mean 'locking'": {"law": "lockin"},
    "design = 'sobl': did you mean 'sobol'": {"design": "sobl"},
    "unknown key 'increments'": {"vary": {"run.increments": [4.0]}},
}


@pytest.mark.parametrize("message", REFUSED)
def test_refused_before_the_first_run(message, tmp_path, capsys):
    study_cases.refused(FOUR | REFUSED[message], message, tmp_path, capsys)


def test_refused_scenes_and_functions(tmp_path):
    cup = CUP | {"vary": {"tools.holder.mas": [4.0]}}
    with pytest.raises(qf.InputError, match="unknown key 'mas': did you mean 'mass'"):
        qf.study(cup, out=tmp_path)
    with pytest.raises(
        qf.InputError, match="there is no 'holdr' in the scene: did you mean 'holder'"
    ):
        qf.study(CUP | {"vary": {"tools.holdr.mass": [4.0]}}, out=tmp_path)
    with pytest.raises(qf.InputError, match="scene missing"):
        qf.study({"outputs": ["force_N"], "vary": {"travel": [4.0]}}, out=tmp_path)
    one = {"outputs": ["force_N"], "vary": {"displacement": [4.0]}}
    with pytest.raises(qf.InputError, match="cannot be found from another process"):
        qf.study(one, out=tmp_path, case=study_cases.local)
    with pytest.raises(qf.InputError, match="cannot be called with these keys"):
        qf.study(one | {"vary": {"travel": [4.0]}}, out=tmp_path, case=study_cases.strip)
    with pytest.raises(qf.InputError, match="workers must be a whole number"):
        qf.study(FOUR, workers=0, out=tmp_path)
    with pytest.raises(qf.InputError, match="I from 1 to N"):
        qf.study(FOUR, share=(3, 2), out=tmp_path)
    (tmp_path / "summary.json").touch()
    with pytest.raises(qf.InputError, match="holds the result of one run"):
        qf.study(FOUR, out=tmp_path)


# Designs


def values(design, vary, **more):
    return [job.values for job in plan(STRIP | {"design": design, "vary": vary} | more).jobs]


def test_designs():
    vary = {"angle": [40.0, 45.0], "displacement": {"from": 2.0, "to": 4.0, "steps": 3}}
    grid = values("grid", vary)
    assert len(grid) == 6
    assert grid[1] == {"angle": 40.0, "displacement": 3.0}
    assert grid[-1] == {"angle": 45.0, "displacement": 4.0}
    vary["angle"] = [40.0, 45.0, 50.0]
    assert values("list", vary)[1] == {"angle": 45.0, "displacement": 3.0}
    by_log = {"displacement": {"from": 1.0, "to": 4.0, "steps": 3, "log": True}}
    assert values("grid", by_log)[1]["displacement"] == pytest.approx(2.0)


def test_samples_follow_their_distributions():
    vary = {
        "angle": {"from": 40.0, "to": 50.0},
        "fabric.friction": {"mean": 0.15, "std": 0.02, "from": 0.13},
        "displacement": [2.0, 3.0],
    }
    lhs = values("lhs", vary, runs=200, seed=1)
    angle, friction, displacement = (np.array([row[key] for row in lhs]) for key in vary)
    counts, _ = np.histogram(angle, 200, (40, 50))
    assert (counts == 1).all()  # one in each of as many bins as runs
    assert friction.min() > 0.13
    assert np.median(friction) == pytest.approx(0.15 + 0.02 * 0.1992, abs=5e-4)  # cut at -1 std
    assert (displacement == 2.0).sum() == 100
    assert values("lhs", vary, runs=200, seed=1) == lhs != values("lhs", vary, runs=200, seed=2)
    long = values("sobol", vary, runs=20)
    assert values("sobol", vary, runs=10) == long[:10]  # more runs keep those that are finished


def test_command_line(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text(toml_text(FOUR), encoding="utf-8")
    words = ["study", str(path), "--out", str(tmp_path / "out")]
    assert main([*words, "--dry-run"]) == 0
    assert "4 runs, 4 to solve: about " in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
    assert main([*words, "--share", "1/2"]) == 0
    assert "2 runs: 2 completed" in capsys.readouterr().out
    assert main([*words, "--dry-run"]) == 0
    assert "4 runs, 2 to solve" in capsys.readouterr().out
    assert main(words) == 0
    said = capsys.readouterr()
    assert "4 runs: 4 completed; 4 converged" in said.out
    assert "4 of 4 runs" in said.err
    assert main([*words, "--share", "3/2"]) == 2
    assert main([*words, "--scheduler", "here", "--share", "1/2"]) == 2


# What is kept


def test_fields_of_all_runs_are_in_one_file(tmp_path):
    h5py = pytest.importorskip("h5py")
    qf.study(FOUR, out=tmp_path)
    assert not (tmp_path / "fields.h5").exists()
    two = FOUR | {"fields": True, "vary": {"displacement": [4.0, 5.0]}}
    qf.study(two, out=tmp_path)  # solved again: their fields were not kept
    table = qf.study(FOUR | {"fields": True}, out=tmp_path)
    assert len(lines(tmp_path)) == 4 + 2 + 2
    model = qf.off_axis_tension(size=40.0, displacement=5.0)
    sheet = qf.solve(model, estimate=False).sheet
    with h5py.File(tmp_path / "fields.h5") as file:
        assert json.loads(file.attrs["runs"]) == table["run"]
        run = file[table["run"][1]]
        np.testing.assert_array_equal(run["triangles"], sheet.triangles)
        np.testing.assert_allclose(run["points"], sheet.points, atol=1e-9)
        gamma = sheet.cell_fields["shear_angle"]
        np.testing.assert_allclose(run["cell/shear_angle"], gamma, atol=1e-9)
    assert not (tmp_path / "fields").exists()
    manifest = json.loads((tmp_path / "croissant.json").read_bytes())
    assert [f["name"] for f in manifest["recordSet"][0]["field"]] == list(table)
    digest = hashlib.sha256((tmp_path / "fields.h5").read_bytes()).hexdigest()
    assert manifest["distribution"][1]["sha256"] == digest


def test_parquet_beside_csv(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = qf.study(FOUR, out=tmp_path)
    assert parquet.read_table(tmp_path / "study.parquet").to_pydict() == table


def test_the_study_of_the_documentation_is_one(capsys):
    page = (ROOT / "docs" / "how-to" / "studies.md").read_text(encoding="utf-8")
    study = tomllib.loads(re.search("```toml\n(.*?)```", page, re.DOTALL)[1])
    assert len(plan(study).jobs) == 64
    assert main(["schema", "--study"]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.validate(study, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(study | {"desgin": "grid"}, schema)
