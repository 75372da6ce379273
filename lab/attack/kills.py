"""Kills commands at random moments and runs them again.

They must end with the same bits or the same result, and leave nothing half-written.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import random
import re
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsut.data.points import load_points_ply
from gsut.files import UNFINISHED
from gsut.output_folder import MARKER
from lab.attack.world import copy_needs
from lab.attack.zygote import Zygote

LONGEST = 600.0  # seconds by the clock of one command
FIRST = 0.02  # of an unbroken run's time, before which nothing happens
VIEWED = ("--view", "--serve", "127.0.0.1:0")
VIEW_SECONDS = 2.0  # after which a page is left, unbroken
PAGES = ("view", "train, viewed")
DONE = re.compile("exists|already holds|is not empty")  # what is said where a kill came too late


@dataclasses.dataclass(frozen=True)
class Killed:
    """A command to kill.

    Attributes:
        name: in the counts.
        words: the command.
        results: files whose bits are compared.
        needs: names in the world.
        again: what goes on after a kill; None: the same command.
    """

    name: str
    words: tuple[str, ...]
    results: tuple[str, ...]
    needs: tuple[str, ...]
    again: tuple[str, ...] | None = None


TRAIN = ("train", "ds", "-o", "out", "--steps", "600", "--quiet",
         "--max-gaussians", "300")  # fmt: skip
REFINE = ("--refine-poses", "--max-side", "48")
BLOCKS = ("--blocks", "2")
SCENE, MORE = ("out/scene.ply",), ("--resume",)
COMMANDS = (
    Killed("train", TRAIN, SCENE, ("ds",), TRAIN + MORE),
    Killed("train, refined", TRAIN + REFINE, (*SCENE, "out/refined.json"), ("ds",),
           TRAIN + REFINE + MORE),
    Killed("train, in blocks", TRAIN + BLOCKS, SCENE, ("ds",), TRAIN + BLOCKS + MORE),
    Killed("train, viewed", TRAIN, SCENE, ("ds",), TRAIN + MORE),
    Killed("compact", ("compact", "run", "-o", "out", "--keep", "0.5", "--finetune", "60"),
           SCENE, ("ds", "run")),
    Killed("convert", ("convert", "run", "out.spz", "--for", "viewers"),
           ("out.spz",), ("ds", "run")),
    Killed("mesh", ("mesh", "run", "-o", "out.ply"), ("out.ply",), ("ds", "run")),
    Killed("render", ("render", "run", "-o", "out", "--frames", "40", "--size", "64x64"),
           ("out/00000.png", "out/00039.png"), ("ds", "run")),
    Killed("view", ("view", "run", "--serve", "127.0.0.1:0"), (), ("ds", "run")),
    Killed("poses", ("poses", "film.mp4", "-o", "out", "--camera", "lens320.json", "--quiet"),
           ("out/transforms.json", "out/points3D.ply"), ("film.mp4", "lens320.json")),
    Killed("scene", ("scene", "film.mp4", "-o", "out", "--camera", "lens320.json", "--steps", "30",
                     "--preset", "fast", "--quiet"), SCENE, ("film.mp4", "lens320.json")),
    Killed("calibrate", ("calibrate", "boards", "--board", "5x4", "--spacing", "0.05", "--lens",
                         "fisheye", "--solver", "opencv", "-o", "out.yaml"),
           ("out.yaml",), ("boards",)),
)  # fmt: skip


def kill_commands(
    world: Path, folder: Path, count: int, seed: int, only: str = ""
) -> Iterator[tuple[str, str | None]]:
    """Name and what is wrong, or None, of so many kills of each command: half of them at random
    times, half before random changes to files, which lie close together. Of those whose name is
    `only`, else of those whose name has it."""
    zygote = Zygote()
    wanted = [command for command in COMMANDS if command.name == only] or [
        command for command in COMMANDS if only in command.name
    ]
    try:
        for command in wanted:
            yield from _kill_command(command, zygote, world, folder, count, random.Random(seed))
    finally:
        zygote.close()


def _kill_command(
    command: Killed, zygote: Zygote, world: Path, folder: Path, count: int, chance: random.Random
) -> Iterator[tuple[str, str | None]]:
    whole = folder / f"whole {command.name}"
    whole.mkdir()
    copy_needs(command.needs, world, whole)
    started = time.monotonic()
    unbroken = zygote.run(_choose_words(command), whole, after=_find_patience(command))
    took = time.monotonic() - started
    if unbroken["status"] != (-signal.SIGKILL if command.name in PAGES else 0):
        yield command.name, f"unbroken: {unbroken['errors']}"
        return
    wanted = _digest_results(command, whole)
    shutil.rmtree(whole)
    for number in range(count):
        scratch = folder / f"kill-{number}"
        scratch.mkdir()
        copy_needs(command.needs, world, scratch)
        moment: dict[str, Any] = {"after": chance.uniform(FIRST, 1.0) * took}
        if number % 2 and unbroken["changes"]:
            moment = {"before": 1 + chance.randrange(unbroken["changes"]), "after": LONGEST}
        yield command.name, _kill_once(command, zygote, scratch, moment, wanted)
        shutil.rmtree(scratch)


def _choose_words(command: Killed) -> tuple[str, ...]:
    return (*command.words, *VIEWED) if command.name == "train, viewed" else command.words


def _find_patience(command: Killed) -> float:
    return VIEW_SECONDS if command.name in PAGES else LONGEST


def _kill_once(
    command: Killed, zygote: Zygote, scratch: Path, moment: dict[str, Any], wanted: dict[str, str]
) -> str | None:
    """What is wrong after this kill and after what goes on, or None."""
    when = "change {before}".format(**moment) if "before" in moment else f"{moment['after']:.2f} s"
    given = {path: _digest_file(path) for path in _list_files(scratch)}
    zygote.run(_choose_words(command), scratch, **moment)
    half = [path.name for path in _list_files(scratch) if not _is_whole(path)]
    if half:
        return f"killed at {when}: {half} half-written"
    early = {name for name, found in _digest_results(command, scratch).items() if found != "absent"}
    wrong = [name for name in early if _digest_results(command, scratch)[name] != wanted[name]]
    if wrong:
        return f"killed at {when}: {wrong} there with other bits"
    changed = [p.name for p, digest in given.items() if not p.exists() or _digest_file(p) != digest]
    if changed:
        return f"killed at {when}: {changed} changed"
    if command.name == "view":
        return None
    began = (scratch / "out" / MARKER).exists()  # a folder that is not there cannot be resumed
    ended = zygote.run((command.again if began else None) or command.words, scratch)
    done = early == set(wanted) and ended["status"] == 2 and DONE.search(ended["errors"])
    if ended["status"] != 0 and not done:
        return f"killed at {when}, again: {ended['errors']}"
    left = [p.name for p in scratch.rglob("*") if UNFINISHED in p.name]
    if left:
        return f"killed at {when}, again: {left} left"
    found = _digest_results(command, scratch)
    wrong = [name for name in wanted if found[name] != wanted[name]]
    return f"killed at {when}, again: {wrong} with other bits" if wrong else None


def _is_whole(path: Path) -> bool:
    """Whether a file that is there by its own name can be read to its end."""
    if UNFINISHED in str(path):
        return True  # not by its own name
    try:
        if path.suffix == ".json" and path.name != MARKER:
            json.loads(path.read_text())
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as members:
                for name in members:
                    members[name]
        elif path.suffix in (".png", ".jpg"):
            with Image.open(path) as image:
                image.load()
        elif path.suffix == ".ply":
            load_points_ply(path)
    except Exception:
        return False
    return True


def _list_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _digest_file(path: Path) -> str:
    return hashlib.sha1(path.read_bytes()).hexdigest()


def _digest_results(command: Killed, folder: Path) -> dict[str, str]:
    places = {name: folder / name for name in command.results}
    return {name: _digest_file(p) if p.is_file() else "absent" for name, p in places.items()}
