"""One run of a study: a function of a description in numbers and text, on any machine.

Files that the description names travel beside it by their content: `@files/NAME` stands for such
a file, NAME is its SHA-256 with its suffix. They are unpacked into a folder of the process.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..checks import InputError
from ..model import Model
from ..recipe import Recipe
from ..result.certificate import wrinkled
from ..result.run import Result
from ..result.summary import package_version
from ..solve.asked import asked, solved

PLACE = "@files/"
FIELDS = "fields.npz"
START = "start"  # number of a perturbed start; 0: no noise
LINEAR = "linear solver"
TEXTS = (".json", ".toml")
LONG = ("model", "parameters", "files", "assumed", "solver")  # of a summary: in the study already


def environment() -> dict[str, Any]:
    """Return what the digits of a result depend on: the same wherever a study runs."""
    found = {"quasiform": package_version(), LINEAR: "superlu", "numba": bool(find_spec("numba"))}
    with suppress(ImportError, AttributeError, OSError):
        if import_module("pymklpardiso")._PardisoSolver:
            found[LINEAR] = "pardiso"
    return found


def difference(here: Mapping[str, Any], there: Mapping[str, Any]) -> str:
    """Say in which part an environment differs; empty if in none."""
    return ", ".join(f"{k} {there.get(k)} (here {v})" for k, v in here.items() if there.get(k) != v)


@cache
def folder() -> TemporaryDirectory:
    """Folder of this process for the files of its runs."""
    return TemporaryDirectory(prefix="quasiform-")


def unpack(files: Mapping[str, bytes]) -> None:
    """Write files that are not there yet."""
    for name, content in files.items():
        path = Path(folder().name, name)
        if not path.exists():
            path.write_bytes(content)


def model_of(description: Mapping[str, Any]) -> tuple[Model, dict[str, Any]]:
    """Build the model of a run; return it with its options."""
    if PLACE in (text := json.dumps(description)):
        description = json.loads(text.replace(PLACE, f"{Path(folder().name).as_posix()}/"))
    if "recipe" in description:
        for reference in description["recipe"]["changes"]:
            import_module(reference.partition(":")[0])
        model, run = Recipe.read(description["recipe"]).build(), {}
    elif "strip" in description:
        from ..fabric import Fabric
        from ..scenes.fabric_tests import off_axis_tension

        fabric = Fabric.read(description["fabric"])
        model, run = off_axis_tension(law=fabric, **description["strip"]), description["run"]
    else:
        from ..scenes.forming import forming
        from ..scenes.scene_file import read_text

        file = read_text({"toml": description["scene"], "source": ""})
        model, run = forming(file, size=description["size"]), file.run
    if run.get("linear", "auto") == "auto":
        run = {**run, "linear": description["environment"][LINEAR]}
    model, options = asked(model, run)
    return model, options | {"seed": description.get(START)}


def outcome(
    description: Mapping[str, Any], files: Mapping[str, bytes], keep: bool, fields: bool
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Solve one run; return its row and the files that it leaves.

    Whatever goes wrong in a run is in its row. InputError if this process has another version.
    """
    if other := difference(description["environment"], environment()):
        raise InputError(f"a worker has another environment: {other}")
    clock = time.thread_time()
    row: dict[str, Any] = {}
    left: dict[str, bytes] = {}
    try:
        unpack(files)
        result = solved(*model_of(description))
        row = _row(result)
        left = _files(result, keep, fields)
    except InputError as error:
        row = {"error": str(error)}
    except MemoryError:
        row = {"error": "not enough memory"}
    except Exception as error:  # a run that crashes is a row of the study
        row = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
    row = json.loads(_portable(json.dumps(row).encode()))
    return row | {"cpu_s": round(time.thread_time() - clock, 3)}, left


def _row(result: Result) -> dict[str, Any]:
    """What the tables of a study need of a result."""
    record = result.record
    travel = record.history[record.travel_name]
    angles = [(ply.summary["shear_angle_deg"]["p99"], ply.locking) for ply in record.plies]
    return {
        "summary": {k: v for k, v in record.summary.items() if k not in LONG},
        "energy_mJ": result.energy,
        "wrinkled": any(map(wrinkled, result.plies)),
        "locked": any(bool(locking) and angle > locking for angle, locking in angles),
        "history": [travel.tolist(), record.forces.tolist()],
    }


def _portable(content: bytes) -> bytes:
    """Return a text without the folder of this process, if it has one."""
    if not folder.cache_info().currsize:
        return content
    return content.replace(f"{Path(folder().name).as_posix()}/".encode(), PLACE.encode())


def _files(result: Result, keep: bool, fields: bool) -> dict[str, bytes]:
    """Contents of the files of a result, by name."""
    left = {}
    if keep:
        with TemporaryDirectory() as out:
            result.save(out, force=True)
            left = {path.name: path.read_bytes() for path in sorted(Path(out).iterdir())}
            left |= {name: _portable(left[name]) for name in left if name.endswith(TEXTS)}
    if fields:
        sheet, packed = result.sheet, BytesIO()
        arrays = {f"point/{name}": value for name, value in sheet.point_fields.items()}
        arrays |= {f"cell/{name}": value for name, value in sheet.cell_fields.items()}
        arrays |= {"points": sheet.points, "flat": sheet.flat, "triangles": sheet.triangles}
        np.savez_compressed(packed, **{name: np.asarray(value) for name, value in arrays.items()})
        left[FIELDS] = packed.getvalue()
    return left
