"""An interactive picture of a sheet: turned, zoomed and probed in a browser, by plotly.

The pointer shows the angle, the place on the flat blank and the fibre strains of a triangle. Plotly
and jinja2 are needed (extra `report`); the page holds its script, so nothing is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_hex

from ..checks import InputError
from ..result.files import writing_to
from ..result.record import Record
from . import plot

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

FloatArray = np.ndarray
PAGE = Path(__file__).with_suffix(".html")

HOVER = (
    "<b>γ = %{customdata[0]:.1f}°</b><br>"
    "X = %{customdata[1]:.1f}, Y = %{customdata[2]:.1f} mm on the flat blank<br>"
    "E11 = %{customdata[3]:.1e}, E22 = %{customdata[4]:.1e}<extra></extra>"
)
ABOVE = 0.006  # of the extent: how far lines lie off the sheet, to be seen on it
LIGHT_FROM = {"x": -3e4, "y": -6e4, "z": -1e5}  # plotly lights the seen face from behind it
LIGHT = {
    "ambient": 0.7,
    "diffuse": 0.35,
    "specular": 0.0,
    "fresnel": 0.0,
    "facenormalsepsilon": 0.0,  # else plotly takes slim triangles for degenerate: black
}


def available() -> bool:
    """Whether plotly is installed."""
    return find_spec("plotly") is not None


def figure(run: Record) -> Figure:
    """View of the last sheet of a run (`Record.upto` chooses another), as a figure of plotly.

    Its `Mesh3d` has |γ| in degrees as cell intensity; `customdata` are, by triangle, γ in degrees,
    X and Y of its middle on the flat blank in mm, E11 and E22. Collapsed triangles, fibre lines and
    the outline are traces of their own.
    """
    if not available():
        raise InputError("the 3D view needs plotly: pip install 'quasiform[report]'")
    from plotly import graph_objects as go

    sheet, fields = run.sheet, run.sheet.cell_fields
    x, gamma = sheet.points, sheet.shear_angle
    middle = sheet.flat[sheet.triangles].mean(1)
    strains = np.column_stack([np.ravel(fields[name]) for name in ("E11", "E22")])
    mesh = go.Mesh3d(
        **_points(x),
        **_corners(sheet.triangles),
        intensity=np.abs(gamma).astype(np.float32),
        intensitymode="cell",
        cmin=0,
        cmax=plot.scale_end([sheet]),
        colorscale=[(k / 32, to_hex(shade)) for k, shade in enumerate(plot.shades(33))],
        colorbar={"title": {"text": "|γ| in °", "side": "right"}, "thickness": 14, "len": 0.75},
        customdata=np.column_stack([gamma, middle, strains]).astype(np.float32),
        hovertemplate=HOVER,
        flatshading=True,
        lighting=LIGHT,
        lightposition=LIGHT_FROM,
        name="sheet",
    )
    traces, failed = [mesh], sheet.doubts()["collapsed"]
    if failed.any():
        look = {"color": plot.COLLAPSED, "hoverinfo": "skip", "showlegend": True}
        faces = _corners(sheet.triangles[failed])
        traces.append(go.Mesh3d(**_points(x), **faces, name="collapsed", **look))
    extent = plot.extent(sheet)
    normals = plot.node_normals(sheet.triangles, x)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    off = ABOVE * extent * normals
    look = {"mode": "lines", "hoverinfo": "skip", "showlegend": False}
    for name, lines, height, line in (
        ("fibres", plot.shown_fibres(sheet), off, {"color": "rgba(0,0,0,0.55)", "width": 1.5}),
        ("outline", sheet.loops, 0.2 * off, {"color": "#1a1a1a", "width": 3}),
    ):
        traces.append(go.Scatter3d(**_along(x, height, lines), name=name, line=line, **look))
    return go.Figure(traces, _layout(run, 2 * ABOVE * extent, legend=bool(failed.any())))


def _layout(run: Record, room: float, *, legend: bool) -> dict[str, Any]:
    """Equal scales along all axes around the sheet with some room, mm, and no axes."""
    low, high = run.sheet.points.min(0), run.sheet.points.max(0)
    half = 0.5 * (high - low) + room
    ends = ((low + high) / 2 + half * [[-1.0], [1.0]]).T.tolist()
    scene = {
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", (1.6 * half / half.max()).tolist(), strict=True)),
        "camera": _camera(run),
        "dragmode": "orbit",
    }
    for axis, between in zip("xyz", ends, strict=True):
        scene[f"{axis}axis"] = {"visible": False, "range": between}
    return {
        "template": "none",
        "margin": dict.fromkeys("lrbt", 0),
        "showlegend": legend,
        "legend": {"x": 0, "y": 0},
        "hoverlabel": {"bgcolor": "white", "font": {"color": "#1a1a1a"}},
        "scene": scene,
    }


def words(run: Record) -> str:
    """What is seen, in a line: case, fabric, mesh, travel, shear angle, force, verdict."""
    return (
        f"{run.case}, {run.fabric_name}, {len(run.sheet.triangles)} triangles: "
        f"{plot.travel_of(run)}, largest |γ| {np.abs(run.sheet.shear_angle).max():.1f}°, "
        f"force {run.force:.4g} {run.force_unit}, {plot.verdict(run)}"
    )


def save(run: Record, path: str | Path) -> Path:
    """Write the view as one HTML file that needs nothing else."""
    drawn = figure(run)
    from jinja2 import Environment
    from plotly.offline import get_plotlyjs

    page = Environment(autoescape=True).from_string(PAGE.read_text(encoding="utf-8"))
    parts = {"title": run.case, "words": words(run), "figure": drawn.to_json()}
    text = page.render(**parts, script=get_plotlyjs())
    path = Path(path)
    with writing_to(path):
        path.write_text(text, encoding="utf-8")
    return path


def _points(x: FloatArray) -> dict[str, FloatArray]:
    return dict(zip("xyz", np.ascontiguousarray(x.T, dtype=np.float32), strict=True))


def _corners(triangles: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip("ijk", triangles.T.astype(np.int32), strict=True))


def _along(x: FloatArray, off: FloatArray, lines: Sequence[np.ndarray]) -> dict[str, FloatArray]:
    """Points of lines of nodes with a gap after each: a copy on either face of the sheet."""
    gap = np.full((1, 3), np.nan)
    points = [p for side in (off, -off) for line in lines for p in (x[line] + side[line], gap)]
    return _points(np.vstack([gap, *points]))


def _camera(run: Record) -> dict[str, Any]:
    """From slightly above as in `plot.py` (a bowl from below), or straight onto a plane sheet."""
    up, eye, low = [0.0, 1.0, 0.0], np.array([0.0, 0.0, 1.7]), 0.0
    if not run.in_plane:
        sign = -1.0 if plot.is_bowl(run) else 1.0
        eye = 2.6 * plot.view_from(turned_over=False)[2] * [1.0, 1.0, sign]
        up, low = [0.0, 0.0, sign], -0.15 * sign
    # the near corner is the largest: it is to be seen in a square window too
    found = {"up": up, "eye": eye.tolist(), "center": [0.0, 0.0, low]}
    return {name: dict(zip("xyz", p, strict=True)) for name, p in found.items()}
