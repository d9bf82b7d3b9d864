"""Pictures of a result: the shear angle on the formed sheet, and the history of the run.

The formed sheet is projected here (parallel projection) and its triangles are drawn from far to
near, so that the sheet hides its own far side; lines on it are drawn over them where no triangle is
nearer. The shade of a triangle follows its normal. Everything is drawn on `Figure` objects of
matplotlib, nothing through pyplot.
"""

from __future__ import annotations

import textwrap
import warnings
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..model import COLLAPSE
from ..net.blank import Blank
from ..result.measures import SLIP_GRADIENT, percentile
from ..result.run import Result
from ..theory import OffAxisTension

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

FloatArray = np.ndarray

WIDTH = 16 / 2.54  # inches: the text width of a page
DPI = 200
STYLE = {
    "font.size": 8,
    "figure.titlesize": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.handletextpad": 0.6,
    "lines.linewidth": 1.2,
    "hatch.linewidth": 0.5,
    "path.snap": False,  # a line along the pixels would step aside from the next one
}
COLOURS = "magma_r"  # perceptually uniform; light where unsheared, so that the shading shows
RING_LEGEND = {"handlelength": 1.0, "columnspacing": 1.0, "title_fontsize": 7, "borderaxespad": 0}
COLLAPSED = "#00c2d1"
FIRST, SECOND, STOP = "#4b2991", "#d1605e", "#b00020"
CURVE = {"markersize": 2, "color": FIRST, "clip_on": False}
SCALES = (10, 20, 30, 45, 60, 75, 90)  # ends of the colour scale, degrees
AZIMUTH, ELEVATION = np.radians(-62.0), np.radians(36.0)
TRUSTED = "#f2f2f2"
DOUBTS = {  # later ones lie over earlier ones
    "unstable_in_shear": ("#9ecae1", "unstable: bands may form"),
    "rovings_may_slip": ("#807dba", "steeper than {slip:g}°/mm: rovings may slip"),
    "beyond_identified_range": ("#fdae61", "beyond {range:g}°: law not identified"),
    "collapsed": ("#b2182b", "collapsed"),
}
LIGHT = np.array([-0.45, 0.55, 0.70])  # direction to the light: right, up, towards the viewer


def save_pictures(result: Result, folder: str | Path) -> None:
    """Write `shear_angle.png`, `history.png` and `doubt.png`.

    Parameters
    ----------
    result : Result
        Of any scene, finished or stopped.
    folder : path
        Existing folder.
    """
    from matplotlib import rc_context

    with rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name with letters the font lacks
        sheet = _plane_figure(result) if result.scene.dim == 2 else _formed_figure(result)
        sheet.savefig(Path(folder) / "shear_angle.png", dpi=DPI)
        _history_figure(result).savefig(Path(folder) / "history.png", dpi=DPI)
        _doubt_figure(result).savefig(Path(folder) / "doubt.png", dpi=DPI)


def _plain(name: str) -> str:
    """Return a name from a file as a label of a legend: nothing in it is a formula."""
    return name.replace("$", r"\$").lstrip("_")  # matplotlib hides what begins with _


def _formed_figure(result: Result) -> Figure:
    """Sheet in space, the same seen along z, and the force."""
    figure = _figure(4.2)
    panels = figure.subplot_mosaic(
        [["space", "above"], ["force", "key"]], width_ratios=[1.35, 1], height_ratios=[2.4, 1]
    )
    for view in ("space", "above"):
        panels[view].set_anchor("N")
    colours = _colour_scale(result)
    _draw_in_space(panels["space"], result, colours)
    rings = _draw_from_above(panels["above"], result, colours)
    _draw_force(panels["force"], result)
    key = panels["key"]
    key.axis("off")
    if rings:
        title = "mean |γ| in the ringed areas"
        key.legend(handles=rings, loc="upper center", ncols=3, title=title, **RING_LEGEND)
    _draw_colour_scale(figure, colours, cax=key.inset_axes([0.02, 0.28, 0.96, 0.12]))
    figure.suptitle(_title(result), parse_math=False)
    return figure


