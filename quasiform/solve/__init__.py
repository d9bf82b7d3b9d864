"""From a scene to its result: increments, levels, Newton, relaxation, linear solvers."""

from .increments import Progress, solve
from .levels import refine

__all__ = ["Progress", "refine", "solve"]
