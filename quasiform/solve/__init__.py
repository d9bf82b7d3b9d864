"""From a scene to its result: increments, levels, Newton, relaxation, linear solvers.

The package is called like its function `solve`, so that `quasiform.solve(model)` and
`import quasiform.solve.newton` both work, whichever comes first.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

from .increments import Progress
from .journal import Journal
from .levels import refine, solve
from .scatter import spread

__all__ = ["Journal", "Progress", "refine", "solve", "spread"]
__wrapped__ = solve  # its signature, for `inspect.signature(quasiform.solve)`


class _Callable(ModuleType):
    """Importing `quasiform.solve.newton` puts this module in the place of the function."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        return solve(*given, **named)

    def __reduce__(self) -> tuple[Any, ...]:  # a module is pickled by its name
        return import_module, (self.__name__,)


sys.modules[__name__].__class__ = _Callable
