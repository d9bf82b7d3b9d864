"""Killed runs leave readable files and carry on to the same end."""

import csv
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import meshio
import numpy as np
import pytest

import quasiform as qf
from quasiform.checks import interruptible
from quasiform.console.cli import main
from quasiform.result.files import FILES, SENSITIVITY
from quasiform.scenes import scene_file
from quasiform.solve import Journal, dependence, journal
from quasiform.solve.run import Run


def forming(size=12.0, travel=20.0):
    return qf.forming("hemisphere", orientation=0, size=size, travel=travel)


class KilledError(BaseException):
    """What no handler of the program catches, as SIGKILL."""


@pytest.fixture(autouse=True)
def _all_is_recorded(monkeypatch):
    monkeypatch.setattr(journal, "SHARE", np.inf)
    monkeypatch.setattr(journal, "SOON", 0.0)


def coarse_path(model):
    model.coarsest = 20.0


def killed_after(n):
    """Return a callback that ends a run after n increments."""
    left = [n]

    def count(_):
        left[0] -= 1
        if not left[0]:
            raise KilledError

    return count


def readable(folder):
    """Read every file of a folder; return its summary."""
    summary = json.loads((folder / "summary.json").read_text())
    rows = list(csv.reader((folder / "history.csv").read_text().splitlines()))
    assert all(len(row) == len(rows[0]) for row in rows)
    for path in folder.glob("*.vtu"):
        assert np.isfinite(meshio.read(path).points).all()
    named = (folder / "result.pvd").read_text()
    assert all((folder / part.split('"')[0]).is_file() for part in named.split('file="')[1:])
    return summary


@pytest.mark.parametrize("kills", [[1], [4], [3, 2]])
def test_a_killed_run_is_carried_on_to_the_same_end(tmp_path, kills):
    straight = qf.solve(forming(), estimate=False)
    for i, n in enumerate(kills):
        with pytest.raises(KilledError):
            qf.solve(forming(), killed_after(n), estimate=False, out=tmp_path, resume=i > 0)
        summary = readable(tmp_path)
        assert summary["status"] == "stopped"
        assert "continues it" in summary["reason"]
    result = qf.solve(forming(), estimate=False, out=tmp_path, resume=True)
    assert readable(tmp_path)["status"] == "completed"
    np.testing.assert_allclose(result.states[-1].x, straight.states[-1].x, atol=1e-6)
    assert result.force == pytest.approx(straight.force, rel=1e-6)
    assert result.energy_balance == pytest.approx(straight.energy_balance, rel=1e-6)
    assert result.increments == straight.increments
    for name, column in straight.history.items():
        np.testing.assert_allclose(result.history[name], column, rtol=1e-6, atol=1e-9)
    assert not (tmp_path / "resume.npz").exists()


def test_memory_of_friction_is_part_of_the_record(tmp_path):
    with pytest.raises(KilledError):
        qf.solve(forming(), killed_after(6), estimate=False, out=tmp_path)
    with np.load(tmp_path / "resume.npz") as file:
        record = dict(file)
    anchors = [name for name in record if name.endswith("anchor")]
    assert anchors
    np.savez(tmp_path / "resume.npz", **record | {name: record[name] + 1.0 for name in anchors})
    with pytest.raises(qf.InputError, match="another input"):
        qf.solve(forming(), estimate=False, out=tmp_path, resume=True)


def test_a_run_that_ended_for_good_stays_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(qf.Model, "lost", lambda self, x: "the holder is lost")
    stopped = qf.solve(forming(), estimate=False, out=tmp_path)
    monkeypatch.undo()
    again = qf.solve(forming(), estimate=False, out=tmp_path, resume=True)
    assert again.status == "stopped"
    assert again.reason == stopped.reason
    assert again.states[-1].travel == stopped.states[-1].travel


def test_other_settings_are_refused(tmp_path):
    with pytest.raises(KilledError):
        qf.solve(forming(), killed_after(2), estimate=False, out=tmp_path)
    with pytest.raises(qf.InputError, match="made with another increment, perturbation"):
        qf.solve(forming(), None, 1.0, estimate=False, perturbation=0.1, out=tmp_path, resume=True)
    with pytest.raises(qf.InputError, match="resume needs the folder"):
        qf.solve(forming(), resume=True)


