"""Coulomb's closed forms: a strip over a drum, one between plates, a sheet on an incline."""

from dataclasses import dataclass

import numpy as np

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact
from quasiform.energy.friction import Friction
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import GRAVITY, SheetWeight, ToolWeight
from quasiform.tools.shapes import Distance, Plane, bar, flipped
from quasiform.unknowns import Sheet, Unknowns

LOAD, RADIUS, LEAD, WIDTH = 20.0, 50.0, 25.0, 10.0  # N, mm


def values() -> dict[str, float]:
    """Pulls divided by dead loads, forces divided by Coulomb's, and energy balances."""
    found = {}
    for wrap, friction in ((90, 0.0), (90, 0.157), (90, 0.3), (45, 0.157), (180, 0.157)):
        run = qf.solve(capstan(friction, float(wrap), size=2.5), estimate=False)
        exact = theory.capstan_ratio(friction, np.radians(wrap))
        found[f"capstan {wrap} deg, mu={friction:g}: pull / load / e^(mu phi)"] = (
            run.force / LOAD / exact
        )
    run = qf.solve(capstan(0.157, 90.0, size=5.0), estimate=False)
    exact = theory.capstan_ratio(0.157, np.pi / 2)
    found["capstan 90 deg, mu=0.157, size 5: pull / load / e^(mu phi)"] = run.force / LOAD / exact
    for mass, friction in ((5.0, 0.157), (20.0, 0.157), (5.0, 0.4)):
        run = qf.solve(strip(mass, friction, 2.0), estimate=False)
        limit = theory.strip_friction(friction, mass)
        found[f"strip {mass:g} kg, mu={friction:g}: force / (2 mu m g)"] = run.force / limit
        found[f"strip {mass:g} kg, mu={friction:g}: energy balance"] = run.energy_balance
    # far below the length of elastic sticking: the strip sticks and does not creep
    run = qf.solve(strip(5.0, 0.157, 2e-4), increment=2e-5, estimate=False)
    force = run.history["force_N"]
    found["strip that sticks: force / (2 mu m g)"] = run.force / theory.strip_friction(0.157, 5.0)
    found["strip that sticks: largest deviation from proportionality"] = float(
        np.abs(np.diff(force) / force[1] - 1).max()
    )
    held, slides = (qf.solve(incline(share), estimate=False) for share in (0.999, 1.001))
    found["incline 0.1 % below the limit: creep"] = creep(held)
    found["incline 0.1 % above the limit: load factor reached"] = slides.states[-1].travel
    return found


@dataclass(frozen=True)
class Incline:
    """The half space below a plane that falls along x."""

    slope: float
    sharpest = np.inf

    @property
    def normal(self) -> np.ndarray:
        return np.array([np.sin(self.slope), 0.0, np.cos(self.slope)])

    def distance(self, points: np.ndarray) -> Distance:
        d, n = points @ self.normal, np.tile(self.normal, (len(points), 1))
        return d, n, np.zeros((len(points), 3, 3))


def incline(share: float, friction: float = 0.157, size: float = 10.0) -> qf.Model:
    """A sheet on a plane inclined by `share` of tan φ = μ, its weight raised by a load factor."""
    fabric = qf.Fabric()
    plane = Incline(float(np.arctan(share * friction)))
    blank = qf.rectangle(100.0, 100.0, size)
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    height, factor = unknowns.add("plane", 1), unknowns.add("load factor", 1)
    x0, fixed, drive = unknowns.start(sheet)
    n, t0 = plane.normal, fabric.thickness
    x, y = blank.nodes.T
    x0[sheet.dofs] = np.column_stack([n[2] * x, y, -n[0] * x]) + t0 / 2 * n
    fixed[height.dofs] = fixed[factor.dofs] = True
    drive[factor.dofs] = 1.0
    contact = Contact(sheet, qf.Tool("plane", plane, friction=friction), height.dofs)
    load = 1e-6 * GRAVITY * fabric.areal_weight
    weight = SheetWeight(sheet, load, int(factor.dofs[0, 0]))
    return qf.Model(
        name="incline",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), Bending(sheet), contact, Friction(contact), weight],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=1.0,
        increment=0.25,
        rows=0.25,
        travel_name="load_factor",
        dead_load=load * blank.areas.sum(),
    )


