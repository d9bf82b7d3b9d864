"""From a campaign of tests to a fabric, and its files."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import InputError
from ..fabric import Fabric
from ..result.files import replaced
from ..result.summary import package_version
from .campaign import ASSUMED, METHODS, VALUES, Campaign, load
from .energy_method import StressCurve, energy_method
from .fit import Fit, Parameter, fit
from .inverse import identify_by_elements

FILES = ("material.toml", "parameters.csv", "stress.csv", "summary.json", "identification.png")


@dataclass(frozen=True)
class Identification:
    """A fabric with what it was identified from.

    Parameters
    ----------
    campaign : Campaign
    fabric : Fabric
        With its provenance: `standing` is that of the tests, and of the values in `standing_of`
        alone; of every value there is an entry of its name that says where it comes from.
    curve : StressCurve or None
        S12 by the energy method; None without tests in shear.
    fitted : Fit or None
        The six parameters; None for a table.
    parameters : tuple of Parameter
        All that was identified, bending included.
    notices : tuple of str
        What was found odd in the data, and what was made of it.
    """

    campaign: Campaign
    fabric: Fabric
    curve: StressCurve | None
    fitted: Fit | None
    parameters: tuple[Parameter, ...]
    notices: tuple[str, ...]

    def save(self, out: str | Path, *, force: bool = False) -> Path:
        """Write material.toml, parameters.csv, stress.csv, summary.json and the picture.

        Parameters
        ----------
        out : path
            Folder; made if missing.
        force : bool
            Replace what was identified before.

        Raises
        ------
        InputError
            If the folder holds such files already and `force` is not set, or cannot be written.
        """
        with replaced(out, force=force, names=FILES) as folder:
            self.fabric.save(folder / "material.toml")
            _write(
                folder / "parameters.csv",
                ["name", "value", "low_95", "high_95", "unit", "state"],
                [[p.name, p.value, p.low, p.high, p.unit, p.state] for p in self.parameters],
            )
            if self.curve is not None:
                _write(folder / "stress.csv", *self._stress())
            summary = json.dumps(self.summary(), indent=2, allow_nan=False)
            (folder / "summary.json").write_text(summary + "\n", encoding="utf-8")
            if self.curve is not None:
                from .picture import save_picture

                save_picture(self, folder / "identification.png")
        return Path(out)

    def summary(self) -> dict[str, Any]:
        """What `summary.json` holds."""
        return {
            "case": self.campaign.name,
            "version": package_version(),
            "provenance": dict(self.fabric.provenance),
            "parameters": [
                {k: None if v != v else v for k, v in asdict(p).items()} for p in self.parameters
            ],
            "stages_deg": None if self.fitted is None else list(self.fitted.stages),
            "notices": list(self.notices),
        }

    def _stress(self) -> tuple[list[str], list[list[float]]]:
        curve = self.curve
        gamma = np.linspace(curve.low, curve.high, 100)
        I6 = np.minimum(np.sin(np.radians(gamma)), curve.spline.t[-1])
        S, half = curve.stress(I6), 2.0 * curve.deviation(I6)
        law = self.fabric.shear.stress(I6)
        head = ["shear_angle_deg", "S12_MPa", "S12_low_MPa", "S12_high_MPa", "S12_law_MPa"]
        return head, np.column_stack([gamma, S, np.maximum(S - half, 0), S + half, law]).tolist()


def identify(source: str | Path | Campaign, **given: Any) -> Identification:
    """Identify a fabric from test data (Schäfer et al., Sect. 2.3, Eq. 10).

    Parameters
    ----------
    source : path or Campaign
        CSV file of one test, TOML file of a campaign (`identification.campaign`), or a `Campaign`.
    **given
        As `identification.campaign.load`: method ("fit", "inverse", "table" or "as-printed"), keep,
        algorithm, size; of a CSV file also kind, length, width, angle, side, thickness, columns,
        units.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        For data or settings that cannot be used, in one line.

    References
    ----------
    .. [1] J. Cao et al., Composites Part A 39 (2008) 1037-1053, Eq. 18, for the coefficient of
       Eq. 10 that conserves energy.
    """
    if isinstance(source, Campaign):
        campaign = replace(source, **given)
    else:
        campaign = load(source, **given)
    fabric, curve, fitted = campaign.fabric, None, None
    parameters: list[Parameter] = []
    notices = [notice for test in campaign.shear for notice in test.curve.notices]
    if campaign.shear:
        curve, fitted = _shear(campaign)
        shear = curve.law() if fitted is None else fitted.law
        fabric = replace(fabric, shear=shear, shear_range=curve.high)
        if fitted is not None:
            parameters += fitted.parameters
            notices += _remarks(fitted, curve)
    for family, stiffness in campaign.bending.items():
        name, half = f"bending_{family}", 2.0 * stiffness.standard_error
        low, high = stiffness.value - half, stiffness.value + half
        parameters.append(Parameter(name, stiffness.value, low, high, "N mm", "fitted"))
        off = 100 * (stiffness.classical / stiffness.value - 1)
        notices.append(f"{name} by Peirce's formula {stiffness.classical:.4g} N mm ({off:+.1f} %)")
        fabric = replace(fabric, **{name: stiffness.value})
    quality = None if curve is None else (curve if fitted is None else fitted).misfit
    origins = _origins(campaign, fitted)
    notices += _not_tested(origins)
    provenance = _provenance(campaign, curve, quality, origins)
    fabric = replace(fabric, name=campaign.name, provenance=provenance)
    return Identification(campaign, fabric, curve, fitted, tuple(parameters), tuple(notices))


def _shear(campaign: Campaign) -> tuple[StressCurve, Fit | None]:
    as_printed = campaign.method == "as-printed"
    thickness = campaign.fabric.thickness
    forces = [test.forces(thickness, as_printed) for test in campaign.shear]
    curve = energy_method(forces)
    if campaign.method == "table":
        return curve, None
    fitted = fit(forces, curve, campaign.keep, campaign.algorithm)
    if campaign.method == "inverse":
        measured = [
            (test.specimen, test.curve, force)
            for test, force in zip(campaign.shear, forces, strict=True)
        ]
        fitted = identify_by_elements(
            measured, fitted, campaign.fabric, campaign.size, campaign.keep
        )
    return curve, fitted


def _remarks(fitted: Fit, curve: StressCurve) -> list[str]:
    loose = [p.name for p in fitted.parameters if p.state == "not identified"]
    found = []
    if loose:
        found.append(f"not identified by these tests: {', '.join(loose)}")
    if any(p.state == "not tested" for p in fitted.parameters):
        words = "the law has none" if fitted.law.C_lo == 0 else "the law has it from there on"
        found.append(
            f"no locking up to {curve.high:.1f} degrees: {words} (keep C_lo and I_lo to set it)"
        )
    return found


def _tested(campaign: Campaign) -> list[str]:
    """Names of the values that the tests have given."""
    shear = ["shear", "shear_range"] if campaign.shear else []
    return [*shear, *(f"bending_{family}" for family in campaign.bending)]


def _origins(campaign: Campaign, fitted: Fit | None) -> dict[str, str]:
    """Where each value of the fabric comes from, and what else went into those of the tests."""
    fabric = campaign.fabric
    origins = {name: str(fabric.provenance.get(name, f"{ASSUMED}{fabric.name}")) for name in VALUES}
    found = dict.fromkeys(_tested(campaign), campaign.standing)
    for name, divisor in (
        ("shear", "thickness"),
        ("bending_warp", "areal_weight"),
        ("bending_weft", "areal_weight"),
    ):
        if name in found and origins[divisor].startswith(ASSUMED):
            found[name] += f", with an assumed {divisor}"
    for state in ("kept", "not identified", "not tested"):
        if names := [p.name for p in (fitted.parameters if fitted else ()) if p.state == state]:
            found["shear"] += f"; {state}: {', '.join(names)}"
    return origins | found


def _not_tested(origins: Mapping[str, str]) -> list[str]:
    """Say which values are those of another fabric, a sentence for each of these."""
    borrowed: dict[str, list[str]] = {}
    for name, origin in origins.items():
        if origin.startswith(ASSUMED):
            borrowed.setdefault(origin.removeprefix(ASSUMED), []).append(name)
    return [
        f"not in these tests, taken from {fabric}: {', '.join(names)}"
        for fabric, names in borrowed.items()
    ]


def _provenance(
    campaign: Campaign,
    curve: StressCurve | None,
    misfit: float | None,
    origins: Mapping[str, str],
) -> Mapping[str, str | float]:
    entries: dict[str, str | float] = {
        "standing": campaign.standing,
        "standing_of": ", ".join(_tested(campaign)),
        **origins,
        "method": METHODS[campaign.method] if campaign.shear else "cantilever tests",
        "date": date.today().isoformat(),
        "quasiform": package_version(),
    }
    if curve is not None:
        entries |= {
            "algorithm": campaign.algorithm,
            "tested_from_deg": round(curve.low, 3),
            "tested_to_deg": round(curve.high, 3),
            "force_misfit_percent": float(f"{100 * misfit:.3g}"),
        }
    if campaign.keep:
        entries["kept"] = ", ".join(f"{k} = {v:g}" for k, v in campaign.keep.items())
    for number, path in enumerate(campaign.sources, start=1):
        entries[f"source_{number}"] = path.name
        try:
            entries[f"sha256_{number}"] = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}") from error
    return entries


def _write(path: Path, head: list[str], rows: list[list[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        for row in rows:
            # no bound is known where a cell stays empty
            writer.writerow(
                [("" if v != v else f"{v:.8g}") if isinstance(v, float) else v for v in row]
            )
