"""Picture of a comparison, seen along z: shear angles, their difference, outlines; forces.

Each sheet is drawn on its own shape, the difference on that of which it has the points.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..draw.plot import COLOURS, DPI, FIRST, SCALES, SECOND, STYLE, WIDTH
from .mapping import ANGLE
from .place import rim

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..result.sheet import FormedSheet
    from .comparison import Comparison

FloatArray = np.ndarray


def draw(comparison: Comparison, path: Path) -> None:
    """Write the picture of a comparison as PNG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    has_field, has_force = comparison.gamma is not None, comparison.forces is not None
    panels = (["result", "reference", "difference"] if has_field else ["outlines"]) + (
        ["force"] if has_force and comparison.forces.shape[1] > 1 else []
    )
    with rc_context(STYLE):
        columns = min(len(panels), 2)
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(WIDTH, 2.9 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        low, high = _frame(comparison)
        for axes, panel in zip(grid, panels, strict=False):
            if panel == "force":
                _force(axes, comparison)
                continue
            if panel != "outlines":
                _field(figure, axes, comparison, panel)
            _outlines(axes, comparison, panel)
            axes.set_title(_title(comparison, panel), parse_math=False)
            axes.set_aspect("equal")
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[1], high[1])
            axes.set_xlabel("x, mm")
            axes.set_ylabel("y, mm")
        for axes in grid[len(panels) :]:
            axes.axis("off")
        figure.suptitle(f"{comparison.names[0]} beside {comparison.names[1]}", parse_math=False)
        figure.savefig(path, dpi=DPI)


def panel_field(comparison: Comparison, panel: str) -> tuple[FormedSheet, FloatArray]:
    """Sheet of a panel and the shear angle (n,) on it: each on its own shape."""
    if panel == "difference":
        return comparison.field, comparison.difference
    sheet = comparison.sheets[panel == "reference"]
    return sheet, sheet.point_fields[ANGLE]


def _frame(comparison: Comparison) -> FloatArray:
    """(2, 2) lower left and upper right of all that is drawn, with a margin, mm."""
    seen = [sheet.places[:, :2] for sheet in comparison.sheets if sheet.contour is None]
    lines = [line.coords for line in map(rim, comparison.sheets) if line is not None]
    points = np.vstack([*seen, *lines])
    low, high = points.min(0), points.max(0)
    margin = 0.04 * (high - low).max()
    return np.array([low - margin, high + margin])


def _title(comparison: Comparison, panel: str) -> str:
    if panel == "outlines":
        return "outlines"
    where = "" if panel_field(comparison, panel)[0].points is not None else ", on the flat blank"
    if panel == "difference":
        on = "result" if comparison.field is comparison.sheets[0] else "reference"
        return f"difference: result - reference,\non the {on}'s shape{where}"
    return f"γ of the {panel}{where}"


def _field(figure: Figure, axes: Axes, comparison: Comparison, panel: str) -> None:
    """Colours of a panel, and their bar; one scale for both sheets, marked at locking."""
    sheet, values = panel_field(comparison, panel)
    if panel == "difference":
        top = max(float(np.nanmax(np.abs(values))), 1e-9)
        scale = {"cmap": "RdBu_r", "vmin": -top, "vmax": top}
    else:
        both = np.concatenate([one.point_fields[ANGLE] for one in comparison.sheets])
        largest = max(np.nanmax(both), *comparison.locking, 0.0)
        end = next((end for end in SCALES if end >= largest), SCALES[-1])
        low = -end if np.nanmin(both) < 0 else 0.0
        scale = {"cmap": COLOURS, "vmin": low, "vmax": end}
    x, y = sheet.places[:, 0], sheet.places[:, 1]
    if not len(sheet.triangles):
        colours = axes.scatter(x, y, c=values, s=4, linewidths=0, **scale)
    else:
        known = np.isfinite(values)[sheet.triangles].all(1)
        visible = np.where(np.isfinite(values), values, 0.0)
        colours = axes.tripcolor(
            x, y, sheet.triangles, visible, mask=~known, shading="gouraud", rasterized=True, **scale
        )
    bar = figure.colorbar(colours, ax=axes, shrink=0.8, label="degrees")
    if panel == "difference":
        return
    angles = sorted({round(a, 3) for a in comparison.locking if a <= scale["vmax"]})
    for angle in angles:
        bar.ax.axhline(angle, color="black", linewidth=2.4)
        bar.ax.axhline(angle, color="white", linewidth=1.0)
    if angles:
        bar.ax.set_title(f"locking {' and '.join(f'{a:.0f}°' for a in angles)}", fontsize=7)


def _outlines(axes: Axes, comparison: Comparison, panel: str) -> None:
    for sheet, colour, name in zip(
        comparison.sheets, (FIRST, SECOND), ("result", "reference"), strict=True
    ):
        line = rim(sheet)
        if line is not None and panel in (name, "difference", "outlines"):
            axes.plot(*line.xy, color=colour, linewidth=0.7, label=name)
    if panel in ("outlines", "difference") and axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


def _force(axes: Axes, comparison: Comparison) -> None:
    s, mine, theirs = comparison.forces
    axes.plot(s, mine, color=FIRST, label="result")
    axes.plot(s, theirs, color=SECOND, linestyle="--", label="reference")
    axes.set_xlabel("travel, mm")
    axes.set_ylabel("force, N")
    axes.legend()
