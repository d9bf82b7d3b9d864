"""Strips under a tip load and under their own weight compared with the elastica."""

import numpy as np

import quasiform as qf
from quasiform import theory
from quasiform.unknowns import Sheet

LENGTH, WIDTH = 100.0, 10.0
SIZES = (10.0, 5.0, 2.5)


class TipLoad(qf.Term):
    """Dead load across the strip on its free end, E = q P mean(z), the factor q driven to 1."""

    name = "load on the tip"

    def __init__(self, sheet: Sheet, nodes: np.ndarray, load: float, factor_dof: int) -> None:
        self.dofs = np.column_stack([sheet.dofs[nodes, 2], 0 * nodes + factor_dof])
        self.share = load / len(nodes)

    def energy(self, x: np.ndarray, state: None = None) -> np.ndarray:
        z, q = x[self.dofs].T
        return self.share * q * z

    def gradient(self, x: np.ndarray, state: None = None) -> np.ndarray:
        z, q = x[self.dofs].T
        return self.share * np.column_stack([q, z])

    def hessian(self, x: np.ndarray, state: None, convex: bool) -> np.ndarray:
        H = np.zeros((len(self.dofs), 2, 2))
        H[:, 0, 1] = H[:, 1, 0] = self.share
        return H


def values() -> dict[str, float]:
    """Ends of the strips divided by the exact ones with 20 elements, and orders of convergence."""
    fabric, found = qf.Fabric(), {}
    for family, B in (("warp", fabric.bending_warp), ("weft", fabric.bending_weft)):
        for k in (1, 2, 5, 10):
            u, w = theory.tip_loaded_elastica(k)
            end = _tip(_tip_loaded(k * B / LENGTH**2, 5.0, family))
            found[f"tip-loaded, {family}, k={k}: shortening / exact"] = (1 - end[0]) / u
            found[f"tip-loaded, {family}, k={k}: deflection / exact"] = end[1] / w
        for k in (1, 2, 8, 10):
            x, drop, slope = theory.heavy_elastica(k)
            end = _tip(_heavy(k * B / LENGTH**3, 5.0, family))
            found[f"heavy, {family}, k={k}: x of the end / exact"] = end[0] / x
            found[f"heavy, {family}, k={k}: drop of the end / exact"] = end[1] / drop
            found[f"heavy, {family}, k={k}: deviation of the slope"] = np.degrees(end[2] - slope)
    B = fabric.bending_warp
    u, w = theory.tip_loaded_elastica(5)
    ends = [_tip(_tip_loaded(5 * B / LENGTH**2, size, "warp")) for size in SIZES]
    found["tip-loaded, k=5: order of the deflection"] = _order([end[1] - w for end in ends])
    x, drop, _ = theory.heavy_elastica(8)
    ends = [_tip(_heavy(8 * B / LENGTH**3, size, "warp")) for size in SIZES]
    found["heavy, k=8: order of the drop"] = _order([end[1] - drop for end in ends])
    peirce = np.degrees(np.arctan2(ends[-1][1], ends[-1][0]))
    found["deviation from Peirce's chord angle at k=8"] = peirce - np.degrees(np.arctan2(drop, x))
    return found


def _order(errors: list[float]) -> float:
    """Slope of the errors over the sizes, both as logarithms."""
    return float(np.polyfit(np.log(SIZES), np.log(np.abs(errors)), 1)[0])


def _heavy(load: float, size: float, family: str) -> qf.Model:
    return qf.cantilever(LENGTH, load, WIDTH, size=size, family=family)


def _tip_loaded(line_load: float, size: float, family: str) -> qf.Model:
    """Cantilever without weight, with a load per width (N/mm) across its free end."""
    scene = qf.cantilever(LENGTH, 1.0, WIDTH, size=size, family=family)
    tip = np.flatnonzero(scene.sheet.blank.nodes[:, 0] > LENGTH - 1e-9)
    factor = len(scene.x0) - 1
    scene.terms[-1] = TipLoad(scene.sheet, tip, line_load * WIDTH, factor)
    scene.dead_load = line_load * WIDTH
    return scene


def _tip(scene: qf.Model) -> tuple[float, float, float]:
    """Position x and drop of the end divided by the length, and the slope of the end, rad."""
    result = qf.solve(scene, estimate=False, tolerance=1e-5)
    if result.reason:
        raise ValueError(f"{scene.name}: {result.reason}")
    X = result.model.sheet.blank.nodes[:, 0]
    x = scene.sheet.positions(result.states[-1].x)
    ends = [x[np.isclose(X, s)].mean(0) for s in np.unique(X)[-3:]]
    # from the middles of the last elements to the end, where moment and shear force vanish: there
    # the slope is a constant and a cube of the distance
    last, before = (np.arctan2(-(b - a)[2], (b - a)[0]) for a, b in (ends[1:], ends[:2]))
    slope = last + (last - before) / 26
    return ends[-1][0] / LENGTH, -ends[-1][2] / LENGTH, slope
