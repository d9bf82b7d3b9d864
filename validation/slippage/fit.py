"""Fit shear law and slip to INSA's strip of 150 x 450 mm and to UN's twill strip of 100 x 200 mm.

    python -m validation.slippage.fit

writes `insa-plain.toml`, `un-twill.toml` and, fitted to the same data without slip,
`insa-plain-no-slip.toml`. No other strip is read here.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import quasiform as qf
from quasiform.identification.energy_method import Forces, energy_method
from quasiform.identification.fit import Trial, search
from quasiform.identification.records import Curve
from quasiform.identification.slipping import (
    SlippingSheet,
    SlipUnknowns,
    Table,
    slip_parameters,
)
from quasiform.identification.specimen import OffAxis

FOLDER = Path(__file__).parent
KNOTS = (1.0, 4.0, 10.0, 18.0, 27.0, 36.0, 45.0)  # degrees
FORCE, SIZES = 0.065, 12  # weight: 6.5 % of a force as 0.5 degrees of an angle; cells over a width
PITCH = 5.0  # mm, assumed
START = 1e-3  # N/mm³
KINEMATIC = 60.0  # degrees, to which a strip without a measured angle is used
RIGID = qf.Slip(np.inf, 1e3, 1e-3)  # no slip


def measured(name: str) -> np.ndarray:
    """(k, n) columns of a measured curve, sorted by displacement."""
    rows = np.genfromtxt(FOLDER / f"{name}.csv", delimiter=",", skip_header=1, comments="#")
    rows = rows[np.isfinite(rows).all(1)]
    return rows[np.argsort(rows[:, 0], kind="stable")].T


def fitted(
    name: str, specimen: OffAxis, thickness: float, slip: qf.Slip, with_slip: bool = True
) -> tuple[qf.Fabric, Trial]:
    """Fabric with the law and the slip that fit the force and, where it was measured, the angle."""
    u, force, *angle = measured(name)
    u, force, *angle = (column[u > 0.01 * u.max()] for column in (u, force, *angle))
    sigma, bare = FORCE * force, Curve(force, u, None, FORCE * force)
    if not angle:
        used = np.degrees(specimen.angle_of(bare)) < KINEMATIC
        u, force, sigma = u[used], force[used], sigma[used]
        bare = Curve(force, u, None, sigma)
    forces = Forces(force, sigma, *specimen.shares(bare, thickness))
    table = Table.through(energy_method([forces]).law(), KNOTS)
    unknowns = SlipUnknowns(table, slip, () if with_slip else ("stiffness",))
    fabric = replace(qf.Fabric(), thickness=thickness, in_plane_bending=0.0)
    curve = replace(bare, shear_angle=np.radians(angle[0]) if angle else None)
    sheet = SlippingSheet(specimen, curve, fabric, specimen.width / SIZES, slip)
    trial = search([sheet], unknowns, 1e-4)
    law = unknowns.law(trial[1].x)
    end = float(np.degrees(curve.shear_angle.max())) if angle else KINEMATIC
    found = replace(fabric, shear=law.shear, slip=law.slip if with_slip else None, shear_range=end)
    origins = {"shear": f"measured: {name}", "in_plane_bending": "assumed: not published"}
    if with_slip:
        parameters, _ = slip_parameters(trial)
        origins |= {"slip": f"measured: {name}", "slip.pitch": "assumed"}
        K = parameters[0]
        origins["slip.stiffness"] = f"measured: {name}, 95 % interval {K.low:.2g} to {K.high:.2g}"
    return replace(found, name=name, provenance=origins), trial


def main() -> None:
    """Fit and write the fabrics."""
    start = qf.Slip(np.inf, START, PITCH)
    insa, twill = OffAxis(450.0, 150.0, 45.0), OffAxis(200.0, 100.0, 45.0)
    for file, given in {
        "insa-plain": ("insa-150x450", insa, 1.2, start),
        "insa-plain-no-slip": ("insa-150x450", insa, 1.2, RIGID, False),
        "un-twill": ("un-twill-100x200", twill, 3.3, start),
    }.items():
        fabric, (unknowns, found) = fitted(*given)
        fabric.save(FOLDER / f"{file}.toml")
        print(file, f"cost {found.cost:.4g}", fabric.slip)
        if unknowns.names:
            print("   ", *slip_parameters((unknowns, found)))


if __name__ == "__main__":
    main()
