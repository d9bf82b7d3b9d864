"""Whether the end of a run is an equilibrium, and what limits the numbers read off it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import number
from ..energy.plies import folds
from ..model import Model
from .measures import (
    LIFTED,
    bent_radius,
    chord_penetration,
    left_out_penetration,
    max_penetration,
    max_ply_penetration,
)
from .outcome import Outcome
from .stability import RESOLVED

RESIDUAL = 1e-3  # of the driving force
BALANCE = 1e-2  # of the work done
PENETRATION = 0.03  # of the thickness
CHORD = 1 / 3  # of the thickness: how far a chord of a fibre may cut into a tool
FINE = 0.5 * 1.02  # of the smallest radius under the sheet, with 2 % for how it is measured
LOWER = 1e-3  # of the energy: what another state must have less
WIDE = 0.2  # of a value: a mesh error beyond this limits the trust in it
SMALL = {"deg": 0.1, "mm": 0.1, "N": 2e-3}  # degrees, of the thickness, of resting loads: no error
JUDGED = 0.05, 2.0  # of a value, degrees: a larger mesh error judges no scatter
SHARE = 0.005  # of the area: less is not reported
MANY = "one of many states: perturbed starts show what is robust"
WRINKLED = f"wrinkled, {MANY}"
BANDED = f"sheared in bands as narrow as the mesh, {MANY}"
ROBUST = {"robust": True, "judged": True}  # a quantity without perturbed runs
FINER = "finer than the mesh shows (wavelengths from {shown:.3g} mm on)"
LIMITED = {
    "bands_may_form": f"so soft in shear that bands may form, {FINER}",
    "rovings_may_slip": "sheared so unevenly that rovings may slip",
    "fibres_may_buckle": f"so compressed that fibres may buckle, {FINER}",
}


@dataclass(frozen=True)
class Certificate:
    """Verdict on the end of a run; true if it is certified.

    Parameters
    ----------
    converged : bool
        Residual, pivots and energy balance are as they should be at an equilibrium.
    certified : bool
        Converged, and nothing else speaks against the state.
    reasons : tuple of str
        Why it is not certified.
    figures : dict of name to float
        The numbers behind it: residual_relative, negative_pivots, energy_balance_relative,
        stabilisation_work_relative, penetration_mm, penetration_allowed_mm, fibre_chord_mm,
        fibre_chord_allowed_mm, smallest_radius_mm, flange_lift_mm; of several plies also
        ply_penetration_mm and slip_between_plies_1_2_mm.

    Examples
    --------
    >>> bool(Certificate(True, False, ("collapsed from 20 mm on",), {}))
    False
    """

    converged: bool
    certified: bool
    reasons: tuple[str, ...]
    figures: dict[str, float]

    def __bool__(self) -> bool:
        return self.certified

    def __str__(self) -> str:
        return "; ".join(self.reasons) or "certified"


def certify(result: Outcome) -> Certificate:
    """Check the end of a run."""
    model, pivots = result.model, result.negative_pivots
    x, thickness = result.states[-1].x, min(s.fabric.thickness for s in model.sheets)
    views = model.plies
    figures = {
        "residual_relative": result.residual,
        "negative_pivots": np.nan if pivots is None else float(pivots),
        "energy_balance_relative": result.energy_balance,
        "stabilisation_work_relative": result.stabilisation,
        "penetration_mm": max_penetration(model, x),
        "penetration_allowed_mm": PENETRATION * thickness,
        "fibre_chord_mm": max(chord_penetration(view, x, fibres=True) for view in views),
        "fibre_chord_allowed_mm": CHORD * thickness,
        "smallest_radius_mm": min(bent_radius(view, x) for view in views),
        "flange_lift_mm": result.flange_lift,
    }
    between, outside = max_ply_penetration(model, x), left_out_penetration(model, x)
    if model.ply_pairs:
        slips = result.slip_between_plies
        figures["ply_penetration_mm"] = between
        figures |= {f"slip_between_plies_{name}_mm": slip for name, slip in slips.items()}
    depth, allowed = figures["penetration_mm"], figures["penetration_allowed_mm"]
    chord, radius = figures["fibre_chord_mm"], figures["smallest_radius_mm"]
    size = max(sheet.blank.size for sheet in model.sheets)
    starts = {name: result.spread.get(name, ROBUST) for name in result.quantities}
    scattered = _scattered(starts)
    unjudged = [name for name, entry in starts.items() if not entry["judged"]]
    collapse = f"{result.collapse['travel_mm']:.4g}" if result.collapse else ""
    open_balance = f"energy balance open by {100 * result.energy_balance:.1f} %"
    steps, folded = too_long(model, result.settings.get("increment")), folds(model.sheets, x)
    unsolved = {  # what is said: whether it is so
        f"residual {result.residual:.1e} of the driving force": not result.residual < RESIDUAL,
        "no pivots from the linear solver": pivots is None,
        f"{pivots} negative pivots of the tangent": bool(pivots),
        f"{open_balance}, {100 * BALANCE:g} % allowed": result.energy_balance > BALANCE,
    }
    doubtful = {
        f"penetration {depth:.4f} mm at a node, {allowed:.4f} allowed": depth > allowed,
        f"plies penetrate each other by {between:.4f} mm, {allowed:.4f} allowed": between > allowed,
        f"a ply penetrates by {outside:.4f} mm a tool that the model keeps it from": (
            outside > allowed
        ),
        f"a fibre cuts {chord:.2f} mm into a tool, {CHORD * thickness:.2f} allowed": (
            chord > CHORD * thickness
        ),
        f"a mesh of {size:.3g} mm is too coarse for the radius of {radius:.1f} mm that the sheet "
        "bends over, half of it allowed": too_coarse(size, radius),
        f"collapsed from {collapse} mm on": bool(collapse),
        folded: bool(folded),
        steps: bool(steps),
        f"perturbed starts scatter in {', '.join(scattered)}": bool(scattered),
        "perturbed starts do not show whether the numbers are robust: the mesh error is large in "
        f"{', '.join(unjudged)}": bool(unjudged),
        f"a perturbed start found a state with {result.lower:.3g} mJ less": (
            result.lower > LOWER * abs(result.energy)
        ),
        WRINKLED: not result.spread and any(map(wrinkled, result.plies)),
        BANDED: not result.spread and any(map(banded, result.plies)),
    }
    checks = {"stopped early": bool(result.reason)} | unsolved | doubtful
    reasons = tuple(words for words, so in checks.items() if so)
    return Certificate(not any(unsolved.values()), not reasons, reasons, figures)


def too_long(model: Model, increment: float | None) -> str:
    """What is wrong with an increment, mm, that is too long for friction; empty if it is not."""
    own = model.increment
    if not increment or not model.frictions or increment <= own * (1 + 1e-6):
        return ""
    return f"friction follows its path in increments of {own:g} mm, not {increment:g}"


def too_coarse(size: float, radius: float) -> bool:
    """Whether a mesh of a size is too coarse for a radius that the sheet bends over, mm."""
    return size > FINE * radius


def _scattered(spread: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Numbers that are judged and not robust."""
    return [name for name, entry in spread.items() if entry["judged"] > entry["robust"]]


