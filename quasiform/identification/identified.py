"""A fabric from a campaign of tests, and its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from datetime import date
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import FORMAT, naming
from ..fabric import Fabric, MomentCurve
from ..result.files import replaced
from ..result.summary import package_version
from ..tables import write_rows
from .campaign import ASSUMED, METHODS, VALUES, Campaign, load
from .cantilever import Stiffness
from .energy_method import StressCurve, energy_method
from .fit import Fit, Parameter, fit
from .inverse import identify_by_elements
from .slipping import identify_with_slip

STRESS = ("shear_angle_deg", "S12_MPa", "S12_low_MPa", "S12_high_MPa", "S12_law_MPa")
PARAMETER = ("name", "value", "low_95", "high_95", "unit", "state")
FILES = ("material.toml", "parameters.csv", "stress.csv", "summary.json", "identification.png")


@dataclass(frozen=True)
class Identification:
    """A fabric and the data it was identified from.

    Parameters
    ----------
    campaign : Campaign
    fabric : Fabric
        With its provenance: `standing` is the origin of the tests and holds for the values listed
        in `standing_of` only; each value has an entry of its own name with its origin.
    curve : StressCurve or None
        S12 by the energy method; None without tests in shear.
    fitted : Fit or None
        The six parameters; None for a table.
    parameters : tuple of Parameter
        All identified parameters, bending included.
    notices : tuple of str
        Peculiarities of the data, and how each was handled.
    """

    campaign: Campaign
    fabric: Fabric
    curve: StressCurve | None
    fitted: Fit | None
    parameters: tuple[Parameter, ...]
    notices: tuple[str, ...]

    def save(self, out: str | Path, *, force: bool = False) -> Path:
        """Write `FILES` to the folder `out`; `force` replaces those that are there already."""
        with replaced(out, force=force, names=FILES) as folder:
            self.fabric.save(folder / "material.toml")
            _write(folder / "parameters.csv", PARAMETER, [astuple(p) for p in self.parameters])
            summary = json.dumps(self.summary(), indent=2, allow_nan=False)
            (folder / "summary.json").write_text(summary + "\n", encoding="utf-8")
            if self.curve is not None:
                from .picture import save_picture

                columns = self.stress()
                _write(folder / "stress.csv", columns, np.transpose([*columns.values()]).tolist())
                save_picture(self, folder / "identification.png")
        return Path(out)

    def summary(self) -> dict[str, Any]:
        """Content of `summary.json`."""
        return {
            "case": self.campaign.name,
            "version": package_version(),
            "format": FORMAT,
            "provenance": dict(self.fabric.provenance),
            "parameters": [
                {k: v if isinstance(v, str) or isfinite(v) else None for k, v in vars(p).items()}
                for p in self.parameters
            ],
            "stages_deg": None if self.fitted is None else list(self.fitted.stages),
            "notices": list(self.notices),
        }

    def stress(self, n: int = 100) -> dict[str, np.ndarray]:
        """S12 over the tested shear angles with its 95 % band, and by the law: columns of (n,)."""
        gamma = np.linspace(self.curve.low, self.curve.high, n)
        I6 = np.minimum(np.sin(np.radians(gamma)), self.curve.spline.t[-1])
        S, half = self.curve.stress(I6), 2.0 * self.curve.deviation(I6)
        columns = gamma, S, np.maximum(S - half, 0), S + half, self.fabric.shear.stress(I6)
        return dict(zip(STRESS, columns, strict=True))


def identify(source: str | Path | Campaign, **given: Any) -> Identification:
    """Identify a fabric from test data (Schäfer et al., Sect. 2.3, Eq. 10).

    Parameters
    ----------
    source : path or Campaign
        CSV file of one test, TOML file of a campaign (`identification.campaign`), or a `Campaign`.
    **given
        As `identification.campaign.load`: method ("fit", "inverse", "table" or "as-printed"), keep,
        algorithm, size; of a CSV file also kind, thickness, columns, units, from, to, zero,
        preload, cycle and the sizes of its specimen.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        For data or settings that cannot be used.

    References
    ----------
    .. [1] J. Cao et al., Composites Part A 39 (2008) 1037-1053, Eq. 18, for the coefficient of
       Eq. 10 that conserves energy.
    """
    own = isinstance(source, Campaign)
    campaign = replace(source, **given) if own else load(source, **given)
    fabric, curve, fitted = campaign.fabric, None, None
    parameters: list[Parameter] = []
    notices = [notice for test in campaign.shear for notice in test.curve.notices]
    if campaign.shear:
        curve, fitted = _shear(campaign)
        shear = curve.law() if fitted is None else fitted.law
        trusted, origin = max(test.trusted() for test in campaign.shear)
        slip = fabric.slip if fitted is None else fitted.slip or fabric.slip
        fabric = replace(fabric, shear=shear, shear_range=trusted, slip=slip)
        if trusted < curve.high - 0.05:
            notices.append(
                f"shear_range ends at {trusted:.1f} degrees, the tests at {curve.high:.1f}: "
                f"{origin} (--to DEG: as far as you trust it)"
            )
        if fitted is not None:
            parameters += fitted.parameters
            notices += [*_remarks(fitted, curve), *fitted.notices]
    for family, bent in campaign.bending.items():
        fabric, parameter, notice = _bent(fabric, family, bent)
        parameters.append(parameter)
        notices.append(notice)
    origins = _origins(campaign, fitted)
    for base in dict.fromkeys(o for o in origins.values() if o.startswith(ASSUMED)):
        names = ", ".join(name for name, origin in origins.items() if origin == base)
        notices.append(f"not in these tests, taken from {base.removeprefix(ASSUMED)}: {names}")
    provenance = _provenance(campaign, curve, fitted, origins)
    fabric = replace(fabric, name=campaign.name, provenance=provenance)
    return Identification(campaign, fabric, curve, fitted, tuple(parameters), tuple(notices))


def _bent(
    fabric: Fabric, family: str, found: Stiffness | MomentCurve
) -> tuple[Fabric, Parameter, str]:
    """The fabric with what was found of a family, its stiffness, and a notice."""
    name = f"bending_{family}"
    if isinstance(found, Stiffness):
        value, half = found.value, 2.0 * found.standard_error
        off = 100 * (found.classical / value - 1)
        notice = f"{name} by Peirce's formula {found.classical:.4g} N mm ({off:+.1f} %)"
        parameter = Parameter(name, value, value - half, value + half, "N mm", "fitted")
        return replace(fabric, **{name: value, f"moment_{family}": None}), parameter, notice
    value, last, moment = found.initial, found.curvature[-1], found.moment[-1]
    notice = (
        f"{name} is that of the flat fabric; at {1e3 * last:.3g} 1/m the moment is "
        f"{moment:.4g} N, {value * last / moment:.3g} times less than by it (moment_{family})"
    )
    parameter = Parameter(name, value, np.nan, np.nan, "N mm", "fitted")
    return replace(fabric, **{name: value, f"moment_{family}": found}), parameter, notice


def _shear(campaign: Campaign) -> tuple[StressCurve, Fit | None]:
    """S12 by the energy method, and the fitted law unless a table is asked for."""
    as_printed = campaign.method == "as-printed"
    forces = [test.forces(campaign.fabric.thickness, as_printed) for test in campaign.shear]
    curve = energy_method(forces)
    if campaign.method == "table":
        return curve, None
    fitted = fit(forces, curve, campaign.keep, campaign.algorithm)
    if campaign.method == "inverse":
        tests = [(t.specimen, t.curve, f) for t, f in zip(campaign.shear, forces, strict=True)]
        given = fitted, campaign.fabric, campaign.size
        if campaign.slip:
            tests = [
                (s, t.whole or c, f) for t, (s, c, f) in zip(campaign.shear, tests, strict=True)
            ]
            return curve, identify_with_slip(tests, campaign.pulled, *given, campaign.slip)
        fitted = identify_by_elements(tests, *given, campaign.keep)
    return curve, fitted


def _remarks(fitted: Fit, curve: StressCurve) -> Iterator[str]:
    if names := _in_state(fitted, "not identified"):
        yield f"not identified by these tests: {names}"
    if _in_state(fitted, "not tested"):
        words = "the law has none" if fitted.law.C_lo == 0 else "the law has it from there on"
        yield f"no locking up to {curve.high:.1f} degrees: {words} (keep C_lo and I_lo to set it)"


def _in_state(fitted: Fit | None, state: str) -> str:
    """Names of the parameters in a state."""
    return ", ".join(p.name for p in (fitted.parameters if fitted else ()) if p.state == state)


def _tested(campaign: Campaign) -> list[str]:
    """Names of the values that follow from the tests."""
    shear = ["shear"] if campaign.shear else []
    curves = [k for k, bent in campaign.bending.items() if isinstance(bent, MomentCurve)]
    bending = [f"bending_{family}" for family in campaign.bending]
    shear += ["slip"] if campaign.slip else []
    return [*shear, *bending, *(f"moment_{family}" for family in curves)]


def _origins(campaign: Campaign, fitted: Fit | None) -> dict[str, str]:
    """Origin of each value of the fabric, and the assumptions in those of the tests."""
    fabric = campaign.fabric
    there = [name for name in VALUES if getattr(fabric, name) is not None]
    origins = {name: str(fabric.provenance.get(name, f"{ASSUMED}{fabric.name}")) for name in there}
    found = dict.fromkeys(_tested(campaign), campaign.standing)
    weighed = [k for k, bent in campaign.bending.items() if isinstance(bent, Stiffness)]
    for name in found.keys() & {"shear", *(f"bending_{family}" for family in weighed)}:
        divisor = "thickness" if name == "shear" else "areal_weight"
        if origins[divisor].startswith(ASSUMED):
            found[name] += f", with an assumed {divisor}"
    if campaign.slip:
        found["slip.pitch"] = "given"
    if campaign.shear:
        found["shear_range"] = max(test.trusted() for test in campaign.shear)[1]
    for state in ("kept", "not identified", "not tested"):
        if names := _in_state(fitted, state):
            found["shear"] += f"; {state}: {names}"
    return origins | found


def _provenance(
    campaign: Campaign, curve: StressCurve | None, fitted: Fit | None, origins: Mapping[str, str]
) -> Mapping[str, str | float]:
    entries: dict[str, str | float] = {
        "standing": campaign.standing,
        "standing_of": ", ".join(_tested(campaign)),
        **origins,
        "method": METHODS[campaign.method] if campaign.shear else "bending tests",
        "date": date.today().isoformat(),
        "quasiform": package_version(),
    }
    if curve is not None:
        entries["algorithm"] = campaign.algorithm
        entries |= {"tested_from_deg": round(curve.low, 3), "tested_to_deg": round(curve.high, 3)}
        entries["force_misfit_percent"] = float(f"{100 * (fitted or curve).misfit:.3g}")
    if campaign.keep:
        entries["kept"] = ", ".join(f"{k} = {v:g}" for k, v in campaign.keep.items())
    for number, path in enumerate(campaign.sources, start=1):
        entries[f"source_{number}"] = path.name
        with naming(path):
            entries[f"sha256_{number}"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return entries


def _write(path: Path, head: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV file; the cell of a number that is unknown or has no bound is empty."""

    def cell(value: Any) -> Any:
        return value if not isinstance(value, float) else f"{value:.8g}" if isfinite(value) else ""

    write_rows(path, [head, *(map(cell, row) for row in rows)])
