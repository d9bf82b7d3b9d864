"""What commands print."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from ..checks import number

if TYPE_CHECKING:
    from ..identification import Identification
    from ..identification.campaign import Campaign
    from ..model import Model
    from ..result.run import Result

LOOSE = 3.0  # %: a misfit beyond the scatter of good tests
SHOWN = 3  # limits of trust in the terminal
ZERO = 1e-9  # N, mm, deg: what is smaller is printed as 0
WIDE = 2.0  # degrees: an error of the shear angle that is pointed out
SPREAD = (
    "force_N",
    "load_work_mJ",
    "shear_angle_deg",
    "shear_angle_mean_deg",
)  # shown of perturbed starts


def say(*lines: str) -> None:
    """Print; a reader that has closed the pipe (`| head`) does not end the run."""
    shown = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in "\n".join(lines))
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(shown.encode(encoding, "backslashreplace").decode(encoding), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def table(rows: Iterable[Iterable[object]], indent: int = 0) -> str:
    """Columns of text; cells are folded on a terminal only."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    for k, row in enumerate(rows):
        cells = [str(cell) for cell in row]
        if not k:
            for i in range(len(cells)):
                grid.add_column(no_wrap=i < len(cells) - 1)
        grid.add_row(*cells)
    width = None if sys.stdout.isatty() else 10_000
    page = Console(file=StringIO(), width=width, markup=False, highlight=False, emoji=False)
    with page.capture() as drawn:
        page.print(grid)
    return "\n".join(" " * indent + line.rstrip() for line in drawn.get().splitlines())


def files(folder: Path, names: Sequence[str]) -> str:
    """Which of the files were written."""
    return f"files in {folder}: {', '.join(name for name in names if (folder / name).exists())}"


def notes(found: Iterable[str], general: Collection[str] = (), where: str = "") -> list[str]:
    """Notes of a hand-over; those that are true of every one are counted only."""
    lines = [f"  note: {note}" for note in found if note not in general]
    if general:
        lines.append(f"  {len(general)} notes that apply to every such export are in {where}")
    return lines


def study(columns: Mapping[str, Sequence[Any]]) -> str:
    """How the runs of a study ended."""
    counts = Counter(columns["status"])
    converged = sum(map(bool, columns["converged"]))
    words = ", ".join(f"{count} {status}" for status, count in counts.items())
    lines = [f"{len(columns['run'])} runs: {words}; {converged} converged"]
    reasons = Counter(filter(None, columns["reason"])).most_common(3)
    return "\n".join([*lines, *(f"  {count} × {reason}" for reason, count in reasons)])


def describe(model: Model) -> str:
    """The model: its size, what is in it and what was left out, and why."""
    nodes, triangles = (
        sum(len(getattr(sheet.blank, name)) for sheet in model.sheets)
        for name in ("nodes", "triangles")
    )
    return "\n".join(
        [
            f"{model.name}: {nodes} nodes, {triangles} triangles, "
            f"{(~model.fixed).sum()} dofs, travel {model.travel:g}"
            + " mm"
            * (model.force_name == "force_N"),
            f"  fabric: {', '.join(dict.fromkeys(p.sheet.fabric.name for p in model.plies))}",
            *(f"  {entry}: {why}" for entry, why in model.description),
        ]
    )


def report(
    result: Result,
    seconds: float,
    estimate: bool | str = True,
    more: Sequence[tuple[str, str]] = (),
) -> str:
    """Key numbers of a run, with their errors and what they are worth.

    `estimate` is how the error was asked for: "coarse" in a draft; `more` are further rows.
    """
    summary, travel = result.summary(), result.model.travel
    name = result.model.force_name
    numbers = _numbers(summary, "work of load" if name == "load_work_mJ" else "force", name)
    rows = numbers | _errors(result, summary, bool(estimate)) | _worth(summary)
    rows |= dict(more)
    if estimate == "coarse":
        rows["draft"] = "a coarse mesh and long increments, which are not certified"
    rows["wall time"] = f"{summary['wall_s']:.1f} s"
    rows["total time"] = f"{seconds:.1f} s, with {'error estimate and ' * bool(estimate)}files"
    reason = f": {summary['reason']}" if summary["reason"] else ""
    unit = " mm" if name == "force_N" else ""
    reached = f"{number(summary['reached_mm'])} of {number(travel)}{unit}"
    return f"{summary['status']} at {reached}{reason}\n{table(rows.items(), 2)}"


