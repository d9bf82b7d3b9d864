"""Large meshes: time, solves and memory of the hemisphere, each size in its own process."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time

import numpy as np

from ..tables import markdown_table

SIZES = (2.2, 1.1, 0.55)  # mm: about 10 000, 40 000 and 160 000 triangles of a quarter
LONGEST = 480.0  # s: the last one is skipped if the one before took longer


def table() -> str:
    """A Markdown table of the runs, and the slope of time over unknowns."""
    runs: list[dict] = []
    note = ""
    for size in SIZES:
        if size == SIZES[-1] and runs[-1]["wall"] > LONGEST:
            note = f"{size:g} mm skipped: {runs[-1]['size']:g} mm took {runs[-1]['wall']:.0f} s."
            break
        answer = subprocess.run(
            [sys.executable, "-m", "validation.speed.scale", str(size)],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        runs.append(json.loads(answer.stdout.splitlines()[-1]))
        print(runs[-1], flush=True)
    names = ["size", "triangles", "dofs", "seconds", "wall", "solves", "memory_gb", "p99", "force"]
    names += ["estimate", "certified", "rescues"]
    head = ["size mm", "triangles", "dofs", "s", "wall s", "solves", "peak memory GB", "p99 °"]
    head += ["force N", "estimate °", "certified", "rescues"]
    cells = [[_cell(run[name]) for name in names] for run in runs]
    slope = np.polyfit(*(np.log([run[key] for run in runs]) for key in ("dofs", "seconds")), 1)[0]
    return (
        "Hemisphere 0°, a quarter as the scene models it, mesh continuation; each row in its "
        f"own process, memory with Python and its imports.\n\n{markdown_table(head, cells)}\n\n"
        f"Time grows with the unknowns to the power {slope:.2f}. {note}".rstrip()
    )


def one(size: float) -> dict:
    """One run; its numbers."""
    import quasiform as qf

    wall, processor = time.perf_counter(), time.process_time()
    result = qf.refine(qf.forming("hemisphere", size=size))
    return {
        "size": size,
        "triangles": len(result.model.sheet.blank.triangles),
        "dofs": int((~result.model.fixed).sum()),
        "seconds": time.process_time() - processor,
        "wall": time.perf_counter() - wall,
        "solves": float(result.linear_solves),
        "memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "p99": result.quantities["shear_angle_deg"],
        "force": result.force,
        "estimate": result.estimate["shear_angle_deg"],
        "certified": bool(result.certified),
        "rescues": result.rescues,
    }


def _cell(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}: {count}" for name, count in value.items())
    if isinstance(value, float):
        return f"{value:.4g}"
    return "yes" if value is True else str(value)


if __name__ == "__main__":
    print(json.dumps(one(float(sys.argv[1]))))
