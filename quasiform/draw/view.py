"""An interactive picture of a sheet: turned, zoomed and probed in a browser, by plotly.

Every triangle has the colour of its shear angle, on the scale of `plot.py`; fibre lines and outline
lie on it. The pointer shows the angle, the place on the flat blank and the fibre strains of a
triangle. Plotly is needed (extra `report`); the page holds its script, so nothing is loaded.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import InputError
from ..net.blank import Blank
from ..result.run import Result
from ..result.saved import Saved
from .plot import AZIMUTH, COLLAPSED, COLOURS, ELEVATION, SCALES, fibre_lines

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

FloatArray = np.ndarray
IntArray = np.ndarray

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
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>
html, body {{ height: 100%; margin: 0; font: 15px/1.4 system-ui, sans-serif; color: #1a1a1a }}
body {{ display: flex; flex-direction: column }}
p {{ margin: .6rem 1rem }}
#sheet {{ flex: 1; min-height: 20rem }}
</style></head><body>
<p>{words}</p>
<div id="sheet"></div>
<p>Drag to turn, scroll to zoom, point at a triangle for its shear angle.</p>
<script>{script}</script>
<script>
const figure = {figure};
const config = {{displaylogo: false, responsive: true, showSendToCloud: false}};
Plotly.newPlot("sheet", figure.data, figure.layout, config);
</script>
</body></html>
"""


def available() -> bool:
    """Whether plotly is installed."""
    return find_spec("plotly") is not None


def figure(result: Result | Saved, state: int = -1) -> Figure:
    """Build the view of a sheet.

    Parameters
    ----------
    result : Result, or a run read back from its folder
    state : int
        Which increment; the last one by default.

    Returns
    -------
    plotly.graph_objects.Figure
        A `Mesh3d` whose cell intensity is |γ| in degrees and whose `customdata` are, by triangle, γ
        in degrees, X and Y of its middle on the flat blank in mm, E11 and E22; with collapsed
        triangles, fibre lines and the outline as traces of their own.

    Raises
    ------
    InputError
        If plotly is not installed.
    """
    if not available():
        raise InputError("the 3D view needs plotly: pip install 'quasiform[report]'")
    from plotly import graph_objects as go

    blank, x = result.blank, result.positions(state)
    fields, collapsed = result.cell_fields(state), result.doubts(state)["collapsed"]
    gamma = fields["shear_angle"]
    middle = blank.nodes[blank.triangles].mean(1)
    probed = np.column_stack([gamma, middle, fields["E11"], fields["E22"]]).astype(np.float32)
    up = -1.0 if _is_bowl(result, x) else 1.0
    largest = np.abs(gamma)[~collapsed].max(initial=0.0)
    sheet = go.Mesh3d(
        **_points(x),
        **dict(zip("ijk", blank.triangles.T.astype(np.int32), strict=True)),
        intensity=np.abs(gamma).astype(np.float32),
        intensitymode="cell",
        cmin=0,
        cmax=next((end for end in SCALES if end >= largest), SCALES[-1]),
        colorscale=_colours(),
        colorbar={"title": {"text": "|γ| in °", "side": "right"}, "thickness": 14, "len": 0.75},
        customdata=probed,
        hovertemplate=HOVER,
        flatshading=True,
        lighting=LIGHT,
        lightposition=LIGHT_FROM,
        name="sheet",
    )
    traces = [sheet]
    if collapsed.any():
        traces.append(
            go.Mesh3d(
                **_points(x),
                **dict(zip("ijk", blank.triangles[collapsed].T.astype(np.int32), strict=True)),
                color=COLLAPSED,
                hoverinfo="skip",
                name="collapsed",
                showlegend=True,
            )
        )
    extent = np.ptp(blank.nodes, axis=0).max()
    fibres = fibre_lines(blank, max(blank.size, extent / 20))
    outline = [np.append(loop, loop[0]) for loop in blank.outline]
    off = ABOVE * extent * _normals(blank, x)
    traces.append(_lines(go, x, off, fibres, "rgba(0,0,0,0.55)", 1.5, "fibres"))
    traces.append(_lines(go, x, 0.2 * off, outline, "#1a1a1a", 3, "outline"))
    low, high = x.min(0), x.max(0)
    half = 0.5 * (high - low) + 2 * ABOVE * extent
    ends = ((low + high) / 2 + half * [[-1.0], [1.0]]).T.tolist()
    ratio = half / half.max()
    return go.Figure(
        traces,
        {
            "template": "none",
            "margin": dict.fromkeys("lrbt", 0),
            "showlegend": bool(collapsed.any()),
            "legend": {"x": 0, "y": 0},
            "hoverlabel": {"bgcolor": "white", "font": {"color": "#1a1a1a"}},
            "scene": {
                "aspectmode": "manual",
                "aspectratio": dict(zip("xyz", (1.6 * ratio).tolist(), strict=True)),
                "camera": _camera(result.scene.dim == 2, up),
                "dragmode": "orbit",
                **{
                    f"{axis}axis": {"visible": False, "range": between}
                    for axis, between in zip("xyz", ends, strict=True)
                },
            },
        },
    )