def _numbers(summary: Mapping[str, Any], what: str, name: str) -> dict[str, str]:
    errors = summary["estimated_errors"].items()
    off = {name: f" ± {number(error, 2, ZERO)}" for name, error in errors if error is not None}
    gamma = summary["shear_angle_deg"]
    rows = {
        what: f"{number(summary[name], zero=ZERO)}{off.get(name, '')} {name.rpartition('_')[2]}",
        "shear angle": f"max {gamma['max']:.2f}, p99 {gamma['p99']:.2f}"
        f"{off.get('shear_angle_deg', '')}, mean {gamma['mean']:.2f}"
        f"{off.get('shear_angle_mean_deg', '')} deg",
    }
    for row, key, error, unit in (
        ("draw-in", "draw_in_mm", "draw_in_{}_mm", "mm"),
        ("areas", "areas", "area_{}_deg", "deg (mean shear angle)"),
    ):
        if summary.get(key):
            rows[row] = ", ".join(
                f"{name} {'none' if value is None else f'{value:.2f}'}"
                f"{off.get(error.format(name), '')}"
                for name, value in summary[key].items()
            )
            rows[row] += f" {unit}"
    if summary["assumed"]:
        rows["assumed"] = in_short(summary["assumed"])
    return rows


def in_short(names: Iterable[str]) -> str:
    """The names in a line, the numbers of a part of the scene together.

    Examples
    --------
    >>> in_short(["blank.length", "tools.punch.radius", "areas.pink", "fabric.compaction"])
    'numbers of blank, punch, areas; compaction of the fabric'
    """
    parts: dict[str, None] = {}
    keys = []
    for name in names:
        head, *rest = name.split(".")
        if head == "fabric":
            keys.append(rest[0])
        else:
            parts[rest[0] if head == "tools" else head] = None
    words = [f"numbers of {', '.join(parts)}"] if parts else []
    return "; ".join(words + ([f"{', '.join(keys)} of the fabric"] if keys else []))


def _errors(result: Result, summary: Mapping[str, Any], asked: bool) -> dict[str, str]:
    rows = {}
    if not any(error is not None for error in summary["estimated_errors"].values()):
        why = "no coarser mesh of this scene came to the same end"
        if not asked:
            why = "not asked for (--no-estimate)"
        elif result.reason or result.collapse:
            why = "the run stopped early" if result.reason else "the sheet has collapsed"
        rows["error estimate"] = f"none: {why}"
    elif (summary["error_estimate"]["shear_angle_deg"] or 0.0) > WIDE:
        finer = "--accuracy 1 or a smaller" if result.model.contacts else "a smaller"
        rows["error estimate"] = f"large: {finer} --size reduces it"
    doubtful = []
    for k, ply in enumerate(summary.get("plies") or [summary], 1):
        shares = {name: share for name, share in ply["doubtful_share"].items() if share >= 0.005}
        words = ", ".join(f"{name.replace('_', ' ')} {share:.0%}" for name, share in shares.items())
        doubtful += [f"{words} of the area{f' of ply {k}' * ('plies' in summary)}"] * bool(shares)
    if doubtful:
        rows["doubtful"] = "; ".join(doubtful)
    if summary["collapse"]:
        rows["collapse"] = (
            "from {travel_mm:.4g} mm on, first at X = ({at[0]:.1f}, {at[1]:.1f}) mm, "
            "{shear_angle_deg:.1f} deg".format(**summary["collapse"])
        )
    return rows


