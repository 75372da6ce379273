"""What an adjustment may change beside poses and points, and what is known of it beforehand."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import Shutter
from gsut.judge import measure_pixels_per_radian
from gsut.lens import Camera
from gsut.sfm.photographs import TANGENT
from gsut.sfm.solution.result import FEATURE_VARIANCE, Solution


class LensFlag(enum.IntEnum):
    """How a parameter of a lens is estimated; 0: it is held."""

    FREE = 1  # by itself
    TIED = 2  # by the same amount as the others of this flag: focal lengths of square pixels
    NEAR = 3  # by that amount and a small one of its own: pixels that are nearly square


# Parameters of the principal point of every lens that is estimated.
CENTER = (2, 3)
# Standard deviation of a coordinate of a principal point from the middle of its picture, over the
# diagonal: of the lens database's cameras.
CENTER_SIGMA = 0.012
# Focal length over the longer side of a picture: mean and standard deviation of the logarithm, of
# the lens database's lenses.
_FOCAL = (math.log(0.84), 0.68)
# Standard deviation of fy over fx: of the lens database's cameras, by their median.
_ASPECT_SIGMA = 0.0012
# Standard deviation of what a higher coefficient of the distortion shifts the edge of a picture by,
# over its distance from the middle.
_EDGE_SIGMA = 0.2
LOSS_SCALE = 1.5  # of the Cauchy loss, in medians of the residuals
MIN_INLIERS = 15  # fewest of an image while the structure grows


@dataclasses.dataclass(frozen=True)
class RigConstraint:
    """What is known of a rig before its poses are adjusted.

    Args:
        body_of_image: (N,) the rig's place that an image was taken from, from 0 without gaps.
        mount_of_image: (N,) the mount of its camera on the body; -1: the camera is the body.
        camera_from_body: (M, 4, 4) of the mounts.
        registered: (N,) bool, whether an image's pose is known; all of a body, or none.
        adjust: adjust the mounts too; the rig keeps its size.
    """

    body_of_image: np.ndarray
    mount_of_image: np.ndarray
    camera_from_body: np.ndarray
    registered: np.ndarray
    adjust: bool = False

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        return {
            "body_of_image": self.body_of_image.tolist(),
            "mount_of_image": self.mount_of_image.tolist(),
            "camera_from_body": list(self.camera_from_body),
            "refine": self.adjust,
        }


@dataclasses.dataclass(frozen=True)
class ReadoutMotion:
    """How the camera moves while images are read line by line.

    Args:
        shutter: the order of the lines.
        readout: seconds from the first line to the last.
        rates: (N, 6) velocities per second (see Solution.velocities); NaN: not known.
        sigma: relative deviation of an image's own velocity from its rate.
    """

    shutter: Shutter
    readout: float
    rates: np.ndarray
    sigma: float = 0.1

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        return {
            "shutter": self.shutter.direction, "readout_time": self.readout,
            "image_rates": self.rates.tolist(), "rate_sigma": self.sigma,
        }  # fmt: skip

    def select(self, chosen: np.ndarray) -> ReadoutMotion:
        """Returns the motion of chosen images (M,)."""
        return dataclasses.replace(self, rates=self.rates[chosen])

    @classmethod
    def follow(cls, solution: Solution) -> ReadoutMotion | None:
        """Returns the motion near a solution's velocities; None: a global shutter."""
        if solution.shutter is None or solution.velocities is None:
            return None
        rates = solution.velocities
        if solution.lines is not None:
            lengths = np.where(solution.lines.readouts > 0, solution.lines.readouts, np.nan)
            rates = rates / lengths[:, None]
        return cls(solution.shutter, 1.0, rates)

    @classmethod
    def hold(cls, solution: Solution, sigma: float = 0.0) -> ReadoutMotion | None:
        """Returns the motion that keeps a solution's velocities; None: a global shutter.

        Args:
            solution: with the velocities.
            sigma: relative deviation to which they are known.
        """
        motion = cls.follow(solution)
        return motion and dataclasses.replace(motion, sigma=sigma)


@dataclasses.dataclass(frozen=True)
class StatedPlaces:
    """Where cameras stood, as something other than images states it.

    Args:
        centers: (N, 3) in the world of the poses, one an image; NaN: not known.
        sigma: (3,) standard deviation of a coordinate.
    """

    centers: np.ndarray
    sigma: np.ndarray

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        return {"places": self.centers.tolist(), "place_sigma": self.sigma.tolist()}

    def select(self, chosen: np.ndarray) -> StatedPlaces:
        """Returns the places of chosen images (M,)."""
        return StatedPlaces(self.centers[chosen], self.sigma)


