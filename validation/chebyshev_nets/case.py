"""Inextensible nets with one solution: in the plane, on cones, a sphere and a torus.

A net of inextensible fibres X(u, v) on a surface with normal n obeys X_uv = -(X_u·H·X_v) n, where H
is the second derivative of the signed distance; the shear angle obeys γ_uv = K cos γ with Gauss's
curvature K. Two given crossing fibres determine the rest, for any shear law.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline, RegularGridInterpolator

import quasiform as qf
from quasiform import theory
from quasiform.draw.plot import STYLE, WIDTH
from quasiform.energy.bending import Bending
from quasiform.energy.membrane import Membrane
from quasiform.tools.shapes import Placed, Shape, ball
from quasiform.unknowns import Sheet, Unknowns
from validation.run import Outcome

SIZES = (8.0, 4.0, 2.0)
ROD = 0.5  # mm, of the exact net
STIFFNESS = 100.0  # N/mm³, with which the sheet is bound to a surface
STRETCH = 1.05  # of all fibres at the start
# An inextensible net has concentrated forces along its free edges; fibres of finite stiffness
# stretch there. The net does not depend on the shear law, so a weak law and stiff fibres keep this
# effect out of the errors.
FABRIC = qf.Fabric(
    name="nearly inextensible",
    shear=qf.ThreeStageLaw(C_ini=0.00334),
    warp=qf.ThreeStageLaw(C_ini=1e5),
    weft=qf.ThreeStageLaw(C_ini=1e5),
    bending_warp=0.034,
    bending_weft=0.034,
)


@dataclass(frozen=True)
class Cone:
    """A cone about -z with its tip, rounded to a sphere, at the origin; half its opening in rad."""

    half_angle: float
    radius: float

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s, c = np.sin(self.half_angle), np.cos(self.half_angle)
        from_centre = points - np.array([0.0, 0.0, -self.radius])
        rho = np.hypot(*points[:, :2].T)
        radial = np.zeros_like(points)
        radial[:, :2] = points[:, :2] / np.maximum(rho, 1e-12)[:, None]
        n = c * radial + [0.0, 0.0, s]
        around = np.cross([0.0, 0.0, 1.0], radial)
        bend = (c / np.maximum(rho, 1e-12))[:, None, None] * _outer(around, around)
        d = np.einsum("ij,ij->i", from_centre, n) - self.radius
        cap = s * rho - c * from_centre[:, 2] <= 0
        d[cap], n[cap], bend[cap] = ball(self.radius).distance(from_centre[cap])
        return d, n, bend


@dataclass(frozen=True)
class Torus:
    """A tube of a radius about a ring in the plane z = 0."""

    ring: float
    radius: float

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rho = np.hypot(*points[:, :2].T)
        radial = np.zeros_like(points)
        radial[:, :2] = points[:, :2] / rho[:, None]
        away = points - self.ring * radial
        q = np.linalg.norm(away, axis=1)
        n = away / q[:, None]
        around = np.cross([0.0, 0.0, 1.0], radial)
        across = np.cross(n, around)
        slope = np.einsum("ij,ij->i", n, radial) / rho
        H = _outer(across, across) / q[:, None, None] + slope[:, None, None] * _outer(
            around, around
        )
        return q - self.radius, n, H


def _outer(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, :, None] * v[:, None, :]


# Each surface touches z = 0 from below at the origin; on the equators of the torus z is radial.
OUTWARD = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
TORUS = Torus(120.0, 60.0)
SURFACES: dict[str, tuple[Shape, float]] = {  # and half the side of the square sheet, mm
    "sphere": (Placed(ball(75.0), np.eye(3), (0.0, 0.0, -75.0)), 72.0),
    "cone of 60 deg": (Cone(np.radians(60.0), 20.0), 80.0),
    "cone of 45 deg": (Cone(np.radians(45.0), 20.0), 80.0),
    "torus, outside": (Placed(TORUS, OUTWARD, (0.0, 0.0, -180.0)), 72.0),
    "torus, inside": (Placed(TORUS, OUTWARD.T, (0.0, 0.0, 60.0)), 56.0),
}


class Bound(qf.Term):
    """Sheet bound to a surface on which it slides, E = k/2 Σ A d²."""

    name = "bound to a surface"

    def __init__(self, sheet: Sheet, shape: Shape) -> None:
        self.dofs = sheet.dofs
        self.shape, self.k = shape, STIFFNESS * sheet.blank.node_areas

    def energy(self, x: np.ndarray, state: None = None) -> np.ndarray:
        return 0.5 * self.k * self.shape.distance(x[self.dofs])[0] ** 2

    def gradient(self, x: np.ndarray, state: None = None) -> np.ndarray:
        d, n, _ = self.shape.distance(x[self.dofs])
        return (self.k * d)[:, None] * n

    def hessian(self, x: np.ndarray, state: None, convex: bool) -> np.ndarray:
        d, n, H = self.shape.distance(x[self.dofs])
        bent = 0.0 if convex else d[:, None, None] * H
        return self.k[:, None, None] * (_outer(n, n) + bent)


def run(quick: bool) -> Outcome:
    """Errors of the shear angle at the finest size, and orders of convergence."""
    found, errors = {}, {}
    worst, errors["plane"], largest = _planar()
    found["plane: largest error"] = worst
    found["plane: order of convergence"] = _order(errors["plane"])
    found["plane: largest shear"] = largest
    for name, (shape, half) in SURFACES.items():
        node = _net_of_rods(shape, STRETCH * half)
        net = _shear(node)
        if name == "sphere":
            a = np.linspace(0.0, half, 30)
            ode = np.degrees(theory.hemisphere_net(a[:, None], a, 75.0))
            off = np.abs(net((a[:, None], a)) - ode).max()
            found["net of rods: largest deviation from the equation on the sphere"] = off
        worst, rms = [], []
        for size in SIZES:
            at, gamma = _draped(shape, half, size, node)
            exact, chosen = net(tuple(at.T)), np.ones(len(at), dtype=bool)
            if isinstance(shape, Cone):  # beyond the rounded tip
                exact = np.full(len(at), 90.0 * (1 - np.sin(shape.half_angle)))
                chosen = (at > shape.radius * (np.pi / 2 - shape.half_angle) + size).all(1)
            off = np.abs(gamma - exact)[chosen]
            worst.append(off.max())
            rms.append(np.sqrt(np.mean(off**2)))
        found[f"{name}: largest error"] = worst[-1]
        errors[name] = rms
        found[f"{name}: order of convergence"] = _order(rms)
        found[f"{name}: largest shear"] = np.abs(exact).max()
    return Outcome(found, {"Error of the shear angle over the size of the mesh": _figure(errors)})


def _figure(errors: dict[str, list[float]]) -> Figure:
    with rc_context(STYLE):
        figure = Figure(figsize=(0.6 * WIDTH, 2.8), layout="constrained")
        axes = figure.subplots()
        for (name, rms), mark in zip(errors.items(), "osv^Dx", strict=True):
            axes.loglog(SIZES, rms, marker=mark, markersize=3, label=name)
        slope = 0.3 * (np.array(SIZES) / SIZES[0]) ** 2
        axes.loglog(SIZES, slope, "k:", linewidth=0.8, label="second order")
        axes.set_xticks(SIZES, [f"{size:g}" for size in SIZES])
        axes.minorticks_off()
        axes.set(xlabel="size in mm", ylabel="root mean square error of γ in °")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _order(errors: list[float]) -> float:
    """Slope of the errors over the sizes, both as logarithms."""
    return float(np.polyfit(np.log(SIZES), np.log(errors), 1)[0])


def _net_of_rods(shape: Shape, half: float) -> np.ndarray:
    """(n, n, 3) nodes of a net of short rods on a surface.

    Each node lies on the surface, a rod away from its two neighbours towards the middle.
    """
    n = int(np.ceil(half / ROD)) + 3
    node = np.zeros((n, n, 3))
    for axis in (0, 1):  # the two fibres through the middle stay in the mirror planes
        line = node[:, 0] if axis == 0 else node[0]
        step = ROD * np.eye(3)[axis]
        for i in range(1, n):
            guess, across = line[i - 1] + step, np.eye(3)[1 - axis]
            line[i] = _meet(shape, guess[None], line[None, i - 1], across[None], plane=True)[0]
            step = line[i] - line[i - 1]
    for diagonal in range(2, 2 * n - 1):
        i = np.arange(max(1, diagonal - n + 1), min(diagonal, n))
        j = diagonal - i
        one, other = node[i - 1, j], node[i, j - 1]
        guess = one + other - node[i - 1, j - 1]
        node[i, j] = _meet(shape, guess, one, other)
    return node


def _shear(node: np.ndarray) -> RegularGridInterpolator:
    """Shear angle (degrees) over the lengths along the fibres, from a net of rods."""
    warp = node[1:, :-1] - node[:-1, :-1] + node[1:, 1:] - node[:-1, 1:]
    weft = node[:-1, 1:] - node[:-1, :-1] + node[1:, 1:] - node[1:, :-1]
    cosine = (warp * weft).sum(2)
    cosine /= np.linalg.norm(warp, axis=2) * np.linalg.norm(weft, axis=2)
    middle = ROD * (np.arange(len(node) - 1) + 0.5)
    return RegularGridInterpolator(
        (middle, middle), np.degrees(np.arcsin(cosine)), "cubic", False, None
    )


def _meet(
    shape: Shape, x: np.ndarray, one: np.ndarray, other: np.ndarray, plane: bool = False
) -> np.ndarray:
    """(m, 3) points on a surface, a rod away from points `one` and `other`, from a guess x.

    With `plane`, the points lie in the plane across `other`.
    """
    for _ in range(8):
        d, n, _ = shape.distance(x)
        a, b = x - one, x - other
        last = (other, (other * x).sum(1)) if plane else (2 * b, (b * b).sum(1) - ROD**2)
        J = np.stack([n, 2 * a, last[0]], axis=1)
        r = np.stack([d, (a * a).sum(1) - ROD**2, last[1]], axis=1)
        x = x - np.linalg.solve(J, r[:, :, None])[:, :, 0]
    return x


def _draped(
    shape: Shape, half: float, size: float, node: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the cells of a quarter of the sheet (mm), and their shear angle (degrees).

    At the start all fibres are too long.
    """
    blank = qf.rectangle(2 * half, 2 * half, size, mirror=("x", "y"))
    lengths = ROD * np.arange(len(node))
    net = RegularGridInterpolator((lengths, lengths), node, "cubic")
    x0 = net(np.maximum(STRETCH * blank.nodes, 0.0))
    x0[:, :2][np.abs(blank.nodes) < 1e-9] = 0.0
    fixed = np.zeros_like(x0, dtype=bool)
    fixed[:, :2] = np.abs(blank.nodes) < 1e-9
    sheet = (unknowns := Unknowns()).sheet(blank, FABRIC, dim=3)
    scene = qf.Model(
        name="net",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), Bending(sheet), Bound(sheet, shape)],
        x0=x0.ravel(),
        fixed=fixed.ravel(),
        drive=np.zeros(x0.size),
        travel=1.0,
        increment=1.0,
        rows=1.0,
        resting=10.0,
    )
    result = qf.solve(scene, estimate=False)
    if result.reason:
        raise ValueError(f"size {size:g}: {result.reason}")
    return _by_cell(blank, scene.membrane.shear_angle(result.states[-1].x))


