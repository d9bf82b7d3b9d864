"""Moment over curvature of the model compared with a measured fabric whose bending softens."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import quasiform as qf
from quasiform.draw.plot import FIRST, SECOND, STYLE, WIDTH
from quasiform.energy.bending import Bending
from quasiform.energy.membrane import Membrane
from quasiform.energy.softening import bending_terms
from quasiform.identification.moment import read_moments
from quasiform.unknowns import Unknowns
from validation.run import Outcome

B0 = 119.2  # N mm, measured to a curvature of 2.39 1/m
FILE = Path(__file__).with_name("moment.csv")
MEASURED = np.loadtxt(FILE, delimiter=",", skiprows=1)
LENGTH, STRIP, SIZE = 60.0, 20.0, 2.5


def run(quick: bool) -> Outcome:
    """Moments per width at the measured curvatures, and their deviations."""
    found, most = {}, 1e-3 * float(MEASURED[-1, 0])
    linear = qf.Fabric(name="binder-stabilised fabric", bending_warp=B0, bending_weft=B0)
    curve = read_moments(FILE)
    soft = replace(linear, bending_warp=curve.initial, moment_warp=curve)
    curvature, moment = _bent(linear, most)
    softer = _bent(soft, most)
    for kappa, measured in MEASURED:
        value = float(np.interp(kappa, curvature, moment))
        found[f"moment at {kappa:g} 1/m"] = value
        found[f"over-prediction at {kappa:g} 1/m"] = 100 * (value / measured - 1)
        found[f"moment with moment_warp at {kappa:g} 1/m"] = float(np.interp(kappa, *softer))
    formed = qf.solve(qf.forming("hemisphere", size=10), estimate=False)
    sharpest = 1e3 * formed.wrinkles["largest_curvature_1_per_mm"]
    found["largest curvature in the hemisphere test"] = sharpest
    return Outcome(
        found,
        {
            "Moment per width over curvature, measured by Broberg et al. (2024)": _figure(
                curvature, moment, softer
            )
        },
        notes=[
            f"The hemisphere test bends its sheet to {sharpest:.0f} 1/m, far beyond where "
            "this fabric bends linearly: a stiffness from small curvatures is too high there."
        ],
    )


def _bent(fabric: qf.Fabric, most: float) -> tuple[np.ndarray, np.ndarray]:
    """Curvature (1/m) and moment per width (N) of a strip whose ends rotate against each other.

    The nodes of the first and last segments follow a regular polygon of chords h and turns κ h;
    with κ as the travel the driving force is the moment times width and bent length.
    """
    blank = qf.rectangle(LENGTH, STRIP, SIZE)
    n = len(blank.nodes)
    segments = round(LENGTH / SIZE)
    column = np.rint((blank.nodes[:, 0] + LENGTH / 2) / SIZE).astype(int)
    driven = (column <= 1) | (column >= segments - 1)

    def place(kappa: float) -> np.ndarray:
        turn = kappa * SIZE * (np.arange(segments) - (segments - 1) / 2)
        x = np.concatenate([[0.0], np.cumsum(SIZE * np.cos(turn))])
        z = np.concatenate([[0.0], np.cumsum(SIZE * np.sin(turn))])
        x, z = x - x.mean(), z - z.mean()
        return np.column_stack([x[column], blank.nodes[:, 1], z[column]]).ravel()

    def drive(kappa: float) -> tuple[np.ndarray, np.ndarray]:
        return place(kappa), (place(kappa + 1e-6) - place(kappa - 1e-6)) / 2e-6

    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    scene = qf.Model(
        name="bent strip",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), *bending_terms(Bending(sheet))],
        x0=np.column_stack([blank.nodes, np.zeros(n)]).ravel(),
        fixed=np.repeat(driven, 3),
        drive=drive,
        travel=most,
        increment=most / 40,
        rows=most / 40,
    )
    result = qf.solve(scene, estimate=False)
    kappa = np.array([state.travel for state in result.states])
    work = np.array([state.force for state in result.states])
    return 1e3 * kappa, work / (STRIP * (LENGTH - SIZE))


def _figure(curvature: np.ndarray, moment: np.ndarray, softer: tuple[np.ndarray, ...]) -> Figure:
    with rc_context(STYLE):
        figure = Figure(figsize=(0.6 * WIDTH, 2.8), layout="constrained")
        axes = figure.subplots()
        axes.plot(curvature, moment, color=FIRST, label="model with B0")
        axes.plot(*softer, color=SECOND, label="model with moment_warp")
        axes.plot(*np.vstack([[0.0, 0.0], MEASURED]).T, "k:", linewidth=0.8)
        axes.plot(*MEASURED.T, "ko", markersize=3, label="measured")
        axes.axvspan(MEASURED[0, 0], curvature[-1], color="0.93", zorder=-1)
        axes.set(xlabel="curvature in 1/m", ylabel="moment per width in N", ylim=(0, None))
        axes.legend(loc="upper left")
    return figure
