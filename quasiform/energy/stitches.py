"""Stitches between two plies: threads that hold a point of one ply near a point of the other.

With the distance d between both points, the length L of the thread, and its stiffness k

    E = Σ k/2 (d - L)²  where d > L, else 0.

L is the distance of the mean surfaces of plies that lie on each other, and a slack: plies slide
by a little before the thread is taut, and do not part. Contact keeps them from coming nearer.
"""

from __future__ import annotations

import numpy as np
import skfem

from ..checks import InputError
from ..unknowns import FloatArray, IntArray, Sheet
from .term import Term


def triangles_under(sheet: Sheet, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """(m,) triangles and (m, 3) barycentric coordinates of points (m, 2) of the flat sheet.

    InputError for a point outside the sheet.
    """
    blank = sheet.blank
    mesh = skfem.MeshTri(blank.nodes.T.copy(), blank.triangles.T.copy(), validate=False)
    try:
        found = mesh.element_finder()(*points.T)
    except ValueError as error:
        raise InputError("a stitch lies outside the ply") from error
    corners = blank.nodes[blank.triangles[found]]
    sides = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    b = np.linalg.solve(sides, (points - corners[:, 0])[:, :, None])[:, :, 0]
    return found, np.column_stack([1.0 - b.sum(1), b])


class Stitches(Term):
    """Threads between two sheets at points (m, 2), mm, of stiffness (m,) N/mm, length (m,) mm."""

    name = "stitches"

    def __init__(
        self,
        above: Sheet,
        below: Sheet,
        points: FloatArray,
        stiffness: FloatArray,
        length: FloatArray,
    ) -> None:
        self.stiffness, self.length = stiffness, length
        self.sheets = above, below
        dofs, weights = [], []
        for sheet, sign in ((above, 1.0), (below, -1.0)):
            triangles, b = triangles_under(sheet, points)
            dofs.append(sheet.dofs[sheet.blank.triangles[triangles]].reshape(len(points), -1))
            weights.append(sign * b)
        self.dofs, self.weights = np.hstack(dofs), np.hstack(weights)

    def _taut(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(m,) distances of the points, (m, 3) directions, and (m,) what a thread is longer by."""
        y = np.einsum("mi,mic->mc", self.weights, x[self.dofs].reshape(-1, 6, 3))
        d = np.linalg.norm(y, axis=1)
        return d, y / np.maximum(d, 1e-300)[:, None], np.maximum(d - self.length, 0.0)

    def largest_force(self, x: FloatArray) -> float:
        """Of the threads, N."""
        return float((self.stiffness * self._taut(x)[2]).max())

    def energy(self, x: FloatArray, state: None = None) -> FloatArray:
        return 0.5 * self.stiffness * self._taut(x)[2] ** 2

    def gradient(self, x: FloatArray, state: None = None) -> FloatArray:
        _, t, longer = self._taut(x)
        force = (self.stiffness * longer)[:, None] * t
        return (self.weights[:, :, None] * force[:, None]).reshape(self.dofs.shape)

    def hessian(self, x: FloatArray, state: None, convex: bool) -> FloatArray:
        """Semi-definite everywhere."""
        d, t, longer = self._taut(x)
        along = t[:, :, None] * t[:, None, :]
        across = (longer / np.maximum(d, 1e-300))[:, None, None]
        local = np.where((longer > 0)[:, None, None], along + across * (np.eye(3) - along), 0.0)
        local *= self.stiffness[:, None, None]
        both = self.weights[:, :, None] * self.weights[:, None, :]
        H = both[:, :, None, :, None] * local[:, None, :, None, :]
        return H.reshape(*self.dofs.shape, -1)
