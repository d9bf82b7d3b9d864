"""Pictures of a study: outputs over keys, force bands, tornado, and those of its answers."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..checks import number
from ..result.summary import error_column
from . import plot
from .plot import CURVE, FIRST, SECOND, STOP, THEORY, new_figure

if TYPE_CHECKING:
    from ..result.sheet import FormedSheet

LEAST = 8  # runs from which on a picture of the table says something
DENSE = 100  # runs from which on the points of a scatter are faint
CROWDED = 200  # runs, from which on bars would hide the points
SHOWN = 4, 6  # outputs and keys of a scatter at most
STATES = {  # colours; those of limits follow
    "good": "#e6e2ee",
    "locked": "#8c6bb1",
    "wrinkled": "#d1605e",
    "not converged": "#fdae61",
    "not completed": "#9e9e9e",
}
LIMITS = ("#2c7fb8", "#41b6c4", "#225ea8")
BEYOND = 0.4  # of the range of an output: how much of an error bar is shown beyond it
SPAN = 0.1, 0.9  # quantiles of a key between which a tornado shows its effect
DPI = plot.DPI
BARS = {"elinewidth": 0.7, "capsize": 1.5}
ROW = 0.28  # inches: a bar of a tornado

Table = Mapping[str, Sequence[Any]]
FloatArray = np.ndarray


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Draw with the style of the pages."""

    def drawn(*args: Any, **options: Any) -> Figure:
        with plot.page_style():
            figure = draw(*args, **options)
            figure.canvas.draw()  # texts take their size from the style
            return figure

    return drawn


def figures(
    keys: Sequence[str],
    outputs: Sequence[str],
    table: Table,
    rows: Sequence[Mapping[str, Any]],
    spread: bool,
) -> dict[str, Figure]:
    """Pictures of a table that has enough runs, by file name.

    `spread` says whether the runs are spread over the ranges, not those of a search.
    """
    done = [k for k, status in enumerate(table["status"]) if status == "completed"]
    if len(done) < LEAST:
        return {}
    known = {name: [table[name][k] for k in done] for name in (*outputs, *keys)}
    known = {name: values for name, values in known.items() if all(map(_is_number, values))}
    outputs = [name for name in outputs if name in known]
    keys = [key for key in keys if len(set(known.get(key, ()))) > 1]
    found: dict[str, Figure] = {}
    if keys and outputs:
        found["scatter.png"] = scatter_figure(keys, outputs, table, done)
        if spread and len(done) > 2 * len(keys) + 1:
            found["tornado.png"] = effects_figure(keys, outputs, table, done)
    if histories := [rows[k]["history"] for k in done if "history" in rows[k]]:
        found["force.png"] = force_figure(histories)
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)


# A table


@styled
def scatter_figure(
    keys: Sequence[str], outputs: Sequence[str], table: Table, rows: Sequence[int]
) -> Figure:
    """Each output over each key with the errors of the mesh: bars, or of many runs the median."""
    outputs, keys = outputs[: SHOWN[0]], keys[: SHOWN[1]]
    figure = new_figure(0.5 + 1.5 * len(outputs))
    panels = figure.subplots(len(outputs), len(keys), sharex="col", sharey="row", squeeze=False)
    bad = np.array([not table["converged"][k] for k in rows])
    faint = min(1.0, max(0.15, (DENSE / len(rows)) ** 0.5))
    many = np.array([bool(table["one_of_many"][k]) for k in rows]) & ~bad
    kinds = {
        "converged": (~bad & ~many, FIRST, {}),
        "one of many states": (many, SECOND, {"markerfacecolor": "white"}),
        "not converged": (bad, "0.5", {"fmt": "x"}),
    }
    for axes_row, output in zip(panels, outputs, strict=True):
        values, error = (_column(table, name, rows) for name in (output, _error_of(table, output)))
        label = _words(output)
        if error is not None and len(rows) > CROWDED:
            label, error = f"{label}\n(± {np.nanmedian(error):.2g} mesh)", None
        axes_row[0].set_ylabel(label)
        for axes, key in zip(axes_row, keys, strict=True):
            x = _column(table, key, rows)
            for label, (chosen, colour, more) in kinds.items():
                if chosen.any():
                    bars = None if error is None else error[chosen]
                    look = {"fmt": "o", "markersize": 2.2, "elinewidth": 0.5, "linewidth": 0.7}
                    look |= {"color": colour, "label": label, "alpha": faint} | more
                    axes.errorbar(x[chosen], values[chosen], bars, **look)
        room = BEYOND * (np.ptp(values) or 1.0)  # a long bar is cut
        low, high = axes_row[0].get_ylim()
        axes_row[0].set_ylim(max(low, values.min() - room), min(high, values.max() + room))
    for axes, key in zip(panels[-1], keys, strict=True):
        axes.set_xlabel(_folded(plot.plain(key)))
    found = panels[0, 0].get_legend_handles_labels()
    if len(found[0]) > 1:
        figure.legend(*found, loc="outside upper right", ncols=3)
    errors = any(_error_of(table, output) for output in outputs)
    how = "bars: mesh error" if len(rows) <= CROWDED else "± median mesh error"
    words = f"{_of(rows, table)}{f'; {how}' * errors}"
    figure.suptitle(words, x=0.01, ha="left")
    return figure