def _plane_figure(result: Result) -> Figure:
    """Specimen in its plane, and the force."""
    figure = _figure(4.4)
    panels = figure.subplot_mosaic([["sheet"], ["force"]], height_ratios=[2.4, 1])
    colours = _colour_scale(result)
    _draw_from_above(panels["sheet"], result, colours)
    _draw_force(panels["force"], result)
    _draw_colour_scale(figure, colours, ax=panels["sheet"], shrink=0.85, aspect=25, panchor=False)
    figure.suptitle(_title(result), parse_math=False)
    return figure


def _doubt_figure(result: Result) -> Figure:
    """Where not to trust the shear angle, and why, seen along z."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Patch

    figure = _figure(4.2)
    axes, key = figure.subplots(1, 2, width_ratios=[1.35, 1])
    blank = result.blank
    faces = np.tile(to_rgba(TRUSTED), (len(blank.triangles), 1))
    doubts = result.doubts()
    handles = []
    for reason, (colour, words) in DOUBTS.items():
        faces[doubts[reason]] = to_rgba(colour)
        share = 100 * blank.areas @ doubts[reason] / blank.areas.sum()
        label = words.format(range=result.scene.fabric.shear_range, slip=SLIP_GRADIENT)
        handles.append(Patch(facecolor=colour, label=f"{label}: {share:.1f} %"))
    positions = result.positions()
    _paint(axes, result, positions, faces, shaded=False)
    _frame(axes, positions[:, :2])
    key.axis("off")
    trusted = Patch(facecolor=TRUSTED, edgecolor="0.6", label="nothing against it")
    title = "doubts about the shear angle, share of the area"
    key.legend(handles=[*handles[::-1], trusted], loc="upper left", title=title, frameon=False)
    figure.suptitle(_title(result), parse_math=False)
    return figure


def _history_figure(result: Result) -> Figure:
    """Force, shear angle and, with mid-edges, draw-in over the travel."""
    draw = [_draw_force, _draw_shear_angles]
    if result.scene.edges:
        draw.append(_draw_draw_in)
    figure = _figure(2.7)
    for axes, panel in zip(figure.subplots(1, len(draw)), draw, strict=True):
        panel(axes, result)
    figure.suptitle(_title(result), parse_math=False)
    return figure


def _figure(height: float) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.05)
    return figure


def _title(result: Result) -> str:
    """Case, fabric and size; then the key numbers of the summary."""
    summary, scene = result.summary(), result.scene
    case = [summary["case"], scene.fabric.name]
    size = scene.parameters.get("size")
    path = f" (path at {summary['path_size_mm']:.3g} mm)" if summary["path_size_mm"] else ""
    case.append(f"size {size if isinstance(size, Real) else scene.blank.size:.3g} mm{path}")
    travel, force, unit = _words(result)
    case.append(f"{travel} {summary['reached_mm']:.4g}{' mm' if unit == 'N' else ''}")
    gamma, certified = summary["shear_angle_deg"], summary["certified"]
    errors = summary["error_estimate"]
    off, off_force = (
        "" if errors[name] is None else f" ± {errors[name]:.2g}"
        for name in ("shear_angle_deg", "force_N")
    )
    numbers = [f"|γ| max {gamma['max']:.1f}°, p99 {gamma['p99']:.1f}{off}°"]
    if unit == "N":
        numbers.append(f"{force} {round(summary['force_N'], 3) + 0.0:.4g}{off_force} N")
    if certified is True:
        numbers.append("certified")
    title = " · ".join(case) + "\n" + " · ".join(numbers)
    if certified is not True:
        title += "\n" + textwrap.fill(f"not certified: {certified}", 100)
    return title


def _words(result: Result) -> tuple[str, str, str]:
    """Names of the travel and of its force, and the unit of the force."""
    scene = result.scene
    if scene.dead_load:
        return "load factor", "load's potential", "mJ"
    if scene.contacts:
        return "punch travel", "punch force", "N"
    return "displacement", "force", "N"


def _collapsed(result: Result) -> np.ndarray:
    """(n_triangles,) bool array: sheared past 85 degrees, or turned over in the plane."""
    beyond = np.abs(result.shear_angle) > np.degrees(COLLAPSE)
    if result.scene.dim == 2:
        corners = result.positions()[result.blank.triangles]
        beyond |= np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] <= 0
    return beyond


def _colour_scale(result: Result) -> ScalarMappable:
    """Colours from 0 to the first round angle that no triangle passes, but for collapsed ones."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    gamma = np.abs(result.shear_angle)[~_collapsed(result)]
    end = next((s for s in SCALES if s >= gamma.max(initial=0.0)), SCALES[-1])
    # the darkest end is left out: shading and fibre lines would not show on it
    shades = colormaps[COLOURS](np.linspace(0.02, 0.88, 256))
    return ScalarMappable(Normalize(0, end), LinearSegmentedColormap.from_list(COLOURS, shades))


