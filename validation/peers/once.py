"""One contender in its own process: `python -m validation.peers.once MODULE FUNCTION JSON`.

Only the module of the peer is imported here. It imports its code where it is used, so that the
process time of one code does not include the start of another.
"""

import importlib
import json
import sys

from .contest import printed

if __name__ == "__main__":
    module, function, arguments = sys.argv[1:]
    solve = getattr(importlib.import_module(f"validation.peers.{module}"), function)
    print(printed(solve(**json.loads(arguments))))
