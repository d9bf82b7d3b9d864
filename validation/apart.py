"""Run one case in this process and write its results to files.

    python -m validation.apart CASE FOLDER [--quick]

`validation.run` starts this process for each case, so that a crash does not stop the other cases.
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

from quasiform.draw import view
from quasiform.draw.plot import save_pictures
from validation.run import OUTCOME, Outcome

if TYPE_CHECKING:
    from quasiform.result.run import Result

DPI = 144


def outcome(case: str, quick: bool) -> Outcome:
    """The outcome of a case: what its `run` returns, or only `values`."""
    module = importlib.import_module(f"validation.{case}.case")
    if not hasattr(module, "run"):
        return Outcome(module.values())
    returned = module.run(quick)
    if not isinstance(returned, Outcome):
        raise TypeError(f"{inspect.getfile(module)}: run must return an Outcome, got {returned!r}")
    return returned


def write(case: str, folder: Path, quick: bool) -> None:
    """Write `outcome.json`, the pictures and the views of the sheets to a folder."""
    content = {"values": {}, "notes": [], "figures": [], "sheets": [], "problem": ""}
    start, end = time.perf_counter(), 0.0
    try:
        found = outcome(case, quick)
        end = time.perf_counter()
        content["values"] = {name: _number(value) for name, value in found.values.items()}
        content["notes"] = list(found.notes)
        for number, (caption, figure) in enumerate(found.figures.items(), 1):
            name = f"figure_{number}.png"
            figure.savefig(folder / name, dpi=DPI)
            content["figures"].append((caption, name))
        for number, (caption, result) in enumerate(found.sheets.items(), 1):
            content["sheets"].append((caption, *_sheet(result, folder, f"sheet_{number}")))
    except Exception as error:  # reported; the other cases still run
        content["problem"] = f"crashed: {type(error).__name__}: {error}".strip()
        traceback.print_exc()
    content["seconds"] = (end or time.perf_counter()) - start
    (folder / OUTCOME).write_text(json.dumps(content), encoding="utf-8")


def _number(value: float) -> float | str:
    """A number that JSON can hold: nan and infinities by their names."""
    value = float(value)
    return value if isfinite(value) else str(value)


def _sheet(result: Result, folder: Path, name: str) -> tuple[str, str | None, str]:
    """Description of a sheet, file of its 3D view (None without plotly) and of its picture."""
    with TemporaryDirectory(dir=folder) as pictures:
        save_pictures(result.record, pictures)
        Path(pictures, "shear_angle.png").replace(folder / f"{name}.png")
    interactive = None
    if view.available():
        interactive = f"{name}.json"
        (folder / interactive).write_text(view.figure(result.record).to_json(), encoding="utf-8")
    return view.words(result.record), interactive, f"{name}.png"


if __name__ == "__main__":
    write(sys.argv[1], Path(sys.argv[2]), "--quick" in sys.argv[3:])
