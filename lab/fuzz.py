"""Feeds every reader with damaged files: `python -m lab.fuzz [SECONDS] [--seed N]`.

A small valid file of every format is written, then changed at random, again and again: bits,
numbers, pieces cut out, doubled, exchanged. A reader may read the result or refuse it in a sentence
of ours; anything else ends the run, and the file that did it is kept.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import random
import re
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import calib
import gsut
import small_datasets
import small_recordings
from formats.scene_cases import plain_scene
from gsut import formats
from gsut.files import list_readers
from lab.attack.world import write_lenses
from reader_examples import EXAMPLES, WITHOUT, import_all

NUMBERS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"-inf", b"9223372036854775807", b"1e-320",
           b"4294967296", b"true", b"null", b'""', b"[]", b"{}", b"9" * 400)  # fmt: skip
SLOWEST = 10.0  # processor seconds of one file
MEMORY = 4 << 30  # bytes that reading a file of some kilobytes may take


@dataclasses.dataclass(frozen=True)
class Target:
    """A reader and what it reads.

    Attributes:
        name: of the format.
        file: which is changed.
        read: reads it, or the folder around it.
    """

    name: str
    file: Path
    read: Callable[[], object]


def list_lens_targets(folder: Path) -> Iterator[Target]:
    write_lenses(folder / "lenses")
    for path in sorted((folder / "lenses").iterdir()):
        yield Target(f"lens {path.name}", path, lambda path=path: gsut.load_camera(path))


def list_scene_targets(folder: Path) -> Iterator[Target]:
    gaussians = plain_scene(np.random.default_rng(1), 60)
    for each in formats.list_formats():
        if each.name == "USD" or each.read is None or each.write is None:
            continue  # USD: of a library that may take minutes over its own damaged files
        path = folder / f"scene{each.suffixes[0]}"
        formats.save_gaussians(path, gaussians)
        yield Target(f"scene {each.name}", path, lambda path=path: formats.load_gaussians(path))


def list_dataset_targets(folder: Path) -> Iterator[Target]:
    writers = (
        small_datasets.write_nerfstudio, small_datasets.write_colmap_text,
        small_datasets.write_colmap_binary, small_datasets.write_folder,
        small_recordings.write_euroc, small_recordings.write_tumvi,
    )  # fmt: skip
    for write in writers:
        place = folder / write.__name__
        write(place)
        for path in sorted(place.rglob("*")):
            if path.is_file() and path.suffix not in (".png", ".jpg"):
                name = f"{write.__name__.removeprefix('write_')} {path.relative_to(place)}"
                yield Target(name, path, lambda place=place: gsut.load_dataset(place))


def list_registered_targets(folder: Path) -> Iterator[Target]:
    """Lists the readers of the registry; a new one needs an example in reader_examples."""
    import_all(gsut)
    import_all(calib)
    for reader in list_readers():
        if reader.name in WITHOUT:
            continue
        place = folder / reader.name
        place.mkdir()
        yield Target(reader.name, *EXAMPLES[reader.name](place))


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


def fault(target: Target) -> str | None:
    """Reads a file; returns what is wrong with how the reader took it, or None."""
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.read()
    except gsut.InputError as error:
        if "\n" in str(error).strip():
            return f"more than one line: {error}"
    except OSError as error:
        if error.filename is None:
            return traceback.format_exc()
    except Exception:
        return traceback.format_exc()
    seconds = time.process_time() - started
    return f"took {seconds:.1f} processor seconds" if seconds > SLOWEST else None


def fuzz(folder: Path, seconds: float, seed: int, rounds: int | None = None) -> tuple[int, int]:
    """Changes and reads until the time is over, or for a number of rounds over all readers.

    Returns:
        Numbers of readers' files and of changed files read.

    Raises:
        AssertionError: what was found; the changed file stays where it is.
    """
    targets: list[Target] = []
    for make in (
        list_lens_targets,
        list_scene_targets,
        list_dataset_targets,
        list_registered_targets,
    ):
        place = folder / make.__name__
        place.mkdir()
        targets += make(place)
    whole = [target.file.read_bytes() for target in targets]
    for target in targets:
        said = fault(target)
        assert said is None, f"{target.name}, as it was written: {said}"
    chance, end, count = random.Random(seed), time.monotonic() + seconds, 0
    while time.monotonic() < end and (rounds is None or count < rounds * len(targets)):
        target, content = targets[count % len(targets)], whole[count % len(targets)]
        target.file.write_bytes(change_bytes(content, chance))
        said = fault(target)
        assert said is None, f"{target.name}: {target.file}: {said}"
        target.file.write_bytes(content)
        count += 1
    return len(targets), count


def print_readers() -> None:
    """Prints a row for each registered reader: format, endings, place in the code, example."""
    import_all(gsut)
    import_all(calib)
    print("| format | files | reader | damaged |\n|---|---|---|---|")
    for reader in sorted(list_readers(), key=lambda reader: reader.name.lower()):
        endings, place = " ".join(reader.endings), f"{reader.module}.{reader.function}"
        print(
            f"| {reader.name} | {endings} | {place} | {'' if reader.name in WITHOUT else 'yes'} |"
        )


def main() -> int:
    parser = argparse.ArgumentParser(prog="lab/run fuzz", description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="print the readers and their files")
    arguments = parser.parse_args()
    if arguments.list:
        print_readers()
        return 0
    if importlib.util.find_spec("resource"):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    folder = Path(tempfile.mkdtemp(prefix="gsut-fuzz-"))
    try:
        files, count = fuzz(folder, arguments.seconds, arguments.seed)
    except AssertionError as error:
        print(f"{error}\nkept in {folder}", file=sys.stderr)
        return 1
    shutil.rmtree(folder)
    print(f"{count:,} changed files of {files} kinds, seed {arguments.seed}: all read or refused")
    return 0


if __name__ == "__main__":
    sys.exit(main())
