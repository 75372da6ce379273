"""`./run bench street`: a made street of rooms trained in blocks: time and memory by rooms."""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gsut
from gsut._core import InputError
from gsut.blocks import training_bytes
from tests.bench.block_runs import figures_of, print_stages, train_apart
from tests.bench.report_rows import (
    add_files,
    bar,
    check_files,
    numbers,
    print_and_write,
    row_writer,
)
from tests.bench.street import write_street

_COLUMNS = (
    ("rooms", "rooms", "d"),
    ("training", "training", ""),
    ("views", "views", ",d"),
    ("Gaussians", "num_gaussians", ",d"),
    ("steps", "steps", ",d"),
    ("PSNR [dB]", "psnr", ".2f"),
    ("worst [dB]", "psnr_min", ".2f"),
    ("CPU-s", "cpu_seconds", ".0f"),
    ("a room", "cpu_a_room", ".1f"),
    ("s", "seconds", ".0f"),
    ("peak MB", "peak_mb", ",.0f"),
    ("one training's table MB", "one_mb", ",.0f"),
    ("ray-casting CPU-s", "made_cpu_seconds", ".0f"),
)


@dataclasses.dataclass(frozen=True)
class StreetOptions:
    """What is made and trained.

    Args:
        rooms: numbers of rooms; a block each.
        views, size: of a room, and pixels of a side.
        steps, gaussians: a room.
        memory: limit of the trainings in blocks, such as 8GB.
        threads: of each training.
        whole: numbers of rooms that are also trained as one.
        runs: folder of datasets and runs, which are kept there and used again.
    """

    rooms: Sequence[int]
    views: int
    size: int
    steps: int
    gaussians: int
    memory: str
    threads: int
    whole: Sequence[int]
    runs: Path


def street_bench(
    options: StreetOptions,
    say: Callable[[str], None],
    write: Callable[[list[dict[str, Any]]], None] = lambda rows: None,
) -> list[dict[str, Any]]:
    """A row a training.

    Args:
        options: what to train.
        say: told what begins.
        write: gets all rows after each.

    Returns:
        `one_mb` is what one training of all rooms would take by the table of docs/blocks.md.
    """
    rows: list[dict[str, Any]] = []
    for rooms in options.rooms:
        data = options.runs / f"street{rooms}"
        say(f"{rooms} rooms, ray-casting")
        began = time.process_time()
        if not data.is_dir():
            write_street(data, rooms, options.views, options.size)
        made = time.process_time() - began
        total = options.gaussians * rooms
        flags = [
            "--steps", str(options.steps * rooms), "--max-gaussians", str(total), "--threads",
            str(options.threads), "--sh-degree", "1",
        ]  # fmt: skip
        blocks = ["--blocks", str(rooms), "--memory", options.memory]
        scene = gsut.load_dataset(data)
        one = training_bytes(scene, 1, total, 0, len(scene.train_indices))
        trainings = {"blocks": blocks} | ({"one": []} if rooms in options.whole else {})
        for name, more in trainings.items():
            say(f"{rooms} rooms, {name}")
            metrics = train_apart(data, options.runs / f"{name}{rooms}", [*flags, *more])
            row = {"rooms": rooms, "training": name, "views": len(scene.views), "one_mb": one / 1e6}
            row |= figures_of(metrics)
            row |= {"cpu_a_room": metrics["cpu_seconds"] / rooms, "made_cpu_seconds": made}
            rows.append(row)
            write(rows)
    return rows


# --- the command ----------------------------------------------------------------------------------

HELP = "a made street of 1, 4 and 16 rooms trained in blocks: seconds and memory by rooms"


def add_flags(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--rooms", metavar="N,M", help="[default 1,4,16]")
    add("--views", type=int, default=63, metavar="N", help="of each room [default 63]")
    add("--size", type=int, default=96, metavar="PX", help="of the images [default 96]")
    add("--steps", type=int, default=200, metavar="N", help="for each room [default 200]")
    add("--gaussians", type=int, default=8000, metavar="N", help="of each room [default 8000]")
    add("--memory", default="8GB", metavar="SIZE", help="of the blocks [default 8GB]")
    add("--threads", type=int, default=2, metavar="N", help="[default 2]")
    add("--whole", metavar="N,M", help="rooms that are also trained as one [default: none]")
    add("--runs", type=Path, metavar="FOLDER", help="keep the runs here, and go on with them")
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    gsut.set_num_threads(arguments.threads)
    rooms = numbers(arguments.rooms, int, "--rooms") or [1, 4, 16]
    if min(rooms) < 1 or arguments.views < 4:
        raise InputError("a street has at least 1 room and 4 --views of it")
    with tempfile.TemporaryDirectory(prefix="gsut-bench-") as temporary:
        runs = arguments.runs or Path(temporary)
        runs.mkdir(parents=True, exist_ok=True)
        options = StreetOptions(
            rooms, arguments.views, arguments.size, arguments.steps, arguments.gaussians,
            arguments.memory, arguments.threads, numbers(arguments.whole, int, "--whole"), runs,
        )  # fmt: skip
        with bar(2 * len(rooms) + len(options.whole)) as advance:
            rows = street_bench(options, advance, row_writer(arguments))
    print_and_write(rows, _COLUMNS, arguments)
    print_stages(rows, "rooms")
    return 0
