"""Patch tests on four kinds of mesh, a bent sheet, and a manufactured solution with its orders."""

import numpy as np
import shapely
from skfem import Basis, ElementTriP1, ElementVector, LinearForm

import quasiform as qf
from quasiform.energy.bending import Bending
from quasiform.energy.membrane import membrane_of
from quasiform.net.free_mesh import triangulate
from quasiform.unknowns import Unknowns

LENGTH, WIDTH = 100.0, 80.0
SIZES = (10.0, 5.0, 2.5)
FABRIC = qf.Fabric()
SOFT = qf.Fabric(  # fibres as soft as the shear, so that an error in either law is visible
    name="soft fibres", warp=qf.ThreeStageLaw(C_ini=1.0), weft=qf.ThreeStageLaw(C_ini=1.0)
)
MESHES = ("along the fibres", "fibres at 30 deg", "distorted", "free")


def values() -> dict[str, float]:
    """Errors of homogeneous states, energies of rigid and bent sheets, orders of convergence."""
    found = {}
    for mesh in MESHES:
        found |= {
            f"homogeneous, {mesh}: error of the {name}": v for name, v in _homogeneous(mesh).items()
        }
        found[f"rigid motion, {mesh}: energy divided by that of 1 deg of shear"] = _rigid(mesh)
    for angle in (0, 30, 45, 90):
        off = [_rolled(float(angle), size) for size in SIZES]
        found[f"rolled, warp at {angle} deg to the arc: energy divided by the exact one"] = (
            1 + off[-1]
        )
        found[f"rolled, warp at {angle} deg to the arc: order"] = _order(off)
    for mesh in ("along the fibres", "fibres at 30 deg", "free"):
        errors = np.array([_manufactured(mesh, size) for size in SIZES])
        found[f"manufactured, {mesh}: error of the shear angle"] = errors[-1, 1]
        found[f"manufactured, {mesh}: order of positions"] = _order(errors[:, 0])
        found[f"manufactured, {mesh}: order of the shear angle"] = _order(errors[:, 1])
    errors = np.array([_manufactured("free", size, FABRIC) for size in SIZES])
    found["manufactured, free, fibres of MD600: error of the shear angle"] = errors[-1, 1]
    found["manufactured, free, fibres of MD600: order of positions"] = _order(errors[:, 0])
    return found


def _order(errors: list[float]) -> float:
    """Slope of the errors over the sizes, both as logarithms."""
    return float(np.polyfit(np.log(SIZES), np.log(np.abs(errors)), 1)[0])


def _blank(mesh: str, size: float) -> qf.Blank:
    if mesh == "free":
        return triangulate(shapely.box(0.0, 0.0, LENGTH, WIDTH), size, 30.0)
    centre = (LENGTH / 2, WIDTH / 2)
    angle = 30.0 if mesh == "fibres at 30 deg" else 0.0
    blank = qf.rectangle(LENGTH, WIDTH, size, angle, centre)
    if mesh != "distorted":
        return blank
    moved = np.random.default_rng(0).uniform(-0.25, 0.25, blank.nodes.shape) * size
    moved[_rim(blank)] = 0.0
    return qf.Blank(blank.nodes + moved, blank.triangles, blank.warp, blank.weft)


def _rim(blank: qf.Blank) -> np.ndarray:
    rim = np.zeros(len(blank.nodes), dtype=bool)
    rim[np.unique(blank.mesh.facets[:, blank.mesh.boundary_facets()])] = True
    return rim


def _homogeneous(mesh: str) -> dict[str, float]:
    """Edge moved by F(s) = 1 + s (F - 1): the inside must follow, the force is t0 A dW/ds."""
    blank = _blank(mesh, 10.0)
    along = np.column_stack([blank.warp, blank.weft])
    F = along @ np.array([[1.002, 0.10], [0.15, 0.999]]) @ along.T
    rate = (blank.nodes @ (F - np.eye(2)).T).ravel()
    sheet = (unknowns := Unknowns()).sheet(blank, FABRIC, dim=2)
    scene = qf.Model(
        name="patch test",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[membrane_of(sheet)],
        x0=blank.nodes.ravel().copy(),
        fixed=np.repeat(_rim(blank), 2),
        drive=rate,
        travel=1.0,
        increment=0.5,
        rows=0.5,
    )
    result = qf.solve(scene, estimate=False, tolerance=1e-8)
    x = scene.sheet.positions(result.states[-1].x)
    a, b = F @ blank.warp, F @ blank.weft
    gamma = np.degrees(np.arcsin(a @ b / np.sqrt((a @ a) * (b @ b))))

    def energy(s: float) -> float:
        G = np.eye(2) + s * (F - np.eye(2))
        a, b = G @ blank.warp, G @ blank.weft
        density = (
            FABRIC.warp.energy(a @ a, 1.0)
            + FABRIC.shear.energy(a @ b)
            + FABRIC.weft.energy(b @ b, 1.0)
        )
        return FABRIC.thickness * LENGTH * WIDTH * float(density)

    force = (energy(1 + 1e-5) - energy(1 - 1e-5)) / 2e-5
    return {
        "positions": np.abs(x - blank.nodes @ F.T).max(),
        "shear angle": np.abs(result.shear_angle - gamma).max(),
        "force": 100 * abs(result.force / force - 1),
    }


def _rigid(mesh: str) -> float:
    """Energy of a sheet rotated in space, divided by that of the flat one sheared by 1 degree."""
    blank = _blank(mesh, 10.0)
    n = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    R = np.eye(3) + np.sin(2.0) * cross + (1 - np.cos(2.0)) * cross @ cross
    sheet = Unknowns().sheet(blank, FABRIC, dim=3)
    terms = [membrane_of(sheet)]
    if blank.pairs is None and mesh != "distorted":
        terms.append(Bending(sheet))
    x = np.pad(blank.nodes, ((0, 0), (0, 1))) @ R.T + [5.0, -70.0, 12.0]
    sheared = FABRIC.thickness * LENGTH * WIDTH * FABRIC.shear.energy(np.sin(np.radians(1.0)))
    return sum(abs(term.energy(x.ravel()).sum()) for term in terms) / float(sheared)