@dataclasses.dataclass(frozen=True)
class StatedPoints:
    """Where points lie, as a survey states it.

    Args:
        seen: (M, 2) an image that shows each point, and the feature there.
        places: (M, 3) in the world of the poses.
        sigma: (M, 3) standard deviation of a coordinate.
    """

    seen: np.ndarray
    places: np.ndarray
    sigma: np.ndarray

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes; see `StatedTurns.to_settings`."""
        sigma = self.sigma / math.sqrt(FEATURE_VARIANCE)
        return {"points": np.hstack([self.seen, self.places, sigma]).tolist()}

    def select(self, chosen: np.ndarray) -> StatedPoints:
        """Returns those that chosen images (M,) show, numbered as they are."""
        own = np.isin(self.seen[:, 0], chosen)
        seen = self.seen[own].copy()
        seen[:, 0] = np.searchsorted(chosen, seen[:, 0])
        return StatedPoints(seen, self.places[own], self.sigma[own])


@dataclasses.dataclass(frozen=True)
class StatedTurns:
    """How cameras are turned against each other, as a gyroscope states it.

    Args:
        images: (P, 2) first and second image of pairs.
        rotations: (P, 3, 3) second camera from first one.
        by_calibration: (P, 3, K) derivatives of a turn (exp(d) rotation) by what is not known of
            the gyroscope's calibration, which is estimated too.
        sigma: standard deviation of a component, radians.
        calibration_sigma: (K,) standard deviations of the calibration.
        shared: variance that features share beyond that of photographs' features, as a factor; they
            weigh more by it.
    """

    images: np.ndarray
    rotations: np.ndarray
    by_calibration: np.ndarray
    sigma: float
    calibration_sigma: np.ndarray
    shared: float = 1.0

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes.

        As with principal points, they weigh more by the variance that features share.
        """
        scale = 1 / math.sqrt(self.shared * FEATURE_VARIANCE)
        columns = self.by_calibration.transpose(0, 2, 1).reshape(len(self.images), -1)
        sigma = np.full((len(self.images), 1), scale * self.sigma)
        turned = self.rotations.reshape(-1, 9)
        rows = np.concatenate([self.images, turned, columns, sigma], axis=1)
        return {"turns": rows.tolist(),
                "calibration_sigma": (scale * self.calibration_sigma).tolist()}  # fmt: skip

    def select(self, chosen: np.ndarray) -> StatedTurns | None:
        """Returns the turns between chosen images (M,), numbered as they are; None without any."""
        own = np.isin(self.images, chosen).all(axis=1)
        if not own.any():
            return None
        return dataclasses.replace(
            self,
            images=np.searchsorted(chosen, self.images[own]),
            rotations=self.rotations[own],
            by_calibration=self.by_calibration[own],
        )


# See `Adjustment`.
LensFlags = np.ndarray | Sequence[np.ndarray | None] | None


@dataclasses.dataclass(frozen=True)
class Adjustment:
    """What is adjusted beside poses and points, and how.

    Args:
        lens_free: (K,) flags of the parameters of the one lens, see `LensFlag`; or such flags of
            each image's lens, one array a lens, None for one that is known; None: all lenses are
            known.
        lens_settled: the lens is nearly right, so that estimating it at the end is enough; of
            `adjust_poses`: so are the poses, and the largest error is tight from the start.
        covariances: False for a trial: they are 0, the solver ends at a rougher tolerance, and
            `solve_poses` extends no tracks.
        rig: of `adjust_poses`: the images' cameras are fixed to each other.
        motion: of `adjust_poses`: images are read line by line.
        extend: of `adjust_poses`: look at the end for points in images that do not see them yet.
        places: of `adjust_poses`: where cameras stood, in the world of the poses, or None.
        points: of `adjust_poses` without a rig: where points lie, in the world of the poses, or
            None.
        turns: of `adjust_poses` without a rig: how cameras are turned against each other, or None.
        center_sigma: standard deviation of a coordinate of a free principal point from the middle
            of its picture, over the diagonal; infinite: nothing is known of a lens beforehand.
        min_inliers: fewest inliers of an image while the structure grows.
    """

    lens_free: LensFlags = None
    lens_settled: bool = False
    covariances: bool = True
    rig: RigConstraint | None = None
    motion: ReadoutMotion | None = None
    extend: bool = False
    places: StatedPlaces | None = None
    points: StatedPoints | None = None
    turns: StatedTurns | None = None
    center_sigma: float = CENTER_SIGMA
    min_inliers: int = MIN_INLIERS

    def select(self, chosen: np.ndarray) -> Adjustment:
        """Returns the adjustment of chosen images (M,) alone."""
        stated = {name: getattr(self, name) for name in ("motion", "places", "points", "turns")}
        own = {name: each and each.select(chosen) for name, each in stated.items()}
        flags = self.lens_free
        if isinstance(flags, list):
            flags = [flags[image] for image in chosen]
        return dataclasses.replace(self, lens_free=flags, **own)


