"""Scenes built by hand, against closed forms: a strip over a drum, and one between plates."""

import numpy as np
import pytest

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.contact import BLEND, LEVER, Contact
from quasiform.energy.friction import Friction
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import GRAVITY, ToolWeight
from quasiform.tool import Plane, bar, flipped


class EndLoad:
    """Dead load along -x on the positions of some nodes: a user's own energy term."""

    name = "end load"

    def __init__(self, nodes, load):
        self.dofs = 3 * np.asarray(nodes)[:, None]
        self.load = load / len(nodes)

    def energy(self, x):
        return self.load * x[self.dofs[:, 0]]

    def gradient(self, x):
        return np.full(self.dofs.shape, self.load)

    def hessian(self, x, convex):
        return np.zeros((len(self.dofs), 1, 1))


def capstan(load, friction, size, radius=50.0, lead=25.0, width=10.0, pull=3.0):
    """A strip over a quarter of a fixed drum: dead load on the flat end, the hanging end pulled."""
    fabric = qf.Fabric()
    mid = radius + fabric.thickness / 2
    arc = mid * np.pi / 2
    length = 2 * lead + arc
    blank = qf.rectangle(length, width, size, centre=(length / 2, 0.0))
    n = len(blank.nodes)
    s = blank.nodes[:, 0] - lead
    angle = np.clip(s / mid, 0.0, np.pi / 2)
    wrapped = np.column_stack(
        [
            mid * np.sin(angle) + np.minimum(s, 0.0),
            blank.nodes[:, 1],
            mid * np.cos(angle) - np.maximum(s - arc, 0.0),
        ]
    )
    x0 = np.append(wrapped.ravel(), 0.0)
    drum = qf.Tool("drum", bar(radius), friction=friction)
    contact = Contact(blank, fabric, drum, 3 * n)
    loaded = np.flatnonzero(blank.nodes[:, 0] < 1e-9)
    pulled = np.flatnonzero(blank.nodes[:, 0] > length - 1e-9)
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[3 * n] = True
    fixed[3 * loaded + 1] = fixed[3 * loaded + 2] = True
    for axis in range(3):
        fixed[3 * pulled + axis] = True
    drive = np.zeros(len(x0))
    drive[3 * pulled + 2] = -1.0
    terms = [Membrane(blank, fabric, 3), Bending(blank, fabric), contact, EndLoad(loaded, load)]
    if friction:
        terms.append(Friction(contact, x0))
    return qf.Scene(
        name="capstan",
        blank=blank,
        fabric=fabric,
        dim=3,
        terms=terms,
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=pull,
        increment=1.0,
        rows=1.0,
        resting=load,
    )


@pytest.mark.parametrize("friction", [0.0, 0.157, 0.3])
def test_capstan(friction):
    load = 20.0
    result = qf.solve(capstan(load, friction, size=2.5))
    assert result.status == "completed"
    assert result.force / load == pytest.approx(theory.capstan_ratio(friction, np.pi / 2), rel=0.01)


def strip_between_plates(mass, friction, pull):
    """A strip on a fixed plate under a loose one with weight, pulled at one end."""
    fabric = qf.Fabric()
    blank = qf.rectangle(100.0, 50.0, 10.0)
    n, t0 = len(blank.nodes), fabric.thickness
    plates = [
        qf.Tool("table", Plane(), friction=friction),
        qf.Tool("plate", flipped(Plane()), t0, "free", friction, mass),
    ]
    contacts = [Contact(blank, fabric, plate, 3 * n + i) for i, plate in enumerate(plates)]
    sunk = contacts[1].depth_under(9.81 * mass, blank.areas.sum())
    positions = np.column_stack([blank.nodes, np.full(n, t0 / 2 - sunk)])
    x0 = np.append(positions.ravel(), [0.0, t0 - 2 * sunk])
    pulled = np.flatnonzero(blank.nodes[:, 0] > 50.0 - 1e-9)
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[3 * n] = True
    fixed[3 * pulled] = fixed[3 * pulled + 1] = True
    drive = np.zeros(len(x0))
    drive[3 * pulled] = 1.0
    return qf.Scene(
        name="strip",
        blank=blank,
        fabric=fabric,
        dim=3,
        terms=[
            Membrane(blank, fabric, 3),
            Bending(blank, fabric),
            *contacts,
            *[Friction(contact, x0) for contact in contacts],
            ToolWeight(1e3 * GRAVITY * mass, 3 * n + 1),
        ],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=pull,
        increment=0.5,
        rows=0.5,
        resting=9.81 * mass,
    )


