"""Coulomb friction with true stick, as a potential with lagged normal force.

For a node with the normal force λ and the normal n taken from an earlier state, and the tangential
distance s = (1 - n n')(x - anchor) in the tool's frame,

    E = K/2 |s|²                    while |s| ≤ μ λ/K      (elastic stick)
    E = μ λ (|s| - μ λ/(2 K))       beyond                 (slip)

a Huber function: convex, with symmetric Hessian, and holding a stuck sheet exactly. K is fixed, so
a change of λ moves no force onto a node that has not moved.

Memory: `refresh` takes λ and n from the present state (repeated until the residual with refreshed
values is small), `commit` moves the anchors after a converged increment. Evaluating changes
nothing.
"""

from __future__ import annotations

import numpy as np

from .contact import Contact, with_tool_height

FloatArray = np.ndarray
STICK = 0.1  # stiffness of elastic stick per area, N/mm³


class Friction:
    """Friction of all nodes on one tool.

    Parameters
    ----------
    contact : Contact
        The normal contact with the same tool.
    x : (n_dofs,) array
        The start, mm.
    """

    def __init__(self, contact: Contact, x: FloatArray) -> None:
        self.name = contact.name.replace("contact", "friction")
        self.contact = contact
        self.dofs = contact.dofs
        self.stick = STICK * contact.area
        points, p = contact.relative(x), contact.penetration(x)
        self._committed = points, p, np.where((p > 0)[:, None], points, np.nan)
        self.refresh(x)

    def refresh(self, x: FloatArray) -> None:
        """Take normal forces and normals from x.

        A node that has come into touch is anchored where its path since the last commit met the
        tool. Refreshing at the last committed state undoes all refreshing since.
        """
        points = self.contact.relative(x)
        d, self.normal, _ = self.contact.tool.shape.distance(points)
        p = self.contact.offset - d
        self.limit = self.contact.tool.friction * self.contact.area * self.contact.pressure(x)
        before, p_before, anchor = self._committed
        fresh = (p_before <= 0) & (p > 0)
        part = np.where(fresh, -p_before / np.where(fresh, p - p_before, 1.0), 0.0)
        touch = before + part[:, None] * (points - before)
        self.anchor = np.where(fresh[:, None], touch, anchor)

    def commit(self, x: FloatArray) -> None:
        """Move the anchors of slipping nodes; nodes that left the tool lose theirs."""
        points = self.contact.relative(x)
        p = self.contact.penetration(x)
        s, length = self._slide(x)
        keep = np.minimum(1.0, self.limit / (self.stick * np.maximum(length, 1e-300)))
        self.anchor = np.where((p > 0)[:, None], points - keep[:, None] * s, np.nan)
        self._committed = points, p, self.anchor

    def _slide(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        arm = self.contact.relative(x) - self.anchor
        arm = np.where(np.isnan(arm), 0.0, arm)
        s = arm - (arm * self.normal).sum(1)[:, None] * self.normal
        return s, np.linalg.norm(s, axis=1)

    def energy(self, x: FloatArray) -> FloatArray:
        """Energy of each node, mJ."""
        _, length = self._slide(x)
        reach = np.minimum(length, self.limit / self.stick)
        return 0.5 * self.stick * reach**2 + self.limit * (length - reach)

    def force(self, x: FloatArray) -> FloatArray:
        """(n_nodes, 3) gradient by the node's position, N."""
        s, length = self._slide(x)
        return s * np.minimum(self.stick, self.limit / np.maximum(length, 1e-300))[:, None]

    def gradient(self, x: FloatArray) -> FloatArray:
        """(n_nodes, 4) force on node and tool height, N."""
        f = self.force(x)
        return np.column_stack([f, -f[:, 2]])

    def hessian(self, x: FloatArray, convex: bool) -> FloatArray:
        """(n_nodes, 4, 4) stiffness, N/mm; positive semi-definite."""
        s, length = self._slide(x)
        n = self.normal
        P = np.eye(3) - n[:, :, None] * n[:, None, :]
        slipping = self.stick * length > (1 - 1e-6) * self.limit  # a node at its limit goes on
        t = s / np.maximum(length, 1e-300)[:, None]
        across = P - t[:, :, None] * t[:, None, :]
        slope = self.limit / np.maximum(length, 1e-300)
        touching = self.limit > 0
        H = np.where(
            slipping[:, None, None],
            slope[:, None, None] * across,
            (touching * self.stick)[:, None, None] * P,
        )
        return with_tool_height(H)
