"""Picture of a comparison, seen along z: shear angles, their difference, outlines; forces."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..plot import COLOURS, DPI, FIRST, SECOND, STYLE, WIDTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

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
        for axes, panel in zip(grid, panels, strict=False):
            if panel == "force":
                _force(axes, comparison)
                continue
            if panel != "outlines":
                colours = _field(axes, comparison, panel)
                figure.colorbar(colours, ax=axes, shrink=0.8, label="degrees")
            _outlines(axes, comparison, legend=panel in ("outlines", "difference"))
            axes.set_title(_title(comparison, panel), parse_math=False)
            axes.set_aspect("equal")
            axes.set_xlabel("x, mm")
            axes.set_ylabel("y, mm")
        for axes in grid[len(panels) :]:
            axes.axis("off")
        figure.suptitle(f"{comparison.names[0]} beside {comparison.names[1]}", parse_math=False)
        figure.savefig(path, dpi=DPI)


def _title(comparison: Comparison, panel: str) -> str:
    return {
        "result": "γ of the result",
        "reference": "γ of the reference",
        "difference": "difference: result - reference",
        "outlines": "outlines",
    }[panel]


def _field(axes: Axes, comparison: Comparison, panel: str) -> ScalarMappable:
    sheet, (mine, theirs) = comparison.field, comparison.gamma
    values = {"result": mine, "reference": theirs, "difference": mine - theirs}[panel]
    if panel == "difference":
        top = max(float(np.nanmax(np.abs(values))), 1e-9)
        scale = {"cmap": "RdBu_r", "vmin": -top, "vmax": top}
    else:
        low = min(0.0, float(np.nanmin(comparison.gamma)))
        scale = {"cmap": COLOURS, "vmin": low, "vmax": float(np.nanmax(comparison.gamma)) or 1.0}
    x, y = sheet.places[:, 0], sheet.places[:, 1]
    if sheet.triangles is None:
        return axes.scatter(x, y, c=values, s=4, linewidths=0, **scale)
    known = np.isfinite(values)[sheet.triangles].all(1)
    shown = np.where(np.isfinite(values), values, 0.0)
    return axes.tripcolor(
        x, y, sheet.triangles, shown, mask=~known, shading="gouraud", rasterized=True, **scale
    )


def _outlines(axes: Axes, comparison: Comparison, legend: bool) -> None:
    for sheet, colour, name in zip(
        comparison.sheets, (FIRST, SECOND), ("result", "reference"), strict=True
    ):
        if sheet.outline is not None:
            line = shapely.get_coordinates(sheet.outline).T
            axes.plot(*line, color=colour, linewidth=0.7, label=name)
    if legend and axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


def _force(axes: Axes, comparison: Comparison) -> None:
    s, mine, theirs = comparison.forces
    axes.plot(s, mine, color=FIRST, label="result")
    axes.plot(s, theirs, color=SECOND, linestyle="--", label="reference")
    axes.set_xlabel("travel, mm")
    axes.set_ylabel("force, N")
    axes.legend()
