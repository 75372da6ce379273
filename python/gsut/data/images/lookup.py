"""Finds pictures by the names that files of datasets give them, on whatever system these began."""

from __future__ import annotations

import functools
import os
import re
from pathlib import Path

from gsut.data.errors import list_some
from gsut.data.images.names import normalize_name
from gsut.files import ENDINGS, split_numbers

# Start of a path of another machine, of which the last parts alone can be found here.
_ABSOLUTE = re.compile(r"(?<![a-z])[a-z]+:/|/|\.\./")
_MOST_LETTERS = 4096  # of a path, on the systems that take the longest


class PictureLookup:
    """Finds pictures below a folder.

    Args:
        folder: that the names are relative to.

    Attributes:
        differing: names whose picture is called otherwise, and how; names without ending, which
            some programs write, are none of them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.differing: dict[str, str] = {}

    @functools.cached_property
    def _names(self) -> dict[str, str | None]:
        """Names by their normal form, also without their ending; None where two have it."""
        names: dict[str, str | None] = {}
        for name in list_picture_names(self._folder):
            plain = normalize_name(name)
            for key in (plain, str(Path(plain).with_suffix(""))):
                names[key] = None if key in names else name
        return names

    def find(self, name: str) -> Path | None:
        """Finds the picture of a name; of one that differs, it is the only one that fits."""
        if "\0" in name or len(name) > _MOST_LETTERS:
            return None
        path = self._folder / name
        if os.path.isfile(path):  # also of parts that are too long for any file
            return path
        plain = normalize_name(name)
        keys = [plain]
        if _ABSOLUTE.match(plain):  # 000.jpg of C:/scan/images/000.jpg
            parts = plain.split("/")
            keys += ["/".join(parts[start:]) for start in range(1, len(parts))]
        found = next((each for key in keys if (each := self._names.get(key))), None)
        if found is None:
            return None
        if str(Path(found).with_suffix("")) != name.removeprefix("./"):
            self.differing[name] = found
        return self._folder / found

    def describe_differing(self, source: object) -> list[str]:
        """Describes in a note how pictures are called otherwise than a file says."""
        if not self.differing:
            return []
        pairs = [f"{name} is {found}" for name, found in self.differing.items()]
        return [
            f"{source}: {len(self.differing)} pictures have other names than it says, in capitals, "
            f"slashes, letters or endings: {list_some(pairs)}"
        ]


def list_picture_names(folder: Path) -> list[str]:
    """Lists the pictures below a folder, relative to it, sorted as people count."""
    found = (p for p in folder.rglob("*") if p.suffix.lower() in ENDINGS["picture"])
    names = (path.relative_to(folder).as_posix() for path in found if path.is_file())
    return sorted(names, key=split_numbers)


def describe_pictures(folder: Path) -> str:
    """Describes which pictures lie below a folder, for messages of those that do not."""
    names = list_picture_names(folder)
    return f"there lie {list_some(names)}" if names else "no picture lies there"
