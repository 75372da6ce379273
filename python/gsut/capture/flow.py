"""Measures how the view moves at each chosen frame, by tracking corners to adjacent frames.

A rolling shutter bends a frame by the camera's motion while the frame is read: the flow at that
moment, which frames half a second apart do not show. Nor does the mean over adjacent frames: frames
are chosen for their sharpness, where a shaking hand was slow and sped up before and after.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
from collections.abc import Collection, Mapping

import numpy as np

from gsut.capture.ahead import WorkAhead
from gsut.capture.choose import shrink_grey, track_corners

# Longer side in pixels of the frames that corners are tracked in.
_SIDE = 480
# Corners that are tracked at a frame: enough for a shutter's few unknowns.
_CORNERS = 40
# Pixels of the small frame within which a corner tracked there and back returns.
_RETURN = 0.3
# Fewest corners that are worth keeping.
_FEWEST = 8
# Frames on each side through which a corner's way is a polynomial.
FRAMES_BESIDE = 2


@dataclasses.dataclass(frozen=True)
class FlowFrame:
    """A frame that corners are tracked in: a small grey picture, and pixels of the file to one."""

    number: int
    time: float
    small: np.ndarray
    scale: float


def shrink_frame(number: int, time: float, grey: np.ndarray) -> FlowFrame:
    """Shrinks a frame, (H, W) uint8 of any size."""
    small = shrink_grey(grey, _SIDE)
    return FlowFrame(number, time, small, grey.shape[1] / small.shape[1])


class FlowSearch:
    """Finds the flow at some frames of a video, whose frames it receives one by one.

    Args:
        wanted: numbers of the frames.
        pool: threads that track corners.
    """

    def __init__(self, wanted: Collection[int], pool: concurrent.futures.Executor) -> None:
        self._wanted = wanted
        self._last: list[FlowFrame] = []
        self._found = WorkAhead[tuple[int, list[list[float]] | None]](pool)

    def add(self, frame: FlowFrame) -> None:
        """Adds the next frame; frames more than two from a wanted one may be skipped."""
        self._last = [*self._last[-2 * FRAMES_BESIDE :], frame]
        self._find(frame.number - FRAMES_BESIDE)

    def finish(self) -> dict[int, list[list[float]]]:
        """Returns the flow: by number of the frame, rows of x, y (pixels), and their change per
        second."""
        for frame in self._last[-FRAMES_BESIDE:]:
            self._find(frame.number)
        return {number: rows for number, rows in self._found.take_all() if rows is not None}

    def _find(self, wanted: int) -> None:
        """Finds the flow at a frame if it is wanted and its neighbours have arrived."""
        own = {frame.number: frame for frame in self._last}
        if wanted in self._wanted and {wanted - 1, wanted, wanted + 1} <= own.keys():
            self._found.submit(_find_flow, wanted, own)


def _find_flow(wanted: int, own: Mapping[int, FlowFrame]) -> tuple[int, list[list[float]] | None]:
    """Returns a frame's number and its flow, None where too few corners are tracked.

    Args:
        own: the frame and those around it, by their numbers.
    """
    import cv2

    middle = own[wanted]
    side = max(middle.small.shape)
    found = cv2.goodFeaturesToTrack(middle.small, _CORNERS, 0.01, 0.04 * side)
    if found is None:
        return wanted, None
    corners = found.reshape(-1, 2)
    ways = {n: _follow_corners(middle, frame, corners) for n, frame in own.items() if n != wanted}
    for reach in range(FRAMES_BESIDE, 0, -1):
        beside = [n for n in range(wanted - reach, wanted + reach + 1) if n != wanted]
        if not own.keys() >= set(beside):
            continue
        times = np.array([own[n].time for n in beside]) - middle.time
        speed = np.tensordot(_weigh_slope(times), [ways[n] for n in beside], axes=1)
        good = np.isfinite(speed).all(axis=1)
        if good.sum() >= _FEWEST:
            # cv2 puts the centre of the top-left pixel at (0, 0).
            rows = np.hstack([(corners + 0.5) * middle.scale, speed * middle.scale])[good]
            return wanted, np.round(rows, 2).tolist()
    return wanted, None


def _follow_corners(middle: FlowFrame, other: FlowFrame, corners: np.ndarray) -> np.ndarray:
    """Returns how far corners (N, 2) move from one frame to another; NaN if lost."""
    moved = track_corners(middle.small, other.small, corners)
    back = track_corners(other.small, middle.small, moved)
    lost = ~(np.linalg.norm(back - corners, axis=1) < _RETURN)
    moved[lost] = np.nan
    return moved - corners


def _weigh_slope(times: np.ndarray) -> np.ndarray:
    """Returns the weights (N,) of values at times (N,) in a polynomial's slope at 0.

    The polynomial goes through the values, and through 0 at time 0. NaN if times coincide.
    """
    nodes = times / max(float(np.abs(times).max()), 1e-12)
    powers = nodes ** np.arange(1, len(nodes) + 1)[:, None]
    if abs(np.linalg.det(powers)) < 1e-9:
        return np.full(len(nodes), np.nan)
    wanted = np.zeros(len(nodes))
    wanted[0] = 1.0
    return np.linalg.solve(powers, wanted) * nodes[-1] / times[-1]
