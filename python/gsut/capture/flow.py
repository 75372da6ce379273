"""Measures how the view moves at each chosen frame, by tracking corners to adjacent frames.

A rolling shutter bends a frame by the camera's motion while the frame is read: the flow at that
moment, which frames half a second apart do not show. Nor does the mean over adjacent frames: frames
are chosen for their sharpness, where a shaking hand was slow and sped up before and after.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

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
FRAMES_BESIDE = 2  # on each side, through which a corner's way is a polynomial


_Frame = tuple[int, float, np.ndarray]  # number, seconds, grey picture


class FlowSearch:
    """Finds the flow at some frames of a video, whose frames it receives one by one.

    Args:
        wanted: numbers of the frames.

    Attributes:
        found: by number of the frame, rows of x, y (pixels), and their change per second.
    """

    def __init__(self, wanted: Collection[int]) -> None:
        self.found: dict[int, list[list[float]]] = {}
        self._wanted = wanted
        self._last: list[_Frame] = []
        self._scale = 1.0

    def add(self, number: int, time: float, grey: np.ndarray) -> None:
        """Adds the next frame, (H, W) uint8; frames more than two from a wanted one may be
        skipped."""
        small = shrink_grey(grey, _SIDE)
        self._scale = grey.shape[1] / small.shape[1]
        self._last = [*self._last[-2 * FRAMES_BESIDE :], (number, time, small)]
        self._find(number - FRAMES_BESIDE)

    def finish(self) -> dict[int, list[list[float]]]:
        """Returns `found` after the last frame."""
        for number, _, _ in self._last[-FRAMES_BESIDE:]:
            self._find(number)
        return self.found

    def _find(self, wanted: int) -> None:
        """Finds the flow at a frame if it is wanted and its neighbours have arrived."""
        own = {number: (number, time, picture) for number, time, picture in self._last}
        if wanted not in self._wanted or not {wanted - 1, wanted, wanted + 1} <= own.keys():
            return
        import cv2

        middle = own[wanted]
        found = cv2.goodFeaturesToTrack(middle[2], _CORNERS, 0.01, 0.04 * max(middle[2].shape))
        if found is None:
            return
        corners = found.reshape(-1, 2)
        ways = {
            n: _follow_corners(middle, frame, corners) for n, frame in own.items() if n != wanted
        }
        for reach in range(FRAMES_BESIDE, 0, -1):
            beside = [n for n in range(wanted - reach, wanted + reach + 1) if n != wanted]
            if not own.keys() >= set(beside):
                continue
            times = np.array([own[n][1] for n in beside]) - middle[1]
            speed = np.tensordot(_weigh_slope(times), [ways[n] for n in beside], axes=1)
            good = np.isfinite(speed).all(axis=1)
            if good.sum() >= _FEWEST:
                # cv2 puts the centre of the top-left pixel at (0, 0).
                rows = np.hstack([(corners + 0.5) * self._scale, speed * self._scale])[good]
                self.found[wanted] = np.round(rows, 2).tolist()
                return


def _follow_corners(middle: _Frame, other: _Frame, corners: np.ndarray) -> np.ndarray:
    """Returns how far corners (N, 2) move from one frame to another; NaN if lost."""
    moved = track_corners(middle[2], other[2], corners)
    back = track_corners(other[2], middle[2], moved)
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
