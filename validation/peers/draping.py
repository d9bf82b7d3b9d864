"""Kinematic draping (fishnet) of the hemisphere by geometry alone.

The fabric is an inextensible net of spacing h. Its two fibres through the pole lie on great circles
(a, b = 0, h, 2h, ...); each further node is the point of the sphere at the arc h from two
neighbours that is not their common neighbour (Mack and Taylor, J. Textile Inst. 47, 1956). With
neighbours p, q on the sphere of radius R and c = R² cos(h/R), the node x solves x·p = x·q = c:

    x = α (p + q) + β q×p,   α = c/(R² + p·q),   β = √(R² - 2 α² (R² + p·q)) / |q×p|,

where p is the neighbour along a. All nodes of one i + j follow from the previous ones at once.
The method gives no forces and no result outside the cap, so it is compared on the cap only, with
the exact net `quasiform.theory.hemisphere_net`. Quasiform solves the whole forming for the same
angles: the accuracies are comparable; the times show the cost of the mechanics.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from .contest import OURS, Answer, Contender, Problem

FloatArray = np.ndarray
SPACINGS = (10.0, 5.0)  # mm
FARTHEST = 60.0  # colatitude up to which the net is compared, degrees
BAND = 0.2  # degrees


def missing() -> str:
    return ""


def problems(folder: Path) -> list[Problem]:
    """Both codes at two spacings, on the punch of quasiform's hemisphere."""
    import quasiform as qf

    made = qf.forming("hemisphere", size=20.0)
    radius = made.contacts[0].tool.shape.radius + made.sheet.fabric.thickness / 2
    return [
        Problem(
            f"net on the hemisphere, spacing {h:g} mm",
            "draping",
            (
                Contender(OURS, "own", "quasiform", {"spacing": h}),
                Contender("fishnet", "own", "fishnet", {"spacing": h, "radius": radius}),
            ),
            0.0,
            BAND,
            "largest error on the bias line, °",
        )
        for h in SPACINGS
    ]


def drape(radius: float, spacing: float, count: int) -> FloatArray:
    """Nodes (count, count, 3) of a quarter of the net, the pole at [0, 0]; nan outside.

    Parameters
    ----------
    radius, spacing : float
        R and h, mm.
    count : int
        Nodes along each of the two fibres through the pole.
    """
    x = np.full((count, count, 3), np.nan)
    along = spacing / radius * np.arange(count)
    x[:, 0] = radius * np.stack([np.sin(along), 0 * along, np.cos(along)], axis=1)
    x[0, :] = radius * np.stack([0 * along, np.sin(along), np.cos(along)], axis=1)
    c = radius**2 * np.cos(spacing / radius)
    for total in range(2, count):
        i = np.arange(1, total)
        j = total - i
        p, q = x[i, j - 1], x[i - 1, j]
        dot = (p * q).sum(1)
        cross = np.cross(q, p)  # points away from the pole
        alpha = c / (radius**2 + dot)
        left = radius**2 - 2 * alpha**2 * (radius**2 + dot)
        left[left < 0] = np.nan  # the neighbours are farther apart than 2 h: the net has locked
        beta = np.sqrt(left) / np.linalg.norm(cross, axis=1)
        x[i, j] = alpha[:, None] * (p + q) + beta[:, None] * cross
    return x


def fishnet(spacing: float, radius: float) -> Answer:
    """Largest error of the fishnet's shear angle on the bias line."""
    clock = time.perf_counter()
    x = drape(radius, spacing, int(1.3 * np.pi * radius / spacing))
    along, across = np.diff(x, axis=0)[:, :-1], np.diff(x, axis=1)[:-1]
    # the two legs at a corner give the shear at the middle of the hypotenuse to second order
    sine = (along * across).sum(-1) / (
        np.linalg.norm(along, axis=-1) * np.linalg.norm(across, axis=-1)
    )
    gamma = np.degrees(np.arcsin(sine))
    seconds = time.perf_counter() - clock
    from quasiform import theory

    i = np.arange(len(gamma))
    middle = (x[i, i] + x[i + 1, i] + x[i, i + 1]) / 3
    colatitude = np.degrees(np.arccos(middle[:, 2] / np.linalg.norm(middle, axis=1)))
    i = i[colatitude < FARTHEST]
    arc = (i + 0.5) * spacing
    error = np.abs(gamma[i, i] - np.degrees(theory.hemisphere_net(arc, arc, radius)))
    return Answer(float(error.max()), float(gamma[i, i].max()), seconds)


def quasiform(spacing: float) -> Answer:
    """Largest error of the triangles on the punch, measured as in `validation/hemisphere_net`."""
    import quasiform as qf
    from quasiform import theory

    result = qf.solve(qf.forming("hemisphere", size=spacing), estimate=False)
    if result.status != "completed":
        return Answer(failed=result.reason)
    made, blank = result.model, result.model.sheet.blank
    x = result.states[-1].x
    corners = blank.nodes[blank.triangles]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    n, k = np.arange(len(edges)), edges.argmax(1)
    a, b = (0.5 * (np.roll(corners, -1, axis=1) + np.roll(corners, 1, axis=1))[n, k]).T
    punch = made.contacts[0]
    radius = punch.tool.shape.radius
    place = made.sheet.positions(x)[blank.triangles].mean(1)
    height = x[punch.tool_dofs[0]] + radius - place[:, 2]
    colatitude = np.degrees(np.arctan2(np.hypot(*place[:, :2].T), height))
    touching = (punch.penetration(x) > 0)[blank.triangles].all(1)
    chosen = touching & (np.abs(a - b) < 1e-6) & (colatitude < FARTHEST)
    exact = theory.hemisphere_net(a[chosen], b[chosen], radius + made.sheet.fabric.thickness / 2)
    gamma = np.degrees(made.membrane.shear_angle(x)[chosen])
    return Answer(
        float(np.abs(gamma - np.degrees(exact)).max()),
        float(gamma.max()),
        result.wall_s,
        result.increments,
        result.linear_solves,
    )