def _worth(summary: Mapping[str, Any]) -> dict[str, str]:
    rows = {}
    if spread := summary["spread"]:
        words = {
            "scattered": [k for k, entry in spread.items() if entry["judged"] > entry["robust"]],
            "not judged, the mesh error is large": [k for k in spread if not spread[k]["judged"]],
        }
        found = [f"{what}: {', '.join(names)}" for what, names in words.items() if names]
        rows["perturbed"] = ", ".join(
            f"{name} {number(spread[name]['low'])} to {number(spread[name]['high'])}"
            for name in spread
            if name in SPREAD
        )
        rows["perturbed"] = "; ".join([rows["perturbed"], *(found or ["all robust"])])
    if summary["path_size_mm"]:
        rows["path"] = f"followed at size {summary['path_size_mm']:g} mm"
    rows["converged"] = "yes" if summary["certificate"]["converged"] else "no"
    limits = [*summary["certificate"]["reasons"], *summary["trust"]]
    rows["trust"] = f"limited: {'; '.join(limits[:SHOWN])}" if limits else "no limit was found"
    if (more := len(limits) - SHOWN) > 0:
        rows["trust"] += f"; and {more} more (summary.json)"
    work = ", ".join(f"{times} at {mesh}" for mesh, times in summary["factorisations"].items())
    solver, increments = summary["solver"]["linear"], summary["increments"]
    rows["factorisations"] = f"{work} ({solver}), in {increments} increments"
    return rows


def campaign(campaign: Campaign) -> str:
    """Tests of a campaign, and how they will be used."""
    import numpy as np

    from ..identification.campaign import METHODS

    fabric, origins = campaign.fabric, campaign.fabric.provenance
    rows = [f"{campaign.name}: {METHODS[campaign.method] if campaign.shear else 'bending tests'}"]
    if campaign.shear:
        rows.append(f"  thickness {fabric.thickness:g} mm ({origins['thickness']})")
    if campaign.bending:
        rows.append(f"  areal weight {fabric.areal_weight:g} g/m² ({origins['areal_weight']})")
    for test in campaign.shear:
        gamma = np.degrees(test.forces(fabric.thickness).angles[0])
        rows.append(
            f"  {test.name}: {len(gamma)} rows, shear angle {gamma.min():.1f} to "
            f"{gamma.max():.1f} deg, force to {number(test.curve.force.max())} "
            + ("N/mm" if test.curve.per_length else "N")
        )
        rows += [f"    {notice}" for notice in test.curve.notices]
    for family, bent in campaign.bending.items():
        value = getattr(bent, "value", None) or bent.initial
        rows.append(f"  bending, {family}: {number(value)} N mm")
    return "\n".join(rows)


def identified(found: Identification) -> str:
    """Parameters that were identified, with their intervals, and the notes."""
    lines = []
    if found.curve is not None:
        misfit = found.fabric.provenance["force_misfit_percent"]
        lines.append(
            f"  tested from {found.curve.low:.1f} to {found.curve.high:.1f} degrees of shear, "
            f"forces within {misfit:g} % (root mean square)"
        )
        if misfit > LOOSE and found.campaign.method == "fit":
            lines.append("  --method table follows the forces where the parameters do not")
    if found.fitted is not None:
        first, third = found.fitted.stages
        lines.append(f"  first stage to {first:.1f} degrees, third from {third:.1f} degrees")
    read = {notice for test in found.campaign.shear for notice in test.curve.notices}
    lines += [f"  note: {notice}" for notice in found.notices if notice not in read]
    rows = []
    for p in found.parameters:
        interval = f"{number(p.low)} to {number(p.high)}" if p.low == p.low else "-"
        rows.append((p.name, number(p.value, 5), p.unit, interval, p.state))
    lines += [f"  warning: {notice}" for notice in sorted(read) if "not given, defaults" in notice]
    return "\n".join(["identified, with 95 % intervals", table(rows, 2), *lines])
