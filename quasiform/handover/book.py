"""A ply book: an HTML file to print, a page a ply with its flat pattern, fibre direction and order.

The drawings are to scale on paper (print at 100 %), with a bar to check it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..result.files import replaced
from ..result.summary import package_version
from .drawing import svg
from .fibres import read_formed
from .keywords import render
from .pattern import FlatPattern, Line, flat_pattern

if TYPE_CHECKING:
    from ..result.record import Record
    from ..result.run import Result

FILE = "ply_book.html"
WIDTH, HEIGHT, ROW = 182.0, 200.0, 6.0  # mm on a page of A4: for drawing and table; a row of it


@dataclass(frozen=True)
class Page:
    """A ply of the scene; joined ones have the pattern of their sheet."""

    number: int
    joined: bool  # to the ply above it
    fabric: str
    orientation: float  # of the warp from x, degrees
    thickness: float  # mm
    area: float  # inside the lines to cut, cm²
    weight: float  # g
    pattern: FlatPattern


def ply_book(
    source: Result | Record | str | Path,
    out: str | Path,
    trim: Line = "edge",
    *,
    within: float | None = None,
    scale: float = 1.0,
    force: bool = False,
) -> Path:
    """Write an HTML file to print, a page a ply: flat pattern, fibre direction, order, weight.

    Parameters
    ----------
    source : Result, Record or path
        A run, or the folder of one.
    out : path
        Folder for `ply_book.html`; made if missing.
    trim, within, scale : optional
        The line to cut along, how far off the sheet it may lie, mm, and its unit, mm, as for
        `flat_pattern`.
    force : bool
        Whether to replace an earlier book.

    Returns
    -------
    path
        Of the file.

    Raises
    ------
    InputError
        As `flat_pattern` does, and for a folder that holds a book.
    """
    record = read_formed(source)
    pages = [
        page
        for ply in record.plies
        for page in _pages(ply, flat_pattern(ply, trim, within=within, scale=scale))
    ]
    with replaced(out, force=force, names=(FILE,)) as folder:
        (folder / FILE).write_text(_text(record.case, pages), encoding="utf-8")
    return Path(out) / FILE


def _pages(ply: Record, pattern: FlatPattern) -> list[Page]:
    """Pages of a sheet: one, or of joined plies one each."""
    layer, fabric = ply.layer, ply.fabric
    numbers = layer.get("plies") or [1]
    turn = layer.get("orientation", ply.parameters.get("orientation", 0.0))
    each, area = 1.0 / len(numbers), pattern.area
    own = fabric.get("name", ""), turn, each * fabric["thickness"], 1e-2 * area
    weight = each * fabric["areal_weight"] * 1e-6 * area
    return [Page(k, k > numbers[0], *own, weight, pattern) for k in numbers]


def _text(case: str, pages: Sequence[Page]) -> str:
    room = WIDTH, HEIGHT - ROW * len(pages)
    drawings = [svg(page.pattern, room) for page in pages]
    given: dict[str, Any] = {"case": case, "pages": pages, "drawings": drawings}
    return render("ply_book.html", **given, version=package_version())