def test_strip_between_plates_slips_at_coulombs_limit():
    result = qf.solve(strip_between_plates(5.0, 0.157, pull=2.0))
    assert result.certified is True
    assert result.force == pytest.approx(theory.strip_friction(0.157, 5.0), rel=0.01)
    assert result.energy_balance < 0.01


def test_strip_between_plates_sticks_below_the_limit():
    # a tenth of the elastic reach of the stick holds the strip elastically: no creep
    scene = strip_between_plates(5.0, 0.157, pull=2e-4)
    result = qf.solve(scene, increment=2e-5)
    limit = theory.strip_friction(0.157, 5.0)
    assert 0.0 < result.force < 0.6 * limit
    forces = result.history["force_N"]
    assert np.allclose(np.diff(forces), forces[1], rtol=1e-3)


@pytest.mark.parametrize("place", [(0.0, 0.0), (8.0, 0.0), (0.0, -3.0), (-5.0, 2.0)])
def test_a_plate_tilts_until_the_pressure_under_it_balances_its_weight(place):
    """Far in the linear range, p = P/(k A) + e/2 + P (a·x)/(k I), once on each face.

    a is the place of the weight, less what the mid-surface, where contact acts, turns away.
    """
    fabric, load = qf.Fabric(compaction=40.0), 4e4  # stiff, so that the tilt is small
    blank = qf.rectangle(100.0, 50.0, 10.0)
    n, t0 = len(blank.nodes), fabric.thickness
    table = qf.Tool("table", Plane())
    plate = qf.Tool("plate", flipped(Plane()), t0, "free", 0.0, 0.0, load, place, tilts=True)
    contacts = [Contact(blank, fabric, table, 3 * n), Contact(blank, fabric, plate, 3 * n + 1)]
    p = load / (fabric.compaction * 5000.0) + BLEND / 2
    flat = np.column_stack([blank.nodes, np.full(n, t0 / 2 - p)])
    x0 = np.append(flat.ravel(), [0.0, t0 - 2 * p, 0.0, 0.0])
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[: 3 * n] = np.tile([True, True, False], n)  # held in its plane
    fixed[3 * n] = True
    result = qf.solve(
        qf.Scene(
            name="tilting plate",
            blank=blank,
            fabric=fabric,
            dim=3,
            terms=[
                *(Membrane(blank, fabric, 3), Bending(blank, fabric), *contacts),
                ToolWeight(load, 3 * n + 1),
            ],
            x0=x0,
            fixed=fixed,
            drive=np.zeros(len(x0)),
            travel=1.0,
            increment=1.0,
            rows=1.0,
            resting=load,
        ),
        tolerance=1e-6,
    )
    assert result.status == "completed"
    x = result.states[-1].x
    height, about_x, about_y = x[-3], *x[-2:] / LEVER
    c = 2 * load / (fabric.compaction * (blank.node_areas @ blank.nodes**2))
    slope = c * place / (1 + c * (t0 / 2 - p))
    # a turn about y lowers the side of positive x, one about x lifts that of positive y
    assert (about_y, -about_x) == pytest.approx(tuple(slope), rel=1e-4, abs=1e-8)
    assert height == pytest.approx(t0 - 2 * p - slope @ place, abs=1e-6)
    for contact, upright in zip(contacts, (1.0, np.cos(about_x) * np.cos(about_y)), strict=True):
        force = contact.pressure(x) * blank.node_areas * upright
        assert force.sum() == pytest.approx(load, rel=1e-6)
        moment = load * slope / c
        assert force @ blank.nodes == pytest.approx(moment, rel=1e-4, abs=0.1)