def wrinkled(result: Outcome) -> bool:
    """Whether the flange is lifted and waves; on a coarse mesh it lifts beside a fillet too.

    Or whether a sheet without contact has buckled.
    """
    return _waving(result) or _buckled(result)


def banded(result: Outcome) -> bool:
    """Whether a part of a sheet that is reported is sheared in bands as narrow as the mesh.

    Not in a plane test, where grips prescribe zones that may be as narrow.
    """
    areas, doubts = _shares(result)
    return result.model.sheet.dim == 3 and bool(areas @ doubts["narrow_bands"] >= SHARE)


def _waving(result: Outcome) -> bool:
    if not result.flange_lift > LIFTED * result.model.sheet.fabric.thickness:
        return False
    return any(result.wrinkles.get(f"waving_{family}_lines") for family in ("warp", "weft"))


def _buckled(result: Outcome) -> bool:
    depth = result.wrinkles.get("buckle_mm", 0.0)
    return depth > LIFTED * result.model.sheet.fabric.thickness


def buckled_away(result: Outcome) -> bool:
    """Whether the sheet left a saddle by more than a tenth of its thickness."""
    return result.parted > LIFTED * result.model.sheet.fabric.thickness


def one_of_many(result: Outcome) -> str:
    """Why the state found is one of several; empty where nothing shows so."""
    signs, snaps = [], result.snaps
    if buckled_away(result) and (saddles := result.rescues.get("saddle left", 0)):
        times = "once" if saddles == 1 else f"{saddles} times"
        signs.append(f"the sheet became unstable and buckled away {times}")
    if snaps:
        signs.append(
            f"the sheet jumped {len(snaps)} time{'s' * (len(snaps) > 1)}, first near "
            f"{snaps[0]['to_mm']:.4g} mm"
        )
    if _waving(result):
        signs.append(f"the flange lifts by {result.flange_lift:.2f} mm")
    if _buckled(result):
        signs.append(f"the sheet has buckled by {result.wrinkles['buckle_mm']:.3g} mm")
    if banded(result):
        signs.append("the sheet is sheared in bands as narrow as the mesh")
    if scattered := _scattered(result.spread):
        signs.append(f"perturbed starts scatter in {', '.join(scattered)}")
    return "; ".join(signs)


def unit(quantity: str) -> str:
    """Unit of a quantity behind a number: `unit("draw_in_+x_mm")` is " mm"."""
    return f" {quantity.rpartition('_')[2]}".replace(" deg", "°")


