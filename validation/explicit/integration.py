"""Explicit time integration of a forming scene: real mass, damping, a punch on a smooth path.

    M a = -dE/dx - α M v,      central differences with the step 0.7 · 2/ω_max

M is lumped: areal weight times tributary area (times a mass scaling), and the real mass of a tool
that rests by its weight. ω_max is the highest frequency of the flat sheet, all in contact; it
rises with the shear, at 45° to (1 + sin γ)^½ of it. The energy E is the scene's own; the anchors of
friction move in every step. The punch follows 10 τ³ - 15 τ⁴ + 6 τ⁵ over the motion and then
stops. No equation is solved.

Mass is in tonnes (N s²/mm), time in seconds.
"""

from __future__ import annotations

import csv
import time
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import eigsh

from quasiform.energy.friction import Friction
from quasiform.energy.weight import ToolWeight
from quasiform.model import Model
from quasiform.potential import Memory, Potential

FloatArray = np.ndarray
STABLE = 0.7  # of the longest stable step of the flat sheet
HEADINGS = ("travel_mm", "force_N", "kinetic_energy_mJ", "internal_energy_mJ")


@dataclass(frozen=True)
class Motion:
    """How the punch moves and what the sheet weighs.

    Parameters
    ----------
    duration, hold : float
        Time of the motion, and of the rest after it, s.
    damping : float
        α, 1/s.
    mass_scaling : float
        Factor of the sheet's areal weight.
    """

    duration: float = 0.15
    hold: float = 0.03
    damping: float = 100.0
    mass_scaling: float = 1.0


@dataclass(frozen=True)
class Explicit:
    """State at the end, and a row every 5 mm of travel and at the end."""

    scene: Model
    x: FloatArray
    rows: list[tuple[float, ...]]
    step: float
    steps: int
    wall_s: float
    processor_s: float

    def save(self, folder: Path) -> None:
        """Write `result.vtu` and `history.csv`: as another code could write them."""
        scene = self.scene
        blank, source, _, triangle, sign = scene.sheet.whole
        X = np.pad(blank.nodes, ((0, 0), (0, 1)))
        X[:, 2] = scene.sheet.positions(scene.x0)[source, 2]
        x = scene.sheet.whole_positions(self.x)
        gamma = np.degrees(scene.membrane.shear_angle(self.x))[triangle] * sign
        meshio.Mesh(
            x,
            [("triangle", blank.triangles)],
            point_data={"displacement": x - X},
            cell_data={"shear_angle": [gamma]},
        ).write(folder / "result.vtu")
        with (folder / "history.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(HEADINGS)
            writer.writerows([f"{value:.8g}" for value in row] for row in self.rows)


def integrate(scene: Model, motion: Motion) -> Explicit:
    """Integrate a scene in time from its start, at rest.

    The force of a row is the mean over the last millimetre of travel, at the end that over the
    second half of the hold: single values of an explicit run oscillate.
    """
    clock, processor = time.perf_counter(), time.process_time()
    free = ~scene.fixed
    memory = tuple(term.initial(scene.x0) for term in scene.terms)
    potential = Potential(scene.terms, free, memory)
    m = _masses(scene, motion.mass_scaling)
    dt = STABLE * 2.0 / _highest(scene, potential, memory, m)
    steps = int(np.ceil((motion.duration + motion.hold) / dt))
    half = 0.5 * motion.damping * dt
    x, v = scene.x0.copy(), np.zeros_like(scene.x0)
    _, rate = scene.prescribed(0.0)
    rows, window = [], []
    goal = 0.0
    for i in range(steps + 1):
        tau = min(i * dt / motion.duration, 1.0)
        travel = scene.travel * tau**3 * (10 - 15 * tau + 6 * tau**2)
        place, rate = scene.prescribed(travel)
        x = np.where(free, x, place)
        memory = potential.refresh(x, memory)
        g = potential.gradient(x, memory)
        memory = potential.commit(x, memory)
        before = v
        v = np.where(free, ((1 - half) * v - dt * g / m) / (1 + half), 0.0)
        force = float(np.where(free, 0.0, rate) @ g) / scene.share
        window.append((i * dt, travel, force))
        resting = i * dt > motion.duration
        if (travel >= goal and not resting) or i == steps:
            since = motion.duration + 0.5 * motion.hold if i == steps else -1.0
            recent = [f for t, s, f in window if s >= travel - 1.0 and t >= since]
            speed = 0.5 * (before + v)
            kinetic = 0.5 * float((m * speed**2)[free].sum()) / scene.share
            rows.append((travel, float(np.mean(recent)), kinetic, _internal(scene, x)))
            goal = 5.0 * (np.floor(travel / 5.0) + 1)
            window = []
        x = x + dt * v
    taken = time.perf_counter() - clock, time.process_time() - processor
    return Explicit(scene, x, rows, dt, steps, *taken)


def _masses(scene: Model, scaling: float) -> FloatArray:
    """(n_dofs,) lumped masses, t; ones on prescribed dofs."""
    m = np.ones(len(scene.x0))
    sheet = scene.sheet
    areas = 1e-12 * sheet.fabric.areal_weight * scaling * sheet.blank.node_areas
    m[sheet.dofs] = areas[:, None]
    for contact in scene.contacts:
        if contact.tool.motion == "free":
            m[contact.tool_dofs] = 1e-3 * contact.tool.mass * scene.share
    return m


def _highest(scene: Model, potential: Potential, memory: Memory, m: FloatArray) -> float:
    """Highest frequency, 1/s, of the start with each point of the sheet in contact with all tools.

    The contacts are included by the row sums of their stiffness.
    """
    values, _ = potential.hessian(scene.x0, memory, convex=True)
    upper = csr_array((values, potential.pattern.indices, potential.pattern.indptr))
    touch = np.zeros(len(m))
    for contact in scene.contacts:
        np.add.at(touch, contact.dofs, contact.stiffness_bound(scene.x0))
    root = 1.0 / np.sqrt(m[potential.free])
    K = upper + upper.T - diags_array(upper.diagonal()) + diags_array(2.0 * touch[potential.free])
    scaled = diags_array(root) @ K @ diags_array(root)
    return float(np.sqrt(eigsh(scaled, k=1, which="LA", tol=1e-3)[0][0]))


def _internal(scene: Model, x: FloatArray) -> float:
    """Strain energy of the sheet and of its contacts, mJ."""
    stored = [t for t in scene.terms if not isinstance(t, Friction | ToolWeight)]
    return float(sum(term.energy(x, None).sum() for term in stored)) / scene.share
