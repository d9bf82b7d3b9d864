"""What the numbers of a run depend on: its table, picture and lines, for the command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..checks import InputError, number
from ..model import Model
from ..result.certificate import spoken, unit
from ..result.files import SENSITIVITY, added, writing_to
from ..result.run import Result
from ..solve.parameters import check_smooth, named, parameters
from ..tables import write_rows

SHOWN = 4, 10  # numbers of a run and parameters in the picture at most
PERCENT = 0.01


def check(model: Model, uncertain: Mapping[str, float]) -> None:
    """Refuse (InputError) an unknown parameter, and one without a derivative, before the run."""
    known = parameters(model)
    for name in uncertain:
        check_smooth(model, named(known, name))


def save(
    result: Result, every: bool, uncertain: Mapping[str, float], folder: Path
) -> list[tuple[str, str]]:
    """Write the derivatives of a run and their picture; return rows for its report.

    By every parameter, or by those that are uncertain. Where there is none the row says why.
    """
    try:
        found = result.sensitivity(None if every else uncertain, result.quantities)
    except InputError as error:
        return [("sensitivity", str(error))]
    table = found.table()
    by_output = found.errors(uncertain)
    changes = by_output if uncertain else _percent(table)
    if uncertain:
        table["error"] = [
            by_output[output].get(name)
            for name, output in zip(table["parameter"], table["output"], strict=True)
        ]
    with writing_to(folder), added(folder) as staging:
        write_rows(staging / SENSITIVITY[0], [table, *zip(*table.values(), strict=True)])
        _draw(changes, found.parameters, uncertain, staging / SENSITIVITY[1])
    if not uncertain:
        largest = changes[result.model.force_name]
        words = f"{spoken(result.model.force_name)} changes by 1 % of "
        names = sorted(largest, key=lambda name: -abs(largest[name]))[:3]
        words += ", ".join(f"{name}: {number(largest[name], 2)}" for name in names)
        return [("sensitivity", words + unit(result.model.force_name))]
    rows = []
    for name, parts in result.parameter_errors(uncertain, found).items():
        words = number(parts.pop("value"))
        total = parts.pop("total")
        for part, error in parts.items():
            if error is not None:
                words += f" ± {number(error, 2)} {part.rpartition('.')[2]}"
        words += f", together ± {number(total, 2)}{unit(name)}"
        rows.append((spoken(name).removeprefix("the "), words))
    return rows


def _percent(table: Mapping[str, list[Any]]) -> dict[str, dict[str, float]]:
    """Change of each number by 1 % of each parameter."""
    found: dict[str, dict[str, float]] = {}
    for name, output, change in zip(
        table["parameter"], table["output"], table["by_percent"], strict=True
    ):
        found.setdefault(output, {})[name] = change
    return found


def _draw(
    changes: Mapping[str, Mapping[str, float]],
    known: Mapping[str, Any],
    uncertain: Mapping[str, float],
    path: Path,
) -> None:
    """Tornado of the numbers of a run."""
    from ..draw.studies import DPI, tornado_figure

    by = {named(known, name).name: error for name, error in uncertain.items()}
    shown = dict(list(changes.items())[: SHOWN[0]])
    scale = {output: max(map(abs, entry.values())) or 1.0 for output, entry in shown.items()}
    names = {name for entry in shown.values() for name in entry}
    weight = {n: max(abs(shown[o][n]) / scale[o] for o in shown) for n in names}
    kept = sorted(names, key=lambda name: -weight[name])[: SHOWN[1]]
    labels = {
        name: f"{name}\n{number(known[name].value)} ± {number(by.get(name, 0.0))}" if by else name
        for name in kept
    }
    title = "change by what each parameter is uncertain by" if by else "change by 1 % of each"
    shown = {output: {n: entry[n] for n in kept} for output, entry in shown.items()}
    tornado_figure(shown, labels, title, bool(by)).savefig(path, dpi=DPI)
