"""What a second, a minute and an hour of computing give: one picture of three runs.

Each run is the command of a user in a process of its own; its time is the processor time of that
whole process, with the start of Python, the error estimate and the files.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from ..tables import markdown_table

RUNS = {"second": ["--draft"], "minute": [], "hour": ["--size", "1.5"]}
HEAD = ["run", "command", "processor s", "wall s", "size mm", "force N", "p99 °"]
PICTURE, TABLE = "bought.png", "bought.md"


def table(out: Path, scene: str = "hemisphere") -> str:
    """Run what is not in `out` yet, draw the picture there, and return a Markdown table."""
    for name, options in RUNS.items():
        if not (out / name / "time.json").exists():
            _run(out / name, ["form", scene, *options])
            print(f"{name}: {_time(out / name)['processor']:.1f} s", flush=True)
    draw(out)
    rows = [_row(out / name, name, options, scene) for name, options in RUNS.items()]
    return markdown_table(HEAD, rows) + "\n"


def _run(folder: Path, command: list[str]) -> None:
    """Run the program; its times go into `time.json` of its folder."""
    before, wall = os.times(), time.perf_counter()
    program = [sys.executable, "-m", "quasiform", *command, "--out", str(folder), "--force"]
    subprocess.run(program, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    after, wall = os.times(), time.perf_counter() - wall
    spent = after.children_user - before.children_user
    spent += after.children_system - before.children_system
    (folder / "time.json").write_text(json.dumps({"processor": spent, "wall": wall}))


def _time(folder: Path) -> dict[str, float]:
    return json.loads((folder / "time.json").read_text(encoding="utf-8"))


def _row(folder: Path, name: str, options: list[str], scene: str) -> list[str]:
    from quasiform.result.record import Record

    run, spent = Record.read(folder), _time(folder)
    numbers, errors = _numbers(run)
    cells = [f"{n:.2f} ± {e:.2g}" for n, e in zip(numbers, errors, strict=True)]
    size = f"{run.parameters['size']:.3g}"
    command = f"`{' '.join(['quasiform form', scene, *options])}`"
    return [name, command, f"{spent['processor']:.1f}", f"{spent['wall']:.1f}", size, *cells]


def _numbers(run) -> tuple[list[float], list[float]]:
    """Force (N) and 99th percentile of the shear angle (degrees), and their errors."""
    errors = [run.summary["error_estimate"][name] for name in ("force_N", "shear_angle_deg")]
    return [run.force, run.summary["shear_angle_deg"]["p99"]], errors


def _words(folder: Path, name: str) -> str:
    """What a run is, and the time it took."""
    what = {"second": "draft", "minute": "default"}.get(name, " ".join(RUNS[name]).strip("-"))
    seconds = _time(folder)["processor"]
    return f"{what}: {seconds:.0f} s" if seconds < 100 else f"{what}: {seconds / 60:.0f} min"


def draw(out: Path) -> Path:
    """Draw the sheets seen from above, and their forces over the travel."""
    from matplotlib import rc_context

    from quasiform.checks import number
    from quasiform.draw import plot
    from quasiform.result.record import Record

    runs = {name: Record.read(out / name) for name in RUNS}
    with rc_context(plot.STYLE):
        figure = plot.new_figure(5.6)
        grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 0.95))
        above = [figure.add_subplot(grid[0, k]) for k in range(3)]
        end = plot.scale_end([run.sheet for run in runs.values()])
        colours = plot.colour_scale(list(runs.values()), end)
        room = np.vstack([run.sheet.flat for run in runs.values()])
        for axes, (name, run) in zip(above, runs.items(), strict=True):
            (force, p99), (off, off_p99) = _numbers(run)
            axes.set_title(
                f"{_words(out / name, name)}\nforce {force:.1f} ± {number(off, 2)} N"
                f"\np99 of |γ| {p99:.1f} ± {number(off_p99, 2)}°"
            )
            plot.draw_flat_outline(axes, run.sheet)
            plot.paint(axes, run.sheet, run.sheet.points, plot.shear_faces(run.sheet, colours))
            plot.frame(axes, room)
        plot.draw_colour_bar(figure, colours, ax=above, shrink=0.55)
        axes = figure.add_subplot(grid[1, :])
        looks = zip(
            ("#009e73", "#d55e00", "#0072b2"), ("s", "o", ""), ("--", "-", "-"), strict=True
        )
        for (name, run), (colour, marker, line) in zip(runs.items(), looks, strict=True):
            look = {"color": colour, "marker": marker, "linestyle": line, "markersize": 3.5}
            plot.draw_force(axes, run, look, _words(out / name, name))
        axes.set_xlabel("punch travel in mm")
        axes.set_ylabel("punch force in N, with its error")
        axes.set_xlim(left=0.0)
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper left")
        figure.savefig(out / PICTURE, dpi=plot.DPI)
    return out / PICTURE
