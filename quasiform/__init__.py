"""quasiform: implicit, quasi-static forming of dry 0°/90° biaxial non-crimp fabrics.

    import quasiform as qf

    result = qf.solve(qf.off_axis_tension(angle=45, law="locking", displacement=50, size=10))
    result = qf.solve(qf.forming("hemisphere", orientation=45, size=5))
    result.save("out/")

Units are mm, N, MPa and mJ; angles are degrees at this edge.
"""

from .blank import Blank, rectangle
from .checks import InputError
from .experiments import cantilever, off_axis_tension, picture_frame
from .forming import forming
from .material import Fabric, ThreeStageLaw
from .progress import progress
from .result import Result
from .scene import Scene
from .solve import Progress, solve
from .tool import Tool

__all__ = [
    "Blank",
    "Fabric",
    "InputError",
    "Progress",
    "Result",
    "Scene",
    "ThreeStageLaw",
    "Tool",
    "cantilever",
    "forming",
    "off_axis_tension",
    "picture_frame",
    "progress",
    "rectangle",
    "solve",
]
