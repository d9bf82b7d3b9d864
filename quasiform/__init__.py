"""quasiform: implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.

    import quasiform as qf

    result = qf.solve(qf.off_axis_tension(angle=45, law="locking", displacement=50, size=10))
    result = qf.solve(qf.forming("hemisphere", orientation=45, size=5))
    result.save("out/")

Units are mm, N, MPa and mJ; angles are degrees at this edge.
"""

from .checks import InputError
from .comparison import Comparison, compare
from .console.progress import progress
from .energy.term import Term
from .fabric import Fabric, TabulatedLaw, ThreeStageLaw
from .handover import FlatPattern, Handover, abaqus_deck, export, flat_pattern
from .identification import Identification, identify
from .model import Model
from .net.blank import Blank, rectangle
from .recipe import Recipe
from .result.run import Result
from .scenes.fabric_tests import cantilever, off_axis_tension, picture_frame
from .scenes.forming import forming
from .solve import Journal, Progress, refine, solve, spread
from .tools.shapes import Tool

__all__ = [
    "Blank",
    "Comparison",
    "Fabric",
    "FlatPattern",
    "Handover",
    "Identification",
    "InputError",
    "Journal",
    "Model",
    "Progress",
    "Recipe",
    "Result",
    "TabulatedLaw",
    "Term",
    "ThreeStageLaw",
    "Tool",
    "abaqus_deck",
    "cantilever",
    "compare",
    "export",
    "flat_pattern",
    "forming",
    "identify",
    "off_axis_tension",
    "picture_frame",
    "progress",
    "rectangle",
    "refine",
    "solve",
    "spread",
]
