"""An interactive picture of a sheet: turned, zoomed and probed in a browser, by plotly.

The pointer shows the angle, the place on the flat blank and the fibre strains of a triangle. Plotly
and jinja2 are needed (extra `report`). The page has a choice of fields, a slider over the travel
and the tools; it holds its script and its numbers, compressed, so nothing is loaded.
"""

from __future__ import annotations

import base64
import gzip
import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_hex

from ..checks import InputError
from ..result.files import writing_to
from ..result.plies import apart, numbers_of
from ..result.record import Record
from ..result.sheet import FormedSheet
from . import plot
from .overlay import tool_faces

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

FloatArray = np.ndarray
PAGE = Path(__file__).with_suffix(".html")

HOVER = (
    "<b>γ = %{customdata[0]:.1f}°</b><br>"
    "X = %{customdata[1]:.1f}, Y = %{customdata[2]:.1f} mm on the flat blank<br>"
    "E11 = %{customdata[3]:.1e}, E22 = %{customdata[4]:.1e}<extra></extra>"
)
AXIS = {"showbackground": False, "gridcolor": "#e4e4e4", "zeroline": False, "nticks": 5}
AXIS |= {"tickfont": {"size": 10}, "showspikes": False}
BUDGET = 2_300_000  # bytes of numbers in a page, before they are compressed
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
    """Equal scales along all axes around the sheet with some room, mm."""
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
        shown = {"range": between, "visible": axis != "z" or not run.in_plane}
        scene[f"{axis}axis"] = AXIS | {"title": {"text": f"{axis} in mm"}} | shown
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
    case = ", ".join(filter(None, (run.case, run.ply_name, run.fabric_name)))
    return (
        f"{case}, {len(run.sheet.triangles)} triangles: "
        f"{plot.travel_of(run)}, largest |γ| {np.abs(run.sheet.shear_angle).max():.1f}°, "
        f"force {run.force:.4g} {run.force_unit}, {plot.verdict(run)}"
    )


def save(run: Record, path: str | Path) -> Path:
    """Write the view as one HTML file that needs nothing else."""
    drawn = figure(run)
    from jinja2 import Environment
    from plotly.offline import get_plotlyjs

    numbers = _Numbers()
    content = _content(run, numbers)
    low, high = content["low"], content["high"]
    half = 0.5 * np.subtract(high, low) + 0.01
    drawn.layout.scene.aspectratio = dict(zip("xyz", 1.6 * half / half.max(), strict=True))
    for axis, *between in zip("xyz", low, high, strict=True):
        drawn.layout.scene[f"{axis}axis"].range = between
    for trace in drawn.data:  # the numbers of all states are in the block
        trace.update(dict.fromkeys("xyz"))
    drawn.data[0].update(dict.fromkeys(("i", "j", "k", "intensity", "customdata")))
    page = Environment(autoescape=True).from_string(PAGE.read_text(encoding="utf-8"))
    parts = {"title": run.case, "words": words(run), "figure": drawn.to_json()}
    parts |= {"content": content, "numbers": numbers.packed(), "tools": content["tools"]}
    text = page.render(**parts, script=_packed(get_plotlyjs().encode()))
    path = Path(path)
    with writing_to(path):
        path.write_text(text, encoding="utf-8")
    return path


class _Numbers:
    """Arrays in one block: whole numbers in four bytes, others between two bounds in two."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self.size = 0

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Append an array; returns where it is, and how its numbers are read."""
        flat = np.ravel(values)
        entry: dict[str, Any] = {"at": self.size, "n": len(flat)}
        if flat.dtype.kind in "iu":
            part = flat.astype("<i4").tobytes()
        else:
            known = flat[np.isfinite(flat)]
            low, high = (float(f(known)) if len(known) else 0.0 for f in (np.min, np.max))
            step = max(high - low, 1e-12) / 65534
            levels = np.where(np.isfinite(flat), np.round((flat - low) / step), 65535)
            part = levels.astype("<u2").tobytes() + b"\0\0" * (len(flat) % 2)
            entry |= {"low": low, "step": step}
        self._parts.append(part)
        self.size += len(part)
        return entry

    def packed(self) -> str:
        """Return the block, compressed."""
        return _packed(b"".join(self._parts))


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()


