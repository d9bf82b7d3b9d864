"""Many runs of one case, each solved once: what is varied comes from a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..checks import InputError
from .places import on_dask, on_pool
from .plan import Case, Plan, plan
from .store import Store, pending


@dataclass(frozen=True)
class StudyProgress:
    """What the callback of a study is called with after each run.

    Parameters
    ----------
    done, total : int
        Count of runs that are finished, and of all.
    solved, left : int
        Count of runs that this call has solved, and has still to solve.
    elapsed : float
        Since it began, s.
    row : dict
        Of the run: its name `run`, and its `summary` or the `error`.
    """

    done: int
    total: int
    solved: int
    left: int
    elapsed: float
    row: dict[str, Any]


def study(
    source: str | Path | Mapping[str, Any] | Plan,
    workers: int = 1,
    scheduler: Any = None,
    share: tuple[int, int] | None = None,
    resume: bool = False,
    out: str | Path | None = None,
    case: Case | None = None,
    callback: Callable[[StudyProgress], None] | None = None,
) -> dict[str, list[Any]]:
    """Solve many runs of a case, and return and write their table.

    Runs that are finished in the folder are not repeated. Solving happens in other processes: a
    script calls it under `if __name__ == "__main__":`.

    Parameters
    ----------
    source : path or dict
        File of the study, or its table.
    workers : int
        Count of worker processes on this machine, one thread each.
    scheduler : str or Client, optional
        Address of a Dask scheduler, or a client of it, in place of worker processes.
    share : (int, int), optional
        Number i, from 1, and count n: every n-th run alone, from number i on.
    resume : bool
        Repeat runs that failed.
    out : path, optional
        Folder; named after the study if not given.
    case : callable, optional
        In place of a scene: a function of the varied values that returns a recipe or a model.
    callback : callable, optional
        Called with a `StudyProgress` after each run.

    Returns
    -------
    dict of str to list
        The columns of `study.csv`, a row for each finished run in the order of the design;
        `pandas.DataFrame` takes it.

    Raises
    ------
    InputError
        For a wrong study before its first run, a folder that cannot be written, and a Dask worker
        with another version.
    """
    if not isinstance(workers, int) or workers < 1:
        raise InputError(f"workers must be a whole number from 1 on, got {workers!r}")
    if share is not None and not 1 <= share[0] <= share[1]:
        raise InputError(f"share must be I/N with I from 1 to N, got {share[0]}/{share[1]}")
    if share is not None and scheduler is not None:
        raise InputError("a share is solved on one machine: give a share or a scheduler")
    planned = source if isinstance(source, Plan) else plan(source, case)
    clock = time.perf_counter()
    store = Store(Path(out or planned.study.name), share)
    try:
        jobs = pending(planned, store.rows, resume, share)
        done = len(planned.jobs) - len(pending(planned, store.rows, resume))
        place = on_dask(jobs, planned, scheduler) if scheduler else on_pool(jobs, planned, workers)
        try:
            for solved, (job, row, files) in enumerate(place if jobs else (), 1):
                store.add({"run": job.id, **row}, files, planned.paths)
                counts = done + solved, len(planned.jobs), solved, len(jobs) - solved
                if callback:
                    elapsed = time.perf_counter() - clock
                    callback(StudyProgress(*counts, elapsed, store.rows[job.id]))
        finally:
            place.close()
            table = store.write_table(planned)
    finally:
        store.claim.release()
    return table