def _draw_colour_scale(figure: Figure, colours: ScalarMappable, **place: object) -> None:
    orientation = "horizontal" if "cax" in place else "vertical"
    bar = figure.colorbar(colours, orientation=orientation, label="shear angle |γ| in °", **place)
    bar.outline.set_linewidth(0.5)


def _draw_in_space(axes: Axes, result: Result, colours: ScalarMappable) -> None:
    """Shaded view from slightly above; a bowl is turned over, so that its dome is seen."""
    positions = result.positions()
    turned_over = _is_bowl(result, positions)
    view = _view(turned_over)
    P = positions @ view.T
    _paint(axes, result, P, colours, shaded=True)
    _frame(axes, P)
    _draw_triad(axes, view, P)
    if turned_over:
        axes.set_title("seen from below (the punch moved up, along −z)", pad=12)


def _is_bowl(result: Result, positions: FloatArray) -> bool:
    """Whether tools have pushed the sheet below its rim."""
    rim = np.unique(_rim(result.blank))
    return bool(result.scene.contacts) and positions[rim, 2].mean() > positions[:, 2].mean()


def _view(turned_over: bool) -> FloatArray:
    """(3, 3) rows: directions to the right, up and towards the viewer."""
    ca, sa, ce, se = np.cos(AZIMUTH), np.sin(AZIMUTH), np.cos(ELEVATION), np.sin(ELEVATION)
    view = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
    return view @ np.diag([1.0, -1.0, -1.0]) if turned_over else view


