"""A model from its parts: a sheet that drapes over a ball under its own weight, with friction.

Where no ready scene fits, unknowns, energies, supports and travel are put together by hand. The
travel is a load factor here: it raises the weight of the sheet from nothing to three times its own.
A quarter is modelled, with mirror planes along the fibres; results are those of the whole sheet.
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
from quasiform.unknowns import Unknowns

fabric = qf.Fabric()
side, radius = 300.0, 60.0
blank = cut(shapely.box(-side / 2, -side / 2, side / 2, side / 2), size=15.0, mirror=("x", "y"))

# The unknowns: three for each node, then the height of the ball and the load factor
unknowns = Unknowns()
sheet = unknowns.sheet(blank, fabric, dim=3)
height, factor = unknowns.add("ball", 1), unknowns.add("load factor", 1)
x0 = np.zeros(unknowns.size)
x0[sheet.dofs[:, :2]] = blank.nodes
x0[sheet.dofs[:, 2]] = radius + fabric.thickness / 2 - 0.01  # the middle surface, just touching

fixed = np.zeros(unknowns.size, dtype=bool)
fixed[height.dofs] = fixed[factor.dofs] = True
for axis in (0, 1):  # nodes on a mirror plane stay in it
    fixed[sheet.dofs[:, axis]] = np.abs(blank.nodes[:, axis]) < 1e-9
drive = np.zeros(unknowns.size)
drive[factor.dofs] = 1.0

form = qf.Tool("ball", ball(radius), friction=fabric.friction)
contact = Contact(sheet, form, height.dofs, at_nodes(blank))
weight = GRAVITY * fabric.areal_weight * 1e-6  # N/mm²
model = qf.Model(
    name="draped",
    unknowns=unknowns,
    sheets=[sheet],
    terms=[
        Membrane(sheet),
        Bending(sheet),
        contact,
        Friction(contact),
        SheetWeight(sheet, weight, int(factor.dofs[0, 0])),
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
result = qf.solve(model)
corner = result.positions()[:, 2].min() - result.positions(0)[:, 2].min()

print(f"{result.status}: the corners hang {-corner:.1f} mm below the middle's height at the start")
