"""Stability map: scenes x settings, the travel that each reaches and why it stops.

    python -m validation.stability                          the map, with the stored cells
    python -m validation.stability --fresh                  all cells again
    python -m validation.stability --only box-45 arch       some scenes
    python -m validation.stability --settings default fine  some settings

Cells stored in cells.json are used again if scene, settings and the relevant sources are the same.
Exit status 1 if a requirement is not met. README.md describes the map.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

for _library in ("OMP", "OPENBLAS", "MKL"):  # read when numpy is loaded: one core per cell
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from . import cells, draw, judge  # noqa: E402
from .scenes import CASES  # noqa: E402
from .settings import SETTINGS, Cell, seeds  # noqa: E402
from .settings import cells as cells_of  # noqa: E402

FOLDER = Path(__file__).parent


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.stability",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", nargs="+", choices=CASES, metavar="SCENE", default=list(CASES))
    parser.add_argument(
        "--settings", nargs="+", choices=SETTINGS, metavar="SETTING", default=list(SETTINGS)
    )
    parser.add_argument("--out", type=Path, default=FOLDER, metavar="DIR")
    parser.add_argument("--workers", type=int, default=2, metavar="N")
    parser.add_argument("--fresh", action="store_true", help="solve every cell again")
    parser.add_argument(
        "--reuse-older", action="store_true", help="show cells of older sources, marked as such"
    )
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "cells.json"
    kept = cells.read(FOLDER / "cells.json", path)
    usable = {} if given.fresh else _usable(kept, given.reuse_older)
    plan = cells_of(given.only, given.settings)
    seeded = seeds(given.only) if "perturbed" in given.settings else []
    needed = list(dict.fromkeys([*plan.values(), *seeded]))
    used: dict[Cell, cells.Solved] = {}
    while True:
        used |= {cell: usable[cell] for cell in needed if cell in usable}
        missing = [cell for cell in needed if cell not in used]
        _solve(missing, given.workers, kept, used, path)
        needed = judge.wanted(used)  # checks of certified cells; twice at most
        if not needed:
            break
    cells.write(path, kept)
    shown = {place: used[cell] for place, cell in plan.items()}
    against = judge.contradictions(shown.values(), used)
    minutes = sum(solved.seconds for solved in used.values()) / 120.0  # on two cores
    found = judge.bars(shown, used, against, minutes)
    report = draw.report(shown, used, against, found, minutes)
    (given.out / "map.md").write_text(report, encoding="utf-8")
    draw.picture(shown, against, given.out / "map.png")
    for bar in found:
        print(f"{'met    ' if bar.met else 'NOT MET'}  {bar.name}: {bar.found}")
    print(given.out / "map.md")
    return 0 if all(bar.met for bar in found) else 1


def _usable(kept: dict[Cell, cells.Solved], older: bool) -> dict[Cell, cells.Solved]:
    """Cells with unchanged input; with `older` those of other sources too."""
    return {cell: s for cell, s in kept.items() if older or s.key == cells.key(cell)}


def _solve(
    missing: list[Cell],
    workers: int,
    kept: dict[Cell, cells.Solved],
    used: dict[Cell, cells.Solved],
    path: Path,
) -> None:
    """Solve cells, the longest first, and store each when it is done."""
    missing = sorted(missing, key=lambda cell: -_expected(cell, kept))
    clock = time.monotonic()
    for i, solved in enumerate(cells.solve_all(missing, workers), 1):
        kept[solved.cell] = used[solved.cell] = solved
        cells.write(path, kept)
        print(
            f"{time.monotonic() - clock:6.0f} s  {i}/{len(missing)}  {solved.scene}, "
            f"{draw.describe(solved.setting)}: {solved.outcome}"
            f"{f' ({solved.reason})' if solved.reason else ''}, certified: {solved.certified}",
            flush=True,
        )


def _expected(cell: Cell, kept: dict[Cell, cells.Solved]) -> float:
    """Processor time of the last solve of a cell, or a guess, s."""
    if cell in kept:
        return kept[cell].seconds
    setting = cell.setting
    slow = 50.0 if setting.method == "relaxation" else 1.0
    return slow * {"coarse": 1.0, "default": 3.0, "fine": 15.0}[setting.size]


if __name__ == "__main__":
    sys.exit(main())
