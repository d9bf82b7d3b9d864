"""Contact and friction between two plies: points of one ply against the surface of the other.

Each pair of plies has two such energies, one for the nodes of each ply, at half the weight. A node
x of a ply is paired with the point y = Σ b_i x_i of a triangle of the other ply, b its barycentric
coordinates, where x - y is along the normal n of that ply: nodal normals, interpolated by b. The
surface is smooth: between its nodes it lies higher than the triangle by

    h = 1/2 Σ_(i<j) b_i b_j [c_ij |e|² + (b_j - b_i) (n_i + n_j)·e],   e = x_j - x_i,

c_ij the curvature along an edge, from normals that are averaged over neighbours: a zigzag of the
nodes has none. With the normals n_i at the corners a zigzag has no kinks at its nodes either.

With the mean thickness t and the side s = 1 of a node above the other ply, -1 of one below it,

    E = Σ w [φs(p) + φ(p - l)],   p = t - s [n·(x - y) - h],   w half the area of the node,

with the compaction law φ of the tools (`contact`), and φs the same with a small part of its
stiffness: plies are soft up to the depth l (`SOFT`, `LOFT`, assumed), as a stack of fabric is.
Where they were stiff at once, nets that differ by more than they can be pressed would touch at few
nodes, and forces would jump from one to the other. Triangle, b, n and h are lagged: `refresh` finds
them, so that energy, gradient and Hessian are exact for fixed pairs. The force on x is divided
among the corners of the triangle by b: the forces of both plies are equal and opposite.

Friction is that of the tools (`friction`). What slides is

    x - y - s t N,

y the material point with which x was paired at the last commit and N the normal of its triangle,
which is not lagged: plies that turn together do not slide, and friction, which acts half a
thickness off the mean surfaces, also turns them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ..checks import InputError
from ..net.transfer import interpolated, percentile
from ..unknowns import FloatArray, IntArray, Sheet
from .bending import second_derivative, skew
from .contact import BLEND, Acting, AtPoints, compaction_law
from .friction import STICK, Friction, Rubbing
from .term import Standing, Term, frozen, same

NEAREST = 12  # triangles, by their centroids, among which that under a point is looked for
MARGIN = 0.03  # how far b may be negative before a node leaves its triangle
SMOOTHED = 3  # averages of the normals from which h is taken: a zigzag of the nodes has none
PASSES = 3  # of the search for the foot of the normal
SOFT = 0.03  # of the compaction stiffness: that of plies on each other at first (assumed)
LOFT = 0.2  # of the mean thickness: how far (assumed)
RIM = 0.2  # over so much of a triangle beyond the rim of the other ply a node loses its contact
APART = 3.0  # sizes of the mesh on the flat sheet: distant places, which may meet in a fold
DEEP = 3.0  # of the mean thickness: what is farther on the wrong side is on another fold


@dataclass(frozen=True, eq=False)
class Pairs:
    """Where each of m nodes of a ply meets the other ply."""

    triangles: IntArray  # (m,) of the other ply
    dofs: IntArray  # (m, 12) numbers in x of the node, then of the corners of its triangle
    weights: FloatArray  # (m, 3) b
    normal: FloatArray  # (m, 3) n
    rise: FloatArray  # (m,) h, mm
    share: FloatArray  # (m,) of the node's area that lies over or under the other ply: 0 to 1

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

    def slopes(self, x: FloatArray, state: Any, rows: IntArray) -> FloatArray:
        """(r, 3, 12) derivatives of x - y by the nodes."""
        shares = np.column_stack([np.ones(len(rows)), -state.weights[rows]])
        return (shares[:, None, :, None] * np.eye(3)[:, None]).reshape(-1, 3, 12)

    def curved(self, x: FloatArray, state: Any, here: Acting) -> FloatArray | float:
        """(r, 12, 12) force times the second derivatives of what it acts on."""
        return 0.0

    def through_refresh(self, x: FloatArray, before: Any, state: Any) -> None:
        raise InputError("no sensitivities with several plies")

    def gradient(self, x: FloatArray, state: Any) -> FloatArray:
        gradient, here = np.zeros(state.dofs.shape), self.acting(x, state)
        J = self.slopes(x, state, here.rows)
        gradient[here.rows] = (here.force[:, None] @ J)[:, 0]
        return gradient

    def hessian(
        self, x: FloatArray, state: Any, convex: bool, rows: IntArray | None = None
    ) -> FloatArray:
        """With `convex` without the curvature of what slides."""
        here = self.acting(x, state)
        J = self.slopes(x, state, here.rows)
        local = J.transpose(0, 2, 1) @ (here.stiffness @ J)
        if not convex:
            local += self.curved(x, state, here)
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
        self.loft = LOFT * self.reach
        corners = other.blank.triangles[np.zeros(len(sheet.dofs), dtype=int)]
        self.dofs = self._table(corners)
        self._smooth = _averages(other)
        self._last: tuple[FloatArray, IntArray | None, Pairs] | None = None

    @property
    def places(self) -> FloatArray:
        """(m, 2) flat places of the nodes, mm."""
        return self.sheet.blank.nodes

    def _table(self, corners: IntArray) -> IntArray:
        return np.column_stack([self.sheet.dofs, self.other.dofs[corners].reshape(-1, 9)])

    def pairs(self, x: FloatArray, before: Pairs | PlyRubbing | None = None) -> Pairs:
        """Pairs at x (n_dofs,); a node stays with the triangle of a state `before` if it can.

        A table that stays the same is the same array.
        """
        kept, last = None if before is None else before.triangles, self._last
        known = last is not None and same(last[0], x)
        if not known or not (last[1] is kept or np.array_equal(last[1], kept)):
            found = self._paired(x, kept)
            if last is not None and np.array_equal(last[2].dofs, found.dofs):
                found = replace(found, dofs=last[2].dofs)
            self._last = last = frozen(x), kept, found
        return last[2]

    def _paired(self, x: FloatArray, kept: IntArray | None) -> Pairs:
        points, surface = self.sheet.positions(x), self.other.positions(x)
        triangles = self.other.blank.triangles
        corners, normals = surface[triangles], nodal_normals(self.other, surface)
        chosen = np.zeros(len(points), dtype=int) if kept is None else kept.copy()
        b, n = self._feet(points, corners, normals, chosen[:, None])[1:]
        lost = np.arange(len(points)) if kept is None else np.flatnonzero(b.min(1) < -MARGIN)
        if len(lost):
            count = min(NEAREST, len(triangles))
            near = cKDTree(corners.mean(1)).query(points[lost], count)[1].reshape(len(lost), -1)
            found = self._feet(points[lost], corners, normals, near)
            chosen[lost], b[lost], n[lost] = found
        nodes = triangles[chosen]
        means = ((self._smooth @ field)[nodes] for field in (normals, surface))
        rise = _rise(b, *means, normals[nodes], surface[nodes])
        share = np.clip(1.0 + b.min(1) / RIM, 0.0, 1.0)
        found = Pairs(chosen, self._table(nodes), b, n, rise, share)
        facing = (n * nodal_normals(self.sheet, points)).sum(1) > 0.0
        deep = self.penetration(x, found) > DEEP * self.reach
        return replace(found, share=share * (facing & ~deep))

    def _feet(
        self, points: FloatArray, corners: FloatArray, normals: FloatArray, near: IntArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Which of the triangles `near` (m, k) each point is over, b (m, 3) there, n (m, 3)."""
        own, triangles = np.arange(len(points)), self.other.blank.triangles
        n = normals[triangles[near[:, 0]]].sum(1)
        arm, legs = points[:, None] - corners[near, 2], (corners[:, :2] - corners[:, 2:])[near]
        for _ in range(PASSES):
            b = _along(n, arm, legs)
            best = b.min(2).argmax(1)
            chosen, b = near[own, best], b[own, best]
            n = np.einsum("mi,mic->mc", _near(b), normals[triangles[chosen]])
            n /= np.linalg.norm(n, axis=1)[:, None]
        return chosen, _along(n, arm[own, best, None], legs[own, best, None])[:, 0], n

    def initial(self, x: FloatArray) -> Pairs:
        return self.pairs(x)

    def refresh(self, x: FloatArray, state: Pairs) -> Pairs:
        return self.pairs(x, state)

    def carried(self, state: Pairs | None, old: Standing | None, new: Standing) -> Pairs:
        return self.initial(new.x)

    def penetration(self, x: FloatArray, state: Pairs) -> FloatArray:
        """(m,) p, mm; negative where the plies are clear of each other, or without a pair.

        Up to `loft` the plies are soft.
        """
        p = self.reach - self.side * ((state.normal * state.relative(x)).sum(1) - state.rise)
        return np.where(state.share > 0, p, -np.inf)

    def pressure(self, p: FloatArray) -> FloatArray:
        """(m,) contact pressure, MPa, by the penetration: at half the weight, of one direction."""
        return self._law(p)[1]

    def _law(self, p: FloatArray) -> tuple[FloatArray, ...]:
        soft = compaction_law(p, SOFT * self.compaction, self.blend)
        stiff = compaction_law(p - self.loft, self.compaction, self.blend)
        return tuple(a + b for a, b in zip(soft, stiff, strict=True))

    def acting(self, x: FloatArray, state: Pairs) -> Acting:
        p = self.penetration(x, state)
        rows = np.flatnonzero(p > 0.0)
        value, first, second = self._law(p[rows])
        n, w = state.normal[rows], self.area[rows] * state.share[rows]
        force = -self.side * (w * first)[:, None] * n
        K = (w * second)[:, None, None] * n[:, :, None] * n[:, None]
        return Acting(rows, w * value, force, K)

    def slid(self, start: FloatArray, x: FloatArray) -> FloatArray:
        """(m,) how far nodes have slid since a start x, mm; nan without a pair then or now."""
        before, now = self.pairs(start), self.pairs(x)
        r = before.relative(x)
        s = r - (r * now.normal).sum(1)[:, None] * now.normal
        both = (before.share > 0) & (now.share > 0)
        return np.where(both, np.linalg.norm(s, axis=1), np.nan)

    def stiffness_bound(self, x: FloatArray) -> FloatArray:
        """(m, 12) shares of the row sums of the stiffness if every node touched, N/mm."""
        weights = np.abs(self.pairs(x).weights)
        shares = np.repeat(np.column_stack([np.ones(len(weights)), weights]), 3, axis=1)
        stiffness = (1.0 + SOFT) * self.compaction * self.area
        return (stiffness * shares.sum(1))[:, None] / 3 * shares


