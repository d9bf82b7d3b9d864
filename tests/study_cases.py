"""Functions of the varied values, which the worker processes of `test_study` import."""

import multiprocessing
import os
import signal
from pathlib import Path

import quasiform as qf
from quasiform.console.cli import main
from quasiform.toml_file import toml_text

FLAG = "QUASIFORM_TEST_FLAG"


def strip(displacement):
    return qf.off_axis_tension(displacement=displacement, size=40.0)


def begun(start):
    return strip(start)


def stiffer(model):
    model.terms[0].volume *= 2.0


def deadly(model):
    """Kill the worker that builds this model: always, or once where a flag is named."""
    flag = os.environ.get(FLAG)
    if multiprocessing.parent_process() and not (flag and Path(flag).exists()):
        if flag:
            Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)


def mortal(displacement):
    """The run at 6 mm kills its worker."""
    recipe = strip(displacement).recipe
    return recipe.including(deadly) if displacement == 6.0 else recipe


def dying(folder, resume=False):
    """Study with the run that kills its worker."""
    study = {"outputs": ["force_N"], "vary": {"displacement": [5.0, 6.0, 7.0]}}
    return qf.study(study, out=folder, case=mortal, resume=resume)


def dying_again(folder):
    return dying(folder, resume=True)


def idle(folder):
    """Study whose workers are killed when they have nothing to do."""

    def kill(step):
        for child in multiprocessing.active_children():
            os.kill(child.pid, signal.SIGKILL)
            child.join()

    study = {"kind": "oat", "size": 40.0, "estimate": False, "outputs": ["force_N"]}
    study["vary"] = {"displacement": [4.0, 5.0, 6.0, 7.0]}
    return qf.study(study, out=folder, callback=kill)


def changed(displacement):
    return strip(displacement).including(stiffer)


def local(displacement):
    return strip(displacement).including(lambda model: None)


def refused(study, message, folder, capsys):
    """A study without the keys that are None ends with 2 and one line, before its first run."""
    path = folder / "study.toml"
    path.write_text(toml_text({k: v for k, v in study.items() if v is not None}), encoding="utf-8")
    assert main(["study", str(path), "--out", str(folder / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (folder / "out").exists()
