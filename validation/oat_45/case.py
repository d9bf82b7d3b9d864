"""Off-axis tension test at 45 degrees compared with other codes and the power balance."""

from dataclasses import replace

import numpy as np

import quasiform as qf
from quasiform import theory
from quasiform.scenes.fabric_tests import off_axis_zones

# theory and the other codes have no in-plane bending
LAWS = {n: replace(qf.Fabric.preset(n), in_plane_bending=0.0) for n in ("best-fit", "locking")}


def values() -> dict[str, float]:
    """Forces at five displacements, and the largest deviations from theory to u = 45 mm."""
    found = {}
    linear = replace(LAWS["locking"], name="linear shear", shear=qf.ThreeStageLaw(C_ini=0.334))
    for name, law in (("locking", LAWS["locking"]), ("linear", linear)):
        result = qf.solve(qf.off_axis_tension(45, law, displacement=50), estimate=False)
        if name == "locking":
            found["triangles"] = len(result.blank.triangles)
            found["energy balance, locking"] = result.energy_balance
        history = result.history
        for u in (10, 20, 30, 40, 50):
            row = np.argmin(np.abs(history["displacement_mm"] - u))
            found[f"force {name} u={u}"] = history["force_N"][row]

    ideal = theory.OffAxisTension(320.0, 160.0, np.pi / 4)
    for law in ("best-fit", "locking"):
        result = qf.solve(qf.off_axis_tension(45, LAWS[law], displacement=45), estimate=False)
        zones = off_axis_zones(result.blank, 320.0, 160.0, 45.0)
        shear = result.model.sheet.fabric.shear
        angle, force, side = [], [], []
        for i, state in enumerate(result.states[1:], start=1):
            gamma, phi_a, _ = np.degrees(ideal.angles(state.travel))
            angle.append(state.measures["shear_angle_center_deg"] - gamma)
            expected = ideal.force(state.travel, shear.stress, result.model.sheet.fabric.thickness)
            force.append(100 * (state.force / expected - 1))
            for zone in ("warp free", "weft free"):
                weight = np.where(zones[zone], result.blank.areas, 0.0)
                side.append(weight @ result.shear_angles(i) / weight.sum() - phi_a)
        found[f"largest deviation of the centre angle from theory, {law}"] = np.abs(angle).max()
        found[f"largest deviation of the force from theory, {law}"] = np.abs(force).max()
        found[f"largest deviation of the side zones from half the angle, {law}"] = np.abs(
            side
        ).max()
    return found
