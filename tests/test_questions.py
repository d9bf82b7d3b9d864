"""Questions to a study: indices, shares and branches, searches, the blank for a trim line."""

import csv
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import quasiform as qf
from quasiform.console.cli import main
from quasiform.draw import studies as draw
from quasiform.net.blank import cut
from quasiform.scenes import scene_file
from quasiform.solve.parameters import with_value
from quasiform.solve.scatter import AMPLITUDE
from quasiform.studies import fields, indices, optimise, plan, robust, trim
from quasiform.studies.run import outcome
from quasiform.toml_file import toml_text
from tests import study_cases
from validation.stability.scenes import flat_strip

STRIP = {"kind": "oat", "size": 40.0, "outputs": ["force_N"]}
TWO = {"angle": {"from": 40.0, "to": 50.0}, "displacement": {"from": 2.0, "to": 6.0}}
CUP = {"scene": "hemisphere", "size": 10.0, "draft": True, "travel": 10.0, "estimate": False}


def row(force, **more):
    """Row of a run that was completed."""
    summary = {"status": "completed", "reason": "", "force_N": force, "trust": []}
    summary |= {"certificate": {"converged": True}, "one_of_many": None}
    return {"summary": summary, "wrinkled": False, "locked": False, "energy_mJ": 1.0} | more


def solved(function):
    """Solve of runs whose force is a function of their values; None for a run that fails."""

    def solve(jobs):
        solve.calls += len(jobs)
        found = [function(**job.values) for job in jobs]
        return [{"error": "no"} if force is None else row(force) for force in found]

    solve.calls = 0
    return solve


# Sobol' indices


def test_indices_are_those_of_scipy():
    rng = np.random.default_rng(0)
    A, B = rng.uniform(-np.pi, np.pi, (2, 3, 64))
    mixed = np.repeat(A[None], 3, axis=0)
    mixed[range(3), range(3)] = B

    def ishigami(x):
        return np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])

    f = [ishigami(x) for x in (A, B, *mixed)]
    known = {"f_A": f[0][None], "f_B": f[1][None], "f_AB": np.array(f[2:])[:, None]}
    wanted = stats.sobol_indices(func=known, n=64)
    first, total = indices.indices(np.array(f))
    np.testing.assert_allclose(first, wanted.first_order, rtol=1e-12)
    np.testing.assert_allclose(total, wanted.total_order, rtol=1e-12)


def test_sobol_study_uses_complete_groups_and_says_how_many():
    study = STRIP | {"vary": TWO, "sobol": {"points": 64}}
    planned = plan(study)
    assert len(planned.jobs) == 64 * 4
    A, B, first, second = (job.values for job in planned.jobs[:4])
    assert first == {"angle": B["angle"], "displacement": A["displacement"]}
    assert second == {"angle": A["angle"], "displacement": B["displacement"]}
    fewer = plan(study | {"sobol": {"points": 16}})
    assert [job.id for job in fewer.jobs] == [job.id for job in planned.jobs[:64]]

    def force(angle, displacement):  # variances 1 to 4
        return None if angle > 49.8 else (angle - 45.0) / 5.0 + (displacement - 4.0)

    answer = indices.answer(planned, solved(force))
    table = answer.tables["sobol.csv"]
    found = dict(zip(zip(table["key"], table["order"], strict=True), table["index"], strict=True))
    assert found["displacement", "first"] == pytest.approx(0.8, abs=0.1)
    assert found["angle", "total"] == pytest.approx(0.2, abs=0.1)
    ends = np.array([table["low"], table["index"], table["high"]])
    assert (np.diff(ends, axis=0) > 0).all()
    assert "runs not completed" in answer.lines[0]
    assert " of 64 groups of runs are complete and used" in answer.lines[1]
    assert indices.answer(planned, solved(force)) == answer
    lost = indices.answer(planned, solved(lambda angle, displacement: None if angle > 44 else 1.0))
    assert not lost.tables
    assert "no indices" in lost.lines[-1]
    draw.indices_figure(*answer.pictures["sobol.png"][1])


# Shares, window and branches


