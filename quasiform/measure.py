"""What is read off a sheet: draw-in at mid-edge, means over named areas, percentiles by area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .blank import Blank, rotation

FloatArray = np.ndarray


@dataclass(frozen=True)
class EdgePoint:
    """A point of the blank's outline, between two nodes, and its inward direction."""

    nodes: np.ndarray  # (2,)
    shares: FloatArray  # (2,)
    inward: FloatArray  # (2,)
    flat: FloatArray  # (2,) mm

    def draw_in(self, positions: FloatArray) -> float:
        """Inward motion, mm, for positions (n_nodes, 2 or 3)."""
        return float(self.inward @ (self.shares @ positions[self.nodes, :2] - self.flat))


def mid_edges(blank: Blank, length: float, width: float, turn: float = 0.0) -> dict[str, EdgePoint]:
    """Middle of each edge of a rectangular blank by direction "+x", "-x", "+y", "-y".

    On a mirrored blank the modelled side stands for both.

    Parameters
    ----------
    blank : Blank
    length, width : float
        mm, along the blank's own x and y.
    turn : float
        Degrees by which the blank is turned.
    """
    R = rotation(turn)
    rim = blank.mesh.facets[:, blank.mesh.boundary_facets()].T
    start, step = blank.nodes[rim[:, 0]], np.diff(blank.nodes[rim], axis=1)[:, 0]
    points = {}
    for axis, name in enumerate("xy"):
        for mark, sign in (("+", 1.0), ("-", -1.0)):
            outward = np.zeros(2)
            outward[axis] = 1.0 if name in blank.mirror else sign
            flat = R @ (outward * (length, width)[axis] / 2)
            s = np.clip(((flat - start) * step).sum(1) / (step**2).sum(1), 0.0, 1.0)
            at = np.linalg.norm(start + s[:, None] * step - flat, axis=1).argmin()
            shares = np.array([1.0 - s[at], s[at]])
            points[mark + name] = EdgePoint(rim[at], shares, -R @ outward, flat)
    return points


def disc(blank: Blank, centre: tuple[float, float], radius: float) -> np.ndarray:
    """(n_triangles,) bool array: triangles with their centroid in a disc of the flat blank."""
    return np.linalg.norm(blank.centroids - centre, axis=1) <= radius


def percentile(values: FloatArray, areas: FloatArray, share: float) -> float:
    """Value below which `share` of the area lies.

    Examples
    --------
    >>> percentile(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 8.0]), 0.5)
    2.0
    """
    order = np.argsort(values)
    below = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])