def creep(result: qf.Result) -> float:
    """Longest motion of a node along the plane in a run of `incline`, mm."""
    n = result.model.contacts[0].tool.shape.normal
    moved = np.array([result.positions(i) for i in range(len(result.states))]) - result.positions(0)
    return float(np.linalg.norm(moved - (moved @ n)[..., None] * n, axis=-1).max())


class EndLoad(qf.Term):
    """Dead load along -x, shared by some nodes."""

    name = "end load"

    def __init__(self, sheet: Sheet, nodes: np.ndarray, load: float) -> None:
        self.dofs = sheet.dofs[nodes, :1]
        self.share = load / len(nodes)

    def energy(self, x: np.ndarray, state: None = None) -> np.ndarray:
        return self.share * x[self.dofs[:, 0]]

    def gradient(self, x: np.ndarray, state: None = None) -> np.ndarray:
        return np.full(self.dofs.shape, self.share)

    def hessian(self, x: np.ndarray, state: None, convex: bool) -> np.ndarray:
        return np.zeros((len(self.dofs), 1, 1))


def capstan(friction: float, wrap: float, size: float) -> qf.Model:
    """A strip over a fixed drum: dead load on one straight end, the other one pulled 3 mm along."""
    fabric = qf.Fabric()
    mid = RADIUS + fabric.thickness / 2
    phi = np.radians(wrap)
    arc = mid * phi
    length = 2 * LEAD + arc
    blank = qf.rectangle(length, WIDTH, size, centre=(length / 2, 0.0))
    n = len(blank.nodes)
    s = blank.nodes[:, 0] - LEAD
    angle = np.clip(s / mid, 0.0, phi)
    before, beyond = np.minimum(s, 0.0), np.maximum(s - arc, 0.0)
    wrapped = np.column_stack(
        [
            mid * np.sin(angle) + before + beyond * np.cos(phi),
            blank.nodes[:, 1],
            mid * np.cos(angle) - beyond * np.sin(phi),
        ]
    )
    x0 = np.append(wrapped.ravel(), 0.0)
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    drum = qf.Tool("drum", bar(RADIUS), friction=friction)
    contact = Contact(sheet, drum, unknowns.add("drum", 1).dofs)
    loaded = np.flatnonzero(blank.nodes[:, 0] < 1e-9)
    pulled = np.flatnonzero(blank.nodes[:, 0] > length - 1e-9)
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[3 * n] = True
    fixed[3 * loaded + 1] = fixed[3 * loaded + 2] = True
    fixed[(3 * pulled[:, None] + np.arange(3)).ravel()] = True
    drive = np.zeros(len(x0))
    drive[3 * pulled], drive[3 * pulled + 2] = np.cos(phi), -np.sin(phi)
    terms = [Membrane(sheet), Bending(sheet), contact, EndLoad(sheet, loaded, LOAD)]
    if friction:
        terms.append(Friction(contact))
    return qf.Model(
        name="capstan",
        unknowns=unknowns,
        sheets=[sheet],
        terms=terms,
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=3.0,
        increment=1.0,
        rows=1.0,
        resting=LOAD,
    )


def strip(mass: float, friction: float, pull: float) -> qf.Model:
    """A strip on a fixed plate under a loose one with weight, pulled at one end."""
    fabric = qf.Fabric()
    blank = qf.rectangle(100.0, 50.0, 10.0)
    n, t0, load = len(blank.nodes), fabric.thickness, 1e3 * GRAVITY * mass
    plates = [
        qf.Tool("table", Plane(), friction=friction),
        qf.Tool("plate", flipped(Plane()), t0, "free", friction, mass),
    ]
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    contacts = [Contact(sheet, plate, unknowns.add(plate.name, 1).dofs) for plate in plates]
    sunk = contacts[1].depth_under(load, blank.areas.sum())
    flat = np.column_stack([blank.nodes, np.full(n, t0 / 2 - sunk)])
    x0 = np.append(flat.ravel(), [0.0, t0 - 2 * sunk])
    pulled = np.flatnonzero(blank.nodes[:, 0] > 50.0 - 1e-9)
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[3 * n] = True
    fixed[3 * pulled] = fixed[3 * pulled + 1] = True
    drive = np.zeros(len(x0))
    drive[3 * pulled] = 1.0
    return qf.Model(
        name="strip",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[
            *(Membrane(sheet), Bending(sheet), *contacts),
            *(Friction(contact) for contact in contacts),
            ToolWeight(load, 3 * n + 1),
        ],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=pull,
        increment=0.5,
        rows=0.5,
        resting=load,
    )
