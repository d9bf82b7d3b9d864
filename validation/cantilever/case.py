"""Cantilever under its own weight against the heavy elastica."""

import numpy as np

import quasiform as qf
from quasiform import theory
from quasiform.energy.bending import Bending
from quasiform.energy.membrane import Membrane
from quasiform.energy.weight import SheetWeight
from quasiform.unknowns import Unknowns

LENGTH = 100.0


def values() -> dict[str, float]:
    """Drop of the tip divided by that of the elastica; energy of a twisted strip."""
    fabric = qf.Fabric()
    found = {}
    for family, B in (("warp", fabric.bending_warp), ("weft", fabric.bending_weft)):
        for k in (1, 2, 8):
            scene = qf.cantilever(LENGTH, k * B / LENGTH**3, width=10.0, size=5.0, family=family)
            found[f"{family} k={k}: drop of the tip / exact"] = (
                _tip_drop(scene) / theory.heavy_elastica(k)[1]
            )
    for k in (1, 2, 8):
        scene = _balanced(fabric, k * fabric.bending_warp / LENGTH**3)
        found[f"mirrored k={k}: drop of the tip / exact"] = (
            _tip_drop(scene) / theory.heavy_elastica(k)[1]
        )
    found["bending energy of a twisted strip / that of a bent one"] = _twist(fabric)
    return found


def _tip_drop(scene: qf.Model) -> float:
    result = qf.solve(scene, estimate=False)
    tip = np.isclose(scene.sheet.blank.nodes[:, 0], LENGTH)
    return -scene.sheet.positions(result.states[-1].x)[tip, 2].mean() / LENGTH


def _balanced(fabric: qf.Fabric, load: float) -> qf.Model:
    """Half of a strip that rests on its middle: the mirror plane clamps it."""
    blank = qf.rectangle(2 * LENGTH, 10.0, 5.0, through=((0.0, 0.0),), mirror=("x", "y"))
    n = len(blank.nodes)
    x0 = np.append(np.column_stack([blank.nodes, np.zeros(n)]).ravel(), 0.0)
    fixed = np.zeros(len(x0), dtype=bool)
    fixed[-1] = True
    middle = np.flatnonzero(blank.nodes[:, 0] == 0)
    fixed[3 * middle] = fixed[3 * middle + 2] = True
    fixed[3 * np.flatnonzero(blank.nodes[:, 1] == 0) + 1] = True
    drive = np.zeros(len(x0))
    drive[-1] = 1.0
    sheet = (unknowns := Unknowns()).sheet(blank, fabric, dim=3)
    factor = int(unknowns.add("load factor", 1).dofs[0, 0])
    return qf.Model(
        name="balanced strip",
        unknowns=unknowns,
        sheets=[sheet],
        terms=[Membrane(sheet), Bending(sheet), SheetWeight(sheet, load, factor)],
        x0=x0,
        fixed=fixed,
        drive=drive,
        travel=1.0,
        increment=0.25,
        rows=0.25,
    )


def _twist(fabric: qf.Fabric) -> float:
    """Bending energy of a free strip on z = c x y, divided by that on z = c x²/2, c small."""
    blank = qf.rectangle(60.0, 30.0, 5.0)
    bending = Bending(Unknowns().sheet(blank, fabric, dim=3))
    X, Y = blank.nodes.T
    energies = [
        bending.energy(np.column_stack([X, Y, z]).ravel()).sum()
        for z in (1e-5 * X * Y, 0.5e-5 * X**2)
    ]
    return energies[0] / energies[1]
