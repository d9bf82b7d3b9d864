"""Penalty contact between the sheet and a rigid tool: E = Σ w φ(p), p = t0/2 - d(y) - s.

The sum is over points of the sheet; y is the point in the tool's frame, d the tool's distance. φ is
C² and has no stiffness at touch: with the compaction stiffness k and the blending depth e

    φ(p) = k p³/(6 e)                     for 0 < p < e
    φ(p) = k (p²/2 - e p/2 + e²/6)        for p ≥ e

and w is the area of the sheet that the point stands for.

A net of straight edges is not the smooth sheet that it stands for: with its nodes on a tool of
curvature c it is shorter than the sheet by (c h)²/24, and its edges cut into the tool by c h²/8, by
c h²/12 in the mean. Therefore there are two sorts of points. *Nodes* touch with their place
averaged along both fibre lines, x + a (x₋ - 2 x + x₊), which lifts them by a c h² for each family
(`share`). *Middles of edges* touch when they are deeper than the sag s = l/8 of an edge l on a
radius as small as itself: they act only where a tool bends more sharply than the mesh can follow,
and bound what the nodes miss. (With s = 0 edges ride over fillets one by one: three times the
linear solves, and a force that ripples.)

The last local degrees of freedom are those of the tool, so that the force on a tool is a derivative
of the potential like any other: its height z, and the tilts a/L and b/L about x and y of a tool
that tilts, with

    y = Ry(b/L)' Rx(a/L)' (X - z e_z).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ..net.blank import Blank
from ..tools.shapes import Distance, Rounded, Tool
from ..unknowns import FloatArray, IntArray, Sheet
from .term import Term, frozen, same

BLEND = 0.05 / 1.004  # e, of the thickness
LEVER = 1 / 1.55  # L, of the blank's reach from the tool: tilts are the motion of a point there
LENGTH = 1 / 24  # a that keeps the length of one family of fibres on a curved tool
MEAN = 1 / 12  # a that puts the net on the tool in the mean
COARSE = 0.6  # of a tool's smallest radius: a coarser net jumps over it with a = 1/12
SAG = 1 / 8
FAR_OFF = 0.2  # of L: beyond it the distance is that of a tool's box
FLAT_FACE = 5.0  # of the thickness: what is nearer may lie under the flat face of a tool


@dataclass(frozen=True)
class Points:
    """Points of the sheet that may touch a tool, each a mean of nodes."""

    name: str
    nodes: IntArray  # (m, k)
    weights: FloatArray  # (m, k, 3) by node and component, which differ at a mirror plane
    areas: FloatArray  # (m,) area that a point stands for, mm²
    sag: FloatArray  # (m,) s, mm


def share(tool: Tool, size: float) -> float:
    """Return a, by which places are averaged along each family of fibres on a tool.

    A ball bends both families wherever it touches, and what counts is the length of the fibres on
    it: each family lifts the nodes by half of what 1/24 would. On edges and fillets the sheet bends
    over a short length, and what counts is the work of the contact force: the mean place, 1/12.
    """
    if getattr(tool.shape, "is_ball", False):
        return LENGTH / 2
    return LENGTH if size > COARSE * getattr(tool.shape, "sharpest", 0.0) > 0 else MEAN


def at_nodes(blank: Blank, share: float = LENGTH) -> Points:
    """Nodes, with their places averaged along the fibre lines by `share`."""
    n = len(blank.nodes)
    own = np.arange(n)
    nodes = np.repeat(own[:, None], 5, axis=1)
    weights = np.zeros((n, 5, 3))
    weights[:, 0] = 1.0
    for f, family in enumerate(("warp", "weft") if blank.pairs is None else ()):
        segments = blank.fibre_lines(family).t
        side = np.full((n, 2), -1)
        side[segments[1], 0], side[segments[0], 1] = segments
        along = blank.warp if family == "warp" else blank.weft
        parted = (np.array([np.bincount(ends, minlength=n) for ends in segments]) > 1).any(0)
        inner = (side >= 0).all(1) & ~parted  # a line parts at the end of a slit
        part = np.repeat(share * inner[:, None].astype(float), 3, axis=1)
        for axis, plane in enumerate("xy"):
            if plane in blank.mirror and abs(along[axis]) > 1 - 1e-8:
                on_plane = (np.abs(blank.nodes[:, axis]) < 1e-9) & (side >= 0).any(1)
                part[on_plane] = share  # the missing neighbour is the mirrored other one
                part[on_plane, axis] = 0.0
                side[on_plane] = side[on_plane].max(1)[:, None]
                inner |= on_plane
        for k in (0, 1):
            column = 1 + 2 * f + k
            nodes[inner, column] = side[inner, k]
            weights[inner, column] = part[inner]
            weights[inner, 0] -= part[inner]
    return Points("", nodes, weights, blank.node_areas, np.zeros(n))


def at_edges(blank: Blank) -> Points:
    """Middles of the edges, with the sag that an edge may have."""
    edges = blank.mesh.facets.T
    half = np.repeat(blank.areas / 3.0, 3)
    areas = np.bincount(blank.mesh.t2f.T.ravel(), half, minlength=len(edges))
    length = np.linalg.norm(np.diff(blank.nodes[edges], axis=1)[:, 0], axis=1)
    return Points(" between nodes", edges, np.full((*edges.shape, 3), 0.5), areas, SAG * length)


@dataclass(eq=False)
class _Last:
    """What a contact keeps of its last evaluation, and where its points are clear of the tool."""

    x: FloatArray | None = None
    y: FloatArray | None = None  # (m, 3) positions in the tool's frame, mm
    all: tuple[FloatArray, ...] | None = None
    acting: Acting | None = None
    centre: FloatArray | None = None  # (m, 3) where a point was when the tool was last evaluated
    clear: FloatArray | None = None  # (m,) how far a point can move from there without touching, mm


@dataclass(frozen=True, eq=False)
class Acting:
    """What acts on the points of the sheet that touch a tool, r of them, in the tool's frame."""

    rows: IntArray  # (r,) numbers of the points
    energy: FloatArray  # (r,) mJ
    force: FloatArray  # (r, 3) derivatives by the position, N
    stiffness: FloatArray  # (r, 3, 3) second derivatives, or their positive semi-definite part
    bend: FloatArray | None = None  # (r, 3, 3) what is taken from it in the exact one

    @cached_property
    def total(self) -> float:
        """Energy of all points, mJ."""
        return float(self.energy.sum())

    def exact(self, convex: bool) -> FloatArray:
        """(r, 3, 3) second derivatives; with `convex` positive semi-definite."""
        return self.stiffness if convex or self.bend is None else self.stiffness - self.bend


