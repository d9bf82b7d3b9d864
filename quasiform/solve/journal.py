"""The journal of a run: its folder is kept up to date, so that a killed run can be continued.

After an increment the state of the run, with the states of its terms and the energy account, goes
into `resume.npz`; after a row of the history the files of the result up to there are written
too, with the status "stopped" and how to continue. Quick increments pass without a record, so that
records take at most a tenth of the time of a run. Every file is made beside its place and then put
there in one step, so that a run killed at any moment leaves readable ones. The first record takes
the place of an older result; the end of the run replaces the last.

`resume.npz` holds numbers and text alone. The recipe in it names functions by module and name.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields, replace
from pathlib import Path
from shutil import rmtree
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..checks import FORMAT, InputError
from ..model import Model
from ..recipe import Recipe
from ..result.files import FILES, RESUME, Claim, added, check_folder
from ..result.run import Result, State
from .run import Account, Run

SHARE = 0.1  # of the time of a run, for its records
SOON = 20.0  # s: what took less is drawn once, with its error
UNREADABLE = OSError, LookupError, TypeError, ValueError, AttributeError, EOFError, BadZipFile


class Journal:
    """The folder of a run.

    Parameters
    ----------
    out : path or Claim
        Made if missing. No other run writes to it until this one is closed; a claim is released
        by who made it.
    options : dict, optional
        How the run was asked for, in numbers and text, for whoever continues it.
    force, resume : bool
        The folder may hold a result already; continue the run that it holds.

    Raises
    ------
    InputError
        If the folder cannot be written, another run writes to it, or it holds a result already, or
        no run to be continued.
    """

    def __init__(
        self,
        out: str | Path | Claim,
        options: dict[str, Any] | None = None,
        *,
        force: bool = False,
        resume: bool = False,
    ) -> None:
        claim = out if isinstance(out, Claim) else Claim(out)
        self._own = None if claim is out else claim  # who made it releases it
        self.folder, self.options = claim.folder, options or {}
        self.recorded: dict[str, Any] = {}
        self.goal = ""  # what follows the travel, as a text
        self._rows = 0
        self._due = 0.0  # when the next record is made, s
        self.more = False  # whether a completed result is not the last one: perturbed starts follow
        if resume:
            self._read()
        else:
            check_folder(self.folder, force=force)
        for left in self.folder.glob(".new-*"):  # by a run that was killed
            rmtree(left, ignore_errors=True)

    def _read(self) -> None:
        path = self.folder / RESUME
        if not path.is_file():
            status = ""
            with suppress(OSError, ValueError, KeyError, TypeError):
                status = json.loads((self.folder / "summary.json").read_bytes())["status"]
            done = ": it is completed" if status == "completed" else f" ({RESUME})"
            raise InputError(f"{self.folder} holds no run that can be continued{done}")
        with self._reading(), path.open("rb") as stream, np.load(stream) as file:
            arrays = {name: file[name] for name in file.files}
            self.recorded = {**json.loads(str(arrays.pop("head"))), "arrays": arrays}
            known = self.recorded.get("format", 1)
            if known != FORMAT:
                raise InputError(
                    f"{path}: a record of format {known}, this version continues {FORMAT}: "
                    "start the run again"
                )
            self.options = self.recorded["options"]

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Refuse what is no record of a run, or a damaged one."""
        try:
            yield
        except InputError:
            raise
        except UNREADABLE as error:
            raise InputError(f"{self.folder / RESUME}: not a record of a run ({error})") from error

    def model(self) -> Model:
        """Build the model of the recorded run from its recipe.

        Raises InputError if the record holds none, or its parts are not there any more.
        """
        if not self.recorded["recipe"]:
            raise InputError(
                f"{self.folder}: the run there has no recipe; continue it with "
                "solve(model, out=..., resume=True)"
            )
        with self._reading():
            return Recipe.read(self.recorded["recipe"]).build()

    def record(self, run: Run, step: float, elapsed: float) -> str:
        """Write a run, with the size of its next increment, mm; the reason why it cannot be."""
        began = time.perf_counter()
        pending = len(run.states) > self._rows  # rows are written where the run stands at one
        if self._rows and (began < self._due or (pending and run.states[-1].travel != run.travel)):
            return ""
        try:
            with added(self.folder, instead=() if self._rows else FILES) as staging:
                (staging / RESUME).write_bytes(self._checkpoint(run, step, elapsed))
                if pending:
                    how = "quasiform resume" if _recipe(run) else "solve(..., resume=True)"
                    reason = (
                        f"killed or still running after {run.travel:.4g} of "
                        f"{run.model.travel:.4g}{self.goal}: {how} continues it"
                    )
                    run.result(reason, elapsed).write(staging, since=self._rows)
                    self._rows = len(run.states)
        except OSError as error:
            return self._unwritable(error)
        ended = time.perf_counter()
        self._due = ended + (ended - began) / SHARE
        return ""

    def _unwritable(self, error: OSError) -> str:
        return f"cannot write to {self.folder}: {error.strerror or error}"

    def _checkpoint(self, run: Run, step: float, elapsed: float) -> bytes:
        states = run.states
        head = {"format": FORMAT, "recipe": _recipe(run), "options": self.options}
        head |= {"parameters": run.model.parameters, "settings": asdict(run.settings)}
        head |= {"step": step, "elapsed": elapsed, "travel": run.travel}
        head["factored"] = run.equations.tangent.factored_at(run.x)
        head |= {"account": asdict(run.account), "files": run.model.files}
        head["counted"] = [{name: getattr(of, name) for name in kept} for of, kept in _counted(run)]
        rows = [[s.travel, s.force, s.linear_solves, *s.measures.values()] for s in states]
        arrays = {"x": run.x, "g": run.equations.gradient(run.x), "rows": np.array(rows)}
        arrays["states"] = np.array([state.x for state in states])
        memory = {
            f"term {i} {entry.name}": getattr(state, entry.name)
            for i, state in enumerate(run.memory)
            if state is not None
            for entry in fields(state)
        }
        stream = io.BytesIO()
        np.savez(stream, head=np.array(_json(head)), **arrays, **memory)
        return stream.getvalue()

    def restore(self, run: Run) -> tuple[float, float]:
        """Put a run of the same model where the recorded one was; its next step, mm; time, s."""
        recorded, model = self.recorded, run.model
        other = InputError(
            f"{self.folder}: the run there is of another input: scene, material or program have "
            "changed since"
        )
        given = json.loads(_json(model.parameters))
        # the record has the content of the scene and the fabric, not that of tools and meshes
        files = self.recorded.get("files", {})
        before = {path: files[path] for path in files if not path.endswith(".toml")}
        if other_files := [path for path in before if model.files.get(path) != before[path]]:
            raise InputError(f"{self.folder}: {other_files[0]} has changed since that run")
        settings = json.loads(_json(asdict(run.settings)))
        with self._reading():
            arrays, before = recorded["arrays"], recorded["settings"]
            if changed := [name for name in settings if settings[name] != before[name]]:
                raise InputError(
                    f"{self.folder}: the run there was made with another {', '.join(changed)}"
                )
            for parameters in (given, recorded["parameters"]):
                parameters.pop("scene_file", None)  # it may have moved
            if recorded["parameters"] != given or arrays["x"].shape != model.x0.shape:
                raise other
            run.x, run.travel = arrays["x"], recorded["travel"]
            run.states = [
                State(s, x, force, int(n), dict(zip(model.measures, measures, strict=True)))
                for x, (s, force, n, *measures) in zip(
                    arrays["states"], arrays["rows"].tolist(), strict=True
                )
            ]
            run.account = Account(**recorded["account"])
            run.memory = tuple(
                s and replace(s, **{f.name: arrays[f"term {i} {f.name}"] for f in fields(s)})
                for i, s in enumerate(run.memory)
            )
            run.equations.take(run.memory)
            run.equations.renew()
            g = run.equations.gradient(run.x)
            if not np.allclose(g, arrays["g"], rtol=1e-9, atol=1e-9 * np.abs(arrays["g"]).max()):
                raise other
            if recorded["factored"]:
                run.equations.certify(run.x)  # the next steps are the same ones, and as many
            for (of, _), values in zip(_counted(run), recorded["counted"], strict=True):
                for name, value in values.items():
                    setattr(of, name, type(getattr(of, name))(value))
        self._rows = len(run.states)
        return recorded["step"], recorded["elapsed"]

    def keep(self, result: Result, drawn: bool = False) -> None:
        """Write a result whose error is not estimated yet; `quasiform resume` estimates it.

        Parameters
        ----------
        result : Result
        drawn : bool
            Whether it is drawn too although it took a short time.
        """
        try:
            with added(self.folder, instead=() if self._rows else FILES) as staging:
                result.write(staging, since=max(self._rows - 1, 0))  # those before are there
            self._rows = len(result.states)
            if result.model.outputs["pictures"] and (drawn or result.wall_s > SOON):
                with added(self.folder) as staging:
                    result.draw(staging)
        except OSError as error:
            if "cannot write to" not in result.reason:
                reasons = [result.reason, self._unwritable(error)]
                result.reason = "; ".join(filter(None, reasons))

    def close(self, result: Result) -> None:
        """Write the result; where that cannot be done, this becomes its `reason`."""
        self.keep(result, drawn=True)
        if not result.reason and not self.more:
            with suppress(OSError):
                (self.folder / RESUME).unlink(missing_ok=True)
        if self._own and not self.more:
            self._own.release()


def _recipe(run: Run) -> dict[str, Any] | None:
    """The recipe of a run's model in numbers and text; None where there is none to be read back."""
    if run.model.changed:
        return None
    try:
        return run.model.recipe.written()
    except InputError:  # a change that no other process finds
        return None


def _json(content: Any) -> str:
    return json.dumps(content, default=np.generic.item)


def _counted(run: Run) -> tuple[tuple[Any, tuple[str, ...]], ...]:
    """Objects of a run beside its account, and what of them goes into a checkpoint."""
    of_tangent = "counts", "convex_taken"
    return (run.equations, ("continued", "relaxed", "travel", "peak")), (
        run.equations.tangent,
        of_tangent,
    )