def test_shares_have_wilson_intervals_and_a_window():
    grid = {key: entry | {"steps": 5} for key, entry in TWO.items()}
    asked = {"window": list(TWO), "limits": {"force_N": 49.0}}
    planned = plan(STRIP | {"vary": grid, "robust": asked})

    def force(angle, displacement):
        return None if displacement == 2.0 else angle

    answer = robust.answer(planned, solved(force), None)
    shares = answer.tables["robust.csv"]
    found = {entry[0]: entry[1:] for entry in zip(*shares.values(), strict=True)}
    assert found["not completed"] == pytest.approx((5, 25, 0.0886, 0.3913), abs=1e-4)
    assert found["force_N > 49"][:2] == (4, 20)
    assert found["good"][:2] == (16, 25)
    _, args = answer.pictures["window.png"]
    assert args[2].count("good") == 16
    draw.window_figure(*args)


def test_branches_have_shares_and_energies():
    planned = plan(CUP | {"robust": {"starts": 6, "apart": 1.0}})
    assert [job.values for job in planned.jobs] == [{"start": k} for k in range(6)]
    flat = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, 2.0], [0.0, -2.0]])
    lifts = ([0, 9, 0, 0], [0, 9.2, 0, 0], [9, 0, 0, 0], [0, 0, 9, 0], [0, 0, 0, 0], [9.1, 0, 0, 0])
    states = {
        job.id: {"flat": flat, "points": np.column_stack([flat, lift])}
        for job, lift in zip(planned.jobs, lifts, strict=True)
    }
    energies = [3.0, 3.1, 3.05, 1.0, 7.0, 3.0]
    rows = [row(1.0, energy_mJ=energy) for energy in energies]
    for entry in rows:
        entry["summary"]["shear_angle_deg"] = {"p99": 2.0}
    table, lines = robust.branches(planned, rows, states.get)
    assert table["runs"] == [4, 1, 1]  # mirror images are one branch
    assert table["energy_mJ"] == [3.0, 1.0, 7.0]
    assert table["start"][0] == 0
    assert "stored energy 3 to 3.1 mJ" in lines[0]
    assert "(the least)" in lines[1]
    assert lines[-1].startswith("states of different branches are 4.5 to ")


def test_a_strip_that_buckles_has_two_branches_of_one_energy():
    planned = plan(CUP | {"robust": {"starts": 8}, "outputs": ["force_N"]})
    model, rows, states = flat_strip(10.0, qf.Fabric.preset("locking")), [], {}
    for k, job in enumerate(planned.jobs):
        result = qf.solve(model, estimate=False, perturbation=0.01 * bool(k), seed=k)
        states[job.id] = {"flat": result.sheet.flat, "points": result.sheet.points}
        rows.append(row(1.0, energy_mJ=result.energy))
    up = sum(state["points"][:, 2].max() > 5 for state in states.values())
    table, lines = robust.branches(planned, rows, states.get)
    assert sorted(table["runs"]) == sorted([up, 8 - up])
    assert 0 < up < 8
    assert table["energy_mJ"][0] == pytest.approx(table["energy_mJ"][1], rel=1e-9)
    assert len(lines) == 3


def test_a_start_is_that_of_perturbed_runs():
    planned = plan(STRIP | {"displacement": 20.0, "estimate": False, "robust": {"starts": 2}})
    found, left = outcome(planned.jobs[1].description, {}, False, True)
    model = qf.off_axis_tension(displacement=20.0, size=40.0)
    how = {"perturbation": AMPLITUDE * model.sheet.fabric.thickness, "seed": 1, "estimate": False}
    result = qf.solve(model, **how)
    assert found["summary"]["force_N"] == pytest.approx(result.force, rel=1e-9)
    assert found["energy_mJ"] == pytest.approx(result.energy, rel=1e-9)
    assert found["history"][1] == pytest.approx(result.history["force_N"].tolist(), rel=1e-9)
    assert "fields.npz" in left
    assert planned.jobs[0].description == plan(
        STRIP | {"displacement": 20.0, "estimate": False, "vary": {"angle": [45.0]}}
    ).jobs[0].description | {"strip": planned.jobs[0].description["strip"]}


# Searches


def bowl(angle, displacement):
    """Least at 46 and 3.4; no result where the angle is small."""
    return None if angle < 41 else 5.0 + (angle - 46.0) ** 2 + 4.0 * (displacement - 3.4) ** 2


