"""Compares names of files as different systems write them."""

from __future__ import annotations

import os
import unicodedata
from pathlib import Path
from urllib.parse import unquote


def normalize_name(name: str) -> str:
    """Returns a name without what systems differ in: slashes, capitals, %20, forms of letters."""
    plain = unicodedata.normalize("NFC", unquote(name).replace("\\", "/")).casefold()
    return plain.removeprefix("./")


def find_named(folder: Path, *names: str) -> Path | None:
    """Finds the first of these paths in a folder that is there, or else one that differs from it
    as `normalize_name` leaves out."""
    for name in names:
        if "\0" not in name and os.path.exists(folder / name):
            return folder / name
    for name in names:
        found: Path | None = folder
        for part in normalize_name(name).split("/"):
            entries = sorted(found.iterdir()) if found is not None and found.is_dir() else []
            found = next((each for each in entries if normalize_name(each.name) == part), None)
        if found is not None:
            return found
    return None
