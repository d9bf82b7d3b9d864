"""Off-axis tension with increasing fibre stiffness: exact at 45 degrees, a bound elsewhere."""

import numpy as np

import quasiform as qf
from quasiform import theory

LENGTH, WIDTH = 320.0, 160.0
FIBRES = (1e3, 4e3, 16e3, 64e3)  # C_ini of warp and weft, MPa; that of MD600 is 1000


def values() -> dict[str, float]:
    """Errors at 45 degrees by fibre stiffness; energies divided by the bound elsewhere."""
    found = {}
    ideal = theory.OffAxisTension(LENGTH, WIDTH, np.pi / 4)
    for law in ("best-fit", "locking"):
        off_force, off_angle = [], []
        for C in FIBRES:
            fabric = _fabric(law, C)
            result = qf.solve(qf.off_axis_tension(45, fabric, displacement=45.0), estimate=False)
            forces, angles = [], []
            for state in result.states[1:]:
                exact = ideal.force(state.travel, fabric.shear.stress, fabric.thickness)
                forces.append(100 * (state.force / exact - 1))
                gamma = np.degrees(ideal.angles(state.travel)[0])
                angles.append(state.measures["shear_angle_center_deg"] - gamma)
            off_force.append(np.abs(forces).max())
            off_angle.append(np.abs(angles).max())
        found[f"45 deg, {law}: deviation of the force, stiffest fibres"] = off_force[-1]
        found[f"45 deg, {law}: deviation of the centre angle, stiffest fibres"] = off_angle[-1]
        found[f"45 deg, {law}: order of the force in the compliance"] = _order(off_force)
        found[f"45 deg, {law}: order of the angle in the compliance"] = _order(off_angle)
    for angle in (30, 35, 40, 50, 60):
        ideal = theory.OffAxisTension(LENGTH, WIDTH, np.radians(angle))
        u = 0.6 * ideal.displacement_limit
        fabric = _fabric("locking", FIBRES[-1])
        result = qf.solve(qf.off_axis_tension(angle, fabric, displacement=u), estimate=False)
        bound = ideal.energy(u, fabric.shear.energy, fabric.thickness)
        stored = result.model.membrane.energy(result.states[-1].x).sum()
        found[f"{angle} deg: energy divided by that of the uniform bands"] = stored / bound
    return found


def _fabric(law: str, C: float) -> qf.Fabric:
    fibre = qf.ThreeStageLaw(C_ini=C)
    shear = qf.Fabric.preset(law).shear
    given = {"shear": shear, "warp": fibre, "weft": fibre, "in_plane_bending": 0.0}
    return qf.Fabric(name=f"{law}, fibres {4 * C:g} MPa", **given)


def _order(errors: list[float]) -> float:
    """Slope of the errors over the compliance of the fibres, both as logarithms."""
    return float(np.polyfit(-np.log(FIBRES), np.log(errors), 1)[0])
