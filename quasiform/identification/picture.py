"""Picture of an identification: S12 over the shear angle as in Fig. 2 b of Schäfer et al."""

from __future__ import annotations

import warnings
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from ..draw.plot import DPI, FIRST, SECOND, STYLE, WIDTH
from ..fabric import Fabric
from .specimen import OffAxis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .identified import Identification

PRESET_STYLE = {  # seen where they coincide: dashes on a broad light line
    "locking": {"color": "0.8", "lw": 3.0, "solid_capstyle": "butt", "zorder": 1.0},
    "best-fit": {"color": "0.25", "lw": 0.8, "ls": "--", "zorder": 3.0},
}
TALLEST = 3.0  # times the largest stress of the tests: a preset above would flatten their curve
MARKERS = "os^Dv<>"
BELOW = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.16), "borderaxespad": 0}
SHOWN = 60  # points a test


def save_picture(identification: Identification, path: str | Path) -> None:
    """Draw S12 with its band, the law and both parameter sets of the paper; and the forces."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        tests = len(identification.campaign.shear)
        height = 3.4 + 0.16 * max(tests + 4, 2 * tests)  # the curves, and a line for each below
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        stress, forces = figure.subplots(1, 2)
        _draw_stress(stress, identification)
        _draw_forces(forces, identification)
        campaign, curve = identification.campaign, identification.curve
        misfit = identification.fabric.provenance["force_misfit_percent"]
        figure.suptitle(
            f"{_short(campaign.name)} · {_short(campaign.standing)} data · "
            f"{identification.fabric.provenance['method']}\n"
            f"tested from {curve.low:.1f}° to {curve.high:.1f}°, "
            f"forces within {misfit:g} % (root mean square)"
        )
        with warnings.catch_warnings():  # a name may have letters that the font lacks
            warnings.filterwarnings("ignore", message="Glyph")
            figure.savefig(path, dpi=DPI)


def _short(name: str) -> str:
    """Return a name from a file as a label: one short line, nothing in it a formula."""
    line = "".join(c if c.isprintable() else " " for c in name)
    return (line if len(line) <= 40 else f"{line[:37]}...").replace("$", r"\$")


def _draw_stress(axes: Axes, identification: Identification) -> None:
    campaign, curve = identification.campaign, identification.curve
    gamma = np.linspace(curve.low, curve.high, 300)
    I6 = np.minimum(np.sin(np.radians(gamma)), curve.spline.t[-1])
    S, half = curve.stress(I6), 2.0 * curve.deviation(I6)
    for test, marker in zip(campaign.shear, MARKERS, strict=False):
        angle, value = _apparent(identification, test)
        label = fill(f"{_short(campaign.standing)}: {_short(test.name)}", 44)
        axes.plot(angle, value, marker, color="0.55", markersize=2.2, mew=0, label=label)
    axes.fill_between(gamma, S - half, S + half, color=FIRST, alpha=0.2, lw=0)
    axes.plot(gamma, S, color=FIRST, label="energy method, 95 %")
    if identification.fitted is not None:
        law = identification.fabric.shear
        axes.plot(gamma, law.stress(I6), color=SECOND, label="fitted law")
    end, top = max(curve.high, 60.0), S.max()
    for name, style in PRESET_STYLE.items():
        preset = Fabric.preset(name)
        tallest = _tallest(preset, curve.high, TALLEST * S.max())
        if tallest is None:
            words = f"{preset.name} (paper):\nnot drawn, over {TALLEST:g} times as high"
            axes.plot([], [], " ", label=words)
            continue
        top = max(top, tallest)
        value = preset.shear.stress(np.sin(np.radians(np.linspace(0.0, end, 400))))
        axes.plot(np.linspace(0.0, end, 400), value, label=f"{preset.name} (paper)", **style)
    axes.set(xlabel="shear angle γ [°]", ylabel="$S_{12}$ [MPa]", ylim=(0, 1.1 * top))
    axes.set_xlim(0, end)
    axes.legend(**BELOW)


def _tallest(preset: Fabric, high: float, limit: float) -> float | None:
    """Stress of a preset that the axis shall reach, MPa; None where that is above the limit.

    It is that at the largest tested angle, degrees. A law that locks before, and climbs out of the
    picture as a wall, is shown up to there.
    """
    I6 = np.sin(np.radians(min(high, 90.0)))
    for at in (I6, min(I6, preset.shear.I_lo)):
        value = float(preset.shear.stress(at))
        if value <= limit:
            return value
    return None


def _apparent(identification: Identification, test: object) -> tuple[np.ndarray, np.ndarray]:
    """Stress of single rows: what is left of the force for the zone of full shear."""
    curve = identification.curve
    forces = test.forces(
        identification.fabric.thickness, identification.campaign.method == "as-printed"
    )
    others = curve.stress(np.minimum(np.sin(forces.angles[1:]), curve.spline.t[-1]))
    value = (forces.force - (forces.shares[1:] * others).sum(0)) / forces.shares[0]
    shown = np.unique(np.linspace(0, len(value) - 1, SHOWN).astype(int))
    return np.degrees(forces.angles[0])[shown], value[shown]


def _draw_forces(axes: Axes, identification: Identification) -> None:
    campaign, fabric = identification.campaign, identification.fabric
    per_length = [test.curve.per_length for test in campaign.shear]
    for test, marker in zip(campaign.shear, MARKERS, strict=False):
        forces = test.forces(fabric.thickness, campaign.method == "as-printed")
        angle = np.degrees(forces.angles[0])
        shown = np.unique(np.linspace(0, len(angle) - 1, SHOWN).astype(int))
        strip = isinstance(test.specimen, OffAxis)
        kind = f"off-axis {test.specimen.angle:g}°" if strip else "frame"
        points = {"color": "0.55", "markersize": 2.2, "mew": 0}
        label = fill(f"{kind}, {_short(campaign.standing)}", 44)
        axes.plot(angle[shown], forces.force[shown], marker, label=label, **points)
        fine = np.linspace(angle.min(), angle.max(), 200)
        shares, angles = (
            np.array([np.interp(fine, angle, row) for row in rows])
            for rows in (forces.shares, forces.angles)
        )
        predicted = (shares * fabric.shear.stress(np.sin(angles))).sum(0)
        axes.plot(fine, predicted, color=SECOND, label=f"{kind}, power balance")
    unit = "N/mm" if all(per_length) else "N" if not any(per_length) else "N, frames N/mm"
    axes.set(xlabel="shear angle γ [°]", ylabel=f"force [{unit}]")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(**BELOW)
