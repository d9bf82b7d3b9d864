"""Where the factorisations of a full path are spent, for the six scenes, whole and reduced."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import quasiform as qf
from quasiform.solve.increments import follow
from quasiform.solve.run import Settings

from ..tables import markdown_table

SCENES = [(name, angle) for name in ("hemisphere", "tetrahedron", "box") for angle in (0.0, 45.0)]
SIZE = 5.0  # mm
PURPOSES = ("prediction", "balance", "friction", "saddle", "check", "rescue", "refused")


def table(out: Path, scenes: Sequence[str] = ()) -> str:
    """A Markdown table with a row a run; written to `out` after each of them.

    `scenes` are names such as "hemisphere"; all by default.
    """
    rows: list[list[str]] = []
    for name, angle in SCENES:
        if scenes and name not in scenes:
            continue
        for symmetry, modelled in (("auto", "reduced"), ("none", "whole")):
            model = qf.forming(name, angle, size=SIZE, symmetry=symmetry)
            if symmetry == "none" and model.share == 1.0 and rows and rows[-1][1] == "whole":
                continue
            reduced = "whole" if model.share == 1.0 else modelled
            result = follow(model, Settings())
            rows.append([f"{name} {angle:g}°", reduced, *_cells(result)])
            out.write_text(_shown(rows), encoding="utf-8")
            print(" | ".join(rows[-1]), flush=True)
    return _shown(rows)


def _cells(result: qf.Result) -> list[str]:
    counts = result.purposes
    by_purpose = []
    for purpose in PURPOSES:
        exact, convex = counts.get(purpose, 0), counts.get(f"{purpose}, convex", 0)
        by_purpose.append(f"{exact} + {convex}" if convex else f"{exact}")
    end = result.reason or ("balanced" if result.negative_pivots == 0 else "a saddle")
    numbers = [str(int((~result.model.fixed).sum())), str(result.increments), *by_purpose]
    return [*numbers, str(result.linear_solves), f"{result.force:.2f}", f"{result.wall_s:.0f}", end]


def _shown(rows: list[list[str]]) -> str:
    head = ["scene", "modelled", "unknowns", "increments", *PURPOSES, "all", "force N", "s", "end"]
    return (
        f"Factorisations of a full path, size {SIZE:g} mm: with the exact tangent + with the "
        f"convex one.\n\n{markdown_table(head, rows)}\n"
    )
