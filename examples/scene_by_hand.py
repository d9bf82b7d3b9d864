"""A scene from its parts: a sheet that drapes over a ball under its own weight, with friction.

Where no ready scene fits, blank, energies, supports and travel are put together by hand. The travel
here is a load factor that raises the weight of the sheet from nothing to three times its own. A
quarter is modelled, with mirror planes along the fibres; results are those of the whole sheet.
"""

import numpy as np
import shapely

import quasiform as qf
from quasiform.energy.bending import Bending
from quasiform.energy.contact import Contact, at_nodes
from quasiform.energy.friction import Friction
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import GRAVITY, SheetWeight
from quasiform.net.blank import cut
from quasiform.tools.shapes import ball

fabric = qf.Fabric()
side, radius = 300.0, 60.0
blank = cut(shapely.box(-side / 2, -side / 2, side / 2, side / 2), size=15.0, mirror=("x", "y"))
n = len(blank.nodes)

# Degrees of freedom: three a node, then the height of the ball and the load factor
height_dof, factor_dof = 3 * n, 3 * n + 1
x0 = np.zeros(3 * n + 2)
positions = x0[: 3 * n].reshape(-1, 3)  # a view
positions[:, :2] = blank.nodes
positions[:, 2] = radius + fabric.thickness / 2 - 0.01  # the middle surface, just touching

fixed = np.zeros(len(x0), dtype=bool)
fixed[[height_dof, factor_dof]] = True
for axis in (0, 1):  # nodes on a mirror plane stay in it
    fixed[axis : 3 * n : 3] = np.abs(blank.nodes[:, axis]) < 1e-9
drive = np.zeros(len(x0))
drive[factor_dof] = 1.0

form = qf.Tool("ball", ball(radius), friction=fabric.friction)
contact = Contact(blank, fabric, form, height_dof, at_nodes(blank))
weight = GRAVITY * fabric.areal_weight * 1e-6  # N/mm²
scene = qf.Scene(
    name="draped",
    blank=blank,
    fabric=fabric,
    dim=3,
    terms=[
        Membrane(blank, fabric, dim=3),
        Bending(blank, fabric),
        contact,
        Friction(contact, x0),
        SheetWeight(blank, weight, factor_dof),
    ],
    x0=x0,
    fixed=fixed,
    drive=drive,
    travel=3.0,
    increment=0.25,
    rows=0.5,
    travel_name="load_factor",
    share=0.25,
    dead_load=3 * weight * blank.areas.sum(),
)
result = qf.solve(scene)
corner = result.positions()[:, 2].min() - result.positions(0)[:, 2].min()

print(f"{result.status}: the corners hang {-corner:.1f} mm below the middle's height at the start")
