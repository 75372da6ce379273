"""Finds a turn that grows along the path of the poses, as odometry and gyroscopes make it."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.check.breaks import list_loops
from gsut.check.epipolar import rate_pairs
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_fit import LEAST_EFFECT, LensFit, fit_lens_beside
from gsut.check.matches import order_in_time
from gsut.check.shutter import count_frames, move_poses
from gsut.sfm.points import measure_angular_errors
from gsut.significance import convert_to_normal

_SIGMAS = 4.0  # standard deviations from which a drift is not chance
_LEAST_SHIFT = 1.0  # thousandths of the diagonal, by which a drift shifts the pixels of a pair
_MOST_MATCHES = 6000  # they determine a drift to a hundredth of a pixel
_STEP = 1e-4  # radians a frame: of the differences that give derivatives
_KNOWN = 0.1  # radians a frame: standard deviation with which a drift is known to be none
_MOST = 0.05  # radians a frame by which one iteration may change the drift
_OTHERS = np.tile([[_STEP], [_KNOWN], [_MOST]], (1, 3))
DRIFT_ADVICE = "the poses drift, as odometry does: adjust all of them at once (`gsut poses`)"


@dataclasses.dataclass(frozen=True)
class Drift:
    """A constant turn from frame to frame, fitted to the matches beside errors of the lens.

    Args:
        fit: of the lens, and of the turn (3,), radians a frame in camera axes.
        shift: thousandths of the diagonal by which the turn shifts the pixels of a pair, median.
    """

    fit: LensFit
    shift: float

    @property
    def turn(self) -> np.ndarray:
        """The turn (3,) that the poses lack, radians a frame in camera axes."""
        return self.fit.values[4:]

    @property
    def significance(self) -> float:
        """The turn, in standard deviations of a normal law that are as rare."""
        ratio = np.abs(self.turn) / np.maximum(self.fit.sigmas[4:], 1e-12)
        return float(convert_to_normal(ratio.max(), self.fit.freedom))

    @property
    def is_sure(self) -> bool:
        """Returns whether it is large, not chance, and surer than an error of the lens."""
        sure = max(_SIGMAS, float(self.fit.significance.max()))
        large = self.shift > _LEAST_SHIFT and self.fit.effect > LEAST_EFFECT
        return large and self.significance > sure


def check_drift(evidence: Evidence) -> list[Finding]:
    """Names a turn that grows along the path, if both halves of the photographs show it.

    Neighbours fit such poses nearly: of an error of the lens it differs as it grows with the number
    of frames between two images.
    """
    drift = fit_drift(evidence)
    if not drift.is_sure:
        return []
    m = evidence.matches
    for late in (False, True):
        half = fit_drift(evidence.select(np.flatnonzero((2 * m.pair >= len(m.pairs)) == late)))
        if half.turn @ drift.turn <= 0 or half.significance < _SIGMAS / np.sqrt(2):
            return []
    return [evidence.make_finding("warning", f"the photographs fit {name_drift(evidence, drift)}",
                                  DRIFT_ADVICE)]  # fmt: skip


def name_drift(evidence: Evidence, drift: Drift) -> str:
    """Says how far poses drift, and from which image to which."""
    path = max(order_in_time(evidence.scene), key=len)
    first, last = (evidence.scene.views[path[place]].name for place in (0, -1))
    angle = float(np.linalg.norm(drift.turn))
    axis = drift.turn / max(angle, 1e-12)
    sigma = float(np.sqrt(axis @ drift.fit.covariance[4:, 4:] @ axis))
    angle, sigma = np.degrees([angle, sigma]) * (len(path) - 1)
    return (
        f"poses without the turn of about {angle:.1f} +- {sigma:.1f} degrees that these accumulate "
        f"from {first} to {last}"
    )


def fit_drift(evidence: Evidence) -> Drift:
    """Fits the drift and errors of the lens to pairs of images that are near on the path."""
    m = evidence.matches
    near = np.flatnonzero(~np.isin(m.pair, list(list_loops(evidence))))
    near = near[:: -(-len(near) // _MOST_MATCHES) or 1]
    used = evidence.select(near)
    poses, frames = used.table.select_poses(), count_frames(used)
    fit = fit_lens_beside(
        used.scene.cameras, used.matches, lambda turn: _turn_apart(poses, frames, turn), _OTHERS
    )
    angle = float(np.linalg.norm(fit.values[4:]) * np.median(frames)) if len(frames) else 0.0
    return Drift(fit, 1000 * angle * evidence.focal / m.diagonal)


def rate_drift(evidence: Evidence, drift: Drift) -> np.ndarray:
    """Returns the cost of each pair (P,) with the poses turned back, from 0 to 1."""
    poses = _turn_apart(evidence.table.select_poses(), count_frames(evidence), drift.turn)
    errors = measure_angular_errors(evidence.rays, poses)
    return rate_pairs(errors, evidence.matches, evidence.focal)


def _turn_apart(poses: np.ndarray, frames: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Turns the two poses (2, M, 4, 4) of each match by half of what the frames between add."""
    speeds = np.broadcast_to(np.concatenate([np.zeros(3), turn]), (*poses.shape[:2], 6))
    return move_poses(poses, speeds, np.stack([-frames, frames]) / 2)
