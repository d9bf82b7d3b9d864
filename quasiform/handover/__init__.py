"""A result handed over: fibre directions for a structural analysis, a deck, a flat pattern.

    handed = qf.export("out/", "calculix", "handover/")
    handed = qf.export(result, "abaqus", "handover/", mesh="structure.inp")
    notices = qf.abaqus_deck(scene, "scene.inp")
    pattern = qf.flat_pattern("out/", "trim.csv")
    pattern.save("pattern/")

What a format or the model cannot carry is told in `notices`, and in a file beside the others.

One file an idea: `part` (the formed sheet with its fibres), `target` (the user's mesh), `fibres`
(directions by element), `inp`, `drape`, `table` (their files), `deck`, `tool_surface`, `pattern`,
`drawing`.
"""

from .deck import abaqus_deck
from .fibres import Fibres, carry
from .handover import FORMATS, Handover, export
from .part import Part, part_of
from .pattern import FlatPattern, flat_pattern

__all__ = [
    "FORMATS",
    "Fibres",
    "FlatPattern",
    "Handover",
    "Part",
    "abaqus_deck",
    "carry",
    "export",
    "flat_pattern",
    "part_of",
]
