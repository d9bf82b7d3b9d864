"""Measured strips predict strips; frames, normalised strips and the centre angle beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import quasiform as qf
from quasiform import theory
from quasiform.draw.plot import FIRST, SECOND, STYLE, WIDTH
from validation.run import Outcome

FOLDER = Path(__file__).parent
THICKNESS = 1.2
LAW_TO = 60.0  # degrees, kinematic: the largest angle of the strip that the law is taken from
AT = (10.0, 20.0, 30.0, 46.0, 60.0, 66.2, 77.4, 80.0, 90.0, 100.0, 105.0)  # mm, 150 x 450 mm
ANGLES_AT = (30.0, 46.0, 66.2, 77.4, 88.7, 99.6, 106.5)  # mm, 150 x 450 mm
SHORT, LONG = (theory.OffAxisTension(h, w, np.pi / 4) for h, w in ((230.0, 115.0), (450.0, 150.0)))
LABELS = {"un": (-20, 4), "uml": (-2, 4), "hkust": (4, -6)}  # points beside the end of a curve
FRAMES = ("hkust", "kul1", "kul3", "uml", "un", "ut")
STRIPS = ("insa", "nu", "hkust")  # 115 x 230 mm, Fig. 38
PLAIN = ("115x230-insa", "115x230-nu", "150x450-insa")
TWILL = ("twill-100x300-un", "twill-200x400-insa")  # unbalanced


def run(quick: bool) -> Outcome:
    """Forces and angles of strips from strips, and the ratios between the published curves."""
    identified = _identified("strip-115x230-insa", kind="off-axis", width=115.0, length=230.0)
    fabric = replace(identified.fabric, in_plane_bending=0.0)  # assumed: nothing is published
    found = {"misfit of the strip INSA 115 x 230": fabric.provenance["force_misfit_percent"]}
    measured = _curve("strip-150x450-insa")
    scene = qf.off_axis_tension(45, fabric, LONG.l0, LONG.w0, ANGLES_AT[-1], LONG.w0 / 23)
    history = qf.solve(scene, increment=2.5, estimate=False).history
    balance = LONG.force(np.array(AT), fabric.shear.stress, THICKNESS)
    for u, uniform in zip(AT, balance, strict=True):
        force = _at(u, history["displacement_mm"], history["force_N"])
        found[f"INSA 150 x 450: force u={u:g}, elements"] = force
        found[f"INSA 150 x 450: force u={u:g}, power balance"] = uniform
    angle = _curve("centre-angle-150x450")
    for u in ANGLES_AT:
        value = _at(u, history["displacement_mm"], history["shear_angle_center_deg"])
        found[f"centre angle u={u:g}"] = value
        at, kinematic = _at(u, *angle), np.degrees(LONG.angles(u)[0])
        off = abs(value - at) / abs(kinematic - at)
        found[f"centre angle u={u:g}: deviation over that of inextensible fibres"] = off
    found["energy divided by that of the uniform bands u=66.2"] = _energy(fabric)
    found |= _same_laboratory() | _fig_40() | _normalised()
    ratios, laws = _frames()
    found |= ratios
    return Outcome(
        found,
        {
            "Strips of INSA: 150 x 450 mm predicted from 115 x 230 mm": _predicted(
                history, measured, angle
            ),
            "Raw strips of 115 x 230 mm, and what frame laws give for them": _scatter(laws),
        },
        notes=[
            "Assumed: fibre modulus 4000 MPa as for MD600, no bending in the plane, no weight, "
            "rigid grips, no slip. The law uses the strip up to a kinematic angle of "
            f"{LAW_TO:g}°. The thickness cancels.",
        ],
    )


def _curve(name: str) -> np.ndarray:
    """(2, n) of a measured curve, sorted by its first column."""
    rows = np.loadtxt(FOLDER / f"{name}.csv", delimiter=",", skiprows=2)
    return rows[np.argsort(rows[:, 0], kind="stable")].T


def _at(u: float, x: np.ndarray, y: np.ndarray) -> float:
    return float(np.interp(u, x, y, left=np.nan, right=np.nan))


def _identified(name: str, **specimen: float | str) -> qf.Identification:
    given = {"thickness": THICKNESS, "method": "table", "to": LAW_TO}
    return qf.identify(FOLDER / f"{name}.csv", **given, **specimen)


def _energy(fabric: qf.Fabric) -> float:
    """Energy of the elements over that of the uniform bands, an admissible field."""
    scene = qf.off_axis_tension(45, fabric, LONG.l0, LONG.w0, 66.2, LONG.w0 / 23)
    end = qf.solve(scene, estimate=False)
    bound = LONG.energy(66.2, fabric.shear.energy, THICKNESS)
    return float(end.model.membrane.energy(end.states[-1].x).sum() / bound)


def _same_laboratory() -> dict[str, float]:
    """UN: longer strips predicted from the strip of 100 x 200 mm, by the power balance."""
    law = _identified("strip-100x200-un", kind="off-axis", width=100.0, length=200.0).fabric.shear
    found = {}
    for length in (250, 300):
        strip = theory.OffAxisTension(length, 100.0, np.pi / 4)
        for degrees in (10, 20, 30, 40):
            u = _displacement(strip, np.radians(degrees))
            ratio = strip.force(u, law.stress, THICKNESS) / _at(
                u, *_curve(f"strip-100x{length}-un")
            )
            found[f"UN 100 x {length}: computed over measured at {degrees} deg"] = float(ratio)
    return found


def _displacement(strip: theory.OffAxisTension, gamma: float) -> float:
    """Displacement (mm) at a kinematic shear angle (rad) of a strip at 45°."""
    return (strip.l0 - strip.w0) * (np.sqrt(1 + np.sin(gamma)) - 1)


def _fig_40() -> dict[str, float]:
    """Two figures of one laboratory, strip and speed, and what its frame gives for both."""
    law = _identified("frame-hkust", kind="picture-frame", **{"from": 15.0}).fabric.shear
    found = {}
    for u in (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0):
        fig_38, fig_40 = (_at(u, *_curve(f"strip-115x230-hkust{f}")) for f in ("", "-fig40"))
        found[f"HKUST 115 x 230: Fig. 40 over Fig. 38 u={u:g}"] = fig_40 / fig_38
        if 20 <= u < 40:
            force = float(SHORT.force(u, law.stress, THICKNESS))
            found[f"HKUST frame law over Fig. 40 u={u:g}"] = force / fig_40
            found[f"HKUST frame law over Fig. 38 u={u:g}"] = force / fig_38
    return found


def _frames() -> tuple[dict[str, float], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Force of the 115 x 230 mm strip by each frame law over the measured one; the curves."""
    curves, found = {}, {}
    grid = np.linspace(0.1, 44.0, 200)
    for lab in FRAMES:
        identified = _identified(f"frame-{lab}", kind="picture-frame")
        tested = np.degrees(SHORT.angles(grid)[0])
        u = grid[(tested >= identified.curve.low) & (tested <= identified.curve.high)]
        curves[lab] = u, SHORT.force(u, identified.fabric.shear.stress, THICKNESS)
    for degrees in (15, 20, 30, 40):
        u = _displacement(SHORT, np.radians(degrees))
        strips = [_at(u, *_curve(f"strip-115x230-{lab}")) for lab in STRIPS]
        frames = {lab: _at(u, *curve) for lab, curve in curves.items()}
        for lab, force in frames.items():
            if np.isfinite(force):
                name = f"force of the strip of INSA predicted from the frame of {lab.upper()}"
                found[f"{name}, over measured at {degrees} deg"] = force / strips[0]
        for kind, forces in (("frames", [*frames.values()]), ("strips", strips)):
            ratio = np.nanmax(forces) / np.nanmin(forces)
            found[f"scatter of the {kind}, largest over smallest at {degrees} deg"] = float(ratio)
    return found, curves


