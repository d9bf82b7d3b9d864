"""quasiform: implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.

    import quasiform as qf

    result = qf.solve(qf.off_axis_tension(angle=45, law="locking", displacement=50, size=10))
    result = qf.solve(qf.forming("hemisphere", orientation=45, size=5))
    result.save("out/")

Units are mm, N, MPa and mJ; angles are degrees at this edge.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .checks import InputError
    from .comparison import Comparison, compare
    from .console.progress import progress
    from .energy.term import Term
    from .fabric import Fabric, MomentCurve, Slip, TabulatedLaw, ThreeStageLaw
    from .handover import FlatPattern, Handover, abaqus_deck, export, flat_pattern, ply_book
    from .identification import Identification, identify
    from .model import Model
    from .net.blank import Blank, rectangle
    from .recipe import Recipe
    from .result.run import Result
    from .scenes.fabric_tests import cantilever, off_axis_tension, picture_frame
    from .scenes.forming import forming
    from .solve import Journal, Progress, refine, solve, spread
    from .studies import StudyProgress, study
    from .tools.shapes import Tool

_MODULES = {  # where each public name is; its module is imported when the name is first used
    "Blank": "net.blank",
    "Comparison": "comparison",
    "Fabric": "fabric",
    "FlatPattern": "handover",
    "Handover": "handover",
    "Identification": "identification",
    "InputError": "checks",
    "Journal": "solve",
    "Model": "model",
    "MomentCurve": "fabric",
    "Progress": "solve",
    "Recipe": "recipe",
    "Result": "result.run",
    "Slip": "fabric",
    "StudyProgress": "studies",
    "TabulatedLaw": "fabric",
    "Term": "energy.term",
    "ThreeStageLaw": "fabric",
    "Tool": "tools.shapes",
    "abaqus_deck": "handover",
    "cantilever": "scenes.fabric_tests",
    "compare": "comparison",
    "export": "handover",
    "flat_pattern": "handover",
    "ply_book": "handover",
    "forming": "scenes.forming",
    "identify": "identification",
    "off_axis_tension": "scenes.fabric_tests",
    "picture_frame": "scenes.fabric_tests",
    "progress": "console.progress",
    "rectangle": "net.blank",
    "refine": "solve",
    "solve": "solve",
    "spread": "solve",
    "study": "studies",
}
__all__ = list(_MODULES)


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _import_module(f".{_MODULES[name]}", __name__)
    # the package `solve` is called like its function, whose place it would take when imported
    value = globals()[name] = module if name == "solve" else getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
