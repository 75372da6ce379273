"""Runs one benchmark by its name: `python -m tests.bench NAME ...`."""

from __future__ import annotations

import argparse
import functools
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from gsut.cli import Parser, run_command
from tests.bench.harness import Benchmark, add_flags, run_benchmark

_ENDING = "_bench"


def find_benchmarks() -> list[str]:
    """Lists the names of the files NAME_bench.py here."""
    files = sorted(Path(__file__).parent.glob(f"*{_ENDING}.py"))
    return [file.stem.removesuffix(_ENDING) for file in files]


def load_benchmark(name: str) -> Benchmark | None:
    """Imports a benchmark by its name; None for one that has a command of its own."""
    return getattr(_load_file(name), "BENCHMARK", None)


def _load_file(name: str) -> ModuleType:
    return importlib.import_module(f"tests.bench.{name}{_ENDING}")


def build_parser(words: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Builds the parser of all benchmarks, or of the one that is named first."""
    names = find_benchmarks()
    parser = Parser(prog="tests.bench", description="Measures speed and, beside it, error.")
    commands = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    for name in [word for word in words[:1] if word in names] or names:
        benchmark = load_benchmark(name)
        if benchmark is None:  # it watches a command: HELP, add_flags(parser), run(arguments)
            file = _load_file(name)
            command = commands.add_parser(name, help=file.HELP, description=file.HELP)
            file.add_flags(command)
            command.set_defaults(run=file.run)
            continue
        command = commands.add_parser(name, help=benchmark.help, description=benchmark.help)
        add_flags(command, benchmark)
        command.set_defaults(run=functools.partial(run_benchmark, name, benchmark))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one benchmark; exit status and errors as of `gsut`."""
    return run_command(build_parser, arguments)


if __name__ == "__main__":
    sys.exit(main())