def _normalised() -> dict[str, float]:
    """Published normalised strips over Eq. 18 of the raw forces, and over a variant of it."""
    found = {}
    for name in PLAIN + TWILL:
        W, H = map(float, name.split("-")[-2].split("x"))
        raw, published = _curve(f"strip-{name}"), _curve(f"normalised-{name}")
        for degrees in (20, 30, 40):
            for way, variant in (("Eq. 18", False), ("its variant", True)):
                ratio = _at(degrees, *published) / _solved(np.radians(degrees), W, H, raw, variant)
                found[f"normalised {name} over {way} at {degrees} deg"] = float(ratio)
    return found


def _solved(gamma: float, W: float, H: float, raw: np.ndarray, variant: bool) -> float:
    """F_sh(γ) = [k F - W F_sh(γ/2) cos(γ/2)] / [(2 H - 3 W) cos γ], N/mm.

    k = √2 (H/W - 1) sin(π/4 - γ/2) is Eq. 18; in the variant k = √2 H/W.
    """
    if gamma < np.radians(0.3):
        return 0.0
    k = np.sqrt(2) * (H / W if variant else (H / W - 1) * np.sin(np.pi / 4 - gamma / 2))
    F = _at((H - W) * (np.sqrt(1 + np.sin(gamma)) - 1), *raw)
    half = W * _solved(gamma / 2, W, H, raw, variant) * np.cos(gamma / 2)
    return (k * F - half) / ((2 * H - 3 * W) * np.cos(gamma))


