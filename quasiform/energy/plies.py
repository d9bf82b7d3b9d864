"""Contact and friction between two plies: points of one ply against the surface of the other.

Each pair of plies has two such energies, one for the nodes of each ply, at half the weight. A node
x of a ply is paired with the point y = Σ b_i x_i of a triangle of the other ply, b its barycentric
coordinates, where x - y is along the normal n of that ply: nodal normals (means over the triangles
around a node), interpolated by b. The surface is smooth: between its nodes it lies higher than the
triangle by

    h = 1/2 Σ_(i<j) b_i b_j (n_j - n_i)·(x_j - x_i).

With the mean thickness t and the side s = 1 of a node above the other ply, -1 of one below it,

    E = Σ w φ(p),   p = t - s [n·(x - y) - h],   w half the area of the node,

with the compaction law φ of the tools (`contact`). Friction is that of the tools (`friction`), with
the tangential distance between x and the material point y with which it was paired at the last
commit. Triangle, b, n and h are lagged: `refresh` finds them, so that energy, gradient and Hessian
are exact for fixed pairs. The force on x is divided among the corners of the triangle by b: the
forces of both plies are equal and opposite. They act on the mean surfaces; the moment of friction
by half a thickness is left out, as it is for tools.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..checks import InputError
from ..net.transfer import interpolated
from ..unknowns import FloatArray, IntArray, Sheet
from .contact import BLEND, Acting, AtPoints, compaction_law
from .friction import STICK, Friction, Rubbing
from .term import Standing, Term, frozen, same

NEAREST = 12  # triangles, by their centroids, among which that under a point is looked for
PASSES = 3  # of the search for the foot of the normal
OUTSIDE = 1e-6  # how far b may be negative
DEEP = 3.0  # of the mean thickness: what is farther on the wrong side is on another fold


@dataclass(frozen=True, eq=False)
class Pairs:
    """Where each of m nodes of a ply meets the other ply."""

    dofs: IntArray  # (m, 12) numbers in x of the node, then of the corners of its triangle
    weights: FloatArray  # (m, 3) b
    normal: FloatArray  # (m, 3) n
    rise: FloatArray  # (m,) h, mm
    paired: np.ndarray  # (m,) bool: whether there is a triangle under or over the node

    def relative(self, x: FloatArray) -> FloatArray:
        """(m, 3) x - y, mm."""
        return relative(self.dofs, self.weights, x)


def relative(dofs: IntArray, weights: FloatArray, x: FloatArray) -> FloatArray:
    """(m, 3) nodes less points of their triangles, mm."""
    places = x[dofs].reshape(-1, 4, 3)
    return places[:, 0] - np.einsum("mi,mic->mc", weights, places[:, 1:])


class AtPairs(AtPoints):
    """An energy of the distances x - y of pairs that are kept in its state."""

    together = ""

    def stencils(self, state: Any) -> IntArray:
        return state.dofs

    def _shares(self, state: Any, rows: IntArray) -> FloatArray:
        """(r, 4) by which x - y is made of the nodes."""
        return np.column_stack([np.ones(len(rows)), -state.weights[rows]])

    def gradient(self, x: FloatArray, state: Any) -> FloatArray:
        gradient, here = np.zeros(state.dofs.shape), self.acting(x, state)
        local = self._shares(state, here.rows)[:, :, None] * here.force[:, None]
        gradient[here.rows] = local.reshape(-1, 12)
        return gradient

    def hessian(
        self, x: FloatArray, state: Any, convex: bool, rows: IntArray | None = None
    ) -> FloatArray:
        """It is positive semi-definite."""
        here = self.acting(x, state)
        c = self._shares(state, here.rows)
        local = np.einsum("ri,rj,rab->riajb", c, c, here.stiffness).reshape(-1, 12, 12)
        if rows is here.rows:
            return local
        H = np.zeros((len(state.dofs), 12, 12))
        H[here.rows] = local
        return H if rows is None else H[rows]

    def add_gradient(self, out: FloatArray, x: FloatArray, state: Any) -> None:
        Term.add_gradient(self, out, x, state)

    def add_hessians(
        self, values: FloatArray, x: FloatArray, states: Sequence, *given: Any, **stress: Any
    ) -> None:
        Term.add_hessians(self, values, x, states, *given, **stress)


class PlyContact(AtPairs):
    """Normal contact of the nodes of a sheet with another sheet, `above` it or below it."""

    def __init__(self, sheet: Sheet, other: Sheet, above: bool) -> None:
        self.sheet, self.other, self.side = sheet, other, 1.0 if above else -1.0
        self.name = f"contact of the {sheet.name} with the {other.name}"
        fabrics = sheet.fabric, other.fabric
        self.reach = float(np.mean([fabric.thickness for fabric in fabrics]))
        self.compaction = 2.0 / sum(1.0 / fabric.compaction for fabric in fabrics)
        self.blend, self.area = BLEND * self.reach, 0.5 * sheet.blank.node_areas
        corners = other.blank.triangles[np.zeros(len(sheet.dofs), dtype=int)]
        self.dofs = self._table(corners)
        self._last: tuple[FloatArray, Pairs] | None = None

    @property
    def places(self) -> FloatArray:
        """(m, 2) flat places of the nodes, mm."""
        return self.sheet.blank.nodes

    def _table(self, corners: IntArray) -> IntArray:
        return np.column_stack([self.sheet.dofs, self.other.dofs[corners].reshape(-1, 9)])

    def pairs(self, x: FloatArray) -> Pairs:
        """Pairs at x (n_dofs,)."""
        if self._last is None or not same(self._last[0], x):
            self._last = frozen(x), self._paired(x)
        return self._last[1]

    def _paired(self, x: FloatArray) -> Pairs:
        points, surface = self.sheet.positions(x), self.other.positions(x)
        triangles = self.other.blank.triangles
        corners, normals = surface[triangles], nodal_normals(self.other, surface)
        count = min(NEAREST, len(triangles))
        near = cKDTree(corners.mean(1)).query(points, count)[1].reshape(len(points), -1)
        first, own = near[:, 0], np.arange(len(points))
        n = normals[triangles[first]].sum(1)
        arm, legs = points[:, None] - corners[near, 2], corners[:, :2] - corners[:, 2:]
        legs = legs[near]
        for _ in range(PASSES):
            b = _along(n, arm, legs)
            best = b.min(2).argmax(1)
            chosen, b = near[own, best], b[own, best]
            n = np.einsum("mi,mic->mc", np.clip(b, 0.0, 1.0), normals[triangles[chosen]])
            n /= np.linalg.norm(n, axis=1)[:, None]
        nodes = triangles[chosen]
        b = _along(n, arm[own, best, None], legs[own, best, None])[:, 0]
        inside = b.min(1) > -OUTSIDE
        facing = (n * nodal_normals(self.sheet, points)).sum(1) > 0.0
        found = Pairs(self._table(nodes), b, n, _rise(b, normals[nodes], surface[nodes]), inside)
        deep = self.penetration(x, found) > DEEP * self.reach
        return replace(found, paired=inside & facing & ~deep)

    def initial(self, x: FloatArray) -> Pairs:
        return self.pairs(x)

    def refresh(self, x: FloatArray, state: Pairs) -> Pairs:
        """Pair the nodes anew; a table that stays the same is the same array."""
        found = self.pairs(x)
        kept = np.array_equal(found.dofs, state.dofs)
        return replace(found, dofs=state.dofs) if kept else found

    def carried(self, state: Pairs | None, old: Standing | None, new: Standing) -> Pairs:
        return self.initial(new.x)

    def through_refresh(self, x: FloatArray, before: Any, state: Any) -> None:
        raise InputError("no sensitivities with several plies")

    def penetration(self, x: FloatArray, state: Pairs) -> FloatArray:
        """(m,) p, mm; negative where the plies are clear of each other, or without a pair."""
        p = self.reach - self.side * ((state.normal * state.relative(x)).sum(1) - state.rise)
        return np.where(state.paired, p, -np.inf)

    def pressure(self, x: FloatArray, state: Pairs) -> FloatArray:
        """(m,) contact pressure, MPa: at half the weight, this is that of one direction."""
        return self._law(self.penetration(x, state))[1]

    def _law(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return compaction_law(p, self.compaction, self.blend)

    def acting(self, x: FloatArray, state: Pairs) -> Acting:
        p = self.penetration(x, state)
        rows = np.flatnonzero(p > 0.0)
        value, first, second = self._law(p[rows])
        n, w = state.normal[rows], self.area[rows]
        force = -self.side * (w * first)[:, None] * n
        K = (w * second)[:, None, None] * n[:, :, None] * n[:, None]
        return Acting(rows, w * value, force, K)

    def slid(self, start: FloatArray, x: FloatArray) -> FloatArray:
        """(m,) how far nodes have slid since a start x, mm; nan without a pair then or now."""
        before, now = self.pairs(start), self.pairs(x)
        r = before.relative(x)
        s = r - (r * now.normal).sum(1)[:, None] * now.normal
        both = before.paired & now.paired
        return np.where(both, np.linalg.norm(s, axis=1), np.nan)

    def stiffness_bound(self, x: FloatArray) -> FloatArray:
        """(m, 12) shares of the row sums of the stiffness if every node touched, N/mm."""
        shares = np.abs(np.repeat(self._shares(self.pairs(x), np.arange(len(self.dofs))), 3, 1))
        return (self.area * self.compaction * shares.sum(1))[:, None] / 3 * shares


@dataclass(frozen=True, eq=False)
class PlyRubbing(Rubbing):
    """What friction remembers: distances from the material points paired at the last commit."""

    dofs: IntArray  # (m, 12), and
    weights: FloatArray  # (m, 3) of these pairs


class PlyFriction(AtPairs, Friction):
    """Friction of a ply on another one, at the nodes of their contact."""

    def __init__(self, contact: PlyContact, friction: float) -> None:
        self.name = contact.name.replace("contact", "friction")
        self.contact, self.dofs, self.friction = contact, contact.dofs, friction
        self.sheet = contact.sheet
        self.stick = STICK * contact.compaction * contact.area
        self._last = None

    def relative(self, x: FloatArray, state: PlyRubbing) -> FloatArray:
        return relative(state.dofs, state.weights, x)

    def initial(self, x: FloatArray) -> PlyRubbing:
        """Nodes that touch at x are anchored where they are."""
        start = self._committed(x, np.zeros((len(self.stick), 3)))
        return self.refresh(x, start)

    def _committed(self, x: FloatArray, anchor: FloatArray) -> PlyRubbing:
        """State of a commit at x, with anchors (m, 3) relative to the present pairs."""
        pairs = self.contact.pairs(x)
        p = self.contact.penetration(x, pairs)
        anchor = np.where((p > 0)[:, None], anchor, np.nan)
        limit = self._limit(p)
        table = pairs.dofs, pairs.weights
        return PlyRubbing(pairs.relative(x), p, anchor, anchor, pairs.normal, limit, *table)

    def _limit(self, p: FloatArray) -> FloatArray:
        pressure = compaction_law(p, self.contact.compaction, self.contact.blend)[1]
        return self.friction * self.contact.area * pressure

    def refresh(self, x: FloatArray, state: PlyRubbing) -> PlyRubbing:
        """Take normal forces and normals from x; see `Friction.refresh`."""
        pairs = self.contact.pairs(x)
        p = self.contact.penetration(x, pairs)
        r, n = self.relative(x, state), pairs.normal
        fresh = (state.p <= 0) & (p > 0)
        clear = np.where(np.isfinite(state.p), -state.p, 0.0)
        part = np.where(fresh, clear / np.where(fresh, p + clear, 1.0), 0.0)
        touch = part[:, None] * (r - (r * n).sum(1)[:, None] * n)
        known = (fresh & ~np.isnan(state.anchor[:, 0]))[:, None]
        anchor = np.where(fresh[:, None], touch, state.touched)
        anchor = np.where(known, state.anchor, anchor)
        # a node that had no pair at the last commit sticks from the next one on
        limit = np.where(np.isfinite(state.p), self._limit(p), 0.0)
        return replace(state, normal=n, limit=limit, anchor=anchor)

    def through_refresh(self, x: FloatArray, before: Any, state: Any) -> None:
        raise InputError("no sensitivities with several plies")

    def commit(self, x: FloatArray, state: PlyRubbing) -> PlyRubbing:
        """Pair anew; what is left of the slide is what is elastic.

        The state that `refresh` would take from x is that of the commit, but for its limits, which
        stay: no force changes.
        """
        s, length = self._slide(self.relative(x, state), state)
        keep = np.minimum(1.0, state.limit / (self.stick * np.maximum(length, 1e-300)))
        after = self._committed(x, -keep[:, None] * s)
        return replace(after, normal=state.normal, limit=state.limit)

    def carried(self, state: PlyRubbing | None, old: Standing | None, new: Standing) -> PlyRubbing:
        """Take over from another mesh: see `Friction.carried`."""
        pressure = np.zeros(len(self.stick))
        if state is not None and old is not None:
            theirs = old.term.contact
            pressure = interpolated(theirs.places, state.limit / theirs.area, self.contact.places)
        touched = pressure > 0
        start = self._committed(new.before, np.zeros((len(touched), 3)))
        p = np.where(touched, np.maximum(start.p, 1e-9 * self.contact.blend), start.p)
        p = np.where(touched, p, np.minimum(p, 0.0))
        anchor = np.where(touched[:, None], np.zeros(3), np.nan)
        more = {"normal": self.contact.pairs(new.x).normal, "limit": pressure * self.contact.area}
        return replace(start, p=p, touched=anchor, anchor=anchor, **more)

    def acting(self, x: FloatArray, state: PlyRubbing) -> Acting:
        last = self._last
        if last is None or last[1] is not state or not same(last[0], x):
            rows = np.flatnonzero(state.limit > 0)
            points = self.relative(x, state)
            self._last = last = frozen(x), state, self._acting(points, state, rows)
        return last[2]


def nodal_normals(sheet: Sheet, places: FloatArray) -> FloatArray:
    """(n_nodes, 3) unit normals of a sheet at its nodes, at places (n_nodes, 3)."""
    triangles = sheet.blank.triangles
    a, b, c = places[triangles].transpose(1, 0, 2)
    across = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    at = triangles.ravel()
    n = np.column_stack([np.bincount(at, part, minlength=len(places)) for part in across.T])
    for axis, plane in enumerate("xy"):  # the mirrored half has the mirrored normal
        if plane in sheet.blank.mirror:
            n[np.abs(sheet.blank.nodes[:, axis]) < 1e-9, axis] = 0.0
    return n / np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]


def _along(n: FloatArray, arm: FloatArray, legs: FloatArray) -> FloatArray:
    """(m, k, 3) barycentric coordinates of points projected along n (m, 3) onto triangles.

    `arm` (m, k, 3) is the point less the third corner, `legs` (m, k, 2, 3) the others less it.
    """
    u, v = legs[:, :, 0], legs[:, :, 1]
    un, vn = np.cross(v, n[:, None]), np.cross(n[:, None], u)
    volume = (u * un).sum(2)
    volume = np.where(np.abs(volume) > 1e-300, volume, 1e-300)
    first, second = (arm * un).sum(2) / volume, (arm * vn).sum(2) / volume
    return np.stack([first, second, 1.0 - first - second], axis=2)


def _rise(b: FloatArray, n: FloatArray, places: FloatArray) -> FloatArray:
    """(m,) h of points b (m, 3) in triangles with normals and places (m, 3, 3) of the corners."""
    b, rise = np.clip(b, 0.0, 1.0), np.zeros(len(b))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        bulge = ((n[:, j] - n[:, i]) * (places[:, j] - places[:, i])).sum(1)
        rise += 0.5 * b[:, i] * b[:, j] * bulge
    return rise
