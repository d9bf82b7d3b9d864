"""Run one case in this process, and leave what it hands over as files.

    python -m validation.apart CASE FOLDER [--quick]

`validation.run` starts this for every case, so that a case that crashes takes nothing with it.
"""

from __future__ import annotations

import importlib
import inspect
import json
import sys
import time
import traceback
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from validation.run import OUTCOME, Outcome

if TYPE_CHECKING:
    from quasiform.result.run import Result

DPI = 144


def hand_over(case: str, quick: bool) -> Outcome:
    """What a case hands over: that of its `run`, or the plain `values`."""
    module = importlib.import_module(f"validation.{case}.case")
    if not hasattr(module, "run"):
        return Outcome(module.values())
    outcome = module.run(quick)
    if not hasattr(outcome, "values") or not hasattr(outcome, "sheets"):
        raise TypeError(f"{inspect.getfile(module)}: run must return an Outcome, not {outcome!r}")
    return outcome


def leave(case: str, folder: Path, quick: bool) -> None:
    """Write `outcome.json`, the pictures and the views of the sheets to a folder."""
    left = {"values": {}, "notes": [], "figures": [], "sheets": [], "problem": ""}
    start, views = time.perf_counter(), 0.0
    try:
        outcome = hand_over(case, quick)
        views = time.perf_counter()
        left["values"] = {name: _number(value) for name, value in outcome.values.items()}
        left["notes"] = list(outcome.notes)
        for number, (caption, figure) in enumerate(outcome.figures.items(), 1):
            name = f"figure_{number}.png"
            figure.savefig(folder / name, dpi=DPI)
            left["figures"].append((caption, name))
        for number, (caption, result) in enumerate(outcome.sheets.items(), 1):
            left["sheets"].append((caption, *_sheet(result, folder, f"sheet_{number}")))
    except Exception as error:  # told in the report, which goes on with the other cases
        left["problem"] = f"crashed: {type(error).__name__}: {error}".strip()
        traceback.print_exc()
    left["seconds"] = (views or time.perf_counter()) - start
    (folder / OUTCOME).write_text(json.dumps(left), encoding="utf-8")


def _number(value: float) -> float | str:
    """A number that JSON can hold: nan and infinities by their names."""
    value = float(value)
    return value if isfinite(value) else str(value)


def _sheet(result: Result, folder: Path, name: str) -> tuple[str, str | None, str]:
    """Words about a sheet, its interactive view (None without plotly) and its picture."""
    from quasiform.draw import view
    from quasiform.draw.plot import save_pictures

    with TemporaryDirectory(dir=folder) as pictures:
        save_pictures(result.record, pictures)
        Path(pictures, "shear_angle.png").replace(folder / f"{name}.png")
    interactive = None
    if view.available():
        interactive = f"{name}.json"
        (folder / interactive).write_text(view.figure(result.record).to_json(), encoding="utf-8")
    return view.words(result.record), interactive, f"{name}.png"


if __name__ == "__main__":
    leave(sys.argv[1], Path(sys.argv[2]), "--quick" in sys.argv[3:])