def _predicted(history: np.ndarray, measured: np.ndarray, angle: np.ndarray) -> Figure:
    """Force and centre angle of the long strip, measured and predicted."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
        left, right = figure.subplots(1, 2)
        u = history["displacement_mm"]
        left.plot(u, history["force_N"], color=FIRST, label="elements, law of 115 × 230 mm")
        left.plot(*measured, "ko", markersize=2, label="measured")
        left.set(xlabel="displacement in mm", ylabel="force in N")
        left.legend(loc="upper left")
        right.plot(u, history["shear_angle_center_deg"], color=FIRST, label="elements, centre")
        grid = np.linspace(0.0, ANGLES_AT[-1], 200)
        kinematic = np.degrees(LONG.angles(grid)[0])
        right.plot(grid, kinematic, "--", color="0.5", label="inextensible fibres")
        right.plot(*angle, "ko", markersize=2, label="measured (image correlation)")
        right.set(xlabel="displacement in mm", ylabel="shear angle in °")
        right.legend(loc="upper left")
    return figure


def _scatter(curves: dict[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Raw strips of three laboratories, and the forces by their and others' frame laws."""
    with rc_context(STYLE):
        figure = Figure(figsize=(0.7 * WIDTH, 3.4), layout="constrained")
        axes = figure.subplots()
        for number, (lab, curve) in enumerate(curves.items()):
            label = "law of a picture frame" if number == 0 else None
            axes.plot(*curve, color=SECOND, linewidth=0.8, label=label)
            end, beside = (curve[0][-1], curve[1][-1]), LABELS.get(lab, (2, -2))
            axes.annotate(lab.upper(), end, beside, textcoords="offset points", fontsize=6)
        for lab, style in zip(STRIPS, "osv", strict=True):
            label = f"measured, {lab.upper()}, Fig. 38"
            axes.plot(*_curve(f"strip-115x230-{lab}"), "k" + style, markersize=2, label=label)
        label = "measured, HKUST, Fig. 40"
        axes.plot(*_curve("strip-115x230-hkust-fig40"), color=FIRST, label=label)
        axes.set(xlabel="displacement in mm", ylabel="force in N", yscale="log", ylim=(0.3, 200))
        axes.legend(loc="upper left")
    return figure
