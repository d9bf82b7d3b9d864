"""The journal of a run: its folder kept up to date increment by increment, and carried on from.

After each increment the state of the run, with the memory of friction and the account of energy,
goes into `resume.npz`; after each row of the history the files of the result up to there are
written too, with the status "stopped" and how to carry on. Every file is made beside its place and
then put there in one step, so that a run killed at any moment leaves readable ones. The first
record takes the place of an older result; the end of the run replaces the last.

`resume.npz` holds numbers and text alone: reading one from a stranger runs no code.
"""

from __future__ import annotations

import io
import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from ..checks import InputError
from ..result.files import FILES, RESUME, added, check_folder
from ..result.run import Result, State

if TYPE_CHECKING:
    from .increments import Run

FloatArray = np.ndarray
KEPT = ("travel", "increments", "work", "gap", "damped", "rescues", "snaps", "collapse")
KEPT += ("doubt", "ended")
COUNTED = ("travel", "linear_solves", "solve_s", "carried_on", "convex_taken", "relaxed")


class Journal:
    """The folder of a run.

    Parameters
    ----------
    out : path
        Folder of the run; made if missing.
    recipe : dict, optional
        What the scene is made from, in numbers and text, for `quasiform resume`.
    force : bool
        Whether the folder may hold a result already.
    resume : bool
        Carry on from the run that it holds.

    Raises
    ------
    InputError
        If the folder cannot be written, holds a result already, or, with `resume`, holds no run
        that can be carried on.
    """

    def __init__(
        self,
        out: str | Path,
        recipe: dict[str, Any] | None = None,
        *,
        force: bool = False,
        resume: bool = False,
    ) -> None:
        self.folder, self.recipe = Path(out), recipe
        self.held: dict[str, Any] = {}
        self.goal = ""  # what follows the travel, in words
        self._rows = 0
        if resume:
            self._read()
        else:
            check_folder(out, force=force)
        for left in self.folder.glob(".new-*"):  # by a run that was killed
            rmtree(left, ignore_errors=True)

    def _read(self) -> None:
        path = self.folder / RESUME
        if not path.is_file():
            status = ""
            with suppress(OSError, ValueError, KeyError, TypeError):
                status = json.loads((self.folder / "summary.json").read_bytes())["status"]
            done = ": it is completed" if status == "completed" else f" ({RESUME})"
            raise InputError(f"{self.folder} holds no run that can be carried on{done}")
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            self.held = {**json.loads(str(arrays.pop("head"))), "arrays": arrays}
            self.recipe = self.held["recipe"]
        except (OSError, ValueError, KeyError, TypeError, BadZipFile, EOFError) as error:
            raise InputError(f"{path}: not a record of a run ({error})") from error

    def record(self, run: Run, step: float, elapsed: float) -> None:
        """Write the run as it stands.

        Parameters
        ----------
        run : Run
            After a converged increment.
        step : float
            Size of the next increment, mm.
        elapsed : float
            Time so far, s.

        Raises
        ------
        OSError
            If the folder is gone or cannot be written; what was there stays.
        """
        memory = _memory(run)
        with added(self.folder, instead=() if self._rows else FILES) as staging:
            if memory is not None:
                (staging / RESUME).write_bytes(self._checkpoint(run, step, elapsed, memory))
            if len(run.states) > self._rows:
                carry_on = "quasiform resume" if self.recipe else "solve(..., resume=True)"
                reason = (
                    f"killed or still running after {run.travel:.4g} of "
                    f"{run.scene.travel:.4g}{self.goal}: {carry_on} carries on"
                    if memory is not None
                    else f"killed or still running after {run.travel:.4g}"
                )
                run.result(reason, elapsed).write(staging, since=self._rows)
                self._rows = len(run.states)

    def _checkpoint(
        self, run: Run, step: float, elapsed: float, memory: dict[str, FloatArray]
    ) -> bytes:
        head = {
            "recipe": self.recipe,
            "parameters": run.scene.parameters,
            "settings": asdict(run.settings),
            "step": step,
            "elapsed": elapsed,
            "run": {name: getattr(run, name) for name in KEPT},
            "equilibrium": {name: getattr(run.equilibrium, name) for name in COUNTED},
            "entry": [run.entry.travel, run.entry.force, run.entry.stored],
        }
        states = run.states
        stream = io.BytesIO()
        np.savez(
            stream,
            head=np.array(_json(head)),
            x=run.x,
            g=run.equilibrium.potential.gradient(run.x),
            states=np.array([state.x for state in states]),
            rows=np.array(
                [[s.travel, s.force, s.linear_solves, *s.measures.values()] for s in states]
            ),
            **memory,
        )
        return stream.getvalue()

    def restore(self, run: Run) -> tuple[float, float]:
        """Put a run of the same scene where the recorded one was.

        Parameters
        ----------
        run : Run
            At its start.

        Returns
        -------
        step : float
            Size of the next increment, mm.
        elapsed : float
            Time of the recorded run, s.

        Raises
        ------
        InputError
            If the scene or the settings are others, or the record is damaged.
        """
        try:
            return self._restored(run)
        except InputError:
            raise
        except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
            raise InputError(f"{self.folder / RESUME}: not a record of a run ({error})") from error

    def _restored(self, run: Run) -> tuple[float, float]:
        held, arrays, scene = self.held, self.held["arrays"], run.scene
        other = InputError(
            f"{self.folder}: the run there is of another input: scene, material or program have "
            "changed since"
        )
        given = json.loads(_json(scene.parameters))
        settings = json.loads(_json(asdict(run.settings)))
        if changed := [name for name in settings if settings[name] != held["settings"][name]]:
            raise InputError(
                f"{self.folder}: the run there was made with another {', '.join(changed)}"
            )
        for parameters in (given, held["parameters"]):
            parameters.pop("scene_file", None)  # it may have moved
        if held["parameters"] != given or arrays["x"].shape != scene.x0.shape:
            raise other
        run.x = arrays["x"]
        run.states = [
            State(row[0], x, row[1], int(row[2]), dict(zip(scene.measures, row[3:], strict=True)))
            for x, row in zip(arrays["states"], arrays["rows"].tolist(), strict=True)
        ]
        for name in KEPT:
            setattr(run, name, held["run"][name])
        for name in COUNTED:
            setattr(run.equilibrium, name, held["equilibrium"][name])
        for i, term in enumerate(scene.remembering):
            term.recall(_parts(arrays, f"term {i} "))
        g = run.equilibrium.potential.gradient(run.x)
        if not np.allclose(g, arrays["g"], rtol=1e-9, atol=1e-9 * np.abs(arrays["g"]).max()):
            raise other
        run.equilibrium.certify(run.x)  # as the run had done: the next steps are the same ones
        for name in COUNTED:
            setattr(run.equilibrium, name, held["equilibrium"][name])
        run.reopen(*held["entry"], _parts(arrays, "rubbing "))
        self._rows = len(run.states)
        return held["step"], held["elapsed"]

    def close(self, result: Result) -> None:
        """Write the result; a completed run cannot be carried on any more.

        Where it cannot be written, this becomes the `reason` of the result.

        Parameters
        ----------
        result : Result
        """
        try:
            with added(self.folder) as staging:
                result.write(staging)
            if result.scene.outputs["pictures"]:
                with added(self.folder) as staging:
                    result.draw(staging)
            if not result.reason:
                (self.folder / RESUME).unlink(missing_ok=True)
        except OSError as error:
            told = f"cannot write to {self.folder}: "
            if told not in result.reason:
                reason = f"{told}{error.strerror or error}"
                result.reason = f"{result.reason}; {reason}" if result.reason else reason


def _memory(run: Run) -> dict[str, FloatArray] | None:
    """Arrays that terms and account remember, by name; None if a term does not tell."""
    arrays = {}
    for i, term in enumerate(run.scene.remembering):
        if not hasattr(term, "memory"):
            return None
        arrays |= {f"term {i} {name}": values for name, values in term.memory().items()}
    for i, (force, place) in enumerate(run.entry.rubbing):
        arrays |= {f"rubbing {i} force": force, f"rubbing {i} place": place}
    return arrays


def _json(content: Any) -> str:
    return json.dumps(content, default=np.generic.item)


def _parts(arrays: dict[str, FloatArray], prefix: str) -> dict[str, FloatArray]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
