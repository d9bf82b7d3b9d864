"""Contents of `summary.json`."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from ..checks import FORMAT
from .assumed import assumed
from .certificate import Certificate, one_of_many, trust
from .measures import (
    chord_penetration,
    max_penetration,
    max_ply_penetration,
    percentile,
    slip_account,
)
from .outcome import Outcome
from .sheet import FormedSheet
from .stability import local_waves

ERRORS = {  # output: the same among the estimated errors
    r"(force_N|load_work_mJ)": r"\1",
    r"shear_angle_deg\.p99": "shear_angle_deg",
    r"shear_angle_deg\.mean": "shear_angle_mean_deg",
    r"areas\.(.*)": r"area_\1_deg",
    r"draw_in_mm\.(.*)": r"draw_in_\1_mm",
}


def summarise(result: Outcome, certificate: Certificate) -> dict[str, Any]:
    """Contents of `summary.json`: numbers that are not finite become None."""
    model, sheet = result.model, result.sheet
    gamma, areas = np.abs(sheet.shear_angle), sheet.flat_areas
    summary: dict[str, Any] = {
        "case": model.name,
        "version": package_version(),
        "format": FORMAT,
        "parameters": model.parameters,
        "files": model.files,
        "status": result.status,
        "reached_mm": result.states[-1].travel,
        "reason": result.reason,
        "wall_s": round(result.wall_s, 3),
        "linear_solves": round(result.linear_solves),
        "factorisations": result.factorisations,
        "solver": result.settings,
        "increments": result.increments,
        "path_size_mm": None if result.path is None else result.path.model.size,
        "nodes": len(model.sheet.blank.nodes),
        "triangles": len(model.sheet.blank.triangles),
        "dofs": int((~model.fixed).sum()),
        "model": [f"{entry}: {why}" for entry, why in result.description],
        model.force_name: result.force,
        "shear_angle_deg": _of_angles(gamma, areas),
        "assumed": assumed(model),
        "error_estimate": {n: result.estimate.get(n) for n in ("shear_angle_deg", model.force_name)}
        | path_errors(result),
        "estimated_errors": result.estimate,
        "equilibrium": {
            "residual_relative": result.residual,
            "energy_balance_relative": result.energy_balance,
            "negative_pivots": result.negative_pivots,
        },
        "fibre_strain_max": _fibre_strain(sheet),
        "collapse": result.collapse,
        "rescues": result.rescues,
        "stabilisation_work_relative": result.stabilisation,
        "snaps": result.snaps,
        "one_of_many": one_of_many(result) or None,
        "spread": result.spread or None,
        "certified": certificate.certified,
        "certificate": {"converged": certificate.converged, "reasons": certificate.reasons},
        "trust": trust(result),
        **_doubtful(result),
    }
    if model.slip:
        state = result.memory[model.terms.index(model.slip)]
        summary["slip"] = slip_account(model, result.states[-1].x, state)
    if model.contacts:
        summary |= _between_tools(result)
    if len(result.plies) > 1:
        summary["plies"] = [_of_ply(ply) for ply in result.plies]
        summary["between_plies"] = {
            "slip_p99_mm": result.slip_between_plies,
            "max_penetration_mm": max_ply_penetration(model, result.states[-1].x),
        }
    return _finite(summary)


def path_errors(result: Outcome) -> dict[str, float | None]:
    """How p99 and force depend on the mesh of the path: 0 if it is this one, None if unknown."""
    force = result.model.force_name
    names = {"path_deg": "shear_angle_deg", f"path_{force.rpartition('_')[2]}": force}
    return {key: result.path_gap.get(name) if result.path else 0.0 for key, name in names.items()}


def _of_angles(gamma: np.ndarray, areas: np.ndarray) -> dict[str, float]:
    """Key numbers of |γ| (n,), degrees, over areas (n,), mm²."""
    p99 = percentile(gamma, areas, 0.99)
    mean = float(areas @ gamma / areas.sum())
    return {"max": float(gamma.max()), "p99": p99, "mean": mean}


def _fibre_strain(sheet: FormedSheet) -> float:
    """Largest elongation of a fibre over its length."""
    strain = np.maximum(sheet.cell_fields["E11"], sheet.cell_fields["E22"]).max()
    return float(np.sqrt(2.0 * strain + 1.0) - 1.0)


def _doubtful(ply: Outcome) -> dict[str, Any]:
    """Where not to trust the shear angle of a ply, as shares of its area."""
    sheet, areas = ply.sheet, ply.sheet.flat_areas
    return {
        "doubtful_share": {
            reason: float(areas @ flag / areas.sum()) for reason, flag in sheet.doubts().items()
        },
        "local_stability": local_waves(ply.first, ply.states[-1].x)[1],
    }


def _of_ply(ply: Outcome) -> dict[str, Any]:
    """Key numbers of one ply of a stack."""
    sheet = ply.model.sheet
    return {
        "fabric": sheet.fabric.name,
        "thickness_mm": sheet.fabric.thickness,
        "nodes": len(sheet.blank.nodes),
        "triangles": len(sheet.blank.triangles),
        "shear_angle_deg": _of_angles(np.abs(ply.shear_angle), ply.blank.areas),
        "fibre_strain_max": _fibre_strain(ply.sheet),
        "draw_in_mm": ply.draw_in,
        "areas": ply.areas,
        "wrinkles": ply.wrinkles,
        **_doubtful(ply),
    }


def _between_tools(result: Outcome) -> dict[str, Any]:
    model, x = result.model, result.states[-1].x
    return {
        "max_penetration_mm": max_penetration(model, x),
        "chord_penetration_mm": max(chord_penetration(view, x) for view in model.plies),
        "draw_in_mm": result.draw_in,
        "areas": result.areas,
        "resting_tools": result.resting_tools(),
        "wrinkles": result.wrinkles,
    }


def _finite(content: Any) -> Any:
    """Replace numbers that are not finite by None, which JSON can hold."""
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(entry) for entry in content]
    if isinstance(content, float) and not np.isfinite(content):
        return None
    return content


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("quasiform")
    except PackageNotFoundError:
        return "not installed"


def error_column(output: str) -> str:
    """Dotted name of the mesh error of a number of a summary; empty if there is none.

    Examples
    --------
    >>> error_column("draw_in_mm.+x")
    'estimated_errors.draw_in_+x_mm'
    """
    for pattern, error in ERRORS.items():
        if match := re.fullmatch(pattern, output):
            return f"estimated_errors.{match.expand(error)}"
    return ""
