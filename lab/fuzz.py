"""Feeds every reader with damaged files: `lab/run fuzz [SECONDS] [--rounds N] [--only WORD]`.

A small valid file of every format is written, then changed at random, again and again: bits,
numbers, pieces cut out, doubled, exchanged. A reader may read the result or refuse it in a sentence
of ours; anything else ends the run, and the file that did it is kept.
"""

from __future__ import annotations

import argparse
import importlib.util
import random
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from reader_examples import EXAMPLES
from wrong_files import find_fault

NUMBERS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"-inf", b"9223372036854775807", b"1e-320",
           b"4294967296", b"true", b"null", b'""', b"[]", b"{}", b"9" * 400)  # fmt: skip
MEMORY = 4 << 30  # bytes that reading a file of some kilobytes may take


def change_bytes(content: bytes, chance: random.Random) -> bytes:
    """Changes bytes, numbers and pieces at random, a few times."""
    for _ in range(chance.choice((1, 1, 2, 5))):
        size = len(content)
        start = chance.randrange(size + 1)
        end = min(size, start + chance.choice((1, 4, 16, 200)))
        kind = chance.randrange(8)
        if kind == 0:
            content = content[:start]
        elif kind == 1:
            content = content[:start] + content[end:]
        elif kind == 2:
            content = content[:end] + content[start:]
        elif kind == 3:
            content = content[:start] + bytes(end - start) + content[end:]
        elif kind == 4:
            content = content[:start] + chance.randbytes(end - start) + content[end:]
        elif kind == 5 and start < size:
            bit = bytes([content[start] ^ 1 << chance.randrange(8)])
            content = content[:start] + bit + content[start + 1 :]
        else:
            numbers = list(re.finditer(rb"-?\d[\d.e+-]*", content))
            if numbers:
                found = chance.choice(numbers)
                content = content[: found.start()] + chance.choice(NUMBERS) + content[found.end() :]
    return content


def fuzz(
    folder: Path, seconds: float, seed: int, rounds: int | None = None, only: str = ""
) -> tuple[int, int]:
    """Changes and reads until the time is over, or for a number of rounds over all readers.

    Args:
        only: of the names of the readers' files.

    Returns:
        Numbers of files and of changed files read.

    Raises:
        AssertionError: what was found; the changed file stays where it is.
    """
    targets = []
    for name, make in EXAMPLES.items():
        if only not in name:
            continue
        (folder / name).mkdir()
        file, read = make(folder / name)
        assert not (said := find_fault(read)), f"{name}, as it was written: {said}"
        targets.append((name, file, file.read_bytes(), read))
    chance, end, count = random.Random(seed), time.monotonic() + seconds, 0
    while time.monotonic() < end and (rounds is None or count < rounds * len(targets)):
        name, file, content, read = targets[count % len(targets)]
        file.write_bytes(change_bytes(content, chance))
        assert not (said := find_fault(read)), f"{name}: {file}: {said}"
        file.write_bytes(content)
        count += 1
    return len(targets), count


def main() -> int:
    parser = argparse.ArgumentParser(prog="lab/run fuzz", description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, help="changed files of each reader, beside SECONDS")
    parser.add_argument("--only", default="", metavar="WORD", help="readers whose file has it")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if importlib.util.find_spec("resource"):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    folder = Path(tempfile.mkdtemp(prefix="gsut-fuzz-"))
    try:
        files, count = fuzz(
            folder, arguments.seconds, arguments.seed, arguments.rounds, arguments.only
        )
    except AssertionError as error:
        print(f"{error}\nkept in {folder}", file=sys.stderr)
        return 1
    shutil.rmtree(folder)
    print(f"{count:,} changed files of {files} kinds, seed {arguments.seed}: all read or refused")
    return 0


if __name__ == "__main__":
    sys.exit(main())
