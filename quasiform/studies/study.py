"""Many runs of one case, each solved once: what is varied comes from a file."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..checks import InputError
from . import fields, indices, optimise, robust
from .answer import Answer, Row, Solve
from .places import Finished, on_dask, on_pool
from .plan import Case, Job, Plan, plan
from .store import ANSWER, Store, part, pending


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
    pictures: bool = False,
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
    pictures : bool
        Draw pictures of the table, and of the answer to the question of the study.

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
    if share is not None and (planned.study.optimise or planned.study.trim):
        raise InputError("a share does not go with [optimise] or [trim]: each run follows others")
    store = Store(Path(out or planned.study.name), share)
    place = partial(on_pool, workers=workers)
    if scheduler:
        place = partial(on_dask, scheduler=scheduler)
    try:
        solving, found = _Solving(planned, store, place, resume, callback), Answer()
        try:
            if share is None:
                found = _answer(planned, solving.rows, store)
            else:
                solving.rows(part(planned.jobs, share))
        finally:
            solving.end()
            table = store.write_table(planned)
        if share is None:
            text = {ANSWER: "\n".join([*found.lines, ""])} if found.lines else {}
            drawn = _drawn(planned, table, store.rows, found) if pictures else {}
            store.write(found.tables | text | drawn)
    finally:
        store.claim.release()
    return table


def _drawn(
    planned: Plan, table: dict[str, list[Any]], rows: Mapping[str, Row], found: Answer
) -> dict[str, Any]:
    """Pictures of the table and of the answer, by file name."""
    from ..draw import studies as draw

    of_runs = [rows.get(run, {}) for run in table["run"]]
    keys, outputs, spread = planned.keys, planned.study.columns, not planned.study.optimise
    figures = draw.figures(keys, outputs, table, of_runs, spread)
    of_answer = {
        name: getattr(draw, f"{kind}_figure")(*args)
        for name, (kind, args) in found.pictures.items()
    }
    return figures | of_answer


def _answer(planned: Plan, solve: Solve, store: Store) -> Answer:
    """Solve all runs, and those that the question asks for."""
    study, left = planned.study, partial(fields.read, store.folder)
    if study.sobol:
        return indices.answer(planned, solve)
    if study.robust:
        return robust.answer(planned, solve, left)
    if study.optimise:
        return optimise.answer(planned, solve)
    if study.trim:
        from . import trim  # libigl

        return trim.answer(planned, solve, left)
    solve(planned.jobs)
    return Answer()


class _Solving:
    """Runs that are solved where they are not in the store yet."""

    def __init__(
        self,
        plan: Plan,
        store: Store,
        place: Callable[[deque[Job], Plan], Iterator[Finished]],
        resume: bool,
        callback: Callable[[StudyProgress], None] | None,
    ) -> None:
        self.plan, self.store, self.resume, self.callback = plan, store, resume, callback
        self.queue, self.solved, self.clock = deque[Job](), set[str](), time.perf_counter()
        self.finished = place(self.queue, plan)

    def rows(self, jobs: Sequence[Job]) -> list[dict[str, Any]]:
        """Return the rows of some runs in their order."""
        known, count = self.store.rows, len(self.solved)
        new = pending(self.plan, jobs, known, self.resume)
        left = {job.id for job in new if job.id not in self.solved}
        self.queue.extend(job for job in new if job.id in left)
        done = len(self.plan.jobs) - len(pending(self.plan, self.plan.jobs, known, self.resume))
        while left:
            job, row, files = next(self.finished)
            left.remove(job.id)
            self.solved.add(job.id)
            self.store.add({"run": job.id, **row}, files, self.plan.paths)
            solved = len(self.solved) - count
            if self.callback:
                counts = done + solved, len(self.plan.jobs), solved, len(left)
                elapsed = time.perf_counter() - self.clock
                self.callback(StudyProgress(*counts, elapsed, known[job.id]))
        return [{"error": job.error} if job.error else known[job.id] for job in jobs]

    def end(self) -> None:
        """End the worker processes."""
        self.finished.close()
