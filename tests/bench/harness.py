"""Runs a benchmark: flags, data, choice of rows, repeats, two versions by turns, tables and files.

A benchmark is a file NAME_bench.py with a BENCHMARK: its columns, its cases and one function that
measures a case. Everything else is here; README.md shows how to add one.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import gsut
from gsut import _core
from gsut._core import InputError
from gsut.files import write_file
from gsut.run import Progress

Row = dict[str, Any]
HALL = "hall"  # the dataset that every machine can make: the demo's
WRONG = "wrong"  # the key of a measured row that says why its result is wrong: no time is printed
TIME_UNITS = ("s", "ms", "ns", "CPU-s", "CPU-ms")  # the least of all repeats counts
_VERSION = "version"


@dataclasses.dataclass(frozen=True)
class Column:
    """One column of a benchmark's table.

    Args:
        key: of the value in a row.
        name: heading; the key if empty.
        unit: shown with the heading. Columns of a unit of time are empty in wrong rows.
        form: of format(); empty for text that names the row, "s" for text that was measured.
    """

    key: str
    name: str = ""
    unit: str = ""
    form: str = ""

    @property
    def heading(self) -> str:
        """Name and unit."""
        name = self.name or self.key
        return f"{name} [{self.unit}]" if self.unit else name

    def show(self, row: Row) -> str:
        """Formats the column's value of a row; a dash where there is none."""
        value = row.get(self.key)
        return "-" if value is None else format(value, self.form)


@dataclasses.dataclass(frozen=True)
class Option:
    """A flag of one benchmark; its type is that of `default`, a tuple takes commas between."""

    name: str
    default: Any
    text: str

    def parse(self, words: str) -> Any:
        """Converts the words of the command line.

        Raises:
            InputError: they are not of the default's type.
        """
        tuples = isinstance(self.default, tuple)
        kind = type(self.default[0]) if tuples and self.default else type(self.default)
        kind = str if kind is tuple else kind
        try:
            found = [kind(word) for word in (words.split(",") if tuples else [words])]
        except ValueError:
            flag = self.name.replace("_", "-")
            raise InputError(f"--{flag} must be of kind {kind.__name__}, found {words!r}") from None
        return tuple(found) if tuples else found[0]


class Settings:
    """What the flags say, and where data and runs are.

    The options of the benchmark, and `threads`, are attributes.

    Args:
        options: name -> value.
        data: folder that holds datasets by name, or None.
        sets: names that replace a benchmark's own, or none.
        folder: for what is made; what it holds already is used again.
    """

    def __init__(
        self,
        options: Row,
        data: Path | None = None,
        sets: Sequence[str] = (),
        folder: Path = Path(),
    ) -> None:
        self.__dict__.update(options)
        self.data, self.sets, self.folder = data, sets, folder

    def __getattr__(self, name: str) -> Any:  # the options, for type checkers
        raise AttributeError(name)

    def make(self, name: str, write: Callable[[Path], object]) -> Path:
        """Returns the folder of this name in the work folder; `write` fills it the first time."""
        path = self.folder / name
        if not path.exists():
            partial = self.folder / f"{name}.partial"
            write(partial)
            partial.rename(path)
        return path

    def find(self, name: str) -> Path | None:
        """Finds a dataset by name or path; None if it is not there."""
        if name == HALL:
            from gsut.demo import write_demo_scene

            return self.make(HALL, write_demo_scene)
        from tests.bench.lens_walks import WALKS, write_walk

        if name in WALKS:
            return self.make(name, functools.partial(write_walk, name))
        places = [Path(name)] if os.sep in name else []
        places += [self.data / name] if self.data else []
        return next((place for place in places if place.exists()), None)

    def path(self, name: str) -> Path:
        """Finds a dataset by name or path.

        Raises:
            InputError: it is not there.
        """
        found = self.find(name)
        if found is None:
            raise InputError(f"{name} is not in the folder of --data (or GSUT_DATA): {self.data}")
        return found


@dataclasses.dataclass(frozen=True)
class Benchmark:
    """What a benchmark declares.

    Args:
        help: its line in --help.
        columns: of the table; those with an empty form name a row.
        cases: gives what each row measures: the values of its naming columns, and under keys that
            begin with an underscore what only `measure` needs. "data" names a dataset; cases of
            datasets that are not there are left out.
        measure: measures a case; returns the row's other columns, error beside time. A result that
            is wrong has the reason under WRONG.
        options: the benchmark's own flags.
    """

    help: str
    columns: tuple[Column, ...]
    cases: Callable[[Settings], Iterable[Row]]
    measure: Callable[[Row, Settings], Row]
    options: tuple[Option, ...] = ()

    def settings(self, folder: Path, **changes: Any) -> Settings:
        """Builds settings from the defaults, for tests and other benchmarks."""
        values = {"threads": 0} | {option.name: option.default for option in self.options}
        return Settings(values | changes, folder=folder)

    def name_row(self, row: Row) -> str:
        """Joins the values of the naming columns."""
        return ", ".join(str(row[c.key]) for c in self.columns if not c.form and row.get(c.key))