PLAIN = Adjustment()


@dataclasses.dataclass(frozen=True)
class IndexedLenses:
    """The different lenses of images.

    Args:
        cameras: each lens once, in order of its first image.
        free: flags of each lens, see `Adjustment`; None: known.
        of_image: number of each image's lens.
    """

    cameras: list[Camera]
    free: list[np.ndarray | None]
    of_image: list[int]


def index_lenses(cameras: Sequence[Camera], free: LensFlags) -> IndexedLenses:
    """Lists the different lenses of images; those with flags of their own differ even if equal."""
    flags = [free] * len(cameras) if free is None or isinstance(free, np.ndarray) else list(free)
    by_id = {id(each): each for each in flags}
    keys = [(camera, id(each)) for camera, each in zip(cameras, flags, strict=True)]
    place = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    return IndexedLenses(
        [camera for camera, _ in place], [by_id[each] for _, each in place],
        [place[key] for key in keys],
    )  # fmt: skip


def state_lenses(lenses: IndexedLenses, center_sigma: float) -> dict[str, Any]:
    """States what is known beforehand of free lenses, as the solver's settings.

    Features of one picture share errors, so that priors weigh more by their variance.

    Args:
        lenses: with their flags.
        center_sigma: see `Adjustment`.
    """
    means: list[list[float]] = []
    sigmas: list[list[float]] = []
    for camera, flags in zip(lenses.cameras, lenses.free, strict=True):
        mean, sigma = find_lens_prior(camera, flags, center_sigma)
        is_known = bool(np.isfinite(sigma).any())
        means.append(mean.tolist() if is_known else [])
        sigmas.append((sigma / math.sqrt(FEATURE_VARIANCE)).tolist() if is_known else [])
    return {"lens_mean": means, "lens_sigma": sigmas} if any(means) else {}


def find_lens_prior(
    camera: Camera, flags: np.ndarray | None, center_sigma: float = CENTER_SIGMA
) -> tuple[np.ndarray, np.ndarray]:
    """Finds what is known of a lens's free parameters beforehand: means and sigmas (K,).

    Focal lengths are those of usual lenses: the mean is the middle one, sigma is of the logarithm.
    A principal point lies near the middle of its picture. Pixels are nearly square: of an fy that
    is near fx, the values are fx and the standard deviation of their difference. Coefficients of
    the distortion after the first are near those of a lens r = f tan(b theta) / b that bends as the
    first one says, or 0.

    Args:
        flags: (K,), see `Adjustment`; None: all parameters are known.
        center_sigma: see `Adjustment`; infinite: nothing is known.
    """
    mean, sigma = camera.params.copy(), np.full(len(camera.params), math.inf)
    if flags is None or not math.isfinite(center_sigma):
        return mean, sigma
    if flags[0]:
        usual = max(camera.width, camera.height) * math.exp(_FOCAL[0])
        mean[0] *= usual / measure_pixels_per_radian(camera)
        sigma[0] = _FOCAL[1]
    if np.any(flags[list(CENTER)]):
        mean[list(CENTER)] = camera.width / 2, camera.height / 2
        sigma[list(CENTER)] = center_sigma * math.hypot(camera.width, camera.height)
    if flags[1] == LensFlag.NEAR:
        mean[1], sigma[1] = camera.params[0], _ASPECT_SIGMA * camera.params[0]
    edge = _find_edge(camera)
    if camera.model == "kannala_brandt":
        power = np.arange(2, 5)
        values, places = np.array(TANGENT[1:]) * (3 * camera.params[4]) ** power, power + 3
    elif camera.model == "opencv4":
        power, values, places, edge = np.array([2]), np.zeros(1), np.array([5]), math.tan(edge)
    else:
        return mean, sigma
    is_free = np.asarray(flags)[places] > 0
    mean[places[is_free]] = values[is_free]
    sigma[places[is_free]] = (_EDGE_SIGMA / edge ** (2.0 * power))[is_free]
    return mean, sigma


def _find_edge(camera: Camera) -> float:
    """Finds the largest angle from the axis at which corners and sides of a picture are seen."""
    x, y = np.meshgrid(
        [0.0, camera.width / 2, camera.width], [0.0, camera.height / 2, camera.height]
    )
    rays, valid = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
    seen = rays[np.asarray(valid, bool)]
    return float(np.max(np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2]), initial=1e-3))
