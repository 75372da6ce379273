"""Calibrates a record of turns by poses: axes, time offset, bias and scale."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import exp_pose
from gsut.gaussians import find_rotation_vectors, rotations_from_quaternions
from gsut.judge import MEDIAN_DEVIATION, list_signed_permutations
from gsut.least_squares import ROUNDS
from gsut.sfm.gyroscope.curve import TurnCurve, exp_quaternions

# Standard deviation of a component of the bias, rad/s: of sensors that were not at rest before.
BIAS_SIGMA = 0.02
# Standard deviations of changes while the calibration is found: rad/s; a share, since the focal
# length may be as wrong; radians between a sensor and the picture; seconds.
_SIGMAS = np.array([*[BIAS_SIGMA] * 3, 0.2, 0.2, 0.2, 0.2, 0.2])
# Unknowns of a calibration: bias (3), scale, axes (3), time offset.
UNKNOWNS = len(_SIGMAS)
# Seconds: offsets that are tried, and their steps, in which nobody turns far.
_LONGEST_OFFSET = 0.3
_STEP = 0.01
# Radians: pictures and sensors measure a turn no better.
_LEAST_SIGMA = 1e-4
# Standard deviations beyond which a turn is taken for a wrong pose.
WRONG = 5.0


@dataclasses.dataclass(frozen=True)
class TurnCalibration:
    """How a record belongs to the pictures of its film.

    Attributes:
        rotations: (P, 3, 3) recorded turns of the pairs, of camera axes; NaN: not recorded.
        by_unknowns: (P, 3, UNKNOWNS) their derivatives (exp(d) rotation).
        used: (P,) bool, the pairs that agree.
        bias: (3,) rad/s, in the sensor's axes.
        scale: recorded turns over those of the poses.
        camera_from_sensor: (3, 3).
        offset: seconds by which the record is late.
        sigmas: (UNKNOWNS,) standard deviations of the calibration.
        sigma: radians, standard deviation of a component of a turn.
        explained: share of the variance of the poses' turns that the record explains.
        rates: the record, see `TurnCurve`.
        apart: seconds between the images of a pair, in the median.
    """

    rotations: np.ndarray
    by_unknowns: np.ndarray
    used: np.ndarray
    bias: np.ndarray
    scale: float
    camera_from_sensor: np.ndarray
    offset: float
    sigmas: np.ndarray
    sigma: float
    explained: float
    rates: np.ndarray
    apart: float

    def find_turns(self, times: np.ndarray) -> np.ndarray:
        """Finds how cameras turn between times (P, 2): (P, 3, 3); NaN: not recorded."""
        turns = TurnCurve(self.rates, self.bias).find_turns(*(times + self.offset).T).rotations
        vectors = find_rotation_vectors(self.camera_from_sensor @ turns @ self.camera_from_sensor.T)
        found = rotations_from_quaternions(exp_quaternions(vectors / self.scale))
        return np.where(np.isfinite(turns), found, np.nan)

    def estimate_sigmas(self, times: np.ndarray) -> np.ndarray:
        """Estimates the standard deviations (P,) of a component of such turns.

        Noise adds up as a random walk, what is not known of the bias in proportion to time.
        """
        seconds = np.abs(times[:, 1] - times[:, 0])
        drift = seconds * float(np.max(self.sigmas[:3]))
        return np.hypot(self.sigma * np.sqrt(np.maximum(seconds / self.apart, 1)), drift)


def calibrate_turns(
    rates: np.ndarray, times: np.ndarray, rotations: np.ndarray
) -> TurnCalibration | None:
    """Calibrates a record by poses; None where fewer pairs than unknowns are recorded.

    Args:
        rates: (N, 4), see `TurnCurve`.
        times: (P, 2) seconds of the first and second picture of pairs.
        rotations: (P, 3, 3) second camera from first one.
    """
    vectors = find_rotation_vectors(rotations)
    start = _search_start(rates, times, vectors)
    if start is None:
        return None
    offset, axes = start
    bias, scale = np.zeros(3), 0.0
    for _ in range(ROUNDS):
        turns = TurnCurve(rates, bias).find_turns(*(times + offset).T)
        recorded = axes @ turns.rotations @ axes.T
        columns = [
            axes @ turns.by_bias, find_rotation_vectors(recorded)[..., None], np.eye(3) - recorded,
            axes @ turns.by_offset[..., None],
        ]  # fmt: skip
        by_unknowns = np.concatenate(columns, axis=2)
        off = find_rotation_vectors(rotations @ recorded.transpose(0, 2, 1))
        known = np.isfinite(off).all(axis=1)
        if np.count_nonzero(known) < UNKNOWNS:
            return None
        change, left, sigma, normal = _solve(off, by_unknowns, known, scale)
        bias = bias + change[:3]
        scale = float(change[3])
        axes = np.asarray(exp_pose([0, 0, 0, *change[4:7]]))[:3, :3] @ axes
        offset += float(change[7])
    used = known & (np.sum(left**2, axis=1) < 3 * (WRONG * sigma) ** 2)
    total = float(np.sum(vectors[used] ** 2))
    return TurnCalibration(
        recorded, by_unknowns, used, bias, 1 / (1 + scale), axes, offset,
        np.sqrt(np.diag(np.linalg.inv(normal))), sigma,
        1 - float(np.sum(left[used] ** 2)) / total if total > 0 else 0.0,
        rates, float(np.median(times[:, 1] - times[:, 0])),
    )  # fmt: skip


def _solve(
    off: np.ndarray, by_unknowns: np.ndarray, known: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Solves for a change of the unknowns, by Cauchy's loss; the scale is found from nothing.

    Returns:
        The change, what it leaves of each turn, the standard deviation of that, and the normal
        equations of the unknowns.
    """
    change = np.zeros(UNKNOWNS)
    change[3] = scale
    rows = by_unknowns[known]
    for _ in range(ROUNDS):
        left = off - by_unknowns @ change
        sigma = max(MEDIAN_DEVIATION * float(np.median(np.abs(left[known]))), _LEAST_SIGMA)
        weight = 1 / (sigma**2 + np.mean(left[known] ** 2, axis=1))
        normal = np.einsum("p,pij,pik->jk", weight, rows, rows) + np.diag(_SIGMAS**-2.0)
        change = np.linalg.solve(normal, np.einsum("p,pij,pi->j", weight, rows, off[known]))
    return change, off - by_unknowns @ change, sigma, normal


def _search_start(
    rates: np.ndarray, times: np.ndarray, vectors: np.ndarray
) -> tuple[float, np.ndarray] | None:
    """Searches the time offset, and the quarter turns that make the sensor's axes the camera's."""
    curve, found = TurnCurve(rates, np.zeros(3)), None
    least = np.inf
    for offset in np.arange(-_LONGEST_OFFSET, _LONGEST_OFFSET + _STEP / 2, _STEP):
        recorded = find_rotation_vectors(curve.find_turns(*(times + offset).T).rotations)
        known = np.isfinite(recorded).all(axis=1)
        if np.count_nonzero(known) < UNKNOWNS:
            continue
        for axes in QUARTER_TURNS:
            left = np.sum((vectors[known] - recorded[known] @ axes.T) ** 2, axis=1)
            # Of equal ones the first: the axes that the file names.
            if (cost := float(np.mean(np.sqrt(left)))) < least * (1 - 1e-6):
                least, found = cost, (float(offset), axes)
    return found


# The 24 rotations that turn axes into axes, with the identity first.
QUARTER_TURNS = [axes for axes in list_signed_permutations() if np.linalg.det(axes) > 0]