class AtPoints(Term):
    """An energy at the points of a contact, of which few act at a time."""

    selective = True
    together = "at points of a contact"
    contact: Contact

    def acting(self, x: FloatArray, state: Any) -> Acting:
        """What acts at x (n_dofs,)."""
        raise NotImplementedError

    def energy(self, x: FloatArray, state: Any = None) -> FloatArray:
        energy, here = np.zeros(len(self.dofs)), self.acting(x, state)
        energy[here.rows] = here.energy
        return energy

    def total(self, x: FloatArray, state: Any) -> float:
        return self.acting(x, state).total

    def gradient(self, x: FloatArray, state: Any = None) -> FloatArray:
        gradient, here = np.zeros(self.dofs.shape), self.acting(x, state)
        gradient[here.rows] = self.contact.pull_back(x, here.force, here.rows)
        return gradient

    def active(self, x: FloatArray, state: Any = None) -> IntArray:
        return self.acting(x, state).rows

    def hessian(
        self, x: FloatArray, state: Any, convex: bool, rows: IntArray | None = None
    ) -> FloatArray:
        """With `convex` without the curvature of the tool, and without its finite rotation."""
        here = self.acting(x, state)
        force = None if convex else here.force
        local = self.contact.pull_back_stiffness(x, here.exact(convex), force, here.rows)
        if rows is here.rows:
            return local
        H = np.zeros((len(self.dofs), *local.shape[1:]))
        H[here.rows] = local
        return H if rows is None else H[rows]

    def add_gradient(self, out: FloatArray, x: FloatArray, state: Any) -> None:
        here, contact = self.acting(x, state), self.contact
        if self.kernels and not contact.tool.tilts:
            given = here.rows, self.dofs, contact.shares, here.force
            self.kernels.add_point_forces(out, *given)
            return
        forces = contact.pull_back(x, here.force, here.rows)
        out += np.bincount(self.dofs[here.rows].ravel(), forces.ravel(), minlength=len(out))

    def add_hessians(
        self, values: FloatArray, x: FloatArray, states: Sequence, convex: bool, slots: IntArray
    ) -> None:
        if not self.kernels or self.contact.tool.tilts:
            super().add_hessians(values, x, states, convex, slots)
            return
        # what acts at a point is summed before it is spread to the nodes
        K, acts = np.zeros((len(self.dofs), 3, 3)), np.zeros(len(self.dofs), dtype=bool)
        for term, state in states:
            here = term.acting(x, state)
            self.kernels.gather(K, acts, here.rows, here.exact(convex))
        self.kernels.add_point_stiffness(values, acts, slots, self.contact.shares, K)


