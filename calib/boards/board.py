"""Describes the chessboard and its photographs, and groups photographs by camera and moment.

All of calib uses the pixels of OpenCV and mrcal: (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import BoardError

_SIZE = re.compile(r"(?<!\d)(\d+)\s*[xX×,]\s*(\d+)")
_FEWEST_CORNERS_A_SIDE = 3  # OpenCV's detectors find no smaller boards


@dataclass(frozen=True)
class Board:
    """A flat chessboard.

    Args:
        columns, rows: inner corners (where four squares meet) along and across.
        spacing: side of a square; its unit, such as metres, becomes that of the rig's poses.
    """

    columns: int
    rows: int
    spacing: float

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < _FEWEST_CORNERS_A_SIDE:
            raise BoardError(
                f"a board of {self.columns} x {self.rows} inner corners is too small; "
                f"count the corners where four squares meet: at least "
                f"{_FEWEST_CORNERS_A_SIDE} each way"
            )
        if not (np.isfinite(self.spacing) and self.spacing > 0):
            raise BoardError(f"the side of a square must be > 0, found {self.spacing}")

    @classmethod
    def parse(cls, size: str, spacing: float) -> Board:
        """Reads the number of corners from text such as "9x6".

        Raises:
            BoardError: the text has another form, or no board can have these numbers.
        """
        match = _SIZE.fullmatch(size.strip())
        if match is None:
            raise BoardError(
                f"the board must be given as COLUMNSxROWS, such as 9x6; found {size!r}"
            )
        return cls(int(match[1]), int(match[2]), float(spacing))

    @property
    def corners(self) -> int:
        """Number of inner corners."""
        return self.columns * self.rows

    def locate_corners(self, warp: Sequence[float] | None = None) -> np.ndarray:
        """Returns (corners, 3) positions in the board's frame, row by row.

        x points along a row, y across the rows, z away from the board.

        Args:
            warp: how far the board's middle lies off the plane of its edges, bent along x and
                along y (mrcal's two numbers), in the unit of `spacing`; None: flat, z = 0.
        """
        y, x = np.mgrid[0 : self.rows, 0 : self.columns]
        flat = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) * self.spacing
        if warp is not None:
            flat[:, 2] = self.bow @ np.asarray(warp, float)
        return flat

    @functools.cached_property
    def bow(self) -> np.ndarray:
        """The z (corners, 2) that a warp of 1 along x and along y gives each corner.

        Each column is a parabola that is 0 at the first and the last corner.
        """
        y, x = np.mgrid[0 : self.rows, 0 : self.columns]
        part = np.stack([x / (self.columns - 1), y / (self.rows - 1)], axis=-1).reshape(-1, 2)
        return 4 * part * (1 - part)

    def __str__(self) -> str:
        return f"{self.columns} x {self.rows}"


@dataclass
class Photograph:
    """One image file and what was found in it.

    Args:
        path: the file. camera: name of the rig's camera. frame: equal for images taken together.
        width, height: in pixels.
        corners: (corners, 2) pixels in the order of `Board.locate_corners`; None: no board found.
        reason: why no board was found. detector: the name of the detector that found it.
        edge_width: pixels over which black turns to white at the squares' edges.
        other_size: corners along and across of a board of another size, or of a part of one.
    """

    path: Path
    camera: str
    frame: str
    width: int = 0
    height: int = 0
    corners: np.ndarray | None = None
    reason: str = ""
    detector: str = ""
    edge_width: float = float("nan")
    other_size: tuple[int, int] | None = None


def assign_cameras(paths: Sequence[Path], cameras: Sequence[str]) -> list[Photograph]:
    """Assigns each image to a camera of the rig, and to the frame of images taken together.

    The last occurrence of a camera's name in the path decides; the rest of the path names the
    frame, as in left12.jpg and right12.jpg, or cam0/12.png and cam1/12.png.

    Args:
        paths: image files.
        cameras: names of the rig's cameras; at most one name means a single camera.

    Raises:
        BoardError: a path holds no camera's name, an image is given twice, or a camera has no
            image.
    """
    resolved = [Path(os.path.realpath(path)) for path in paths]  # tolerates links to themselves
    twice = {path for path in resolved if resolved.count(path) > 1}
    if twice:
        raise BoardError(f"{min(twice)} is given twice; give every image once")
    if len(cameras) <= 1:
        name = cameras[0] if cameras else "camera"
        return [Photograph(path, name, str(path)) for path in paths]
    if len(set(cameras)) != len(cameras):
        raise BoardError(f"the cameras of a rig need different names, found {', '.join(cameras)}")
    photographs = []
    for path in paths:
        text = path.as_posix()
        position, name = max((text.rfind(name), name) for name in cameras)
        if position < 0:
            raise BoardError(
                f"{path}: its name holds none of the cameras' names {', '.join(cameras)}"
            )
        frame = text[:position] + "*" + text[position + len(name) :]
        photographs.append(Photograph(path, name, frame))
    for name in cameras:
        if not any(photograph.camera == name for photograph in photographs):
            raise BoardError(f"no image of camera {name}: no path holds its name")
    return photographs


def split_numbers(text: str) -> list:
    """Splits text into words and numbers: a sorting key that puts left2.jpg before left10.jpg."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", text)]