@dataclass(frozen=True, eq=False)
class PlyRubbing(Rubbing):
    """What friction remembers of what slides, by the pairs of the last commit and the present ones.

    `points` and `touched` are by those of the last commit, `anchor` by the present ones.
    """

    origin: FloatArray  # (m, 3) the anchor by the pairs of the last commit, mm
    from_dofs: IntArray  # (m, 12), and
    from_weights: FloatArray  # (m, 3) of these pairs
    triangles: IntArray  # (m,), and
    dofs: IntArray  # (m, 12), and
    weights: FloatArray  # (m, 3) of the present pairs


class PlyFriction(AtPairs, Friction):
    """Friction of a ply on another one, at the nodes of their contact."""

    def __init__(self, contact: PlyContact, friction: float) -> None:
        self.name = contact.name.replace("contact", "friction")
        self.contact, self.dofs, self.friction = contact, contact.dofs, friction
        self.sheet = contact.sheet
        self.stick = STICK * contact.compaction * contact.area
        self.lever = contact.side * contact.reach
        self._last = None

    def relative(self, x: FloatArray, state: PlyRubbing) -> FloatArray:
        """(m, 3) x - y - s t N, mm."""
        return self._sliding(x, state.dofs, state.weights)

    def _sliding(self, x: FloatArray, dofs: IntArray, weights: FloatArray) -> FloatArray:
        return relative(dofs, weights, x) - self.lever * _facets(x, dofs)[2]

    def slopes(self, x: FloatArray, state: PlyRubbing, rows: IntArray) -> FloatArray:
        J = super().slopes(x, state, rows)
        for corner, D in zip((1, 2, 3), _turning(*_facets(x, state.dofs[rows])), strict=True):
            J[:, :, 3 * corner : 3 * corner + 3] -= self.lever * D
        return J

    def curved(self, x: FloatArray, state: PlyRubbing, here: Acting) -> FloatArray:
        legs = _facets(x, state.dofs[here.rows])
        H = np.zeros((len(here.rows), 12, 12))
        H[:, 3:, 3:] = _curving(-self.lever * here.force, *legs)
        return H

    def initial(self, x: FloatArray) -> PlyRubbing:
        """Nodes that touch at x are anchored where they are."""
        pairs = self.contact.pairs(x)
        return self._committed(x, pairs, self.contact.penetration(x, pairs) > 0, 0.0)

    def _committed(
        self, x: FloatArray, pairs: Pairs, touches: np.ndarray, slide: FloatArray | float
    ) -> PlyRubbing:
        """State of a commit at x with a slide (m, 3) from the anchors of what touches (m,)."""
        p = self.contact.penetration(x, pairs)
        points = self._sliding(x, pairs.dofs, pairs.weights)
        anchor = np.where(touches[:, None], points - slide, np.nan)
        table = pairs.dofs, pairs.weights
        given = points, p, anchor, anchor, pairs.normal, self._limit(p, pairs), anchor
        return PlyRubbing(*given, *table, pairs.triangles, *table)

    def _limit(self, p: FloatArray, pairs: Pairs) -> FloatArray:
        return self.friction * self.contact.area * pairs.share * self.contact.pressure(p)

    def refresh(self, x: FloatArray, state: PlyRubbing) -> PlyRubbing:
        """Take pairs, normals and normal forces from x; what has slid is the same by all pairs.

        Anchors are found as in `Friction.refresh`. A node that had no pair at the last commit
        slides freely up to the next one.
        """
        pairs = self.contact.pairs(x, state)
        p = self.contact.penetration(x, pairs)
        points = self._sliding(x, state.from_dofs, state.from_weights)
        known = np.isfinite(state.p)
        clear = np.where(known, -state.p, 1.0)
        fresh = (clear >= 0) & (p > 0) & known
        part = np.where(fresh, clear / np.where(fresh, p + clear, 1.0), 0.0)
        touch = state.points + part[:, None] * (points - state.points)
        had = (fresh & ~np.isnan(state.origin[:, 0]))[:, None]
        origin = np.where(fresh[:, None], touch, state.touched)
        origin = np.where(had, state.origin, origin)
        limit = np.where(known, self._limit(p, pairs), 0.0)
        anchor = self._sliding(x, pairs.dofs, pairs.weights) - (points - origin)
        now = {"triangles": pairs.triangles, "dofs": pairs.dofs, "weights": pairs.weights}
        now |= {"normal": pairs.normal, "limit": limit, "origin": origin, "anchor": anchor}
        return replace(state, **now)

    def commit(self, x: FloatArray, state: PlyRubbing) -> PlyRubbing:
        """Move the anchors of what slips, by the present pairs; what has left loses its anchor."""
        p = self.contact.penetration(x, self.contact.pairs(x, state))
        points = self.relative(x, state)
        s, length = self._slide(points, state)
        keep = np.minimum(1.0, state.limit / (self.stick * np.maximum(length, 1e-300)))
        anchor = np.where((p > 0)[:, None], points - keep[:, None] * s, np.nan)
        start = {"from_dofs": state.dofs, "from_weights": state.weights, "origin": anchor}
        return replace(state, points=points, p=p, touched=anchor, anchor=anchor, **start)

    def carried(self, state: PlyRubbing | None, old: Standing | None, new: Standing) -> PlyRubbing:
        """Take over from another mesh: see `Friction.carried`."""
        contact, pressure = self.contact, np.zeros(len(self.stick))
        if state is not None and old is not None:
            theirs = old.term.contact
            pressure = interpolated(theirs.places, state.limit / theirs.area, contact.places)
        touched = pressure > 0
        start = self._committed(new.before, contact.pairs(new.before), touched, 0.0)
        p = np.where(touched, np.maximum(start.p, 1e-9 * contact.blend), np.minimum(start.p, 0.0))
        normal = contact.pairs(new.x).normal
        return replace(start, p=p, normal=normal, limit=pressure * contact.area)

    def acting(self, x: FloatArray, state: PlyRubbing) -> Acting:
        last = self._last
        if last is None or last[1] is not state or not same(last[0], x):
            rows = np.flatnonzero(state.limit > 0)
            points = self.relative(x, state)
            self._last = last = frozen(x), state, self._acting(points, state, rows)
        return last[2]


