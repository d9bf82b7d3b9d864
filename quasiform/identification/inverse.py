"""Inverse identification: the six parameters from tests that are solved by finite elements.

Each off-axis test is solved at a few displacements, more of them where the force rises steeply.
Between these, the ratio of its force to the power balance (`specimen`) is interpolated, which is
smooth where the force is not. A picture frame is in uniform shear and needs no elements.

The derivatives come from the converged states. With the tangent K, the response v = dx/du of the
sheet to the grip, the volumes V and the gradient dI6 of the invariant of each triangle,

    df/dθ = Σ V (∂S12/∂θ) dI6·v,      K dx/dθ = -Σ V (∂S12/∂θ) dI6,

so one factorisation of each state serves all parameters. The least squares shorten a step to a law
under which a test finds no equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy as sp  # its parts load when they are used

from ..fabric import Fabric, ThreeStageLaw
from ..scenes.fabric_tests import off_axis_tension
from ..solve.equilibrium import Equilibrium, NotConvergedError
from ..solve.newton import minimise, predict
from .energy_method import Forces
from .fit import LOCKING, NAMES, Fit, Unknowns, choose, report, search
from .records import Curve
from .specimen import OffAxis, Specimen

FloatArray = np.ndarray
TOLERANCE = 1e-5  # relative change of cost and parameters
POINTS = 20  # displacements at which a test is solved
ANGLE_SIGMA = np.radians(0.5)  # of a measured angle at the centre, *assumed*


def identify_by_elements(
    tests: Sequence[tuple[Specimen, Curve, Forces]],
    start: Fit,
    fabric: Fabric,
    size: float,
    keep: Mapping[str, float] | None = None,
) -> Fit:
    """Fit the three-stage law to tests solved by finite elements of an edge `size`, mm.

    The fit starts from that by the power balance, whose choice of a third stage is tried first.
    """
    keep = dict(keep or {})
    if len(keep) == len(NAMES):
        return start
    models = [
        Sheet(*test, fabric, size, start.law) if isinstance(test[0], OffAxis) else test[2]
        for test in tests
    ]
    top = max(float(np.sin(forces.angles).max()) for *_, forces in tests)
    kept, free, trials = keep.keys() & set(LOCKING), [n for n in NAMES if n not in keep], []
    law, third = start.law, keep.get("I_lo", 0.0) < top  # whether a third stage is tested
    if third and len(kept) < 2:
        if law.I_lo >= top:  # the power balance found none: start with one late in the range
            begun = {"I_lo": 0.8 * top, "C_lo": max(law.C_mid, 0.1 * law.C_ini)}
            law = replace(law, **(begun | {name: keep[name] for name in kept}))
        trials.append(search(models, Unknowns(law, free), TOLERANCE))
    if not trials or not kept:
        law = start.law if kept else replace(start.law, I_lo=top, C_lo=0.0)
        early = [name for name in free if name not in LOCKING]
        trials.append(search(models, Unknowns(law, early), TOLERANCE))
    return report(models, *choose(trials), keep)


class Sheet:
    """The finite-element model of one off-axis test, with cells of an edge `size`, mm.

    `forces` are those in the power balance; the points are placed by an estimate of the law.
    """

    def __init__(
        self, specimen: OffAxis, curve: Curve, forces: Forces, fabric: Fabric, size: float, law: Any
    ) -> None:
        def balance(u: FloatArray) -> Forces:
            """The power balance with the kinematic angle, even where another was measured."""
            return Forces(u, u, *specimen.shares(Curve(u, u, None, u), fabric.thickness))

        self.curve, self.fabric, self.force, self.sigma = curve, fabric, forces.force, forces.sigma
        u = specimen.displacement(curve)
        self.model = off_axis_tension(
            specimen.angle, fabric, specimen.length, specimen.width, float(u.max()), size
        )
        self.angle = self.model.measures["shear_angle_center_deg"]
        self.equilibrium = Equilibrium(self.model, tolerance=1e-6)
        self.at_rows = balance(u)
        # a coordinate along which the ratio is smooth at the onset of locking too
        along = u / u.max() + 0.5 * np.log(self.at_rows.predicted(law))
        stations = np.linspace(along[0], along[-1], POINTS)
        self.points = np.interp(stations, along, u)
        self.at_points = balance(self.points)
        # interpolates from the points to the rows
        self.to_rows = sp.interpolate.CubicSpline(stations, np.eye(POINTS))(along)
        self.with_angle = curve.shear_angle is not None and curve.displacement is not None
        self.rows = len(u) * (2 if self.with_angle else 1)

    def states(self, law: ThreeStageLaw) -> list[FloatArray]:
        """Equilibria at the points; NotConvergedError where there is none."""
        self.model.membrane.fabric = replace(self.fabric, shear=law)
        x, u, found = self.model.x0, 0.0, []
        for goal in self.points:
            x, u = self._advance(x, u, goal), goal
            found.append(x)
        return found

    def _advance(self, x: FloatArray, u: float, goal: float, halvings: int = 5) -> FloatArray:
        self.equilibrium.travel = u
        try:
            return minimise(self.equilibrium, predict(self.equilibrium, x, goal), max_iterations=60)
        except NotConvergedError:
            if not halvings:
                raise
        middle = 0.5 * (u + goal)
        x = self._advance(x, u, middle, halvings - 1)
        return self._advance(x, middle, goal, halvings - 1)

    def _force(self, x: FloatArray) -> float:
        return self.equilibrium.force(self.equilibrium.gradient(x))

    def predicted(self, law: ThreeStageLaw) -> FloatArray:
        """(n,) forces of the rows; NotConvergedError as `states`."""
        ratio = [self._force(x) for x in self.states(law)] / self.at_points.predicted(law)
        return self.to_rows @ ratio * self.at_rows.predicted(law)

    def residual(self, unknowns: Unknowns, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `Forces.residual`; infinite where the test has no equilibrium under this law."""
        try:
            states = self.states(unknowns.law(p))
            slopes = [self._slopes(x, self._rate(x), unknowns, p) for x in states]
        except NotConvergedError:
            return np.full(self.rows, np.inf), np.full((self.rows, len(p)), np.nan)
        dforce, dangle = (np.array(part) for part in zip(*slopes, strict=True))
        force = np.array([self._force(x) for x in states])
        r, J = self._misfit(force, dforce, unknowns, p)
        if not self.with_angle:
            return r, J
        angle = np.radians([self.angle(x) for x in states])
        off = (self.to_rows @ angle - self.curve.shear_angle) / ANGLE_SIGMA
        return np.append(r, off), np.vstack([J, self.to_rows @ dangle / ANGLE_SIGMA])

    def _misfit(
        self, force: FloatArray, dforce: FloatArray, unknowns: Unknowns, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals of the rows, and their derivatives, from forces at the points and theirs."""
        # force(u) = ratio(u) balance(u), the ratio interpolated
        law, sigma = unknowns.law(p), self.sigma
        points, rows = self.at_points.predicted(law), self.at_rows.predicted(law)
        ratio = force / points
        dratio = dforce - ratio[:, None] * unknowns.slopes(p, self.at_points.predicted)
        dratio /= points[:, None]
        r = (self.to_rows @ ratio * rows - self.force) / sigma
        J = (self.to_rows @ ratio)[:, None] * unknowns.slopes(p, self.at_rows.predicted)
        return r, (J + rows[:, None] * (self.to_rows @ dratio)) / sigma[:, None]

    def _rate(self, x: FloatArray) -> FloatArray:
        """(n_dofs,) derivative of the state by the displacement; factors the tangent at x."""
        v = np.where(self.model.fixed, self.model.drive, 0.0)
        _, load = self.equilibrium.factor(x, False, motion=v)
        v[self.equilibrium.free] = -self.equilibrium.tangent.solve(load)
        return v

    def _angle_slope(self, x: FloatArray, g: FloatArray) -> float:
        """Derivative of the centre angle, rad, where that of all forces is g (n_dofs,).

        The tangent at x is factored.
        """
        dx, free = np.zeros(len(x)), self.equilibrium.free
        dx[free] = -self.equilibrium.tangent.solve(g[free])
        h = 1e-3 / max(np.abs(dx).max(), 1e-300)
        return np.radians((self.angle(x + h * dx) - self.angle(x - h * dx)) / (2 * h))

    def _slopes(
        self, x: FloatArray, v: FloatArray, unknowns: Unknowns, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives (k,) of the force (N) and of the centre angle (rad); v is the rate of x."""
        membrane = self.model.membrane
        f, fv = membrane.fibres(x), membrane.fibres(v)
        I6 = (f[:, 0] * f[:, 1]).sum(1)
        rate = (f[:, 0] * fv[:, 1] + f[:, 1] * fv[:, 0]).sum(1)
        dS12 = membrane.volume[:, None] * unknowns.slopes(p, lambda law: law.stress(I6))
        dangle = np.zeros(len(p))
        for i, column in enumerate(dS12.T if self.with_angle else []):
            push = membrane.g.transpose(0, 2, 1) @ (column[:, None, None] * f[:, ::-1])
            g = np.bincount(membrane.dofs.ravel(), push.ravel(), minlength=len(x))
            dangle[i] = self._angle_slope(x, g)
        return rate @ dS12, dangle
