"""Finds a rolling shutter in photographs whose poses are those of a global one."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.check.epipolar import rate_matches
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_fit import convert_to_normal, fit_numbers, measure_line_errors
from gsut.check.matches import order_in_time
from gsut.check.turns import to_rotation_vector
from gsut.data import Scene
from gsut.gaussians import rotations_from_quaternions
from gsut.sfm.points import measure_angular_errors

_SIGMAS = 4.0  # standard deviations from which a readout is not chance
_LEAST_SHIFT = 2.0  # thousandths of the diagonal, by which a readout shifts what is worth a note
_STEP = 0.01  # frames: of the differences that give the errors' derivative
_STARTS = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.75, -0.75)  # frames that a readout takes
_KNOWN = 1.0  # frames: a readout is hardly longer than the time between two frames
_MOST = 0.3  # frames that the readout changes in one iteration
_FEWEST_VIEWS = 5  # of a path, which give velocities


@dataclasses.dataclass(frozen=True)
class Readout:
    """A rolling shutter's readout, fitted to the matches with the poses' velocities.

    Args:
        frames: from the first line to the last, of the time between two views; below 0 upwards.
        sigma: its standard deviation, by the jackknife over views.
        shift: thousandths of the diagonal by which what is seen moves during it, median.
        significance: in standard deviations of a normal law that are as rare.
        cost: of the matches with the poses of the lines, from 0 to 1.
    """

    frames: float
    sigma: float
    shift: float
    significance: float
    cost: float


def check_shutter(evidence: Evidence, most: float) -> list[Finding]:
    """Names a rolling shutter of which the poses know nothing, if the photographs show it.

    Args:
        evidence: of the photographs.
        most: cost, from 0 to 1, that the matches have at most with the poses of the lines.
    """
    readout = fit_readout(evidence)
    if readout is None or readout.significance < _SIGMAS or readout.shift < _LEAST_SHIFT:
        return []
    if readout.cost > most:
        return []
    way = "first to the last" if readout.frames > 0 else "last to the first"
    return [
        evidence.make_finding(
            "warning",
            "the photographs fit better a rolling shutter, whose readout from the "
            f"{way} line takes {abs(readout.frames):.2f} +- {readout.sigma:.2f} of the time "
            "between two images, than the poses' global one",
            "find poses of the lines (`gsut poses --shutter rolling`), or write "
            "transform_matrix_start and _end of each image",
        )
    ]


def fit_readout(evidence: Evidence) -> Readout | None:
    """Fits the readout; None if poses have lines of their own, or the path has no velocities."""
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

    def find_errors(x: np.ndarray) -> np.ndarray:
        moved = move_poses(poses, speeds[views], x[0] * line)
        return measure_line_errors(scene.cameras, m, moved, np.zeros(4))

    def rate(frames: float) -> float:
        lines = move_poses(poses, speeds[views], frames * line)
        return rate_matches(measure_angular_errors(evidence.rays, lines), m, evidence.focal)

    x, covariance = fit_numbers(
        find_errors, m.pairs[m.pair], np.array([_STEP]), np.array([_KNOWN]), np.array([_MOST]),
        start=np.array([min(_STARTS, key=rate)]),
    )  # fmt: skip
    sigma = float(np.sqrt(covariance[0, 0]))
    if not np.isfinite(sigma):
        return None
    moved = np.linalg.norm(m.pixels[1] - m.pixels[0], axis=1) / count_frames(evidence)
    freedom = max(1, len(np.unique(m.pairs)) - 1)
    return Readout(
        float(x[0]), sigma, 1000 * abs(float(x[0])) * float(np.median(moved)) / m.diagonal,
        float(convert_to_normal(np.abs(x[0]) / max(sigma, 1e-12), freedom)),
        rate(float(x[0])),
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
