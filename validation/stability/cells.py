"""Solve cells of the map, each in its own process with a time limit, and store them.

A process is forked for each cell, so that a crash or a hang of one does not stop the others. A
finished cell is stored in `cells.json` with date, version and a fingerprint of the sources.
"""

from __future__ import annotations

import ast
import hashlib
import json
import multiprocessing
import os
import resource
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from functools import cache
from multiprocessing import connection
from pathlib import Path
from typing import Any

import numpy as np

import quasiform as qf
from quasiform.result.summary import package_version

from .scenes import CASES, SPAN
from .settings import DEFAULT, Cell, Setting

LIMIT = 400.0  # s of processor time of a cell; more is a hang
PATIENCE = 4.0  # times that in wall time, for a cell that waits without computing
# modules that do not influence a solution: cells stay valid when they change
APART = {
    *("__main__", "console", "draw", "comparison", "handover", "identification", "theory"),
    *("files", "journal", "record", "saved", "cad", "grid", "surface_file", "levels", "spread"),
}


@dataclass(frozen=True)
class Solved:
    """The result of a cell.

    Parameters
    ----------
    scene : str
    setting : Setting
    outcome : str
        "completed", "stopped", "refused", "crash" or "hang".
    reason : str
        Why it is not completed, or what is wrong with its end state.
    reached, goal : float
        Travel, mm (or load factor).
    rescues : dict of rung to count
    certified : str
        "yes", or the reasons why not.
    collapse : float or None
        Travel at which the first triangle collapses, mm.
    averages : dict
        Values that another solve of the same problem must find too.
    estimate : dict
        The program's error estimates of them, where they exist.
    waves : dict
        Wavelength and envelope of wrinkles.
    force : float
        At the end, N.
    residual, energy_balance : float
    negative_pivots : int or None
    solves, increments : int
    warned : list of str
        Warnings of numpy and others.
    seconds : float
        Processor time.
    key, sources, version, date : str
        Hash of the input; fingerprint of the sources; version; date.
    """

    scene: str
    setting: Setting
    outcome: str
    reason: str = ""
    reached: float = 0.0
    goal: float = 0.0
    rescues: dict[str, int] = field(default_factory=dict)
    certified: str = "not solved"
    collapse: float | None = None
    averages: dict[str, float] = field(default_factory=dict)
    estimate: dict[str, float] = field(default_factory=dict)
    waves: dict[str, float | None] = field(default_factory=dict)
    force: float = 0.0
    residual: float | None = None
    energy_balance: float | None = None
    negative_pivots: int | None = None
    solves: int = 0
    increments: int = 0
    warned: list[str] = field(default_factory=list)
    seconds: float = 0.0
    key: str = ""
    sources: str = ""
    version: str = ""
    date: str = ""

    @property
    def cell(self) -> Cell:
        """Scene and setting."""
        return Cell(self.scene, self.setting)

    @property
    def share(self) -> float:
        """Share of the travel reached."""
        return self.reached / self.goal if self.goal else 0.0

    @property
    def arrived(self) -> bool:
        """Whether it reached full travel in a correct state."""
        return self.outcome == "completed" and not self.reason


def solve(cell: Cell) -> dict[str, Any]:
    """Build and solve a cell; fields of `Solved`."""
    case, setting = CASES[cell.scene], cell.setting
    scene = case.build(cell.size, case.fabric(setting.contact, setting.friction))
    increment = setting.increment * (scene.travel / SPAN if case.scaled else 1.0)
    chosen: dict[str, Any] = {
        "increment": increment or None,
        "convex": setting.convex,
        "method": setting.method,
        "perturbation": setting.perturbation,
        "seed": setting.seed,
    }
    usual = {"increment": None, **{name: getattr(DEFAULT, name) for name in list(chosen)[1:]}}
    differing = {name: value for name, value in chosen.items() if value != usual[name]}
    result = qf.solve(scene, estimate=setting.estimate, **differing)
    found: dict[str, Any] = {
        "outcome": result.status,
        "reason": result.reason or case.wrong(result),
        "reached": result.states[-1].travel,
        "goal": scene.travel,
        "rescues": result.rescues,
        "certified": "yes" if result.certified else "; ".join(result.certified.reasons),
        "collapse": result.collapse and result.collapse["travel_mm"],
        "averages": case.averages(result),
        "force": result.force,
        "residual": _finite(result.residual),
        "energy_balance": _finite(result.energy_balance),
        "negative_pivots": result.negative_pivots,
        "solves": int(result.linear_solves),
        "increments": result.increments,
    }
    found["estimate"] = {
        name: result.estimate[name]
        for name in found["averages"]
        if result.estimate.get(name) is not None
    }
    if case.waves and not result.reason:
        found["waves"] = case.waves(result)
    numbers = [*found["averages"].values(), result.force, *result.states[-1].x]
    if not np.isfinite(numbers).all():
        return {"outcome": "crash", "reason": "the end state is not finite"}
    return found


def _finite(value: float) -> float | None:
    """A number, or None where JSON has none."""
    return float(value) if np.isfinite(value) else None