def _of(rows: Sequence[int], table: Table) -> str:
    """How many runs are shown, of how many."""
    count = len(table["status"])
    return f"{len(rows)} runs" if len(rows) == count else f"{len(rows)} of {count} runs, completed"


def _error_of(table: Table, output: str) -> str:
    """Column of the mesh error that stands behind an output, if there is one."""
    name = error_column(output)
    return name if any(value is not None for value in table.get(name, ())) else ""


def _column(table: Table, name: str, rows: Sequence[int]) -> FloatArray | None:
    if not name:
        return None
    return np.array([np.nan if (v := table[name][k]) is None else v for k in rows], dtype=float)


def _words(name: str) -> str:
    """Name of an output with its unit, as a label."""
    unit = ""
    for end, short in (("_N", "N"), ("_mJ", "mJ"), ("_deg", "°"), ("_mm", "mm")):
        head, found, tail = name.partition(end)
        if found and tail[:1] in ("", "."):
            name, unit = head + tail, f" in {short}"
    return plot.plain(name.replace("draw_in", "draw-in").replace("_", " ").replace(".", " ") + unit)


def _folded(words: str) -> str:
    """Words on lines that fit beside a low panel."""
    words = words.replace(".", ". ").replace(" in ", "\u00a0in\u00a0")
    return "\n".join(textwrap.wrap(words, 18)).replace(". ", ".")


@styled
def force_figure(histories: Sequence[Sequence[Sequence[float]]]) -> Figure:
    """Median of the force over the travel, and the bands with half and nine tenths of the runs."""
    end = min(travel[-1] for travel, _ in histories)
    travel = np.linspace(0.0, end, 200)
    forces = np.array([np.interp(travel, *history) for history in histories])
    figure = new_figure(2.6)
    axes = figure.subplots()
    for share, shade in ((0.9, 0.15), (0.5, 0.3)):
        low, high = np.quantile(forces, [0.5 - share / 2, 0.5 + share / 2], axis=0)
        look = {"color": FIRST, "alpha": shade, "linewidth": 0}
        axes.fill_between(travel, low, high, label=f"{100 * share:g} % of the runs", **look)
    axes.plot(travel, np.median(forces, axis=0), color=FIRST, label="median")
    axes.plot(travel, forces.min(0), **THEORY, label="least and largest")
    axes.plot(travel, forces.max(0), **THEORY)
    axes.set(xlim=(0, end), ylim=(min(0.0, forces.min()), None))
    longest = max(travel[-1] for travel, _ in histories)
    axes.set_xlabel("travel in mm" + ", of the shortest run" * (longest > end * (1 + 1e-9)))
    axes.set_ylabel("force in N")
    axes.legend(loc="upper left")
    axes.set_title(f"{len(histories)} runs", loc="right")
    return figure


