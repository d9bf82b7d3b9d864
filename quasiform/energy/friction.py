"""Coulomb friction with true stick, as a potential with lagged normal force.

For a point of the sheet with the normal force λ and the normal n taken from an earlier state, and
the tangential distance s = (1 - n n')(x - anchor) in the tool's frame,

    E = K/2 |s|²                    while |s| ≤ μ λ/K      (elastic stick)
    E = μ λ (|s| - μ λ/(2 K))       beyond                 (slip)

a Huber function: convex, with symmetric Hessian, and holding a stuck sheet exactly. K is fixed, so
a change of λ moves no force onto a node that has not moved.

The state holds λ and n, which `refresh` takes from the present x (repeated until the residual with
refreshed values is small), and the anchors, which `commit` moves after a converged increment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..net.transfer import interpolated
from ..unknowns import FloatArray, IntArray
from .contact import Acting, AtPoints, Contact
from .term import Standing

STICK = 0.01  # stiffness of elastic stick, of the compaction stiffness
FAST = 1e6  # mm: reach of elastic stick that no sheet comes to


@dataclass(frozen=True, eq=False)
class Rubbing:
    """What friction remembers of m points of the sheet on a tool, in the tool's frame."""

    points: FloatArray  # (m, 3) positions at the last commit, mm
    p: FloatArray  # (m,) penetrations there, mm
    touched: FloatArray  # (m, 3) anchors there, mm; nan for a point that did not touch
    anchor: FloatArray  # (m, 3) anchors now, mm, also of points that have come into touch since
    normal: FloatArray  # (m, 3) n
    limit: FloatArray  # (m,) μ λ, N


