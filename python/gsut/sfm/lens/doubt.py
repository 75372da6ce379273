"""Camera motions and scenes that leave something open, recognised from poses and points."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.sfm.core import FEATURE_VARIANCE, PairMatches, PosesOptions, Solution, rotation_angles
from gsut.sfm.lens.covariance import lens_covariance

# Second over first extent of the camera centres, below which they lie on a line.
_STRAIGHT = 0.03
_TURNS = math.radians(10.0)  # between the views, less than which says nothing of the lens
# Third over second extent of the points, below which they lie in a plane.
_FLAT = 0.03
_LITTLE_PARALLAX = math.radians(2.0)
TURNED = "the camera mostly turned on the spot"  # how that sentence begins
_OF_TURN = 0.1  # parallax of a pair over its turn, below which the turn is what there is
_MOSTLY = 0.8  # of the pairs
_TURNED_ONLY = 0.9  # share of a pair's matches that a rotation explains


def critical_motion(solution: Solution, pairs: Sequence[PairMatches]) -> str | None:
    """What of the motion or the scene leaves the lens open, as a sentence; None if nothing does.

    A straight flight without turns: a longer focal length with a longer path gives the same images.
    A turn about one point: no depth. A plane seen from one height: no depth differences, so that
    focal length and height trade off (Sturm, "Critical motion sequences for monocular
    self-calibration", CVPR 1997).

    Args:
        solution: poses and points. pairs: verified matches.
    """
    poses = solution.camera_from_world[solution.registered]
    turned = [pair.rotation_matches > _TURNED_ONLY * len(pair.matches) for pair in pairs]
    parallax = np.array([pair.parallax for pair in pairs])
    turns = rotation_angles(
        np.array([p.second_from_first[:3, :3] for p in pairs]).reshape(-1, 3, 3)
    )
    # A rolling shutter, and a step to the side, are more than a rotation explains.
    beside = parallax < _OF_TURN * turns
    mostly = pairs and max(np.mean(turned), np.mean(beside)) > _MOSTLY
    if mostly and float(np.median(parallax)) < _LITTLE_PARALLAX:
        return (
            f"{TURNED}, so depths are hardly known and nothing can be seen from elsewhere: walk "
            "between the pictures, sideways to what you film"
        )
    extents = _extents(find_centers(poses))
    middle = poses[len(poses) // 2, :3, :3]
    angles = rotation_angles(poses[:, :3, :3] @ middle.T)
    still = float(np.percentile(angles, 90)) < _TURNS
    if extents[1] < _STRAIGHT * extents[0] and still:
        return (
            "the camera moved straight on without turning, so the focal length and the length of "
            "the path along the view can replace each other: film a curve, or turn the camera "
            "while you move, some pictures upright and some on their side"
        )
    flat = _extents(_near(solution.points))
    if flat[2] < _FLAT * flat[1] and still:
        return (
            "everything seen lies in one plane and was seen from one direction, so focal length "
            "and distance can replace each other: add pictures tilted by 30 degrees or more, or "
            "with things of different height"
        )
    return None


def _near(points: np.ndarray) -> np.ndarray:
    """The points without the farthest tenth: single outliers are no depth."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return points[distance <= np.percentile(distance, 90)] if len(points) else points


def _extents(points: np.ndarray) -> np.ndarray:
    """(3,) singular values about the mean, largest first."""
    if len(points) < 3:
        return np.array([1.0, 0.0, 0.0])
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return np.maximum(values, 1e-300 * np.ones(3))


# Above the first usable at most, above the second poor: two standard deviations of the focal
# length over it, and the median residual over the image's diagonal.
FOCAL_LIMITS = (0.02, 0.1)


@dataclasses.dataclass(frozen=True)
class LensDoubt:
    """What is open about an estimated lens.

    Args:
        focal_sigma: standard deviation of the focal length over it; infinite: not determined.
        motion: why, see `critical_motion`.
    """

    focal_sigma: float
    motion: str | None

    @property
    def percent(self) -> float | None:
        """Standard deviation of the focal length in percent; None: not determined."""
        return 100 * self.focal_sigma if math.isfinite(self.focal_sigma) else None

    def words(self) -> str | None:
        """A sentence, if the focal length is not known to 2 % (two standard deviations)."""
        if 2 * self.focal_sigma <= FOCAL_LIMITS[0] and self.motion is None:
            return None
        share = (
            f"to {200 * self.focal_sigma:.1f} %"
            if math.isfinite(self.focal_sigma) and self.focal_sigma < 1
            else "not at all"
        )
        if self.motion:
            return (
                f"{self.motion}; by the errors of the features alone the focal length is known "
                f"{share} (two standard deviations)"
            )
        return (
            f"these images determine the focal length {share} (two standard deviations); give "
            "--camera or --fov if you know the lens"
        )


def lens_doubt(
    solution: Solution, flags: np.ndarray, pairs: Sequence[PairMatches], options: PosesOptions
) -> LensDoubt:
    """How well the images determine the lens that was estimated from them.

    Args:
        solution: with the lens. flags: of its parameters, see `search_lens`.
        pairs: verified. options: of the adjustment.
    """
    motion = critical_motion(solution, pairs)
    try:
        covariance = lens_covariance(solution, flags, options.loss_scale, FEATURE_VARIANCE)
    except SolveError:
        return LensDoubt(math.inf, motion)
    return LensDoubt(float(covariance.sigmas[0] / solution.cameras[0].params[0]), motion)