def _paint(
    axes: Axes, result: Result, P: FloatArray, colours: ScalarMappable | FloatArray, *, shaded: bool
) -> None:
    """Draw triangles from far to near, and the fibre lines that are seen.

    Parameters
    ----------
    axes : Axes
    result : Result
    P : (n_nodes, 3) array
        Nodes in the view: to the right, up, towards the viewer, mm.
    colours : ScalarMappable, or (n_triangles, 4) array
        Of the shear angle, or by triangle.
    shaded : bool
        Shade the triangles by their normals.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    blank = result.blank
    collapsed = _collapsed(result)
    if isinstance(colours, np.ndarray):
        faces = colours.copy()
    else:
        faces = colours.to_rgba(np.abs(result.shear_angle))
        faces[collapsed] = to_rgba(COLLAPSED)
    if shaded:
        faces[:, :3] *= _shade(blank, P)[:, None]
    depth = P[blank.triangles, 2].mean(1)
    depth[collapsed] += 2.0 * np.sqrt(2.0 * blank.areas.max())  # slivers, which shall be seen
    order = np.argsort(depth, kind="stable")
    faces = np.clip(faces, 0.0, 1.0)[order]
    axes.add_collection(
        PolyCollection(
            P[blank.triangles[order], :2],
            facecolors=faces,
            edgecolors=faces,
            linewidths=np.where(collapsed, 1.5, 0.3)[order],
            joinstyle="round",
        )
    )
    pitch = max(blank.size, np.ptp(blank.nodes, axis=0).max() / 20)
    draw_lines(axes, P, blank.triangles, P[fibre_lines(blank, pitch)], to_rgba("black", 0.5), 0.35)
    draw_lines(axes, P, blank.triangles, P[_rim(blank)], "0.1", 0.6)


def draw_lines(
    axes: Axes,
    P: FloatArray,
    triangles: np.ndarray,
    segments: FloatArray,
    colour: object,
    width: float,
) -> None:
    """Draw segments (n, 2, 3) that lie on the sheet, joined, where no triangle hides them.

    Parameters
    ----------
    axes : Axes
    P : (n_nodes, 3) array
        Nodes in the view: to the right, up, towards the viewer, mm.
    triangles : (n_triangles, 3) int array
    segments : (n, 2, 3) array
        In the view.
    colour : colour of matplotlib
    width : float
        Points.
    """
    from matplotlib.collections import LineCollection

    shown = segments[~hidden(P, triangles, segments.mean(1)), :, :2]
    pieces = shapely.multilinestrings(shapely.linestrings(np.round(shown, 6)))
    lines = [
        shapely.get_coordinates(part) for part in shapely.get_parts(shapely.line_merge(pieces))
    ]
    axes.add_collection(
        LineCollection(lines, colors=[colour], linewidths=width, joinstyle="round", capstyle="butt")
    )


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


def _shade(blank: Blank, P: FloatArray) -> FloatArray:
    """(n_triangles,) factors of the colours, from the normals averaged at the nodes."""
    corners = P[blank.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at_nodes = np.zeros((len(P), 3))
    np.add.at(at_nodes, blank.triangles, normals[:, None])
    n = at_nodes[blank.triangles].sum(1)
    n /= np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
    n *= np.where(n[:, 2] < 0, -1.0, 1.0)[:, None]  # the side that is seen
    light = LIGHT / np.linalg.norm(LIGHT)
    return 0.55 + 0.5 * np.clip(n @ light, 0.0, 1.0)


def fibre_lines(blank: Blank, pitch: float) -> np.ndarray:
    """(n_segments, 2) nodes of every so many fibre lines, about `pitch` mm apart when flat."""
    kept = []
    families = (("warp", blank.weft), ("weft", blank.warp)) if blank.pairs is None else ()
    for family, across in families:
        segments = blank.fibre_lines(family).t.T
        if not len(segments):  # a mesh that does not follow the fibres
            continue
        s = (blank.nodes @ across)[segments].mean(1)
        order = np.argsort(s)
        step = np.diff(s[order], prepend=s[order[0]])
        new = step > 1e-6 * np.ptp(s)
        line = np.empty(len(s), dtype=int)
        line[order] = np.cumsum(new)
        every = max(1, round(pitch / np.median(step[new]))) if new.any() else 1
        middle = line[np.abs(s - blank.nodes.mean(0) @ across).argmin()]
        kept.append(segments[(line - middle) % every == 0])
    return np.vstack([np.empty((0, 2), dtype=int), *kept])


def _draw_from_above(axes: Axes, result: Result, colours: ScalarMappable) -> list[Line2D]:
    """Shear angle seen along z over the flat blank; grips, draw-in, areas (returns their rings)."""
    blank, positions = result.blank, result.positions()
    grips = _draw_grips(axes, result, positions)
    for line in _outline(blank.nodes[_rim(blank)]):
        axes.plot(*line.T, color="0.3", linewidth=0.8, linestyle=(0, (4, 3)), zorder=0.5)
    _paint(axes, result, positions, colours, shaded=False)
    rings = _draw_areas(axes, result, positions)
    _draw_draw_in_arrows(axes, result)
    _frame(axes, np.vstack([positions[:, :2], blank.nodes, *grips]))
    if _collapsed(result).any():
        (mark,) = axes.plot([], [], "s", color=COLLAPSED, label="collapsed")
        axes.legend(handles=[mark], loc="lower left", borderaxespad=0, handletextpad=0)
    if result.scene.edges:
        axes.set_title("seen from above; draw-in in mm", pad=12)
    return rings


def _draw_grips(axes: Axes, result: Result, positions: FloatArray) -> list[FloatArray]:
    """Hatch a band along the fully held parts of the outline; return the bands' outlines."""
    scene, blank = result.scene, result.blank
    held = scene.fixed[: scene.n_nodal].reshape(-1, scene.dim).all(1)[scene.whole[1]]
    of_triangle = blank.mesh.f2t[0, blank.mesh.boundary_facets()]
    rim = _rim(blank)
    gripped = held[rim].all(1)
    ends = positions[rim[gripped], :2]
    inside = positions[blank.triangles[of_triangle[gripped]], :2].mean(1)
    outward = (ends[:, 1] - ends[:, 0])[:, ::-1] * [1.0, -1.0]
    outward *= np.sign((outward * (ends[:, 0] - inside)).sum(1))[:, None]
    outward *= 0.04 * np.ptp(blank.nodes, axis=0).max() / np.linalg.norm(outward, axis=1)[:, None]
    strips = np.stack([ends[:, 0], ends[:, 1], ends[:, 1] + outward, ends[:, 0] + outward], axis=1)
    grips = shapely.get_parts(shapely.union_all(shapely.polygons(strips), grid_size=1e-6))
    outlines = [np.asarray(grip.exterior.coords) for grip in grips]
    for outline in outlines:
        axes.fill(*outline.T, facecolor="0.93", edgecolor="0.35", hatch="//////", linewidth=0.6)
    return outlines