def _by_cell(blank: qf.Blank, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the cells and the mean of their two triangles (rad to degrees).

    The legs of a triangle give the fibre directions at their middles, and so the shear at the
    middle of the hypotenuse, the centre of the cell, to second order.
    """
    corners = blank.nodes[blank.triangles]
    middle = 0.5 * (corners.min(1) + corners.max(1))
    cells, number = np.unique(middle.round(6), axis=0, return_inverse=True)
    number = number.ravel()
    return cells, np.degrees(np.bincount(number, gamma) / np.bincount(number))


def _planar() -> tuple[float, list[float], float]:
    """Net x = A(a) + B(b) of curved fibres, prescribed on its rim: γ = phi(a) - psi(b).

    Returns the largest error at the finest size, the errors of all, and the largest angle, degrees.
    """
    side = 100.0
    t = np.linspace(-side / 2, side / 2, 4001)

    def turns(t: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        return scale * 0.4 * np.sin(np.pi * t / side), scale * 0.4 * np.cos(np.pi * t / side)

    def positions(X: np.ndarray, scale: float) -> np.ndarray:
        phi, psi = turns(t, scale)[0], -turns(t, scale)[1]
        A = CubicSpline(t, np.column_stack([np.cos(phi), np.sin(phi)])).antiderivative()
        B = CubicSpline(t, np.column_stack([-np.sin(psi), np.cos(psi)])).antiderivative()
        return (A(X[:, 0]) - A(0.0) + B(X[:, 1]) - B(0.0)).ravel()

    worst, rms = [], []
    for size in SIZES:
        blank = qf.rectangle(side, side, size)
        rim = np.zeros(len(blank.nodes), dtype=bool)
        rim[np.unique(blank.mesh.facets[:, blank.mesh.boundary_facets()])] = True

        def drive(s: float, X: np.ndarray = blank.nodes) -> tuple[np.ndarray, np.ndarray]:
            ahead, behind = positions(X, s + 1e-4), positions(X, s - 1e-4)
            return positions(X, s), (ahead - behind) / 2e-4

        sheet = (unknowns := Unknowns()).sheet(blank, FABRIC, dim=2)
        scene = qf.Model(
            name="planar net",
            unknowns=unknowns,
            sheets=[sheet],
            terms=[Membrane(sheet)],
            x0=blank.nodes.ravel().copy(),
            fixed=np.repeat(rim, 2),
            drive=drive,
            travel=1.0,
            increment=0.25,
            rows=0.25,
        )
        result = qf.solve(scene, estimate=False)
        if result.reason:
            raise ValueError(f"planar net, size {size:g}: {result.reason}")
        at, gamma = _by_cell(blank, scene.membrane.shear_angle(result.states[-1].x))
        exact = np.degrees(turns(at[:, 0], 1.0)[0] + turns(at[:, 1], 1.0)[1])
        worst.append(np.abs(gamma - exact).max())
        rms.append(np.sqrt(np.mean((gamma - exact) ** 2)))
    return worst[-1], rms, np.abs(exact).max()