def _rolled(angle: float, size: float) -> float:
    """Bending energy of a sheet rolled on a cylinder divided by the exact one, minus 1.

    A fibre at an angle t to the arc is a helix of curvature cos²(t)/R. The free ends of the lines
    have no curvature and are excluded.
    """
    radius = 100.0
    blank = qf.rectangle(LENGTH, WIDTH, size, angle, (LENGTH / 2, WIDTH / 2))
    X, Y = blank.nodes.T
    x = np.column_stack([radius * np.sin(X / radius), Y, radius * (1 - np.cos(X / radius))])
    kappa = np.abs(Bending(Unknowns().sheet(blank, FABRIC, dim=3)).curvature(x.ravel()))
    t = np.radians(angle)
    exact = np.array([np.cos(t) ** 2, np.sin(t) ** 2]) / radius
    found = [k[k > 0.5 * e] if e > 1e-9 else k for k, e in zip(kappa.T, exact, strict=True)]
    B = np.array([FABRIC.bending_warp, FABRIC.bending_weft])
    return float(B @ [(k**2).mean() for k in found] / (B @ exact**2) - 1)


def _manufactured(mesh: str, size: float, fabric: qf.Fabric = SOFT) -> tuple[float, float]:
    """Root mean square errors of positions (mm) and shear angle (deg) against a given solution.

    x = A(a) + B(b) of curved fibres, all in tension (with this weak shear, compressed fibres
    would buckle in the plane). The load is that of its stress, f_i = ∫ t0 P·∇N_i; the edge is
    prescribed.
    """
    blank = _blank(mesh, size)
    speed, turn = 0.005, 0.15
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=2)
    membrane = membrane_of(sheet)
    along = np.column_stack([blank.warp, blank.weft])
    s, w = np.polynomial.legendre.leggauss(12)
    s, w = 0.5 * (s + 1), 0.5 * w

    def tangent(t: np.ndarray, family: int) -> np.ndarray:
        """(2, ...) derivative of A or B by the length along the flat fibre."""
        angle = turn * np.sin(np.pi * t / LENGTH + 0.5 * family) * (1 - 2 * family)
        length = 1 + speed * (1.2 + np.cos(2 * np.pi * t / LENGTH))
        start = np.array([np.cos(angle), np.sin(angle)])
        return length * (start if family == 0 else np.array([-start[1], start[0]]))

    def curve(t: np.ndarray, family: int) -> np.ndarray:
        return np.tensordot(tangent(t[..., None] * s, family), w, axes=1) * t

    def positions(X: np.ndarray) -> np.ndarray:
        a, b = (X @ along).T
        return (along @ (curve(a, 0) + curve(b, 1))).T

    @LinearForm
    def load(v, place):
        a, b = np.tensordot(along, place.x, axes=(0, 0))
        da, db = tangent(a, 0), tangent(b, 1)
        I4, I6, I8 = (da * da).sum(0), (da * db).sum(0), (db * db).sum(0)
        S11, S22 = 2 * fabric.warp.stress(I4, 1.0), 2 * fabric.weft.stress(I8, 1.0)
        S12 = fabric.shear.stress(I6)
        along_a = np.tensordot(along, S11 * da + S12 * db, axes=(1, 0))
        along_b = np.tensordot(along, S12 * da + S22 * db, axes=(1, 0))
        P = np.einsum("i...,j->ij...", along_a, blank.warp)
        P += np.einsum("i...,j->ij...", along_b, blank.weft)
        return fabric.thickness * np.einsum("ij...,ij...", P, v.grad)

    basis = Basis(blank.mesh, ElementVector(ElementTriP1()), intorder=6)
    forces = load.assemble(basis)
    start = positions(blank.nodes)
    scene = qf.Model(
        name="manufactured solution",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[membrane, DeadLoads(forces)],
        x0=start.ravel(),
        fixed=np.repeat(_rim(blank), 2),
        drive=np.zeros(start.size),
        travel=1.0,
        increment=1.0,
        rows=1.0,
        resting=100.0,
    )
    result = qf.solve(scene, estimate=False)
    if result.reason:
        raise ValueError(f"{mesh}, size {size:g}: {result.reason}")
    x = result.states[-1].x
    a, b = (blank.centroids @ along).T
    da, db = tangent(a, 0), tangent(b, 1)
    cosine = (da * db).sum(0) / (np.linalg.norm(da, axis=0) * np.linalg.norm(db, axis=0))
    off = np.degrees(membrane.shear_angle(x) - np.arcsin(cosine))
    moved = ((scene.sheet.positions(x) - start) ** 2).sum(1)
    node, area = blank.node_areas, blank.areas
    return np.sqrt(node @ moved / node.sum()), np.sqrt(area @ off**2 / area.sum())


class DeadLoads(qf.Term):
    """Given forces on the nodes, E = -f·x."""

    name = "dead loads"

    def __init__(self, forces: np.ndarray) -> None:
        self.dofs, self.forces = np.arange(len(forces))[:, None], forces

    def energy(self, x: np.ndarray, state: None = None) -> np.ndarray:
        return -self.forces * x

    def gradient(self, x: np.ndarray, state: None = None) -> np.ndarray:
        return -self.forces[:, None]

    def hessian(self, x: np.ndarray, state: None, convex: bool) -> np.ndarray:
        return np.zeros((len(self.forces), 1, 1))
