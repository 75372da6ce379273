"""Parses the page's request for one frame."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import FARTHEST
from gsut.data.poses import check_rigid
from gsut.files import Number
from gsut.orientation import turn_camera, turn_pixel, turn_size
from gsut.view.lenses import check_size

# What a frame can show.
MODES = ("color", "distance", "normal", "alpha", "centers", "error")
# Shares of the Gaussians that a frame can be drawn from: those of a large scene cost more than
# its pixels do.
SHARES = (1.0, 0.5, 0.25)
# Most measured points drawn over a frame.
_MOST_MARKS = 1000
# Pixels above which a frame is large: more than full HD takes seconds on a small machine.
_LARGE_PIXELS = 1920 * 1080
# JPEG quality of a frame at rest, and of a photograph.
FULL_QUALITY = 92
# Shapes of a request's values, see `check_shape`; the page sends null for what is not chosen.
NONE = type(None)
POSE = Number(shape=(16,))
TURNS = Number(0, 3, whole=True)
SIZE = {"lens": Number(whole=True), "width": Number(whole=True), "height": Number(whole=True)}
_VIEW = (NONE, Number(whole=True))
FRAME = SIZE | {
    "pose": POSE, "mode?": str, "view?": _VIEW, "shutter?": _VIEW,
    "layers?": [frozenset({"cameras", "points", "domain"})],
    "marks?": Number(-FARTHEST, FARTHEST, shape=(None, 3)), "quality?": (NONE, Number(5, 100)),
    "share?": Number(), "turns?": TURNS, "edits?": (NONE, str),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class FrameRequest:
    """One frame that the page requests.

    Attributes:
        pose: (4, 4) camera_from_world, scene coordinates.
        lens: its number in `Lenses`.
        width, height: of the image.
        mode: one of MODES.
        view: the photograph whose pose this is, or None.
        shutter: the photograph whose rolling shutter is used, or None.
        layers: names of what is drawn over it: cameras, points, domain.
        marks: (n, 3) measured points.
        quality: of the JPEG; None: a lossless PNG.
        share: of the Gaussians, the most visible ones; below 1 while the eye moves.
        turns: quarter turns clockwise from the image, whose pose, lens and size these are, to the
            picture on the page.
        edits: key of the edits by hand, see `Selections`; None: none.
    """

    pose: np.ndarray
    lens: int
    width: int
    height: int
    mode: str = "color"
    view: int | None = None
    shutter: int | None = None
    layers: frozenset[str] = frozenset()
    marks: np.ndarray | None = None
    quality: int | None = FULL_QUALITY
    share: float = 1.0
    turns: int = 0
    edits: str | None = None

    def turn_back(self, pixel: tuple[float, float]) -> np.ndarray:
        """Returns (2,) where a pixel of the page's picture is in the image."""
        size = turn_size(self.width, self.height, self.turns)
        return np.array(turn_pixel(*pixel, *size, -self.turns))

    @property
    def is_large(self) -> bool:
        """Whether other frames should not wait for this one."""
        return self.width * self.height > _LARGE_PIXELS

    @classmethod
    def parse(cls, values: dict[str, Any], num_views: int) -> FrameRequest:
        """Parses the request of an object of the shape FRAME, whose pose and size are those of the
        page's picture.

        Raises:
            InputError: a value is out of range; the message says which.
        """
        # A photograph's pose keeps its bits on the way through the page.
        pose = np.array(values["pose"], np.float64).reshape(4, 4)
        check_rigid(pose, "the frame's pose")
        turns = int(values.get("turns", 0))
        width, height = turn_size(int(values["width"]), int(values["height"]), turns)
        view, shutter = (
            None if values.get(key) is None else int(values[key]) for key in ("view", "shutter")
        )
        mode, share = values.get("mode", "color"), values.get("share", 1.0)
        quality = values.get("quality", FULL_QUALITY)
        marks = np.array(values.get("marks", []), np.float64).reshape(-1, 3)
        if mode not in MODES:
            raise InputError(f"there is no mode {mode!r}; known: {', '.join(MODES)}")
        check_size(width, height)
        if any(row is not None and not 0 <= row < num_views for row in (view, shutter)):
            raise InputError(f"there is no such photograph; there are {num_views}")
        if share not in SHARES:
            raise InputError(f"share must be one of {SHARES}, found {share}")
        if len(marks) > _MOST_MARKS:
            raise InputError(f"at most {_MOST_MARKS} points are marked, found {len(marks)}")
        return cls(
            turn_camera(pose, -turns), int(values["lens"]), width, height, mode, view, shutter,
            frozenset(values.get("layers", ())), marks, None if quality is None else int(quality),
            share, turns, values.get("edits") or None,
        )  # fmt: skip
