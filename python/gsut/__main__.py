"""`python -m gsut`: the same as the command `gsut`."""

import sys

from gsut.cli import main

if __name__ == "__main__":
    sys.exit(main())
