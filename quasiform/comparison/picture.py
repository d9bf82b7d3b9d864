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

    Sheets = tuple[FormedSheet, FormedSheet]
    Fields = dict[str, tuple[FormedSheet, np.ndarray]]

FloatArray = np.ndarray
SIDES = ("result", "reference")


def draw(
    path: Path,
    names: tuple[str, str],
    sheets: Sheets,
    field: FormedSheet | None,
    gamma: FloatArray | None,
    forces: FloatArray | None,
    locking: tuple[float, ...],
) -> None:
    """Write the picture of a comparison as PNG; the arguments are as in `Comparison`."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    fields = fields_of(sheets, field, gamma)
    panels = list(fields) or ["outlines"]
    panels += ["force"] if forces is not None and forces.shape[1] > 1 else []
    with rc_context(STYLE):
        columns = min(len(panels), 2)
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(WIDTH, 2.9 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        (left, bottom), (right, top) = _frame(sheets)
        for axes, panel in zip(grid, panels, strict=False):
            if panel == "force":
                _force(axes, forces)
                continue
            if panel in fields:
                _field(figure, axes, panel, fields, locking)
            _outlines(axes, sheets, panel)
            on = "result" if field is sheets[0] else "reference"
            axes.set_title(_title(panel, fields, on), parse_math=False)
            axes.set(aspect="equal", xlim=(left, right), ylim=(bottom, top))
            axes.set(xlabel="x, mm", ylabel="y, mm")
        for axes in grid[len(panels) :]:
            axes.axis("off")
        figure.suptitle(f"{names[0]} beside {names[1]}", parse_math=False)
        figure.savefig(path, dpi=DPI)


def fields_of(sheets: Sheets, field: FormedSheet | None, gamma: FloatArray | None) -> Fields:
    """Sheet of each panel and the shear angle (n,) on it: each on its own shape."""
    if field is None:
        return {}
    own = {side: (s, s.point_fields[ANGLE]) for side, s in zip(SIDES, sheets, strict=True)}
    return own | {"difference": (field, gamma[0] - gamma[1])}


def _frame(sheets: Sheets) -> FloatArray:
    """(2, 2) lower left and upper right of all that is drawn, with a margin, mm."""
    seen = [sheet.places[:, :2] for sheet in sheets if sheet.contour is None]
    lines = [line.coords for line in map(rim, sheets) if line is not None]
    points = np.vstack([*seen, *lines])
    low, high = points.min(0), points.max(0)
    margin = 0.04 * (high - low).max()
    return np.array([low - margin, high + margin])


def _title(panel: str, fields: Fields, on: str) -> str:
    if panel not in fields:
        return panel
    where = "" if fields[panel][0].points is not None else ", on the flat blank"
    if panel == "difference":
        return f"difference: result - reference,\non the {on}'s shape{where}"
    return f"γ of the {panel}{where}"


def _field(
    figure: Figure,
    axes: Axes,
    panel: str,
    fields: Fields,
    locking: tuple[float, ...],
) -> None:
    """Colours of a panel, and their bar; one scale for both sheets, marked at locking."""
    sheet, values = fields[panel]
    if panel == "difference":
        top = max(float(np.nanmax(np.abs(values))), 1e-9)
        scale = {"cmap": "RdBu_r", "vmin": -top, "vmax": top}
    else:
        both = np.concatenate([fields[side][1] for side in SIDES])
        largest = max(np.nanmax(both), *locking, 0.0)
        end = next((end for end in SCALES if end >= largest), SCALES[-1])
        low = -end if np.nanmin(both) < 0 else 0.0
        scale = {"cmap": COLOURS, "vmin": low, "vmax": end}
    x, y = sheet.places[:, 0], sheet.places[:, 1]
    if not len(sheet.triangles):
        colours = axes.scatter(x, y, c=values, s=4, linewidths=0, **scale)
    else:
        scale |= {"mask": ~np.isfinite(values)[sheet.triangles].all(1), "shading": "gouraud"}
        visible = np.nan_to_num(values)
        colours = axes.tripcolor(x, y, sheet.triangles, visible, rasterized=True, **scale)
    bar = figure.colorbar(colours, ax=axes, shrink=0.8, label="degrees")
    if panel == "difference":
        return
    angles = sorted({round(angle, 3) for angle in locking if angle <= scale["vmax"]})
    for angle in angles:
        bar.ax.axhline(angle, color="black", linewidth=2.4)
        bar.ax.axhline(angle, color="white", linewidth=1.0)
    if angles:
        bar.ax.set_title(f"locking {' and '.join(f'{a:.0f}°' for a in angles)}", fontsize=7)


def _outlines(axes: Axes, sheets: Sheets, panel: str) -> None:
    for sheet, colour, side in zip(sheets, (FIRST, SECOND), SIDES, strict=True):
        line = rim(sheet)
        if line is not None and panel in (side, "difference", "outlines"):
            axes.plot(*line.xy, color=colour, linewidth=0.7, label=side)
    if panel in ("outlines", "difference") and axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


def _force(axes: Axes, forces: FloatArray) -> None:
    s, mine, theirs = forces
    axes.plot(s, mine, color=FIRST, label="result")
    axes.plot(s, theirs, color=SECOND, linestyle="--", label="reference")
    axes.set(xlabel="travel, mm", ylabel="force, N")
    axes.legend()
