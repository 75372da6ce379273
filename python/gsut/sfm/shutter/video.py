"""Finds whether the frames of a video were read line by line, and how fast, from their motion.

The flow of the video shows how fast the camera moved at each frame; the residuals of poses without
a rolling shutter show whether lines were bent by that, and how long a readout takes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import Shutter, SolveError
from gsut.judge import KEPT, SURE
from gsut.lens import Camera
from gsut.sampling import FEWEST_SAMPLES
from gsut.sfm.gyroscope import USUAL_READOUT, sharpen_rates
from gsut.sfm.lens import GROUPS
from gsut.sfm.mapping import Mapping
from gsut.sfm.matches import PairMatches, choose_connected_pairs, keep_most_distinct
from gsut.sfm.photographs import ImageLines
from gsut.sfm.shutter.agreement import find_better_order, reverse_lines
from gsut.sfm.shutter.correction import LONGEST_READOUT, USUALLY_SHORT, correct_readout
from gsut.sfm.shutter.readout import (
    FlowReadout,
    estimate_rates,
    estimate_readout_by_flow,
)
from gsut.sfm.solution import Adjustment, ReadoutMotion, Solution, measure_line_times

# Motion during a readout over the diagonal that is worth the time that training takes longer.
_MATTERS = 1e-3
_OBLONG = 1.2  # ratio of a picture's sides from which it shows how the sensor was held


@dataclasses.dataclass(frozen=True)
class VideoShutter:
    """The shutter of a video.

    Args:
        solution: with a rolling shutter, or the one given.
        readout: None: not determined, and the shutter counts as global.
        signs: standard deviations of the readout time from nothing; None: not measured.
    """

    solution: Solution
    readout: FlowReadout | None
    signs: float | None = None

    def describe(self) -> str:
        """Describes the shutter in a sentence."""
        found = self.readout
        if found is None or self.solution.shutter is None:
            return (
                "the readout time of the shutter is not determined by this video, and each frame "
                "counts as taken in one moment: the camera moved too little for it to matter, its "
                "shutter is global, or the video was stabilised in the camera"
            )
        orders = dict.fromkeys(shutter.direction for shutter in self.solution.shutters if shutter)
        order = " and ".join(orders).replace("_", " ")
        return (
            f"rolling shutter: lines are read {order} in {1000 * found.time:.1f} ms (standard "
            f"deviation {1000 * found.sigma:.1f} ms)"
        )


def find_shutter(mapping: Mapping) -> Mapping:
    """Finds the rolling shutter of a video of which nothing is said, and adds it to the figures.

    Returns:
        The run, whose solution is then one with a rolling shutter, and the figures.
    """
    solution = mapping.solved
    figures: dict[str, Any] = {}
    is_unknown = solution.shutter is None and mapping.options.shutter == "auto"
    if is_unknown and mapping.photographs.flows:
        lines = find_video_shutter(mapping)
        mapping = mapping.replace(solution=lines.solution)
        solution = mapping.solved
        (mapping.log.keep if solution.shutter is None else mapping.log.note)(lines.describe())
        found = lines.readout
        if lines.signs is not None:
            figures["shutter_signs"] = lines.signs
        figures["shutter"] = solution.shutter.direction if solution.shutter else "global"
        figures["readout"] = {
            "seconds": found.time if found else None,
            "sigma_seconds": found.sigma if found else None,
        }
    elif solution.shutter is None:
        figures["shutter"] = "global"
    else:
        figures["shutter"] = solution.shutter.direction
        figures["readout"] = {"given": mapping.options.readout_time}
    return mapping.add_findings(figures)


def estimate_velocities(mapping: Mapping) -> tuple[np.ndarray, np.ndarray]:
    """Estimates velocities of the images, see `estimate_rates`, by the gyroscope too."""
    return sharpen_rates(mapping, estimate_rates(mapping.solved, mapping.photographs.flows))


def find_video_shutter(mapping: Mapping) -> VideoShutter:
    """Looks for a rolling shutter in a solution without one.

    Lines are taken to run along the longer side of the picture, as those of a sensor do; of two
    lenses along the same side.
    """
    solution = mapping.solved
    if len(set(solution.cameras)) > 1:
        return VideoShutter(solution, None)
    rates, spread = estimate_velocities(mapping)
    order, signs = find_line_order(mapping, (rates, spread), mapping.one_lens_free)
    nothing = VideoShutter(solution, None, signs)
    order = order or _find_order_by_matches(mapping, rates)
    if order is None:
        return nothing
    some = _choose_images(solution, mapping.pairs, rates)
    trial = dataclasses.replace(solution, registered=some, lines=order.lines)

    def adjust_trial(time: float) -> Solution:
        return _adjust_trial(mapping, trial, rates, order.shutter, time)

    try:
        readout = correct_readout(
            mapping, (rates, spread), order.first, adjust_trial, mapping.one_lens_free
        )
        if readout is None:
            return nothing
        motion = ReadoutMotion(order.shutter, readout.time, rates)
        moved = mapping.adjust(
            Adjustment(mapping.lens_free, lens_settled=True, motion=motion, extend=True),
            dataclasses.replace(solution, lines=order.lines), stage="shutter",
        )  # fmt: skip
    except SolveError:
        return nothing
    kept = moved.num_registered >= KEPT * solution.num_registered
    return VideoShutter(moved, readout, signs) if kept else nothing


def _adjust_trial(
    mapping: Mapping, trial: Solution, rates: np.ndarray, shutter: Shutter | None, time: float
) -> Solution:
    """Adjusts some images with a readout time; their velocities are the rates' exactly."""
    motion = None
    if shutter is not None:
        motion = ReadoutMotion(shutter, time, rates, sigma=0.0)
    adjustment = Adjustment(mapping.one_lens_free, motion=motion)
    return mapping.adjust(adjustment, trial, keep_most_distinct(mapping.pairs))