def _draw_draw_in_arrows(axes: Axes, result: Result) -> None:
    """Number and arrow of the draw-in at the middle of each edge, and where it is largest."""
    scene = result.scene
    arrows = [
        (scene.edges[name].flat, scene.edges[name].inward, draw_in, "")
        for name, draw_in in result.draw_in.items()
    ]
    if arrows:
        arrows += _largest_draw_in(result)
    away = 0.055 * np.ptp(result.blank.nodes, axis=0).max()
    for flat, inward, draw_in, word in arrows:
        tilt = np.degrees(np.arctan2(inward[0], -inward[1]))
        _draw_arrow(axes, flat, flat + draw_in * inward)
        axes.text(
            *(flat - away * inward),
            f"{word}{round(draw_in, 1) + 0.0:.1f}",
            ha="center",
            va="center",
            rotation=90.0 - (90.0 - tilt) % 180.0,
            fontsize=7,
        )


def _largest_draw_in(result: Result) -> list[tuple[FloatArray, FloatArray, float, str]]:
    """Where a blank that is no rectangle draws in most: flat place, inward normal, mm, a word."""
    blank = result.blank
    loop = blank.outline[0]
    loop = loop[:-1] if loop[0] == loop[-1] else loop
    X, x = blank.nodes[loop], result.positions()[loop, :2]
    flat = shapely.Polygon(X)
    if flat.area > 0.99 * flat.minimum_rotated_rectangle.area:
        return []
    along = np.roll(X, -1, axis=0) - np.roll(X, 1, axis=0)
    inward = along[:, ::-1] * ([-1.0, 1.0] if flat.exterior.is_ccw else [1.0, -1.0])
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    draw_in = ((x - X) * inward).sum(1)
    most = int(draw_in.argmax())
    return [(X[most], inward[most], float(draw_in[most]), "most ")]


def _draw_areas(axes: Axes, result: Result, positions: FloatArray) -> list[Line2D]:
    """Rings around the named areas where the sheet has carried them, with their mean angle."""
    from matplotlib.colors import is_color_like
    from matplotlib.patheffects import Normal, Stroke

    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    rims = [Stroke(linewidth=w, foreground=c) for w, c in ((2.8, "black"), (2.2, "white"))]
    rims.append(Normal())
    rings = []
    for name, mean in result.areas.items():
        centre, radius = result.scene.areas[name]
        ring = _carried(result.blank, positions[:, :2], centre + radius * circle)
        colour = name if is_color_like(name) else "black"
        rings += axes.plot(
            *ring.T,
            color=colour,
            linewidth=1.2,
            path_effects=rims,
            label=_plain(f"{name} –" if mean is None else f"{name} {mean:.1f}°"),
        )
    return rings