def test_a_search_finds_the_least_and_does_not_repeat_runs():
    study = STRIP | {"vary": TWO, "optimise": {"least": "force_N", "tolerance": 1e-3}}
    planned, solve = plan(study), solved(bowl)
    answer = optimise.answer(planned, solve)
    assert solve.calls == len(planned.jobs) <= 40
    assert len({job.id for job in planned.jobs}) == len(planned.jobs)
    best = min((job.values for job in planned.jobs if bowl(**job.values)), key=lambda v: bowl(**v))
    assert best["angle"] == pytest.approx(46.0, abs=0.05)
    assert best["displacement"] == pytest.approx(3.4, abs=0.02)
    assert "best of" in " ".join(answer.lines)
    again = plan(study)
    assert optimise.answer(again, solved(bowl)) == answer
    assert [job.id for job in again.jobs] == [job.id for job in planned.jobs]
    draw.search_figure(*answer.pictures["optimise.png"][1])


def test_a_search_keeps_limits_and_meets_targets():
    def force(angle, displacement):
        return angle * displacement

    asked = {"most": "force_N", "limits": {"force_N": 200.0}, "tolerance": 1e-3}
    planned = plan(STRIP | {"vary": TWO, "optimise": asked})
    optimise.answer(planned, solved(force))
    kept = [force(**job.values) for job in planned.jobs if force(**job.values) < 200.2]
    assert max(kept) == pytest.approx(200.0, rel=2e-3)
    planned = plan(STRIP | {"vary": TWO, "optimise": {"target": {"force_N": 150.0}}})
    answer = optimise.answer(planned, solved(force))
    assert any(line.startswith("force_N 150") for line in answer.lines)
    planned = plan(STRIP | {"vary": TWO, "optimise": {"least": "force_N", "runs": 10}})
    optimise.answer(planned, solved(force))
    assert len(planned.jobs) == 10
    lost = optimise.answer(planned, solved(lambda **_: None))
    assert lost.lines[-1] == "no run to start the search from"


# The blank for a trim line


def formed(outline):
    """End state of a disc that is stretched, sheared and bent: a known map of its flat points."""
    sheet = cut(outline, 10.0)
    X, Y = sheet.nodes.T
    points = np.column_stack([0.9 * X + 0.1 * Y, 0.8 * Y, 1e-3 * X**2])
    return {"points": points, "flat": sheet.nodes, "triangles": sheet.triangles}


def test_trim_line_by_a_known_map(tmp_path):
    turn = 2 * np.pi * np.arange(120) / 120
    flat = 170 * np.column_stack([np.cos(turn), np.sin(turn)])  # beyond the first blank in places
    line = np.column_stack([flat @ [0.9, 0.1], 0.8 * flat[:, 1], 1e-3 * flat[:, 0] ** 2])
    both = np.column_stack([np.repeat([0, 1], 120), np.vstack([line, line * [0.3, 0.3, 0.09]])])
    for table, name in ((line, "x,y,z"), (line[:, :2], "x,y"), (both, "loop,x,y,z")):
        path = tmp_path / "line.csv"
        np.savetxt(path, table, delimiter=",", header=name, comments="")
        planned = plan(CUP | {"trim": {"line": str(path), "within": 1.5}})
        states = {}

        def solve(jobs, states=states):
            for job in jobs:
                text = {"toml": job.description["scene"], "source": ""}
                states[job.id] = formed(scene_file.read_text(text).outline)
            return [row(1.0) for _ in jobs]

        answer = trim.answer(planned, solve, states.get)
        table = answer.tables["trim.csv"]
        assert table["largest_mm"][0] > 20.0
        assert len(table["round"]) <= 3
        assert table["largest_mm"][-1] < 1.5
        x, y = np.array([p.split(",") for p in answer.tables["blank.csv"].split()[1:]], float).T
        assert np.hypot(x, y) == pytest.approx(170.0, abs=1.6)
        blank = tomllib.loads(answer.tables["blank.toml"])["blank"]
        assert len(blank["points"]) == len(x)
        holes = [np.hypot(*np.transpose(hole["points"])) for hole in blank.get("holes", [])]
        assert len(holes) == (name == "loop,x,y,z")
        assert np.concatenate([[51.0], *holes]) == pytest.approx(51.0, abs=1.6)
        draw.trim_figure(*answer.pictures["trim.png"][1])


