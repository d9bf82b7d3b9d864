"""Scenes built by hand, against closed forms: a strip over a drum and a strip between plates."""

import numpy as np
import pytest

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact
from quasiform.energy.friction import Friction
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import ToolWeight
from quasiform.tool import Cylinder, Flipped, Plane


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
    drum = qf.Tool("drum", Cylinder(radius), friction=friction)
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
        qf.Tool("plate", Flipped(Plane()), t0, "free", friction, mass),
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
            ToolWeight(mass, 3 * n + 1),
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
