"""Coulomb friction with true stick, as a potential with lagged normal force.

For a point of the sheet with the normal force λ and the normal n taken from an earlier state, and
the tangential distance s = (1 - n n')(x - anchor) in the tool's frame,

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

from .contact import Contact

FloatArray = np.ndarray
IntArray = np.ndarray
STICK = 0.1  # stiffness of elastic stick per area, N/mm³


class Friction:
    """Friction of the sheet on one tool, at the points where it touches.

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
        self.reset(x)

    def reset(self, x: FloatArray) -> None:
        """Forget everything: points that touch at x are anchored where they are."""
        points, p = self.contact.relative(x), self.contact.penetration(x)
        self.anchor = np.where((p > 0)[:, None], points, np.nan)
        self._committed = points, p, self.anchor
        self.refresh(x)

    def refresh(self, x: FloatArray) -> None:
        """Take normal forces and normals from x.

        A node that has come into touch is anchored where its path since the last commit met the
        tool, and stays anchored there while it touches: an anchor that followed it would let it
        creep without end. Refreshing at the last committed state undoes all refreshing since.
        """
        points, p = self.contact.relative(x), self.contact.penetration(x)
        self.normal = self.contact.normal(x)
        self.limit = self.contact.tool.friction * self.contact.area * self.contact.pressure(x)
        before, p_before, anchor = self._committed
        fresh = (p_before <= 0) & (p > 0)
        known = (fresh & ~np.isnan(self.anchor[:, 0]))[:, None]
        part = np.where(fresh, -p_before / np.where(fresh, p - p_before, 1.0), 0.0)
        touch = before + part[:, None] * (points - before)
        self.anchor = np.where(known, self.anchor, np.where(fresh[:, None], touch, anchor))

    def commit(self, x: FloatArray) -> None:
        """Move the anchors of slipping nodes; nodes that left the tool lose theirs."""
        points = self.contact.relative(x)
        p = self.contact.penetration(x)
        s, length = self._slide(x)
        keep = np.minimum(1.0, self.limit / (self.stick * np.maximum(length, 1e-300)))
        self.anchor = np.where((p > 0)[:, None], points - keep[:, None] * s, np.nan)
        self._committed = points, p, self.anchor

    def memory(self) -> dict[str, FloatArray]:
        """Return all that is remembered, as arrays by name."""
        points, p, anchor = self._committed
        return {
            "points": points,
            "p": p,
            "touched": anchor,
            "anchor": self.anchor,
            "normal": self.normal,
            "limit": self.limit,
        }

    def recall(self, memory: dict[str, FloatArray]) -> None:
        """Take over what `memory` returned."""
        self._committed = memory["points"], memory["p"], memory["touched"]
        self.anchor, self.normal, self.limit = (memory[k] for k in ("anchor", "normal", "limit"))

    def adopt(
        self, x: FloatArray, before: FloatArray, touched: np.ndarray, limit: FloatArray
    ) -> None:
        """Take over from another mesh: x was reached from `before`, where points had touched.

        Parameters
        ----------
        x, before : (n_dofs,) arrays, mm
            Present positions, and those at the last commit; slip between them is not yet undone.
        touched : (m,) bool array
            Points that touched at the last commit.
        limit : (m,) array
            Greatest friction force, N, until the next `refresh`.
        """
        points = self.contact.relative(before)
        p = self.contact.penetration(before)
        p = np.where(touched, np.maximum(p, 1e-9), np.minimum(p, 0.0))
        self._committed = points, p, np.where(touched[:, None], points, np.nan)
        self.normal, self.limit = self.contact.normal(x), limit
        self.anchor = self._committed[2]

    def _slide(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        arm = self.contact.relative(x) - self.anchor
        arm = np.where(np.isnan(arm), 0.0, arm)
        s = arm - (arm * self.normal).sum(1)[:, None] * self.normal
        return s, np.linalg.norm(s, axis=1)

    def energy(self, x: FloatArray) -> FloatArray:
        """Energy of each point, mJ."""
        _, length = self._slide(x)
        reach = np.minimum(length, self.limit / self.stick)
        return 0.5 * self.stick * reach**2 + self.limit * (length - reach)

    def force(self, x: FloatArray) -> FloatArray:
        """(m, 3) gradient by the position in the tool's frame, N."""
        s, length = self._slide(x)
        return s * np.minimum(self.stick, self.limit / np.maximum(length, 1e-300))[:, None]

    def gradient(self, x: FloatArray) -> FloatArray:
        """(m, n_local) forces on nodes and tool, N."""
        return self.contact.pull_back(x, self.force(x))

    def active(self, x: FloatArray) -> IntArray:
        """Numbers of the points that rub."""
        return np.flatnonzero(self.limit > 0)

    def hessian(
        self, x: FloatArray, convex: bool, rows: IntArray | slice = slice(None)
    ) -> FloatArray:
        """(m, n_local, n_local) stiffness, N/mm; positive semi-definite with `convex`.

        With `rows`, that of these points only.
        """
        s, length = (of_all[rows] for of_all in self._slide(x))
        n, limit, stick = self.normal[rows], self.limit[rows], self.stick[rows]
        P = np.eye(3) - n[:, :, None] * n[:, None, :]
        slipping = stick * length > (1 - 1e-6) * limit  # a point at its limit goes on
        t = s / np.maximum(length, 1e-300)[:, None]
        across = P - t[:, :, None] * t[:, None, :]
        slope = limit / np.maximum(length, 1e-300)
        H = np.where(
            slipping[:, None, None],
            slope[:, None, None] * across,
            ((limit > 0) * stick)[:, None, None] * P,
        )
        force = None if convex else s * np.minimum(stick, slope)[:, None]
        return self.contact.pull_back_stiffness(x, H, force, rows)
