"""Error against work, and the effect of each simplification of the model.

    python -m validation.speed                            every scene: rows.csv, rows.md, charts
    python -m validation.speed --scenes oat-45 box        some scenes
    python -m validation.speed --quick                    a check, about three minutes
    python -m validation.speed --reductions               reductions.md
    python -m validation.speed --scale                    scale.md: the hemisphere on fine meshes
    python -m validation.speed --iterations               iterations.md: what factorisations are for
    python -m validation.speed --bought                   a second, a minute, an hour: a picture

Rows of rows.csv with the same sources of the package are not computed again. The error is relative
to a solution two levels finer than the finest mesh of the chart. Work is processor time, and linear
solves x unknowns^1.25 over all meshes of a run, in units of one solve
of the scene's default mesh.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import product
from pathlib import Path

import numpy as np

from ..tables import markdown_table
from . import bought, chart, cost, iterations, reductions, scale
from .rows import GAIN, REFERENCE, Row, expected_seconds, judged, pareto, read, write
from .runs import PROBLEMS, STRATEGIES, Plan, plans, run, sources


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--scenes", nargs="+", choices=PROBLEMS, metavar="SCENE")
    parser.add_argument("--quick", action="store_true", help="few rows, and a coarser reference")
    parser.add_argument("--out", type=Path, default=Path("speed"), metavar="DIR")
    parser.add_argument(
        "--budget", type=float, metavar="SECONDS", help="skip the runs that are unlikely to fit"
    )
    parser.add_argument("--draw", action="store_true", help="draw rows.csv again without computing")
    parser.add_argument("--reductions", action="store_true", help="effect of each simplification")
    parser.add_argument("--scale", action="store_true", help="time and memory of large meshes")
    parser.add_argument("--iterations", action="store_true", help="what factorisations are for")
    parser.add_argument("--cost", action="store_true", help="time of one Newton iteration")
    parser.add_argument("--bought", action="store_true", help="a second, a minute and an hour")
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    if given.reductions:
        _save(reductions.table(), given.out / "reductions.md")
    elif given.scale:
        _save(scale.table(), given.out / "scale.md")
    elif given.iterations:
        path = given.out / "iterations.md"
        _save(iterations.table(path, given.scenes or ()), path)
    elif given.cost:
        _save(cost.table(), given.out / "cost.md")
    elif given.bought:
        _save(bought.table(given.out), given.out / bought.TABLE)
    else:
        path = given.out / "rows.csv"
        rows = read(path) if given.draw else _compute(given, path)
        if not chart.panels(rows, "seconds", "error"):
            print(f"nothing to draw: no scene in {path} has a reference and another row")
            return 1
        _save(_report(rows), given.out / "rows.md")
        for picture in chart.draw(rows, given.out):
            print(picture)
    return 0


def _compute(given: argparse.Namespace, path: Path) -> list[Row]:
    """Run what is not in rows.csv yet, coarse meshes first; all rows."""
    version = sources()
    rows = [row for row in read(path) if row.version == version]
    known = {row.key for row in rows}
    stored = path.with_name("fields.npz")
    fields = dict(np.load(stored)) if stored.exists() else {}
    spent = 0.0
    for plan in plans(given.scenes or list(PROBLEMS), given.quick):
        key = (plan.scene, plan.strategy, plan.size, plan.increment, version)
        if key in known:
            continue
        where = f"{plan.scene}, {_name(plan)}"
        expected = expected_seconds(plan.scene, plan.strategy, plan.size, plan.increment, rows)
        if given.budget and spent + (expected or 0.0) > given.budget:
            print(f"skipped: {where}: expected {expected or 0:.0f} s do not fit", flush=True)
            continue
        clock = time.perf_counter()
        row, angles = run(plan)
        rows.append(row)
        fields[row.name] = angles
        spent += time.perf_counter() - clock
        finest = {r.scene: r.size for r in sorted(rows, key=lambda r: -r.size) if _is_reference(r)}
        rows = [r for r in rows if not _is_reference(r) or r.size == finest[r.scene]]
        rows = judged(rows, fields)
        write(rows, path)
        np.savez_compressed(stored, **fields)
        print(
            f"{where}: {row.seconds:.1f} s, {row.solves:.0f} solves, p99 {row.p99:.3f}, "
            f"force {row.force:.3f} N, certified: {row.certified}",
            flush=True,
        )
    return judged(rows, fields)


def _is_reference(row: Row) -> bool:
    return row.strategy == REFERENCE


def _report(rows: list[Row]) -> str:
    """Rows by scene in Markdown, position of the default, ratios.

    Marks: * on the Pareto front of the error of p99, + on that of the mean error.
    """
    parts = []
    for name, problem in PROBLEMS.items():
        own = [row for row in rows if row.scene == name]
        if not own:
            continue
        marks = {
            measure: {
                row.key: "".join(mark for mark, keys in fronts.items() if row.key in keys)
                for row in own
            }
            for measure in chart.WORK
            for fronts in [_fronts(own, measure)]
        }
        table = [
            [
                STRATEGIES[r.strategy][0] + (" (default)" if chart.is_default(r) else ""),
                f"{r.size:g}",
                f"{r.increment:g}" if r.increment else "auto",
                r.dofs,
                f"{r.seconds:.2f}{marks['seconds'][r.key]}",
                f"{r.wall:.2f}",
                f"{r.solves:.0f}",
                f"{r.units:.1f}{marks['units'][r.key]}" if r.units else "",
                f"{r.force:.3f}",
                f"{r.p99:.3f}",
                _shown(r.error, ".3f"),
                _shown(r.estimate, ".3f"),
                _shown(r.error_field, ".3f"),
                _shown(r.error_force, ".2f"),
                r.certified,
            ]
            for r in sorted(own, key=lambda r: (list(STRATEGIES).index(r.strategy), -r.size))
        ]
        head = ["strategy", "size", "increment", "dofs", "s", "wall s", "solves", "units"]
        head += [
            "force N",
            "p99 °",
            "error °",
            "estimate °",
            "mean error °",
            "force error %",
            "certified",
        ]
        notes = "\n".join([*_default(own), *_estimates(own), *_ratios(own)])
        parts.append(f"## {problem.title}\n\n{markdown_table(head, table)}\n\n{notes}")
    return "\n\n".join(parts)


def _fronts(rows: list[Row], measure: str) -> dict[str, set[tuple]]:
    """Keys of the rows on the Pareto fronts of the two errors."""
    found = {}
    for mark, error in zip("*+", chart.ERRORS, strict=True):
        points = [r for r in chart.comparable(rows, measure, error) if r.certified == "yes"]
        at = pareto([(getattr(r, measure), getattr(r, error)) for r in points])
        found[mark] = {points[i].key for i in at}
    return found


def _default(rows: list[Row]) -> list[str]:
    """Work of the default divided by the least work with the same error."""
    lines = []
    for measure, error in product(chart.WORK, chart.ERRORS):
        points = chart.comparable(rows, measure, error)
        for default in filter(chart.is_default, points):
            least = getattr(default, error) / (1 - GAIN)
            as_good = [r for r in points if getattr(r, error) <= least and r.certified == "yes"]
            best = min(as_good or [default], key=lambda row: getattr(row, measure))
            ratio = getattr(default, measure) / getattr(best, measure)
            lines.append(
                f"- default, {chart.ERRORS[error][1]} against {chart.WORK[measure][1]}: "
                + ("on the front" if best is default else f"{ratio:.2f} times {_name(best)}")
            )
    return lines


def _estimates(rows: list[Row]) -> list[str]:
    """Errors divided by the program's estimates."""
    known = [r for r in rows if r.strategy in ("full path", "continuation") and not r.increment]
    known = [r for r in known if r.error is not None and r.estimate]
    if not known:
        return []
    ratios = ", ".join(f"{_name(r)} {r.error / r.estimate:.2g}" for r in known)
    return [f"- error divided by the program's estimate: {ratios}"]


def _name(row: Row | Plan) -> str:
    increment = f", increment {row.increment:g}" if row.increment else ""
    return f"{STRATEGIES[row.strategy][0]} {row.size:g} mm{increment}"


def _ratios(rows: list[Row]) -> list[str]:
    """Processor time of each strategy divided by that of the full path, by size."""
    automatic = {(r.strategy, r.size): r for r in rows if not r.increment}
    lines = []
    for (strategy, size), row in automatic.items():
        plain = automatic.get(("full path", size))
        if plain is None or strategy in ("full path", REFERENCE):
            continue
        lines.append(
            f"- {STRATEGIES[strategy][0]} / full path at {size:g} mm: "
            f"{row.seconds / plain.seconds:.2f} in time"
            + (f", {row.units / plain.units:.2f} in solves" if row.units and plain.units else "")
            + f"; p99 {row.p99 - plain.p99:+.3f}°, "
            f"force {100 * (row.force / plain.force - 1):+.2f} %"
        )
    return lines


def _shown(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _save(text: str, path: Path) -> None:
    path.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    sys.exit(main())
