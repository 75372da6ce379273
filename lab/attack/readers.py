"""Gives every registered reader every kind of wrong file."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterator
from pathlib import Path

from reader_examples import EXAMPLES
from wrong_files import find_fault, list_contents, list_pieces


@functools.cache
def _list_files(name: str) -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as folder:
        file, _ = EXAMPLES[name](Path(folder))
        content = file.read_bytes()
        return (*list_contents(file, content), *list_pieces(content))


def list_reader_cases() -> Iterator[tuple[str, str]]:
    """Lists the kind and title of each wrong file: the reader's name and the file's number."""
    for name in EXAMPLES:
        yield from (
            ("reader", f"reader: {name}, {number}") for number in range(len(_list_files(name)))
        )


def read_wrong_file(title: str, scratch: Path) -> str | None:
    """Reads the wrong file of a row and returns the fault, if any."""
    name, _, number = title.removeprefix("reader: ").rpartition(", ")
    scratch.mkdir()
    file, read = EXAMPLES[name](scratch)
    file.write_bytes(_list_files(name)[int(number)])
    return find_fault(read) or None
