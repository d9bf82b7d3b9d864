"""Picture of a comparison, seen along z: shear angles, their difference, outlines; forces.

Each sheet is drawn on its own shape, the difference on that of which it has the points.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..draw.plot import COLOURS, DPI, FIRST, SCALES, SECOND, WIDTH, page_style
from .mapping import ANGLE, SIDES
from .place import rim

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..result.sheet import FormedSheet

    Sheets = tuple[FormedSheet, FormedSheet]
    Fields = dict[str, tuple[FormedSheet, np.ndarray]]

FloatArray = np.ndarray
LINES = (
    {"color": FIRST, "label": "result"},
    {"color": SECOND, "label": "reference", "linestyle": "--"},
)
TITLES = {
    "outlines": "outlines",
    "difference": "difference: result - reference,\non the {on}'s shape",
}


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
    from matplotlib.figure import Figure

    fields = fields_of(sheets, field, gamma)
    panels = list(fields) or ["outlines"]
    angle = "γ" if any(np.nanmin(fields[side][1]) < 0 for side in SIDES if fields) else "|γ|"
    panels += ["force"] if forces is not None and forces.shape[1] > 1 else []
    with page_style():
        columns = min(len(panels), 2)
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(WIDTH, 2.9 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        seen = [s.places[:, :2] if s.contour is None else s.contour[:, :2] for s in sheets]
        low, high = np.min([p.min(0) for p in seen], 0), np.max([p.max(0) for p in seen], 0)
        margin = 0.04 * (high - low).max()
        (left, bottom), (right, top) = low - margin, high + margin
        for axes, panel in zip(grid, panels, strict=False):
            if panel == "force":
                for values, style in zip(forces[1:], LINES, strict=True):
                    axes.plot(forces[0], values, **style)
                axes.set(xlabel="travel in mm", ylabel="force in N")
                axes.legend()
                continue
            if panel in fields:
                _field(figure, axes, panel, fields, locking)
            _outlines(axes, sheets, panel)
            flat = panel in fields and fields[panel][0].points is None
            title = TITLES.get(panel, angle + " of the {panel}") + ", on the flat blank" * flat
            on = SIDES[field is not sheets[0]]
            axes.set_title(title.format(panel=panel, on=on), parse_math=False)
            axes.set(aspect="equal", xlim=(left, right), ylim=(bottom, top))
            axes.set(xlabel="x in mm", ylabel="y in mm")
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


def _field(
    figure: Figure, axes: Axes, panel: str, fields: Fields, locking: tuple[float, ...]
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
    what = "difference" if panel == "difference" else "shear angle"
    bar = figure.colorbar(colours, ax=axes, shrink=0.8, label=f"{what} in °")
    if panel == "difference":
        return
    angles = sorted({round(angle, 3) for angle in locking if angle <= scale["vmax"]})
    for angle in angles:
        bar.ax.axhline(angle, color="black", linewidth=2.4)
        bar.ax.axhline(angle, color="white", linewidth=1.0)
    if angles:
        bar.ax.set_title(f"locking {' and '.join(f'{a:.0f}°' for a in angles)}", fontsize=7)


def _outlines(axes: Axes, sheets: Sheets, panel: str) -> None:
    for sheet, style in zip(sheets, LINES, strict=True):
        line = rim(sheet)
        if line is not None and panel in (style["label"], "difference", "outlines"):
            axes.plot(*line.xy, **style | {"linestyle": "-", "linewidth": 0.7})
    if panel in ("outlines", "difference") and axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
