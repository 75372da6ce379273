"""Whether the frames of a video were read line by line, and how fast: from their own motion.

The flow of the video tells how fast the camera moved at each frame; the residuals of poses without
a rolling shutter tell whether lines were bent by that, and how long a readout takes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gsut._core import Shutter, SolveError
from gsut.lens import Camera
from gsut.sfm.core import (
    Features,
    Moving,
    PairMatches,
    PosesOptions,
    Solution,
    choose_connected_pairs,
    keep_most_distinct,
    refine_registered,
)
from gsut.sfm.shutter.frame_motion import rates_of_frames
from gsut.sfm.shutter.readout_by_flow import FlowReadout, readout_by_flow

_FEWEST = 8  # images whose motion is known
_LONGEST = 0.05  # seconds that a readout takes at most
_KNOWN = 0.1  # share of the time that two standard deviations may be, for it to be known
# Standard deviations from nothing, at least, and images that keep a pose.
_CLEAR, _KEPT = 4.0, 0.95
# The time is corrected so often at most, on so many images, until a step is this share of it; a
# correction is at least that share of what is missing. Velocities stay meanwhile.
_CORRECTIONS, _IMAGES, _SETTLED, _LEAST_SLOPE, _HELD = 5, 30, 0.03, 0.25, 0.0
_MATCHES = 150  # of a pair meanwhile: the most distinct
# Of the diagonal: less motion during a readout is not worth the time that training takes longer.
# The first estimate falls short by about that factor.
_MATTERS, _SHORT = 1e-3, 2.0
_USUAL_READOUT = 0.015  # seconds
_OBLONG = 1.2  # sides of a picture: less tells nothing of how the sensor was held
_BACKWARDS = {"top_to_bottom": "bottom_to_top", "left_to_right": "right_to_left"}


@dataclasses.dataclass(frozen=True)
class VideoShutter:
    """What was found.

    Args:
        solution: with a rolling shutter, or as it was.
        readout: None: not determined, and the shutter counts as global.
    """

    solution: Solution
    readout: FlowReadout | None

    @property
    def is_known(self) -> bool:
        """Whether the time is known to 10 % (two standard deviations)."""
        return self.readout is not None and 2 * self.readout.sigma <= _KNOWN * self.readout.time

    def words(self) -> str:
        """A sentence."""
        found = self.readout
        if found is None or self.solution.shutter is None:
            return (
                "the readout time of the shutter is not determined by this video, and each frame "
                "counts as taken in one moment: the camera moved too little for it to matter, its "
                "shutter is global, or the video was stabilised in the camera"
            )
        order = self.solution.shutter.direction.replace("_", " ")
        doubt = "" if self.is_known else ", which is not known to 10 %"
        return (
            f"rolling shutter: lines are read {order} in {1000 * found.time:.1f} ms (standard "
            f"deviation {1000 * found.sigma:.1f} ms{doubt})"
        )

    def figures(self) -> dict[str, Any]:
        """Of poses.json."""
        found = self.readout
        return {
            "seconds": found.time if found else None,
            "sigma_seconds": found.sigma if found else None,
        }


def find_video_shutter(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    flows: Mapping[str, np.ndarray],
    lens_free: np.ndarray | None,
    on_progress: Callable[[float, str], None],
    on_step: Callable[[int, int, int, str], None] = lambda *_: None,
) -> VideoShutter:
    """Looks for a rolling shutter in a solution without one.

    Lines are taken to run along the longer side of the picture, as those of a sensor do.

    Args:
        solution: poses of frames. features: of all images. pairs: verified.
        options: see PosesOptions.
        flows: see `rates_of_frames`, in seconds.
        lens_free: see `solve`.
        on_progress: told which share of finding the time is done, and words.
        on_step: told of the adjustment with it, see `solve`.
    """
    nothing = VideoShutter(solution, None)
    rates, spread = rates_of_frames(solution, flows)
    if np.isfinite(rates).all(axis=1).sum() < _FEWEST or len(set(solution.cameras)) > 1:
        return nothing
    found, forward = None, ""
    for direction in _directions(solution.cameras[0]):
        along_y = direction == "top_to_bottom"
        other = readout_by_flow(solution, rates, spread, along_y, lens_free, options.loss_scale)
        if other and (found is None or other.clearness > found.clearness):
            found, forward = other, direction
    if found is None or found.clearness < _CLEAR or abs(found.time) > _LONGEST:
        return nothing
    camera = solution.cameras[0]
    if not _matters(_SHORT * abs(found.time), flows, camera.width, camera.height):
        return nothing
    sign = 1 if found.time > 0 else -1
    shutter = Shutter(forward if sign > 0 else _BACKWARDS[forward])
    try:
        readout = _settled(
            solution, features, pairs, options, rates, spread, lens_free, shutter,
            FlowReadout(abs(found.time), found.sigma), on_progress,
        )  # fmt: skip
        if not 0 < readout.time < _LONGEST:
            return nothing
        moved = refine_registered(
            solution, features, pairs, options, lens_free=lens_free,
            moving=Moving(shutter, readout.time, rates), on_progress=on_step,
        )  # fmt: skip
    except SolveError:
        return nothing
    kept = moved.num_registered >= _KEPT * solution.num_registered
    return VideoShutter(moved, readout) if kept else nothing


def _settled(
    solution: Solution,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    rates: np.ndarray,
    spread: np.ndarray,
    lens_free: np.ndarray | None,
    shutter: Shutter,
    found: FlowReadout,
    on_progress: Callable[[float, str], None],
) -> FlowReadout:
    """The readout time at which the residuals ask for no other one.

    Poses without a rolling shutter have lost the observations that speak most for one: each
    correction falls short, by a share that the last two tell (the secant method).
    """
    some = _some_images(solution, pairs, rates)
    few = keep_most_distinct(pairs, _MATCHES)
    sign = 1 if shutter.direction in _BACKWARDS else -1
    time, slope, before = found.time, 1 / _SHORT, None
    for number in range(_CORRECTIONS):
        on_progress(number / _CORRECTIONS, f"lines read in {1000 * time:.1f} ms?")
        moving = Moving(shutter, time, rates, _HELD, extend=False)
        moved = refine_registered(
            solution, features, few, options, only=some, lens_free=lens_free, moving=moving
        )
        along_y = "top" in shutter.direction
        more = readout_by_flow(moved, rates, spread, along_y, lens_free, options.loss_scale)
        if more is None:
            break
        own, found = sign * more.time, more
        if before is not None and abs(time - before[0]) > _SETTLED * time:
            slope = float(np.clip((before[1] - own) / (time - before[0]), _LEAST_SLOPE, 1.0))
        before = time, own
        time += own / slope
        if abs(own / slope) < _SETTLED * time or not 0 < time < _LONGEST:
            break
    # What a correction falls short by, its standard deviation does too.
    return FlowReadout(
        time / found.reliability, found.sigma / (slope * found.reliability), found.reliability
    )


def _some_images(solution: Solution, pairs: Sequence[PairMatches], rates: np.ndarray) -> list[int]:
    """Images with a pose and a rate that are well connected with each other."""
    good = solution.registered & np.isfinite(rates).all(axis=1)
    own = [pair for pair in pairs if good[pair.first] and good[pair.second]]
    chosen = choose_connected_pairs(own, _IMAGES) if own else []
    return sorted({image for pair in chosen for image in (pair.first, pair.second)})


def probably_rolling(flows: Mapping[str, np.ndarray], width: int, height: int) -> bool:
    """Whether a readout as long as most cameras' would be found in the flow of such pictures."""
    return bool(flows) and _matters(_USUAL_READOUT, flows, width, height)


def _matters(time: float, flows: Mapping[str, np.ndarray], width: int, height: int) -> bool:
    """Whether pictures move enough, in the median, during a readout of so many seconds."""
    speeds = [np.linalg.norm(flow[:, 2:], axis=1) for flow in flows.values()]
    moved = time * float(np.median(np.concatenate(speeds)))
    return moved >= _MATTERS * math.hypot(width, height)


def _directions(camera: Camera) -> list[str]:
    """Orders of lines to try: along the longer side, where one is longer."""
    both = ["top_to_bottom", "left_to_right"]
    if max(camera.width, camera.height) < _OBLONG * min(camera.width, camera.height):
        return both
    return both[:1] if camera.width > camera.height else both[1:]
