"""Functions of the varied values, which the worker processes of `test_study` import."""

import multiprocessing
import os
import signal
from pathlib import Path

import quasiform as qf

FLAG = "QUASIFORM_TEST_FLAG"


def strip(displacement):
    return qf.off_axis_tension(displacement=displacement, size=40.0)


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


def changed(displacement):
    return strip(displacement).including(stiffer)


def local(displacement):
    return strip(displacement).including(lambda model: None)