def _facets(x: FloatArray, dofs: IntArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Legs u, v (m, 3) of triangles, their unit normals (m, 3), and |u x v| (m,)."""
    a, b, c = x[dofs[:, 3:]].reshape(-1, 3, 3).transpose(1, 0, 2)
    u, v = b - a, c - a
    across = np.cross(u, v)
    length = np.maximum(np.linalg.norm(across, axis=1), 1e-300)
    return u, v, across / length[:, None], length


def _turning(
    u: FloatArray, v: FloatArray, N: FloatArray, length: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(m, 3, 3) derivatives of the unit normals of triangles by their corners."""
    Q = (np.eye(3) - N[:, :, None] * N[:, None]) / length[:, None, None]
    by_u, by_v = -Q @ skew(v), Q @ skew(u)
    return -by_u - by_v, by_u, by_v


def _curving(
    force: FloatArray, u: FloatArray, v: FloatArray, N: FloatArray, length: FloatArray
) -> FloatArray:
    """(m, 9, 9) second derivatives of force (m, 3) times the unit normals, by the corners."""
    kappa = (force * N).sum(1)
    q = (force - kappa[:, None] * N) / length[:, None]
    y = np.stack([force, np.zeros_like(force), u, v], axis=1)
    ones = np.array([[1.0, 0.0]] * len(force)).reshape(-1, 2)
    both = np.stack([kappa, np.zeros_like(kappa)], axis=1)
    slope = np.stack([q, np.zeros_like(q)], axis=1)
    H = second_derivative(ones, y, both, N, length, slope)[:, 6:, 6:]
    from_legs = np.kron(np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]]), np.eye(3))
    return from_legs.T @ H @ from_legs


