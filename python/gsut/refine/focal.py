"""An error of a photograph's focal length: whether its colours show it, and how far the pose moves.

A pose adapts to a wrong focal length: the camera steps back until the picture fits again but for
parallax. Linear estimates at that pose find little of the error, since parallax is beyond what
slopes follow. So costs are compared, of lenses that are a little longer and shorter with the pose
moved along, and where one is lower, the focal length is found with the smaller photographs, where
parallax is less than a pixel.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import Shutter, SolveError, moved_pose
from gsut.refine.pixel_rows import POSE, compute_losses, estimate_step, estimate_sum_error
from gsut.refine.pose import Photograph, scale_focal_length
from gsut.refine.secants import SecantPose, place_lines
from gsut.render import render

# Pixels by which the lenses that are compared move the corners of the picture: less is the grain of
# renders, more hides small errors.
_CORNER_SHIFT = 0.5
# Standard deviations by which another focal length must lower the cost to count as better.
_CLEAR = 2.5
# Error of the logarithm of the focal length that small photographs do not show.
_BLUR = 0.0125
# Logarithm of the factor on the focal length from which another lens took the photograph.
_OTHER_LENS = 0.75


def measure_focal_error(
    photograph: Photograph,
    fine: SecantPose,
    shutter: Shutter | None,
    widening: float,
    levels: range,
) -> tuple[float, np.ndarray]:
    """Measures what the focal length is wrong by, and how far the pose is off for it.

    Args:
        photograph: with the lens, whose first parameters are fx and fy.
        fine: its pose through this lens. shutter: with which it was refined.
        widening: factor on the standard deviations of noise.
        levels: how often the photograph is halved where the focal length is found.

    Returns:
        The logarithm of the factor on the focal length with which colours fit best, and (6,) the
        error of the pose, at least that of the error which small photographs do not show; zeros
        where no other focal length fits better.

    Raises:
        SolveError: no focal length that is at all near fits.
    """
    better, along = _compare_focal_lengths(photograph, fine, shutter, widening)
    if better == 0:
        return 0.0, np.zeros(POSE)
    best = photograph.refine_coarsely(
        fine.camera_from_world, levels, True, with_focal_length=True
    ).focal_change
    if abs(best) >= _OTHER_LENS:
        raise SolveError(
            "the photograph was not found in the scene: its colours would fit a focal length times "
            f"{np.exp(best):.1f} or beyond; another lens took it: give its own with --camera"
        )
    return best, max(abs(best), _BLUR) * along


def _compare_focal_lengths(
    photograph: Photograph, fine: SecantPose, shutter: Shutter | None, widening: float
) -> tuple[int, np.ndarray]:
    """Compares a longer and a shorter lens with the given one.

    Returns:
        1 or -1 where the longer or the shorter one fits better, 0 where neither does, and (6,) the
        change of the pose with the logarithm of the focal length.
    """
    camera, rows = photograph.camera, fine.rows
    colors = photograph.pixels.reshape(-1, 3)[rows.pixels]
    slopes = rows.stack_slopes(shutter)
    step = 2 * _CORNER_SHIFT / float(np.hypot(camera.width, camera.height))

    def compare(size: float, change: np.ndarray) -> np.ndarray:
        moves, gains = change[:-2], np.add(fine.gain, change[-2:])
        motion = fine.motion + (moves[POSE:] if len(moves) > POSE else 0.0)
        where = place_lines(moved_pose(fine.camera_from_world, moves[:POSE], 1.0), motion, shutter)
        seen = render(
            photograph.scene, scale_focal_length(camera, size), where,
            background=photograph.background, watch=False,
        ).image.reshape(-1, 3)[rows.pixels]  # fmt: skip
        return gains[0] * seen.astype(np.float64) + gains[1] - colors

    still = np.zeros(slopes.shape[2])
    by_focal = (compare(step, still) - compare(-step, still)) / (2 * step)
    along = estimate_step(dataclasses.replace(rows, residuals=by_focal), slopes)
    least = compute_losses(compare(0.0, still))
    better, lowest = 0, 0.0
    for sign in (1, -1):
        gains = compute_losses(compare(sign * step, sign * step * along)) - least
        gain = float(gains.sum())
        if gain < min(lowest, -_CLEAR * widening * estimate_sum_error(rows, gains)):
            better, lowest = sign, gain
    return better, along[:POSE]
