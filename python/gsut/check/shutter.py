"""Finds a rolling shutter where poses are of a global one, and a clock a part of a frame late."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.check.epipolar import rate_matches
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_fit import (
    LEAST_EFFECT,
    find_line_rays,
    fit_numbers,
    measure_line_errors,
)
from gsut.check.matches import order_in_time
from gsut.check.turns import to_rotation_vector
from gsut.data import Scene
from gsut.gaussians import rotations_from_quaternions
from gsut.sfm.points import measure_angular_errors
from gsut.significance import convert_to_normal

_SIGMAS = 4.0  # standard deviations from which a time is not chance
_LEAST_SHIFT = 2.0  # thousandths of the diagonal, by which a time shifts what is worth a note
_STEP = 0.01  # frames: of the differences that give the errors' derivatives
_STARTS = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.75, -0.75)  # frames of either time
_KNOWN = 1.0  # frames: neither readout nor delay is much longer than the time between two frames
_MOST = 0.3  # frames that a time changes in one iteration
# Frames that a readout takes at most, as the next one starts after it; and a delay, since the
# velocities of the poses hold from one frame to the next.
_LONGEST = 1.0
_FEWEST_VIEWS = 5  # of a path, which give velocities


@dataclasses.dataclass(frozen=True)
class Timing:
    """Readout of a rolling shutter and delay, fitted to the matches with the poses' velocities.

    Args:
        frames: (2,) readout from the first line to the last, below 0 upwards, and time from the
            given poses to the images; of the time between two views.
        sigmas: (2,) standard deviations, by the jackknife over views.
        shifts: (2,) thousandths of the diagonal by which the image moves during each, median.
        significance: (2,) in standard deviations of a normal law that are as rare.
        effect: of both on the errors, see `fit_numbers`.
        cost: of the matches with the poses of the lines, from 0 to 1.
    """

    frames: np.ndarray
    sigmas: np.ndarray
    shifts: np.ndarray
    significance: np.ndarray
    effect: float
    cost: float


def check_timing(evidence: Evidence, most: float) -> list[Finding]:
    """Names a rolling shutter, or a delay, of which the poses know nothing.

    Args:
        evidence: of the photographs.
        most: cost, from 0 to 1, that the matches have at most with the poses of the lines.
    """
    timing = fit_timing(evidence)
    if timing is None or timing.cost > most or timing.effect < LEAST_EFFECT:
        return []
    sure = (timing.significance > _SIGMAS) & (timing.shifts > _LEAST_SHIFT)
    sure &= np.abs(timing.frames) < _LONGEST
    (readout, delay), sigmas = timing.frames, timing.sigmas
    if sure[1] and timing.significance[1] > timing.significance[0]:
        what = (
            f"when each image takes the pose of {abs(delay):.2f} +- {sigmas[1]:.2f} frames "
            f"{'later' if delay > 0 else 'earlier'}"
        )
        advice = "shift the poses' clock against the images' by as much"
    elif sure[0]:
        what = (
            "a rolling shutter, whose readout from the "
            f"{'first to the last' if readout > 0 else 'last to the first'} line takes "
            f"{abs(readout):.2f} +- {sigmas[0]:.2f} of the time between two images, than the "
            "poses' global one"
        )
        advice = (
            "find poses of the lines (`gsut poses --shutter rolling`), or write "
            "transform_matrix_start and _end of each image"
        )
    else:
        return []
    return [evidence.make_finding("warning", f"the photographs fit better {what}", advice)]


def fit_timing(evidence: Evidence) -> Timing | None:
    """Fits both times; None if poses have lines of their own, or the path has no velocities."""
    scene, m = evidence.scene, evidence.matches
    if evidence.table.poses.shape[1] > 1:
        return None
    speeds = _measure_speeds(scene)
    views = evidence.table.rows[..., 0]
    if not np.isfinite(speeds[views]).any():
        return None
    height = np.array([camera.height for camera in scene.cameras])[m.lens]
    line = m.pixels[..., 1] / height - 0.5
    poses = evidence.table.select_poses()
    rays = find_line_rays(scene.cameras, m)

    def find_poses(x: np.ndarray) -> np.ndarray:
        return move_poses(poses, speeds[views], x[0] * line + x[1])

    def find_errors(x: np.ndarray) -> np.ndarray:
        return measure_line_errors(rays, find_poses(x))

    def rate(x: np.ndarray) -> float:
        errors = measure_angular_errors(evidence.rays, find_poses(x))
        return rate_matches(errors, m, evidence.focal)

    starts = [frames * axis for frames in _STARTS for axis in np.eye(2)]
    x, covariance, effect = fit_numbers(
        find_errors, m.pairs[m.pair], np.full(2, _STEP), np.full(2, _KNOWN), np.full(2, _MOST),
        start=min(starts, key=rate),
    )  # fmt: skip
    sigmas = np.sqrt(np.diag(covariance))
    if not np.isfinite(sigmas).all():
        return None
    moved = np.linalg.norm(m.pixels[1] - m.pixels[0], axis=1) / count_frames(evidence)
    ratio = np.abs(x) / np.maximum(sigmas, 1e-12)
    return Timing(
        x, sigmas, 1000 * np.abs(x) * float(np.median(moved)) / m.diagonal,
        convert_to_normal(ratio, max(1, len(np.unique(m.pairs)) - 2)), effect, rate(x),
    )  # fmt: skip


def count_frames(evidence: Evidence) -> np.ndarray:
    """Returns the number of steps of the path (M,) between the two images of each match."""
    place = {v: i for group in order_in_time(evidence.scene) for i, v in enumerate(group)}
    gaps = [abs(place[b] - place[a]) for a, b in evidence.matches.pairs]
    return np.maximum(1, gaps)[evidence.matches.pair]


def _measure_speeds(scene: Scene) -> np.ndarray:
    """Returns the motion (V, 6) of each camera from view to view, NaN where it is unknown.

    Its centre's in the world, and its rotation vector's in camera axes, by differences of the views
    before and after.
    """
    speeds = np.full((len(scene), 6), np.nan)
    centers = np.array([view.camera_center for view in scene.views])
    for group in order_in_time(scene):
        last = len(group) - 1
        for place, index in enumerate(group if last >= _FEWEST_VIEWS - 1 else ()):
            low, high = max(0, place - 1), min(last, place + 1)
            one, two = (scene.views[group[k]].camera_from_world[:3, :3] for k in (low, high))
            turn = to_rotation_vector(one @ two.T)
            moved = centers[group[high]] - centers[group[low]]
            speeds[index] = np.concatenate([moved, turn]) / (high - low)
    return speeds


def move_poses(poses: np.ndarray, speeds: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Moves poses (..., 4, 4) world_from_camera by their speeds (..., 6) for a time (...)."""
    vector = (speeds[..., 3:] * time[..., None]).reshape(-1, 3)
    half = np.linalg.norm(vector, axis=1, keepdims=True) / 2
    quaternions = np.concatenate([np.cos(half), 0.5 * vector * np.sinc(half / np.pi)], axis=1)
    turns = rotations_from_quaternions(quaternions).reshape(*poses.shape[:-2], 3, 3)
    moved = poses.copy()
    moved[..., :3, :3] = poses[..., :3, :3] @ turns
    moved[..., :3, 3] += speeds[..., :3] * time[..., None]
    return moved
