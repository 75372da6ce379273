"""Commands killed at random moments: run again as their own words say, they end with the same bits
or the same result, and nothing stays half-written."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import gsut
import small_videos
import synthetic_boards
from gsut.files import UNFINISHED

LONGEST = 600.0  # seconds by the clock of one command
VIEWED = ("--view", "--no-open")


@dataclasses.dataclass(frozen=True)
class Killed:
    """A command to kill.

    Attributes:
        name: in the counts.
        words: the command.
        again: what goes on after a kill; None: the same command.
        results: files whose bits are compared; of ".json" what is not a time is.
        needs: names in the world.
        share: of all kills.
    """

    name: str
    words: tuple[str, ...]
    results: tuple[str, ...]
    needs: tuple[str, ...]
    again: tuple[str, ...] | None = None
    share: int = 1


TRAIN = ("train", "ds", "-o", "out", "--steps", "120", "--quiet", "--checkpoint-every", "20")
REFINE = ("--refine-poses", "--max-side", "48")
COMMANDS = (
    Killed("train", TRAIN, ("out/scene.ply",), ("ds",), (*TRAIN, "--resume"), 4),
    Killed("train, refined", (*TRAIN, *REFINE), ("out/scene.ply", "out/refined.json"), ("ds",),
           (*TRAIN, *REFINE, "--resume"), 3),
    Killed("train, viewed", TRAIN, ("out/scene.ply",), ("ds",), (*TRAIN, "--resume"), 2),
    Killed("compact", ("compact", "run", "-o", "out", "--keep", "0.5", "--finetune", "60"),
           ("out/scene.ply",), ("ds", "run"), share=3),
    Killed("convert", ("convert", "run", "out.spz", "--for", "viewers", "--steps", "60"),
           ("out.spz",), ("ds", "run"), share=2),
    Killed("mesh", ("mesh", "run", "-o", "out.ply"), ("out.ply",), ("ds", "run"), share=2),
    Killed("render", ("render", "run", "-o", "out", "--frames", "40", "--size", "64x64"),
           ("out/00000.png", "out/00039.png"), ("ds", "run"), share=2),
    Killed("poses", ("poses", "walk.mp4", "-o", "out", "--frames", "8", "--quiet"),
           ("out/transforms.json",), ("walk.mp4",), share=3),
    Killed("scene", ("scene", "walk.mp4", "-o", "out", "--frames", "8", "--steps", "60",
                     "--preset", "fast", "--quiet"), ("out/scene.ply",), ("walk.mp4",), share=2),
    Killed("calibrate", ("calibrate", "boards", "--board", "8x6", "--spacing", "0.05", "--lens",
                         "fisheye", "--solver", "opencv", "-o", "lens/out.yaml"),
           ("lens/out.yaml",), ("boards", "lens"), share=2),
    Killed("view", ("view", "run", "--no-open"), ("run/scene.ply",), ("ds", "run")),
)  # fmt: skip


def add_to_world(world: Path) -> None:
    """A film to walk through and photographs of a board."""
    small_videos.walk(world / "walk.mp4", 40)
    (world / "lens").mkdir()
    (world / "lens" / "mine.txt").write_text("mine\n")
    write_boards(world / "boards")


def write_boards(folder: Path) -> None:
    import cv2
    import numpy as np

    folder.mkdir()
    camera = gsut.Camera("kannala_brandt", [150, 150, 160, 120, 0.01, 0, 0, 0], 320, 240)
    board = synthetic_boards.Board(8, 6, 0.05)
    rng = np.random.default_rng(4)
    poses = synthetic_boards.random_poses(camera, board, 10, 35.0, rng)
    for number, pose in enumerate(poses):
        cv2.imwrite(str(folder / f"{number:02d}.png"), synthetic_boards.draw(camera, board, pose))


def kills(world: Path, folder: Path, count: int, seed: int) -> Iterator[tuple[str, str | None]]:
    """Name and what is wrong, or None, of each of so many kills."""
    chance = random.Random(seed)
    turns = [command for command in COMMANDS for _ in range(command.share)]
    order = [turns[i % len(turns)] for i in range(max(count, 0))]
    wanted: dict[Killed, tuple[dict[str, str], float]] = {}
    for number, command in enumerate(sorted(order, key=COMMANDS.index)):
        scratch = folder / f"kill-{number}"
        if command not in wanted:
            _copy(command, world, scratch)
            started = time.monotonic()
            told = _run(command.words, scratch, until=6.0 if command.name == "view" else None)
            took = time.monotonic() - started
            if told and command.name != "view":
                yield command.name, f"unbroken: {told}"
                continue
            wanted[command] = _results(command, scratch), took
            shutil.rmtree(scratch)
        results, took = wanted[command]
        _copy(command, world, scratch)
        yield command.name, _kill(command, scratch, chance.uniform(0.05, 1.0) * took, results)
        shutil.rmtree(scratch)


def _copy(command: Killed, world: Path, scratch: Path) -> None:
    scratch.mkdir()
    for need in command.needs:
        source, target = world / need, scratch / need
        shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)


def _run(words: tuple[str, ...], folder: Path, until: float | None = None) -> str:
    """Runs a command, killed after so many seconds; its errors where it did not end well."""
    command = [sys.executable, "-m", "gsut", *words]
    with open(folder.with_suffix(".log"), "w+b") as log:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.DEVNULL, stderr=log, start_new_session=True
        )
        try:
            status = process.wait(LONGEST if until is None else until)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            status = process.wait()
        log.seek(0)
        return "" if status == 0 else f"{status}: {log.read()[-400:].decode(errors='replace')}"


def _kill(command: Killed, scratch: Path, after: float, results: dict[str, str]) -> str | None:
    before = {path: _digest(path) for path in _files(scratch)}
    words = (*command.words, *VIEWED) if command.name == "train, viewed" else command.words
    _run(words, scratch, until=after)
    for path in _files(scratch):
        if path.suffix == ".json" and UNFINISHED not in str(path):
            try:
                json.loads(path.read_text())
            except ValueError:
                return f"after {after:.1f} s {path.name} is half-written"
    for name, digest in _results(command, scratch).items():
        if command.again is None and digest not in ("absent", results[name]):
            return f"after {after:.1f} s {name} is there with other bits"
    changed = [p.name for p, digest in before.items() if not p.exists() or _digest(p) != digest]
    if changed:
        return f"after {after:.1f} s {changed} changed"
    if command.name == "view":
        return None
    done = scratch / command.results[0]
    if command.again is None and done.exists() and not (scratch / "out").is_dir():
        return None  # it had ended: a second time would be refused
    told = _run(command.again or command.words, scratch)
    if told and not ("exists" in told or "already holds" in told or "is not empty" in told):
        return f"after {after:.1f} s, again: {told}"
    left = [p.name for p in scratch.rglob("*") if UNFINISHED in p.name]
    if left:
        return f"after {after:.1f} s {left} is left"
    found = _results(command, scratch)
    wrong = [name for name in results if found[name] != results[name]]
    return f"after {after:.1f} s {wrong} has other bits {told}" if wrong else None


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _digest(path: Path) -> str:
    return hashlib.sha1(path.read_bytes()).hexdigest()


def _results(command: Killed, folder: Path) -> dict[str, str]:
    places = {name: folder / name for name in command.results}
    return {name: _digest(p) if p.is_file() else "absent" for name, p in places.items()}
