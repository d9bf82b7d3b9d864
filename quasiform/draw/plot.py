"""Pictures of one run: the shear angle on the formed sheet, the history, and where to trust it.

The formed sheet is projected here (parallel projection) and its triangles are drawn from far to
near; lines on it are drawn over them where no triangle is nearer.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib import colormaps, rc_context, rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, is_color_like, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke

from ..checks import number
from ..net.blank import Blank
from ..net.edges import edge_points
from ..net.slits import joined
from ..result.measures import SLIP_GRADIENT, percentile
from ..result.plies import apart
from ..result.record import Record
from ..result.sheet import FormedSheet
from ..tools.mending import normals_of
from .overlay import level_lines, tool_cuts

FloatArray = np.ndarray

WIDTH = 16 / 2.54  # inches: the text width of a page
DPI = 200
STYLE = rc_params_from_file(Path(__file__).with_name("page.mplstyle"), use_default_template=False)
COLOURS = "magma_r"  # perceptually uniform; light where unsheared, so that the shading shows
RING_LEGEND = {"handlelength": 1.0, "columnspacing": 1.0, "title_fontsize": 7, "borderaxespad": 0}
COLLAPSED = "#00c2d1"
FIRST, SECOND, STOP = "#4b2991", "#d1605e", "#b00020"
CURVE = {"markersize": 2, "color": FIRST, "clip_on": False}
THEORY = {"linestyle": "--", "color": "0.4", "linewidth": 0.9}
DASHED = {"color": "0.3", "linewidth": 0.8, "linestyle": (0, (4, 3))}
ARROW = {"arrowstyle": "-|>,head_width=0.12,head_length=0.25", "linewidth": 0.8, "color": "black"}
ARROW |= {"shrinkA": 0, "shrinkB": 0}
MIDDLE = {"ha": "center", "va": "center", "fontsize": 7}
SCALES = (10, 20, 30, 45, 60, 75, 90)  # ends of the colour scale, degrees
AZIMUTH, ELEVATION = np.radians(-62.0), np.radians(36.0)
TRUSTED = "#f2f2f2"
LOCKED = "#009e73"
TOOL = "0.45"
DOUBTS = {  # colour, meaning and advice; later ones lie over earlier ones
    "bands_may_form": (
        "#9ecae1",
        "shear bands finer than the mesh may form",
        "use means over areas, or a smaller --size",
    ),
    "fibres_may_buckle": (
        "#74c476",
        "fibres in compression may buckle, finer than the mesh",
        "use a smaller --size",
    ),
    "rovings_may_slip": (
        "#807dba",
        "angle changes faster than {slip:g}°/mm: rovings may slip",
        "the real angles there are smaller or larger: do not use them",
    ),
    "beyond_identified_range": (
        "#fdae61",
        "beyond {range}°: not tested",
        "do not use these angles; test the fabric to larger ones",
    ),
    "narrow_bands": (
        "#e7298a",
        "bands of shear as narrow as the mesh",
        "do not use their angles and places; compare perturbed starts (--seeds)",
    ),
    "collapsed": (
        "#b2182b",
        "collapsed: beyond 85°, or turned over",
        "do not use the result here; use a law with locking",
    ),
}
LIMITS_SHOWN = 4
RINGS = ("black", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")  # Okabe and Ito
GAPS = {"E22_warp_layer": "E22 of the warp layer", "E11_weft_layer": "E11 of the weft layer"}
LIGHT = np.array([-0.45, 0.55, 0.70])  # direction to the light: right, up, towards the viewer


def save_pictures(run: Record, folder: str | Path) -> None:
    """Write the pictures into an existing folder; `gaps.png` where rovings slip."""
    gaps = all(name in run.sheet.cell_fields for name in GAPS)
    draw = FIGURES | ({"gaps": gap_figure} if gaps else {})
    with page_style():
        for name, picture in draw.items():
            picture(run).savefig(Path(folder) / f"{name}.png", dpi=DPI)
        for ply in run.plies[1:]:
            name = f"shear_angle_ply_{ply.ply}.png"
            sheet_figure(ply).savefig(Path(folder) / name, dpi=DPI)


@contextmanager
def page_style() -> Iterator[None]:
    """Draw with the style of the pages; a name may have letters that the font lacks."""
    with rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        yield


def sheet_figure(run: Record) -> Figure:
    """Sheet in space and seen along z, or a specimen in its plane; and the force.

    The plies of a stack have one scale of colours.
    """
    colours = colour_scale(run.plies)
    if run.in_plane:
        figure = new_figure(4.4)
        panels = figure.subplot_mosaic([["above"], ["force"]], height_ratios=[2.4, 1])
        _draw_from_above(panels["above"], run, colours)
        place = {"ax": panels["above"], "shrink": 0.85, "aspect": 25, "panchor": False}
    else:
        figure = new_figure(4.2)
        panels = figure.subplot_mosaic(
            [["space", "above"], ["force", "key"]], width_ratios=[1.35, 1], height_ratios=[2.4, 1]
        )
        for view in ("space", "above"):
            panels[view].set_anchor("N")
        if draw_in_space(panels["space"], run, colours):
            panels["space"].set_title("seen from below (the punch moved up, along −z)", pad=12)
        rings = _draw_from_above(panels["above"], run, colours)
        key = panels["key"]
        key.axis("off")
        if run.locking and np.abs(run.sheet.shear_angle).max() > run.locking:
            look = {"color": LOCKED, "linewidth": 1.1}
            rings.append(Line2D([], [], label=f"locking, {run.locking:.0f}°", **look))
        if rings:
            title = "tools" + ", and mean |γ| in the ringed areas" * bool(run.summary.get("areas"))
            key.legend(handles=rings, loc="upper center", ncols=3, title=title, **RING_LEGEND)
        place = {"cax": key.inset_axes([0.02, 0.11, 0.96, 0.12]), "orientation": "horizontal"}
    _draw_force_panel(panels["force"], run)
    mark_locking(draw_colour_bar(figure, colours, **place), [run], colours.norm.vmax)
    figure.suptitle(_title(run), parse_math=False)
    return figure


def doubt_figure(run: Record) -> Figure:
    """Where not to trust the shear angle, and why, seen along z."""
    figure = new_figure(4.2)
    axes, key = figure.subplots(1, 2, width_ratios=[1.35, 1])
    sheet, areas = run.sheet, run.sheet.flat_areas
    faces = np.tile(to_rgba(TRUSTED), (len(sheet.triangles), 1))
    doubts, handles, advice = sheet.doubts(), [], []
    for reason, (colour, label, remedy) in limits_of(run).items():
        faces[doubts[reason]] = to_rgba(colour)
        share = 100 * areas @ doubts[reason] / areas.sum()
        handles.append(Patch(facecolor=colour, label=f"{label}: {share:.1f} %"))
        if doubts[reason].any():
            advice.append(f"{label.split(':')[0]}: {remedy}")
    paint(axes, sheet, sheet.points, faces)
    frame(axes, sheet.points)
    key.axis("off")
    trusted = Patch(facecolor=TRUSTED, edgecolor="0.6", label="no limit was found")
    title = "limits of the shear angle, share of the area"
    look = {"frameon": False, "alignment": "left", "borderaxespad": 0}
    key.legend(handles=[*handles[::-1], trusted], loc="upper left", title=title, **look)
    limits, more = run.limits[:LIMITS_SHOWN], len(run.limits) - LIMITS_SHOWN
    limits += [f"and {more} more in summary.json"] * (more > 0)
    found = {"what to do": advice[::-1], "limits of the whole result": limits}
    lines = []
    for heading, entries in found.items():
        look = {"width": 58, "initial_indent": "– ", "subsequent_indent": "   "}
        lines += [f"{heading}:", *(textwrap.fill(e, **look) for e in entries or ["none"]), ""]
    words = "\n".join(lines)
    look = {"va": "top", "fontsize": 7, "linespacing": 1.5, "in_layout": False}
    key.text(0.0, 0.62, words, parse_math=False, **look)
    figure.suptitle(_title(run), parse_math=False)
    return figure


def gap_figure(run: Record) -> Figure:
    """Strain across the rovings of either layer, seen along z: gaps where it is positive."""
    sheet = run.sheet
    fields = {name: np.ravel(sheet.cell_fields[name]) for name in GAPS}
    end = max(max(float(np.quantile(v, 0.99)) for v in fields.values()), 0.01)
    colours = ScalarMappable(Normalize(-end, end), colormaps["RdBu_r"])
    figure = new_figure(3.4)
    panels = figure.subplots(1, 2)
    for axes, (name, values) in zip(panels, fields.items(), strict=True):
        paint(axes, sheet, sheet.points, colours.to_rgba(values))
        frame(axes, sheet.points)
        axes.set_title(GAPS[name])
    place = {"ax": panels.tolist(), "orientation": "horizontal", "aspect": 40, "extend": "both"}
    bar = figure.colorbar(colours, label="strain across the rovings: > 0 gaps", **place)
    bar.outline.set_linewidth(0.5)
    figure.suptitle(_title(run), parse_math=False)
    return figure


def limits_of(run: Record) -> dict[str, tuple[str, str, str]]:
    """Colour, meaning and advice of each of the limits of the shear angle."""
    shown = run.plies if run.ply == 0 else [run]
    ranges = sorted({ply.fabric.get("shear_range", np.nan) for ply in shown})
    numbers = {"range": "° or ".join(f"{angle:g}" for angle in ranges), "slip": SLIP_GRADIENT}
    return {
        reason: (colour, words.format(**numbers), advice)
        for reason, (colour, words, advice) in DOUBTS.items()
    }


def history_figure(run: Record) -> Figure:
    """Force, shear angle and, with mid-edges, draw-in over the travel."""
    panels = 3 if run.summary.get("draw_in_mm") else 2
    shear, draw_in = [], []
    for sheet in run.sheets:  # each is loaded once
        shear.append((np.abs(sheet.shear_angle), sheet.flat_areas))
        if panels == 3:
            draw_in.append([edge.draw_in(sheet.points) for edge in _edges(run, sheet)])
    figure = new_figure(2.7)
    axes = figure.subplots(1, panels)
    _draw_force_panel(axes[0], run)
    _draw_shear_angles(axes[1], run, shear)
    if panels == 3:
        _draw_draw_in(axes[2], run, draw_in)
    figure.suptitle(_title(run), parse_math=False)
    return figure


FIGURES = {"shear_angle": sheet_figure, "history": history_figure, "doubt": doubt_figure}


def new_figure(height: float) -> Figure:
    """Figure of the text width, its height in inches."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.05)
    return figure


