"""The report of a validation run: for readers (HTML), pull requests (Markdown) and programs.

`report.html` has everything; `report.md` the verdict, failures and limitations; `report.json` all
numbers; `junit.xml` one test per row. They are written again after each case, so that an
interrupted run leaves a report. HTML and Markdown come from the templates `report.html.j2` and
`report.md.j2`. Styles, scripts, pictures and plotly are inside the HTML file; it loads nothing.
"""

from __future__ import annotations

import base64
import json
import os
import platform
import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import asdict, dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup
from matplotlib.figure import Figure
from scipy.sparse import csr_array

from quasiform.result.summary import package_version
from quasiform.solve.linear import linear_solver

from . import agreement
from .bands import (
    FAILED,
    INFORMATION,
    LIMITATION,
    MISSING,
    NO_REFERENCE,
    PASSED,
    SKIPPED,
    WRONG,
    Case,
    Row,
)
from .report_text import band, duration, quantity, verdict

HTML, MARKDOWN, JSON, JUNIT = "report.html", "report.md", "report.json", "junit.xml"
FILES = (HTML, MARKDOWN, JSON, JUNIT)
PICTURES = "report_files"  # the folder for the files of the cases
FOLDER = Path(__file__).parent
PACKAGES = ("numpy", "scipy", "scikit-fem", "pyamg", "meshio", "shapely", "matplotlib", "plotly")
OPTIONAL = ("py-mkl-pardiso", "gmsh", "libigl")
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
TYPES = {".png": "image/png", ".svg": "image/svg+xml"}


class Sign(NamedTuple):
    """How a state is shown: sign, CSS class and meaning."""

    sign: str
    kind: str
    meaning: str


STATES = {
    PASSED: Sign("✓", "passed", "the computed value is within the tolerance"),
    FAILED: Sign("✗", "failed", "it is outside, or not a number; the exit status is 1"),
    MISSING: Sign("✗", "missing", "the case did not return a value; the exit status is 1"),
    LIMITATION: Sign(
        "◆",
        "limitation",
        "the model is known to differ here, for the reason given; the row has its own tolerance, "
        "and the value is within it",
    ),
    NO_REFERENCE: Sign(
        "○", "unknown", "the measured value is not published yet; the row is not judged"
    ),
    INFORMATION: Sign("·", "information", "a value without a tolerance; it is not judged"),
    SKIPPED: Sign("–", "skipped", "only the other suite (quick or full) computes this row"),
}
STANDINGS = {
    "measured": "a published experiment; only these rows compare with an experiment",
    "input": "a measured value that the model was given; the row checks that it comes back",
    "between tests": "one measurement against another; the model takes no part",
    "stated": "a statement of the paper that this package follows",
    "exact": "a closed form, or an equation solved to all digits",
    "peer": "another code on the same problem",
    "prototype": "an earlier calculation with this method",
    "inferred": "follows from a statement, with an assumption",
    "assumed": "a choice, as nothing is stated",
    "own": "a bound of this package for consistency, without an outside reference",
}
GATHERED = {  # rows of all cases that a reader should see first
    "Failed rows and missing values": WRONG,
    "Known limitations, each within its own tolerance": (LIMITATION,),
    "Rows without a reference yet": (NO_REFERENCE,),
}
WORST, FIRST = 3, 5  # disagreements and pictures on the first screen
STUDIES = (  # pictures that other commands make: folder, title, command, about, patterns
    (
        "speed",
        "Speed and accuracy",
        "python -m validation.speed --out validation/speed",
        "Error against work for sizes, increments and strategies, with the Pareto front.",
        ("chart_*.svg", "chart_*.png"),
    ),
    (
        "stability",
        "Stability map",
        "python -m validation.stability",
        "Scenes against settings: the travel reached, rescues and certificate of each.",
        ("map*.svg", "map*.png"),
    ),
)


@dataclass(frozen=True)
class About:
    """Date, suite, versions and machine of a run, and the cases that were not chosen."""

    date: str
    quick: bool
    not_run: tuple[str, ...]
    versions: dict[str, str]
    machine: dict[str, str]

    @property
    def suite(self) -> str:
        """The name of the suite."""
        return "quick suite" if self.quick else "full suite"


def about(*, quick: bool, not_run: list[str]) -> About:
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
        "threads": ", ".join(set_threads) or "default of the libraries",
        "system": f"{platform.system()} {platform.release()} ({platform.machine()})",
    }
    date = datetime.now().astimezone().isoformat(timespec="seconds")
    return About(date, quick, tuple(not_run), versions, machine)


