"""What a solver is given, the images, and what it returns, poses and points."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from gsut import _core
from gsut._core import Shutter
from gsut.lens import Camera
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features, ImageLines

# Variance of what is estimated from the features of photographs, over that which independent normal
# errors of the same size would give: the position of a feature drifts slowly along a walk, and
# neighbouring features drift alike, which residuals hardly show. Measured as the mean squared
# normalised error of poses against exact truth (33.8 for 6 degrees of freedom without the factor).
# Errors that all features share, of the lens, the shutter or the reference, are not included.
FEATURE_VARIANCE = 5.6
# Share of the matches of a pair that observe one point, below which the solution rejects them all.
_REJECTED = 0.1


@dataclasses.dataclass(frozen=True)
class Solution:
    """Poses of photographs and the points that they see.

    Args:
        names: of all images.
        cameras: the lens of each image; the estimated one where it was unknown.
        registered: (N,) bool.
        camera_from_world: (N, 4, 4) float64, OpenCV axes; identity where not registered.
        covariances: (N, 6, 6) of the centre in the world and the turn in the camera frame
            (radians, camera_from_world <- exp(turn) camera_from_world), multiplied by
            FEATURE_VARIANCE; 0 for what the gauge holds, NaN where not determined. They cover the
            features' errors alone, not those of a wrong lens or shutter.
        points: (P, 3) float64.
        colors: (P, 3) uint8, mean of the observations.
        point_errors: (P,) pixels, mean over the observations.
        observations: (S, 3) int32: point, image, feature.
        pixels: (S, 2) float64 of the observations.
        residuals: (S, 2) float64, projected minus observed pixels.
        field_angles: (S,) radians between the observations' rays and the lens' axis.
        initial_pair: the images that the reconstruction started from.
        restarts: number of times that it started again.
        rms, median: of the residuals' lengths, in pixels.
        shutter: rolling, or None; camera_from_world is then that of the middle of the readout.
        velocities: (N, 6) of rolling shutters, else None: how far the centre moves in the world and
            the camera turns (radians, camera frame) during the image's readout.
        lines: how each image is read, where they differ.
        camera_from_body: (M, 4, 4) of a rig's mounts, else None.
        learned_noise: standard deviation of learned features' errors over that of the others.
    """

    names: list[str]
    cameras: list[Camera]
    registered: np.ndarray
    camera_from_world: np.ndarray
    covariances: np.ndarray
    points: np.ndarray
    colors: np.ndarray
    point_errors: np.ndarray
    observations: np.ndarray
    pixels: np.ndarray
    residuals: np.ndarray
    field_angles: np.ndarray
    initial_pair: tuple[int, int]
    restarts: int
    rms: float
    median: float
    shutter: Shutter | None = None
    velocities: np.ndarray | None = None
    lines: ImageLines | None = None
    camera_from_body: np.ndarray | None = None
    learned_noise: float = 1.0

    @property
    def num_registered(self) -> int:
        """Number of images with a pose."""
        return int(self.registered.sum())

    @property
    def registered_names(self) -> list[str]:
        """Images with a pose."""
        return [n for n, r in zip(self.names, self.registered, strict=True) if r]

    @property
    def unregistered_names(self) -> list[str]:
        """Images without a pose."""
        return [n for n, r in zip(self.names, self.registered, strict=True) if not r]

    @property
    def readout_turn(self) -> float | None:
        """Returns the root mean square turn in a readout, radians; None for a global shutter."""
        if self.velocities is None:
            return None
        turns = self.velocities[self.registered, 3:]
        return math.sqrt(float((turns**2).sum(axis=1).mean()))

    @property
    def shutters(self) -> list[Shutter | None]:
        """The shutter of each image."""
        if self.lines is None or self.shutter is None:
            return [self.shutter] * len(self.names)
        return list(self.lines.shutters)

    def measure_line_times(self) -> np.ndarray:
        """Returns (S,) when the lines of the observations are read: see `measure_line_times`."""
        return measure_line_times(self, self.shutters, self.lines)

    def interpolate_poses(self, time: float) -> np.ndarray:
        """Returns (N, 4, 4) camera_from_world at a time of the readout, 0 its start, 1 its end."""
        if self.velocities is None:
            return self.camera_from_world
        return np.array(
            [
                _core.moved_pose(pose, velocity, time - 0.5)
                for pose, velocity in zip(self.camera_from_world, self.velocities, strict=True)
            ]
        )

    def fill_poses(self, others: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Returns (4, 4) poses of all images, from `others` where one is not registered."""
        return [
            found if registered else other
            for found, registered, other in zip(
                self.camera_from_world, self.registered, others, strict=True
            )
        ]

    def index_points(self, lengths: np.ndarray) -> list[np.ndarray]:
        """Returns the point that each feature of each image observes, -1: none.

        Args:
            lengths: (N,) number of features of each image.
        """
        ends = np.cumsum(lengths)
        point, image, feature = self.observations.T
        points = np.full(int(ends[-1]), -1)
        points[(ends - lengths)[image] + feature] = point
        return np.split(points, ends[:-1])


@dataclasses.dataclass(frozen=True)
class PairAgreement:
    """How far the verified matches of pairs of registered images observe common points.

    Args:
        matches: (P,) of each pair.
        together: (P,) of these, those that observe one point.
    """

    matches: np.ndarray
    together: np.ndarray

    @property
    def share(self) -> float:
        """Returns the share of all matches that observe one point.

        Above 0.9 where lens and images belong together, 0.3 to 0.4 with a wrong lens: pairs then
        agree one by one, but not with each other.
        """
        return float(self.together.sum() / max(1, self.matches.sum()))

    @property
    def rejected(self) -> np.ndarray:
        """Returns (P,) bool: hardly any match of a pair observes one point."""
        return self.together < _REJECTED * self.matches

    @property
    def upheld(self) -> np.ndarray:
        """Returns (P,) bool: most matches of a pair observe one point."""
        return 2 * self.together > self.matches


