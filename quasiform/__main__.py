"""The command line as `python -m quasiform`."""

import sys

from .console.cli import main

if __name__ == "__main__":
    sys.exit(main())