def words(result: Result | Saved) -> str:
    """What is seen, in a line: scene, fabric, mesh, travel, shear angle, force, certificate."""
    scene, gamma, certified = result.scene, np.abs(result.shear_angle), result.certified
    return (
        f"{scene.name}, {scene.fabric.name}, {len(result.blank.triangles)} triangles: "
        f"{scene.travel_name.removesuffix('_mm').replace('_', ' ')} "
        f"{result.states[-1].travel:.4g} mm, largest |γ| {gamma.max():.1f}°, "
        f"force {result.force:.4g} N, "
        + ("certified" if certified is True else f"not certified: {certified}")
    )


def save(result: Result | Saved, path: str | Path, state: int = -1) -> Path:
    """Write the view as one HTML file that needs nothing else.

    Raises
    ------
    InputError
        If plotly is not installed, or the file cannot be written.
    """
    drawn = figure(result, state)
    from plotly.offline import get_plotlyjs

    page = PAGE.format(
        title=escape(result.scene.name),
        words=escape(words(result)),
        script=get_plotlyjs(),
        figure=drawn.to_json(),
    )
    try:
        Path(path).write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
    return Path(path)


def _points(x: FloatArray) -> dict[str, FloatArray]:
    return dict(zip("xyz", np.ascontiguousarray(x.T, dtype=np.float32), strict=True))


def _normals(blank: Blank, x: FloatArray) -> FloatArray:
    """(n_nodes, 3) unit normals, the mean of the triangles around a node."""
    corners = x[blank.triangles]
    of_triangles = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(x)
    np.add.at(normals, blank.triangles, of_triangles[:, None])
    return normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]


def _lines(
    go: Any,
    x: FloatArray,
    off: FloatArray,
    lines: Iterable[IntArray],
    colour: str,
    width: float,
    name: str,
) -> Any:
    """Lines of nodes as one trace with a gap after each: a copy on either face of the sheet."""
    gap = np.full((1, 3), np.nan)
    lines = list(lines)
    points = [p for side in (off, -off) for line in lines for p in (x[line] + side[line], gap)]
    return go.Scatter3d(
        **_points(np.vstack([gap, *points])),
        mode="lines",
        line={"color": colour, "width": width},
        hoverinfo="skip",
        showlegend=False,
        name=name,
    )


def _colours() -> list[tuple[float, str]]:
    """The colours of `plot.py`, whose darkest end is left out there too."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    places = np.linspace(0.0, 1.0, 33)
    return [
        (float(at), to_hex(colour))
        for at, colour in zip(places, colormaps[COLOURS](0.02 + 0.86 * places), strict=True)
    ]


def _is_bowl(result: Result | Saved, x: FloatArray) -> bool:
    """Whether tools have pushed the sheet below its rim: it is shown upside down, as a dome."""
    rim = np.concatenate(result.blank.outline)
    return bool(result.scene.contacts) and x[rim, 2].mean() > x[:, 2].mean()


def _camera(plane: bool, up: float) -> dict[str, Any]:
    """From slightly above as in `plot.py`, or straight onto a plane sheet; `up` is 1 or -1."""
    if plane:
        above, eye = (0.0, 1.0, 0.0), (0.0, 0.0, 1.7)
    else:
        ca, sa, ce, se = np.cos(AZIMUTH), np.sin(AZIMUTH), np.cos(ELEVATION), np.sin(ELEVATION)
        above, eye = (0.0, 0.0, up), 2.6 * np.array([ce * ca, ce * sa, up * se])
    return {
        "up": dict(zip("xyz", map(float, above), strict=True)),
        "eye": dict(zip("xyz", map(float, eye), strict=True)),
        # the near corner is the largest: it is to be seen in a square window too
        "center": {"x": 0.0, "y": 0.0, "z": 0.0 if plane else -0.15 * up},
    }
