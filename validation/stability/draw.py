"""The map as a picture and as a report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle

from ..tables import markdown_table
from .cells import Solved, key
from .judge import Bar, Contradiction, Map, errors, is_right
from .scenes import CASES
from .settings import DEFAULT, NOISE, SEEDED, SETTINGS, Cell, Setting, seeds

CODES = {  # the first that is found in the reason
    "is not finite": "C",
    "processor time": "T",
    "not done after": "T",
    "friction does not settle": "F",
    "dynamic relaxation": "R",
    "Newton": "N",
    "descent": "N",
    "singular": "S",
    "tilts": "L",
    "surrounds": "L",
}
MEANING = {
    "N": "Newton's method does not converge",
    "F": "friction does not settle",
    "R": "dynamic relaxation does not converge",
    "S": "the tangent is singular",
    "L": "a loose tool tilts",
    "W": "a wrong end state",
    "X": "refused",
    "T": "over its time limit (hang)",
    "C": "crash",
    "?": "another reason, in map.md",
}
UNCERTIFIED = {  # short names of the reasons; the most serious first
    "negative pivots": "pivots",
    "residual": "residual",
    "collapsed": "collapse",
    "penetration": "depth",
    "energy balance": "energy",
    "no pivots": "no pivots",
    "friction follows": "path",
    "wrinkled": "wrinkled",
    "fibre cuts": "mesh",
    "too coarse": "mesh",
}
SHORT = {
    "default": "default",
    **{f"increment-{mm}": f"increment\n{mm} mm" for mm in (1, 2, 5, 10, 20)},
    "coarse": "coarse\nmesh",
    "fine": "fine\nmesh",
    "contact-0.1": "contact\n× 0.1",
    "contact-10": "contact\n× 10",
    "friction-0": "friction\n0",
    "friction-0.5": "friction\n0.5",
    "exact": "exact\ntangent",
    "convex": "convex\ntangent",
    "relaxation": "relaxation\nalone\n(coarse)",
    "perturbed": "start\n± 0.01 mm",
    "friction-0.5+increment-20": "friction 0.5\nincrement\n20 mm",
    "contact-10+fine": "contact\n× 10,\nfine mesh",
    "perturbed+fine": "start\n± 0.01 mm,\nfine mesh",
}


def describe(setting: Setting) -> str:
    """Differences from the default as text."""
    differing = [
        f"{f.name} {getattr(setting, f.name)}"
        for f in fields(Setting)
        if f.name != "estimate" and getattr(setting, f.name) != getattr(DEFAULT, f.name)
    ]
    return ", ".join(differing) or "default"


def code(solved: Solved) -> str:
    """Letter of the reason why a cell did not reach full travel; empty if it did."""
    if solved.arrived:
        return ""
    if solved.outcome in ("crash", "refused", "completed"):
        return {"crash": "C", "refused": "X", "completed": "W"}[solved.outcome]
    if solved.outcome == "hang":
        return "T"
    return next((letter for part, letter in CODES.items() if part in solved.reason), "?")


def uncertified(solved: Solved) -> str:
    """Short reason why a completed cell is not certified; empty if it is."""
    if solved.certified == "yes" or solved.outcome != "completed":
        return ""
    return next((word for part, word in UNCERTIFIED.items() if part in solved.certified), "other")


def label(solved: Solved) -> str:
    """Lines of text: share of the travel with reason or certificate, and rescues."""
    if solved.outcome == "refused":
        return "refused"
    head = f"{code(solved)} {100 * solved.share:.0f} %".strip()
    lines = [f"{head} ✓" if solved.certified == "yes" else head, uncertified(solved)]
    eased = solved.rescues.get("convex tangent", 0)  # frequent, and hardly a rescue
    rescued = sum(solved.rescues.values()) - eased
    lines.append(" ".join(f"{x}{n}" for x, n in (("c", eased), ("r", rescued)) if n))
    return "\n".join(line for line in lines if line)


def picture(cells: Map, against: Sequence[Contradiction], path: Path) -> None:
    """Draw the heat map.

    The colour (cividis: grey in print, the same to the colour-blind) is the share of the travel;
    cells without the required outcome have a thick frame, contradicted ones a cross.
    """
    rows = [name for name in CASES if any(scene == name for scene, _ in cells)]
    columns = [name for name in SETTINGS if any(setting == name for _, setting in cells)]
    colours = plt.get_cmap("cividis")
    figure, axes = plt.subplots(
        figsize=(2.6 + 0.82 * len(columns), 1.9 + 0.46 * len(rows)), layout="constrained"
    )
    contradicted = {c.cell.cell for c in against}
    for i, scene in enumerate(rows):
        for j, setting in enumerate(columns):
            solved = cells.get((scene, setting))
            if solved is None:
                axes.text(j, i, "·", ha="center", va="center", color="0.6", fontsize=8)
                continue
            refused = solved.outcome == "refused"
            failed = solved.outcome in ("crash", "hang")
            face = "0.85" if refused else "black" if failed else colours(solved.share)
            right = is_right(solved)
            axes.add_patch(
                Rectangle(
                    (j - 0.47, i - 0.46),
                    0.94,
                    0.92,
                    facecolor=face,
                    edgecolor="0.6" if right else "black",
                    linewidth=0.5 if right else 2.5,
                )
            )
            dark = failed or (not refused and solved.share < 0.55)
            text = label(solved) + (" ×" if solved.cell in contradicted else "")
            older = solved.key != key(solved.cell)
            axes.text(
                j,
                i,
                text,
                ha="center",
                va="center",
                fontsize=6.2,
                color="white" if dark else "black",
                style="italic" if older else "normal",
            )
    axes.set_xlim(-0.5, len(columns) - 0.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xticks(range(len(columns)), [SHORT[name] for name in columns], fontsize=7)
    axes.set_yticks(range(len(rows)), [CASES[name].title for name in rows], fontsize=7.5)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    seen = {code(solved) for solved in cells.values()} - {"", "X"}
    legend = "   ".join(f"{letter} {MEANING[letter]}" for letter in MEANING if letter in seen)
    axes.set_xlabel(
        "share of the travel reached; c: convex tangents; r: other rescues; ✓: certified, "
        "else the reason why not; ×: contradicted by another solve;\n"
        f"thick frame: requirement not met; italics: older code; ·: does not apply\n{legend}",
        fontsize=7,
        loc="left",
    )
    scale = plt.cm.ScalarMappable(cmap=colours, norm=plt.Normalize(0, 100))
    bar = figure.colorbar(scale, ax=axes, shrink=0.5, aspect=25, pad=0.01)
    bar.set_label("travel reached, %", fontsize=7)
    bar.ax.tick_params(labelsize=6)
    figure.savefig(path, dpi=160)
    plt.close(figure)


def report(
    cells: Map,
    used: Mapping[Cell, Solved],
    against: Sequence[Contradiction],
    bars: Sequence[Bar],
    minutes: float,
) -> str:
    """Text of map.md."""
    dates = sorted(solved.date for solved in cells.values())
    older = sum(solved.key != key(solved.cell) for solved in cells.values())
    checks = len(used) - len({s.cell for s in cells.values()})
    parts = [
        "# Stability map",
        f"{len(cells)} cells and {checks} solves for checks and other seeds; solved "
        f"{dates[0][:10]} to {dates[-1][:10]}; {minutes:.1f} minutes on two cores; version "
        f"{', '.join(sorted({s.version for s in cells.values()}))}"
        + (f"; **{older} cells are of older sources**" if older else "")
        + ".",
        "![map](map.png)",
        "## Requirements",
        markdown_table(
            ["requirement", "result", ""],
            [[bar.name, bar.found, "met" if bar.met else "**not met**"] for bar in bars],
        ),
        "## Cells without full travel or in a wrong state",
        _not_arrived(cells),
        "## Certificates",
        _certificates(cells),
        "## Contradictions",
        _contradictions(against),
        "## Rescues",
        _rescues(cells),
        "## Robust properties of wrinkled states",
        _wrinkles(used),
        "## Estimated errors of the mesh",
        _errors(cells, used),
    ]
    warned = Counter(w for solved in used.values() for w in solved.warned)
    if warned:
        parts += ["## Warnings", markdown_table(["warning", "cells"], warned.most_common())]
    return "\n\n".join(parts) + "\n"


def _not_arrived(cells: Map) -> str:
    rows = [
        [scene, name, solved.outcome, _reach(solved), solved.reason, _ladder(solved)]
        for (scene, name), solved in cells.items()
        if not solved.arrived and not CASES[scene].refused
    ]
    refused = Counter(s.reason for s in cells.values() if CASES[s.scene].refused and s.reason)
    notes = [f"Refused, as required ({n} cells): {reason}." for reason, n in refused.items()]
    head = ["scene", "setting", "outcome", "reached", "reason", "rescues"]
    return "\n\n".join([markdown_table(head, rows) if rows else "None.", *notes])


def _reach(solved: Solved) -> str:
    return f"{solved.reached:.4g} of {solved.goal:.4g}"


def _ladder(solved: Solved) -> str:
    return ", ".join(f"{rung} {count}" for rung, count in solved.rescues.items()) or "none"


def _certificates(cells: Map) -> str:
    completed = [s for s in cells.values() if s.outcome == "completed"]
    certified = sum(s.certified == "yes" for s in completed)
    rows = [
        [scene, name, solved.certified]
        for (scene, name), solved in cells.items()
        if solved.outcome == "completed" and solved.certified != "yes"
    ]
    text = f"{certified} of {len(completed)} completed cells are certified."
    return f"{text}\n\n{markdown_table(['scene', 'setting', 'why not'], rows)}" if rows else text


def _contradictions(against: Sequence[Contradiction]) -> str:
    if not against:
        return "None."
    rows = [
        [c.cell.scene, describe(c.cell.setting), describe(c.check.setting), str(c)] for c in against
    ]
    return markdown_table(["scene", "cell", "contradicting solve", "worst average"], rows)


def _rescues(cells: Map) -> str:
    total, in_cells = Counter(), Counter()
    for solved in cells.values():
        total.update(solved.rescues)
        in_cells.update(solved.rescues.keys())
    if not total:
        return "None."
    rows = [[rung, in_cells[rung], count] for rung, count in total.most_common()]
    return markdown_table(["rung", "cells", "times"], rows)


def _wrinkles(used: Mapping[Cell, Solved]) -> str:
    parts = [
        f"The same scene from starts perturbed by ± {NOISE:g} mm, one seed each, and the "
        "unperturbed one. Wavelength and envelope are read along one line of the flat sheet "
        "(`scenes.waves`). The spread is the largest minus the smallest value over the seeds."
    ]
    for scene in SEEDED:
        perturbed = [used[cell] for cell in seeds([scene]) if cell in used]
        perturbed = [solved for solved in perturbed if solved.outcome == "completed"]
        default = used.get(Cell(scene, DEFAULT))
        if not perturbed:
            continue
        rows = []
        for name in [*perturbed[0].averages, *perturbed[0].waves, "force_N"]:
            values = [
                (solved.averages | solved.waves | {"force_N": solved.force}).get(name)
                for solved in perturbed
            ]
            values = [value for value in values if value is not None]
            if not values or name in [row[0] for row in rows]:
                continue
            plain = default and (default.averages | default.waves | {"force_N": default.force}).get(
                name
            )
            mean, spread = np.mean(values), np.ptp(values)
            relative = f"{100 * spread / abs(mean):.2g} %" if mean else "–"
            rows.append(
                [
                    name,
                    f"{plain:.4g}" if plain is not None else "–",
                    f"{mean:.4g}",
                    f"{spread:.2g}",
                    relative,
                    len(values),
                ]
            )
        head = ["quantity", "unperturbed", "mean", "spread", "of the mean", "seeds"]
        certified = sum(solved.certified == "yes" for solved in perturbed)
        parts.append(
            f"**{CASES[scene].title}**: {certified} of {len(perturbed)} certified\n\n"
            f"{markdown_table(head, rows)}"
        )
    return "\n\n".join(parts)


def _errors(cells: Map, used: Mapping[Cell, Solved]) -> str:
    rows = []
    for scene in dict.fromkeys(scene for scene, _ in cells):
        for (size, name), (error, origin) in sorted(errors(scene, used).items()):
            rows.append([scene, size, name, f"{error:.3g}", origin])
    return markdown_table(["scene", "size", "average", "error", "from"], rows)
