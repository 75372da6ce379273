"""Plants one cause of a bad training in a capture, and asks which one the verdict names."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gsut.data.images import decode_image
from gsut.files import write_picture
from lab.proving.commands import run_training

_TURN_DEGREES = 1.2  # of each pose, about an axis of its own
_LONGER = 1.15  # than the true focal length
_FEW_VIEWS = 3
_EVERY = 8  # views are held out by default, from this place on:
_FIRST = 4
_TALL = (0.5, 0.9)  # of something that moves, over the picture's height
_SWAY = (0.1, 0.06)  # of what stays in the middle, over the picture's width and height
_SLIM = 0.4  # its width over its height
_STRIDE = (0.06, 0.14)  # from picture to picture, over the picture's width
# Small and short, so that a table of all causes takes minutes.
_FAST = ("--preset", "fast", "--max-side", "200", "--steps", "350", "--max-gaussians", "20000")
GOOD = "good"
NOTHING = "nothing"  # wrong
# Words of a verdict -> the cause that they name, the first that is found.
_NAMES = {
    "the poses are wrong": "poses",
    "the lens is wrong": "lens",
    "poses or the lens are wrong": "poses or lens",
    "wrong poses or a wrong lens": "poses or lens",
    "too few photographs": "few photographs",
    "something moved": "movers",
    "steps and Gaussians are few": "steps or Gaussians",
    "moved past": "movers",
}

# Of metrics.json, that a verdict is made from.
_FIGURES = (
    "detail_median", "detail_train", "detail_shifted_median", "psnr", "moving_train", "patch_train",
)  # fmt: skip

Values = dict[str, Any]
Change = Callable[[Values, Path, np.random.Generator], None]


def _keep(values: Values, folder: Path, rng: np.random.Generator) -> None:
    """Leaves everything right."""


def _turn_poses(values: Values, folder: Path, rng: np.random.Generator) -> None:
    for frame in values["frames"]:
        axis = rng.normal(size=3)
        turn = cv2.Rodrigues(axis / np.linalg.norm(axis) * math.radians(_TURN_DEGREES))[0]
        for key in [key for key in frame if key.startswith("transform_matrix")]:
            pose = np.array(frame[key])
            pose[:3, :3] = pose[:3, :3] @ turn
            frame[key] = pose.tolist()


def _lengthen_lens(values: Values, folder: Path, rng: np.random.Generator) -> None:
    for holder in (values, *values["frames"]):
        holder.update({key: _LONGER * holder[key] for key in ("fl_x", "fl_y") if key in holder})


def _drop_views(values: Values, folder: Path, rng: np.random.Generator) -> None:
    frames = values["frames"]
    held = frames[_FIRST::_EVERY]
    others = [frame for frame in frames if frame not in held]
    chosen = np.unique(np.linspace(0, len(others) - 1, _FEW_VIEWS).round().astype(int))
    left = [others[number] for number in chosen]
    values["frames"] = sorted(held + left, key=lambda frame: frame["file_path"])


def _add_mover(values: Values, folder: Path, rng, tall=_TALL, stays: bool = False) -> None:
    """Paints somebody before the scene who walks past, or turns and `stays` in the middle."""
    look, tall = rng.uniform(30, 225, (9, 4, 3)).astype(np.float32), rng.uniform(*tall)
    place, stride = rng.uniform(0, 1), rng.uniform(*_STRIDE)
    foot = rng.uniform(0.75, 1.0)
    (folder / "moving").mkdir()
    for number, frame in enumerate(values["frames"]):
        image = decode_image(folder / frame["file_path"])[0]
        height, width = image.shape[:2]
        axes = 0.5 * tall * height * np.array([_SLIM, 1.0])
        middle = np.array([(place + number * stride) % 1.0 * width, foot * height - axes[1]])
        if stays:
            sway = np.sin([1.3 * number + 6 * place, 2.1 * number]) * _SWAY
            middle, look = (0.5 + sway) * (width, height), np.roll(look, 1, axis=0)
        y, x = np.mgrid[:height, :width] + 0.5
        inside = (((np.dstack([x, y]) - middle) / axes) ** 2).sum(axis=2) < 1
        box = np.maximum(1, (2 * axes).astype(int))
        paint = cv2.resize(look, (int(box[0]), int(box[1])), interpolation=cv2.INTER_CUBIC)
        column = np.clip(x[inside] - middle[0] + axes[0], 0, box[0] - 1).astype(int)
        row = np.clip(y[inside] - middle[1] + axes[1], 0, box[1] - 1).astype(int)
        painted = image.copy()
        painted[inside] = np.clip(paint[row, column], 0, 255)
        # Nothing is painted where the lens sees nothing.
        painted[~image.any(axis=2)] = 0
        name = f"moving/{number:03d}.png"
        write_picture(folder / name, painted[..., ::-1])
        frame["file_path"] = name


@dataclasses.dataclass(frozen=True)
class Cause:
    """A cause of a bad training.

    Attributes:
        plant: changes transforms.json, or pictures, of a copy.
        words: of `gsut train`.
        named: what a verdict may name; `GOOD` is right, too, where the cause did no harm.
    """

    plant: Change
    words: tuple[str, ...]
    named: tuple[str, ...]


CAUSES = {
    NOTHING: Cause(_keep, _FAST, ("steps or Gaussians", "few photographs")),
    "few steps": Cause(_keep, (*_FAST, "--steps", "20"), ("steps or Gaussians",)),
    "few Gaussians": Cause(_keep, (*_FAST, "--max-gaussians", "300"), ("steps or Gaussians",)),
    "few views": Cause(_drop_views, _FAST, ("few photographs",)),
    "walking movers": Cause(_add_mover, _FAST, ("movers",)),
    "small movers": Cause(partial(_add_mover, tall=(0.15, 0.3)), _FAST, ("movers",)),
    "middle movers": Cause(partial(_add_mover, tall=(0.3, 0.6), stays=True), _FAST, ("movers",)),
    "large movers": Cause(partial(_add_mover, tall=(0.7, 0.9), stays=True), _FAST, ("movers",)),
    "wrong poses": Cause(_turn_poses, _FAST, ("poses", "poses or lens")),
    "wrong lens": Cause(_lengthen_lens, _FAST, ("lens", "poses or lens")),
}


def score_causes(data: Path, work: Path, seed: int, only: str = "") -> dict[str, Any]:
    """Trains on a dataset with each cause; a row of what the verdict said.

    Args:
        data: an exact dataset.
        work: an existing folder.
        seed: of what is drawn.
        only: word in the names of the causes that are planted, beside none.

    Returns:
        cause_NAME: the cause that the verdict names, `GOOD`, or the reasons that it gives;
        figures_NAME: what the verdict was made from.
    """
    row: dict[str, Any] = {}
    for name, cause in CAUSES.items():
        if only not in name and name != NOTHING:
            continue
        folder, out = (work / f"{name.replace(' ', '-')}-{part}" for part in ("data", "run"))
        copy_changed(data, folder, cause.plant, np.random.default_rng([seed, 51]))
        outcome, metrics = run_training(folder, out, "--force", *cause.words, work=work)
        if not metrics:
            row[f"cause_{name}"] = outcome.last_line
            continue
        row[f"cause_{name}"] = name_cause(metrics["verdict"])
        row[f"figures_{name}"] = {key: metrics.get(key) for key in _FIGURES} | {
            "cpu_seconds": outcome.cpu_seconds,
            "views": metrics["train_views"],
        }
    return row


def find_wrong_cause(row: dict[str, Any], name: str) -> str | None:
    """Returns what a verdict said of a planted cause if that is wrong, else None."""
    said = row.get(f"cause_{name}")
    return None if said in (None, GOOD, *CAUSES[name].named) else said


def name_cause(verdict: dict[str, Any]) -> str:
    """Names the cause that a verdict gives: `GOOD` if there is none, its reasons if unknown."""
    reasons = "; ".join(verdict["reasons"])
    unknown = GOOD if verdict["level"] == "good" else reasons
    return next((cause for words, cause in _NAMES.items() if words in reasons), unknown)


def copy_changed(data: Path, folder: Path, change: Change, rng: np.random.Generator) -> None:
    """Copies a dataset, its pictures as links, and changes the copy."""
    folder.mkdir()
    for each in data.iterdir():
        if each.name != "transforms.json":
            (folder / each.name).symlink_to(each.resolve())
    values = json.loads((data / "transforms.json").read_text("utf-8"))
    change(values, folder, rng)
    (folder / "transforms.json").write_text(json.dumps(values), encoding="utf-8")
