"""An energy with memory: stitching yarns that soften for good as they are stretched.

A yarn runs along each diagonal of the cells that grows under load. With the rest length L, the
vector d between its ends, the strain e = max(½(|d|²/L² - 1), 0) and the largest strain κ so far,

    σ(e) = K e exp(-e/e0)                               where e ≥ κ, on the envelope
    σ(e) = k e,  k = K exp(-κ/e0)                       where e < κ
    E = L [½ k κ² + G(e) - G(κ)]  or  ½ L k e²,
    G(e) = ∫ σ = K e0² [1 - (1 + e/e0) exp(-e/e0)].

κ is the state. It changes in `commit` only, after a converged increment, and what it costs is
dissipated: L [½ k0 κ0² + G(κ1) - G(κ0) - ½ k1 κ1²]. The run owns the state: reset, checkpoint,
transfer to a finer mesh and energy balance come without another line.
"""

from dataclasses import dataclass

import numpy as np

import quasiform as qf


@dataclass(frozen=True)
class Stretched:
    """Largest strain so far of each yarn, (m,)."""

    kappa: np.ndarray


class SofteningYarns(qf.Term):
    """Yarns between pairs of nodes, (m, 2) node numbers; stiffness K, N, and strain e0."""

    name = "softening yarns"

    def __init__(self, sheet, ends, stiffness, e0):
        self.dofs = sheet.dofs[ends].reshape(len(ends), -1)
        self.length = np.linalg.norm(np.diff(sheet.blank.nodes[ends], axis=1)[:, 0], axis=1)
        self.stiffness, self.e0 = stiffness, e0

    def _strain(self, x):
        d = np.diff(x[self.dofs].reshape(len(self.dofs), 2, -1), axis=1)[:, 0]
        return d, np.maximum(0.5 * ((d**2).sum(1) / self.length**2 - 1), 0)

    def _G(self, e):
        return self.stiffness * self.e0**2 * (1 - (1 + e / self.e0) * np.exp(-e / self.e0))

    def _secant(self, e, state):
        return self.stiffness * np.exp(-np.maximum(e, state.kappa) / self.e0)

    def initial(self, x):
        return Stretched(np.zeros(len(self.dofs)))

    def commit(self, x, state):
        return Stretched(np.maximum(state.kappa, self._strain(x)[1]))

    def dissipated(self, before, after, x):
        spent = self._G(after.kappa) - self._G(before.kappa)
        for sign, state in ((1, before), (-1, after)):
            spent += sign * 0.5 * self._secant(0.0, state) * state.kappa**2
        return float(self.length @ spent)

    def energy(self, x, state):
        e = self._strain(x)[1]
        below, kappa = np.minimum(e, state.kappa), state.kappa
        beyond = self._G(np.maximum(e, kappa)) - self._G(kappa)
        return self.length * (0.5 * self._secant(0.0, state) * below**2 + beyond)

    def gradient(self, x, state):
        d, e = self._strain(x)
        pull = (self._secant(e, state) * e / self.length)[:, None] * d
        return np.hstack([-pull, pull])

    def hessian(self, x, state, convex):
        d, e = self._strain(x)
        secant, L = self._secant(e, state), self.length[:, None, None]
        slope = secant * np.where(e > state.kappa, 1 - e / self.e0, 1.0)
        if convex:
            slope = np.maximum(slope, 0.0)
        K = (secant * e)[:, None, None] * np.eye(d.shape[1])
        K = (K + slope[:, None, None] * d[:, :, None] * d[:, None, :] / L**2) / L
        K *= (e > 0)[:, None, None]
        return np.block([[K, -K], [-K, K]])


def stitched(model):
    """Add the yarns; as part of the recipe this is done on every mesh."""
    nodes, edges = model.sheet.blank.nodes, model.sheet.blank.mesh.facets.T
    step = np.diff(nodes[edges], axis=1)[:, 0]
    along = np.abs(step[:, 0]) > 0.99 * np.linalg.norm(step, axis=1)  # the load acts along x
    stiffness = 0.14 * model.sheet.blank.size  # N: yarns of 0.14 N/mm of width, on every mesh
    model.terms.append(SofteningYarns(model.sheet, edges[along], stiffness, e0=0.2))


if __name__ == "__main__":
    model = qf.off_axis_tension(displacement=40, size=20).including(stitched)
    first, second = qf.solve(model), qf.solve(model)

    print(f"force at the end: {first.force:.3f} ± {first.estimate['force_N']:.3f} N")
    print(f"the second run is the first, bit for bit: {first.force == second.force}")
    print(f"energy balance open by {100 * first.energy_balance:.3f} %")
