"""Damages a file in every way that does not depend on what it holds."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

Damage = Callable[[Path], object]
PICTURE = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63f8"
    "cfc000000301010018dd8db00000000049454e44ae426082"
)  # one red pixel


def replace(make: Callable[[Path], object]) -> Damage:
    """Something else in place of the file."""

    def damage(path: Path) -> None:
        path.unlink()
        make(path)

    return damage


def rewrite(change: Callable[[bytes], bytes]) -> Damage:
    """The file with other content."""
    return lambda path: path.write_bytes(change(path.read_bytes()))


# Name -> what is done. None of these files can be read in any sense.
TO_ANY_FILE: dict[str, Damage] = {
    "empty": rewrite(lambda _: b""),
    "cut in half": rewrite(lambda content: content[: len(content) // 2]),
    "zeros": rewrite(lambda content: bytes(len(content))),
    "noise": rewrite(lambda content: random.Random(1).randbytes(len(content))),
    "a picture": rewrite(lambda _: PICTURE),
    "one line of text": rewrite(lambda _: b"hello, this is something else\n"),
    "a web page": rewrite(lambda _: b"<!DOCTYPE html><html><body>404</body></html>\n"),
    "a folder": replace(lambda path: path.mkdir()),
    "a pipe that nobody writes": replace(os.mkfifo),
    "a device without end": replace(lambda path: path.symlink_to("/dev/zero")),
    "a link to itself": replace(lambda path: path.symlink_to(path.name)),
    "a link to nothing": replace(lambda path: path.symlink_to("nowhere")),
    "missing": Path.unlink,
}
# Of text alone.
TO_TEXT: dict[str, Damage] = {
    "UTF-16": rewrite(lambda content: content.decode().encode("utf-16")),
    "a byte that is no UTF-8": rewrite(lambda content: content[:9] + b"\xff\xfe" + content[9:]),
}
# What the sentence must say of it, beside the file's name.
CAUSES = {
    "a folder": r"directory|folder|is not a file|holds neither|holds no images",
    "a pipe that nobody writes": r"pipe|no such file|absent|cannot be read|cannot be opened",
    "a device without end": r"device|no such file|absent|cannot be read|cannot be opened",
    "a link to itself": r"symbolic link|no such file|absent|cannot be read|cannot be opened",
    "a link to nothing": r"[Nn]o such file|absent|there is no|no such folder|missing",
    "missing": r"[Nn]o such file|absent|there is no|no such folder|missing",
}
