"""Scenes built by hand, against closed forms: a strip over a drum, and one between plates."""

from contextlib import nullcontext

import numpy as np
import pytest

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.contact import BLEND, Contact
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import ToolWeight
from quasiform.solve.equilibrium import Equilibrium
from quasiform.solve.linear import SlidesOffError
from quasiform.tools.shapes import Plane, flipped
from quasiform.unknowns import Unknowns
from validation.friction_exact.case import LOAD, capstan, creep, incline, strip


@pytest.mark.parametrize("friction", [0.0, 0.157, 0.3])
def test_capstan(friction):
    result = qf.solve(capstan(friction, 90.0, size=2.5))
    assert result.status == "completed"
    assert result.force / LOAD == pytest.approx(theory.capstan_ratio(friction, np.pi / 2), rel=0.01)


def test_strip_between_plates_slips_at_coulombs_limit():
    result = qf.solve(strip(5.0, 0.157, pull=2.0))
    assert result.certified
    assert result.force == pytest.approx(theory.strip_friction(0.157, 5.0), rel=0.01)
    assert result.energy_balance < 0.01


def test_strip_between_plates_sticks_below_the_limit():
    # a tenth of the elastic reach of the stick holds the strip elastically: no creep
    scene = strip(5.0, 0.157, pull=2e-4)
    result = qf.solve(scene, increment=2e-5)
    limit = theory.strip_friction(0.157, 5.0)
    assert 0.0 < result.force < 0.6 * limit
    forces = result.history["force_N"]
    assert np.allclose(np.diff(forces), forces[1], rtol=1e-3)


@pytest.mark.parametrize(("friction", "size"), [(0.157, 10.0), (0.157, 5.0), (0.5, 10.0)])
def test_a_sheet_below_the_friction_angle_does_not_creep(friction, size):
    result = qf.solve(incline(0.999, friction, size), estimate=False)
    assert result.status == "completed"
    assert creep(result) < 1e-3


@pytest.mark.parametrize("share", [1.001, 1.2, 3.0])
def test_a_sheet_beyond_the_friction_angle_slides_off(share):
    result = qf.solve(incline(share), estimate=False)
    assert result.reason.endswith("slides off: friction cannot hold it")
    assert result.states[-1].travel < 0.05
    assert creep(result) < 1e-3  # nothing was accepted that slides


def test_a_point_that_jumps_is_no_sheet_that_slides_off():
    equations = Equilibrium(incline(0.999))
    model, x = equations.model, equations.model.x0
    equations.begin(x, 1e-6)
    nodes = model.sheet.dofs[:, 0]
    for moved, slides in ((nodes[:1], False), (nodes, True)):
        far = x.copy()
        far[moved] += 100.0 * equations.mesh_size
        with pytest.raises(SlidesOffError) if slides else nullcontext():
            equations.check_slide(far)


@pytest.mark.parametrize("place", [(0.0, 0.0), (8.0, 0.0), (0.0, -3.0), (-5.0, 2.0)])
def test_a_plate_tilts_until_the_pressure_under_it_balances_its_weight(place):
    """Far in the linear range, p = P/(k A) + e/2 + P (a·x)/(k I), once on each face.

    a is the place of the weight, less what the mid-surface, where contact acts, turns away.
    """
    fabric, load = qf.Fabric(compaction=40.0), 4e4  # stiff, so that the tilt is small
    blank = qf.rectangle(100.0, 50.0, 10.0)
    n, t0 = len(blank.nodes), fabric.thickness
    unknowns = Unknowns()
    sheet = unknowns.sheet(blank, fabric, dim=3)
    table = qf.Tool("table", Plane())
    plate = qf.Tool("plate", flipped(Plane()), t0, "free", 0.0, 0.0, load, place, tilts=True)
    contacts = [
        Contact(sheet, tool, unknowns.add(tool.name, count).dofs)
        for tool, count in ((table, 1), (plate, 3))
    ]
    p = load / (fabric.compaction * 5000.0) + BLEND * t0 / 2
    flat = np.column_stack([blank.nodes, np.full(n, t0 / 2 - p)])
    x0 = np.append(flat.ravel(), [0.0, t0 - 2 * p, 0.0, 0.0])
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[: 3 * n] = np.tile([True, True, False], n)  # held in its plane
    fixed[3 * n] = True
    result = qf.solve(
        qf.Model(
            name="tilting plate",
            unknowns=unknowns,
            sheets=[sheet],
            terms=[
                *(Membrane(sheet), Bending(sheet), *contacts),
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
    height, about_x, about_y = x[-3], *x[-2:] / contacts[1].lever
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
