"""One contender in a process of its own: `python -m validation.peers.once MODULE FUNCTION JSON`.

Nothing is imported here but the module of the peer, which imports its code where it uses it, so
that no code pays for another's start.
"""

import importlib
import json
import sys

from .contest import printed

if __name__ == "__main__":
    module, function, arguments = sys.argv[1:]
    solve = getattr(importlib.import_module(f"validation.peers.{module}"), function)
    print(printed(solve(**json.loads(arguments))))