@styled
def effects_figure(
    keys: Sequence[str], outputs: Sequence[str], table: Table, rows: Sequence[int]
) -> Figure:
    """Effect of each key on each output by linear regression, between two of its quantiles."""
    x = np.column_stack([_column(table, key, rows) for key in keys])
    low, high = np.quantile(x, SPAN, axis=0)
    span = np.where(high > low, high - low, np.ptp(x, axis=0))
    design = np.column_stack([np.ones(len(x)), (x - x.mean(0)) / span])
    back = np.linalg.pinv(design)
    panels = []
    for output in outputs[: SHOWN[0]]:
        y = _column(table, output, rows)
        effect = back @ y
        left = y - design @ effect
        variance = left @ left / (len(y) - design.shape[1])
        error = np.sqrt(variance * (back**2).sum(1))
        total = ((y - y.mean()) ** 2).sum()
        fit = f"linear fit: {100 * (1 - left @ left / (total or 1)):.0f} % of the variance"
        bars = zip(effect[1:].tolist(), error[1:].tolist(), strict=True)
        panels.append((output, dict(zip(keys, bars, strict=True)), fit))
    names = {
        key: f"{plot.plain(key)}\n{number(a, 3)} to {number(b, 3)}"
        for key, a, b in zip(keys, low, low + span, strict=True)
    }
    return _tornado(panels, names, f"change of an output as one key changes, {_of(rows, table)}")


@styled
def tornado_figure(
    changes: Mapping[str, Mapping[str, float]], names: Mapping[str, str], title: str, both: bool
) -> Figure:
    """Change of each output (outer key) by each parameter (inner key); `names` label those.

    `both` says that the changes are to both sides.
    """
    panels = [
        (output, {key: (change, None) for key, change in by.items()}, "")
        for output, by in list(changes.items())[: SHOWN[0]]
    ]
    return _tornado(panels, names, title, both)


