"""Recorded durations of runs, replayed through Dask on workers that only wait.

    python -m validation.speed.replay FOLDER ...

The workers are threads that are reached by TCP as those of a cluster. Each folder of a study gives
the same share of 1,000 runs, in random order. The time scale is such that 16 workers without a
moment of idleness need a minute.
"""

from __future__ import annotations

import csv
import sys
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from distributed import LocalCluster

from quasiform.studies import places

RUNS, WORKERS, IDEAL = 1000, 16, 60.0


def recorded(folder: Path) -> list[float]:
    """Processor time of the runs of a study, s."""
    with (folder / "study.csv").open(encoding="utf-8") as file:
        return [float(row["cpu_s"]) for row in csv.DictReader(file) if row["cpu_s"]]


def wait(seconds: float, **_: Any) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Take the place of a run."""
    time.sleep(seconds)
    return {}, {}


def main(folders: Sequence[str]) -> None:
    """Print the share of the workers' time that the runs took."""
    chance, known = np.random.default_rng(0), [recorded(Path(folder)) for folder in folders]
    drawn = [chance.choice(known[i % len(known)]) for i in range(RUNS)]
    seconds = chance.permutation(drawn) * WORKERS * IDEAL / sum(drawn)
    jobs = deque(SimpleNamespace(description=float(s)) for s in seconds)
    plan = SimpleNamespace(files={}, study=SimpleNamespace(leaves=(False, False)))
    places.outcome = wait
    threads = {"processes": False, "threads_per_worker": 1, "protocol": "tcp"}
    with LocalCluster(n_workers=WORKERS, dashboard_address=None, **threads) as cluster:
        with cluster.get_client() as client:
            client.wait_for_workers(WORKERS)
            start = time.perf_counter()
            done = sum(1 for _ in places.on_dask(jobs, plan, client))
            took = time.perf_counter() - start
    share = sum(seconds) / (WORKERS * took)
    print(f"{done} runs of {min(seconds):.2g} to {max(seconds):.2g} s (factor ", end="")
    print(f"{max(drawn) / min(drawn):.3g}) on {WORKERS} workers: {took:.1f} s, {100 * share:.1f} %")


if __name__ == "__main__":
    main(sys.argv[1:])
