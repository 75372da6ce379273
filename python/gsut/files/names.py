"""Names of files: safe ones, free ones, and those that cannot be written."""

from __future__ import annotations

import os
import re
from pathlib import Path

from gsut._core import InputError
from gsut.files.errors import WriteError

_MOST_LETTERS = 60  # of a name: four bytes each, and a file system takes 255 with an ending


def to_file_name(name: str) -> str:
    """Converts a name of any origin, such as a topic of a bag, to one part of a path.

    Letters, digits, dots, dashes and underscores stay; a leading dot does not.
    """
    plain = re.sub(r"[^\w.-]+", "_", name).strip("_")
    return plain.lstrip("._")[:_MOST_LETTERS] or "unnamed"


def claim_name(name: str, taken: set[str]) -> str:
    """Adds a file's name to those taken, with -2, -3 ... before its suffix where it is taken.

    Returns:
        The name as it was added.
    """
    stem, dot, suffix = name.rpartition(".") if "." in name.rpartition("/")[2] else (name, "", "")
    unique, number = name, 2
    while unique in taken:
        unique, number = f"{stem}-{number}{dot}{suffix}", number + 1
    taken.add(unique)
    return unique


def check_name(path: str | os.PathLike[str]) -> None:
    """Raises WriteError for a name with a zero byte, where the system would cut it off: what has
    the shorter name would be overwritten."""
    if b"\0" in os.fsencode(path):
        raise WriteError(
            f"cannot write {os.fspath(path)!r}: the name holds a zero byte; give another name"
        )


def refuse_existing(path: Path, by: str = "") -> None:
    """Raises InputError where something is there already, or nothing can be: a file is written
    under a new name, and no time is spent on one that nobody can write.

    Args:
        path: to be written.
        by: how another name is given, such as " with -o".
    """
    check_name(path)
    if path.exists():
        raise InputError(f"{path} exists; give another name{by} (nothing was overwritten)")
    folder = path.parent
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        what = "cannot be written to" if folder.is_dir() else "is no folder that is there"
        raise InputError(f"{path} cannot be written: {folder} {what}; give another name{by}")