def test_trim_study_from_the_command_line(tmp_path, capsys):
    turn = 2 * np.pi * np.arange(90) / 90
    line = 130 * np.column_stack([np.cos(turn), np.sin(turn)])
    np.savetxt(tmp_path / "line.csv", line, delimiter=",", header="x,y", comments="")
    study = CUP | {"trim": {"line": "line.csv", "runs": 3}, "set": {"outputs.pictures": False}}
    (tmp_path / "net.toml").write_text(toml_text(study), encoding="utf-8")
    out = tmp_path / "out"
    words = ["study", str(tmp_path / "net.toml"), "--out", str(out)]
    assert main([*words, "--dry-run"]) == 0
    assert "1 to solve first, 3 in all at most" in capsys.readouterr().out
    assert main([*words, "--share", "1/2"]) == 2
    assert "a share does not go with [optimise] or [trim]" in capsys.readouterr().err
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "round 2: edge and line" in said
    assert "trim.png" in said
    with (out / "trim.csv").open(encoding="utf-8") as file:
        off = [float(entry["largest_mm"]) for entry in csv.DictReader(file)]
    assert off[0] > 60 > 1 > off[-1]
    before = (out / "rows.jsonl").read_bytes()
    assert main(words) == 0  # takes the runs that it has
    assert (out / "rows.jsonl").read_bytes() == before
    ids = [json.loads(text)["run"] for text in before.splitlines()]
    assert len(fields.read(out, ids[0])["points"])


# Refusals


REFUSED = {
    "points must be a power of 2 such as 8 or 16, got 12": {"sobol": {"points": 12}},
    "[sobol] points missing": {"sobol": {}},
    "design does not go with [sobol]": {"sobol": {"points": 8}, "design": "lhs"},
    "confidence must be at least 0.5": {"sobol": {"points": 8, "confidence": 0.1}},
    "unknown key 'point': did you mean 'points'": {"sobol": {"point": 8}},
    "[sobol] and [robust]: a study has one of them": {"sobol": {"points": 8}, "robust": {}},
    "window: did you mean 'angle'?": {"robust": {"window": ["angel", "displacement"]}},
    "window must name two keys": {"robust": {"window": ["angle"]}},
    "unknown output 'force': did you mean 'force_N'": {
        "robust": {"limits": {"force": 3.0}},
        "vary": {"angle": [40.0, 45.0]},
    },
    "give one of least, most, target, got none": {"optimise": {}},
    "got least and most": {"optimise": {"least": "force_N", "most": "force_N"}},
    "unknown output 'forc_N'": {"optimise": {"least": "forc_N"}},
    "target: force_N must not be 0": {"optimise": {"target": {"force_N": 0.0}}},
    "runs must exceed start = 8, got 8": {"optimise": {"least": "force_N", "runs": 8}},
    "angle must be a range from ... to for [optimise]": {
        "optimise": {"least": "force_N"},
        "vary": {"angle": [40.0, 45.0]},
    },
    "vary does not go with [trim]": {"trim": {"line": "line.csv"}},
    "[trim] needs a scene": {"trim": {"line": "line.csv"}, "vary": None},
    "line.csv: No such file": {
        "trim": {"line": "line.csv"},
        "vary": None,
        "kind": "form",
        "size": 20.0,
        "scene": "hemisphere",
    },
}


@pytest.mark.parametrize("message", REFUSED)
def test_refused_before_the_first_run(message, tmp_path, capsys):
    study_cases.refused(STRIP | {"vary": TWO} | REFUSED[message], message, tmp_path, capsys)


def test_a_function_has_no_trim_line_and_may_have_a_start():
    two = {"outputs": ["force_N"], "vary": {"start": [1.0, 2.0]}}
    assert [job.values["start"] for job in plan(two, study_cases.begun).jobs] == [1.0, 2.0]
    with pytest.raises(qf.InputError, match="start is what starts = 3 varies"):
        plan(two | {"robust": {"starts": 3}}, study_cases.begun)
    with pytest.raises(qf.InputError, match="needs a scene, not a function"):
        plan({"trim": {"line": "line.csv"}}, study_cases.begun)


# Pictures of a table