def _carried(blank: Blank, positions: FloatArray, points: FloatArray) -> FloatArray:
    """Deformed places (n, 2) of those flat points that lie on the blank."""
    tree = shapely.STRtree(shapely.polygons(blank.nodes[blank.triangles]))
    at, triangle = tree.query(shapely.points(points), predicate="intersects")
    at, first = np.unique(at, return_index=True)
    corners = blank.triangles[triangle[first]]
    X, x = blank.nodes[corners], positions[corners]
    shares = np.linalg.solve(
        (X[:, 1:] - X[:, :1]).transpose(0, 2, 1), (points[at] - X[:, 0])[..., None]
    )
    return x[:, 0] + ((x[:, 1:] - x[:, :1]) * shares).sum(1)


def _rim(blank: Blank) -> np.ndarray:
    """(n_segments, 2) nodes of the outline."""
    return blank.mesh.facets[:, blank.mesh.boundary_facets()].T


def _outline(segments: FloatArray) -> list[FloatArray]:
    """Join segments (n, 2, 2) to lines, each (m, 2), without points on straight stretches."""
    lines = shapely.line_merge(shapely.union_all(shapely.linestrings(segments)))
    return [np.asarray(line.coords) for line in shapely.get_parts(lines.simplify(1e-6))]


def _frame(axes: Axes, points: FloatArray) -> None:
    """Equal scales, no axes, and a scale bar below the points (n, 2 or more), mm."""
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    extent = (high - low).max()
    power = 10.0 ** np.floor(np.log10(extent / 3))
    bar = max(step * power for step in (1, 2, 5) if step * power <= extent / 3)
    y = low[1] - 0.05 * extent
    axes.plot([high[0] - bar, high[0]], [y, y], color="black", linewidth=1.5, solid_capstyle="butt")
    axes.text(
        high[0] - bar / 2, y - 0.015 * extent, f"{bar:g} mm", ha="center", va="top", fontsize=7
    )
    axes.set_xlim(low[0] - 0.03 * extent, high[0] + 0.03 * extent)
    axes.set_ylim(y - 0.06 * extent, high[1] + 0.03 * extent)
    axes.set_aspect("equal")
    axes.axis("off")


def _draw_triad(axes: Axes, view: FloatArray, P: FloatArray) -> None:
    """Directions of x, y and z in the lower left corner."""
    low = P[:, :2].min(0)
    arm = 0.09 * np.ptp(P[:, :2], axis=0).max()
    origin = low + np.array([arm, 0.0])
    for name, direction in zip("xyz", view.T[:, :2], strict=True):
        _draw_arrow(axes, origin, origin + arm * direction)
        axes.text(*(origin + 1.3 * arm * direction), name, ha="center", va="center", fontsize=7)