def _find_order_by_matches(mapping: Mapping, rates: np.ndarray) -> LineOrder | None:
    """Finds the order of the lines of one lens, and a first time, by `find_better_order`."""
    solution, flows = mapping.solved, mapping.photographs.flows
    camera, some = solution.cameras[0], _choose_images(solution, mapping.pairs, rates)
    if mapping.photographs.rig_cameras is not None or some.sum() < GROUPS:
        return None
    if not is_probably_rolling(flows, camera.width, camera.height):
        return None
    trial = dataclasses.replace(solution, registered=some)
    pairs = keep_most_distinct(mapping.pairs)
    pairs = [pair for pair in pairs if some[pair.first] and some[pair.second]]

    def adjust(shutter: Shutter | None) -> Solution:
        return _adjust_trial(mapping, trial, rates, shutter, USUAL_READOUT)

    try:
        found = find_better_order(adjust, mapping.features, pairs, list_likely_shutters(camera))
    except SolveError:
        return None
    if found is None:
        return None
    shutter, share = found
    return LineOrder(FlowReadout(share * USUAL_READOUT, math.inf), shutter, None)


@dataclasses.dataclass(frozen=True)
class LineOrder:
    """The order in which lines are read, and a first readout time, which is too short.

    Args:
        first: of the longest readout.
        shutter: of the first lens.
        lines: of each image, where two lenses differ.
    """

    first: FlowReadout
    shutter: Shutter
    lines: ImageLines | None


