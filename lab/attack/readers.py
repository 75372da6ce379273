"""Gives every registered reader every kind of wrong file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from reader_examples import EXAMPLES
from wrong_files import find_fault, list_contents


def list_reader_cases(folder: Path) -> Iterator[tuple[str, str]]:
    """Lists the kind and title of each wrong file: the reader's name and the file's number."""
    for name, make in EXAMPLES.items():
        place = folder / f"list {name}"
        place.mkdir(parents=True)
        file, _ = make(place)
        count = sum(1 for _ in list_contents(file, file.read_bytes()))
        yield from (("reader", f"reader: {name}, {number}") for number in range(count))


def read_wrong_file(title: str, scratch: Path) -> str | None:
    """Reads the wrong file of a row and returns the fault, if any."""
    name, _, number = title.removeprefix("reader: ").rpartition(", ")
    scratch.mkdir()
    file, read = EXAMPLES[name](scratch)
    for place, content in enumerate(list_contents(file, file.read_bytes())):
        if place == int(number):
            file.write_bytes(content)
            return find_fault(read) or None
    return f"there is no file {number}"