def write(folder: Path, about: About, done: list[Case], waiting: list[str]) -> None:
    """Write the report of the cases done so far in all forms; `waiting` are not run yet."""
    _replace(folder / HTML, page(about, done, waiting))
    _replace(folder / MARKDOWN, markdown(about, done, waiting))
    summary = json.dumps(as_data(about, done, waiting), indent=1, allow_nan=False)
    _replace(folder / JSON, summary + "\n")
    _replace(folder / JUNIT, junit(done))


def page(about: About, done: list[Case], waiting: list[str]) -> str:
    """The report as one HTML file."""
    scripts = []
    if any(view for case in done for _, _, view, _ in case.sheets):
        from plotly.offline import get_plotlyjs

        scripts = [Markup(get_plotlyjs()), Markup(_own("report.js"))]
    rows = [row for case in done for row in case.rows]
    total = Counter(row.state for row in rows)
    by_standing = {
        standing: Counter(row.state for row in rows if row.reference.standing == standing)
        for standing in STANDINGS
    }
    rows_measured = agreement.compared(done)
    by_curve = [found[0] for found in agreement.groups(rows_measured).values()]
    return _render(
        "report.html.j2",
        about,
        done,
        waiting,
        passed=all(case.passed for case in done),
        total=total,
        columns=[state for state in STATES if total[state] or state in (PASSED, FAILED)],
        worst=by_curve[:WORST],
        by_case=agreement.by_case(rows_measured),
        first_pictures=_first_pictures(done),
        times=agreement.times,
        by_standing={name: counts for name, counts in by_standing.items() if counts},
        standings=STANDINGS,
        studies=[_study(*study) for study in STUDIES],
        css=Markup(_own("report.css")),
        scripts=scripts,
    )


def _first_pictures(done: list[Case]) -> list[tuple[str, str, Path | Figure]]:
    """Five pictures: the agreement with measurement, then one a case, those with tests first."""
    tested = {found.case for found in agreement.compared(done)}
    cases = sorted(done, key=lambda case: case.name not in tested)
    found = [
        (f"case-{case.name}", *case.figures[k])
        for k in range(2)
        for case in cases
        if len(case.figures) > k
    ]
    if tested:
        caption = "Computed over measured: one dot a number, the worst curves first"
        found.insert(0, ("verdict", caption, agreement.figure(done)))
    return found[:FIRST]


def markdown(about: About, done: list[Case], waiting: list[str]) -> str:
    """The verdict, failures and limitations, for a pull request."""
    return _render("report.md.j2", about, done, waiting, wrong=WRONG)


def _render(template: str, about: About, done: list[Case], waiting: list[str], **more: Any) -> str:
    """Fill a template; both use the same formats, and the rows gathered from all cases."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=template.endswith(".html.j2"),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    formats = (band, difference, duration, picture, quantity, readme, reference, title, used)
    formats += (agreement.label,)
    environment.globals |= {f.__name__: f for f in formats}
    environment.globals["with_case"] = lambda case, rows: [(case, row) for row in rows]
    environment.filters |= {
        "cell": lambda text: " ".join(text.split()).replace("|", "\\|"),
        "clock": lambda date: date[5:16].replace("T", " "),
        "data": lambda path: Markup(path.read_text(encoding="utf-8").replace("</", "<\\/")),
        "day": lambda date: f"{date[:16].replace('T', ' ')} {date[19:].replace('+00:00', 'UTC')}",
        "inline": lambda text: Markup(_reader().renderInline(text)),
    }
    gathered = {
        heading: [(case, row) for case in done for row in case.rows if row.state in states]
        for heading, states in GATHERED.items()
    }
    text = environment.get_template(template).render(
        about=about,
        done=done,
        waiting=waiting,
        verdict=verdict(done, waiting),
        headline=agreement.headline(done),
        states=STATES,
        gathered=gathered,
        **more,
    )
    return text.strip() + "\n"


def reference(row: Row) -> str:
    """The reference value, or why there is none."""
    known = row.reference
    if known.value is None:
        return "not published"
    if (known.tolerance, known.value) == ("report", 0):
        return "none"
    kind = {"max": "at most ", "min": "at least "}.get(known.tolerance, "")
    return kind + quantity(known.value, known.unit)


def difference(row: Row) -> str:
    """The difference from the reference with its unit, or why there is none."""
    known = row.reference
    if known.value is None or (known.tolerance, known.value) == ("report", 0):
        return "no reference"
    if row.value is None:
        return "not computed"
    off = row.value - known.value
    unit = {"deg": "°", "1": ""}.get(known.unit, f" {known.unit}")
    ratio = row.value / known.value if known.value else 0.0
    if not ratio > 0 or not isfinite(ratio):
        words = f"{off:+.3g}{unit}"
    elif not 0.5 < ratio < 2:
        words = f"{ratio:.3g} ×"
    else:
        words = f"{100 * (ratio - 1):+.3g} %" if off else "0 %"
        if known.unit == "deg" and off:
            words = f"{off:+.3g}° ({words})"
    return words.replace("-", "−")


def used(row: Row) -> float | None:
    """Used share of the tolerance; None where this has no meaning."""
    if row.value is None or row.reference.value is None:
        return None
    share = row.reference.used(row.value)
    return share if share is not None and isfinite(share) else None


def picture(path: Path | Figure, description: str) -> Markup:
    """An image element with the picture inside; a PNG's size prevents jumps while it loads."""
    size, suffix = Markup(), ".png"
    if isinstance(path, Figure):
        path.savefig(drawn := BytesIO(), dpi=144)
        content = drawn.getvalue()
    else:
        content, suffix = path.read_bytes(), path.suffix
    if suffix == ".png":
        width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
        size = Markup(f' width="{width}" height="{height}"')
    return Markup(
        '<img alt="{}" loading="lazy" decoding="async"{} src="data:{};base64,{}">'
    ).format(description, size, TYPES[suffix], base64.b64encode(content).decode())


