"""Estimated errors compared with those from meshes two or four times as fine."""

import numpy as np

import quasiform as qf

SCENES = {
    "oat-45": (lambda size: qf.off_axis_tension(45, displacement=45, size=size), 10.0, 2.5),
    "oat-30": (lambda size: qf.off_axis_tension(30, displacement=12, size=size), 10.0, 2.5),
    "hemisphere-0": (lambda size: qf.forming("hemisphere", size=size), 5.0, 2.5),
    "hemisphere-45": (lambda size: qf.forming("hemisphere", 45, size=size), 5.0, 2.5),
    "tetrahedron-0": (lambda size: qf.forming("tetrahedron", size=size), 5.0, 2.5),
    # beyond 20 mm the box buckles, and its state is one of many
    "box-0 to 20 mm": (lambda size: qf.forming("box", size=size, travel=20), 5.0, 2.5),
    "box-45 to 20 mm": (lambda size: qf.forming("box", 45, size=size, travel=20), 5.0, 2.5),
}


def values() -> dict[str, float]:
    """Quantities whose true error is within the estimate, and the errors of p99 and force."""
    found, inside = {}, []
    for name, (scene, size, finer) in SCENES.items():
        run, true = qf.refine(scene(size)), qf.refine(scene(finer)).quantities
        errors = {key: abs(run.quantities[key] - true[key]) for key in run.estimate}
        within = [error <= run.estimate[key] for key, error in errors.items()]
        inside += within
        found[f"{name}: quantities within the estimate"] = 100 * float(np.mean(within))
        for key, title in (("shear_angle_deg", "99th percentile"), ("force_N", "force")):
            found[f"{name}: {title}, true error"] = errors[key]
            found[f"{name}: {title}, estimate"] = run.estimate[key]
    found["quantities within the estimate, all scenes"] = 100 * float(np.mean(inside))
    return found
