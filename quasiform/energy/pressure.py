"""Pressure on the upper face of a sheet, which follows the sheet: E = p V.

V is the volume of the cones from a point o to the triangles (x1, x2, x3), seen from above
counter-clockwise,

    V = Σ (x1 - o)·[(x2 - o) x (x3 - o)] / 6.

Its derivative by a node is the area vector of that node, so that p > 0 pushes against the normal.
That is the whole load where the edge is fixed or lies in a mirror plane through o. At a free edge
V has cones over the edge too, whose force on both nodes of an edge (xa, xb) is -p (xa x xb)/6. A
pressure that ends at a free edge has no potential: its stiffness is not symmetric [1]_, [2]_.
`PressureAtEdge` adds

    E = p Σ [m·(xb x xa)/6 + c·(xa + xb)],   m = (xa + xb)/2,   c = (xa x xb)/12,

with m and c lagged. At the last refresh the sum of both has the force of the pressure on the face,
no more, and its Hessian is the symmetric part of the stiffness. p, MPa, is a prescribed unknown.

References
----------
.. [1] H. D. Hibbitt, Int. J. Numer. Methods Eng. 14 (1979) 937-941.
.. [2] K. Schweizerhof, E. Ramm, Comput. Struct. 18 (1984) 1099-1114.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..net.blank import Blank
from ..unknowns import FloatArray, IntArray, Sheet
from .bending import skew
from .term import Standing, Term

PRESSURE_FORCE = "pressure_force_N"  # column of the history


class Pressure(Term):
    """Pressure p = x[dof] on the upper face, or `up` on the lower one; o at z = `height`, mm."""

    name = "pressure"
    load = True

    def __init__(self, sheet: Sheet, dof: int, height: float = 0.0, up: bool = False) -> None:
        self.sign = -1.0 if up else 1.0
        self.sheet, self.dof, self.origin = sheet, dof, np.array([0.0, 0.0, height])
        self.area = float(sheet.blank.areas.sum())  # of the flat sheet, mm²
        corners = sheet.dofs[sheet.blank.triangles].reshape(-1, 9)
        self.dofs = np.column_stack([corners, np.full(len(corners), dof)])

    def _corners(self, x: FloatArray) -> FloatArray:
        """(3, n, 3) corners of the triangles from o, mm."""
        return x[self.dofs[:, :9]].reshape(-1, 3, 3).swapaxes(0, 1) - self.origin

    def volumes(self, x: FloatArray) -> FloatArray:
        """(n,) volumes under the triangles, mm³."""
        a, b, c = self._corners(x)
        return self.sign * (a * np.cross(b, c)).sum(1) / 6.0

    def areas(self, x: FloatArray) -> FloatArray:
        """(n, 9) derivatives of the volumes by the corners, mm²."""
        a, b, c = self._corners(x)
        return self.sign * np.hstack([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6.0

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return x[self.dof] * self.volumes(x)

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        return np.column_stack([x[self.dof] * self.areas(x), self.volumes(x)])

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """With `convex` only the mixed derivative, which is not a stiffness."""
        H = np.zeros((len(self.dofs), 10, 10))
        H[:, 9, :9] = H[:, :9, 9] = self.areas(x)
        if not convex:
            a, b, c = self._corners(x)
            for (i, j), side in (((0, 3), -c), ((0, 6), b), ((3, 6), -a)):
                part = self.sign * x[self.dof] * skew(side) / 6.0
                H[:, i : i + 3, j : j + 3] = part
                H[:, j : j + 3, i : i + 3] = part.swapaxes(1, 2)
        return H


@dataclass(frozen=True, eq=False)
class EdgePlaces:
    """Where the nodes of the edges were at the last refresh."""

    places: FloatArray  # (n, 2, 3) from o, mm
    pressure: FloatArray  # (n,) p there, MPa


class PressureAtEdge(Term):
    """What takes the cones over the free edges out of the load of a pressure."""

    name = "pressure at the edge"

    def __init__(self, pressure: Pressure) -> None:
        self.pressure, self.sheet = pressure, pressure.sheet
        ends = self.sheet.dofs[free_edges(self.sheet.blank)].reshape(-1, 6)
        self.dofs = np.column_stack([ends, np.full(len(ends), pressure.dof)])

    def _ends(self, x: FloatArray) -> FloatArray:
        return x[self.dofs[:, :6]].reshape(-1, 2, 3) - self.pressure.origin

    def initial(self, x: FloatArray) -> EdgePlaces:
        return EdgePlaces(self._ends(x), x[self.dofs[:, 6]])

    def refresh(self, x: FloatArray, state: EdgePlaces) -> EdgePlaces:
        return self.initial(x)

    commit = refresh

    def carried(self, state: EdgePlaces | None, old: Standing | None, new: Standing) -> EdgePlaces:
        return self.initial(new.x)

    def _lagged(self, state: EdgePlaces) -> tuple[FloatArray, FloatArray]:
        """Lagged m and c (n, 3), with the sign of the pressure."""
        a, b = state.places.swapaxes(0, 1)
        return 0.5 * self.pressure.sign * (a + b), self.pressure.sign * np.cross(a, b) / 12.0

    def _volumes(self, ends: FloatArray, state: EdgePlaces) -> FloatArray:
        """(n,) volumes E/p, mm³."""
        (a, b), (m, c) = ends.swapaxes(0, 1), self._lagged(state)
        return (m * np.cross(b, a)).sum(1) / 6.0 + (c * (a + b)).sum(1)

    def dissipated(self, before: EdgePlaces, after: EdgePlaces, x: FloatArray) -> float:
        """Work of the part that has no potential, by the trapezoidal rule."""
        started, ended = before.places, self._ends(x)
        change = before.pressure * (self._volumes(started, after) - self._volumes(started, before))
        change += after.pressure * (self._volumes(ended, after) - self._volumes(ended, before))
        return float(-0.5 * change.sum())

    def energy(self, x: FloatArray, state: EdgePlaces) -> FloatArray:
        return x[self.pressure.dof] * self._volumes(self._ends(x), state)

    def _areas(self, x: FloatArray, state: EdgePlaces) -> FloatArray:
        (a, b), (m, c) = self._ends(x).swapaxes(0, 1), self._lagged(state)
        return np.hstack([np.cross(m, b) / 6.0 + c, np.cross(a, m) / 6.0 + c])

    def gradient(self, x: FloatArray, state: EdgePlaces) -> FloatArray:
        volumes = self._volumes(self._ends(x), state)
        return np.column_stack([x[self.pressure.dof] * self._areas(x, state), volumes])

    def hessian(self, x: FloatArray, state: EdgePlaces, convex: bool) -> FloatArray:
        """With `convex` only the mixed derivative, which is not a stiffness."""
        H = np.zeros((len(self.dofs), 7, 7))
        H[:, 6, :6] = H[:, :6, 6] = self._areas(x, state)
        if not convex:
            part = x[self.pressure.dof] * skew(self._lagged(state)[0]) / 6.0
            H[:, :3, 3:6], H[:, 3:6, :3] = part, part.swapaxes(1, 2)
        return H


def free_edges(blank: Blank) -> IntArray:
    """(n, 2) nodes of the edges of a blank, which is on their left; none in a mirror plane."""
    edges = np.vstack([np.column_stack([ring[:-1], ring[1:]]) for ring in blank.outline])
    inside = np.zeros(len(edges), dtype=bool)
    for axis, plane in enumerate("xy"):
        if plane in blank.mirror:
            inside |= (np.abs(blank.nodes[edges, axis]) < 1e-9).all(1)
    return edges[~inside]