def plain(name: str) -> str:
    """Return a name from a file as a label of a legend: nothing in it is a formula."""
    return name.replace("$", r"\$").lstrip("_")  # matplotlib hides what begins with _


def _title(run: Record) -> str:
    """Case, fabric and size; the key numbers; and the verdict with the worst news."""
    summary = run.summary
    size, path = run.parameters.get("size"), summary.get("path_size_mm")
    size = size if isinstance(size, Real) else run.sheet.blank.size
    travel, force, unit = words_of(run)
    case = [run.case, *filter(None, [run.ply_name]), run.fabric_name, f"size {size:.3g} mm"]
    case[-1] += f" (path at {path:.3g} mm)" if path else ""
    case.append(f"{travel} {summary['reached_mm']:.4g}{' mm' if unit == 'N' else ''}")
    gamma, errors = summary["shear_angle_deg"], summary["error_estimate"]
    off = {name: "" if e is None else f" ± {number(e, 2)}" for name, e in errors.items()}
    numbers = f"|γ| max {gamma['max']:.1f}°, p99 {gamma['p99']:.1f}{off['shear_angle_deg']}°"
    if unit == "N":
        numbers += f" · {force} {number(summary['force_N'], zero=5e-4)}{off['force_N']} N"
    return "\n".join([" · ".join(case), numbers, textwrap.fill(verdict(run), 105)])