def pair_name(pair: Iterable[Sheet]) -> str:
    """Numbers of two plies, such as 1_2."""
    return "_".join(sheet.name.rpartition(" ")[2] for sheet in pair)


def slip_between(start: FloatArray, pair: Sequence[PlyContact], x: FloatArray) -> float:
    """99th percentile of how far two plies have slid on each other since the start, mm, by area."""
    slid = np.concatenate([contact.slid(start, x) for contact in pair])
    area, known = np.concatenate([contact.area for contact in pair]), ~np.isnan(slid)
    return percentile(slid[known], area[known], 0.99) if known.any() else 0.0


def folds(sheets: Iterable[Sheet], x: FloatArray) -> str:
    """Message that names a sheet that folds on itself at x; empty if none does."""
    for sheet in sheets:
        if sheet.dim == 3 and folds_on_itself(sheet, x):
            return f"the {sheet.name} folds on itself, and self-contact is not modelled"
    return ""


def folds_on_itself(sheet: Sheet, x: FloatArray) -> bool:
    """Whether a node is nearer than half a thickness to a distant place of its own sheet."""
    blank, places = sheet.blank, sheet.positions(x)
    corners = places[blank.triangles]
    count = min(2 * NEAREST, len(corners))
    near = cKDTree(corners.mean(1)).query(places, count)[1]
    apart = np.linalg.norm(blank.nodes[:, None] - blank.centroids[near], axis=2)
    node, k = np.nonzero(apart > APART * blank.size)
    at = near[node, k]
    arm, legs = places[node] - corners[at, 2], corners[at, :2] - corners[at, 2:]
    n = np.cross(legs[:, 0], legs[:, 1])
    n /= np.linalg.norm(n, axis=1)[:, None]
    inside = _along(n, arm[:, None], legs[:, None])[:, 0].min(1) >= 0
    return bool((np.abs((n * arm).sum(1)[inside]) < 0.5 * sheet.fabric.thickness).any())


