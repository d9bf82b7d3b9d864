"""Profiles of the property-based tests: `--hypothesis-profile=thorough` for all of their cases."""

from hypothesis import HealthCheck, settings

COMMON = {
    "derandomize": True,  # the same cases at every run
    "database": None,
    "deadline": None,  # the tests have a limit of their own, which also ends what hangs
    "suppress_health_check": list(HealthCheck),
}
settings.register_profile("part", max_examples=40, **COMMON)
settings.register_profile("thorough", max_examples=250, **COMMON)
settings.load_profile("part")
