"""Pictures of several runs side by side, all on one scale of colours, and a table of them.

The scale ends at the first round angle that neither a triangle nor the locking angle of a fabric
passes, so that pictures of one fabric share it, and the locking angle is marked on it and on the
sheet. Lines of different colour (Okabe and Ito's, safe for colour-blind readers, and of different
lightness) also differ in their strokes, for print without colours.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..checks import InputError, force_column, number, suggestion
from ..result.measures import percentile
from ..result.record import Record
from . import plot
from .overlay import level_lines, tool_cuts

FloatArray = np.ndarray
Runs, Labels = Sequence[Record], Sequence[str]
ABREAST = 3  # runs in a row of pictures
TALLEST = 4.6  # inches: width of axes beyond which a sheet is not drawn larger
INKS = ("#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00")
STROKES = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
MARKS = "os^Dv"
WARP, WEFT = "#003f66", "#d55e00"
SHEET = "#f4efe6"
FRAMES_PER_SECOND = 6
FILES = (
    *("shear_angle.png", "fibres.png", "outline.png", "force.png"),
    *("travel.gif", "travel.mp4", "table.csv"),
)


def save(
    runs: Runs,
    folder: str | Path,
    only: Sequence[str] | None = None,
    end: float | None = None,
    animate: str | None = None,
) -> list[str]:
    """Write pictures of runs, each at its last sheet, into an existing folder.

    `only` names some of `PICTURES`, `end` is that of the colour scale (degrees), and `animate` is
    "gif" or "mp4". Returns what could not be drawn, and why.
    """
    for name in only or ():
        if name not in PICTURES:
            raise InputError(f"unknown picture '{name}': {suggestion(name, PICTURES)}")
    check_animation(animate)
    runs, labels = list(runs), _labels(runs)
    end = end or scale_end(runs)
    notes: list[str] = []
    with plot.page_style():
        for name in only or PICTURES:
            figure = PICTURES[name](runs, labels, end, notes)
            figure.savefig(Path(folder) / f"{name}.png", dpi=plot.DPI, bbox_inches="tight")
        if animate:
            _animate(runs, labels, end, Path(folder) / f"travel.{animate}")
    return notes


def check_animation(kind: str | None) -> None:
    """Refuse an animation that cannot be written here."""
    if kind not in (None, "gif", "mp4"):
        raise InputError(f"animate must be 'gif' or 'mp4', got {kind!r}")
    if kind == "mp4" and shutil.which("ffmpeg") is None:
        raise InputError("an mp4 needs ffmpeg, which was not found: use gif")


def table(runs: Runs) -> list[list[str]]:
    """Key numbers of several runs: a row of headings, then one a run."""
    rows = [{"result": label} | _row(run) for label, run in zip(_labels(runs), runs, strict=True)]
    names = list(dict.fromkeys(name for row in rows for name in row))
    return [names, *([row.get(name, "-") for name in names] for row in rows)]


def _row(run: Record) -> dict[str, str]:
    """Key numbers of a run by name; those of the end at the end only."""
    gamma, area, summary = np.abs(run.sheet.shear_angle), run.sheet.flat_areas, run.summary
    numbers = {
        "size_mm": (run.parameters.get("size"), "g"),
        "travel_mm": (run.travel, ".4g"),
        force_column(run.travel_name): (run.force, ".4g"),
        "shear_angle_max_deg": (gamma.max(), ".2f"),
        "shear_angle_p99_deg": (percentile(gamma, area, 0.99), ".2f"),
        "shear_angle_mean_deg": (area @ gamma / area.sum(), ".2f"),
    }
    if run.at_end:
        draw_in = list((summary.get("draw_in_mm") or {}).values())
        numbers["shear_angle_error_deg"] = summary["error_estimate"].get("shear_angle_deg"), ".2g"
        numbers["draw_in_mm"] = np.mean(draw_in) if draw_in else None, ".2f"
        converged = summary["certificate"]["converged"]
        numbers["converged"] = "yes" if converged else "no", "s"
        numbers["trust"] = "limited" if run.limits else "no limit found", "s"
    numbers["linear_solves"] = summary.get("linear_solves"), "g"
    numbers["wall_s"] = summary.get("wall_s"), ".1f"
    row = {"case": run.case, "fabric": run.fabric_name}
    for name, (value, form) in numbers.items():
        known = isinstance(value, str) or (isinstance(value, int | float) and np.isfinite(value))
        row[name] = format(value, form) if known else "-"
    return row


def _labels(runs: Runs) -> list[str]:
    """Names of the folders; of equal ones the paths."""
    names = [run.name for run in runs]
    return [run.name if names.count(run.name) == 1 else str(run.folder) for run in runs]


def scale_end(runs: Runs) -> float:
    """End of the colour scale: a round angle that no triangle and no locking angle passes."""
    locking = max(run.locking or 0.0 for run in runs)
    return plot.scale_end([run.sheet for run in runs], least=locking)


def _grid(count: int, *frames: FloatArray, below: float = 0.8) -> tuple[Figure, np.ndarray]:
    """A figure of the text width, and by run axes that hold the points (n, 2+) of each frame.

    `below` is the room under them all, inches.
    """
    columns = min(count, ABREAST)
    blocks = -(-count // columns)
    heights = [_height(frame, plot.WIDTH / columns) for frame in frames]
    figure = plot.new_figure((sum(heights) + 0.62) * blocks + below)
    shape = {"nrows": blocks * len(frames), "ncols": columns, "squeeze": False}
    axes = figure.subplots(**shape, height_ratios=heights * blocks)
    axes = axes.reshape(blocks, len(frames), columns).transpose(0, 2, 1).reshape(-1, len(frames))
    for spare in axes[count:].ravel():
        spare.axis("off")
    return figure, axes[:count]


def _height(frame: FloatArray, width: float) -> float:
    """Height of axes that hold points and a bar below them, inches; wide ones are not too high."""
    across, up = np.ptp(frame[:, :2], axis=0)
    return min(width, TALLEST) * (up + 0.18 * max(across, up)) / (1.06 * max(across, 0.8 * up))


def _common(runs: Runs) -> FloatArray:
    """Points of all runs in their views, for panels of one scale."""
    return np.vstack([run.sheet.points @ plot.view_of(run)[0].T for run in runs])


def _head(
    axes: Axes, label: str, run: Record, *, force: bool = True, turned_over: bool = False
) -> None:
    words = f"{plot.travel_of(run)}, |γ| max {np.abs(run.sheet.shear_angle).max():.1f}°"
    if force and np.isfinite(run.force):
        words += f"\nforce {number(run.force, zero=5e-4)} {run.force_unit}"
    if turned_over:
        words += ", seen from below" if force else "\nseen from below"
    axes.set_title("\n".join(textwrap.wrap(label, 40)) + "\n" + words, parse_math=False)


def _shear_angles(runs: Runs, labels: Labels, end: float, notes: list[str]) -> Figure:
    """Formed sheets in space and seen along z, with the line at the locking angle."""
    plane = all(run.in_plane for run in runs)
    colours, room = plot.colour_scale(runs, end), _common(runs)
    plan = np.vstack([p for run in runs for p in (run.sheet.points[:, :2], run.sheet.flat)])
    figure, grid = _grid(len(runs), *([plan] if plane else [room, plan]))
    for axes, label, run in zip(grid, labels, runs, strict=True):
        sheet, above = run.sheet, axes[-1]
        if not plane:
            plot.draw_in_space(axes[0], run, colours, room)
        _head(axes[0], label, run, turned_over=plot.view_of(run)[1])
        plot.draw_flat_outline(above, sheet)
        plot.paint(above, sheet, sheet.points, plot.shear_faces(sheet, colours))
        plot.draw_locking(above, run)
        plot.frame(above, plan)
    _draw_scale(figure, grid, runs, colours)
    return figure


def _draw_scale(figure: Figure, grid: np.ndarray, runs: Runs, colours: ScalarMappable) -> None:
    """Horizontal scale of colours below all axes, with the locking angles marked."""
    place = {"orientation": "horizontal", "fraction": 0.05, "aspect": 40}
    place |= {"ax": grid.ravel().tolist(), "shrink": 0.6 if len(grid) > 1 else 0.9}
    bar = plot.draw_colour_bar(figure, colours, **place)
    plot.mark_locking(bar, runs, colours.norm.vmax)


def _fibres(runs: Runs, labels: Labels, end: float, notes: list[str]) -> Figure:
    """Warp and weft on the formed sheet, at even distances on the flat one, whatever the mesh."""
    room = _common(runs)
    figure, grid = _grid(len(runs), room, below=0.25)
    least = max(plot.extent(run.sheet) for run in runs) / 20
    power = 10.0 ** np.floor(np.log10(least))
    pitch = next(step * power for step in (1, 2, 5, 10) if step * power >= least * (1 - 1e-9))
    for axes, label, run in zip(grid[:, 0], labels, runs, strict=True):
        sheet = run.sheet
        view, turned_over = plot.view_of(run)
        _head(axes, label, run, force=False, turned_over=turned_over)
        P = sheet.points @ view.T
        faces = np.tile(to_rgba(SHEET), (len(sheet.triangles), 1))
        plot.paint(axes, sheet, P, faces, shaded=not run.in_plane, fibres=False)
        warp, weft = sheet.along
        for across, ink, width in ((weft, WARP, 0.9), (warp, WEFT, 0.5)):
            s = sheet.flat @ across  # a line of warp is where the place along weft is one
            levels = pitch * np.arange(np.ceil(s.min() / pitch), np.floor(s.max() / pitch) + 1)
            lines = level_lines(P, sheet.triangles, s, levels)
            plot.draw_lines(axes, P, sheet.triangles, lines, ink, width)
        plot.draw_lines(axes, P, sheet.triangles, P[plot.rim(sheet)], "0.1", 0.7)
        plot.frame(axes, room, None if run.in_plane else view)
    handles = [
        Line2D([], [], color=ink, linewidth=width, label=f"{name}, every {pitch:g} mm when flat")
        for name, ink, width in (("warp", WARP, 1.6), ("weft", WEFT, 0.8))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _stroke(number: int) -> dict[str, Any]:
    return {"color": INKS[number % len(INKS)], "linestyle": STROKES[number % len(STROKES)]}


def _outlines(runs: Runs, labels: Labels, end: float, notes: list[str]) -> Figure:
    """Outlines of the formed sheets seen along z, over cuts through the tools of the first."""
    figure = plot.new_figure(4.9)
    axes = figure.subplots()
    handles = []
    cuts, why_not = tool_cuts(runs[0])
    if why_not:
        notes.append(f"{labels[0]}: no tools under the outline: {why_not}")
    several = len({str(run.parameters.get("scene")) for run in runs}) > 1
    whose = f"{plot.plain(labels[0])}: " if several else ""
    for k, (words, (x, y, d)) in enumerate(cuts.items()):
        look = {"colors": "0.55", "linewidths": 0.8 + 0.8 * k, "linestyles": "-"}
        axes.contour(x, y, d, levels=[0.0], **look)
        handles.append(Line2D([], [], color="0.55", linewidth=0.8 + 0.8 * k, label=whose + words))
    flats: list[shapely.MultiLineString] = []
    for k, (label, run) in enumerate(zip(labels, runs, strict=True)):
        sheet = run.sheet
        flat = shapely.MultiLineString([sheet.flat[loop] for loop in sheet.loops])
        if not any(shapely.hausdorff_distance(flat, other) < 1e-3 for other in flats):
            plot.draw_flat_outline(axes, sheet, linewidth=0.6)
            flats.append(flat)
        for loop in sheet.outline:
            axes.plot(*loop[:, :2].T, linewidth=1.3, **_stroke(k))
        handles.append(Line2D([], [], linewidth=1.3, label=plot.plain(label), **_stroke(k)))
    handles.append(Line2D([], [], label="flat blank", **plot.DASHED | {"linewidth": 0.6}))
    seen = [p for run in runs for p in (run.sheet.flat, run.sheet.points[:, :2])]
    plot.frame(axes, np.vstack(seen))
    figure.legend(handles=handles, loc="outside right upper")
    return figure


def _forces(runs: Runs, labels: Labels, end: float, notes: list[str]) -> Figure:
    """Force over travel of all runs in one panel."""
    figure, shown = plot.new_figure(3.3), []
    axes = figure.subplots()
    for k, (label, run) in enumerate(zip(labels, runs, strict=True)):
        if run.forces is None:
            notes.append(f"{label}: no force in its history")
            continue
        look = {"marker": MARKS[k % len(MARKS)], "markersize": 3.5, "clip_on": True}
        label = plot.plain(label)
        plot.draw_force(axes, run, look | _stroke(k), label, f"{label}: collapsed")
        shown.append(run)
    if any(line.get_markerfacecolor() == "white" for line in axes.lines):
        hollow = {"marker": "o", "markersize": 3.5, "markerfacecolor": "white", "color": "0.4"}
        axes.plot([], [], ls="", label="hollow: on a\ncoarser mesh", **hollow)
    names = dict.fromkeys(run.travel_name.removesuffix("_mm") for run in runs)
    units = {run.force_unit: f"{plot.words_of(run)[1]} in {run.force_unit}" for run in shown}
    lengths = " in mm" if "N" in units or not units else ""
    axes.set_xlabel(" or ".join(name.replace("_", " ") for name in names) + lengths)
    if "N" in units:
        units["N"] = "force in N"
    axes.set_ylabel(" or ".join(units.values()) or "force in N")
    axes.set_xlim(left=0.0)
    sound = [run.forces[: plot.sound_rows(run)] for run in shown]
    low, high = (f(np.concatenate([*sound, [0.0]])) for f in (np.min, np.max))
    if high > low and any(run.summary.get("collapse") for run in shown):
        axes.set_ylim(1.05 * low - 0.05 * high, 1.5 * high - 0.5 * low)  # of what means something
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right upper")
    return figure


def _animate(runs: Runs, labels: Labels, end: float, path: Path) -> None:
    """Write the travel as an animation: every sheet that was written, all on one scale."""
    colours = plot.colour_scale(runs, end)
    views = [plot.view_of(run)[0] for run in runs]  # of the end, for all frames
    seen = zip(runs, views, strict=True)
    room = np.vstack([run.sheets[k].points @ view.T for run, view in seen for k in (0, -1)])
    figure, grid = _grid(len(runs), room)
    _draw_scale(figure, grid, runs, colours)
    travels = sorted({travel for run in runs for travel in run.sheets.travels})
    figure.canvas.draw()  # the layout is found once: nothing jumps between the frames
    writer = (PillowWriter if path.suffix == ".gif" else FFMpegWriter)(fps=FRAMES_PER_SECOND)
    with writer.saving(figure, path, dpi=110):
        for travel in [*travels, *travels[-1:] * FRAMES_PER_SECOND]:  # the end stands for a second
            for axes, label, run, view in zip(grid[:, 0], labels, runs, views, strict=True):
                axes.clear()
                now = run.near(travel)
                _head(axes, label, now)
                faces = plot.shear_faces(now.sheet, colours)
                P = now.sheet.points @ view.T
                plot.paint(axes, now.sheet, P, faces, shaded=not run.in_plane)
                plot.frame(axes, room)
            writer.grab_frame()
            figure.set_layout_engine("none")


PICTURES: dict[str, Callable[[Runs, Labels, float, list[str]], Figure]] = {
    "shear_angle": _shear_angles,
    "fibres": _fibres,
    "outline": _outlines,
    "force": _forces,
}