# --- measuring ------------------------------------------------------------------------------------


def measure_rows(
    benchmark: Benchmark,
    settings: Settings,
    *,
    only: str = "",
    repeats: int = 1,
    against: Path | None = None,
    words: Sequence[str] = (),
) -> list[Row]:
    """Measures all cases, or those whose names contain `only`.

    Args:
        benchmark: what to measure.
        settings: of the benchmark.
        only: a part of the names of rows.
        repeats: runs of each case; the least of each time counts.
        against: another checkout, with its .venv, whose benchmark of the same name measures each
            case by turns with this one.
        words: module, name and flags of the benchmark, for `against`.
    """
    cases = [
        case for case in available_cases(benchmark, settings) if only in benchmark.name_row(case)
    ]
    if not cases:
        raise InputError(f"no row's name contains {only!r}, or the data of all rows is missing")
    threads, isa = _core.num_threads(), _core.active_isa()
    rows: list[Row] = []
    with Progress(sys.stderr.isatty()) as bars:
        for number, case in enumerate(cases):
            bars.show("measured", number, len(cases), benchmark.name_row(case))
            runs: list[Row] = []
            others: list[Row] = []
            for _ in range(repeats):
                try:
                    runs.append(benchmark.measure(case, settings))
                finally:
                    _core.set_num_threads(threads)
                    _core.set_isa(isa)
                if against is not None:
                    others.append(_measure_elsewhere(against, words, benchmark.name_row(case)))
            named = {key: value for key, value in case.items() if not key.startswith("_")}
            rows.append(_merge(benchmark, [named | run for run in runs]))
            if others:
                rows[-1][_VERSION] = "this"
                rows.append(_merge(benchmark, others) | {_VERSION: str(against)})
    return rows


def available_cases(benchmark: Benchmark, settings: Settings) -> list[Row]:
    """Lists the cases whose data is there; says on standard error which are left out."""
    found, missing = [], []
    for case in benchmark.cases(settings):
        if "data" in case and settings.find(case["data"]) is None:
            missing.append(case["data"])
        else:
            found.append(case)
    for name in dict.fromkeys(missing):
        print(f"left out: {name} is not in the folder of --data", file=sys.stderr)
    return found


def _merge(benchmark: Benchmark, runs: Sequence[Row]) -> Row:
    """Takes the last run's row with the least of each time; no times if the result is wrong."""
    row = dict(runs[-1])
    for column in benchmark.columns:
        if column.unit in TIME_UNITS:
            times = [run[column.key] for run in runs if run.get(column.key) is not None]
            row[column.key] = min(times) if times and not row.get(WRONG) else None
    return row


def _measure_elsewhere(checkout: Path, words: Sequence[str], name: str) -> Row:
    """Has another checkout measure the row of this name."""
    with tempfile.TemporaryDirectory(prefix="gsut-against-") as folder:
        file = Path(folder).resolve() / "rows.json"
        command = [".venv/bin/python", "-m", *words, "--only", name]
        done = subprocess.run(
            [*command, "--json", str(file)], cwd=checkout, capture_output=True, text=True,
            env=os.environ | {"PYTHONPATH": "tests"}, check=False,
        )  # fmt: skip
        if done.returncode:
            raise InputError(f"--against {checkout}: {done.stderr.strip() or done.returncode}")
        return json.loads(file.read_text())[0]


# --- tables ---------------------------------------------------------------------------------------


def choose_columns(benchmark: Benchmark, keys: str, rows: Sequence[Row] = ()) -> tuple[Column, ...]:
    """Returns the columns of these keys, with commas between; all if there are none.

    Raises:
        InputError: the benchmark has no such column.
    """
    known = {column.key: column for column in benchmark.columns}
    unknown = [key for key in keys.split(",") if keys and key not in known]
    if unknown:
        raise InputError(f"--columns: no {unknown[0]!r}; there are {', '.join(known)}")
    chosen = tuple(known[key] for key in keys.split(",")) if keys else benchmark.columns
    versions = (Column(_VERSION),) if any(_VERSION in row for row in rows) else ()
    return (*chosen, *versions)


