"""Pictures of saved results, one or several side by side, all on one scale of colours.

The scale ends at the first round angle that neither a triangle nor the locking angle of a fabric
passes, so that pictures of one fabric share it, and the locking angle is marked on it and on the
sheet. Lines told apart by colour (Okabe and Ito's, safe for colour-blind readers, and of different
lightness) also differ in their strokes, for print without colours.
"""

from __future__ import annotations

import shutil
import textwrap
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..checks import InputError, suggestion
from ..comparison.sheet import at_nodes
from ..result.saved import Saved, tool_cuts
from .plot import (
    COLOURS,
    DPI,
    SCALES,
    STYLE,
    WIDTH,
    _draw_triad,
    _figure,
    _frame,
    _is_bowl,
    _outline,
    _paint,
    _plain,
    _rim,
    _shade,
    _view,
    draw_lines,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

FloatArray = np.ndarray
ABREAST = 3  # results in a row of pictures
TALLEST = 4.6  # inches: width of axes beyond which a sheet is not drawn larger
INKS = ("#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00")
STROKES = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
MARKS = "os^Dv"
WARP, WEFT = "#003f66", "#d55e00"
SHEET = "#f4efe6"
LOCKED = "#009e73"
FRAMES_PER_SECOND = 6
FILES = (
    *("shear_angle.png", "fibres.png", "outline.png", "force.png"),
    *("travel.gif", "travel.mp4", "table.csv"),
)


def save(
    runs: Sequence[Saved],
    folder: str | Path,
    only: Sequence[str] | None = None,
    end: float | None = None,
    animate: str | None = None,
) -> list[str]:
    """Write pictures of saved results into an existing folder.

    Parameters
    ----------
    runs : list of Saved
        Each is shown at its last state (`Saved.near` chooses another).
    folder : path
    only : list of str, optional
        Which of `PICTURES`; all of them if not given.
    end : float, optional
        End of the colour scale, degrees.
    animate : "gif" or "mp4", optional
        Also write the travel as an animation.

    Returns
    -------
    notes : list of str
        What could not be drawn, and why.

    Raises
    ------
    InputError
        For an unknown picture, a broken file, or an mp4 without ffmpeg.
    """
    from matplotlib import rc_context

    for name in only or ():
        if name not in PICTURES:
            raise InputError(f"unknown picture '{name}': {suggestion(name, PICTURES)}")
    check_animation(animate)
    runs, labels = list(runs), _labels(runs)
    end = end or _end(runs)
    notes: list[str] = []
    with rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name with letters the font lacks
        for name in only or PICTURES:
            figure = PICTURES[name](runs, labels, end, notes)
            figure.savefig(Path(folder) / f"{name}.png", dpi=DPI, bbox_inches="tight")
        if animate:
            _animate(runs, labels, end, Path(folder) / f"travel.{animate}")
    return notes


def check_animation(kind: str | None) -> None:
    """Refuse an animation that cannot be written here.

    Raises
    ------
    InputError
    """
    if kind not in (None, "gif", "mp4"):
        raise InputError(f"animate must be 'gif' or 'mp4', got {kind!r}")
    if kind == "mp4" and shutil.which("ffmpeg") is None:
        raise InputError("an mp4 needs ffmpeg, which was not found: use gif")


def table(runs: Sequence[Saved]) -> list[list[str]]:
    """Key numbers of several results: a row of headings, then one a result."""
    rows = [{"result": label} | run.row for label, run in zip(_labels(runs), runs, strict=True)]
    names = list(dict.fromkeys(name for row in rows for name in row))
    return [names, *([row.get(name, "-") for name in names] for row in rows)]


def _labels(runs: Sequence[Saved]) -> list[str]:
    """Names of the folders; of equal ones the paths."""
    names = [run.label for run in runs]
    return [
        name if names.count(name) == 1 else str(run.folder)
        for name, run in zip(names, runs, strict=True)
    ]


def _end(runs: Sequence[Saved]) -> float:
    """End of the colour scale: a round angle that no triangle and no locking angle passes."""
    largest = max(max(run.sound.max(initial=0.0), run.locking or 0.0) for run in runs)
    return next((end for end in SCALES if end >= largest), SCALES[-1])


def _colour_scale(end: float) -> ScalarMappable:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    # the darkest end is left out: shading and fibre lines would not show on it
    shades = colormaps[COLOURS](np.linspace(0.02, 0.88, 256))
    return ScalarMappable(Normalize(0, end), LinearSegmentedColormap.from_list(COLOURS, shades))


def _grid(count: int, *frames: FloatArray, below: float = 0.8) -> tuple[Figure, np.ndarray]:
    """A figure of the text width with axes for each of the frames, one above the other, by result.

    Parameters
    ----------
    count : int
        Results.
    *frames : (n, 2 or more) arrays
        Points that all results' axes of a kind have to hold, to the right and up.
    below : float
        Room for what goes below them all, inches.
    """
    columns = min(count, ABREAST)
    blocks = -(-count // columns)
    heights = [_height(frame, WIDTH / columns) for frame in frames]
    figure = _figure((sum(heights) + 0.62) * blocks + below)
    axes = figure.subplots(
        blocks * len(frames), columns, squeeze=False, height_ratios=heights * blocks
    )
    axes = axes.reshape(blocks, len(frames), columns).transpose(0, 2, 1).reshape(-1, len(frames))
    for spare in axes[count:].ravel():
        spare.axis("off")
    return figure, axes[:count]


def _height(frame: FloatArray, width: float) -> float:
    """Height of axes that hold points and a bar below them, inches; wide ones are not too high."""
    across, up = np.ptp(frame[:, :2], axis=0)
    return min(width, TALLEST) * (up + 0.18 * max(across, up)) / (1.06 * max(across, 0.8 * up))


def _seen_from(run: Saved) -> tuple[FloatArray, bool]:
    """View that fits a run, (3, 3), and whether it is turned over to show a bowl as a dome."""
    if run.scene.dim == 2:
        return np.eye(3), False
    turned_over = _is_bowl(run, run.positions())
    return _view(turned_over), turned_over


def _common(runs: Sequence[Saved]) -> FloatArray:
    """Points of all runs in their views, for panels of one scale."""
    return np.vstack([run.positions() @ _seen_from(run)[0].T for run in runs])


def _head(
    axes: Axes, label: str, run: Saved, *, force: bool = True, turned_over: bool = False
) -> None:
    gamma = np.abs(run.shear_angle)
    words = f"{run.scene.travel_name.removesuffix('_mm').replace('_', ' ')} "
    words += f"{run.states[-1].travel:.4g} mm, |γ| max {gamma.max():.1f}°"
    if force and np.isfinite(run.force):
        words += f"\nforce {round(run.force, 3) + 0.0:.4g} N"
    if turned_over:
        words += ", seen from below" if force else "\nseen from below"
    axes.set_title("\n".join(textwrap.wrap(label, 40)) + "\n" + words, parse_math=False)


def _mark_locking(bar: Axes, runs: Sequence[Saved], end: float) -> None:
    """Mark the locking angles on a horizontal colour scale."""
    for angle in sorted({round(run.locking, 3) for run in runs if run.locking}):
        if angle > end:
            continue
        bar.axvline(angle, color="black", linewidth=2.4)
        bar.axvline(angle, color="white", linewidth=1.0)
        bar.annotate(
            f"locking {angle:.0f}°",
            (angle / end, 1.0),
            (0, 3),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=7,
        )


def _shear_angles(
    runs: Sequence[Saved], labels: Sequence[str], end: float, notes: list[str]
) -> Figure:
    """Formed sheets in space and seen along z, with the line at the locking angle."""
    from matplotlib.collections import LineCollection

    plane = all(run.scene.dim == 2 for run in runs)
    colours = _colour_scale(end)
    frame = _common(runs)
    plan = np.vstack(
        [points for run in runs for points in (run.positions()[:, :2], run.blank.nodes)]
    )
    figure, grid = _grid(len(runs), *([plan] if plane else [frame, plan]))
    for axes, label, run in zip(grid, labels, runs, strict=True):
        x, blank = run.positions(), run.blank
        _head(axes[0], label, run, turned_over=_seen_from(run)[1])
        if not plane:
            _draw_in_space(axes[0], run, colours, frame)
        above = axes[-1]
        for line in _outline(blank.nodes[_rim(blank)]):
            above.plot(*line.T, color="0.3", linewidth=0.8, linestyle=(0, (4, 3)), zorder=0.5)
        _paint(above, run, x, colours, shaded=False)
        if run.locking:
            gamma = _at_nodes(run, np.abs(run.shear_angle))
            line = level_lines(x, blank.triangles, gamma, [run.locking])[:, :, :2]
            for width, ink in ((2.2, "white"), (1.1, LOCKED)):
                above.add_collection(LineCollection(line, colors=ink, linewidths=width))
        _frame(above, plan)
    _draw_scale(figure, grid, runs, end)
    return figure


def _draw_scale(figure: Figure, grid: np.ndarray, runs: Sequence[Saved], end: float) -> None:
    bar = figure.colorbar(
        _colour_scale(end),
        ax=grid.ravel().tolist(),
        label="shear angle |γ| in °",
        orientation="horizontal",
        fraction=0.05,
        shrink=0.6 if len(grid) > 1 else 0.9,
        aspect=40,
    )
    bar.outline.set_linewidth(0.5)
    _mark_locking(bar.ax, runs, end)


def _draw_in_space(axes: Axes, run: Saved, colours: ScalarMappable, frame: FloatArray) -> None:
    view, _ = _seen_from(run)
    _paint(axes, run, run.positions() @ view.T, colours, shaded=True)
    _frame(axes, frame)
    _draw_triad(axes, view, frame)


def _at_nodes(run: Saved, values: FloatArray) -> FloatArray:
    """(n_nodes,) means of (n_triangles,) values around each node, weighted by area."""
    return at_nodes(values, np.pad(run.blank.nodes, ((0, 0), (0, 1))), run.blank.triangles)


def level_lines(
    x: FloatArray, triangles: np.ndarray, values: FloatArray, levels: Sequence[float]
) -> FloatArray:
    """Lines on which a function, linear in each triangle, has one of some values.

    Parameters
    ----------
    x : (n, d) array
        Points.
    triangles : (m, 3) int array
    values : (n,) array
        Of the function at the points.
    levels : list of float

    Returns
    -------
    (k, 2, d) array
        Segments, one for each triangle and each level that crosses it.

    Examples
    --------
    >>> x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> level_lines(x, np.array([[0, 1, 2]]), x[:, 0], [0.25]).tolist()
    [[[0.25, 0.75], [0.25, 0.0]]]
    """
    segments = [np.empty((0, 2, x.shape[1]))]
    for level in levels:
        above = values[triangles] > level
        # turned so that the first corner lies alone on its side of the line
        alone = (above.sum(1) == 1)[:, None] == above
        crossed = above.any(1) & ~above.all(1)
        first = alone[crossed].argmax(1)
        corners = triangles[crossed][
            np.arange(len(first))[:, None], (first[:, None] + range(3)) % 3
        ]
        f = values[corners]
        share = ((level - f[:, :1]) / (f[:, 1:] - f[:, :1]))[:, :, None]
        segments.append((1 - share) * x[corners[:, :1]] + share * x[corners[:, 1:]])
    return np.concatenate(segments)


def _fibres(runs: Sequence[Saved], labels: Sequence[str], end: float, notes: list[str]) -> Figure:
    """Warp and weft on the formed sheet, at even distances on the flat one, whatever the mesh."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba
    from matplotlib.lines import Line2D

    frame = _common(runs)
    figure, grid = _grid(len(runs), frame, below=0.25)
    extent = max(np.ptp(run.blank.nodes, axis=0).max() for run in runs)
    pitch = _round(extent / 20)
    for axes, label, run in zip(grid[:, 0], labels, runs, strict=True):
        blank = run.blank
        view, turned_over = _seen_from(run)
        _head(axes, label, run, force=False, turned_over=turned_over)
        P = run.positions() @ view.T
        faces = np.tile(to_rgba(SHEET), (len(blank.triangles), 1))
        if run.scene.dim == 3:
            faces[:, :3] *= _shade(blank, P)[:, None]
        order = np.argsort(P[blank.triangles, 2].mean(1), kind="stable")
        faces = np.clip(faces, 0, 1)[order]
        axes.add_collection(
            PolyCollection(
                P[blank.triangles[order], :2],
                facecolors=faces,
                edgecolors=faces,
                linewidths=0.3,
                joinstyle="round",
            )
        )
        families = ((blank.weft, WARP, 0.9), (blank.warp, WEFT, 0.5))
        for across, ink, width in families:  # a line of warp is where the place along weft is one
            s = blank.nodes @ across
            levels = pitch * np.arange(np.ceil(s.min() / pitch), np.floor(s.max() / pitch) + 1)
            lines = level_lines(P, blank.triangles, s, levels)
            draw_lines(axes, P, blank.triangles, lines, ink, width)
        draw_lines(axes, P, blank.triangles, P[_rim(blank)], "0.1", 0.7)
        _frame(axes, frame)
        if run.scene.dim == 3:
            _draw_triad(axes, view, frame)
    handles = [
        Line2D([], [], color=WARP, linewidth=1.6, label=f"warp, every {pitch:g} mm when flat"),
        Line2D([], [], color=WEFT, linewidth=0.8, label=f"weft, every {pitch:g} mm when flat"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _round(length: float) -> float:
    """Next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= length * (1 - 1e-9))


def _stroke(number: int) -> dict[str, object]:
    return {"color": INKS[number % len(INKS)], "linestyle": STROKES[number % len(STROKES)]}


def _outlines(runs: Sequence[Saved], labels: Sequence[str], end: float, notes: list[str]) -> Figure:
    """Outlines of the formed sheets seen along z, over cuts through the tools of the first."""
    from matplotlib.lines import Line2D

    seen = [points for run in runs for points in (run.blank.nodes, run.positions()[:, :2])]
    figure = _figure(4.9)
    axes = figure.subplots()
    handles = []
    cuts, why_not = tool_cuts(runs[0])
    if why_not:
        notes.append(f"{labels[0]}: no tools under the outline: {why_not}")
    several = len({str(run.summary["parameters"].get("scene")) for run in runs}) > 1
    whose = f"{_plain(labels[0])}: " if several else ""
    for k, (words, (x, y, d)) in enumerate(cuts.items()):
        look = {"colors": "0.55", "linewidths": 0.8 + 0.8 * k, "linestyles": "-"}
        axes.contour(x, y, d, levels=[0.0], **look)
        handles.append(Line2D([], [], color="0.55", linewidth=0.8 + 0.8 * k, label=whose + words))
    flats = []
    for k, (label, run) in enumerate(zip(labels, runs, strict=True)):
        flat, x = run.blank.nodes, run.positions()[:, :2]
        for line in _outline(flat[_rim(run.blank)]):
            ring = shapely.linestrings(line)
            if not any(shapely.hausdorff_distance(ring, flat) < 1e-3 for flat in flats):
                axes.plot(*line.T, color="0.3", linewidth=0.6, linestyle=(0, (4, 3)))
                flats.append(ring)
        for loop in run.blank.outline:
            axes.plot(*x[loop].T, linewidth=1.3, **_stroke(k))
        handles.append(Line2D([], [], linewidth=1.3, label=_plain(label), **_stroke(k)))
    dashed = {"color": "0.3", "linewidth": 0.6, "linestyle": (0, (4, 3))}
    handles.append(Line2D([], [], label="flat blank", **dashed))
    _frame(axes, np.vstack(seen))
    figure.legend(handles=handles, loc="outside right upper")
    return figure


def _forces(runs: Sequence[Saved], labels: Sequence[str], end: float, notes: list[str]) -> Figure:
    """Force over travel of all results in one panel."""
    figure = _figure(3.3)
    axes = figure.subplots()
    coarser = False
    for k, (label, run) in enumerate(zip(labels, runs, strict=True)):
        if "force_N" not in run.history:
            notes.append(f"{label}: no force in its history")
            continue
        travel, force = run.history[run.scene.travel_name], run.history["force_N"]
        axes.plot(travel, force, linewidth=1.2, **_stroke(k))
        mark = {"marker": MARKS[k % len(MARKS)], "markersize": 3.5}
        sizes = run.history.get("size_mm", np.zeros(len(travel)))
        coarse = sizes > sizes[-1] * (1 + 1e-9)
        ink = _stroke(k)["color"]
        axes.plot(travel[coarse], force[coarse], color=ink, markerfacecolor="white", ls="", **mark)
        axes.plot(travel[~coarse], force[~coarse], color=ink, ls="", **mark)
        axes.plot([], [], linewidth=1.2, label=_plain(label), **mark, **_stroke(k))
        coarser |= coarse.any()
        collapse = run.summary.get("collapse")
        if collapse:  # beyond, the force means nothing
            axes.axvline(collapse["travel_mm"], linewidth=0.6, **_stroke(k))
            axes.plot([], [], linewidth=0.6, label=f"{_plain(label)}: collapsed", **_stroke(k))
    if coarser:
        hollow = {"marker": "o", "markersize": 3.5, "markerfacecolor": "white", "color": "0.4"}
        axes.plot([], [], ls="", label="hollow: on a\ncoarser mesh", **hollow)
    names = dict.fromkeys(run.scene.travel_name.removesuffix("_mm") for run in runs)
    axes.set_xlabel(f"{' or '.join(name.replace('_', ' ') for name in names)} in mm")
    axes.set_ylabel("force in N")
    axes.set_xlim(left=0.0)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right upper")
    return figure


def _animate(runs: Sequence[Saved], labels: Sequence[str], end: float, path: Path) -> None:
    """Write the travel as an animation: every state that was written, all on one scale."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    colours = _colour_scale(end)
    views = [_seen_from(run)[0] for run in runs]  # of the end, for all frames
    frame = np.vstack(
        [
            run.at(k).positions() @ view.T
            for run, view in zip(runs, views, strict=True)
            for k in (0, -1)
        ]
    )
    figure, grid = _grid(len(runs), frame)
    _draw_scale(figure, grid, runs, end)
    travels = sorted({s.travel for run in runs for s in run.states})
    figure.canvas.draw()  # the layout is found once: nothing jumps between the frames
    writer = (PillowWriter if path.suffix == ".gif" else FFMpegWriter)(fps=FRAMES_PER_SECOND)
    with writer.saving(figure, path, dpi=110):
        for travel in [*travels, *travels[-1:] * FRAMES_PER_SECOND]:  # the end stands for a second
            for axes, label, run, view in zip(grid[:, 0], labels, runs, views, strict=True):
                axes.clear()
                now = run.near(travel)
                _head(axes, label, now)
                _paint(axes, now, now.positions() @ view.T, colours, shaded=run.scene.dim == 3)
                _frame(axes, frame)
            writer.grab_frame()
            figure.set_layout_engine("none")


PICTURES: dict[str, Callable[[Sequence[Saved], Sequence[str], float, list[str]], Figure]] = {
    "shear_angle": _shear_angles,
    "fibres": _fibres,
    "outline": _outlines,
    "force": _forces,
}