class Friction(AtPoints):
    """Friction of the sheet on one tool, at the points of the normal contact with it."""

    mixed = ("limit",)

    def __init__(self, contact: Contact) -> None:
        self.name = contact.name.replace("contact", "friction")
        self.contact, self.dofs = contact, contact.dofs
        self.stick = STICK * contact.compaction * contact.area
        self._last: tuple[FloatArray, Rubbing, Acting] | None = None

    def relative(self, x: FloatArray, state: Rubbing) -> FloatArray:
        """(m, 3) positions of the points in the tool's frame, mm."""
        return self.contact.relative(x)

    def initial(self, x: FloatArray) -> Rubbing:
        """Points that touch at x are anchored where they are."""
        points, p = self.contact.relative(x), self.contact.penetration(x)
        anchor = np.where((p > 0)[:, None], points, np.nan)
        start = Rubbing(points, p, anchor, anchor, np.zeros_like(points), np.zeros_like(p))
        return self.refresh(x, start)

    def refresh(self, x: FloatArray, state: Rubbing) -> Rubbing:
        """Take normal forces and normals from x.

        A point that has come into touch is anchored where its path since the last commit met the
        tool, and stays anchored there while it touches: an anchor that followed it would let it
        creep without end.
        """
        points, p = self.contact.relative(x), self.contact.penetration(x)
        fresh = (state.p <= 0) & (p > 0)
        known = (fresh & ~np.isnan(state.anchor[:, 0]))[:, None]
        part = np.where(fresh, -state.p / np.where(fresh, p - state.p, 1.0), 0.0)
        touch = state.points + part[:, None] * (points - state.points)
        anchor = np.where(fresh[:, None], touch, state.touched)
        return replace(
            state,
            normal=self.contact.normal(x),
            limit=self.contact.tool.friction * self.contact.area * self.contact.pressure(x),
            anchor=np.where(known, state.anchor, anchor),
        )

    def through_refresh(
        self, x: FloatArray, before: Rubbing, state: Rubbing
    ) -> tuple[IntArray, FloatArray]:
        """Through n, λ and the place of first touch, by the position y in the tool's frame.

            ∂f/∂s · [-(n ⊗ r + (r·n) 1) ∂n/∂y - P ∂anchor/∂y] + t ⊗ μ ∂λ/∂y

        The last part where the point slips; r = y - anchor, P = 1 - n n', t is its direction.
        """
        contact, rows = self.contact, np.flatnonzero(state.limit > 0)
        y, d, slope, curvature = (values[rows] for values in contact.at(x))
        n, limit, stick = state.normal[rows], state.limit[rows], self.stick[rows]
        s, length = self._slide(contact.relative(x), state, rows)
        arm = np.nan_to_num(y - state.anchor[rows])
        eye = np.eye(3)
        P = eye - n[:, :, None] * n[:, None, :]
        dn = P @ curvature / np.linalg.norm(slope, axis=1)[:, None, None]
        along = (arm * n).sum(1)[:, None, None]
        ds = -(n[:, :, None] * arm[:, None, :] + along * eye) @ dn
        # the anchor of a point in touch since the last commit: where its path met the tool
        p0, p, path = before.p[rows], contact.reach[rows] - d, y - before.points[rows]
        fresh = p0 <= 0
        over = np.where(fresh, p - p0, 1.0)
        part, rate = np.where(fresh, -p0 / over, 0.0), np.where(fresh, p0 / over**2, 0.0)
        ds -= P @ (part[:, None, None] * eye - (rate[:, None] * path)[:, :, None] * slope[:, None])
        t = s / np.maximum(length, 1e-300)[:, None]
        slips = (stick * length > limit)[:, None, None]
        reach = (limit / np.maximum(length, 1e-300))[:, None, None]
        by_slide = np.where(
            slips, reach * (eye - t[:, :, None] * t[:, None, :]), stick[:, None, None] * eye
        )
        stiff = contact.tool.friction * contact.area[rows] * contact.stiffness_at(p)
        by_force = -t[:, :, None] * (stiff[:, None] * slope)[:, None, :]
        local = by_slide @ ds + np.where(slips, by_force, 0.0)
        return rows, contact.pull_back_stiffness(x, local, None, rows)

    def commit(self, x: FloatArray, state: Rubbing) -> Rubbing:
        """Move the anchors of slipping points; points that left the tool lose theirs."""
        points, p = self.contact.relative(x), self.contact.penetration(x)
        s, length = self._slide(points, state)
        keep = np.minimum(1.0, state.limit / (self.stick * np.maximum(length, 1e-300)))
        anchor = np.where((p > 0)[:, None], points - keep[:, None] * s, np.nan)
        return replace(state, points=points, p=p, touched=anchor, anchor=anchor)

    def dissipated(self, before: Rubbing, after: Rubbing, x: FloatArray) -> float:
        """Work of the friction forces by the trapezoidal rule, less what elastic stick stores."""
        force = [self._force(state.points, state) for state in (before, after)]
        moved = self.relative(x, before) - before.points
        work = (0.5 * (force[0] + force[1]) * moved).sum()
        stored = [self._energy(state.points, state).sum() for state in (before, after)]
        return float(work - (stored[1] - stored[0]))

    def carried(self, state: Rubbing | None, old: Standing | None, new: Standing) -> Rubbing:
        """Take over from another mesh: each point slips from where it was one increment earlier.

        What a point bears is interpolated, until the contact forces of this mesh are found.
        """
        pressure = np.zeros(len(self.stick))
        if state is not None and old is not None:
            theirs = old.term.contact
            pressure = interpolated(theirs.places, state.limit / theirs.area, self.contact.places)
        touched = pressure > 0
        points, p = self.contact.relative(new.before), self.contact.penetration(new.before)
        p = np.where(touched, np.maximum(p, 1e-9 * self.contact.blend), np.minimum(p, 0.0))
        anchor = np.where(touched[:, None], points, np.nan)
        limit = pressure * self.contact.area
        return Rubbing(points, p, anchor, anchor, self.contact.normal(new.x), limit)

    def slide(self, x: FloatArray, state: Rubbing) -> float:
        """Mean way of the points along the tool from their anchors, mm, by their areas."""
        points, area = self.relative(x, state), self.contact.area
        if self.kernels:
            return self.kernels.mean_slide(points, state.anchor, state.normal, area)
        rows = np.flatnonzero(~np.isnan(state.anchor[:, 0]))
        total, slid = area[rows].sum(), area[rows] @ self._slide(points, state, rows)[1]
        return float(slid / total) if total else 0.0

    def stuck(self, state: Rubbing) -> Rubbing:
        """State in which no point that touches can slip."""
        return replace(state, limit=np.where(state.limit > 0, FAST * self.stick, 0.0))

    def _slide(
        self, points: FloatArray, state: Rubbing, rows: IntArray | slice = slice(None)
    ) -> tuple[FloatArray, FloatArray]:
        arm, n = points[rows] - state.anchor[rows], state.normal[rows]
        arm = np.where(np.isnan(arm), 0.0, arm)
        s = arm - (arm * n).sum(1)[:, None] * n
        return s, np.sqrt((s * s).sum(1))

    def _energy(self, points: FloatArray, state: Rubbing) -> FloatArray:
        return self._law(state, slice(None), *self._slide(points, state))[0]

    def _force(self, points: FloatArray, state: Rubbing) -> FloatArray:
        return self._law(state, slice(None), *self._slide(points, state))[1]

    def _law(
        self, state: Rubbing, rows: IntArray | slice, s: FloatArray, length: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(m,) energies and (m, 3) forces of points at distances s (m, 3) from their anchors."""
        limit, stick = state.limit[rows], self.stick[rows]
        reach = np.minimum(length, limit / stick)
        force = s * np.minimum(stick, limit / np.maximum(length, 1e-300))[:, None]
        return 0.5 * stick * reach**2 + limit * (length - reach), force

    def force(self, x: FloatArray, state: Rubbing) -> FloatArray:
        """(m, 3) gradient by the position in the tool's frame, N."""
        return self._force(self.relative(x, state), state)

    def acting(self, x: FloatArray, state: Rubbing) -> Acting:
        points, last = self.contact.relative(x), self._last
        if last is None or last[0] is not points or last[1] is not state:
            known = last is not None and last[1] is state
            rows = last[2].rows if known else np.flatnonzero(state.limit > 0)
            self._last = last = points, state, self._acting(points, state, rows)
        return last[2]

    def _acting(self, points: FloatArray, state: Rubbing, rows: IntArray) -> Acting:
        if self.kernels:
            given = state.anchor, state.normal, state.limit, self.stick
            return Acting(rows, *self.kernels.friction(rows, points, *given))
        s, length = self._slide(points, state, rows)
        n, limit, stick = state.normal[rows], state.limit[rows], self.stick[rows]
        P = np.eye(3) - n[:, :, None] * n[:, None, :]
        slipping = stick * length > (1 - 1e-6) * limit  # a point at its limit slips on
        t = s / np.maximum(length, 1e-300)[:, None]
        across = P - t[:, :, None] * t[:, None, :]
        slope = limit / np.maximum(length, 1e-300)
        stuck = stick[:, None, None] * P
        H = np.where(slipping[:, None, None], slope[:, None, None] * across, stuck)
        return Acting(rows, *self._law(state, rows, s, length), H)
