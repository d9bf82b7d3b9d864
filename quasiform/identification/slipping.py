"""Inverse identification of shear law and slip together (`energy.slip`).

Slip lowers the force already where it is elastic, so a law that was found without it is too soft.
The forces, and the angle at the centre where it was measured, are those of finite elements with
slip. The load of such a test only grows: slip is taken without its memory, as a potential D(|d|).
So the derivatives of a converged state hold for slip too: with g_θ the derivative of all forces by
K or τ,

    df/dθ = g_θ·v,      K dx/dθ = -g_θ,      v = dx/du.

K and τ lower the same forces: their intervals and their correlation show how far the tests tell
them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..energy.slip import ENDLESS, SlipWidth
from ..fabric import Fabric, Slip, TabulatedLaw, ThreeStageLaw
from ..solve.equilibrium import Equilibrium
from .energy_method import Forces
from .fit import UNSEEN, Parameter, Trial, Unknowns
from .inverse import Sheet
from .records import Curve
from .specimen import OffAxis

FloatArray = np.ndarray
WIDEST = 7.0  # of the logarithm of K and τ from their start
SURE = 1.0  # half a 95 % interval of such a logarithm: beyond, it is not identified


@dataclass(frozen=True)
class SlippingLaw:
    """Shear law and slip."""

    shear: ThreeStageLaw | TabulatedLaw
    slip: Slip

    def stress(self, I6: FloatArray) -> FloatArray:
        """S12 of the shear law, MPa; same shape as `I6`."""
        return self.shear.stress(I6)


class Table:
    """A tabulated law as numbers of order one: the steps of its stress over those of a start."""

    def __init__(self, start: TabulatedLaw) -> None:
        self.I6, self.steps = start.I6[1:], np.diff(start.S12)
        self.free = [f"S12 at I6 = {I6:.3g}" for I6 in self.I6]
        self.start = np.ones(len(self.steps))
        self.bounds = np.outer([1e-3, 1e3], self.start)

    @classmethod
    def through(cls, law: TabulatedLaw, degrees: Sequence[float]) -> Table:
        """Start with the stress of a law at some shear angles."""
        I6 = np.sin(np.radians(degrees))
        S12 = np.maximum.accumulate(law.stress(I6))
        rise = 1e-4 * S12[-1] * np.arange(1, len(I6) + 1)  # where it does not rise
        return cls(TabulatedLaw(tuple(I6.tolist()), tuple((S12 + rise).tolist())))

    def law(self, p: FloatArray) -> TabulatedLaw:
        """The law of (k,) numbers."""
        return TabulatedLaw(self.I6, tuple(np.cumsum(p * self.steps).tolist()))


class SlipUnknowns(Unknowns):
    """The numbers of a shear law, then the logarithms of K and τ over those of a start.

    Those in `keep` are not fitted, nor is a resistance that is infinite: elastic slip only.
    """

    def __init__(self, of_law: Unknowns | Table, start: Slip, keep: Sequence[str] = ()) -> None:
        self.of_law, self.slip = of_law, start
        names = [n for n in ("stiffness", "resistance") if getattr(start, n) < ENDLESS]
        self.names = names = [name for name in names if name not in keep]
        more = np.zeros(len(names))
        self.free = [*of_law.free, *names]
        self.start = np.append(of_law.start, more)
        self.bounds = np.hstack([of_law.bounds, np.outer([-WIDEST, WIDEST], more + 1)])

    def law(self, p: FloatArray) -> SlippingLaw:
        """Law and slip of (k,) numbers."""
        n = len(self.of_law.start)
        found = {
            name: getattr(self.slip, name) * float(np.exp(q))
            for name, q in zip(self.names, p[n:], strict=True)
        }
        return SlippingLaw(self.of_law.law(p[:n]), replace(self.slip, **found))

    def slopes(self, p: FloatArray, of: Any) -> FloatArray:
        """Derivatives (..., k) of a function (...) of the shear law, by central differences."""
        columns = []
        for i in range(len(self.of_law.start)):
            step = 1e-6 * max(abs(p[i]), 1e-3)
            above, below = p.copy(), p.copy()
            above[i], below[i] = p[i] + step, max(p[i] - step, self.bounds[0, i])
            columns.append((of(self.law(above)) - of(self.law(below))) / (above[i] - below[i]))
        columns += [np.zeros_like(columns[0])] * len(self.names)
        return np.stack(columns, axis=-1)


class SlippingSheet(Sheet):
    """The finite-element model of one off-axis test with slip."""

    def __init__(
        self,
        specimen: OffAxis,
        curve: Curve,
        forces: Forces,
        fabric: Fabric,
        size: float,
        law: SlippingLaw,
    ) -> None:
        fabric = replace(fabric, slip=law.slip)
        super().__init__(specimen, curve, forces, fabric, size, law)
        self.width = next(t for t in self.model.terms if isinstance(t, SlipWidth))
        self.width.quadratic = False  # its Hessian changes with K
        self.equilibrium = Equilibrium(self.model, tolerance=1e-6)
        self.unit = self.width.H / law.slip.coupling  # of G = 1

    def states(self, law: SlippingLaw) -> list[FloatArray]:
        """Equilibria at the points; NotConvergedError where there is none."""
        resistance = self.model.slip
        resistance.K, resistance.tau = law.slip.stiffness, min(law.slip.resistance, ENDLESS)
        self.width.H = law.slip.coupling * self.unit
        return super().states(law.shear)

    def _slopes(
        self, x: FloatArray, unknowns: SlipUnknowns, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        dforce, dangle = super()._slopes(x, unknowns, p)
        equilibrium, model, law = self.equilibrium, self.model, unknowns.law(p)
        free = equilibrium.free
        v = np.where(model.fixed, model.drive, 0.0)
        _, load = equilibrium.factor(x, False, motion=v)
        v[free] = -equilibrium.tangent.solve(load)
        for i, name in enumerate(unknowns.names, start=len(unknowns.of_law.start)):
            g = getattr(law.slip, name) * self._by(name, x)
            dforce[i] = g @ v
            if self.with_angle:
                dx = np.zeros(len(x))
                dx[free] = -equilibrium.tangent.solve(g[free])
                h = 1e-3 / max(np.abs(dx).max(), 1e-300)
                rise = self.angle(x + h * dx) - self.angle(x - h * dx)
                dangle[i] = np.radians(rise / (2 * h))
        return dforce, dangle

    def _by(self, name: str, x: FloatArray) -> FloatArray:
        """(n_dofs,) derivative of all forces by K, mm³, or by τ, mm²."""
        term, g = self.model.slip, np.zeros(len(x))
        d = x[term.dofs]
        r = np.sqrt((d * d).sum(1))
        slides = (r > term.tau / term.K)[:, None]
        if name == "resistance":
            g[term.dofs] = np.where(slides, d / np.maximum(r, 1e-300)[:, None], 0.0)
            g[term.dofs] *= term.area[:, None]
            return g
        self.width.add_gradient(g, x, None)
        g /= term.K
        g[term.dofs] += np.where(slides, 0.0, d) * term.area[:, None]
        return g


def slip_parameters(found: Trial) -> tuple[list[Parameter], float]:
    """K and τ with their 95 % intervals, and their correlation (nan for one of them alone)."""
    unknowns, fitted = found
    law, count = unknowns.law(fitted.x), len(unknowns.names)
    covariance = _covariance(fitted.jac, fitted.fun)[-count:, -count:]
    deviation = np.sqrt(np.diag(covariance))
    units = {"stiffness": "N/mm³", "resistance": "MPa"}
    parameters = []
    for name, wide in zip(unknowns.names, (1.96 * deviation).tolist(), strict=True):
        value = getattr(law.slip, name)
        low, high = (value * float(np.exp(min(wide, 99.0) * sign)) for sign in (-1, 1))
        state = "fitted" if wide < SURE else "not identified"
        high = high if wide < 99.0 else np.inf
        parameters.append(Parameter(f"slip.{name}", value, low, high, units[name], state))
    both = covariance[0, -1] / np.prod(deviation) if count == 2 else np.nan
    return parameters, float(both)


def _covariance(J: FloatArray, r: FloatArray) -> FloatArray:
    """(k, k) of the numbers; larger where the residuals (n,) are correlated, infinite if unseen."""
    lag = float(np.clip((r[1:] @ r[:-1]) / max(r @ r, 1e-300), 0.0, 0.95))
    variance = float(r @ r) / max(len(r) - J.shape[1], 1) * (1 + lag) / (1 - lag)
    size = np.linalg.norm(J, axis=0)
    seen = size > UNSEEN * size.max()
    found = np.diag(np.full(len(size), 1e8))
    found[np.ix_(seen, seen)] = variance * np.linalg.pinv(J[:, seen].T @ J[:, seen], hermitian=True)
    return found
