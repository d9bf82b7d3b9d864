"""One thread for linear algebra; `--hypothesis-profile=thorough` for all property-based cases."""

import os

from hypothesis import HealthCheck, settings

for _library in ("OMP", "OPENBLAS", "MKL"):  # small matrices: a second thread only waits, and is
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")  # waited for on a busy machine

COMMON = {
    "derandomize": True,  # the same cases at every run
    "database": None,
    "deadline": None,  # the tests have a limit of their own, which also ends what hangs
    "suppress_health_check": list(HealthCheck),
}
settings.register_profile("part", max_examples=40, **COMMON)
settings.register_profile("thorough", max_examples=250, **COMMON)
settings.load_profile("part")
