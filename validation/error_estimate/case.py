"""Estimated errors compared with those from meshes that are much finer."""

from collections.abc import Callable

import numpy as np

import quasiform as qf
from quasiform.model import Model

Scene = Callable[[float], Model]


def _oat(angle: float, displacement: float, **strip: float) -> Scene:
    return lambda size: qf.off_axis_tension(angle, displacement=displacement, size=size, **strip)


def _form(*scene: object, **given: float) -> Scene:
    return lambda size: qf.forming(*scene, size=size, **given)


SCENES = {  # scene, its size, that of the truth, mm
    "oat-45": (_oat(45, 45), 10.0, 1.25),
    "oat-37": (_oat(37, 10, length=300, width=120), 10.0, 1.25),
    "oat-30": (_oat(30, 12), 10.0, 1.25),
    "hemisphere-0": (_form("hemisphere"), 4.0, 1.6),
    "hemisphere-45": (_form("hemisphere", 45), 4.0, 1.6),
    "tetrahedron-0": (_form("tetrahedron"), 5.0, 2.0),
    # beyond 20 mm the box buckles, and its state is one of many
    "box-0 to 20 mm": (_form("box", travel=20), 4.0, 1.6),
    "box-45 to 20 mm": (_form("box", 45, travel=20), 4.0, 1.6),
}
LEAST = 1e-3  # of a value: a smaller true error is one of the solver, and its ratio means nothing


def values() -> dict[str, float]:
    """Quantities whose true error is within the estimate, and the ratios of both."""
    found, inside, ratios = {}, [], []
    for name, (scene, size, finer) in SCENES.items():
        run, true = qf.refine(scene(size)), qf.refine(scene(finer)).quantities
        errors = {key: abs(run.quantities[key] - true[key]) for key in run.estimate}
        within = [error <= run.estimate[key] for key, error in errors.items()]
        inside += within
        ratios += [
            run.estimate[key] / error
            for key, error in errors.items()
            if error > LEAST * abs(true[key])
        ]
        found[f"{name}: quantities outside the estimate"] = float(np.sum(~np.array(within)))
        for key, title in (("shear_angle_deg", "99th percentile"), ("force_N", "force")):
            found[f"{name}: {title}, true error"] = errors[key]
            found[f"{name}: {title}, estimate"] = run.estimate[key]
    found["quantities within the estimate, all scenes"] = 100 * float(np.mean(inside))
    found["median of estimate/true"] = float(np.median(ratios))
    found["largest of estimate/true"] = float(np.max(ratios))
    return found
