"""Off-axis tension test at 30 degrees: forces, upper bound on the energy, collapse."""

from dataclasses import replace

import numpy as np

import quasiform as qf
from quasiform import theory

# theory and the other codes have no in-plane bending
LAWS = {n: replace(qf.Fabric.preset(n), in_plane_bending=0.0) for n in ("best-fit", "locking")}


def values() -> dict[str, float]:
    """Forces and energies at u = 5, 10, 15 mm; where triangles and the centre pass 85 degrees."""
    found = {}
    ideal = theory.OffAxisTension(320.0, 160.0, np.pi / 6)
    result = qf.solve(qf.off_axis_tension(30, LAWS["locking"], displacement=15), estimate=False)
    fabric = result.model.sheet.fabric
    found["energy balance"] = result.energy_balance
    for state in result.states:
        if state.travel not in (5.0, 10.0, 15.0):  # there are rows between
            continue
        u = round(state.travel)
        found[f"force u={u}"] = state.force
        bound = ideal.energy(state.travel, fabric.shear.energy, fabric.thickness)
        stored = result.model.membrane.energy(state.x).sum()
        found[f"energy divided by that of the uniform bands u={u}"] = stored / bound

    for law in ("best-fit", "locking"):
        result = qf.solve(qf.off_axis_tension(30, LAWS[law]), increment=1.0, estimate=False)
        found[f"displacement reached, {law}"] = result.states[-1].travel
        found[f"displacement of the first triangle beyond 85 deg, {law}"] = result.collapse[
            "travel_mm"
        ]
        centre = result.history["shear_angle_center_deg"]
        found[f"largest centre angle, {law}"] = np.abs(centre).max()
        at = np.abs(centre).argmax()
        found[f"displacement of the largest centre angle, {law}"] = result.states[at].travel
        finite = [np.isfinite(values).all() for values in result.sheet.cell_fields.values()]
        found[f"all fields finite (1: yes), {law}"] = float(all(finite))
    return found
