"""A result handed over: fibre directions for a structural analysis, a deck, a flat pattern.

    handed = qf.export("out/", "calculix", "handover/")
    handed = qf.export(result, "abaqus", "handover/", mesh="structure.inp")
    notices = qf.abaqus_deck(scene, "scene.inp")
    pattern = qf.flat_pattern("out/", "trim.csv")
    pattern.save("pattern/")
    book = qf.ply_book("out/", "book/")

What a format or the model cannot carry is in `notices`, and in a file beside the others.

One file an idea: `fibres` (directions by element), `keywords`, `inp`,
`drape`, `table` and `layup` (their files), `deck`, `tool_surface`, `pattern`, `drawing`, `book`.
"""

from .book import ply_book
from .deck import abaqus_deck
from .fibres import Fibres, carry, read_formed
from .handover import FORMATS, Handover, export
from .pattern import FlatPattern, flat_pattern

__all__ = [
    "FORMATS",
    "Fibres",
    "FlatPattern",
    "Handover",
    "abaqus_deck",
    "carry",
    "export",
    "flat_pattern",
    "ply_book",
    "read_formed",
]
