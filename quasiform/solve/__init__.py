"""From a scene to its result: increments, levels, Newton, relaxation, linear solvers."""

from .increments import Progress, solve
from .journal import Journal
from .levels import refine
from .spread import spread

__all__ = ["Journal", "Progress", "refine", "solve", "spread"]