def spoken(quantity: str) -> str:
    """Name of a quantity in a sentence.

    Examples
    --------
    >>> spoken("area_pink_deg"), spoken("draw_in_+x_mm")
    ('the mean shear angle of area pink', 'the draw-in at +x')
    >>> spoken("ply_2_shear_angle_deg"), spoken("slip_1_2_mm")
    ('the shear angle (p99) of ply 2', 'the slip between plies 1 and 2')
    """
    known = {
        "force_N": "the force",
        "load_work_mJ": "the work of the load",
        "shear_angle_deg": "the shear angle (p99)",
        "shear_angle_mean_deg": "the mean shear angle",
    }
    if quantity.startswith("ply_"):
        _, number, own = quantity.split("_", 2)
        return f"{spoken(own)} of ply {number}"
    if quantity.startswith("slip_"):
        _, above, below, _ = quantity.split("_")
        return f"the slip between plies {above} and {below}"
    kind, _, place = quantity.rpartition("_")[0].replace("draw_in", "draw-in").partition("_")
    what = {"area": "mean shear angle of area", "draw-in": "draw-in at"}
    return known.get(quantity) or f"the {what.get(kind, kind)} {place}"


def small(model: Model, quantity: str, value: float) -> float:
    """Largest error of the mesh by which the scatter of a quantity is judged, in its unit."""
    share, angle = JUDGED
    least = angle if quantity.endswith("_deg") else _not_reported(model, quantity)
    return max(share * abs(value), least)


def _not_reported(model: Model, quantity: str) -> float:
    """Error of a quantity, in its unit, below which it is not reported."""
    # of ply_2_draw_in_+x_mm or slip_1_2_mm the plies that are named, else the first
    named = re.match(r"ply_(\d+)_|slip_(\d+)_(\d+)_", quantity)
    numbers = [int(k) for k in named.groups() if k] if named else [1]
    thickness = min(model.sheets[k - 1].fabric.thickness for k in numbers)
    units = {"deg": 1.0, "mm": thickness, "N": model.resting / model.share}
    unit = quantity.rpartition("_")[2]
    return SMALL.get(unit, 0.0) * units.get(unit, 0.0)


def trust(result: Outcome) -> list[str]:
    """What limits the numbers of a run, one sentence each, the worst first."""
    plies = result.plies
    names = [f"ply {k}: " if len(plies) > 1 else "" for k in range(1, len(plies) + 1)]
    found = [start + line for start, ply in zip(names, plies, strict=True) for line in _tested(ply)]
    errors = {
        name: (error, value)
        for name, value in result.quantities.items()
        if (error := result.estimate.get(name))
        and error > max(WIDE * abs(value), _not_reported(result.model, name))
    }
    for name in sorted(errors, key=lambda name: -errors[name][0] / max(abs(errors[name][1]), 1e-9)):
        error, value = errors[name]
        found.append(
            f"the mesh error of {spoken(name)} is {number(error, 2)} at a value of "
            f"{number(value, 3)}{unit(name)}"
        )
    if not any(error is not None for error in result.estimate.values()):
        found.append("the mesh error is not known")
    for name, values in result.in_plane.items():
        (r, value), (other, changed) = values.items()
        if result.estimate.get(name) and abs(value - changed) > result.estimate[name]:
            found.append(
                f"{spoken(name)} depends on in_plane_bending (assumed): {number(value)} with {r}, "
                f"{number(changed)}{unit(name)} with {other}"
            )
    found += [
        start + line for start, ply in zip(names, plies, strict=True) for line in _doubts(ply)
    ]
    if many := one_of_many(result):
        found.append(f"one of many states: {many}")
    return found


def _shares(result: Outcome) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Shares of the triangles of a ply in its area, and its doubts."""
    return result.blank.areas / result.blank.areas.sum(), result.sheet.doubts()


def _tested(result: Outcome) -> list[str]:
    """Whether the shear law of a ply was tested as far as it is sheared."""
    largest = np.abs(result.shear_angle).max()
    known = result.model.sheet.fabric.shear_range
    if largest <= known:
        return []
    areas, doubts = _shares(result)
    share = 100 * areas @ doubts["beyond_identified_range"]
    return [
        f"the largest shear angle is {largest:.1f}°, the law was tested to {known:g}° "
        f"({number(share, 2)} % of the area is beyond)"
    ]


def _doubts(result: Outcome) -> list[str]:
    """Where the shear angle of a ply may be wrong."""
    model, found = result.model, list[str]()
    areas, doubts = _shares(result)
    if model.slip and doubts["rovings_may_slip"].any():
        farthest = np.linalg.norm(result.states[-1].x[model.slip.dofs], axis=1).max()
        share = 100 * areas @ doubts["rovings_may_slip"]
        found.append(
            f"rovings have slipped by {number(farthest, 2)} mm, more than a size of the mesh "
            f"({number(share, 2)} % of the area)"
        )
        doubts = {k: flag for k, flag in doubts.items() if k != "rovings_may_slip"}
    for reason, flag in doubts.items():
        if reason in LIMITED and (share := areas @ flag) >= SHARE:
            shown = RESOLVED * result.blank.size
            words = LIMITED[reason].format(shown=shown)
            found.append(f"{100 * share:.0f} % of the area is {words}")
    return found