def verdict(run: Record) -> str:
    """Whether a run converged, and what limits the trust in it, the worst first."""
    head = "converged" if run.summary["certificate"]["converged"] else "not converged"
    limits, head = run.limits, head if run.at_end else "an increment"
    if not limits:
        return f"{head}; no limit to its trust was found"
    more = f"; and {len(limits) - 2} more (summary.json)" if len(limits) > 2 else ""
    return f"{head}; trust limited: {'; '.join(limits[:2])}{more}"


def words_of(run: Record) -> tuple[str, str, str]:
    """Names of the travel and of its force, and the unit of the force."""
    if run.force_unit == "mJ":
        return "load factor", "work of the load by its factor", "mJ"
    if np.array_equal(run.history.get("pressure_force_N", ()), run.forces):
        return "travel", "force of the pressure", "N"
    if run.has_tools:
        return "punch travel", "punch force", "N"
    return "displacement", "force", "N"


def travel_of(run: Record) -> str:
    """Travel of the last sheet of a run, with its name."""
    name = run.travel_name.removesuffix("_mm").replace("_", " ")
    return f"{name} {run.travel:.4g}{' mm' * (run.force_unit == 'N')}"


def collapsed(sheet: FormedSheet) -> np.ndarray:
    """(n_triangles,) bool array: sheared past 85 degrees, or turned over in the plane."""
    found = sheet.doubts()["collapsed"].copy()
    if np.ptp(sheet.points[:, 2]) == 0:
        found |= np.linalg.det(sheet.F[:, :2]) <= 0
    return found


def colour_scale(runs: Sequence[Record], end: float | None = None) -> ScalarMappable:
    """Colours of |γ| from 0 to an end, degrees, or to that of `scale_end`."""
    if end is None:
        end = scale_end([run.sheet for run in runs])
    return ScalarMappable(Normalize(0, end), LinearSegmentedColormap.from_list(COLOURS, shades()))


def shades(count: int = 256) -> FloatArray:
    """(count, 4) colours without the darkest: shading and fibre lines would not show on it."""
    return colormaps[COLOURS](np.linspace(0.02, 0.88, count))


def scale_end(sheets: Sequence[FormedSheet], least: float = 0.0) -> float:
    """First round angle that no triangle passes, but for collapsed ones."""
    largest = [np.abs(s.shear_angle)[~collapsed(s)].max(initial=least) for s in sheets]
    return next((end for end in SCALES if end >= max(largest)), SCALES[-1])


def draw_colour_bar(figure: Figure, colours: ScalarMappable, **place: Any) -> Axes:
    """Draw the scale of colours; return its axes."""
    bar = figure.colorbar(colours, label="shear angle |γ| in °", **place)
    bar.outline.set_linewidth(0.5)
    return bar.ax


