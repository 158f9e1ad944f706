"""`python -m jaxlens`: the command line, where the `jaxlens` script is not on the path."""

import sys

from jaxlens.cli import main

if __name__ == "__main__":
    sys.exit(main())
