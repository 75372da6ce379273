"""`gsut bench`: speed beside error, on this machine."""

from __future__ import annotations

import argparse

from gsut.bench.arguments import add_bench

HELP = "speed against error, on this machine"
DESCRIPTION = (
    "Measures speed and, beside it, error: against a double-precision reference, against the "
    "truth, never speed alone."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_bench(parser)
