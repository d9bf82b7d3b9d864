"""An energy of your own: stitching yarns that resist shear in one direction only.

A yarn runs across each cell of the net along its diagonal, and is taut only where that grows. With
the rest length L, the vector d between its ends and the strain e = max(½(|d|²/L² - 1), 0)

    E = ½ K L e²,   ∂E/∂d = K e d/L,   ∂²E/∂d² = K (e 1 + d d'/L²)/L   where e > 0,

with the stiffness K in N. Model and solver need nothing else than the numbers of the unknowns of
each yarn and these three formulas. The yarns are part of the model's recipe, so that they are there
on the coarser meshes by which the error is estimated, too.
"""

import numpy as np

import quasiform as qf


class Stitching(qf.Term):
    """Tension-only yarns between pairs of nodes, (m, 2) node numbers; stiffness K, N."""

    name = "stitching"

    def __init__(self, sheet, ends, stiffness):
        self.dofs = sheet.dofs[ends].reshape(len(ends), -1)
        flat = sheet.blank.nodes[ends]
        self.length = np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1)
        self.stiffness = stiffness

    def _strain(self, x):
        d = np.diff(x[self.dofs].reshape(len(self.dofs), 2, -1), axis=1)[:, 0]
        return d, np.maximum(0.5 * ((d**2).sum(1) / self.length**2 - 1), 0)

    def energy(self, x, state=None):
        """(m,) energy, mJ."""
        return 0.5 * self.stiffness * self.length * self._strain(x)[1] ** 2

    def gradient(self, x, state=None):
        """(m, 4) forces, N."""
        d, e = self._strain(x)
        pull = (self.stiffness * e / self.length)[:, None] * d
        return np.hstack([-pull, pull])

    def hessian(self, x, state, convex):
        """(m, 4, 4) stiffness, N/mm; never indefinite, so `convex` changes nothing."""
        d, e = self._strain(x)
        L = self.length[:, None, None]
        K = e[:, None, None] * np.eye(d.shape[1]) + d[:, :, None] * d[:, None, :] / L**2
        K *= self.stiffness * (e > 0)[:, None, None] / L
        return np.block([[K, -K], [-K, K]])


def diagonals(blank, direction):
    """Node pairs on the diagonals of the cells that run along a flat direction."""
    edges = blank.mesh.facets.T
    along = np.abs(np.diff(blank.nodes[edges], axis=1)[:, 0] @ direction)
    length = np.linalg.norm(np.diff(blank.nodes[edges], axis=1)[:, 0], axis=1)
    return edges[along > 0.99 * length]


def stitch(model):
    """Add yarns along the load, where the cells grow; half as stiff on half as wide cells."""
    ends = diagonals(model.sheet.blank, np.array([1.0, 0.0]))
    model.terms.append(Stitching(model.sheet, ends, stiffness=0.5 * model.size / 20))


model = qf.off_axis_tension(displacement=20, size=20)
plain = qf.solve(model, estimate=False)
stitched = qf.solve(model.including(stitch))

error = stitched.estimate["force_N"]
print(f"force without stitching {plain.force:.2f} N, with it {stitched.force:.2f} ± {error:.2f} N")
