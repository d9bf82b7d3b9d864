"""Closed forms and ordinary differential equations compared with published numbers."""

import numpy as np

import quasiform as qf
from quasiform import theory

LAWS = ("best-fit", "locking")
LENGTH, WIDTH = 320.0, 160.0


def values() -> dict[str, float]:
    """Values of `quasiform.theory` and the shear laws for each published number."""
    return (
        _laws() | _tension_at_45() | _tension_at_30() | _elasticae() | _hemisphere() | _friction()
    )


def _laws() -> dict[str, float]:
    """S12 of both sets of Table 1, and of Eq. 9 by its energy."""
    found = {}
    for law in LAWS:
        shear = qf.Fabric.preset(law).shear
        for gamma in (1, 5, 10, 20, 30, 40, 50, 57, 60, 70, 90):
            found[f"S12 {law}, {gamma} deg"] = float(shear.stress(np.sin(np.radians(gamma))))
        I6 = np.linspace(-0.98, 0.98, 400)
        rise = (shear.energy(I6 + 1e-6) - shear.energy(I6 - 1e-6)) / 2e-6
        off = np.abs(rise - shear.stress(I6)).max() / np.abs(shear.stress(I6)).max()
        found[f"S12 {law} as the slope of its energy"] = float(off)
    return found


def _tension_at_45() -> dict[str, float]:
    strip, found = theory.OffAxisTension(LENGTH, WIDTH, np.pi / 4), {}
    for u in (10, 20, 30, 40, 50, 55, 58):
        found[f"off-axis tension 45 deg: shear angle u={u}"] = float(np.degrees(strip.angles(u)[0]))
        for law in LAWS:
            found[f"off-axis tension 45 deg: force {law} u={u}"] = _force(strip, law, u)
    found["off-axis tension 45 deg: largest displacement"] = float(strip.displacement_limit)
    return found


def _tension_at_30() -> dict[str, float]:
    strip, found = theory.OffAxisTension(LENGTH, WIDTH, np.pi / 6), {}
    for u in (2, 5, 10, 12, 15):
        for name, angle in zip(
            ("shear angle", "shear angle phi_a", "shear angle phi_b"), strip.angles(u), strict=True
        ):
            found[f"off-axis tension 30 deg: {name} u={u}"] = float(np.degrees(angle))
        found[f"off-axis tension 30 deg: force best-fit u={u}"] = _force(strip, "best-fit", u)
    found["off-axis tension 30 deg: force locking u=15"] = _force(strip, "locking", 15)
    found["off-axis tension 30 deg: largest displacement"] = float(strip.displacement_limit)
    for name, area in zip(
        ("full", "phi_a only", "phi_b only", "rigid"), strip.zone_areas, strict=True
    ):
        found[f"off-axis tension 30 deg: area {name}"] = float(area)
    return found


def _force(strip: theory.OffAxisTension, law: str, u: float) -> float:
    fabric = qf.Fabric.preset(law)
    return float(strip.force(u, fabric.shear.stress, fabric.thickness))


def _elasticae() -> dict[str, float]:
    found = {}
    for k in (1, 2, 8, 10):
        x, drop, slope = theory.heavy_elastica(k)
        found[f"heavy elastica k={k}: x"], found[f"heavy elastica k={k}: drop"] = x, drop
        found[f"heavy elastica k={k}: slope"] = float(np.degrees(slope))
    x, drop, _ = theory.heavy_elastica(8.0042)
    found["Peirce's chord at k = 8.0042"] = float(np.degrees(np.arctan2(drop, x)))
    for k in (1, 2, 5, 10):
        u, w = theory.tip_loaded_elastica(k)
        found[f"tip-loaded elastica k={k}: u"], found[f"tip-loaded elastica k={k}: w"] = u, w
    return found


def _hemisphere() -> dict[str, float]:
    found = {}
    for p in (0.25, 0.5, 1.0):
        found[f"net on the sphere, p={p:g}"] = float(np.degrees(theory.hemisphere_net(p, 1.0, 1.0)))
    colatitudes = (15, 30, 45, 60, 75, 90)
    gamma, _ = theory.hemisphere_bias(np.radians(colatitudes), 75.0)
    for colatitude, angle in zip(colatitudes, np.degrees(gamma), strict=True):
        found[f"net on the sphere, bias line at {colatitude} deg"] = float(angle)
    return found


def _friction() -> dict[str, float]:
    return {
        "capstan, 90 deg": float(theory.capstan_ratio(0.157, np.pi / 2)),
        "strip between plates, 5 kg": theory.strip_friction(0.157, 5.0),
    }
