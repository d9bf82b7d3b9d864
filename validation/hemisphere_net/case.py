"""Shear on the hemisphere compared with the exact inextensible net, in material coordinates."""

import numpy as np

import quasiform as qf
from quasiform import theory


def values() -> dict[str, float]:
    """Largest deviation on the bias line, colatitude to 60 degrees, at two sizes."""
    return {f"largest error on the bias line, size {size}": _deviation(size) for size in (10, 5)}


def _deviation(size: float) -> float:
    result = qf.solve(qf.forming("hemisphere", size=size), estimate=False)
    scene, blank = result.model, result.model.sheet.blank
    x = result.states[-1].x
    # the legs of a triangle give the fibre directions at their middles, and so the shear at the
    # middle of the hypotenuse to second order
    corners = blank.nodes[blank.triangles]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    n, k = np.arange(len(edges)), edges.argmax(1)
    a, b = (0.5 * (np.roll(corners, -1, axis=1) + np.roll(corners, 1, axis=1))[n, k]).T
    punch = scene.contacts[0]
    radius = punch.tool.shape.radius
    centre = x[punch.tool_dofs[0]] + radius
    place = scene.sheet.positions(x)[blank.triangles].mean(1)
    colatitude = np.degrees(np.arctan2(np.hypot(*place[:, :2].T), centre - place[:, 2]))
    touching = (punch.penetration(x) > 0)[blank.triangles].all(1)
    chosen = touching & (np.abs(a - b) < 1e-6) & (colatitude < 60)
    if colatitude[chosen].max() < 45:
        raise ValueError("the bias line is not in contact to 45 degrees")
    net = theory.hemisphere_net(a[chosen], b[chosen], radius + scene.sheet.fabric.thickness / 2)
    return np.abs(np.degrees(scene.membrane.shear_angle(x)[chosen] - net)).max()