def _averages(sheet: Sheet) -> csr_array:
    """(n_nodes, n_nodes) repeated means of values at the nodes of a sheet and their neighbours."""
    edges, n = sheet.blank.mesh.facets, len(sheet.blank.nodes)
    own = np.arange(n)
    at = np.concatenate([own, *edges]), np.concatenate([own, *edges[::-1]])
    once = csr_array((np.ones(len(at[0])), at), shape=(n, n))
    once = once / once.sum(1)[:, None]
    mean = once
    for _ in range(SMOOTHED - 1):
        mean = mean @ once
    return csr_array(mean)


def nodal_normals(sheet: Sheet, places: FloatArray) -> FloatArray:
    """(n_nodes, 3) unit normals of a sheet at its nodes, at places (n_nodes, 3).

    With the weights of N. Max, J. Graphics Tools 4 (1999) 1-6, which are exact on a sphere.
    """
    triangles, n = sheet.blank.triangles, np.zeros_like(places)
    corners = places[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sides = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(2)  # squares, of 01, 12, 20
    for k in range(3):
        part = across / (sides[:, k] * sides[:, k - 1])[:, None]
        at = triangles[:, k]
        n += np.column_stack([np.bincount(at, w, minlength=len(n)) for w in part.T])
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


def _near(b: FloatArray) -> FloatArray:
    """Barycentric coordinates that do not lead far out of a triangle."""
    return np.clip(b, -2 * MARGIN, 1.0 + 2 * MARGIN)


def _rise(
    b: FloatArray, n: FloatArray, means: FloatArray, normals: FloatArray, places: FloatArray
) -> FloatArray:
    """(m,) h of points b (m, 3) in triangles with these places (m, 3, 3) of the corners, mm.

    The curvature along an edge is that of means n of the normals over `means` of the places.
    """
    b, rise = _near(b), np.zeros(len(b))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge, mean = places[:, j] - places[:, i], means[:, j] - means[:, i]
        curvature = ((n[:, j] - n[:, i]) * mean).sum(1) / np.maximum((mean**2).sum(1), 1e-300)
        twist = ((normals[:, i] + normals[:, j]) * edge).sum(1)
        bend = curvature * (edge**2).sum(1) + (b[:, j] - b[:, i]) * twist
        rise += 0.5 * b[:, i] * b[:, j] * bend
    return rise
