"""`python -m tests.bench NAME ...`: finds the benchmarks, files NAME_bench.py here; runs one.

A benchmark has HELP (its line in --help, the whole of it in its own), `add_flags(parser)` and
`run(arguments) -> exit status`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gsut.cli import Parser, add_commands, run_command

_ENDING = "_bench"


def build_parser(_: Sequence[str] = ()) -> argparse.ArgumentParser:
    """The parser of all benchmarks."""
    files = sorted(Path(__file__).parent.glob(f"*{_ENDING}.py"))
    modules = {file.stem.removesuffix(_ENDING): f"tests.bench.{file.stem}" for file in files}
    parser = Parser(prog="tests.bench", description="Measures speed and, beside it, error.")
    add_commands(parser, modules, "benchmarks", "BENCHMARK")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one benchmark; exit status and errors as of `gsut`."""
    return run_command(build_parser, arguments)


if __name__ == "__main__":
    sys.exit(main())
