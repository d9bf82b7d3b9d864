"""The report of a validation run: for readers (HTML), pull requests (Markdown) and machines.

`report.html` holds everything (`report_html.py`); `report.md` the verdict and what is not as it
should be (`report_text.py`); `report.json` all numbers; `junit.xml` one test a row. They are
written again after every case, so that a run that is cut short leaves a report.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import asdict, dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from quasiform.result.summary import package_version
from quasiform.solve.linear import linear_solver

from . import report_html
from .bands import AWAITED, LEFT_OUT, MISSED, MISSING, Case, Row
from .report_text import band, markdown, quantity, verdict

HTML, MARKDOWN, JSON, JUNIT = "report.html", "report.md", "report.json", "junit.xml"
FILES = (HTML, MARKDOWN, JSON, JUNIT)
PICTURES = "report_files"  # the folder of what the cases leave
FOLDER = Path(__file__).parent
PACKAGES = ("numpy", "scipy", "scikit-fem", "pyamg", "meshio", "shapely", "matplotlib", "plotly")
OPTIONAL = ("py-mkl-pardiso", "gmsh", "libigl")
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


@dataclass(frozen=True)
class About:
    """Of which run a report is: when, where, with what, and what was not chosen."""

    date: str
    quick: bool
    left_out: tuple[str, ...]
    versions: dict[str, str]
    machine: dict[str, str]


def about(*, quick: bool, left_out: list[str]) -> About:
    """Describe this run."""
    identity = csr_array(np.eye(2))
    solver = linear_solver("auto", identity, np.zeros((2, 2))).name
    versions = {"quasiform": _revision(package_version()), "Python": platform.python_version()}
    versions |= {name: _version(name) for name in PACKAGES}
    versions |= {name: found for name in OPTIONAL if (found := _version(name)) != "not installed"}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    set_threads = [f"{name}={os.environ[name]}" for name in THREADS if name in os.environ]
    machine = {
        "linear solver": solver,
        "processor": _processor(),
        "cores": str(cores),
        "threads": ", ".join(set_threads) or "left to the libraries",
        "system": f"{platform.system()} {platform.release()} ({platform.machine()})",
    }
    date = datetime.now().astimezone().isoformat(timespec="seconds")
    return About(date, quick, tuple(left_out), versions, machine)


def write(folder: Path, about: About, done: list[Case], waiting: list[str]) -> None:
    """Write all forms of the report of the cases done so far; `waiting` are still to be run."""
    page = report_html.page(about, done, waiting)
    _replace(folder / HTML, page)
    _replace(folder / MARKDOWN, markdown(about, done, waiting))
    summary = json.dumps(as_data(about, done, waiting), indent=1, allow_nan=False)
    _replace(folder / JSON, summary + "\n")
    _replace(folder / JUNIT, junit(done))


def as_data(about: About, done: list[Case], waiting: list[str]) -> dict[str, Any]:
    """Everything but the pictures."""
    return {
        "verdict": verdict(done, waiting),
        "held": all(case.held for case in done) and not waiting,
        **asdict(about),
        "waiting": waiting,
        "cases": [
            {
                "name": case.name,
                "held": case.held,
                "problem": case.problem,
                "seconds": round(case.seconds, 2),
                "date": case.date,
                "notes": list(case.notes),
                "counts": dict(case.counts),
                "rows": [_row_data(row) for row in case.rows],
            }
            for case in done
        ],
    }


def _row_data(row: Row) -> dict[str, Any]:
    value = row.value
    used = None if value is None or row.reference.value is None else row.reference.used(value)
    finite = value is not None and np.isfinite(value)
    return {
        "state": row.state,
        "computed": value if finite or value is None else str(value),
        "share_of_band": used if used is None or np.isfinite(used) else None,
        **{("reference" if key == "value" else key): v for key, v in asdict(row.reference).items()},
    }


def junit(done: list[Case]) -> str:
    """One test suite a case, one test a row."""
    root = ET.Element("testsuites", name="quasiform validation")
    for case in done:
        suite = ET.SubElement(
            root,
            "testsuite",
            name=case.name,
            tests=str(len(case.rows) + bool(case.problem)),
            failures=str(case.counts[MISSED] + case.counts[MISSING]),
            errors=str(int(bool(case.problem))),
            skipped=str(case.counts[AWAITED] + case.counts[LEFT_OUT]),
            time=f"{case.seconds:.3f}",
            timestamp=case.date,
        )
        if case.problem:
            test = ET.SubElement(suite, "testcase", classname=case.name, name="the case runs")
            ET.SubElement(test, "error", message=_printable(case.problem))
        for row in case.rows:
            known = row.reference
            test = ET.SubElement(suite, "testcase", classname=case.name, name=known.name)
            said = (
                f"{quantity(row.value, known.unit)}, reference "
                f"{quantity(known.value, known.unit)}, band {band(row)} ({known.standing})"
            )
            if not row.held:
                ET.SubElement(test, "failure", message=f"{row.state}: {said}")
            elif row.state in (AWAITED, LEFT_OUT):
                ET.SubElement(test, "skipped", message=row.state)
            elif known.limitation:
                ET.SubElement(test, "system-out").text = f"known limitation: {known.limitation}"
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _printable(text: str) -> str:
    """Text without the control characters that XML forbids."""
    return "".join(c if c.isprintable() else " " for c in text)


def _replace(path: Path, text: str) -> None:
    """Write a file that is whole at every moment."""
    new = path.with_name(f".{path.name}.new")
    new.write_text(text, encoding="utf-8")
    new.replace(path)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _revision(known: str) -> str:
    """The version, in a clone with its commit."""
    if not (FOLDER.parent / ".git").exists():
        return known
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty=, changed"],
            cwd=FOLDER.parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return known
    return f"{known} (commit {found.stdout.strip()})"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
