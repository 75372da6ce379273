"""Checks of pictures: those that a capture chose, and those that poses are found for."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut.judge.checks.check import Check, judge
from gsut.run import Verdict

# Share of bad pictures, or of a picture's matches that poses reject, above which the others no
# longer make up for them; where no more than these are good, a result is poor.
MANY = 0.25


@dataclasses.dataclass(frozen=True)
class PictureQuality:
    """What pictures are like for whoever finds poses for them.

    Attributes:
        images: number of all.
        dark, bright: numbers of underexposed and overexposed ones.
        featureless: number of those without a pose that have few features.
    """

    images: int
    dark: int
    bright: int
    featureless: int


PICTURE_CHECKS: tuple[Check[PictureQuality], ...] = (
    Check(
        "exposure", lambda q: (q.dark + q.bright) / max(1, q.images), MANY, 1 - MANY,
        lambda q: f"{q.dark} of {q.images} images are too dark, {q.bright} too bright",
        "film with more light and a fixed exposure",
    ),
    Check(
        "features", lambda q: q.featureless / max(1, q.images), MANY, 1 - MANY,
        lambda q: f"{q.featureless} of {q.images} images have few features: blurred, dark or "
        "without texture",
        "keep something with texture in view, in focus and well lit, and hold the camera still",
    ),
)  # fmt: skip


def judge_pictures(figures: dict[str, Any]) -> Verdict:
    """Judges the pictures that a capture chose; whether they are enough, held-out views show.

    Args:
        figures: of a capture: "frames", a row for each picture, and "size".
    """
    rows, (width, height) = figures["frames"], figures["size"]
    blurred = sum(bool(row.get("blurred")) for row in rows)
    sharpness: Check[int] = Check(
        "sharpness", lambda blurred: blurred / max(1, len(rows)), MANY, 1.0,
        lambda blurred: f"{blurred} of them blurred", "film more slowly, or with more light",
    )  # fmt: skip
    return judge([sharpness], blurred, f"{len(rows)} pictures of {width} x {height}", "")
