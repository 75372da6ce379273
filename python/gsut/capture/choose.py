"""Chooses frames of a video by how far the view moved and by sharpness, never every n-th.

Corners are tracked (Lucas-Kanade, in pyramids) on small grey frames. A first pass finds candidates
a short step of the view apart, each the sharpest of the frames near there; frames are then chosen
among them, evenly along the way of the view.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut.capture.ahead import WorkAhead

# Least motion of the median corner between candidates, x the picture's diagonal.
_LEAST_STEP = 0.004
# Most motion of the median corner between candidates, x the picture's diagonal.
_MOST_STEP = 0.008
# Motion that is assumed if most corners are lost, x the diagonal: a cut, or a sudden turn.
_LOST_STEP = 0.15
# Motion between chosen frames, x the diagonal, if their number allows it.
_CHOSEN_STEP = 0.05
# Fewest frames that are chosen if there are candidates: fewer make a poor scene.
_FEWEST = 60
# Fewest candidates of a video that has as many frames: poses need that many, and corners cannot be
# followed through a slide show.
FEWEST_CANDIDATES = 20
# Most frames that are chosen: more take long and add little.
_MOST = 300
# Corners that are tracked; more do not change their median.
_CORNERS = 200
# Corners below which motion cannot be measured: a blank wall, darkness.
_FEWEST_CORNERS = 12
# Share of corners followed to the next frame below which it shows another scene.
_CUT = 0.1
# Share of corners followed to the next frame above which it shows the same scene.
_FOLLOWED = 0.5
# Pixels within which a corner that is followed to a frame and back comes back.
_COMES_BACK = 1.0
# Seconds between candidates if motion cannot be measured.
_BLANK_SECONDS = 0.5
# Longer side in pixels of the frames that corners are tracked in.
_TRACKED_SIDE = 320
# Longer side in pixels of the frames that sharpness is measured in.
_JUDGED_SIDE = 800
# Share of the way between two chosen frames in which the sharpest is sought.
_MIDDLE = 0.5
# Sharpness, x the median of the frames around, below which a frame is blurred.
_BLURRED = 0.4
# Frames on each side that a frame's sharpness is compared with.
_NEIGHBOURS = 5


@dataclasses.dataclass(frozen=True)
class Look:
    """What the search needs of a frame: sharpness, see `Candidate`, and a small grey picture."""

    number: int
    time: float
    sharpness: float
    small: np.ndarray


def look_at(number: int, time: float, grey: np.ndarray) -> Look:
    """Looks at a frame, (H, W) uint8 of any size; frames can be looked at beside each other."""
    sharpness = _measure_sharpness(shrink_grey(grey, _JUDGED_SIDE))
    return Look(number, time, sharpness, shrink_grey(grey, _TRACKED_SIDE))


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A frame that may be chosen.

    Attributes:
        number: of the frame, from 0 in the order of the file.
        time: seconds from the video's start.
        sharpness: variance of the Laplacian, in grey levels squared.
        moved: motion of the view since the candidate before, x the picture's diagonal.
    """

    number: int
    time: float
    sharpness: float
    moved: float


class CandidateSearch:
    """Finds candidates among a video's frames, which it receives one by one.

    Args:
        pool: threads that follow corners back, beside the caller that follows them on.
    """

    def __init__(self, pool: concurrent.futures.Executor) -> None:
        self.candidates: list[Candidate] = []
        self.frames: list[Candidate] = []  # all of them, without their motion
        self._corners: np.ndarray | None = None  # (N, 2) where those of the last candidate are now
        self._start: np.ndarray = np.zeros((0, 2), np.float32)  # where they were in it
        self._before: np.ndarray | None = None  # the frame before
        self._best: tuple[Candidate, np.ndarray] | None = None  # since the last candidate
        self.cuts: list[float] = []  # seconds at which another scene begins
        self._was_followed = False  # whether the frame before shows what that before it did
        self._doubt: float | None = None  # seconds of a cut unless the next frame is one as well
        # Seconds of frames, and the share of corners that was followed to each.
        self._followed = WorkAhead[tuple[float, float | None]](pool)

    def add(self, look: Look | None) -> None:
        """Adds the next frame; None, a damaged one, is left out."""
        if look is None:
            return
        time, small = look.time, look.small
        frame = Candidate(look.number, time, look.sharpness, 0.0)
        self.frames.append(frame)
        if self._before is None:
            self._commit(frame, small)
            self._before = small
            return
        corners = self._corners
        self._corners = track_corners(self._before, small, corners)
        self._followed.submit(_measure_followed, time, self._before, small, corners, self._corners)
        for row in self._followed.take_due():
            self._find_cut(*row)
        self._before = small
        moved = self._measure_motion(time, small)
        if moved < _LEAST_STEP:
            return
        frame = dataclasses.replace(frame, moved=moved)
        if moved <= _MOST_STEP:
            if self._best is None or frame.sharpness > self._best[0].sharpness:
                self._best = frame, small
            return
        if self._best is None:
            self._commit(frame, small)
            return
        self._commit(*self._best)
        self._corners = track_corners(self._best_picture, small, self._corners)
        moved = self._measure_motion(time, small)
        if moved >= _LEAST_STEP:
            self._best = dataclasses.replace(frame, moved=moved), small

    def finish(self) -> list[Candidate]:
        """Returns all candidates after the last frame."""
        if self._best is not None:
            self._commit(*self._best)
        for row in self._followed.take_all():
            self._find_cut(*row)
        return self.candidates

    def _commit(self, frame: Candidate, small: np.ndarray) -> None:
        import cv2

        self.candidates.append(frame)
        found = cv2.goodFeaturesToTrack(small, _CORNERS, 0.01, 0.02 * max(small.shape))
        self._start = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2)
        self._corners = self._start
        self._best, self._best_picture = None, small

    def _find_cut(self, time: float, share: float | None) -> None:
        """Finds a cut: no corner is followed from one frame to the next, as they were to that
        frame and are from it. A turn or a flash loses them for several frames."""
        share = 0.5 * (_CUT + _FOLLOWED) if share is None else share  # nothing is known
        if self._doubt is not None and share > _FOLLOWED:
            self.cuts.append(self._doubt)
        self._doubt = time if self._was_followed and share < _CUT else None
        self._was_followed = share > _FOLLOWED

    def _measure_motion(self, time: float, small: np.ndarray) -> float:
        """Returns the median corner's motion since the last candidate; lost corners went far."""
        if len(self._start) < _FEWEST_CORNERS:
            return _MOST_STEP * (time - self.candidates[-1].time) / _BLANK_SECONDS
        assert self._corners is not None
        way = np.linalg.norm(self._corners - self._start, axis=1)
        median = float(np.median(np.where(np.isfinite(way), way, np.inf)))
        return min(median / float(np.hypot(*small.shape)), _LOST_STEP)


