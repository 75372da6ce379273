"""Renews the marked tables of docs: `lab/run figures [NAME ...]`.

A table stands between `<!-- table: NAME FLAGS -->` and `<!-- end -->`. It is written by the
benchmark of that name with these flags, among them --columns. Each row has the letter of its
origin: commit, date and machine. Rows that are not measured this time, since their data or program
is not here, stay with theirs.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import shlex
import string
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gsut._core import InputError, active_isa
from gsut.cli import Parser, run_command
from gsut.files import write_file
from lab.bench.__main__ import PACKAGES
from tests.bench.__main__ import build_parser as build_bench_parser
from tests.bench.__main__ import find_benchmarks, load_benchmark
from tests.bench.harness import Column, Row, choose_columns

ROOT = Path(__file__).resolve().parents[2]
ORIGIN = "Origin"  # heading of the letters
_TABLE = re.compile(r"<!-- table: (\S+)(.*?) -->\n(.*?)<!-- end -->", re.DOTALL)
_ORIGINS = re.compile(r"\b([a-z]): (commit [^;\n]+?)(?:;|\.\n|\.$)")


class Table(NamedTuple):
    """A marked table: its place in the page's text, its benchmark, flags and text."""

    page: Path
    begin: int
    end: int
    name: str
    flags: list[str]
    text: str

    @property
    def columns(self) -> tuple[Column, ...]:
        """The benchmark's columns that its flags choose."""
        benchmark = load_benchmark(self.name, PACKAGES)
        assert benchmark is not None
        parsed = build_bench_parser([self.name], PACKAGES).parse_args([self.name, *self.flags])
        return choose_columns(benchmark, parsed.columns)


def find_tables() -> Iterator[Table]:
    """Finds the marked tables of all pages."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for found in _TABLE.finditer(page.read_text()):
            flags = shlex.split(found[2])
            yield Table(page, found.start(3), found.end(3), found[1], flags, found[3])


def read_rows(text: str) -> list[dict[str, str]]:
    """Reads a Markdown table: heading -> cell of each row, the origin in words."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    origins = dict(_ORIGINS.findall(text))
    rows = [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]
    return [row | {ORIGIN: origins.get(row.get(ORIGIN, ""), "unknown")} for row in rows]


def renew_table(table: Table, rows: Sequence[Row], origin: str) -> str:
    """Writes a table from measured rows; then come rows of the old one that were not measured."""
    columns = table.columns
    names = [column.heading for column in columns if not column.form]
    new = [
        {column.heading: column.show(row).replace("|", "\\|") for column in columns}
        | {ORIGIN: origin}
        for row in rows
    ]
    kept = {tuple(row.get(name, "") for name in names): row for row in read_rows(table.text)}
    measured = {tuple(row[name] for name in names): row for row in new}
    merged = list((measured | {key: kept[key] for key in kept if key not in measured}).values())
    origins = list(dict.fromkeys(row[ORIGIN] for row in merged))
    letters = dict(zip(origins, string.ascii_lowercase, strict=False))
    headings = [*(column.heading for column in columns), ORIGIN]
    lines = [f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    for row in merged:
        cells = [row.get(heading, "-") for heading in headings[:-1]]
        lines.append(f"| {' | '.join([*cells, letters[row[ORIGIN]]])} |")
    legend = "; ".join(f"{letter}: {text}" for text, letter in letters.items())
    return "\n".join([*lines, "", f"`{describe_command(table)}`; {legend}.", ""])


def describe_command(table: Table) -> str:
    """Returns the command that measures a table, without the choice of its columns."""
    flags = list(table.flags)
    if "--columns" in flags:
        place = flags.index("--columns")
        del flags[place : place + 2]
    program = "./run" if table.name in find_benchmarks() else "lab/run"
    return shlex.join([program, "bench", table.name, *flags])


def describe_origin() -> str:
    """Describes commit, date and machine."""

    def ask_git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
        return done.stdout.strip()

    changed = ask_git("status", "--porcelain", "--untracked-files=no", "--", "cpp", "python")
    commit = f"{ask_git('rev-parse', '--short=8', 'HEAD')}{' with changes' if changed else ''}"
    model = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text())
    machine = f"{os.cpu_count()} cores of {model[1] if model else 'an unknown processor'}"
    return f"commit {commit}, {datetime.date.today()}, {machine}, {active_isa()}"


def measure_table(table: Table, further: Sequence[str]) -> list[Row]:
    """Runs the table's benchmark in a process of its own, with further flags.

    Raises:
        InputError: it fails.
    """
    with tempfile.TemporaryDirectory(prefix="gsut-figures-") as folder:
        file = Path(folder) / "rows.json"
        words = [table.name, *table.flags, "--json", str(file), *further]
        done = subprocess.run([sys.executable, "-m", "lab.bench", *words], cwd=ROOT, check=False)
        if not file.is_file():
            raise InputError(f"{describe_command(table)} ended with {done.returncode}")
        return json.loads(file.read_text())


def build_parser(_: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Builds the parser of `lab/run figures`."""
    parser = Parser(prog="lab/run figures", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="benchmarks [default: all shown]")
    parser.add_argument(
        "--data", metavar="FOLDER", default=os.environ.get("GSUT_DATA"),
        help="folder that holds datasets by name [default: GSUT_DATA]",
    )  # fmt: skip
    parser.add_argument(
        "--pycolmap", metavar="PYTHON",
        help="a Python that has pycolmap, for its rows; without it they stay as they are",
    )  # fmt: skip
    parser.set_defaults(run=run)
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Renews the tables of the named benchmarks, each as soon as it is measured."""
    shown = [table.name for table in find_tables()]
    unknown = [name for name in arguments.names if name not in shown]
    if unknown:
        kind = "shown in no page" if unknown[0] in find_benchmarks(PACKAGES) else "unknown"
        raise InputError(
            f"benchmark {unknown[0]!r} is {kind}; shown: {', '.join(sorted(set(shown)))}"
        )
    for number, name in enumerate(shown):
        if arguments.names and name not in arguments.names:
            continue
        table = list(find_tables())[number]
        further = ["--data", arguments.data] if arguments.data else []
        if "pycolmap" in table.flags:
            if not arguments.pycolmap:
                print(f"{table.page.name}: rows of pycolmap stay, without --pycolmap", flush=True)
                continue
            further += ["--pycolmap", arguments.pycolmap]
        print(f"{table.page.name}: {describe_command(table)}", flush=True)
        origin, rows = describe_origin(), measure_table(table, further)
        table = list(find_tables())[number]  # the page may have changed while it was measured
        text = table.page.read_text()
        new = renew_table(table, rows, origin)
        write_file(table.page, text[: table.begin] + new + text[table.end :])
    return 0


if __name__ == "__main__":
    sys.exit(run_command(build_parser))