def test_pictures_of_a_table():
    rng = np.random.default_rng(0)
    angle, mass = rng.uniform(40, 50, 30), rng.uniform(2, 8, 30)
    force = 3.0 * mass + rng.normal(0, 0.3, 30)
    table = {"angle": angle.tolist(), "tools.holder.mass": mass.tolist()}
    table |= {"force_N": force.tolist(), "estimated_errors.force_N": [0.5, None] * 15}
    table |= {"status": ["completed"] * 29 + ["failed"], "converged": [True, False] * 15}
    table |= {"one_of_many": [None, None, "it buckled"] * 10}
    rows = [{"history": [[0.0, 5.0, 10.0], [0.0, 0.4 * f, f]]} for f in force]
    found = draw.figures(list(table)[:2], ["force_N"], table, rows, True)
    assert list(found) == ["scatter.png", "tornado.png", "force.png"]
    bars = found["tornado.png"].axes[0].patches  # from the least to the largest
    span = 3.0 * np.diff(np.quantile(mass[:29], [0.1, 0.9]))
    assert bars[-1].get_width() == pytest.approx(span[0], rel=0.03)
    assert abs(bars[0].get_width()) < 0.1 * span[0]
    assert "bars: mesh error" in found["scatter.png"].get_suptitle()
    crowd = {name: 7 * values for name, values in table.items()}
    scatter = draw.figures(list(table)[:2], ["force_N"], crowd, 7 * rows, True)["scatter.png"]
    assert scatter.axes[0].get_ylabel() == "force in N\n(± 0.5 mesh)"
    assert not any(bars.has_yerr for axes in scatter.axes for bars in axes.containers)
    few = table | {"status": ["completed"] * 3}
    assert not draw.figures(["angle"], ["force_N"], few, rows, True)


# Sensitivities on the command line


def test_errors_by_parameters_on_the_command_line(tmp_path, capsys):
    words = ["oat", "--size", "40", "--displacement", "40", "--out", str(tmp_path / "out")]
    assert main([*words, "--uncertain", "thicknes=0.05"]) == 2
    assert "did you mean 'fabric.thickness'" in capsys.readouterr().err
    assert main([*words, "--uncertain", "length=1"]) == 2
    assert "'length' changes the mesh" in capsys.readouterr().err
    assert main([*words, "--uncertain", "thickness=-1"]) == 2
    capsys.readouterr()
    given = {"thickness": 0.05, "S_ini": 3e-4}
    assert main([*words, *(f"--uncertain={name}={by}" for name, by in given.items())]) == 0
    said = capsys.readouterr().out
    result = qf.solve(qf.off_axis_tension(size=40.0, displacement=40.0))
    force = result.parameter_errors(given)["force_N"]
    line = next(line for line in said.splitlines() if line.split()[0] == "force" and "mesh" in line)
    assert f"± {force['mesh']:.2g} mesh ± {force['fabric.thickness']:.2g} thickness ± " in line
    assert f"together ± {force['total']:.2g}" in line
    with (tmp_path / "out" / "sensitivity.csv").open(encoding="utf-8") as file:
        table = [entry for entry in csv.DictReader(file) if entry["output"] == "force_N"]
    assert [float(entry["error"]) for entry in table] == pytest.approx(list(force.values())[2:4])
    assert (tmp_path / "out" / "sensitivity.png").exists()


def test_a_path_without_derivatives_says_so(tmp_path, capsys):
    words = ["form", "hemisphere", "--size", "10", "--draft", "--travel", "20", "--sensitivity"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    assert "no sensitivities: the run is not converged" in capsys.readouterr().out
    assert not (tmp_path / "out" / "sensitivity.csv").exists()


def test_parameters_of_a_model_on_another_mesh():
    model = qf.off_axis_tension(size=20.0)
    coarse = model.recipe.build(40.0, like=model)
    assert with_value(coarse, "fabric.thickness", 1.1).x0.shape == coarse.x0.shape


def test_the_questions_of_the_documentation_are_some(tmp_path, monkeypatch):
    page = Path(__file__).parents[1] / "docs" / "how-to" / "questions.md"
    studies = re.findall("```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("net.csv").write_text("x,y\n120,0\n0,120\n-120,0\n0,-120\n", encoding="utf-8")
    counts = [len(plan(tomllib.loads(text.replace("64", "8"))).jobs) for text in studies]
    assert counts == [32, 36, 9, 8, 1]
