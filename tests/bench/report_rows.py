"""Rows of a benchmark: a table for people, JSON, CSV and plot files, and the flags of these."""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import itertools
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.files import write_file
from gsut.run import Progress
from tests.bench.plots import check_plot_path

MEASURED = "Measured"  # heading of what a benchmark measures, in its --help


def table_text(rows: Sequence[dict[str, Any]], columns: Sequence[tuple[str, str, str]]) -> str:
    """The rows as lines of aligned text; what is null is a dash.

    Args:
        rows: see the benchmarks.
        columns: (heading, key, format); a key of a dict within the row is written a.b.
    """
    cells = [[heading for heading, _, _ in columns]]
    for row in rows:
        flat = _flattened(row)
        cells.append([_cell(flat.get(key), form) for _, key, form in columns])
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    left = [form == "" for _, _, form in columns]
    lines = [
        "  ".join(
            cell.ljust(width) if to_left else cell.rjust(width)
            for cell, width, to_left in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in cells
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def _cell(value: Any, form: str) -> str:
    return "-" if value is None else format(value, form)


def write_json(path: str | os.PathLike[str], rows: Any) -> None:
    """The rows as a JSON file."""
    text = json.dumps(rows, indent=2, allow_nan=False) + "\n"
    write_file(path, text)


def read_rows(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """The rows that `write_json` wrote; none where there is no such file.

    Raises:
        InputError: the file cannot be read or holds something else.
    """
    if not Path(path).exists():
        return []
    try:
        rows = json.loads(Path(path).read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {error}; remove it or leave --resume out") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path} holds no rows of a benchmark; name another file with --json")
    return rows


def write_csv(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """The rows as a CSV file: a heading, then one line a row; what is null is empty.

    A dict within a row becomes one column an entry, named a.b.
    """
    flat = [_flattened(row) for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    write_file(path, buffer.getvalue())


def _flattened(row: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, dict):
            flat |= _flattened(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


# --- flags ----------------------------------------------------------------------------------------


def add_files(
    parser: argparse.ArgumentParser, plot: str | None = None, *, resume: bool = False
) -> None:
    """--json, --csv, --plot (if `plot` says what it draws) and --resume."""
    parser.add_argument("--json", metavar="FILE", help="write the rows as JSON")
    parser.add_argument("--csv", metavar="FILE", help="write the rows as CSV")
    if plot:
        parser.add_argument("--plot", metavar="FILE", help=f"draw (svg, png or pdf) {plot}")
    if resume:
        parser.add_argument(
            "--resume",
            action="store_true",
            help="keep the rows of --json FILE that were made with the same settings",
        )


def check_files(arguments: argparse.Namespace) -> None:
    """Refuses what cannot be written before anything is measured."""
    if getattr(arguments, "plot", None):
        check_plot_path(arguments.plot)
    for flag in ("json", "csv", "plot"):
        path = getattr(arguments, flag, None)
        if path and not Path(path).absolute().parent.is_dir():
            raise InputError(f"--{flag} {path}: there is no such folder; make it first")


def print_and_write(
    rows: list[dict[str, Any]],
    columns: Sequence[tuple[str, str, str]],
    arguments: argparse.Namespace,
) -> None:
    print(table_text(rows, columns))
    if arguments.json:
        write_json(arguments.json, rows)
    if arguments.csv:
        write_csv(arguments.csv, rows)


def rows_to_keep(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """With --resume, the rows that an earlier call wrote."""
    if not arguments.resume:
        return []
    if not arguments.json:
        raise InputError("--resume goes on with the rows of --json FILE; name that file")
    return read_rows(arguments.json)


def row_writer(arguments: argparse.Namespace) -> Callable[[list[dict[str, Any]]], None]:
    """Writes --json after every row: it takes long, and a killed call then loses one."""
    return lambda rows: write_json(arguments.json, rows) if arguments.json else None


def words(text: str | None) -> list[str]:
    """The words of a list with commas."""
    return [word.strip() for word in (text or "").split(",") if word.strip()]


def numbers(text: str | None, kind: Callable[[str], Any], flag: str) -> list[Any]:
    """The numbers of a list with commas."""
    try:
        return [kind(word) for word in words(text)]
    except ValueError:
        raise InputError(f'{flag} takes numbers with commas between, found "{text}"') from None


@contextlib.contextmanager
def bar(total: int) -> Iterator[Callable[[str], None]]:
    """Progress on standard error; gives the function that is told what begins."""
    begun = itertools.count()
    with Progress(sys.stderr.isatty()) as bars:
        yield lambda text: bars.show("measured", next(begun), total, text)