def _draw_arrow(axes: Axes, start: FloatArray, end: FloatArray) -> None:
    axes.annotate(
        "",
        end,
        start,
        arrowprops={
            "arrowstyle": "-|>,head_width=0.12,head_length=0.25",
            "linewidth": 0.8,
            "color": "black",
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )


def _draw_force(axes: Axes, result: Result) -> None:
    """Force over travel; faded from a collapse on, with the closed form of an off-axis test."""
    travel = np.array([s.travel for s in result.rows])
    force = np.array([s.force for s in result.rows])
    until = result.collapse["travel_mm"] if result.collapse else np.inf
    n = max(1, int(np.sum(travel < until)))
    first = int(_scale_force(axes, force, force[:n]))  # no force at the start: not on a log scale
    (curve,) = axes.plot(travel[first:n], force[first:n], "o-", **CURVE)
    if n < len(travel):
        axes.plot(
            travel[n - 1 :],
            force[n - 1 :],
            ":",
            color=FIRST,
            alpha=0.6,
            label="collapsed:\nforce not meaningful",
        )
    known = _off_axis_theory(result)
    if known:
        curve.set_label("computed")
        u, _, f = known
        label = "power balance,\ninextensible fibres"
        axes.plot(u, f, "--", color="0.4", linewidth=0.9, label=label)
    _, name, unit = _words(result)
    if result.reason:
        label = f"stopped at {travel[-1]:.4g}{' mm' if unit == 'N' else ''}"
        axes.plot([], [], "X", color=STOP, markersize=6, label=label)
    _finish_panel(axes, result, travel[-1], force[-1], f"{name} in {unit}")


def _scale_force(axes: Axes, force: FloatArray, sound: FloatArray) -> bool:
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


def _draw_shear_angles(axes: Axes, result: Result) -> None:
    """Largest shear angle over travel, and that at the centre or the 99th percentile."""
    travel = np.array([s.travel for s in result.rows])
    gamma = [np.abs(at.shear_angles(i)) for at, i in result.followed]
    largest = np.array([g.max() for g in gamma])
    axes.plot(travel, largest, "o-", **CURVE | {"markersize": 4}, mfc="white", label="largest")
    centre = result.history.get("shear_angle_center_deg")
    if centre is not None:
        axes.plot(travel, centre, "s-", **CURVE | {"color": SECOND}, label="centre")
    else:
        areas = [at.blank.areas for at, _ in result.followed]
        p99 = [percentile(g, area, 0.99) for g, area in zip(gamma, areas, strict=True)]
        axes.plot(travel, p99, "s-", **CURVE | {"color": SECOND}, label="99th percentile")
    known = _off_axis_theory(result)
    if known:
        u, angle, _ = known
        axes.plot(
            u, angle, "--", color="0.4", linewidth=0.9, label="kinematic,\ninextensible fibres"
        )
    axes.set_ylim(0.0, max(1.0, 1.1 * largest.max()))
    _finish_panel(axes, result, travel[-1], largest[-1], "shear angle |γ| in °")


def _draw_draw_in(axes: Axes, result: Result) -> None:
    """Draw-in over travel: mean of the mid-edges and their range."""
    travel = np.array([s.travel for s in result.rows])
    draw_in = np.array(
        [
            [edge.draw_in(at.positions(i)) for edge in at.scene.edges.values()]
            for at, i in result.followed
        ]
    )
    mean = draw_in.mean(1)
    axes.plot(travel, mean, "o-", **CURVE, label="mean of the edges")
    low, high = draw_in.min(1), draw_in.max(1)
    if (high - low).max() > max(0.1, 0.02 * np.abs(mean).max()):
        axes.fill_between(travel, low, high, color=FIRST, alpha=0.2, linewidth=0, label="range")
    axes.set_ylim(min(0.0, 1.1 * draw_in.min()), max(1.0, 1.1 * draw_in.max()))
    _finish_panel(axes, result, travel[-1], mean[-1], "draw-in in mm")


def _finish_panel(axes: Axes, result: Result, travel: float, value: float, label: str) -> None:
    """Label a panel over the travel and mark where a stopped run ended."""
    if result.reason:
        axes.plot(travel, value, "X", color=STOP, markersize=6, zorder=3)
    name, _, unit = _words(result)
    axes.set_xlim(0.0, 1.02 * _goal(result))
    axes.set_xlabel(f"{name} in mm" if unit == "N" else name)
    axes.set_ylabel(label)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")


def _goal(result: Result) -> float:
    """End of the travel axis: the goal, also where a run stopped before it."""
    return max(result.states[-1].travel, result.scene.travel) or 1.0


def _off_axis_theory(result: Result) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Displacement (mm), shear angle (degrees) and force (N) with inextensible fibres, if known."""
    scene = result.scene
    if "shear_angle_center_deg" not in scene.measures:
        return None
    length, width, angle = (scene.parameters.get(key) for key in ("length", "width", "angle"))
    try:
        strip = OffAxisTension(length, width, np.radians(angle))
    except (TypeError, ValueError):  # a size is not known, or a fibre joins both grips
        return None
    u = np.linspace(0.0, min(_goal(result), 0.999 * strip.displacement_limit), 200)
    force = strip.force(u, scene.fabric.shear.stress, scene.fabric.thickness)
    return u, np.degrees(strip.angles(u)[0]), force