def choose_frames(candidates: Sequence[Candidate], count: int | None = None) -> list[int]:
    """Returns the indices of the candidates to keep, in order.

    Args:
        candidates: of one video.
        count: number to keep; None: 60 to 300 by how far the view moved.
    """
    way = np.cumsum([c.moved for c in candidates])
    if count is None:
        count = int(np.clip(round(way[-1] / _CHOSEN_STEP) + 1, _FEWEST, _MOST))
    if count >= len(candidates):
        return list(range(len(candidates)))
    sharp = np.array([c.sharpness for c in candidates])
    step = way[-1] / max(1, count - 1)
    chosen: list[int] = []
    for place in range(count):
        first = chosen[-1] + 1 if chosen else 0
        last = len(candidates) - (count - place)  # those to come need one each
        away = np.abs(way[first : last + 1] - place * step)
        near = first + np.flatnonzero(away <= max(_MIDDLE / 2 * step, away.min()))
        chosen.append(int(near[np.argmax(sharp[near])]))
    return chosen


def add_candidates(
    candidates: Sequence[Candidate], frames: Sequence[Candidate], count: int | None = None
) -> list[Candidate]:
    """Adds frames, evenly over the video and the sharpest near there, where candidates are few.

    Args:
        candidates: of one video.
        frames: all frames of that video.
        count: number of frames wanted; None: 20 are enough.

    Returns:
        The candidates and the added frames, which share the motion between two candidates.
    """
    wanted = min(FEWEST_CANDIDATES if count is None else count, len(frames))
    if len(candidates) >= wanted:
        return list(candidates)
    chosen = {c.number for c in candidates}
    free = [frame for frame in frames if frame.number not in chosen]
    for part in np.array_split(np.arange(len(free)), wanted - len(chosen)):
        chosen.add(max((free[i] for i in part), key=lambda frame: frame.sharpness).number)
    numbers = [c.number for c in candidates]
    way = np.cumsum([c.moved for c in candidates])
    rows = [frame for frame in frames if frame.number in chosen]
    steps = np.diff(np.interp([row.number for row in rows], numbers, way), prepend=0.0)
    return [dataclasses.replace(r, moved=float(s)) for r, s in zip(rows, steps, strict=True)]


def find_blurred(candidates: Sequence[Candidate]) -> np.ndarray:
    """Returns (N,) bool: frames far less sharp than those around them."""
    sharp = np.array([c.sharpness for c in candidates])
    around = [
        np.median(sharp[max(0, i - _NEIGHBOURS) : i + _NEIGHBOURS + 1]) for i in range(len(sharp))
    ]
    return sharp < _BLURRED * np.array(around)


def shrink_grey(grey: np.ndarray, longer: int) -> np.ndarray:
    """Shrinks a grey picture (H, W) so that its longer side has at most `longer` pixels."""
    import cv2

    scale = longer / max(grey.shape)
    if scale >= 1:
        return grey
    size = max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def _measure_followed(
    time: float,
    before: np.ndarray,
    after: np.ndarray,
    start: np.ndarray | None,
    end: np.ndarray | None,
) -> tuple[float, float | None]:
    """Returns the time and the share of corners that come back where they were; None: too few."""
    alive = np.isfinite(np.zeros((0, 2)) if start is None else start).all(axis=1)
    if alive.sum() < _FEWEST_CORNERS:
        return time, None
    assert start is not None
    away = np.linalg.norm(track_corners(after, before, end) - start, axis=1)[alive]
    return time, float(np.mean(away < _COMES_BACK))


def _measure_sharpness(grey: np.ndarray) -> float:
    import cv2

    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def track_corners(before: np.ndarray, after: np.ndarray, corners: np.ndarray | None) -> np.ndarray:
    """Tracks corners (N, 2) of one grey frame to another; NaN if lost."""
    import cv2

    corners = np.zeros((0, 2), np.float32) if corners is None else corners
    found = corners.copy()
    alive = np.isfinite(corners).all(axis=1)
    found[~alive] = np.nan
    if not alive.any():
        return found
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        before, after, corners[alive].reshape(-1, 1, 2), np.empty(0), winSize=(15, 15), maxLevel=3
    )
    moved = moved.reshape(-1, 2)
    height, width = after.shape
    inside = (moved >= 0).all(axis=1) & (moved < (width, height)).all(axis=1)
    found[alive] = np.where((inside & (status.ravel() == 1))[:, None], moved, np.nan)
    return found
