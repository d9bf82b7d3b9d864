"""FElupe on the off-axis tension test at 45°: the same mesh, the same law, the same tolerance.

The fabric is a FElupe user material of F with exact tangents. With the fibre vectors f = F a0 and
h = F b0, W = W4(f·f) + W6(f·h) + W8(h·h) gives

    P_iJ    = ∂W/∂F_iJ  = Σ_k W_k' G^k_iJ,
              G^4 = 2 f⊗a0,  G^6 = f⊗b0 + h⊗a0,  G^8 = 2 h⊗b0
    A_iJkL  = Σ_k W_k'' G^k_iJ G^k_kL + δ_ik [2 W4' a0⊗a0 + W6' (a0⊗b0 + b0⊗a0) + 2 W8' b0⊗b0]_JL.

The three-stage law is implemented here again, from Eq. 9 of the paper, so that FElupe's process
does not load quasiform; `problems` checks that both laws are the same.

FElupe 11 solves with Newton's method without a line search (its own, by residuals, can be switched
on). Its first iteration of an increment is a prediction along the tangent, as quasiform's is.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .contest import OURS, Answer, Contender, Problem

FloatArray = np.ndarray
TRAVEL = 50.0  # mm
TOLERANCE = 1e-4  # sum of the nodal residuals over the driving force, both codes
FORCES = {10.0: 21.480, 5.0: 21.452}  # N at 50 mm by cell size (peer results)
BAND = 1e-3
EQUAL = (1.0, 5.0, 10.0, 12.5, 50.0 / 3.0, 25.0, 50.0)


def missing() -> str:
    return "" if importlib.util.find_spec("felupe") else "felupe is not installed"


def problems(folder: Path) -> list[Problem]:
    """Two meshes, a range of increments, both codes alternately."""
    return [_problem(folder, size) for size in FORCES]


def _membrane() -> Any:
    """Fabric without in-plane bending, which FElupe's element does not have."""
    import quasiform as qf

    return replace(qf.Fabric.preset("locking"), in_plane_bending=0.0)


def _problem(folder: Path, size: float) -> Problem:
    import quasiform as qf

    scene = qf.off_axis_tension(45, _membrane(), displacement=TRAVEL, size=size)
    blank, fabric = scene.sheet.blank, scene.sheet.fabric
    law = Law(**asdict(fabric.shear))
    I = np.linspace(-0.99, 0.99, 2001)
    for mine, theirs in (
        (law.stress, fabric.shear.stress),
        (law.stiffness, fabric.shear.stiffness),
    ):
        np.testing.assert_allclose(mine(I), theirs(I), rtol=1e-9)
    mesh = folder / f"oat_{size:g}.npz"
    radius = min(160 / 8, 320 * np.sqrt(0.5) / 2 - 160 * np.sqrt(0.5) / 2)
    centre = np.linalg.norm(blank.centroids, axis=1) < radius
    np.savez(
        mesh,
        points=blank.nodes,
        triangles=blank.triangles,
        warp=blank.warp,
        weft=blank.weft,
        thickness=fabric.thickness,
        C_fibre=fabric.warp.C_ini,
        shear=list(asdict(fabric.shear).values()),
        weights=np.where(centre, blank.areas, 0.0) / blank.areas[centre].sum(),
    )
    contenders = []
    for increment in EQUAL:
        setting = f"{increment:.3g} mm"
        contenders += [
            Contender(OURS, setting, "quasiform", {"size": size, "increment": increment}),
            Contender("FElupe", setting, "felupe", {"mesh": str(mesh), "increment": increment}),
        ]
    contenders.append(Contender(OURS, "automatic", "quasiform", {"size": size}))
    force = FORCES[size]
    return Problem(
        f"off-axis tension 45°, {len(blank.triangles)} triangles",
        "felupe_oat",
        tuple(contenders),
        force * (1 - BAND),
        force * (1 + BAND),
    )