def measure_agreement(solution: Solution, pairs: Sequence[PairMatches]) -> PairAgreement:
    """Measures how far the verified matches of pairs agree in all images together."""
    lengths = np.zeros(len(solution.names), np.int64)
    np.maximum.at(lengths, solution.observations[:, 1], solution.observations[:, 2] + 1)
    for pair in pairs:
        for image, features in zip((pair.first, pair.second), pair.matches.T, strict=True):
            lengths[image] = max(lengths[image], int(features.max(initial=-1)) + 1)
    points = solution.index_points(lengths)
    known = [p for p in pairs if solution.registered[p.first] and solution.registered[p.second]]
    together = np.zeros(len(known), np.int64)
    for number, pair in enumerate(known):
        first = points[pair.first][pair.matches[:, 0]]
        second = points[pair.second][pair.matches[:, 1]]
        together[number] = np.count_nonzero((first >= 0) & (first == second))
    return PairAgreement(np.array([len(p.matches) for p in known], np.int64), together)


def measure_diagonal(cameras: Sequence[Camera]) -> float:
    """Returns the diagonal of the largest image in pixels."""
    return max(math.hypot(c.width, c.height) for c in cameras)


def measure_line_times(
    solution: Solution, shutters: Sequence[Shutter | None], lines: ImageLines | None = None
) -> np.ndarray:
    """Returns (S,) when the lines of the observations are read.

    Args:
        shutters: of each image; None: all lines at once, in the middle.
        lines: their readouts, where these differ.

    Returns:
        Times from the middle of a readout, -0.5 to 0.5 in units of the longest one.
    """
    axis, sign = np.zeros(len(shutters), np.int64), np.zeros(len(shutters))
    for image, shutter in enumerate(shutters):
        if shutter is not None:
            axis[image] = shutter.direction in ("top_to_bottom", "bottom_to_top")
            sign[image] = 1 if shutter.direction in ("top_to_bottom", "left_to_right") else -1
    sizes = np.array([(camera.width, camera.height) for camera in solution.cameras])
    rows = solution.observations[:, 1]
    along = axis[rows]
    share = solution.pixels[np.arange(len(rows)), along] / sizes[rows, along] - 0.5
    return sign[rows] * share * (1.0 if lines is None else lines.readouts[rows])


def transform_to_cameras(
    points: np.ndarray, observations: np.ndarray, camera_from_world: np.ndarray
) -> np.ndarray:
    """Returns (S, 3) the observed points in their images' cameras.

    Args:
        points: (P, 3) world.
        observations: (S, 3) point, image, feature.
        camera_from_world: (N, 4, 4) of all images.
    """
    pose = camera_from_world[observations[:, 1]]
    return np.einsum("nij,nj->ni", pose[:, :3, :3], points[observations[:, 0]]) + pose[:, :3, 3]


def _split_by_image(observations: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yields each image that observes something, with the rows of its observations in order."""
    order = np.argsort(observations[:, 1], kind="stable")
    images, starts = np.unique(observations[order, 1], return_index=True)
    yield from zip(images.tolist(), np.split(order, starts)[1:], strict=True)


def gather_pixels(features: Sequence[Features], observations: np.ndarray) -> np.ndarray:
    """Returns (S, 2) the pixels of observations (S, 3): point, image, feature."""
    pixels = np.zeros((len(observations), 2))
    for image, rows in _split_by_image(observations):
        pixels[rows] = features[image].pixels[observations[rows, 2]]
    return pixels


def evaluate_observations(
    observations: np.ndarray,
    in_camera: np.ndarray,
    cameras: Sequence[Camera],
    features: Sequence[Features],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns pixels (S, 2), residuals (S, 2) and field angles (S,) as in `Solution`.

    Args:
        observations: (S, 3) point, image, feature.
        in_camera: (S, 3) the points in the images' cameras.
        cameras, features: of all images.
    """
    pixels = gather_pixels(features, observations)
    residuals = np.full((len(observations), 2), np.nan)
    for image, rows in _split_by_image(observations):
        camera = cameras[image]
        residuals[rows] = camera.subtract_pixels(camera.project(in_camera[rows])[0], pixels[rows])
    angles = np.arctan2(np.hypot(in_camera[:, 0], in_camera[:, 1]), in_camera[:, 2])
    return pixels, residuals, angles


def average_colors(
    observations: np.ndarray, points: int, of_images: Sequence[np.ndarray]
) -> np.ndarray:
    """Returns (P, 3) uint8, the mean over each point's observations of the images' colours.

    Args:
        observations: (S, 3) point, image, feature.
        points: number of points.
        of_images: (N, 3) uint8 of each image's features.
    """
    colors = np.zeros((points, 3))
    for image, rows in _split_by_image(observations):
        np.add.at(colors, observations[rows, 0], of_images[image][observations[rows, 2]])
    counts = np.bincount(observations[:, 0], minlength=points).clip(1)
    return np.rint(colors / counts[:, None]).astype(np.uint8)


def similarity_from_points(
    source: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Fits the scale, rotation (3, 3) and translation (3,) that carry source to target points.

    Source: Umeyama, "Least-squares estimation of transformation parameters", PAMI 1991.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    left, values, right = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    rotation = left @ sign @ right
    scale = float((values * np.diag(sign)).sum() / max((a**2).sum(), 1e-300))
    return scale, rotation, target_mean - scale * rotation @ source_mean
