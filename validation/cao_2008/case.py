"""A law from picture-frame data predicts the force of a bias-extension test: measured data."""

from pathlib import Path

import numpy as np

import quasiform as qf
from quasiform import theory

FRAME = Path(__file__).with_name("picture_frame.csv")
LENGTH, WIDTH, THICKNESS = 230.0, 115.0, 1.2


def values() -> dict[str, float]:
    """Forces of the bias-extension test by the power balance and by finite elements."""
    found = {}
    strip = theory.OffAxisTension(LENGTH, WIDTH, np.pi / 4)
    for method in ("table", "fit"):
        identified = qf.identify(FRAME, kind="picture-frame", thickness=THICKNESS, method=method)
        fabric = identified.fabric
        found[f"misfit of the frame, {method}"] = fabric.provenance["force_misfit_percent"]
        scene = qf.off_axis_tension(45, fabric, LENGTH, WIDTH, displacement=30.0, size=5.0)
        history = qf.solve(scene, estimate=False).history
        for u in (20.0, 25.0, 30.0):
            force = strip.force(u, fabric.shear.stress, THICKNESS)
            found[f"force u={u:g}, {method}, power balance"] = float(force)
            row = np.argmin(np.abs(history["displacement_mm"] - u))
            found[f"force u={u:g}, {method}, elements"] = history["force_N"][row]
    return found