def quasiform(size: float, increment: float | None = None) -> Answer:
    """Quasiform with equal or automatic increments."""
    import quasiform as qf

    scene = qf.off_axis_tension(45, _membrane(), displacement=TRAVEL, size=size)
    for step in (TRAVEL, increment):  # the first one loads what is loaded at the first use
        result = qf.solve(scene, increment=step, tolerance=TOLERANCE, estimate=False)
    if result.status != "completed":
        return Answer(failed=result.reason)
    return Answer(
        float(result.force),
        float(result.history["shear_angle_center_deg"][-1]),
        result.wall_s,
        result.increments,
        result.linear_solves,
    )


@dataclass(frozen=True)
class Law:
    """Three-stage shear law (Eq. 9 with the sign of I on the derivative), MPa."""

    C_ini: float
    S_ini: float
    C_mid: float
    dS_mid: float
    C_lo: float
    I_lo: float

    def stress(self, I: FloatArray) -> FloatArray:
        x, y, z, c = self._stages(I)
        first = self.C_ini * np.minimum(x, self.S_ini / self.C_ini)
        plateau = (self.C_mid * y + self.dS_mid) * (1 - np.exp(-c * y))
        return np.sign(I) * (first + plateau + self.C_lo * z**2)

    def stiffness(self, I: FloatArray) -> FloatArray:
        _, y, z, c = self._stages(I)
        E = np.exp(-c * y)
        later = self.C_mid * (1 - E) + (self.C_mid * y + self.dS_mid) * c * E + 2 * self.C_lo * z
        return np.where(y > 0, later, self.C_ini)

    def _stages(self, I: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        x = np.abs(I)
        y = np.maximum(x - self.S_ini / self.C_ini, 0.0)
        return x, y, np.maximum(x - self.I_lo, 0.0), self.C_ini / self.dS_mid


class Fabric:
    """The fabric as a FElupe user material in the plane, in N/mm (times the thickness)."""

    def __init__(
        self, warp: FloatArray, weft: FloatArray, thickness: float, C_fibre: float, shear: Law
    ) -> None:
        self.a, self.b, self.t0 = warp, weft, thickness
        self.C_fibre, self.shear = C_fibre, shear
        self.x = [np.zeros((2, 2)), np.zeros(0)]  # F, and no state variables

    def _kinematics(self, F: FloatArray) -> tuple[FloatArray, ...]:
        """Invariants (3, q, c) and their derivatives by F (3, 2, 2, q, c)."""
        f, h = np.einsum("iJqc,J->iqc", F, self.a), np.einsum("iJqc,J->iqc", F, self.b)
        I = np.stack([(f * f).sum(0), (f * h).sum(0), (h * h).sum(0)])
        fa, fb, ha, hb = (
            u[:, None] * v[None, :, None, None] for u in (f, h) for v in (self.a, self.b)
        )
        return I, np.stack([2 * fa, fb + ha, 2 * hb])

    def _first(self, I: FloatArray) -> FloatArray:
        fibres = self.C_fibre * (I - 1)
        return self.t0 * np.stack([fibres[0], self.shear.stress(I[1]), fibres[2]])

    def gradient(self, x: list[FloatArray]) -> list[FloatArray]:
        """First Piola-Kirchhoff stress times the thickness."""
        I, G = self._kinematics(x[0])
        return [(self._first(I)[:, None, None] * G).sum(0), x[-1]]

    def hessian(self, x: list[FloatArray]) -> list[FloatArray]:
        """Its derivative by F."""
        I, G = self._kinematics(x[0])
        fibres = np.full_like(I[0], self.C_fibre)
        W2 = self.t0 * np.stack([fibres, self.shear.stiffness(I[1]), fibres])
        A = np.einsum("nqc,niJqc,nkLqc->iJkLqc", W2, G, G, optimize=["einsum_path", (0, 1), (0, 1)])
        aa, ab, bb = (np.outer(*pair) for pair in ((self.a,) * 2, (self.a, self.b), (self.b,) * 2))
        M = np.stack([2 * aa, ab + ab.T, 2 * bb])
        geometric = np.einsum("nJL,nqc->JLqc", M, self._first(I))
        for i in (0, 1):
            A[i, :, i] += geometric
        return [A]


def felupe(
    mesh: str,
    increment: float,
    linear: str = "symmetric",
    line_search: bool = False,
    first: bool = True,
) -> Answer:
    """FElupe with equal increments.

    Parameters
    ----------
    mesh : str
        File written by `problems`.
    increment : float
        mm.
    linear : "symmetric", "pypardiso" or "scipy"
        SuperLU with a symmetric minimum-degree order, the fastest; PyPardiso's `spsolve`, as
        FElupe's documentation recommends; or SciPy's, FElupe's default.
    line_search : bool
        Switch on FElupe's own line search.
    first : bool
        Solve once before the clock starts, which loads what is loaded at the first use.
    """
    import felupe as fem
    from felupe.tools import NewtonConvergenceError

    if first:
        felupe(mesh, TRAVEL, linear, line_search, first=False)
    data = np.load(mesh)
    solver = _linear_solver(linear)
    clock = time.perf_counter()
    region = fem.RegionTriangle(fem.Mesh(data["points"], data["triangles"], "triangle"))
    displacement = fem.Field(region, dim=2)
    field = fem.FieldContainer([displacement])
    material = Fabric(
        data["warp"],
        data["weft"],
        float(data["thickness"]),
        float(data["C_fibre"]),
        Law(*data["shear"]),
    )
    body = fem.SolidBody(material, field)
    edge = data["points"][:, 0].max()
    boundaries = {
        "left": fem.Boundary(displacement, fx=lambda x: np.isclose(x, -edge)),
        "across": fem.Boundary(displacement, fx=lambda x: np.isclose(x, edge), skip=(1, 0)),
        "pulled": fem.Boundary(displacement, fx=lambda x: np.isclose(x, edge), skip=(0, 1)),
    }
    dof0, dof1 = fem.dof.partition(field, boundaries)
    pulled = boundaries["pulled"].dof
    count = round(TRAVEL / increment)
    plugins = [fem.LinesearchPlugin()] if line_search else []
    iterations = 0

    def check(dx, x, f, xtol, ftol, dof1, dof0, items):
        """Quasiform's measure: sum of the free nodal forces over the driving force."""
        free = f.copy()
        free[dof0] = 0.0
        residual = np.linalg.norm(free.reshape(-1, 2), axis=1).sum() / abs(f[pulled].sum())
        return np.linalg.norm(dx), residual, residual < ftol

    for k in range(1, count + 1):
        boundaries["pulled"].update(TRAVEL * k / count)
        ext0 = fem.dof.apply(field, boundaries, dof0=dof0)
        try:
            found = fem.newtonraphson(
                x0=field,
                items=[body],
                dof0=dof0,
                dof1=dof1,
                ext0=ext0,
                tol=TOLERANCE,
                maxiter=60,
                check=check,
                solver=solver,
                verbose=0,
                plugins=plugins,
            )
        except (NewtonConvergenceError, ArithmeticError) as error:
            reason = " ".join(str(error).split())
            return Answer(failed=f"at {TRAVEL * k / count:.3g} mm: {reason}")
        field.link(found.x)
        iterations += found.iterations
    seconds = time.perf_counter() - clock
    F = field.extract()[0][:, :, 0]
    f, h = np.einsum("iJc,J->ic", F, data["warp"]), np.einsum("iJc,J->ic", F, data["weft"])
    gamma = np.arcsin((f * h).sum(0) / np.sqrt((f * f).sum(0) * (h * h).sum(0)))
    return Answer(
        float(found.fun[pulled].sum()),
        float(data["weights"] @ np.degrees(gamma)),
        seconds,
        count,
        iterations,
    )


def _linear_solver(name: str) -> Callable:
    if name == "pypardiso":
        from pypardiso import spsolve

        return spsolve
    if name == "scipy":
        from scipy.sparse.linalg import spsolve

        return spsolve
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    return lambda A, b: splu(
        A.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
    ).solve(b)
