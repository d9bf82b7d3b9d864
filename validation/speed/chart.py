"""The chart: error against work, one panel per scene, with the Pareto front and the default."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quasiform.draw.plot import DPI, FIRST, SECOND, STYLE, WIDTH

from .rows import REFERENCE, Row, pareto
from .runs import PROBLEMS, STRATEGIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

LOOKS = {  # marker and colour of a strategy
    "full path": ("o", FIRST),
    "continuation": ("D", SECOND),
    "whole": ("s", "#3c8d5a"),
    "convex": ("^", "#d59b00"),
    "free mesh": ("v", "#2a8fbd"),
    "relaxation": ("P", "0.35"),
}
WORK = {
    "seconds": ("processor time in s", "seconds"),
    "units": ("work in linear solves of the default mesh", "solves"),
}
ERRORS = {
    "error": ("error of p99 of |γ| in °", "p99"),
    "error_field": ("mean error of γ over the sheet in °", "mean"),
}
FRONT = "0.8"
LEAST = 1e-3  # degrees: smaller errors are drawn here


def draw(rows: list[Row], folder: Path) -> list[Path]:
    """Write a chart for each measure of work and of error; their paths."""
    from matplotlib import rc_context

    paths = []
    with rc_context(STYLE):
        for (measure, (_, work)), (error, (_, kind)) in product(WORK.items(), ERRORS.items()):
            paths.append(folder / f"chart_{kind}_{work}.png")
            _figure(rows, measure, error).savefig(paths[-1], dpi=DPI)
    return paths


def is_default(row: Row) -> bool:
    """Whether this is the default of the command line."""
    return (row.strategy, row.size) == PROBLEMS[row.scene].default and not row.increment


def comparable(rows: list[Row], measure: str, error: str) -> list[Row]:
    """Rows with both work and error."""
    return [r for r in rows if getattr(r, measure) > 0 and getattr(r, error) is not None]


def panels(rows: list[Row], measure: str, error: str) -> dict[str, list[Row]]:
    """Rows of each charted scene."""
    found = {
        name: comparable([row for row in rows if row.scene == name], measure, error)
        for name, problem in PROBLEMS.items()
        if problem.charted
    }
    return {name: points for name, points in found.items() if points}


def _figure(rows: list[Row], measure: str, error: str) -> Figure:
    from matplotlib.figure import Figure

    drawn = panels(rows, measure, error)
    n = len(drawn) + 1  # the legend is a panel too
    columns = min(n, 3)
    lines = -(-n // columns)
    figure = Figure(figsize=(1.55 * WIDTH * columns / 3, 0.62 + 2.75 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for panel, (name, points) in zip(axes, drawn.items(), strict=False):
        reference = next(r for r in rows if r.scene == name and r.strategy == REFERENCE)
        _panel(panel, points, reference, measure, error)
    for panel in axes[len(drawn) :]:
        panel.axis("off")
    _key(axes[len(drawn)], {row.strategy for points in drawn.values() for row in points})
    figure.canvas.draw()
    for panel, points in zip(axes, drawn.values(), strict=False):
        _write_sizes(panel, points, [_place(row, measure, error) for row in points])
    return figure


def _panel(axes: Axes, rows: list[Row], reference: Row, measure: str, error: str) -> None:
    """Points, Pareto front, and the ring around the default."""
    places = [_place(row, measure, error) for row in rows]
    sound = [p for p, row in zip(places, rows, strict=True) if row.certified == "yes"]
    front = np.array([sound[i] for i in pareto(sound)]).reshape(-1, 2)
    axes.plot(*front.T, "o-", color=FRONT, linewidth=4, markersize=9, zorder=1)
    for row, place in zip(rows, places, strict=True):
        marker, colour = LOOKS[row.strategy]
        size = 5 if not row.increment else 3
        face = colour if row.certified == "yes" else "white"
        axes.plot(
            *place, marker, color=colour, markersize=size, markerfacecolor=face, zorder=3, mew=0.8
        )
        if is_default(row):
            axes.plot(*place, "o", markersize=13, markerfacecolor="none", color="black", zorder=4)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for set_limits, values in (
        (axes.set_xlim, [p[0] for p in places]),
        (axes.set_ylim, [p[1] for p in places]),
    ):
        low, high = min(values), max(values)
        room = max((high / low) ** 0.14, 1.35)
        set_limits(low / room, high * room)
    _plain_ticks(axes)
    axes.set_xlabel(WORK[measure][0])
    axes.set_ylabel(ERRORS[error][0])
    known = f" (p99 {reference.p99:.2f}°)" if error == "error" else ""
    title = PROBLEMS[reference.scene].title
    axes.set_title(f"{title}\nreference at {reference.size:g} mm{known}")


def _place(row: Row, measure: str, error: str) -> tuple[float, float]:
    return getattr(row, measure), max(getattr(row, error), LEAST)


def _plain_ticks(axes: Axes) -> None:
    """Plain numbers; also between the decades if there are less than two."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        decades = np.log10(high / low)
        steps = (1.0,) if decades > 2.5 else (1.0, 3.0) if decades > 1.3 else (1.0, 2.0, 5.0)
        axis.set_major_locator(LogLocator(subs=steps))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
        axis.set_minor_formatter(NullFormatter())