def _two_abreast(count: int, head: float, each: float, **shared: bool) -> tuple[Figure, np.ndarray]:
    """A figure with panels in rows of two at most, each so high, under a head, inches."""
    columns = min(count, 2)
    lines = -(-count // columns)
    figure = new_figure(head + lines * each)
    panels = figure.subplots(lines, columns, squeeze=False, **shared).ravel()
    for spare in panels[count:]:
        spare.axis("off")
    return figure, panels


def _tornado(
    panels: list[tuple[str, dict[str, tuple[float, float | None]], str]],
    names: Mapping[str, str],
    title: str,
    both: bool = False,
) -> Figure:
    """Bars of changes with their errors, the largest on top, a panel for each output."""
    most = max(len(bars) for _, bars, _ in panels)
    row = ROW * (1.25 if "\n" in "".join(names.values()) else 1.0)
    figure, grid = _two_abreast(len(panels), 0.35, 0.55 + row * most)
    for axes, (output, bars, fit) in zip(grid, panels, strict=False):
        order = sorted(bars, key=lambda key: abs(bars[key][0]))
        width = [bars[key][0] for key in order]
        errors = [bars[key][1] for key in order]
        colours = [FIRST if value > 0 else SECOND for value in width]
        look = {"error_kw": BARS, "height": 0.6, "color": colours}
        if both:
            look |= {"left": np.negative(width), "color": FIRST}
            width = [2.0 * value for value in width]
        axes.barh(range(len(order)), width, xerr=None if None in errors else errors, **look)
        axes.use_sticky_edges = not both
        axes.axvline(0.0, color="0.3", linewidth=0.6)
        axes.set_yticks(range(len(order)), [names[key] for key in order])
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel(f"change of {_words(output)}")
        axes.set_title(fit, loc="right", fontsize=7, color="0.4")
    figure.suptitle(title, x=0.01, ha="left")
    return figure


# Answers


@styled
def indices_figure(table: Table, groups: int, confidence: float) -> Figure:
    """Sobol' indices of each output with their intervals."""
    outputs = list(dict.fromkeys(table["output"]))[: SHOWN[0]]
    keys = list(dict.fromkeys(table["key"]))
    each = 0.5 + 0.33 * len(keys)
    figure, panels = _two_abreast(len(outputs), 0.5, each, sharey=True, sharex=True)
    rows = list(zip(*table.values(), strict=True))
    for axes, output in zip(panels, outputs, strict=False):
        for order, colour, shift in (("first", FIRST, 0.17), ("total", "#b5a4d0", -0.17)):
            found = [row for row in rows if row[0] == output and row[2] == order]
            value, low, high = np.array([row[3:] for row in found]).T
            off = np.maximum([value - low, high - value], 0.0)
            y = np.arange(len(keys))[::-1] + shift
            look = {"height": 0.32, "color": colour, "error_kw": BARS}
            axes.barh(y, value, xerr=off, label=f"{order} order", **look)
        axes.set_yticks(range(len(keys)), [plot.plain(key) for key in keys[::-1]])
        axes.tick_params(axis="y", length=0)
        axes.axvline(0.0, color="0.3", linewidth=0.6)
        axes.set_title(_words(output))
    for axes in panels[-min(len(outputs), 2) :]:
        axes.set_xlabel("share of the variance")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    words = f"Sobol' indices, {groups} groups of runs, {100 * confidence:g} % intervals"
    figure.suptitle(words, x=0.01, ha="left")
    return figure


@styled
def window_figure(
    keys: Sequence[str],
    places: Sequence[Sequence[float]],
    states: Sequence[str],
    order: Sequence[str],
    limited: Sequence[bool],
    shares: Table,
) -> Figure:
    """Process window over two keys: the worst state of each run, and around it that of the nearest.

    Where several runs are at one place it is the most frequent, and the share of good ones is
    written there. A cross marks a place with a run whose trust is limited.
    """
    from scipy.spatial import cKDTree

    order = [name for name in order if name in states or name in ("good", "wrinkled", "locked")]
    at, index = np.unique(np.array(places, dtype=float), axis=0, return_inverse=True)
    number_of = {name: k for k, name in enumerate(order)}
    counts = np.zeros((len(at), len(order)), dtype=int)
    np.add.at(counts, (index.ravel(), [number_of[name] for name in states]), 1)
    low, high = at.min(0), at.max(0)
    span = np.where(high > low, high - low, 1.0)
    edge = [
        0.5 * np.diff(np.unique(x)).min(initial=s) if len(np.unique(x)) > 1 else 0.5 * s
        for x, s in zip(at.T, span, strict=True)
    ]
    margin = np.minimum(edge, 0.1 * span)
    grid = [np.linspace(a - m, b + m, 300) for a, b, m in zip(low, high, margin, strict=True)]
    x, y = np.meshgrid(*grid)
    tree = cKDTree((at - low) / span)
    near = tree.query((np.stack([x, y], axis=-1) - low) / span)[1]
    others = iter(LIMITS * len(order))
    colours = np.array([STATES.get(name) or next(others) for name in order])
    most = counts.shape[1] - 1 - counts[:, ::-1].argmax(1)  # the worse one where two are equal
    faces = to_rgba_array(colours)[most[near]]
    figure = new_figure(3.6)
    axes = figure.subplots()
    extent = (x[0, 0], x[0, -1], y[0, 0], y[-1, 0])
    axes.imshow(faces, extent=extent, origin="lower", aspect="auto", alpha=0.75)
    doubtful = np.bincount(index.ravel(), limited) > 0
    for marker, chosen in (("o", ~doubtful), ("X", doubtful)):
        look = {"marker": marker, "c": colours[most[chosen]], "edgecolors": "black"}
        axes.scatter(*at[chosen].T, s=14, linewidths=0.5, **look)
    many = counts.sum(1)
    if many.max() > 1 and len(at) <= 100:
        for place, count, of in zip(at, counts[:, 0], many, strict=True):
            look = {"fontsize": 6, "ha": "center", "xytext": (0, 4), "textcoords": "offset points"}
            axes.annotate(f"{count}/{of}", place, **look)
    axes.set_xlabel(plot.plain(keys[0]))
    axes.set_ylabel(plot.plain(keys[1]))
    labels = {
        name: f"{name}: {n} of {of} ({number(100 * low, 2)} to {number(100 * high, 2)} %)"
        for name, n, of, low, high in zip(*shares.values(), strict=True)
    }
    look = {"alpha": 0.75, "ec": "0.3", "linewidth": 0.5}
    named = zip(order, colours, strict=True)
    handles = [Patch(facecolor=colour, label=labels[name], **look) for name, colour in named]
    look = {"marker": "X", "mfc": "white", "mec": "black", "markeredgewidth": 0.5}
    look |= {"linestyle": "", "markersize": 4, "label": labels["trust limited"]}
    handles.append(Line2D([], [], **look))
    figure.legend(handles=handles, loc="outside right upper")
    figure.suptitle(f"process window, {len(states)} runs", x=0.01, ha="left")
    return figure


@styled
def search_figure(
    aim: str,
    values: Sequence[float],
    kept: Sequence[bool],
    best: int,
    start: int,
    keys: Mapping[str, Sequence[float]],
) -> Figure:
    """Aim and values of the keys of each run of a search."""
    figure = new_figure(1.7 + 1.1 * len(keys))
    ratio = [1.6, *[1.0] * len(keys)]
    panels = figure.subplots(1 + len(keys), 1, sharex=True, height_ratios=ratio)
    run, inside = np.arange(1, len(values) + 1), np.array(kept)
    for axes, column in zip(panels, (values, *keys.values()), strict=True):
        y = np.array(column, dtype=float)
        axes.plot(run[inside], y[inside], "o", **CURVE | {"markersize": 3})
        axes.plot(run[~inside], y[~inside], "o", **CURVE | {"color": "0.6", "mfc": "white"})
        axes.plot(best + 1, y[best], "*", color=STOP, markersize=9, clip_on=False)
        axes.axvspan(0.5, start + 0.5, color="0.93", zorder=0, linewidth=0)
    dot = CURVE | {"marker": "o", "markersize": 3}
    handles = [Patch(color="0.93", label="spread first")]
    looks = {
        "within the limits": dot,
        "beyond a limit": dot | {"color": "0.6", "mfc": "white"},
        "best": {"marker": "*", "color": STOP, "markersize": 8},
    }
    for label, look in looks.items():
        handles.append(Line2D([], [], linestyle="", label=label, **look))
    figure.legend(handles=handles, loc="outside upper right", ncols=4)
    panels[0].set_ylabel(_folded(_words(aim)))
    for axes, key in zip(panels[1:], keys, strict=True):
        axes.set_ylabel(_folded(plot.plain(key)))
    panels[-1].set_xlabel("run")
    panels[-1].xaxis.get_major_locator().set_params(integer=True)
    figure.align_ylabels(panels)
    panels[-1].set_xlim(0.5, len(values) + 0.5)
    return figure


@styled
def trim_figure(
    first: FormedSheet, last: FormedSheet, lines: Sequence[FloatArray], table: Table, within: float
) -> Figure:
    """Flat blanks, formed edges beside the line seen along z, and how far apart they are."""
    figure = new_figure(3.4)
    panels = figure.subplots(1, 3, width_ratios=[1, 1, 0.8])
    looks = (first, "first", {"color": "0.5", "linestyle": "--"}), (last, "best", {"color": FIRST})
    for sheet, name, look in looks:
        for k, loop in enumerate(sheet.loops):
            label = name if k == 0 else None
            panels[0].plot(*sheet.flat[loop].T, **look, label=label)
            panels[1].plot(*sheet.points[loop, :2].T, **look)
    for k, line in enumerate(lines):
        closed = np.vstack([line, line[:1]])
        look = {"color": STOP, "linewidth": 0.8, "label": None if k else "line wanted"}
        panels[1].plot(closed[:, 0], closed[:, 1], **look)
    for axes, words in zip(panels, ("flat blank", "edge, seen from above"), strict=False):
        plot.frame(axes, np.vstack([first.flat, last.flat, first.points[:, :2]]))
        axes.set_title(words)
    handles = [h for axes in panels[:2] for h in axes.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower left", ncols=3)
    axes = panels[2]
    rounds = table["round"]
    axes.semilogy(rounds, table["largest_mm"], "o-", **CURVE | {"markersize": 4}, label="largest")
    axes.semilogy(rounds, table["mean_mm"], "s-", **CURVE | {"color": SECOND}, label="mean")
    axes.axhline(within, **THEORY, label="allowed")
    axes.set_xticks(rounds)
    axes.set_xlabel("round")
    axes.set_ylabel("distance of edge and line in mm")
    axes.legend()
    return figure