def _content(run: Record, numbers: _Numbers) -> dict[str, Any]:
    """What the page draws besides the last sheet: states, fields and tools."""
    chosen = _chosen(run)
    meshes: list[dict[str, Any]] = []
    states, seen, last = [], [], None
    ranges: dict[str, list[float]] = {}
    shown = run.plies if run.ply == 0 else [run]
    weights = np.array([ply.fabric.get("areal_weight", np.nan) for ply in shown])
    for k in chosen:
        sheet = run.sheets[k]
        if last is None or not np.array_equal(sheet.triangles, last):
            last = sheet.triangles
            meshes.append(_mesh(sheet, numbers))
        found = _fields(run, sheet, weights)
        for name, values in found.items():
            known = values[np.isfinite(values)]
            ends = [*ranges.get(name, []), known.min(), np.quantile(known, 0.998)]
            ranges[name] = [float(min(ends)), float(max(ends))]
        fields = {name: numbers.add(values) for name, values in found.items()}
        points = {"x": numbers.add(sheet.points), "fields": fields, "mesh": len(meshes) - 1}
        states.append(points | {"travel": float(run.sheets.travels[k])})
        seen += [sheet.points.min(0), sheet.points.max(0)]
    ranges["shear"] = [0.0, plot.scale_end([run.sheet])]
    tools = []
    for tool, x, y, z in tool_faces(run):
        corners = np.stack([*np.meshgrid(x, y), z], axis=-1)
        moved = [tool.moved(state["travel"]) for state in states]
        tools.append({"name": tool.name, "moved": moved, "z": numbers.add(z)})
        tools[-1] |= {"x": x.tolist(), "y": y.tolist()}
        seen += [np.nanmin(corners, (0, 1)), np.nanmax(corners, (0, 1))]
    room = 4 * ABOVE * plot.extent(run.sheet)
    return {
        "low": (np.min(seen, axis=0) - room).tolist(),
        "high": (np.max(seen, axis=0) + room).tolist(),
        "states": states,
        "meshes": meshes,
        "tools": tools,
        "ranges": ranges,
        "travel": "load factor" if run.force_unit == "mJ" else plot.words_of(run)[0],
        "unit": " mm" if run.force_unit == "N" else "",
        "above": ABOVE * plot.extent(run.sheet),
        "plies": len(shown),
        "fields": [(name, *words) for name in ranges if (words := _named(name))],
        "doubts": [(colour, words) for colour, words, _ in plot.limits_of(run).values()],
    }


def _named(field: str) -> tuple[str, str]:
    """Name and unit of a field in the choice of the page."""
    if pair := re.fullmatch(r"slip_(\d+)_(\d+)", field):
        return f"slip between plies {pair[1]} and {pair[2]}", "mm"
    return FIELDS[field]


FIELDS = {  # in the choice of the page: name and unit
    "shear": ("shear angle |γ|", "°"),
    "weight": ("areal weight", "g/m²"),
    "warp": ("warp direction from x, seen along z", "°"),
    "weft": ("weft direction from x, seen along z", "°"),
    "pressure": ("contact pressure", "MPa"),
    "slip_warp": ("slip of the warp along itself", "mm"),
    "slip_weft": ("slip of the weft along itself", "mm"),
    "E22_warp_layer": ("E22 of the warp layer: gaps where positive", ""),
    "E11_weft_layer": ("E11 of the weft layer: gaps where positive", ""),
    "stack_thickness": ("thickness of the plies that lie on each other", "mm"),
    "error": ("mesh error of the shear angle", "°"),
    "limit": ("limits of the shear angle", ""),
}


def _chosen(run: Record) -> list[int]:
    """Numbers of the sheets of the page: as many as it can hold, evenly, with both ends."""
    bytes_each = 2 * (3 * len(run.sheet.points) + 7 * len(run.sheet.triangles))
    count = int(np.clip(BUDGET // bytes_each, 2, len(run.sheets)))
    return sorted({round(k) for k in np.linspace(0, len(run.sheets) - 1, count)})


def _mesh(sheet: FormedSheet, numbers: _Numbers) -> dict[str, Any]:
    """Triangles, the flat places of their middles, and lines of nodes of each ply, gaps of -1."""
    lines: dict[str, list[Any]] = {"fibres": [], "outline": []}
    for nodes, ply in apart(sheet):
        for name, found in (("fibres", plot.shown_fibres(ply)), ("outline", ply.loops)):
            parts = [part for line in found for part in (nodes[line], [-1])]
            lines[name].append(numbers.add(np.concatenate([np.empty(0, dtype=int), *parts])))
    return {
        "triangles": numbers.add(sheet.triangles.T),
        "flat": numbers.add(sheet.flat[sheet.triangles].mean(1)),
        "ply": numbers.add(numbers_of(sheet).astype(int)),
        "lines": lines,
    }


def _fields(run: Record, sheet: FormedSheet, weights: FloatArray) -> dict[str, FloatArray]:
    """Fields by triangle that the sheet has, by name; the shear angle is signed.

    `weights` (n_plies,) are those of the flat fabrics, g/m².
    """
    cells, corners = sheet.cell_fields, sheet.triangles
    found = {"shear": sheet.shear_angle}
    number = numbers_of(sheet).astype(int) - 1 if len(weights) > 1 else 0
    if np.isfinite(weights).all() and weights.all():
        found["weight"] = weights[number] / np.maximum(sheet.area_ratio, 1e-6)
    for name in ("warp", "weft"):
        found[name] = np.degrees(np.arctan2(cells[name][:, 1], cells[name][:, 0]))
    if run.has_tools and "contact_pressure" in sheet.point_fields:
        found["pressure"] = np.ravel(sheet.point_fields["contact_pressure"])[corners].mean(1)
    if "shear_angle_error" in cells:
        found["error"] = np.ravel(cells["shear_angle_error"])
    for name, values in sheet.point_fields.items():
        if name == "stack_thickness" or name.startswith("slip_"):
            found[name] = np.ravel(values)[corners].mean(1)
    for name in ("E22_warp_layer", "E11_weft_layer"):
        if name in cells:
            found[name] = np.ravel(cells[name])
    doubts = sheet.doubts()
    found["limit"] = np.zeros(len(corners))
    for k, name in enumerate(plot.DOUBTS, 1):
        found["limit"][doubts[name]] = k
    return found


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