def title(case: str) -> str:
    """The first heading of a case's README."""
    return _readme(case)[0]


def readme(case: str) -> Markup:
    """The rest of a case's README as HTML, headings one level down."""
    reader = _reader()
    tokens = reader.parse(_readme(case)[1])
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(6, int(token.tag[1]) + 1)}"
    return Markup(reader.renderer.render(tokens, reader.options, {}))


def _readme(case: str) -> tuple[str, str]:
    path = FOLDER / case / "README.md"
    if not path.is_file():
        return case, "*This case has no README.*"
    head, _, rest = path.read_text(encoding="utf-8").strip().partition("\n")
    return head.lstrip("# ").strip() or case, rest


def _reader() -> MarkdownIt:
    return MarkdownIt("commonmark", {"html": False}).enable("table")


def _study(
    folder: str, title: str, command: str, about: str, patterns: tuple[str, ...]
) -> dict[str, Any]:
    pictures = [path for pattern in patterns for path in sorted((FOLDER / folder).glob(pattern))]
    return {
        "folder": folder,
        "title": title,
        "command": command,
        "about": about,
        "pictures": pictures,
    }


def _own(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def as_data(about: About, done: list[Case], waiting: list[str]) -> dict[str, Any]:
    """Everything except the pictures, as data for JSON."""
    return {
        "agreement": agreement.headline(done),
        "verdict": verdict(done, waiting),
        "passed": all(case.passed for case in done) and not waiting,
        **asdict(about),
        "waiting": waiting,
        "cases": [
            {
                "name": case.name,
                "passed": case.passed,
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
    finite = value is not None and isfinite(value)
    return {
        "state": row.state,
        "computed": value if finite or value is None else str(value),
        "share_of_band": used(row),
        **{("reference" if key == "value" else key): v for key, v in asdict(row.reference).items()},
    }


def junit(done: list[Case]) -> str:
    """One test suite per case, one test per row."""
    root = ET.Element("testsuites", name="quasiform validation")
    for case in done:
        suite = ET.SubElement(
            root,
            "testsuite",
            name=case.name,
            tests=str(len(case.rows) + bool(case.problem)),
            failures=str(sum(case.counts[state] for state in WRONG)),
            errors=str(int(bool(case.problem))),
            skipped=str(case.counts[NO_REFERENCE] + case.counts[SKIPPED]),
            time=f"{case.seconds:.3f}",
            timestamp=case.date,
        )
        if case.problem:
            test = ET.SubElement(suite, "testcase", classname=case.name, name="the case runs")
            ET.SubElement(test, "error", message=_printable(case.problem))
        for row in case.rows:
            known = row.reference
            test = ET.SubElement(suite, "testcase", classname=case.name, name=known.name)
            text = (
                f"{quantity(row.value, known.unit)}, reference "
                f"{quantity(known.value, known.unit)}, tolerance {band(row)} ({known.standing})"
            )
            if not row.passed:
                ET.SubElement(test, "failure", message=f"{row.state}: {text}")
            elif row.state in (NO_REFERENCE, SKIPPED):
                ET.SubElement(test, "skipped", message=row.state)
            elif known.limitation:
                ET.SubElement(test, "system-out").text = f"known limitation: {known.limitation}"
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _printable(text: str) -> str:
    """Text without the control characters that XML forbids."""
    return "".join(c if c.isprintable() else " " for c in text)


def _replace(path: Path, text: str) -> None:
    """Write a file in one step, so that a reader never sees a part of it."""
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
