"""Rovings that slip: strips predicted from strips, and the sign and place of gaps in MD600."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import quasiform as qf
from quasiform import theory
from quasiform.draw.plot import FIRST, SECOND, STYLE, WIDTH
from validation.run import Outcome

FOLDER = Path(__file__).parent
CELLS = 12  # over the width of a strip
SHORT, LONG = np.arange(5.0, 46.0, 5.0), np.arange(10.0, 101.0, 10.0)  # mm
TWILL = np.arange(10.0, 51.0, 10.0)
MD600 = qf.Slip(resistance=0.003, stiffness=0.005, pitch=5.0)  # assumed: nothing is published
History = dict[str, np.ndarray]


def run(quick: bool) -> Outcome:
    """Forces and angles of strips with and without slip; MD600 with assumed slip."""
    found, drawn = {}, {}
    for words, file in (("", "insa-plain"), (" without slip", "insa-plain-no-slip")):
        long = _strip(file, 450.0, 150.0, 106.0)
        short = _strip(file, 230.0, 115.0, 45.0)
        drawn[file] = long, short
        for u in LONG:
            found[f"INSA 150 x 450 fitted{words}: force u={u:g}"] = _at(u, long, "force_N")
            angle = _at(u, long, "shear_angle_center_deg")
            found[f"INSA 150 x 450 fitted{words}: centre angle u={u:g}"] = angle
        for u in SHORT:
            found[f"INSA 115 x 230 predicted{words}: force u={u:g}"] = _at(u, short, "force_N")
    twill = _strip("un-twill", 300.0, 100.0, 50.0)
    for u in TWILL:
        found[f"UN twill 100 x 300 predicted: force u={u:g}"] = _at(u, twill, "force_N")
    found |= _md600() | _no_slip()
    figure = _figure(drawn)
    return Outcome(found, {"Strips of INSA: 150 × 450 mm fitted, 115 × 230 mm predicted": figure})


def _strip(file: str, length: float, width: float, displacement: float) -> History:
    fabric = qf.Fabric.load(FOLDER / f"{file}.toml")
    model = qf.off_axis_tension(45.0, fabric, length, width, displacement, width / CELLS)
    return qf.solve(model, increment=2.5, estimate=False).history


def _at(u: float, history: History, name: str) -> float:
    return float(np.interp(u, history["displacement_mm"], history[name], right=np.nan))


def _md600() -> dict[str, float]:
    """What the paper says of MD600, as signs: strains between rovings, collapse, force."""
    best = replace(qf.Fabric.preset("best-fit"), in_plane_bending=0.0, slip=MD600)
    found = {}
    along = qf.solve(qf.off_axis_tension(45.0, best, displacement=65.0), estimate=False)
    E22 = along.sheet.cell_fields["E22_warp_layer"]
    net = theory.OffAxisTension(320.0, 160.0, np.pi / 4)
    blank = along.model.sheet.blank
    s, t = blank.centroids @ blank.warp, blank.centroids @ blank.weft
    half = (320.0 - 160.0) / np.sqrt(2.0) / 2  # of the full zone, a square
    off = np.maximum(np.abs(s), np.abs(t)) - half
    edges = np.abs(off) < 10.0
    found["MD600 45 deg u=65: E22 along the edges of the shear zone, 95th percentile"] = float(
        np.quantile(E22[edges], 0.95)
    )
    found["MD600 45 deg u=65: E22 in the centre"] = along.history["E22_warp_layer_center"][-1]
    ideal = float(net.force(np.array([60.0]), best.shear.stress, best.thickness)[0])
    found["MD600 45 deg u=60: force over that of pure shear"] = (
        _at(60.0, along.history, "force_N") / ideal
    )
    across = qf.solve(qf.off_axis_tension(30.0, best, displacement=80.0), estimate=False)
    found["MD600 30 deg u=25: E22 in the centre"] = _at(
        25.0, across.history, "E22_warp_layer_center"
    )
    found["MD600 30 deg: largest shear angle to 80 mm"] = float(
        across.history["shear_angle_max_deg"].max()
    )
    found["MD600 30 deg: displacement reached"] = across.states[-1].travel
    for angle, u, result in ((45.0, 65.0, along), (30.0, 25.0, across)):
        fine = qf.solve(qf.off_axis_tension(angle, best, displacement=u, size=5.0), estimate=False)
        off = _at(u, result.history, "force_N") / fine.force - 1.0
        found[f"MD600 {angle:g} deg u={u:g}: force, size 10 over size 5"] = 100.0 * off
    return found


def _no_slip() -> dict[str, float]:
    """Endless stiffness and resistance against no slip at all."""
    plain = replace(qf.Fabric.preset("locking"), in_plane_bending=0.0)
    stiff = replace(plain, slip=qf.Slip(np.inf, 1e4, 5.0))
    forces = [
        qf.solve(qf.off_axis_tension(45.0, f, displacement=30.0), estimate=False, tolerance=1e-7)
        for f in (plain, stiff)
    ]
    return {"endless resistance: force over that without slip": forces[1].force / forces[0].force}


def _figure(drawn: dict[str, tuple[History, History]]) -> Figure:
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
        panels = figure.subplots(1, 3)
        looks = {"insa-plain": (FIRST, "-", "with slip")}
        looks["insa-plain-no-slip"] = (SECOND, "--", "without slip")
        long, short = (
            np.loadtxt(FOLDER / f"insa-{name}.csv", delimiter=",", skiprows=1).T
            for name in ("150x450", "115x230")
        )
        for axes, points, k, column in (
            (panels[0], long[:2], 0, "force_N"),
            (panels[1], long[[0, 2]], 0, "shear_angle_center_deg"),
            (panels[2], short[:2], 1, "force_N"),
        ):
            axes.plot(*points, "ko", markersize=2, label="measured")
            for file, (colour, style, label) in looks.items():
                history = drawn[file][k]
                given = {"color": colour, "linestyle": style, "label": label}
                axes.plot(history["displacement_mm"], history[column], **given)
            axes.set_xlabel("displacement in mm")
        panels[0].set(ylabel="force in N", title="150 × 450 mm, fitted")
        panels[1].set(ylabel="centre angle in °", title="150 × 450 mm, fitted")
        panels[2].set(ylabel="force in N", title="115 × 230 mm, predicted")
        panels[0].legend(loc="upper left")
    return figure