def draw_locking(axes: Axes, run: Record) -> None:
    """Draw the line at the locking angle on a sheet seen from above."""
    if run.locking:
        gamma = run.sheet.at_nodes(np.abs(run.sheet.shear_angle))
        line = level_lines(run.sheet.points, run.sheet.triangles, gamma, [run.locking])[:, :, :2]
        for width, ink in ((2.2, "white"), (1.1, LOCKED)):
            axes.add_collection(LineCollection(line, colors=ink, linewidths=width))


def mark_locking(bar: Axes, runs: Sequence[Record], end: float) -> None:
    """Mark the locking angles on a horizontal or vertical scale of colours that has this end."""
    upright = bar.get_position().height > bar.get_position().width
    for angle in {round(run.locking, 3) for run in runs if run.locking and run.locking <= end}:
        for ink, width in (("black", 2.4), ("white", 1.0)):
            (bar.axhline if upright else bar.axvline)(angle, color=ink, linewidth=width)
        at, away = ((0.0, angle / end), (-3, 0)) if upright else ((angle / end, 1.0), (0, 3))
        side = {"ha": "right"} if upright else {"va": "bottom"}
        place = {"xycoords": "axes fraction", "textcoords": "offset points"}
        bar.annotate(f"locking {angle:.0f}°", at, away, **MIDDLE | place | side)


def view_of(run: Record) -> tuple[FloatArray, bool]:
    """Rows to the right, up and towards the viewer, (3, 3); and whether a bowl is turned over."""
    if run.in_plane:
        return np.eye(3), False
    turned_over = is_bowl(run)
    return view_from(turned_over), turned_over


def is_bowl(run: Record) -> bool:
    """Whether tools have pushed the sheet below its rim: it is shown upside down, as a dome."""
    z = run.sheet.points[:, 2]
    return run.has_tools and bool(z[np.concatenate(run.sheet.loops)].mean() > z.mean())


def view_from(turned_over: bool) -> FloatArray:
    """(3, 3) rows: directions to the right, up and towards the viewer, from slightly above."""
    ca, sa, ce, se = np.cos(AZIMUTH), np.sin(AZIMUTH), np.cos(ELEVATION), np.sin(ELEVATION)
    view = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
    return view @ np.diag([1.0, -1.0, -1.0]) if turned_over else view


def draw_in_space(
    axes: Axes, run: Record, colours: ScalarMappable, room: FloatArray | None = None
) -> bool:
    """Draw the shaded sheet in its view, which holds the points `room`; True if turned over."""
    view, turned_over = view_of(run)
    P = run.sheet.points @ view.T
    paint(axes, run.sheet, P, shear_faces(run.sheet, colours), shaded=True)
    frame(axes, P if room is None else room, view)
    return turned_over


def shear_faces(sheet: FormedSheet, colours: ScalarMappable) -> FloatArray:
    """(n_triangles, 4) colours of the shear angle, and of what has collapsed."""
    faces = colours.to_rgba(np.abs(sheet.shear_angle))
    faces[collapsed(sheet)] = to_rgba(COLLAPSED)
    return faces


