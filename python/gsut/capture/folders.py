"""Finds the photographs, films and masks of a folder, whatever else lies among them."""

from __future__ import annotations

import collections
import dataclasses
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from gsut._core import InputError
from gsut.files import find_kind, read_bytes, split_numbers

# Files and folders that are looked through below a folder of photographs: the largest sets of
# photographs that poses are found of have a tenth of that, and listing a disk takes minutes.
_MOST_FILES = 100_000
# Folders of previews and of what was thrown away, as photo libraries and network drives make them.
_PREVIEWS = ("thumbs", "thumbnails", "thumbnail", "__macosx", "previews", "lost+found")
_HIDDEN = (".", "@", "#", "$")  # first letters of names that systems keep for themselves
_MASK_FOLDERS = ("masks", "mask")
# Small copies of films that cameras make for their screens and for editing.
_PROXY_NAME = re.compile(r"\.lr[vf]|^lrv_|_proxy\.", re.IGNORECASE)
# A mask is called as its photograph, with one of these words behind its stem, or before it.
_MASK_NAME = re.compile(r"^(?:(.+)[._ -]masks?|masks?[._ -](.+))", re.IGNORECASE)
# What programs put behind the stem of a copy: "IMG (1)", "IMG - Copy", "IMG copy 2".
_COPY_NAME = re.compile(
    r"^(.+?)(?<![ _-])[ _-]*(?:\(\d+\)|(?:- )?(?:copy|copie|kopie|copia)\b.*)", re.IGNORECASE
)
# What phones call an edited copy: IMG_E0042, IMG-edited, 20260102_090000~2.
_EDITED_NAME = re.compile(r"^(IMG_)E(\d{4,})|^(.+?)(?:[-_ ]edited|~\d)", re.IGNORECASE)


@dataclasses.dataclass
class Found:
    """What a folder holds.

    Attributes:
        root: that names of photographs are relative to.
        photographs, films: sorted as people count.
        masks: by the photograph that each is of.
        copies: of photographs, which are left out.
        twins: in another format of a photograph, which are left out.
    """

    root: Path
    photographs: list[Path] = dataclasses.field(default_factory=list)
    films: list[Path] = dataclasses.field(default_factory=list)
    masks: dict[Path, Path] = dataclasses.field(default_factory=dict)
    copies: list[Path] = dataclasses.field(default_factory=list)
    twins: list[Path] = dataclasses.field(default_factory=list)

    def describe_rest(self) -> str:
        """Describes what was passed over beside the photographs; "" if nothing was."""
        copies = f"copies of others, or edited: {self.copies[0].name} ..." if self.copies else ""
        twins = "of the same in another format"
        counts = (
            (len(self.films), "films"), (len(self.copies), copies), (len(self.twins), twins)
        )  # fmt: skip
        rest = [f"{count} {what}" for count, what in counts if count]
        if not self.photographs or not rest:
            return ""
        return f"{self.root}: {len(self.photographs)} photographs; left out: {', '.join(rest)}"


def list_folder(folder: Path) -> Found:
    """Lists photographs, films and masks of a folder, or of its folder images.

    Those in the folder itself count, or, where there are none, those in the folders below, such as
    100MEDIA and 101MEDIA of a memory card; in images, all.
    """
    inner = folder / "images"
    found = Found(inner if inner.is_dir() else folder)
    kinds = {} if inner.is_dir() else _find_kinds(found.root, "*")
    kinds = kinds or _find_kinds(found.root, "**/*")
    films = [path for path, kind in kinds.items() if kind == "video"]
    whole = [path for path in films if not _PROXY_NAME.search(path.name)]
    found.films = whole or films
    pictures = [path for path, kind in kinds.items() if kind == "picture"]
    stems = {path.with_suffix("") for path in pictures}
    for kind in ("heif", "raw"):  # one file counts of what a camera writes in two formats
        others = [path for path, each in kinds.items() if each == kind]
        found.twins += [path for path in others if path.with_suffix("") in stems]
        pictures += [path for path in others if path.with_suffix("") not in stems]
        stems |= {path.with_suffix("") for path in others}
    taken = set(pictures)
    _sort_out_masks(found, [path for path in kinds if path in taken])
    _sort_out_copies(found)
    return found


def _find_kinds(root: Path, pattern: str) -> dict[Path, str]:
    """Finds the kinds of the photographs and films of a folder, sorted as people count."""
    found = list(itertools.islice(root.glob(pattern), _MOST_FILES + 1))
    if len(found) > _MOST_FILES:
        raise InputError(
            f"{root} holds more than {_MOST_FILES:,} files and folders; give the folder of the "
            "photographs"
        )
    files = (path for path in found if _is_shown(path.relative_to(root)))
    names = {path: path.relative_to(root).as_posix() for path in files}
    ordered = sorted(names, key=lambda path: split_numbers(names[path]))
    return {path: kind for path in ordered if (kind := find_kind(path))}


def _is_shown(path: Path) -> bool:
    """Returns whether no part of a path is hidden, a preview's or a mask's."""
    *folders, name = path.parts
    if any(part.startswith(_HIDDEN) for part in path.parts) or name.lower() == "mask.png":
        return False
    return not any(part.lower() in (*_PREVIEWS, *_MASK_FOLDERS) for part in folders)


def _sort_out_masks(found: Found, pictures: list[Path]) -> None:
    """Separates photographs from masks, which are called as one of them with a word more."""
    by_name = {(path.parent, each): path for path in pictures for each in (path.name, path.stem)}
    for path in pictures:
        match = _MASK_NAME.fullmatch(path.stem)
        of = match and by_name.get((path.parent, match[1] or match[2]))
        if of:
            found.masks[of] = path
        else:
            found.photographs.append(path)


def _sort_out_copies(found: Found) -> None:
    """Leaves out files called as copies of others, if they hold the same bytes or are edited."""
    by_name = {(path.parent, path.stem, path.suffix): path for path in found.photographs}
    for path in found.photographs:
        match = _COPY_NAME.fullmatch(path.stem)
        of = match and by_name.get((path.parent, match[1], path.suffix))
        if of and of.stat().st_size == path.stat().st_size and read_bytes(of) == read_bytes(path):
            found.copies.append(path)
        edited = _EDITED_NAME.fullmatch(path.stem)
        if edited and (path.parent, "".join(filter(None, edited.groups())), path.suffix) in by_name:
            found.copies.append(path)
    copies = set(found.copies)
    found.photographs = [path for path in found.photographs if path not in copies]


def expand_folders(inputs: Sequence[Path]) -> list[Path]:
    """Replaces each folder that holds films and no photograph by its films."""
    expanded = []
    for path in inputs:
        found = list_folder(path) if path.is_dir() else Found(path)
        expanded += found.films if found.films and not found.photographs else [path]
    return expanded


def explain_no_photographs(inputs: Sequence[Path]) -> InputError:
    """Explains what lies where photographs are expected."""
    endings = collections.Counter(
        path.suffix.lower() or "no ending"
        for given in inputs
        for path in (given.rglob("*") if given.is_dir() else [given]) if path.is_file()
    )  # fmt: skip
    lie = ", ".join(f"{count} x {ending}" for ending, count in endings.most_common(5))
    return InputError(
        f"{', '.join(map(str, inputs))}: there are no photographs here (found {lie or 'nothing'}); "
        "give a folder of JPEG, PNG, HEIC or raw files, or a video"
    )
