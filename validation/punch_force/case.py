"""Punch force along the whole travel, compared with that on a mesh of half the size."""

import matplotlib.pyplot as plt
import numpy as np

import quasiform as qf
from validation.run import Outcome

SCENES = {"hemisphere 0°": ("hemisphere", None), "box 0° to 20 mm": ("box", 20.0)}
FINE, ROWS = 2.5, 2.5  # mm


def run(quick: bool) -> Outcome:
    """Largest difference in % of the end force, falls of the force, and its error bar."""
    values, figures = {}, {}
    for name, (scene, travel) in SCENES.items():
        given = {} if travel is None else {"travel": travel}
        own = qf.solve(qf.forming(scene, **given), increment=ROWS)
        fine = qf.solve(qf.forming(scene, size=FINE, **given), increment=ROWS, estimate=False)
        s, force = own.history["travel_mm"], own.history["force_N"]
        true = np.interp(s, fine.history["travel_mm"], fine.history["force_N"])
        error, bar = np.abs(force - true), own.history["force_error_N"]
        values[f"{name}: largest difference"] = 100 * error.max() / true[-1]
        falls = (np.diff(force) < 0) & (np.diff(true) >= 0)
        values[f"{name}: increments in which it falls and the finer one does not"] = falls.sum()
        values[f"{name}: rows within their error bar"] = 100 * np.mean(error <= bar + 1e-9)
        figure, axes = plt.subplots(figsize=(5, 3.4), layout="constrained")
        axes.fill_between(s, force - bar, force + bar, alpha=0.2, linewidth=0, label="error bar")
        axes.plot(s, force, "o-", markersize=3, label=f"{own.model.size:g} mm, the default")
        axes.plot(s, true, "k--", label=f"{FINE:g} mm")
        axes.set(xlabel="travel in mm", ylabel="punch force in N", title=name)
        axes.legend(frameon=False)
        figures[name] = figure
    return Outcome(values=values, figures=figures)