def find_line_order(
    mapping: Mapping, velocities: tuple[np.ndarray, np.ndarray], lens_free: np.ndarray | None
) -> tuple[LineOrder | None, float | None]:
    """Finds the order of the lines, of each lens where there are two.

    Args:
        velocities: rates and their covariances, see `estimate_rates`.
        lens_free: see `estimate_readout_by_flow`.

    Returns:
        None where nothing speaks for a rolling shutter, or it matters too little; and the standard
        deviations of the readout time from nothing, None where too few images show it.
    """
    solution, (rates, spread) = mapping.solved, velocities
    of_image = mapping.photographs.rig_cameras
    if of_image is None:
        of_image = np.zeros(len(solution.names), np.int64)
    if np.isfinite(rates).all(axis=1).sum() < GROUPS:
        return None, None

    def estimate(ways: Sequence[Shutter]) -> _Trial:
        shutters = [ways[each] for each in of_image]
        is_same = len({way.direction for way in ways}) == 1
        lines = None if is_same else ImageLines(shutters, np.ones(len(shutters)))
        found = estimate_readout_by_flow(
            solution, rates, spread, measure_line_times(solution, shutters, lines), lens_free,
        )  # fmt: skip
        return _Trial(found or FlowReadout(0.0, math.inf), list(ways), lines)

    trials = [
        estimate(ways)
        for forward in list_likely_shutters(solution.cameras[0])
        for ways in _list_ways(forward, int(of_image.max()) + 1)
    ]
    best = max(trials, key=lambda each: each.found.clearness)
    found, camera = best.found, solution.cameras[0]
    signs = found.clearness
    if signs < SURE or abs(found.time) > LONGEST_READOUT:
        return None, signs
    flows = mapping.photographs.flows
    if not _has_enough_motion(USUALLY_SHORT * abs(found.time), flows, camera.width, camera.height):
        return None, signs
    return best.turn_forward(), signs


@dataclasses.dataclass(frozen=True)
class _Trial:
    """A readout time for an order of the lines of each lens; below 0 they are read backwards."""

    found: FlowReadout
    ways: list[Shutter]
    lines: ImageLines | None

    def turn_forward(self) -> LineOrder:
        """Returns the order in which the time is above 0."""
        first = FlowReadout(abs(self.found.time), self.found.sigma)
        if self.found.time > 0:
            return LineOrder(first, self.ways[0], self.lines)
        turned = [reverse_lines(way) for way in self.ways]
        lines = self.lines
        if lines is not None:
            shutters = [None if way is None else reverse_lines(way) for way in lines.shutters]
            lines = ImageLines(shutters, lines.readouts)
        return LineOrder(first, turned[0], lines)


def _list_ways(forward: Shutter, lenses: int) -> list[list[Shutter]]:
    """Lists how the lenses may read their lines: all alike, or every other one backwards."""
    alike = [forward] * lenses
    if lenses == 1:
        return [alike]
    return [alike, [reverse_lines(forward) if lens % 2 else forward for lens in range(lenses)]]


def _choose_images(
    solution: Solution, pairs: Sequence[PairMatches], rates: np.ndarray
) -> np.ndarray:
    """Chooses (N,) bool images with a pose and a rate that are well connected with each other."""
    good = solution.registered & np.isfinite(rates).all(axis=1)
    own = [pair for pair in pairs if good[pair.first] and good[pair.second]]
    chosen = choose_connected_pairs(own, FEWEST_SAMPLES) if own else []
    images = {image for pair in chosen for image in (pair.first, pair.second)}
    return np.isin(np.arange(len(good)), list(images))


def is_probably_rolling(flows: dict[str, np.ndarray], width: int, height: int) -> bool:
    """Returns whether a usual readout would be found in the flow of pictures of this size."""
    return bool(flows) and _has_enough_motion(USUAL_READOUT, flows, width, height)


def _has_enough_motion(time: float, flows: dict[str, np.ndarray], width: int, height: int) -> bool:
    """Returns whether pictures move enough, in the median, during a readout (seconds)."""
    speeds = [np.linalg.norm(flow[:, 2:], axis=1) for flow in flows.values()]
    moved = time * float(np.median(np.concatenate(speeds)))
    return moved >= _MATTERS * math.hypot(width, height)


def list_likely_shutters(camera: Camera) -> list[Shutter]:
    """Lists shutters whose lines run along the longer side, or both ways if neither is longer.

    Of each pair that only differ by the order of the lines one stands for both: the motion has a
    sign.
    """
    both = [Shutter("top_to_bottom"), Shutter("left_to_right")]
    width, height = camera.width, camera.height
    if max(width, height) < _OBLONG * min(width, height):
        return both
    return both[:1] if width > height else both[1:]
