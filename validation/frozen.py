"""Freeze the results of ten runs in a file, and compare two such files.

    python -m validation.frozen write FILE.json [RUN ...]
    python -m validation.frozen compare A.json B.json

The runs are the six forming scenes (hemisphere, tetrahedron and box at 0 and 45 degrees,
`qf.refine` at size 5) and four off-axis tension tests (45 and 30 degrees, both laws). `compare`
ends with status 1 if a number of a run without a snap differs by more than 1e-9: a change of the
code that should not change results has changed them. Runs with a snap are listed but not judged.

The files may also be the `report.json` of two validation runs. Their rows are then compared by
position; a difference is relative to the computed or the reference value, whichever is larger.

Only the public interface is used. As a script (`python validation/frozen.py write FILE.json`) the
file also runs with an older installed version.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

import quasiform as qf

LIMIT = 1e-9
WORK = ("linear_solves", "factorisations")  # columns that count work: not results


def _formed(scene: str, angle: float) -> Any:
    return qf.refine(qf.forming(scene, orientation=angle, size=5))


def _pulled(angle: float, law: str) -> Any:
    displacement = 50 if angle == 45 else 15
    return qf.solve(qf.off_axis_tension(angle=angle, law=law, displacement=displacement, size=10))


RUNS: dict[str, Callable[[], Any]] = {
    f"{scene}-{angle}": partial(_formed, scene, angle)
    for scene in ("hemisphere", "tetrahedron", "box")
    for angle in (0, 45)
} | {
    f"oat-{angle}-{law}": partial(_pulled, angle, law)
    for angle in (45, 30)
    for law in ("locking", "best-fit")
}


def frozen(result: Any) -> dict[str, Any]:
    """History columns, key numbers and snaps of a result, ready for JSON."""
    history = {
        name: np.asarray(column, float).tolist()
        for name, column in result.history.items()
        if name not in WORK
    }
    numbers = {k: None if v is None else float(v) for k, v in result.quantities.items()}
    return {"history": history, "quantities": numbers, "snaps": len(result.snaps)}


def read(path: Path) -> dict[str, dict[str, Any]]:
    """Frozen runs of a file, or the rows of a `report.json` in the same form, without times."""
    content = json.loads(path.read_text())
    if "cases" not in content:
        return content
    return {
        case["name"]: {
            "history": {},
            "quantities": {
                f"row {i}": [row["computed"] or 0.0, row["reference"] or 0.0]
                for i, row in enumerate(case["rows"], 1)
                if row["unit"] != "s"
            },
            "snaps": 0,
        }
        for case in content["cases"]
    }


def difference(a: Any, b: Any) -> float:
    """Largest |a - b| relative to the largest |a|; infinite where the two cannot be compared."""
    a, b = np.atleast_1d(np.array(a, float)), np.atleast_1d(np.array(b, float))
    if a.shape != b.shape or np.any(np.isnan(a) != np.isnan(b)):
        return np.inf
    off, scale = np.nan_to_num(np.abs(a - b)).max(initial=0.0), np.nan_to_num(np.abs(a)).max()
    return float(off / scale) if off and scale else float(np.inf if off else 0.0)


def compare(a: dict[str, Any], b: dict[str, Any]) -> int:
    """Print the largest difference of each run; the exit status."""
    worst = 0.0
    for run in sorted(a.keys() | b.keys()):
        if run not in a or run not in b:
            print(f"{run:20} only in {'the first' if run in a else 'the second'} file")
            worst = np.inf
            continue
        found = {"": 0.0}
        for part in ("history", "quantities"):
            one, two = a[run][part], b[run][part]
            for name in one.keys() | two.keys():
                found[f"{part} {name}"] = difference(one.get(name), two.get(name))
        where, largest = max(found.items(), key=lambda item: item[1])
        snap = a[run]["snaps"] or b[run]["snaps"]
        print(f"{run:20} {largest:8.1e}  {where}{'  (has a snap: not judged)' if snap else ''}")
        worst = worst if snap else max(worst, largest)
    print(f"largest of the runs without a snap: {worst:.1e} (limit {LIMIT:g})")
    return int(isnan(worst) or worst > LIMIT)


def main(argv: list[str] | None = None) -> int:
    """Write one file or compare two; the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    write = commands.add_parser("write")
    write.add_argument("file", type=Path)
    write.add_argument("runs", nargs="*", metavar="RUN", help=", ".join(RUNS))
    against = commands.add_parser("compare")
    against.add_argument("a", type=Path)
    against.add_argument("b", type=Path)
    given = parser.parse_args(argv)
    if given.command == "compare":
        return compare(read(given.a), read(given.b))
    if unknown := set(given.runs) - RUNS.keys():
        parser.error(f"unknown run {', '.join(sorted(unknown))}; expected {', '.join(RUNS)}")
    done = {}
    for name in given.runs or RUNS:
        done[name] = frozen(RUNS[name]())
        print(f"{name:20} snaps {done[name]['snaps']}, {done[name]['quantities']}", flush=True)
        given.file.write_text(json.dumps(done, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