def test_an_interrupt_during_the_estimate_is_told(tmp_path, monkeypatch, capsys):
    def interrupted(*arguments, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr(dependence, "follow", interrupted)
    out = tmp_path / "out"
    assert main(["oat", "--size", "20", "--displacement", "10", "--out", str(out)]) == 3
    assert "interrupted while the error" in readable(out)["reason"]
    monkeypatch.undo()
    assert main(["resume", str(out)]) == 0
    assert readable(out)["error_estimate"]["force_N"] > 0


def test_the_path_of_a_refined_run_is_carried_on(tmp_path):
    scene = qf.forming("hemisphere", size=10, travel=20).including(coarse_path)
    with pytest.raises(KilledError):
        qf.refine(scene, killed_after(5), out=tmp_path)
    assert "on a mesh of 20 mm, the way to one of 10 mm" in readable(tmp_path)["reason"]
    result = qf.refine(scene, out=tmp_path, resume=True)
    assert result.path.model.size == 20
    straight = qf.refine(scene)
    np.testing.assert_allclose(result.states[-1].x, straight.states[-1].x, atol=1e-6)
    assert readable(tmp_path)["status"] == "completed"


@pytest.mark.parametrize("delay", [0.05, 0.4, 1.0])
def test_sigkill_leaves_readable_files_and_resume_carries_on(tmp_path, delay):
    out = tmp_path / "out"
    command = ["oat", "--size", "20", "--displacement", "20", "--increment", "0.25"]
    child = subprocess.Popen(
        [sys.executable, "-m", "quasiform", *command, "--out", str(out)],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    until = time.monotonic() + 60
    while not (out / "summary.json").exists():
        assert time.monotonic() < until
        assert child.poll() is None
        time.sleep(0.01)
    time.sleep(delay)
    child.send_signal(signal.SIGKILL)
    child.wait()
    readable(out)
    if (out / "resume.npz").exists():  # else it was quicker
        assert main(["resume", str(out)]) == 0
    straight = qf.solve(qf.off_axis_tension(size=20, displacement=20), increment=0.25)
    summary = readable(out)
    assert summary["status"] == "completed"
    assert summary["force_N"] == pytest.approx(straight.force, rel=1e-6)
    assert summary["estimated_errors"]["force_N"] == pytest.approx(
        straight.estimate["force_N"], rel=1e-6
    )
    assert not list(out.glob(".new-*"))


def test_a_run_from_a_file_is_carried_on_from_any_directory(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copy(scene_file.FOLDER / "hemisphere.toml", "part.toml")
    monkeypatch.setattr(
        "quasiform.console.progress.LiveProgress.__call__", lambda *_: killed_after(1)(None)
    )
    with pytest.raises(KilledError):
        main(["form", "part.toml", "--size", "12", "--travel", "10", "--out", "out"])
    monkeypatch.undo()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert main(["resume", "../out"]) == 0
    assert "completed at 10 of 10 mm" in capsys.readouterr().out
    assert readable(tmp_path / "out")["status"] == "completed"


@pytest.mark.parametrize("change", [{"size": 11.0}, {"law": "best-fit"}, {"orientation": 90}])
def test_another_input_is_refused(tmp_path, capsys, change):
    given = {"orientation": 0, "size": 12, "travel": 20, "symmetry": "none"}
    with pytest.raises(KilledError):
        qf.solve(qf.forming("hemisphere", **given), killed_after(3), estimate=False, out=tmp_path)
    scene = qf.forming("hemisphere", **(given | change))
    with pytest.raises(qf.InputError, match="another input"):
        qf.solve(scene, estimate=False, out=tmp_path, resume=True)
    assert main(["resume", str(tmp_path)]) == 2
    assert "not started by a command" in capsys.readouterr().err


def test_what_is_no_record_is_refused_in_one_line(tmp_path, capsys):
    assert main(["resume", str(tmp_path)]) == 2
    assert "holds no run that can be continued" in capsys.readouterr().err
    for content in (b"", b"nonsense", b"PK\x03\x04"):
        (tmp_path / "resume.npz").write_bytes(content)
        assert main(["resume", str(tmp_path)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    heads = ["3", "[1]", '{"recipe": [1]}', '{"recipe": {"command": ["oat"]}}']
    heads += ['{"recipe": {"command": "oat", "directory": "/"}}', '{"recipe": {"command": "oat"}}']
    for head in heads:
        np.savez(tmp_path / "resume.npz", head=np.array(head))
        assert main(["resume", str(tmp_path)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_record_from_a_stranger_runs_no_code(tmp_path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "pwned"),)

    np.savez(tmp_path / "resume.npz", head=np.array([Evil()], dtype=object))
    with pytest.raises(qf.InputError, match="not a record of a run"):
        Journal(tmp_path, resume=True)
    assert not (tmp_path / "pwned").exists()


def test_a_folder_that_goes_away_stops_the_run_with_the_reason(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calls = []

    def remove(*_):
        calls.append(1)
        if len(calls) == 2:
            shutil.rmtree("out")

    monkeypatch.setattr("quasiform.console.progress.LiveProgress.__call__", remove)
    assert main(["oat", "--size", "40", "--displacement", "20", "--out", "out"]) == 3
    assert "cannot write to out: No such file or directory" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_a_full_disk_loses_nothing_earlier(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    real, calls = qf.Result.write, []

    def full(self, folder, since=0):
        calls.append(1)
        if len(calls) >= 3:
            raise OSError(28, "No space left on device")
        real(self, folder, since)

    monkeypatch.setattr(qf.Result, "write", full)
    assert main(["oat", "--size", "40", "--displacement", "20", "--out", "out"]) == 3
    assert "cannot write to out: No space left on device" in capsys.readouterr().out
    summary = readable(tmp_path / "out")
    assert 0 < summary["reached_mm"] <= 5
    monkeypatch.undo()
    assert main(["resume", str(tmp_path / "out")]) == 0
    assert readable(tmp_path / "out")["reached_mm"] == 20


def test_records_take_a_tenth_of_the_time_of_a_run(tmp_path, monkeypatch):
    monkeypatch.setattr(journal, "SHARE", 0.1)
    now, made, checkpoint = [0.0], [], Journal._checkpoint

    def written(self, run, *given):
        made.append(now[0])
        now[0] += 1.0  # s that a record takes
        return checkpoint(self, run, *given)

    def passed(_):
        now[0] += 3.0  # s that an increment takes

    monkeypatch.setattr(journal.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(Journal, "_checkpoint", written)
    straight = qf.solve(forming(), estimate=False)
    with pytest.raises(KilledError):
        qf.solve(forming(), killed_after(9), estimate=False, out=tmp_path)
    assert len(made) == 1  # the time of the nine increments stood still
    result = qf.solve(forming(), passed, estimate=False, out=tmp_path, resume=True)
    assert result.history["linear_solves"].tolist() == straight.history["linear_solves"].tolist()
    gaps = np.diff(made[1:])
    assert len(gaps) > 1
    assert (gaps >= 11.0).all()  # a second of a record, ten of the run


def test_perturbed_starts_that_were_interrupted_are_solved_by_resume(tmp_path, monkeypatch):
    from quasiform.solve import asked

    def interrupted(*given, **more):
        raise KeyboardInterrupt

    monkeypatch.setattr(asked, "spread", interrupted)
    case = ["form", "hemisphere", "--size", "20", "--travel", "5", "--seeds", "1", "--no-estimate"]
    assert main([*case, "--out", str(tmp_path / "a")]) == 3
    assert "perturbed starts" in readable(tmp_path / "a")["reason"]
    monkeypatch.undo()
    assert main(["resume", str(tmp_path / "a")]) == 0
    summary = readable(tmp_path / "a")
    assert summary["status"] == "completed"
    assert set(summary["spread"]) >= {"force_N", "shear_angle_deg"}
    assert not (tmp_path / "a/resume.npz").exists()


def test_a_path_that_took_long_is_drawn_before_its_error_is_estimated(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(qf.Result, "draw", lambda self, folder: drawn.append(self.estimate))
    for soon in (0.0, 1e9):
        monkeypatch.setattr(journal, "SOON", soon)
        qf.solve(forming(size=20, travel=5), out=tmp_path / str(soon))
    early, *late = [estimate["force_N"] for estimate in drawn]
    assert early is None
    assert len(late) == 2
    assert late[0] == late[1] > 0


def test_a_new_run_leaves_the_old_result_until_it_has_one_of_its_own(tmp_path):
    qf.solve(qf.off_axis_tension(size=40, displacement=5), estimate=False, out=tmp_path)
    with pytest.raises(qf.InputError, match="holds a result already"):
        qf.solve(qf.off_axis_tension(size=40, displacement=5), out=tmp_path)
    over = Journal(tmp_path, force=True)
    assert readable(tmp_path)["status"] == "completed"
    qf.solve(qf.off_axis_tension(size=40, displacement=10), estimate=False, out=over)
    assert readable(tmp_path)["reached_mm"] == 10


def test_a_folder_is_claimed_by_one_run(tmp_path):
    """Eight runs of one case at once: with one --out only one runs, without it all do."""
    case = ["oat", "--size", "80", "--displacement", "2", "--no-estimate"]

    def at_once(*more):
        start = [sys.executable, "-m", "quasiform", *case, *more]
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        runs = [subprocess.Popen(start, cwd=tmp_path, **pipes) for _ in range(8)]
        return [(*run.communicate(), run.returncode) for run in runs]

    assert [status for _, _, status in at_once()] == [0] * 8
    names = {f"oat-45{number}" for number in ("", *(f"-{i}" for i in range(2, 9)))}
    assert {path.name for path in tmp_path.iterdir()} == names
    for name in names:
        assert readable(tmp_path / name)["status"] == "completed"
    found = at_once("--out", "one")
    assert sorted(status for _, _, status in found) == [0] + [2] * 7
    refused = [error for _, error, status in found if status]
    assert all("another run writes to" in e or "holds a result already" in e for e in refused)
    assert readable(tmp_path / "one")["status"] == "completed"
    assert not (tmp_path / "one/.lock").exists()


def test_a_run_that_is_refused_leaves_no_folder(tmp_path):
    with pytest.raises(qf.InputError, match="increment must be at least"):
        qf.solve(forming(), increment=1e-6, out=tmp_path / "new/folder")
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_a_result_is_kept_before_its_error_is_estimated(tmp_path, monkeypatch):
    def killed(*arguments, **named):
        raise KilledError

    monkeypatch.setattr(dependence, "follow", killed)
    with pytest.raises(KilledError):
        qf.solve(forming(), out=tmp_path)
    summary = readable(tmp_path)
    assert summary["status"] == "completed"
    assert summary["estimated_errors"]["force_N"] is None
    for name in set(FILES) - {"gaps.png", *SENSITIVITY}:  # of slip, and where they are asked for
        assert (tmp_path / name).exists(), name
    monkeypatch.undo()
    result = qf.solve(forming(), out=tmp_path, resume=True)
    assert readable(tmp_path)["estimated_errors"]["force_N"] == result.estimate["force_N"] > 0
    assert not (tmp_path / "resume.npz").exists()


def test_an_interrupt_while_the_start_is_recorded_is_said_in_the_result(tmp_path, monkeypatch):
    record = Journal.record

    def interrupted(*given):
        record(*given)
        raise KeyboardInterrupt

    monkeypatch.setattr(Journal, "record", interrupted)
    result = qf.solve(forming(), out=tmp_path, estimate=False)
    assert result.reason.startswith("interrupted at 0 of ")
    assert readable(tmp_path)["reason"] == result.reason
    monkeypatch.undo()
    assert not qf.solve(forming(), out=tmp_path, resume=True, estimate=False).reason


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("wait", ["increment_0000.vtu", "increment_0002.vtu"])
def test_an_interrupted_command_says_so_in_a_line_and_keeps_its_increments(tmp_path, name, wait):
    # small enough for the path to take much longer than a busy machine needs to see its first files
    words = ["form", "hemisphere", "--size", "3", "--no-estimate", "--out", str(tmp_path / "out")]
    command = [sys.executable, "-m", "quasiform", *words]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True, cwd=tmp_path) as run:
        while not (tmp_path / "out" / wait).exists() and run.poll() is None:
            time.sleep(0.02)
        run.send_signal(getattr(signal, name))
        out, err = run.communicate()
    assert run.returncode == 3, err
    assert "Traceback" not in err
    summary = readable(tmp_path / "out")
    assert "interrupted" in summary["reason"]
    assert "interrupted" in out
    assert summary["reached_mm"] >= (10 if wait.endswith("2.vtu") else 0)
    if summary["reached_mm"] == 0:
        assert "0.00" not in out


def test_a_disk_that_is_full_from_the_start_is_one_line(tmp_path, monkeypatch, capsys):
    def full(self, folder, since=0):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(qf.Result, "write", full)
    out = str(tmp_path / "out")
    assert main(["oat", "--size", "40", "--displacement", "20", "--out", out]) == 3
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last == f"stopped at 0 of 20 mm: cannot write to {out}: No space left on device"


def test_an_interrupt_in_compiled_code_is_one():
    def interrupted(cause):
        error = SystemError("returned a result with an exception set")
        raise error from cause

    nested = SystemError("unpickled with an exception set")
    nested.__cause__ = KeyboardInterrupt()
    causes = (KeyboardInterrupt(), nested, ValueError())
    kinds = (KeyboardInterrupt, KeyboardInterrupt, SystemError)
    for cause, kind in zip(causes, kinds, strict=True):
        with pytest.raises(kind), interruptible():
            interrupted(cause)


def test_an_interrupt_in_compiled_code_ends_an_estimate_not_the_result(tmp_path, monkeypatch):
    advance = Run.advance

    def interrupted(self, *arguments, **named):
        if self.model.size > 12:
            raise SystemError from KeyboardInterrupt()
        return advance(self, *arguments, **named)

    monkeypatch.setattr(Run, "advance", interrupted)
    result = qf.solve(forming(), out=tmp_path)
    assert result.reason == readable(tmp_path)["reason"] == dependence.INTERRUPTED
    assert readable(tmp_path)["reached_mm"] == result.model.travel