class Contact(AtPoints):
    """Normal contact of points of the sheet, by default its nodes, with one tool.

    The fabric supplies the thickness t0 and the compaction stiffness k, times the number of
    `plies`, which press on the tool together. `tool_dofs` (1,) or (3,) are the numbers in x of the
    tool's height and, if it tilts, of its tilts.

    A tool is evaluated only for points that it may touch: around each point that was found clear
    of it there is a ball in which it stays clear, as no distance changes faster than its place.
    """

    def __init__(
        self,
        sheet: Sheet,
        tool: Tool,
        tool_dofs: IntArray,
        points: Points | None = None,
        plies: int = 1,
    ) -> None:
        self.sheet, self.tool, self.tool_dofs = sheet, tool, np.ravel(tool_dofs)
        self.contact = self
        self.points = points or at_nodes(sheet.blank, share(tool, sheet.blank.size))
        self.name = f"{sheet.named('contact')} with {tool.name}{self.points.name}"
        m = len(self.points.nodes)
        nodal = sheet.dofs[self.points.nodes].reshape(m, -1)
        self.dofs = np.column_stack([nodal, np.tile(self.tool_dofs, (m, 1))])
        self.height_column = nodal.shape[1]
        component = np.tile(np.arange(3 * m).reshape(m, 3), (1, self.points.nodes.shape[1]))
        flat = 3 * self.points.nodes[:, :, None] + np.arange(3)
        mean = self.points.weights.ravel(), (component.ravel(), flat.ravel())
        self._mean = csr_array(mean, shape=(3 * m, sheet.dofs.size))  # places from nodes
        # node and height move the point relative to the tool along this axis, by this share
        self._axes = np.append(np.tile([0, 1, 2], nodal.shape[1] // 3), 2)
        self.shares = np.column_stack([self.points.weights.reshape(m, -1), np.full(m, -1.0)])
        self._last = _Last()
        self.blend = BLEND * sheet.fabric.thickness
        reach = np.abs(sheet.blank.nodes - tool.place).max()
        self.lever = float(f"{LEVER * reach:.9g}")  # without the round-off of a turned blank
        self.far_off = FAR_OFF * self.lever
        self.area = self.points.areas
        self.reach = 0.5 * sheet.fabric.thickness - self.points.sag
        self.plies, self.compaction = plies, plies * sheet.fabric.compaction

    @property
    def places(self) -> FloatArray:
        """(m, 2) flat places of the points, mm."""
        nodes = self.sheet.blank.nodes[self.points.nodes]
        return (self.points.weights[:, :, :2] * nodes).sum(1)

    def arm(self, x: FloatArray) -> FloatArray:
        """(m, 3) places of the points relative to the tool's origin, mm."""
        if self.kernels:
            return self.kernels.places(self.dofs, self.shares, x, *map(float, self.tool.place))
        places = self._mean @ self.sheet.positions(x).ravel()
        return places.reshape(-1, 3) - self.origin(x)

    def origin(self, x: FloatArray) -> FloatArray:
        """(3,) origin of the tool, mm."""
        return np.array([*self.tool.place, x[self.tool_dofs[0]]])

    def _into_frame(self, x: FloatArray) -> FloatArray:
        """(3, 3) turn into the tool's frame."""
        if not self.tool.tilts:
            return np.eye(3)
        A, B = self._turns(x)
        return B[0] @ A[0]

    def _turns(self, x: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Rx(a/L)' and Ry(b/L)' (3, 3) with their first and second derivatives by a and b."""
        tilt = x[self.tool_dofs[1:]]
        return _turn(tilt[0], self.lever, 1, 2), _turn(tilt[1], self.lever, 2, 0)

    def relative(self, x: FloatArray) -> FloatArray:
        """(m, 3) positions of the points in the tool's frame, mm."""
        return self._at(x).y

    def at(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Positions of all points in the tool's frame with d, n and its curvature there."""
        last = self._at(x)
        if last.all is None:
            last.all = (last.y, *self.distance(last.y))
        return last.all

    def _at(self, x: FloatArray) -> _Last:
        """What is kept for the last x."""
        last = self._last
        if last.x is None or not same(last.x, x):
            last.x, last.all, last.acting = frozen(x), None, None
            last.y = self.in_tool_frame(x, self.arm(x))
        return last

    def acting(self, x: FloatArray, state: None = None) -> Acting:
        last = self._at(x)
        if last.acting is None:
            near = self._within_reach(last)
            exact = isinstance(self.tool.shape, Rounded)  # there is no need of its box
            d, n, H = (self.tool.shape.distance if exact else self.distance)(last.y[near])
            boxed = not exact and getattr(self.tool.shape, "box", None) is not None
            last.acting = self._touching(last, near, d, n, H, self.far_off if boxed else np.inf)
        return last.acting

    def _within_reach(self, last: _Last) -> IntArray:
        """Numbers of the points that may touch the tool."""
        if last.centre is None:
            last.centre, last.clear = last.y.copy(), np.full(len(last.y), -np.inf)
        steepest = getattr(self.tool.shape, "steepest", 1.0) * (1 + 1e-9)
        if self.kernels:
            return self.kernels.may_touch(last.y, last.centre, last.clear, steepest)
        square = ((last.y - last.centre) ** 2).sum(1)
        clear = (last.clear >= 0.0) & (steepest**2 * square < last.clear**2)
        return np.flatnonzero(~clear)  # with those that are nowhere

    def _touching(
        self, last: _Last, near: IntArray, d: FloatArray, n: FloatArray, H: FloatArray, far: float
    ) -> Acting:
        """What acts on the points `near`, from their distances, which beyond `far` are a box's."""
        if self.kernels:
            given = last.y, self.reach, self.area, self.compaction, self.blend, far
            found = self.kernels.touching(near, d, n, H, *given, last.centre, last.clear)
            return Acting(*found)
        last.clear[near] = d - np.where(d >= far, far, self.reach[near])
        last.centre[near] = last.y[near]
        touch = np.flatnonzero(last.clear[near] < 0.0)
        rows, n = near[touch], n[touch]
        value, first, second = self._law(-last.clear[rows])
        area, nn = self.area[rows], n[:, :, None] * n[:, None, :]
        force = area * first
        K, bend = (area * second)[:, None, None] * nn, force[:, None, None] * H[touch]
        return Acting(rows, area * value, -force[:, None] * n, K, bend)

    def in_tool_frame(self, x: FloatArray, arm: FloatArray) -> FloatArray:
        """Turn (m, 3) places relative to the tool's origin into its frame."""
        return arm @ self._into_frame(x).T if self.tool.tilts else arm

    def distance(self, y: FloatArray) -> Distance:
        """Distance of the tool at (m, 3) positions in its frame; far away that to its box."""
        box = getattr(self.tool.shape, "box", None)
        if box is None:
            return self.tool.shape.distance(y)
        n, H = np.zeros_like(y), np.zeros((len(y), 3, 3))
        d = np.linalg.norm(y - np.clip(y, *box), axis=1)
        near = d < self.far_off
        d[near], n[near], H[near] = self.tool.shape.distance(y[near])
        return d, n, H

    def penetration(self, x: FloatArray) -> FloatArray:
        """(m,) p, mm; negative where the sheet is clear of the tool."""
        return self.reach - self.at(x)[1]

    def normal(self, x: FloatArray) -> FloatArray:
        """(m, 3) unit normals of the tool in its frame (the gradient of a grid is none)."""
        n = self.at(x)[2]
        return n / np.maximum(np.linalg.norm(n, axis=1), 1e-12)[:, None]

    def pressure(self, x: FloatArray) -> FloatArray:
        """(m,) contact pressure, MPa."""
        return self._law(self.penetration(x))[1]

    def stiffness_at(self, p: FloatArray) -> FloatArray:
        """(m,) φ'' at penetrations, N/mm³."""
        return self._law(p)[2]

    def nodal_force(self, x: FloatArray) -> FloatArray:
        """(n_nodes,) normal contact force spread to the nodes, N."""
        force = (self.area * self.pressure(x))[:, None] * self.points.weights.mean(2)
        n = len(self.sheet.blank.nodes)
        return np.bincount(self.points.nodes.ravel(), force.ravel(), minlength=n)

    def pull_back(
        self, x: FloatArray, force: FloatArray, rows: IntArray | slice = slice(None)
    ) -> FloatArray:
        """(m, n_local) local forces from (m, 3) derivatives by the position in the tool's frame."""
        if not self.tool.tilts:
            return self.shares[rows] * force[:, self._axes]
        local = self.shares[rows] * (force @ self._into_frame(x))[:, self._axes]
        return np.column_stack([local, *((force * swept).sum(1) for swept in self._swept(x, rows))])

    def pull_back_stiffness(
        self, x: FloatArray, H: FloatArray, force: FloatArray | None, rows: IntArray | slice
    ) -> FloatArray:
        """(m, n_local, n_local) from second (m, 3, 3) and first derivatives (m, 3) by y.

        Without `force` the part of the tool's finite rotation is left out.
        """
        J = self.shares[rows][:, None] * self._into_frame(x)[:, self._axes]
        if self.tool.tilts:
            J = np.concatenate([J, np.stack(self._swept(x, rows), axis=2)], axis=2)
        local = J.transpose(0, 2, 1) @ (H @ J)
        if force is None or not self.tool.tilts:
            return local
        A, B = self._turns(x)
        arm = self.arm(x)[rows]
        for i, turn in ((-2, B[0] @ A[1]), (-1, B[1] @ A[0])):
            row = self.shares[rows] * (force @ turn)[:, self._axes]
            local[:, i, :-2] += row
            local[:, :-2, i] += row
        for i, j, turn in ((-2, -2, B[0] @ A[2]), (-2, -1, B[1] @ A[1]), (-1, -1, B[2] @ A[0])):
            value = (force * (arm @ turn.T)).sum(1)
            local[:, i, j] += value
            local[:, j, i] += value if i != j else 0.0
        return local

    def _swept(self, x: FloatArray, rows: IntArray | slice = slice(None)) -> list[FloatArray]:
        """(m, 3) derivatives of y by both tilts."""
        A, B = self._turns(x)
        arm = self.arm(x)[rows]
        return [arm @ turn.T for turn in (B[0] @ A[1], B[1] @ A[0])]

    def stiffness_bound(self, x: FloatArray) -> FloatArray:
        """(m, n_local) shares of the row sums of the stiffness if every point touched, N/mm."""
        far = np.linalg.norm(self.arm(x), axis=1)[:, None] / self.lever
        tilts = [far, far] if self.tool.tilts else []
        nodal = np.abs(self.points.weights).reshape(len(far), -1)
        shares = np.column_stack([nodal, np.ones(len(far)), *tilts])
        total = nodal.sum(1)[:, None] / 3 + 1.0 + sum(tilts)
        return (0.5 * self.area * self.compaction)[:, None] * total * shares

    def depth_under(self, force: float, area: float) -> float:
        """Penetration at which a plate on `area` mm² of sheet carries `force` N (in the blend)."""
        return float(np.sqrt(2.0 * self.blend * force / (self.compaction * area)))

    def _law(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return compaction_law(p, self.compaction, self.blend)


def compaction_law(p: FloatArray, k: float, e: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """φ, φ', φ'' of penetrations (m,), mm."""
    p = np.maximum(p, 0.0)
    blend = p < e
    value = np.where(blend, p * p**2 / (6 * e), p**2 / 2 - e * p / 2 + e**2 / 6)
    first = np.where(blend, p**2 / (2 * e), p - e / 2)
    second = np.where(blend, p / e, 1.0)
    return k * value, k * first, k * second


def _turn(tilt: float, lever: float, i: int, j: int) -> list[FloatArray]:
    """Transposed rotation by tilt/L in the plane of axes i, j; its derivatives by the tilt."""
    c, s = np.cos(tilt / lever), np.sin(tilt / lever)
    series = []
    for order, (p, q) in enumerate(((c, s), (-s, c), (-c, -s))):
        R = np.zeros((3, 3))
        R[i, i], R[i, j], R[j, i], R[j, j] = p, q, -q, p
        R /= lever**order
        if order == 0:
            R[3 - i - j, 3 - i - j] = 1.0
        series.append(R)
    return series


def surrounds(contact: Contact, x: FloatArray) -> bool:
    """Whether the points under the flat face of the tool lie around its origin."""
    import shapely

    _, d, n, _ = contact.at(x)
    near = d < FLAT_FACE * contact.sheet.fabric.thickness
    under = contact.arm(x)[near & (np.abs(n[:, 2]) > 0.99), :2]
    for axis, plane in enumerate("xy"):
        if plane in contact.sheet.blank.mirror:  # there the modelled part continues
            flip = np.ones(2)
            flip[axis] = -1.0
            under = np.vstack([under, under * flip])
    return bool(shapely.MultiPoint(under).convex_hull.contains(shapely.Point(0.0, 0.0)))


def moment(contact: Contact, x: FloatArray) -> FloatArray:
    """(2,) moment of the contact forces on the tool about x and y through its origin, N mm."""
    y, _, n, _ = contact.at(x)
    force = (-contact.area * contact.pressure(x))[:, None] * n
    return np.cross(y, force).sum(0)[:2]
