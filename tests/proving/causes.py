"""Plants one cause of a bad training in a capture, and asks whether the verdict names it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.proving.commands import run_gsut

_TURN_DEGREES = 1.2  # of each pose, about an axis of its own
_LONGER = 1.12  # than the true focal length
_FEW_VIEWS = 5
_EVERY = 8  # views are held out by default, from this place on:
_FIRST = 4
_FAST = ("--preset", "fast")

Values = dict[str, Any]


def _keep(values: Values, rng: np.random.Generator) -> None:
    """Leaves everything right."""


def _turn_poses(values: Values, rng: np.random.Generator) -> None:
    for frame in values["frames"]:
        axis = rng.normal(size=3)
        turn = cv2.Rodrigues(axis / np.linalg.norm(axis) * math.radians(_TURN_DEGREES))[0]
        for key in [key for key in frame if key.startswith("transform_matrix")]:
            pose = np.array(frame[key])
            pose[:3, :3] = pose[:3, :3] @ turn
            frame[key] = pose.tolist()


def _lengthen_lens(values: Values, rng: np.random.Generator) -> None:
    for holder in (values, *values["frames"]):
        holder.update({key: _LONGER * holder[key] for key in ("fl_x", "fl_y") if key in holder})


def _drop_views(values: Values, rng: np.random.Generator) -> None:
    frames = values["frames"]
    held = frames[_FIRST::_EVERY]
    others = [frame for frame in frames if frame not in held]
    left = others[:: max(1, len(others) // _FEW_VIEWS)]
    values["frames"] = sorted(held + left, key=lambda frame: frame["file_path"])


# Name -> what is changed in transforms.json, how it is trained, what the verdict says of it.
CAUSES: dict[str, tuple[Callable[[Values, np.random.Generator], None], tuple[str, ...], str]] = {
    "few steps": (_keep, ("--steps", "60"), "steps and Gaussians are few"),
    "few Gaussians": (_keep, (*_FAST, "--max-gaussians", "1000"), "steps and Gaussians are few"),
    "few views": (_drop_views, _FAST, "too few photographs"),
    "wrong poses": (_turn_poses, _FAST, "poses or the lens are wrong"),
    "wrong lens": (_lengthen_lens, _FAST, "poses or the lens are wrong"),
}


def score_causes(data: Path, work: Path, seed: int) -> dict[str, Any]:
    """Trains on a dataset with each cause; a row of what the verdict said.

    Args:
        data: an exact dataset.
        work: an existing folder.
        seed: of what is drawn.

    Returns:
        cause_NAME: True if the verdict names it, None if the result is good in spite of it, else
        the reasons that it gives.
    """
    row: dict[str, Any] = {}
    for name, (change, words, says) in CAUSES.items():
        folder, out = (work / f"{name.replace(' ', '-')}-{part}" for part in ("data", "run"))
        _copy_changed(data, folder, change, np.random.default_rng([seed, 51]))
        outcome = run_gsut("train", folder, "-o", out, "--quiet", "--force", *words, work=work)
        if outcome.status != 0:
            row[f"cause_{name}"] = outcome.last_line
            continue
        verdict = json.loads((out / "metrics.json").read_text("utf-8"))["verdict"]
        reasons = "; ".join(verdict["reasons"])
        row[f"cause_{name}"] = None if verdict["level"] == "good" else says in reasons or reasons
    return row


def _copy_changed(
    data: Path, folder: Path, change: Callable[[Values, Any], None], rng: np.random.Generator
) -> None:
    folder.mkdir()
    for each in data.iterdir():
        if each.name != "transforms.json":
            (folder / each.name).symlink_to(each)
    values = json.loads((data / "transforms.json").read_text("utf-8"))
    change(values, rng)
    (folder / "transforms.json").write_text(json.dumps(values), encoding="utf-8")
