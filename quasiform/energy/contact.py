"""Penalty contact between the sheet's nodes and a rigid tool: E = Σ w φ(p), p = t0/2 - d(x).

φ is C² and has no stiffness at touch: with the compaction stiffness k and the blending depth e

    φ(p) = k p³/(6 e)                     for 0 < p < e
    φ(p) = k (p²/2 - e p/2 + e²/6)        for p ≥ e

w is the tributary area of the node. The last local degree of freedom is the height of the tool, so
that the force on a tool is a derivative of the potential like any other.
"""

from __future__ import annotations

import numpy as np

from ..blank import Blank
from ..material import Fabric
from ..tool import Tool

FloatArray = np.ndarray
BLEND = 0.05  # e, mm


class Contact:
    """Normal contact of all nodes with one tool.

    Parameters
    ----------
    blank : Blank
    fabric : Fabric
        Supplies thickness t0 and compaction stiffness k.
    tool : Tool
    height_dof : int
        Degree of freedom of the tool's height.
    """

    def __init__(self, blank: Blank, fabric: Fabric, tool: Tool, height_dof: int) -> None:
        self.name = f"contact with {tool.name}"
        self.tool = tool
        nodes = np.arange(len(blank.nodes))
        self.dofs = np.column_stack(
            [3 * nodes, 3 * nodes + 1, 3 * nodes + 2, 0 * nodes + height_dof]
        )
        self.area = blank.node_areas
        self.offset = 0.5 * fabric.thickness
        self.compaction = fabric.compaction

    def relative(self, x: FloatArray) -> FloatArray:
        """(n_nodes, 3) positions in the tool's frame, mm."""
        local = x[self.dofs]
        points = local[:, :3].copy()
        points[:, 2] -= local[:, 3]
        return points

    def penetration(self, x: FloatArray) -> FloatArray:
        """(n_nodes,) p, mm; negative where the sheet is clear of the tool."""
        return self.offset - self.tool.shape.distance(self.relative(x))[0]

    def pressure(self, x: FloatArray) -> FloatArray:
        """(n_nodes,) contact pressure, MPa."""
        return self._law(self.penetration(x))[1]

    def energy(self, x: FloatArray) -> FloatArray:
        """Energy of each node, mJ."""
        return self.area * self._law(self.penetration(x))[0]

    def gradient(self, x: FloatArray) -> FloatArray:
        """(n_nodes, 4) force on node and tool height, N."""
        d, n, _ = self.tool.shape.distance(self.relative(x))
        force = -self.area * self._law(self.offset - d)[1]
        return force[:, None] * np.column_stack([n, -n[:, 2]])

    def hessian(self, x: FloatArray, convex: bool) -> FloatArray:
        """(n_nodes, 4, 4) stiffness, N/mm; with `convex` without the curvature of the tool."""
        d, n, curvature = self.tool.shape.distance(self.relative(x))
        _, pressure, stiffness = self._law(self.offset - d)
        H = (self.area * stiffness)[:, None, None] * (n[:, :, None] * n[:, None, :])
        if not convex:
            H -= (self.area * pressure)[:, None, None] * curvature
        return with_tool_height(H)

    def depth_under(self, force: float, area: float) -> float:
        """Penetration at which a plate on `area` mm² of sheet carries `force` N (in the blend)."""
        return float(np.sqrt(2.0 * BLEND * force / (self.compaction * area)))

    def _law(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """φ, φ', φ'' of the penetration."""
        k, e = self.compaction, BLEND
        p = np.maximum(p, 0.0)
        blend = p < e
        value = np.where(blend, p**3 / (6 * e), p**2 / 2 - e * p / 2 + e**2 / 6)
        first = np.where(blend, p**2 / (2 * e), p - e / 2)
        second = np.where(blend, p / e, 1.0)
        return k * value, k * first, k * second


def with_tool_height(H: FloatArray) -> FloatArray:
    """Extend (n, 3, 3) stiffness by the tool's height: x - z e_z is all that matters."""
    J = np.zeros((3, 4))
    J[:, :3] = np.eye(3)
    J[2, 3] = -1.0
    return J.T @ H @ J