def format_table(rows: Sequence[Row], columns: Sequence[Column]) -> str:
    """Aligns the rows as text: names to the left, numbers to the right."""
    cells = [[column.heading for column in columns]]
    cells += [[column.show(row) for column in columns] for row in rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    lines = [
        "  ".join(
            cell.rjust(width) if column.form else cell.ljust(width)
            for cell, width, column in zip(line, widths, columns, strict=True)
        ).rstrip()
        for line in cells
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def format_markdown(rows: Sequence[Row], columns: Sequence[Column]) -> str:
    """Writes the rows as a Markdown table."""
    lines = [[column.heading for column in columns]]
    lines += [[column.show(row).replace("|", "\\|") for column in columns] for row in rows]
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([head, "|---" * len(columns) + "|", *body])


# --- the command ----------------------------------------------------------------------------------


def add_flags(parser: argparse.ArgumentParser, benchmark: Benchmark) -> None:
    """Adds the flags of all benchmarks and those of this one."""
    add = parser.add_argument
    for option in benchmark.options:
        default = option.default
        shown = ",".join(map(str, default)) if isinstance(default, tuple) else default
        flag = f"--{option.name.replace('_', '-')}"
        add(flag, dest=option.name, metavar="X", help=f"{option.text} [default: {shown}]")
    add("--only", default="", metavar="WORDS", help="measure the rows whose names contain this")
    add("--data", metavar="FOLDER", default=os.environ.get("GSUT_DATA"),
        help="folder that holds datasets by name [default: GSUT_DATA]")  # fmt: skip
    add("--sets", metavar="A,B", default="",
        help=f"datasets to measure, by name or path; {HALL}: the demo's")  # fmt: skip
    add("--repeats", type=int, default=1, metavar="N", help="the least of N times [default: 1]")
    add("--threads", type=int, default=0, metavar="N", help="0: all [default: 0]")
    add("--against", type=Path, metavar="CHECKOUT",
        help="measure each row by turns with another checkout, which has a .venv")  # fmt: skip
    add("--columns", default="", metavar="A,B", help="columns to print [default: all]")
    add("--markdown", action="store_true", help="print a Markdown table")
    add("--json", metavar="FILE", help="write the rows here; -: print them")
    add("--folder", type=Path, metavar="FOLDER", help="keep what is made here, and use it again")


def run_benchmark(
    module: str, name: str, benchmark: Benchmark, arguments: argparse.Namespace
) -> int:
    """Measures and prints the table.

    Returns:
        The exit status: 1 if a result was wrong.
    """
    values: Row = {"threads": arguments.threads}
    words = [module, name]
    for option in benchmark.options:
        given = getattr(arguments, option.name)
        values[option.name] = option.default if given is None else option.parse(given)
        words += [] if given is None else [f"--{option.name.replace('_', '-')}", given]
    if arguments.repeats < 1:
        raise InputError(f"--repeats must be at least 1, found {arguments.repeats}")
    choose_columns(benchmark, arguments.columns)
    if arguments.json not in (None, "-") and not Path(arguments.json).absolute().parent.is_dir():
        raise InputError(f"--json {arguments.json}: there is no such folder; make it first")
    for flag in ("data", "sets", "threads"):
        words += [f"--{flag}", str(getattr(arguments, flag))] if getattr(arguments, flag) else []
    gsut.set_num_threads(arguments.threads)
    sets = [each for each in arguments.sets.split(",") if each]
    data = None if arguments.data is None else Path(arguments.data)
    with _open_folder(arguments.folder) as folder:
        rows = measure_rows(
            benchmark, Settings(values, data, sets, folder), only=arguments.only,
            repeats=arguments.repeats, against=arguments.against, words=words,
        )  # fmt: skip
    if arguments.json == "-":
        print(json.dumps(rows, indent=1))
    else:
        show = format_markdown if arguments.markdown else format_table
        print(show(rows, choose_columns(benchmark, arguments.columns, rows)))
        if arguments.json:
            write_file(Path(arguments.json), json.dumps(rows, indent=1) + "\n")
    wrong = [row for row in rows if row.get(WRONG)]
    for row in wrong:
        print(f"{benchmark.name_row(row)}: {row[WRONG]}", file=sys.stderr)
    return 1 if wrong else 0


@contextlib.contextmanager
def _open_folder(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        yield keep.resolve()
        return
    with tempfile.TemporaryDirectory(prefix="gsut-bench-") as folder:
        yield Path(folder)