def _child(cell: Cell, limit: float, sender: connection.Connection) -> None:
    """Solve a cell within its time and send the result."""
    seconds = int(np.ceil(limit))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = solve(cell)
        except qf.InputError as error:
            found = {"outcome": "refused", "reason": str(error)}
        except Exception:
            found = {"outcome": "crash", "reason": _last_line(traceback.format_exc())}
    found["warned"] = sorted({f"{w.category.__name__}: {w.message}" for w in caught})
    found["seconds"] = round(time.process_time(), 2)
    sender.send(found)


def _last_line(text: str) -> str:
    """The error of a traceback with the file and line where it was raised."""
    lines = text.strip().splitlines()
    places = [line.split('"')[1:] for line in lines if line.startswith("  File ")]
    where = [f"{Path(p[0]).name}{p[1].split(' in ')[0].replace(', line ', ':')}" for p in places]
    return f"{lines[-1]} ({where[-1]})" if where else lines[-1]


def solve_all(
    waiting: list[Cell], workers: int, limit: float = LIMIT, work: Callable = _child
) -> Iterator[Solved]:
    """Solve cells, each in its own process, `workers` at a time; yield them when they are done.

    Parameters
    ----------
    waiting : list of Cell
        The first is started first.
    workers : int
    limit : float
        Processor time of a cell, s.
    work : function of the cell, the limit and the sending end of a pipe
        Run in the process.
    """
    context = multiprocessing.get_context("fork")  # the package is imported once
    waiting, running = list(waiting), {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                cell = waiting.pop(0)
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=work, args=(cell, limit, sender), daemon=True)
                process.start()
                sender.close()  # else the end of the process would not be noticed
                running[receiver] = cell, process, time.monotonic()
            ready = connection.wait(list(running), timeout=2.0)
            for receiver, (cell, process, began) in list(running.items()):
                late = time.monotonic() - began > PATIENCE * limit
                if receiver not in ready and not late:
                    continue
                found = None
                if receiver in ready:
                    with suppress(EOFError):
                        found = receiver.recv()
                if late:
                    process.kill()
                process.join()
                del running[receiver]
                receiver.close()
                yield _dated(cell, found or _died(process.exitcode, late, limit))
    finally:
        for _, process, _ in running.values():
            process.kill()
            process.join()


def _died(exitcode: int, late: bool, limit: float) -> dict[str, Any]:
    """Outcome of a cell whose process sent nothing."""
    if late:
        return {"outcome": "hang", "reason": f"not done after {PATIENCE * limit:.0f} s"}
    if -exitcode in (signal.SIGXCPU, signal.SIGKILL):
        return {
            "outcome": "hang",
            "reason": f"not done in {limit:.0f} s of processor time",
            "seconds": limit,
        }
    end = f"signal {signal.Signals(-exitcode).name}" if exitcode < 0 else f"status {exitcode}"
    return {"outcome": "crash", "reason": f"the process ended with {end}"}


def _dated(cell: Cell, found: dict[str, Any]) -> Solved:
    return Solved(
        cell.scene,
        cell.setting,
        key=key(cell),
        sources=sources(),
        version=package_version(),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        **found,
    )


# Stored cells


@cache
def sources() -> str:
    """Fingerprint of the code on which a solution depends."""
    folder = Path(qf.__file__).parent
    paths = [
        path
        for path in sorted(folder.rglob("*.py"))
        if not APART & {*path.relative_to(folder).with_suffix("").parts}
        and path != folder / "__init__.py"
    ]
    here = Path(__file__)
    return fingerprint(
        [*paths, here.with_name("scenes.py"), *sorted(here.parents[2].glob("geometries/*.toml"))]
    )


def fingerprint(paths: list[Path]) -> str:
    """Digest of files, without comments and docstrings of Python."""
    digest = hashlib.sha256()
    for path in paths:
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".py":
            tree = ast.parse(text)
            for node in ast.walk(tree):
                if _documented(node):
                    node.body = node.body[1:]
            text = ast.dump(tree)
        digest.update(f"{path.name}\n{text}".encode())
    return digest.hexdigest()[:12]


def _documented(node: ast.AST) -> bool:
    """Whether the body of a node begins with a docstring."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    return isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None


def key(cell: Cell) -> str:
    """Hash of the input of a cell: scene, size, setting and sources."""
    content = json.dumps([cell.scene, cell.size, asdict(cell.setting), sources()])
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def read(*paths: Path) -> dict[Cell, Solved]:
    """Stored cells; of the same cell the newest."""
    found: dict[Cell, Solved] = {}
    names = {f.name for f in fields(Solved)}
    for path in paths:
        if not path.exists():
            continue
        for entry in json.loads(path.read_text(encoding="utf-8")):
            entry = {name: value for name, value in entry.items() if name in names}
            solved = Solved(**entry | {"setting": Setting(**entry["setting"])})
            known = found.get(solved.cell)
            if known is None or known.date <= solved.date:
                found[solved.cell] = solved
    return found


def write(path: Path, kept: dict[Cell, Solved]) -> None:
    """Write the cells, one per line, in one step."""
    rows = sorted(kept.values(), key=lambda s: (s.scene, str(s.setting)))
    lines = ",\n".join(json.dumps(asdict(row)) for row in rows)
    new = path.with_suffix(".part")
    new.write_text(f"[\n{lines}\n]\n", encoding="utf-8")
    new.replace(path)
