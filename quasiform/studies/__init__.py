"""Studies: many runs of one case, on one machine or many."""

from .plan import Plan, plan
from .study import StudyProgress, study

__all__ = ["Plan", "StudyProgress", "plan", "study"]
