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

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("tests.bench",)
_ENDING = "_bench"


def find_benchmarks(packages: Sequence[str] = PACKAGES) -> dict[str, str]:
    """Maps the NAME of each file NAME_bench.py of these packages to its package, sorted."""
    found = {
        file.stem.removesuffix(_ENDING): package
        for package in packages
        for file in (ROOT / package.replace(".", "/")).glob(f"*{_ENDING}.py")
    }
    return dict(sorted(found.items()))


def load_benchmark(name: str, packages: Sequence[str] = PACKAGES) -> Benchmark | None:
    """Imports a benchmark by its name; None for one that has a command of its own."""
    return getattr(_load_file(name, packages), "BENCHMARK", None)


def _load_file(name: str, packages: Sequence[str]) -> ModuleType:
    return importlib.import_module(f"{find_benchmarks(packages)[name]}.{name}{_ENDING}")


def build_parser(
    words: Sequence[str] = (), packages: Sequence[str] = PACKAGES
) -> argparse.ArgumentParser:
    """Builds the parser of all benchmarks, or of the one that is named first."""
    names = find_benchmarks(packages)
    parser = Parser(prog=packages[0], description="Measures speed and, beside it, error.")
    commands = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    for name in [word for word in words[:1] if word in names] or names:
        benchmark = load_benchmark(name, packages)
        if benchmark is None:  # it watches a command: HELP, add_flags(parser), run(arguments)
            file = _load_file(name, packages)
            command = commands.add_parser(name, help=file.HELP, description=file.HELP)
            file.add_flags(command)
            command.set_defaults(run=file.run)
            continue
        command = commands.add_parser(name, help=benchmark.help, description=benchmark.help)
        add_flags(command, benchmark)
        command.set_defaults(run=functools.partial(run_benchmark, packages[0], name, benchmark))
    return parser


def main(arguments: Sequence[str] | None = None, packages: Sequence[str] = PACKAGES) -> int:
    """Runs one benchmark; exit status and errors as of `gsut`."""
    return run_command(functools.partial(build_parser, packages=packages), arguments)


if __name__ == "__main__":
    sys.exit(main())
