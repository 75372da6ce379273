"""How the view moves at each frame chosen: corners followed to the frames beside it.

A rolling shutter bends a frame by what the camera moves while the frame is read: the flow at that
moment, which frames half a second apart do not tell.
"""

from __future__ import annotations

import numpy as np

from gsut.capture.choose import shrunk_grey, track_corners

_SIDE = 480  # longer side of the frames that corners are followed in, pixels
_CORNERS = 40
_RETURN = 0.3  # pixels there, within which a corner that is followed there and back returns
_FEWEST = 8


class FlowSearch:
    """Takes a video's frames one by one, and finds the flow at those wanted.

    Attributes:
        found: by number of the frame rows of x, y (pixels), and their change in a second.
    """

    def __init__(self) -> None:
        self.found: dict[int, list[list[float]]] = {}
        self._last: list[tuple[int, float, np.ndarray]] = []
        self._scale = 1.0

    def add(self, number: int, time: float, grey: np.ndarray, wanted: bool) -> None:
        """Takes the next frame, (H, W) uint8; `wanted`: the frame before it was chosen."""
        small = shrunk_grey(grey, _SIDE)
        self._scale = grey.shape[1] / small.shape[1]
        self._last = [*self._last[-2:], (number, time, small)]
        if wanted and len(self._last) == 3:
            self._find(*self._last)

    def _find(self, *frames: tuple[int, float, np.ndarray]) -> None:
        """Of the middle one of three frames."""
        import cv2

        (before, start, first), (number, _, middle), (after, end, last) = frames
        if after - before != 2 or not end > start:
            return
        found = cv2.goodFeaturesToTrack(middle, _CORNERS, 0.01, 0.04 * max(middle.shape))
        if found is None:
            return
        corners = found.reshape(-1, 2)
        ends = []
        for other in (first, last):
            moved = track_corners(middle, other, corners)
            back = track_corners(other, middle, moved)
            lost = ~(np.linalg.norm(back - corners, axis=1) < _RETURN)
            moved[lost] = np.nan
            ends.append(moved)
        speed = (ends[1] - ends[0]) / (end - start)
        good = np.isfinite(speed).all(axis=1)
        if good.sum() < _FEWEST:
            return
        # cv2 puts the centre of the top-left pixel at (0, 0).
        rows = np.hstack([(corners + 0.5) * self._scale, speed * self._scale])[good]
        self.found[number] = np.round(rows, 2).tolist()
