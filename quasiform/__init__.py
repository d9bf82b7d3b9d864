"""quasiform: implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.

    import quasiform as qf

    result = qf.solve(qf.off_axis_tension(angle=45, law="locking", displacement=50, size=10))
    result = qf.solve(qf.forming("hemisphere", orientation=45, size=5))
    result.save("out/")

Units are mm, N, MPa and mJ; angles are degrees at this edge.
"""

from .blank import Blank, rectangle
from .checks import InputError
from .compare import Comparison, compare
from .experiments import cantilever, off_axis_tension, picture_frame
from .export import FlatPattern, Handover, abaqus_deck, export, flat_pattern
from .forming import forming
from .identification import Identification, identify
from .material import Fabric, TabulatedLaw, ThreeStageLaw
from .progress import progress
from .result import Result
from .scene import Scene
from .solve import Journal, Progress, refine, solve, spread
from .tool import Tool

__all__ = [
    "Blank",
    "Comparison",
    "Fabric",
    "FlatPattern",
    "Handover",
    "Identification",
    "InputError",
    "Journal",
    "Progress",
    "Result",
    "Scene",
    "TabulatedLaw",
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
