"""Dynamic relaxation with kinetic damping: equilibrium as the rest of a damped motion.

Leapfrog steps of unit length with fictitious masses from Gershgorin's bound on the convex tangent,
the full contact stiffness included whether or not a node touches; whenever the kinetic energy has
passed a peak the motion is stopped and started anew from there. It needs gradients only, so it gets
along where tangents are bad, some forty times slower than Newton where they are not.

References: A. S. Day (1965) "An introduction to dynamic relaxation", The Engineer 219; P. Cundall
(1976) for kinetic damping.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from ..energy.contact import Contact
from ..energy.plies import PlyContact
from ..unknowns import FloatArray
from .equilibrium import Equilibrium
from .linear import NotConvergedError

RAMP, REFRESHED = 400, 50  # iterations


def relax(
    equilibrium: Equilibrium,
    x: FloatArray,
    motion: FloatArray,
    tolerance: float | None = None,
    max_iterations: int = 40_000,
) -> tuple[FloatArray, float]:
    """Relax a state to equilibrium; it and the kinetic energy that was taken out, mJ.

    The motion (n_dofs,) of the prescribed unknowns is spread over the first `RAMP` iterations.
    Masses and lagged values are updated every `REFRESHED` iterations.
    """
    tolerance = tolerance or equilibrium.goal
    free, nodes = equilibrium.free, equilibrium.model.unknowns.at_nodes()
    v = np.zeros_like(x)
    kinetic_before = damped = 0.0
    ramp = RAMP if motion.any() else 0
    for iteration in range(max_iterations):
        equilibrium.relaxed += 1
        if iteration < ramp:
            x = x + motion / ramp
        if iteration % (REFRESHED if iteration >= ramp else RAMP // 20) == 0:
            mass = _masses(equilibrium, x)
            equilibrium.refresh(x)
        g = equilibrium.gradient(x)
        residual = equilibrium.residual(g)
        # a residual counts with refreshed friction only
        settled = not equilibrium.remembers or iteration % REFRESHED == 0
        if residual < tolerance and settled and iteration >= ramp:
            return x, damped
        a = np.where(free, -g / mass, 0.0)
        v_next = v + a if v.any() else 0.5 * a
        kinetic = float((mass * v_next**2)[free].sum())
        if kinetic < kinetic_before:
            x = x - 0.5 * v  # back to about the peak
            v = np.zeros_like(v)
            damped += 0.5 * kinetic_before
            kinetic_before = 0.0
            continue
        v, kinetic_before = v_next, kinetic
        x = x + v
        if not np.abs(v[nodes]).max() < equilibrium.mesh_size:
            raise NotConvergedError("dynamic relaxation diverged")
    raise NotConvergedError(
        f"dynamic relaxation: residual {residual:.1e} after {max_iterations} iterations, "
        f"largest {equilibrium.worst(g)}"
    )


def _masses(equilibrium: Equilibrium, x: FloatArray) -> FloatArray:
    """(n_dofs,) masses that keep unit time steps stable: Σ_j |K_ij| / 2."""
    model, potential = equilibrium.model, equilibrium.potential
    values, _ = potential.hessian(x, equilibrium.memory, convex=True)
    upper = csr_array((np.abs(values), potential.pattern.indices, potential.pattern.indptr))
    upper.resize(potential.pattern.shape)
    rows = np.asarray(upper.sum(1)) + np.asarray(upper.sum(0)) - upper.diagonal()
    sums = np.ones_like(x)
    sums[equilibrium.free] = rows
    for term, state in zip(model.terms, equilibrium.memory, strict=True):
        if isinstance(term, Contact | PlyContact):
            stiffness, dofs = term.stiffness_bound(x), term.stencils(state)
            sums += np.bincount(dofs.ravel(), stiffness.ravel(), minlength=len(x))
    return 0.5 * sums
