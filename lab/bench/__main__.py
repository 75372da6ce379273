"""Runs one benchmark of the laboratory or of the house: `python -m lab.bench NAME ...`."""

import sys

from tests.bench.__main__ import main

PACKAGES = ("lab.bench", "tests.bench")

if __name__ == "__main__":
    sys.exit(main(packages=PACKAGES))
