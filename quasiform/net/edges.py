"""Places of the flat sheet where a run is measured: points of its edge, discs."""

from __future__ import annotations

import itertools
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


def edge_points(blank: Blank, turn: float = 0.0) -> dict[str, EdgePoint]:
    """Outermost points of the outline from the blank's middle along "+x", "-x", "+y", "-y".

    The blank is the whole sheet; `turn` is by how many degrees it, and its x and y, are turned.
    """
    R = rotation(turn)
    rim = blank.mesh.facets[:, blank.mesh.boundary_facets()].T
    flat = blank.nodes @ R  # in the blank's own axes
    middle = 0.5 * (flat.min(0) + flat.max(0))
    start, step = flat[rim[:, 0]] - middle, np.diff(flat[rim], axis=1)[:, 0]
    points = {}
    for (axis, name), (mark, sign) in itertools.product(enumerate("xy"), (("+", 1.0), ("-", -1.0))):
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -start[:, 1 - axis] / step[:, 1 - axis]
        crosses = (s >= -1e-9) & (s <= 1 + 1e-9)
        along = start[:, axis] + np.where(crosses, s, 0.0) * step[:, axis]
        reach = np.where(crosses, sign * along, 0.0)
        at = reach.argmax()
        if reach[at] <= 0:
            continue
        share = float(np.clip(s[at], 0.0, 1.0))
        shares = np.array([1.0 - share, share])
        inward, place = -sign * R[:, axis], shares @ blank.nodes[rim[at]]
        points[mark + name] = EdgePoint(rim[at], shares, inward, place)
    return points


def disc(blank: Blank, centre: tuple[float, float], radius: float) -> np.ndarray:
    """(n_triangles,) bool array: triangles with their centroid in a disc of the flat blank."""
    return np.linalg.norm(blank.centroids - centre, axis=1) <= radius
