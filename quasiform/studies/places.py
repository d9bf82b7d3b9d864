"""Where the runs of a study are solved: worker processes of this machine, or a Dask cluster.

Each place is a generator of (job, row, files) in the order in which runs finish. It takes runs from
a queue to which others may be added while it waits to be asked for the next one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from ..checks import InputError, optional
from .plan import Job, Plan
from .run import difference, environment, folder, outcome, unpack

Finished = tuple[Job, dict[str, Any], dict[str, bytes]]
THREADS = [f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "VECLIB", "NUMBA")]
MAIN = "if __name__ == '__main__':"
DIED = {"error": "worker died"}
TRIES = 2  # of a run whose worker dies
AHEAD = 2  # runs for each thread of a cluster that its scheduler has at a time


@contextmanager
def one_thread() -> Iterator[None]:
    """Let processes that start here have one thread for linear algebra each."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def begin(files: Mapping[str, bytes]) -> None:
    """Prepare a worker process: its files, no Ctrl-C of its own, and an end with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: _end())
    unpack(files)
    parent = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), _end()), daemon=True).start()


def _end() -> None:
    if folder.cache_info().currsize:
        folder().cleanup()
    os._exit(1)


class _Worker:
    """One process; a pool of one each, so that a death concerns one run alone."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.files = files
        self.pool = ProcessPoolExecutor(1, spawn, initializer=begin, initargs=(files,))
        self.pid = self.pool.submit(os.getpid)

    def replaced(self) -> _Worker:
        """Return another one in place of one that died; InputError if it did not even start."""
        self.pool.shutdown(wait=False)
        if error := self.pid.exception():
            words = f"worker processes do not start: {error}"
            raise InputError(f"{words} In a script, study(...) goes under {MAIN}") from error
        return _Worker(self.files)

    def kill(self) -> None:
        """End it at once, whatever it does."""
        with suppress(OSError, BrokenProcessPool, TimeoutError):
            if not self.pid.cancel():
                os.kill(self.pid.result(timeout=30), signal.SIGTERM)
        self.pool.shutdown(wait=False, cancel_futures=True)


def on_pool(jobs: deque[Job], plan: Plan, workers: int) -> Iterator[Finished]:
    """Solve runs in worker processes of this machine."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise InputError(f"study(...) of a script goes under {MAIN}")
    again: deque[tuple[Job, int]] = deque()
    busy: dict[Future, tuple[_Worker, Job, int]] = {}
    with one_thread():
        idle = [_Worker(plan.files) for _ in range(min(workers, len(jobs)))]
        try:
            while jobs or again or busy:
                while (jobs or again) and idle:
                    worker = idle.pop()
                    job, tries = again.popleft() if again else (jobs.popleft(), 1)
                    how = job.description, {}, *plan.study.leaves
                    with suppress(BrokenProcessPool):  # it died while it had nothing to do
                        busy[worker.pool.submit(outcome, *how)] = worker, job, tries
                        continue
                    idle.append(worker.replaced())
                    again.appendleft((job, tries))
                for future in wait(busy, return_when=FIRST_COMPLETED).done:
                    worker, job, tries = busy.pop(future)
                    try:
                        row, files = future.result()
                        idle.append(worker)
                    except BrokenProcessPool:
                        idle.append(worker.replaced())
                        if tries < TRIES:
                            again.appendleft((job, tries + 1))
                            continue
                        row, files = DIED, {}
                    yield job, row, files
        finally:
            for worker, *_ in busy.values():
                worker.kill()
            for worker in idle:
                worker.pool.shutdown()


def on_dask(jobs: deque[Job], plan: Plan, scheduler: Any) -> Iterator[Finished]:
    """Solve runs on a Dask cluster, by the address of its scheduler or a client of it.

    Dask repeats the runs of a worker that dies, and says when several have died with one.
    """
    distributed = optional("distributed", "study", "a scheduler needs Dask")
    own = isinstance(scheduler, str)
    try:
        client = distributed.Client(scheduler, timeout=10) if own else scheduler
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler at {scheduler}: {error}") from error
    try:
        _check_workers(client)
        files = client.submit(dict, plan.files, pure=False)  # made again if its worker dies
        solve = partial(client.submit, outcome, pure=False, retries=1)
        settings = {"files": files, **dict(zip(("keep", "fields"), plan.study.leaves, strict=True))}
        running, suspects = {}, deque()
        finished = distributed.as_completed()

        def fill() -> None:
            most = AHEAD * max(sum(client.nthreads().values()), 4)
            while jobs and len(running) < most:
                job = jobs.popleft()
                future = solve(job.description, **settings)
                running[future.key] = job
                finished.add(future)

        while jobs:
            fill()
            for future in finished:
                job = running.pop(future.key)
                try:
                    yield job, *future.result()
                except distributed.scheduler.KilledWorker:
                    suspects.append(job)
                fill()
            while suspects:  # alone: those that waited on a worker that died are suspected too
                job = suspects.popleft()
                try:
                    row, left = solve(job.description, **settings).result()
                except distributed.scheduler.KilledWorker:
                    row, left = DIED, {}
                yield job, row, left
    finally:
        if own:
            client.close()


def _check_workers(client: Any) -> None:
    """Refuse a worker with another version, linear solver or without numba, by its name."""

    def found() -> dict[str, Any]:  # sent as code: another version may not have this module
        from importlib.metadata import version

        try:
            from quasiform.studies.run import environment
        except ImportError:
            return {"quasiform": version("quasiform")}
        return environment()

    for address, there in client.run(found, on_error="return").items():
        there = {} if isinstance(there, Exception) else there
        if other := difference(environment(), there):
            raise InputError(f"worker {address} has {other}")