def paint(
    axes: Axes,
    sheet: FormedSheet,
    P: FloatArray,
    faces: FloatArray,
    *,
    shaded: bool = False,
    fibres: bool = True,
) -> None:
    """Draw triangles from far to near with their colours (m, 4), the fibre lines and the outline.

    P (n, 3) are the nodes in the view: to the right, up, towards the viewer, mm.
    """
    failed, triangles = collapsed(sheet), sheet.triangles
    faces = faces.copy()
    if shaded:
        n = node_normals(triangles, P)[triangles].sum(1)
        n /= np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
        n *= np.where(n[:, 2] < 0, -1.0, 1.0)[:, None]  # the side that is seen
        bright = np.clip(n @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
        faces[:, :3] *= (0.55 + 0.5 * bright)[:, None]
    depth = P[triangles, 2].mean(1)
    depth[failed] += 2.0 * np.sqrt(2.0 * sheet.flat_areas.max())  # slivers, which shall be seen
    order = np.argsort(depth, kind="stable")
    faces = np.clip(faces, 0.0, 1.0)[order]
    look = {"facecolors": faces, "edgecolors": faces, "joinstyle": "round"}
    look["linewidths"] = np.where(failed, 1.5, 0.3)[order]
    axes.add_collection(PolyCollection(P[triangles[order], :2], **look))
    if fibres:
        draw_lines(axes, P, triangles, P[shown_fibres(sheet)], (0.0, 0.0, 0.0, 0.5), 0.35)
        draw_lines(axes, P, triangles, P[rim(sheet)], "0.1", 0.6)


def extent(sheet: FormedSheet) -> float:
    """Larger side of the flat sheet, mm."""
    return float(np.ptp(sheet.flat, axis=0).max())


def shown_fibres(sheet: FormedSheet) -> np.ndarray:
    """(n_segments, 2) nodes of some twenty fibre lines of a family of each ply."""
    plies = apart(sheet)
    return np.vstack(
        [nodes[fibre_lines(p.blank, max(p.blank.size, extent(p) / 20))] for nodes, p in plies]
    )


def rim(sheet: FormedSheet) -> np.ndarray:
    """(n_segments, 2) nodes of the outlines."""
    return np.vstack([np.column_stack([loop[:-1], loop[1:]]) for loop in sheet.loops])


def draw_lines(
    axes: Axes, P: FloatArray, triangles: np.ndarray, lines: FloatArray, colour: Any, width: float
) -> None:
    """Draw segments (k, 2, 3) that lie on the sheet, joined, where no triangle hides them.

    Segments and nodes P (n, 3) are those in the view; the width is in points.
    """
    shown = lines[~hidden(P, triangles, lines.mean(1)), :, :2]
    look = {"colors": [colour], "linewidths": width, "joinstyle": "round", "capstyle": "butt"}
    axes.add_collection(LineCollection(joined(np.round(shown, 6)), **look))


def hidden(P: FloatArray, triangles: np.ndarray, points: FloatArray) -> np.ndarray:
    """(n,) bool array: points of the sheet in the view, (n, 3), behind one of its triangles."""
    corners = P[triangles]
    a, legs = corners[:, 0], corners[:, 1:] - corners[:, :1]
    area = np.linalg.det(legs[:, :, :2])
    seen = np.abs(area) > 1e-9 * np.abs(area).max()  # one seen along its plane hides nothing
    tree = shapely.STRtree(shapely.polygons(corners[seen][:, :, :2]))
    at, triangle = tree.query(shapely.points(points[:, :2]), predicate="intersects")
    triangle = np.flatnonzero(seen)[triangle]
    arm = points[at, None, :2] - a[triangle, None, :2]
    shares = np.linalg.solve(legs[triangle, :, :2].transpose(0, 2, 1), arm.transpose(0, 2, 1))
    depth = a[triangle, 2] + (legs[triangle, :, 2] * shares[:, :, 0]).sum(1)
    near = 1e-4 * np.ptp(P[:, :2], axis=0).max()  # the triangles it lies on, and roundings
    return np.bincount(at, depth > points[at, 2] + near, len(points)) > 0


def node_normals(triangles: np.ndarray, P: FloatArray) -> FloatArray:
    """(n_nodes, 3) sums of the normals of the triangles around a node, twice their area long."""
    normals = np.zeros((len(P), 3))
    np.add.at(normals, triangles, normals_of(P[triangles])[:, None])
    return normals


def fibre_lines(blank: Blank, pitch: float) -> np.ndarray:
    """(n_segments, 2) nodes of every so many fibre lines, about `pitch` mm apart when flat.

    None where the mesh does not follow the fibres.
    """
    kept = [np.empty((0, 2), dtype=int)]
    legs = blank.nodes[blank.triangles] - blank.nodes[np.roll(blank.triangles, 1, axis=1)]
    legs /= np.linalg.norm(legs, axis=2)[:, :, None]
    on_fibre = np.abs(legs @ np.column_stack([blank.warp, blank.weft])) > 1 - 1e-8
    families = (("warp", blank.weft), ("weft", blank.warp)) if on_fibre.any((1, 2)).all() else ()
    for family, across in families:
        segments = blank.fibre_lines(family).t.T
        s = (blank.nodes @ across)[segments].mean(1)
        order = np.argsort(s)
        step = np.diff(s[order], prepend=s[order[0]])
        new = step > 1e-6 * np.ptp(s)
        line = np.empty(len(s), dtype=int)
        line[order] = np.cumsum(new)
        every = max(1, round(pitch / np.median(step[new]))) if new.any() else 1
        middle = line[np.abs(s - blank.nodes.mean(0) @ across).argmin()]
        kept.append(segments[(line - middle) % every == 0])
    return np.vstack(kept)


def draw_flat_outline(axes: Axes, sheet: FormedSheet, **look: Any) -> None:
    """Dashed outlines of the flat sheet."""
    for loop in sheet.loops:
        line = shapely.LineString(sheet.flat[loop]).simplify(1e-6)
        axes.plot(*shapely.get_coordinates(line).T, **{**DASHED, "zorder": 0.5, **look})


def _draw_from_above(axes: Axes, run: Record, colours: ScalarMappable) -> list[Line2D]:
    """Shear angle seen along z over the flat blank; grips, draw-in, areas (returns their rings)."""
    sheet = run.sheet
    grips = [] if run.gripped is None else draw_grips(axes, sheet, run.gripped)
    draw_flat_outline(axes, sheet)
    paint(axes, sheet, sheet.points, shear_faces(sheet, colours))
    draw_locking(axes, run)
    rings = [*_draw_tools(axes, run), *_draw_areas(axes, run)]
    draw_draw_in_arrows(axes, run)
    frame(axes, np.vstack([sheet.points[:, :2], sheet.flat, *grips]))
    if collapsed(sheet).any():
        (mark,) = axes.plot([], [], "s", color=COLLAPSED, label="collapsed")
        axes.legend(handles=[mark], loc="lower left", borderaxespad=0, handletextpad=0)
    if run.summary.get("draw_in_mm"):
        axes.set_title("seen from above; draw-in in mm", pad=12)
    return rings


def _draw_tools(axes: Axes, run: Record) -> list[Line2D]:
    """Cuts through punch and die, dashed and dotted; returns them for the key."""
    handles = []
    cuts, _ = tool_cuts(run)
    for stroke, (words, (x, y, d)) in zip(("--", ":"), cuts.items(), strict=False):
        look = {"linestyles": stroke, "linewidths": 1.0, "colors": TOOL}
        axes.contour(x, y, d, levels=[0.0], **look)
        name = words.partition(",")[0]
        handles.append(Line2D([], [], color=TOOL, linestyle=stroke, linewidth=1.0, label=name))
    return handles


def draw_grips(axes: Axes, sheet: FormedSheet, gripped: np.ndarray) -> list[FloatArray]:
    """Hatch a band along the gripped parts of the outline; return the bands' outlines."""
    segments = rim(sheet)
    ends = sheet.points[segments[gripped[segments].all(1)], :2]
    outward = (ends[:, 1] - ends[:, 0])[:, ::-1] * [1.0, -1.0]  # the sheet is on the left
    outward *= 0.04 * extent(sheet) / np.linalg.norm(outward, axis=1)[:, None]
    strips = np.stack([ends[:, 0], ends[:, 1], ends[:, 1] + outward, ends[:, 0] + outward], axis=1)
    grips = shapely.get_parts(shapely.union_all(shapely.polygons(strips), grid_size=1e-6))
    outlines = [shapely.get_coordinates(grip) for grip in grips]
    for outline in outlines:
        axes.fill(*outline.T, facecolor="0.93", edgecolor="0.35", hatch="//////", linewidth=0.6)
    return outlines


def draw_draw_in_arrows(axes: Axes, run: Record) -> None:
    """Number and arrow of the draw-in at the middle of each edge, and where it is largest."""
    points, edges = run.sheet.points, _edges(run, run.sheet)
    arrows = [(edge.flat, edge.inward, edge.draw_in(points), "") for edge in edges]
    away, known = 0.055 * extent(run.sheet), [flat for flat, *_ in arrows]
    for most in largest_draw_in(run.sheet) if arrows else []:
        if np.linalg.norm(most[0] - known, axis=1).min() > 3 * away:  # else their words overlap
            arrows.append(most)
    for flat, inward, draw_in, word in arrows:
        tilt = np.degrees(np.arctan2(inward[0], -inward[1]))
        axes.annotate("", flat + draw_in * inward, flat, arrowprops=ARROW)
        words = f"{word}{round(draw_in, 1) + 0.0:.1f}"
        turn = 90.0 - (90.0 - tilt) % 180.0
        axes.text(*(flat - away * inward), words, rotation=turn, **MIDDLE)


def _edges(run: Record, sheet: FormedSheet) -> list[Any]:
    """Points of the outline where the draw-in is measured."""
    found = edge_points(sheet.blank, float(run.parameters.get("turn", 0.0)))
    return [found[name] for name in run.summary.get("draw_in_mm") or ()]


def largest_draw_in(sheet: FormedSheet) -> list[tuple[FloatArray, FloatArray, float, str]]:
    """Where a blank that is no rectangle draws in most: flat place, inward normal, mm, a word."""
    loop = sheet.loops[0][:-1]
    X, x = sheet.flat[loop], sheet.points[loop, :2]
    flat = shapely.Polygon(X)
    if flat.area > 0.99 * flat.minimum_rotated_rectangle.area:
        return []
    along = np.roll(X, -1, axis=0) - np.roll(X, 1, axis=0)
    inward = along[:, ::-1] * ([-1.0, 1.0] if flat.exterior.is_ccw else [1.0, -1.0])
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    draw_in = ((x - X) * inward).sum(1)
    most = int(draw_in.argmax())
    return [(X[most], inward[most], float(draw_in[most]), "most ")]


def _draw_areas(axes: Axes, run: Record) -> list[Line2D]:
    """Rings around the named areas on the formed sheet, with their mean angle."""
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    rims = [Stroke(linewidth=w, foreground=c) for w, c in ((2.8, "black"), (2.2, "white"))]
    rims.append(Normal())
    rings = []
    for name, mean in (run.summary.get("areas") or {}).items():
        if name not in run.areas:  # its scene is not known
            continue
        centre, radius = run.areas[name]
        ring = formed_places(run.sheet, centre + radius * circle)
        colour = name if is_color_like(name) else RINGS[len(rings) % len(RINGS)]
        label = plain(f"{name} –" if mean is None else f"{name} {mean:.1f}°")
        rings += axes.plot(*ring.T, color=colour, linewidth=1.2, path_effects=rims, label=label)
    return rings


def formed_places(sheet: FormedSheet, points: FloatArray) -> FloatArray:
    """Formed places (n, 2), seen along z, of those flat points that lie on the sheet."""
    tree = shapely.STRtree(shapely.polygons(sheet.flat[sheet.triangles]))
    at, triangle = tree.query(shapely.points(points), predicate="intersects")
    at, first = np.unique(at, return_index=True)
    triangle = triangle[first]
    corner = sheet.triangles[triangle, 0]
    moved = np.einsum("nij,nj->ni", sheet.F[triangle], points[at] - sheet.flat[corner])
    return (sheet.points[corner] + moved)[:, :2]


def frame(axes: Axes, points: FloatArray, view: FloatArray | None = None) -> None:
    """Equal scales, no axes, and a scale bar below the points (n, 2 or more), mm.

    With a view, also the directions of x, y and z but for what points at the viewer.
    """
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    extent = (high - low).max()
    power = 10.0 ** np.floor(np.log10(extent / 3))
    bar = max(step * power for step in (1, 2, 5) if step * power <= extent / 3)
    y = low[1] - 0.05 * extent
    axes.plot([high[0] - bar, high[0]], [y, y], color="black", linewidth=1.5, solid_capstyle="butt")
    below = high[0] - bar / 2, y - 0.015 * extent
    axes.text(*below, f"{bar:g} mm", **MIDDLE | {"va": "top"})
    axes.set_xlim(low[0] - 0.03 * extent, high[0] + 0.03 * extent)
    axes.set_ylim(y - 0.06 * extent, high[1] + 0.03 * extent)
    axes.set_aspect("equal")
    axes.axis("off")
    arm = 0.09 * extent
    shown = () if view is None else zip("xyz", view.T[:, :2], strict=True)
    for name, direction in shown:
        if np.linalg.norm(direction) >= 0.1:
            origin = low + np.array([arm, 0.0])
            axes.annotate("", origin + arm * direction, origin, arrowprops=ARROW)
            axes.text(*(origin + 1.3 * arm * direction), name, **MIDDLE)


def draw_force(
    axes: Axes, run: Record, look: dict[str, Any], label: str | None = None, tail: str | None = None
) -> None:
    """Force over travel with its error; faded from a collapse on, hollow on a coarser mesh.

    Where the end was solved on a finer mesh than the way there, the step to it is dotted.
    """
    travel, force = run.history[run.travel_name], run.forces
    n = sound_rows(run)
    first = int(axes.get_yscale() == "log")  # no force at the start
    marks = {"marker": look.get("marker", "o"), "markersize": look.get("markersize", 2)}
    look = {"clip_on": False, **look}
    sizes = run.history.get("size_mm", np.zeros(len(travel)))
    coarse = (sizes > sizes[-1] * (1 + 1e-9))[first:n]
    same = first + int(coarse.sum()) if coarse.any() else n  # rows of the way there
    axes.plot(travel[first:same], force[first:same], **look, label=label)
    if same < n:
        step = {"color": look["color"], "linestyle": ":", "linewidth": 0.9}
        axes.plot(travel[same - 1 : n], force[same - 1 : n], **step)
        axes.plot(travel[same:n], force[same:n], **look | {"linestyle": ""})
    if n < len(travel):
        faded = {"color": look["color"], "linestyle": ":", "alpha": 0.6}
        axes.plot(travel[n - 1 :], force[n - 1 :], **faded, label=tail)
    if (error := run.history.get(f"force_error_{run.force_unit}")) is not None:
        bars = {"ecolor": look["color"], "elinewidth": 0.7, "capsize": 1.5, "fmt": "none"}
        axes.errorbar(travel[first:n], force[first:n], error[first:n], **bars)
        if axes.get_yscale() == "linear":
            high = (f[first:n].max(initial=0.0) for f in (force + error, 1.5 * force))
            axes.set_ylim(top=max(axes.get_ylim()[1], 1.05 * min(high)))
    if coarse.any():
        hollow = {**marks, "color": look["color"], "markerfacecolor": "white", "linestyle": ""}
        axes.plot(travel[first:n][coarse], force[first:n][coarse], **hollow)


def sound_rows(run: Record) -> int:
    """How many rows of the history there are before a collapse, at least one."""
    collapse = run.summary.get("collapse")
    travel = run.history[run.travel_name]
    return max(1, int(np.sum(travel < (collapse["travel_mm"] if collapse else np.inf))))


def _draw_force_panel(axes: Axes, run: Record) -> None:
    """Force over travel, with the closed form of an off-axis test."""
    travel, force = run.history[run.travel_name], run.forces
    scale_force(axes, force, force[: sound_rows(run)])
    known = off_axis_theory(run)
    look = CURVE | {"marker": "o", "linestyle": "-"}
    sizes = run.history.get("size_mm", np.zeros(1))
    if (sizes > sizes[-1] * (1 + 1e-9)).any():
        look["markersize"] = 3.5
        hollow = {"marker": "o", "linestyle": "", "markersize": 3.5, "color": FIRST}
        axes.plot([], [], mfc="white", label=f"path, {sizes.max():.3g} mm mesh", **hollow)
        axes.plot([], [], label=f"end, {sizes[-1]:.3g} mm mesh", **hollow)
    draw_force(axes, run, look, "computed" if known else None, "collapsed:\nforce not meaningful")
    if f"force_error_{run.force_unit}" in run.history:
        axes.errorbar([], [], [], fmt="none", ecolor=FIRST, capsize=1.5, label="mesh error")
    if known:
        u, _, f = known
        axes.plot(u, f, **THEORY, label="power balance,\ninextensible fibres")
    _, name, unit = words_of(run)
    if run.summary["reason"] and travel[-1] < run.goal * (1 - 1e-9):
        label = f"stopped at {travel[-1]:.4g}{' mm' if unit == 'N' else ''}"
        axes.plot([], [], "X", color=STOP, markersize=6, label=label)
    _finish_panel(axes, run, travel[-1], force[-1], f"{name} in {unit}")


def scale_force(axes: Axes, force: FloatArray, sound: FloatArray) -> bool:
    """Let the sound part of the force fill the panel; on a log scale (True) where it locks."""
    rising = sound[1:]
    if len(rising) and 0 < 50.0 * np.quantile(rising, 0.3) < rising.max() and rising.min() > 0:
        axes.set_yscale("log")
        axes.set_ylim(0.7 * rising.min(), 1.5 * rising.max())
        return True
    low, high = min(0.0, sound.min()), max(0.0, sound.max())
    high = max(high, min(force.max(), 1.5 * high))
    room = 0.1 * (high - low)
    if room < 1e-6:  # nothing but the start, or no force
        low, high, room = 0.0, 1.0, 0.0
    axes.set_ylim(low - room * (low < -room), high + room)
    return False


def _draw_shear_angles(axes: Axes, run: Record, found: list[tuple[FloatArray, FloatArray]]) -> None:
    """Largest shear angle over travel, and that at the centre or the 99th percentile.

    `found` has |γ| and the flat areas of the triangles of each sheet.
    """
    travel = np.array(run.sheets.travels)
    largest = np.array([gamma.max() for gamma, _ in found])
    axes.plot(travel, largest, "^-", **CURVE | {"markersize": 4}, label="largest")
    other, label = run.history.get("shear_angle_center_deg"), "centre"
    if other is None or len(other) != len(travel):
        other, label = [percentile(g, area, 0.99) for g, area in found], "99th percentile"
    axes.plot(travel, other, "s-", **CURVE | {"color": SECOND}, label=label)
    if known := off_axis_theory(run):
        u, angle, _ = known
        axes.plot(u, angle, **THEORY, label="kinematic,\ninextensible fibres")
    axes.set_ylim(0.0, max(1.0, 1.1 * largest.max()))
    _finish_panel(axes, run, travel[-1], largest[-1], "shear angle |γ| in °")


def _draw_draw_in(axes: Axes, run: Record, found: list[list[float]]) -> None:
    """Draw-in over travel: mean of the mid-edges and their range, from those of each sheet."""
    travel = np.array(run.sheets.travels)
    mean, low, high = (np.array(f(found, axis=1)) for f in (np.mean, np.min, np.max))
    axes.plot(travel, mean, "o-", **CURVE, label="mean of the edges")
    if (high - low).max() > max(0.1, 0.02 * np.abs(mean).max()):
        axes.fill_between(travel, low, high, color=FIRST, alpha=0.2, linewidth=0, label="range")
    axes.set_ylim(min(0.0, 1.1 * low.min()), max(1.0, 1.1 * high.max()))
    _finish_panel(axes, run, travel[-1], mean[-1], "draw-in in mm")


def _finish_panel(axes: Axes, run: Record, travel: float, value: float, label: str) -> None:
    """Label a panel over the travel and mark where a stopped run ended."""
    if run.summary["reason"] and travel < run.goal * (1 - 1e-9):
        axes.plot(travel, value, "X", color=STOP, markersize=6, zorder=3)
    name, _, unit = words_of(run)
    axes.set_xlim(0.0, 1.02 * run.goal)
    axes.set_xlabel(f"{name} in mm" if unit == "N" else name)
    axes.set_ylabel(label)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")


def off_axis_theory(run: Record) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Displacement (mm), shear angle (degrees) and force (N) with inextensible fibres, if known."""
    from ..theory import OffAxisTension

    if "shear_angle_center_deg" not in run.history or run.model is None:
        return None
    length, width, angle = (run.parameters.get(key) for key in ("length", "width", "angle"))
    try:
        strip = OffAxisTension(length, width, np.radians(angle))
    except (TypeError, ValueError):  # a size is not known, or a fibre joins both grips
        return None
    u = np.linspace(0.0, min(run.goal, 0.999 * strip.displacement_limit), 200)
    fabric = run.model.sheet.fabric
    force = strip.force(u, fabric.shear.stress, fabric.thickness)
    return u, np.degrees(strip.angles(u)[0]), force
