"""`./run bench verdict`: captures of the demo's hall, good and poor, each for its reason.

Each is judged by `gsut poses`; a command that refuses with a sentence has called it poor.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import json
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsut.cli import main
from gsut.lens import Camera
from gsut.sfm.lens.candidates import make_lens
from gsut.sfm.world.comparison import compare_poses
from tests.bench.report_rows import table_text
from tests.bench.walk_film import Film, Path4, film_pictures, walk

HELP = "thirteen captures of the demo's hall, good and poor: whether the verdict is right"
COLUMNS = (
    ("capture", "capture", ""),
    ("expected", "expected", ""),
    ("verdict", "verdict", ""),
    ("centres off [%]", "off", ".2f"),
    ("first reason", "reason", ""),
    ("right", "right", ""),
)
_WIDTH, _HEIGHT, _COUNT = 400, 300, 32
_SECONDS = 16.0
_ZOOM = 1.6
_PLAIN, _WIDE = 11, 12  # seeds of the walks
_OFF = 2.0  # percent of the extent that centres may be off, in the mean
Pictures = list[np.ndarray]


@dataclasses.dataclass(frozen=True)
class Case:
    """A capture.

    Args:
        make: its pictures, of those of two walks: an ordinary lens', and a wide one's.
        expected: levels that are right.
        reason: of a poor one: pattern of its first reason, or of the sentence that refuses it.
        camera: lens that is given, or None.
        seed: of the walk whose pictures they are, in order: poses that are called good or usable
            must be right.
    """

    make: Callable[[Pictures, Pictures], Pictures]
    expected: tuple[str, ...] = ("good",)
    reason: str = ""
    camera: Camera | None = None
    seed: int | None = None


def _path(seed: int) -> Path4:
    return walk(_SECONDS, seed=seed, shake_degrees=0.3)


def _walk(field: float, bend: float, seed: int) -> Pictures:
    camera = make_lens(_WIDTH, _HEIGHT, field, bend)
    film = Film(
        camera, _path(seed), _SECONDS, _COUNT / _SECONDS, readout=0.0, exposure=0.0, seed=seed
    )
    return list(film_pictures(film))


def _blurred(pictures: Pictures, pixels: float) -> Pictures:
    import cv2

    return [cv2.GaussianBlur(picture, (0, 0), pixels) for picture in pictures]


def _times(pictures: Pictures, gains: np.ndarray) -> Pictures:
    noise = np.random.default_rng(1)
    return [
        np.clip(gain * p + noise.normal(0, 2, p.shape), 0, 255).astype(np.uint8)
        for gain, p in zip(gains, pictures, strict=True)
    ]


def _turned() -> Pictures:
    """What a camera sees that turns in one place."""
    around = walk(_SECONDS, seed=13, around=0.0, looking=1.2, shake_degrees=0.3)

    def path(times: np.ndarray) -> np.ndarray:
        poses = around(times)
        poses[:, :3, 3] = [2.0, 1.0, 1.5]
        return poses

    camera = make_lens(_WIDTH, _HEIGHT, 72, 1.0)
    film = Film(camera, path, _SECONDS, 1.0, readout=0.0, exposure=0.0, seed=13)
    return list(film_pictures(film))


def _far_apart(pictures: Pictures) -> Pictures:
    """Few parts of pictures that hardly show the same."""
    width = pictures[0].shape[1]
    return [
        np.ascontiguousarray(p[:, : width // 2] if i % 2 else p[:, width // 2 :])
        for i, p in enumerate(pictures[::2])
    ]


def _zoomed(pictures: Pictures) -> Pictures:
    """Every second one zoomed in."""
    import cv2

    middle = (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2
    zoom = cv2.getRotationMatrix2D(middle, 0.0, _ZOOM)
    return [
        cv2.warpAffine(p, zoom, (_WIDTH, _HEIGHT), flags=cv2.INTER_CUBIC) if i % 2 else p
        for i, p in enumerate(pictures)
    ]


_ONES = np.ones(_COUNT)
CAPTURES: dict[str, Case] = {
    "a walk": Case(lambda plain, wide: plain, seed=_PLAIN),
    "a wide lens": Case(lambda plain, wide: wide, seed=_WIDE),
    "held upright": Case(lambda plain, wide: [np.rot90(p).copy() for p in plain], seed=_PLAIN),
    "drifting light": Case(
        lambda plain, wide: _times(plain, 0.8 + 0.25 * np.sin(np.arange(_COUNT) / 4)), seed=_PLAIN
    ),
    "a little blurred": Case(
        lambda plain, wide: _blurred(plain, 0.8), ("good", "usable"), seed=_PLAIN
    ),
    "fifteen pictures": Case(lambda plain, wide: wide[:15], ("usable",), "views", seed=_WIDE),
    "four pictures": Case(lambda plain, wide: plain[:4], ("poor",), "only 4 views|are few"),
    "far apart": Case(
        lambda plain, wide: _far_apart(plain), ("poor",), "connect|overlap|no lens tried"
    ),
    "in the dark": Case(lambda plain, wide: _times(plain, 0.06 * _ONES), ("poor",), "dark"),
    "blurred": Case(lambda plain, wide: _blurred(plain, 6.0), ("poor",), "blurred"),
    "another lens given": Case(
        lambda plain, wide: wide, ("poor",), "agree|off by", make_lens(_WIDTH, _HEIGHT, 45, 1.0)
    ),
    "turned on the spot": Case(lambda plain, wide: _turned(), ("poor",), "turn"),
    "two zooms": Case(lambda plain, wide: _zoomed(plain), ("usable", "poor"), "2 zooms"),
}


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--captures", metavar="NAMES", default="all", help="comma-separated [default: all]"
    )
    parser.add_argument("--json", metavar="FILE", help="write the rows here")


def run(arguments: argparse.Namespace) -> int:
    wanted = arguments.captures.split(",")
    plain, wide = _walk(72, 1.0, _PLAIN), _walk(115, 0.3, _WIDE)
    rows = []
    with tempfile.TemporaryDirectory(prefix="gsut-verdict-") as folder:
        for name, case in CAPTURES.items():
            if arguments.captures == "all" or name in wanted:
                rows.append(judge(name, case, case.make(plain, wide), Path(folder) / name))
                print(f"{name}: {rows[-1]['words']}", flush=True)
    print(table_text(rows, COLUMNS))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(rows, indent=1) + "\n")
    return 0 if all(row["right"] == "yes" for row in rows) else 1


def judge(name: str, case: Case, pictures: Pictures, folder: Path) -> dict[str, Any]:
    """The row of one capture."""
    import cv2

    (folder / "in").mkdir(parents=True)
    for i, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"in/{i:03d}.jpg"), picture[:, :, ::-1])
    words = ["poses", str(folder / "in"), "-o", str(folder / "out"), "--quiet"]
    if case.camera is not None:
        case.camera.save(folder / "lens.yaml")
        words += ["--camera", str(folder / "lens.yaml")]
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        refused = main(words) != 0
    if refused:
        level, reasons = "poor", [said.getvalue().strip()]
    else:
        verdict = json.loads((folder / "out/poses.json").read_text())["verdict"]
        level, reasons = verdict["level"], verdict["reasons"]
    first = reasons[0] if reasons else ""
    off = None if refused or case.seed is None else _centers_off(folder / "out", case.seed)
    right = level in case.expected and re.search(case.reason, first) is not None
    right = right and (off is None or off < _OFF)
    return {
        "capture": name,
        "expected": " or ".join(case.expected),
        "verdict": level + (", refused" if refused else ""),
        "off": off,
        "reason": first[:90],
        "right": "yes" if right else "NO",
        "words": "; ".join([level, *reasons]),
    }


def _centers_off(data: Path, seed: int) -> float:
    """Root mean squared distance of the cameras from the walk, in percent of its extent."""
    frames = json.loads((data / "transforms.json").read_text())["frames"]
    found = {Path(frame["file_path"]).stem: np.array(frame["transform_matrix"]) for frame in frames}
    numbers = np.array(sorted(map(int, found)))
    poses = np.array([found[f"{number:03d}"] for number in numbers])
    poses[:, :3, 1:3] *= -1  # OpenGL's axes
    true = _path(seed)(numbers * _SECONDS / _COUNT)
    return compare_poses(np.linalg.inv(poses), np.linalg.inv(true)).ate_percent
