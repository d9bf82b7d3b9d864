"""From a scene to its result: increments, Newton, relaxation, linear solvers."""

from .increments import Progress, solve

__all__ = ["Progress", "solve"]