def _write_sizes(axes: Axes, rows: list[Row], places: list[tuple[float, float]]) -> None:
    """Write the size next to each point, where it overlaps nothing."""
    from matplotlib.transforms import Bbox

    figure = axes.figure
    dot = figure.dpi / 72
    at = axes.transData.transform(places)
    taken = [Bbox.from_bounds(*(p - 3.5 * dot), 7 * dot, 7 * dot) for p in at]
    inside = axes.get_window_extent()
    order = sorted(range(len(rows)), key=lambda i: (not is_default(rows[i]), rows[i].increment > 0))
    for i in order:
        far = 9.0 if is_default(rows[i]) else 6.0
        text = axes.annotate(
            _label(rows[i]),
            at[i],
            xycoords="figure pixels",
            fontsize=6,
            color=LOOKS[rows[i].strategy][1],
            ha="center",
            va="center",
            annotation_clip=False,
        )
        extent = text.get_window_extent()
        half = np.array([extent.width, extent.height]) / 2
        for step, (right, up) in product(
            (1.0, 1.6), ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
        ):
            reach = step * far * dot * (0.75 if right and up else 1.0)
            centre = at[i] + np.array([right, up]) * (reach + half - 2 * dot * (step == 1.0))
            box = Bbox([centre - half, centre + half])
            if not any(_overlap(box, other) for other in taken) and _within(box, inside):
                place = axes.transData.inverted().transform(centre)
                text.remove()
                axes.text(
                    *place,
                    _label(rows[i]),
                    fontsize=6,
                    color=LOOKS[rows[i].strategy][1],
                    ha="center",
                    va="center",
                    zorder=5,
                )
                taken.append(box)
                break
        else:
            text.remove()


def _label(row: Row) -> str:
    return f"{row.size:g}" + (f"/{row.increment:g}" if row.increment else "")


def _overlap(a: Bbox, b: Bbox) -> bool:
    return bool(a.x0 < b.x1 and b.x0 < a.x1 and a.y0 < b.y1 and b.y0 < a.y1)


def _within(a: Bbox, b: Bbox) -> bool:
    return bool(a.x0 >= b.x0 and a.x1 <= b.x1 and a.y0 >= b.y0 and a.y1 <= b.y1)


def _key(axes: Axes, shown: set[str]) -> None:
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], marker=marker, color=colour, linestyle="", markersize=5, label=label)
        for name, (marker, colour) in LOOKS.items()
        if name in shown
        for label in [STRATEGIES[name][0]]
    ]
    marks += [
        Line2D(
            [],
            [],
            marker="o",
            color="0.4",
            linestyle="",
            markersize=3,
            label="small: increment given",
        ),
        Line2D(
            [],
            [],
            marker="o",
            color="0.4",
            linestyle="",
            markersize=5,
            mfc="white",
            label="hollow: not certified",
        ),
        Line2D(
            [],
            [],
            marker="o",
            color="black",
            linestyle="",
            markersize=11,
            mfc="none",
            label="default of the command line",
        ),
        Line2D(
            [],
            [],
            marker="o",
            markersize=9,
            color=FRONT,
            linewidth=4,
            label="Pareto front of certified runs",
        ),
    ]
    axes.legend(
        handles=marks,
        loc="upper left",
        labelspacing=0.7,
        title="size/increment in mm",
        alignment="left",
        title_fontsize=7,
    )
    axes.text(
        0.02,
        0.0,
        "Mirror planes are used except in the whole sheet and\nthe free mesh. Full paths: "
        "without the cost of an error\nestimate; mesh continuation includes one.",
        transform=axes.transAxes,
        fontsize=6,
        color="0.3",
        va="bottom",
    )
