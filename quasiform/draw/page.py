"""A result on one page, HTML and PDF, for somebody who did not run it.

What was formed, whether it converged, what limits the trust in it, its key numbers with their
errors, three pictures, and what was assumed.
"""

from __future__ import annotations

import base64
import re
import textwrap
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.image import imread

from ..checks import InputError, number
from ..result.certificate import spoken
from ..result.files import writing_to
from ..result.record import Record
from . import plot

TEMPLATE = Path(__file__).with_suffix(".html")
A4 = 8.27, 11.69  # inches
PICTURES = {  # what each shows
    "shear_angle": "Shear angle: the change of the right angle between warp and weft",
    "history": "Along the travel",
    "doubt": "Where the shear angle has limits, and what to do",
}


def save(run: Record, path: str | Path) -> list[Path]:
    """Write the page as HTML to `path`, and as PDF beside it; returns both."""
    try:
        from jinja2 import Environment
    except ImportError as error:
        raise InputError("the page needs jinja2: pip install 'quasiform[report]'") from error

    path, found = Path(path), contents(run)
    page = Environment(autoescape=True).from_string(TEMPLATE.read_text(encoding="utf-8"))
    pictures = _pictures(run)
    shown = {
        caption: base64.b64encode(pictures[name]).decode() for name, caption in PICTURES.items()
    }
    with writing_to(path):
        path.write_text(page.render(**found, pictures=shown), encoding="utf-8")
    pdf = path.with_suffix(".pdf")
    with writing_to(pdf):
        _on_paper(found, pictures).savefig(pdf, metadata={"CreationDate": None})
    return [path, pdf]


def contents(run: Record) -> dict[str, Any]:
    """Texts of the page."""
    summary, (travel, _, unit) = run.summary, plot.words_of(run)
    errors = summary.get("estimated_errors") or {}
    converged = summary["certificate"]["converged"]
    size = summary.get("path_size_mm")
    how, whole = f"{summary['triangles']} triangles", len(run.sheet.triangles)
    how += f", mirrored to {whole}" if whole != summary["triangles"] else ""
    how += f", path on a {size:g} mm mesh" if size else ""
    return {
        "title": ", ".join(filter(None, (run.case, run.ply_name, run.fabric_name))),
        "what": f"Computed by quasiform {summary.get('version', '')} on {how}: {travel} "
        f"{number(run.travel)}{' mm' * (unit == 'N')} of {number(run.goal)}.",
        "converged": "Converged" if converged else "Not converged",
        "meaning": "it is a stable equilibrium"
        if converged
        else "it is not a stable equilibrium; do not use its numbers",
        "limits": run.limits,
        "rows": [
            (name, number(value), "" if error is None else f"± {number(error, 2)}", unit)
            for name, value, error, unit in _numbers(summary, errors)
        ],
        "assumed": summary.get("assumed") or [],
        "model": summary.get("model") or [],
    }


def _numbers(
    summary: dict[str, Any], errors: dict[str, float | None]
) -> list[tuple[str, float, float | None, str]]:
    """Name, value, error of the mesh and unit of the key numbers."""
    force = "force_N" if "force_N" in summary else "load_work_mJ"
    gamma = summary["shear_angle_deg"]
    found = [
        (spoken(force), summary[force], force, force.rpartition("_")[2]),
        ("shear angle, 99 % of the area is below", gamma["p99"], "shear_angle_deg", "°"),
        ("largest shear angle, in one triangle", gamma["max"], "", "°"),
        ("mean shear angle", gamma["mean"], "shear_angle_mean_deg", "°"),
    ]
    for key, form, unit in (("draw_in_mm", "draw_in_{}_mm", "mm"), ("areas", "area_{}_deg", "°")):
        for name, value in (summary.get(key) or {}).items():
            if value is not None:
                found.append((spoken(form.format(name)), value, form.format(name), unit))
    return [
        (re.sub(" -(?=[xy]$)", " −", name.removeprefix("the ")), value, errors.get(error), unit)
        for name, value, error, unit in found
    ]


def _pictures(run: Record) -> dict[str, bytes]:
    """PNG of each picture."""
    found = {}
    with plot.page_style():
        for name, picture in plot.FIGURES.items():
            drawn = picture(run)
            drawn.suptitle("")  # the page says it once
            drawn.savefig(content := BytesIO(), dpi=plot.DPI)
            found[name] = content.getvalue()
    return found


def _on_paper(found: dict[str, Any], pictures: dict[str, bytes]) -> Figure:
    """The page as a figure of A4 size."""
    with plot.page_style():
        page = Figure(figsize=A4)
        look = {"va": "top", "parse_math": False}
        page.text(0.07, 0.965, found["title"], size=15, weight="bold", **look)
        page.text(0.07, 0.94, textwrap.fill(found["what"], 110), size=8.5, **look)
        limits = found["limits"] or ["no limit was found"]
        lines = [
            f"{found['converged']}: {found['meaning']}.",
            "Limits of the trust in its numbers:",
        ]
        lines += [textwrap.fill(f"– {limit}", 112) for limit in limits]
        words = "\n".join(lines)
        box = {"facecolor": "#f2f2f2", "edgecolor": "0.6", "boxstyle": "square,pad=0.6"}
        page.text(0.08, 0.915, words, size=8.5, bbox=box, linespacing=1.4, **look)
        top = 0.885 - 0.0165 * (words.count("\n") + 1)
        cells = [(name, f"{value} {error} {unit}") for name, value, error, unit in found["rows"]]
        half = -(-len(cells) // 2)
        for left, part in ((0.07, cells[:half]), (0.53, cells[half:])):
            for k, (name, value) in enumerate(part):
                page.text(left, top - 0.0155 * k, textwrap.shorten(name, 44), size=8, **look)
                page.text(left + 0.4, top - 0.0155 * k, value, size=8, ha="right", **look)
        top -= 0.0155 * half + 0.01
        assumed = f"Assumed, not measured: {', '.join(found['assumed']) or 'nothing'}."
        upper, lower = 0.6 * (top - 0.075), 0.4 * (top - 0.075)
        below = top - upper
        places = (0.07, top, 0.86, upper), (0.07, below, 0.42, lower), (0.51, below, 0.42, lower)
        for (name, caption), (left, y, wide, high) in zip(PICTURES.items(), places, strict=True):
            axes = page.add_axes((left, y - high, wide, high - 0.022), anchor="N")
            axes.imshow(imread(BytesIO(pictures[name])), interpolation="lanczos")
            axes.axis("off")
            page.text(left, y - 0.004, caption, size=8.5, weight="bold", **look)
        page.text(0.07, 0.065, textwrap.fill(assumed, 125), size=7.5, **look)
    return page
