"""Picture of an identification: S12 over the shear angle as in Fig. 2 b of Schäfer et al."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from ..draw.plot import DPI, FIRST, SECOND, WIDTH, page_style
from ..fabric import Fabric
from .energy_method import Forces
from .specimen import OffAxis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PRESET_STYLE = {  # both are seen where they coincide: dashes on a broad light line
    "locking": {"color": "0.8", "lw": 3.0, "solid_capstyle": "butt", "zorder": 1.0},
    "best-fit": {"color": "0.25", "lw": 0.8, "ls": "--", "zorder": 3.0},
}
TALLEST = 3.0  # times the largest stress of the tests: a higher preset would flatten their curve
POINTS = {"color": "0.55", "markersize": 2.2, "mew": 0}
BELOW = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.16), "borderaxespad": 0}
SHOWN = 60  # points a test


def save_picture(identification: Any, path: str | Path) -> None:
    """Draw an `Identification`: S12 with its band, the laws of test and paper; and the forces."""
    from matplotlib.figure import Figure

    campaign, curve = identification.campaign, identification.curve
    given, tests = identification.fabric.provenance, len(campaign.shear)
    with page_style():
        height = 3.4 + 0.16 * max(tests + 4, 2 * tests)  # the curves, and a line for each below
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        stress, forces = figure.subplots(1, 2)
        _draw_stress(stress, identification)
        _draw_forces(forces, identification)
        figure.suptitle(
            f"{_short(campaign.name)} · {_short(campaign.standing)} data · {given['method']}\n"
            f"tested from {curve.low:.1f}° to {curve.high:.1f}°, "
            f"forces within {given['force_misfit_percent']:g} % (root mean square)"
        )
        figure.savefig(path, dpi=DPI)


def _short(name: str) -> str:
    """A name from a file as a short label on one line, without formulas."""
    line = "".join(c if c.isprintable() else " " for c in name)
    return (line if len(line) <= 40 else f"{line[:37]}...").replace("$", r"\$")


def _tests(identification: Any) -> list[tuple[Any, Forces, str]]:
    """Tests with their forces and markers."""
    campaign = identification.campaign
    settings = identification.fabric.thickness, campaign.method == "as-printed"
    forces = [test.forces(*settings) for test in campaign.shear]
    return list(zip(campaign.shear, forces, "os^Dv<>", strict=False))


def _draw_stress(axes: Axes, identification: Any) -> None:
    standing, curve = _short(identification.campaign.standing), identification.curve
    gamma, S, low, high, law = identification.stress(300).values()
    for test, forces, marker in _tests(identification):
        # the stress of single rows: the rest of the force acts in the zone of full shear
        others = curve.stress(np.minimum(np.sin(forces.angles[1:]), curve.spline.t[-1]))
        value = (forces.force - (forces.shares[1:] * others).sum(0)) / forces.shares[0]
        _draw_points(axes, forces, value, marker, f"{standing}: {_short(test.name)}")
    axes.fill_between(gamma, low, high, color=FIRST, alpha=0.2, lw=0)
    axes.plot(gamma, S, color=FIRST, label="energy method, 95 %")
    if identification.fitted is not None:
        axes.plot(gamma, law, color=SECOND, label="fitted law")
    end, top = max(curve.high, 60.0), S.max()
    gamma = np.linspace(0.0, end, 400)
    for name, style in PRESET_STYLE.items():
        preset = Fabric.preset(name)
        tallest = _tallest(preset, curve.high, TALLEST * S.max())
        if tallest is None:
            label = f"{preset.name} (paper):\nnot drawn, over {TALLEST:g} times as high"
            axes.plot([], [], " ", label=label)
            continue
        top = max(top, tallest)
        value = preset.shear.stress(np.sin(np.radians(gamma)))
        axes.plot(gamma, value, label=f"{preset.name} (paper)", **style)
    axes.set(xlabel="shear angle γ [°]", ylabel="$S_{12}$ [MPa]", ylim=(0, 1.1 * top))
    axes.set_xlim(0, end)
    axes.legend(**BELOW)


def _draw_points(axes: Axes, forces: Forces, value: np.ndarray, marker: str, label: str) -> None:
    shown = np.unique(np.linspace(0, len(value) - 1, SHOWN).astype(int))
    angle = np.degrees(forces.angles[0][shown])
    axes.plot(angle, value[shown], marker, label=fill(label, 44), **POINTS)


def _tallest(preset: Fabric, high: float, limit: float) -> float | None:
    """Stress of a preset at the largest tested angle, degrees, or at its onset of locking, MPa.

    None where both are above the limit.
    """
    I6 = np.sin(np.radians(min(high, 90.0)))
    values = (float(preset.shear.stress(at)) for at in (I6, min(I6, preset.shear.I_lo)))
    return next((value for value in values if value <= limit), None)


def _draw_forces(axes: Axes, identification: Any) -> None:
    campaign, fabric = identification.campaign, identification.fabric
    for test, forces, marker in _tests(identification):
        strip = isinstance(test.specimen, OffAxis)
        kind = f"off-axis {test.specimen.angle:g}°" if strip else "frame"
        _draw_points(axes, forces, forces.force, marker, f"{kind}, {_short(campaign.standing)}")
        angle, predicted = np.degrees(forces.angles[0]), forces.predicted(fabric.shear)
        axes.plot(angle, predicted, color=SECOND, label=f"{kind}, power balance")
    per_length = [test.curve.per_length for test in campaign.shear]
    unit = "N/mm" if all(per_length) else "N" if not any(per_length) else "N, frames N/mm"
    axes.set(xlabel="shear angle γ [°]", ylabel=f"force [{unit}]")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(**BELOW)
