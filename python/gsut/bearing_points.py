"""Points from matched bearings of posed images: tracks that grow image by image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.cameras import Camera
from gsut.structure.features import Features
from gsut.structure.matching import PairMatches


class BearingPoints:
    """Where matched rays of posed images meet.

    Args:
        cameras, features: of all images.
        pairs: verified matches.
        max_error: largest distance between a feature and its point's projection, pixels.
        min_angle: smallest angle between two rays that make a point, radians.

    Attributes:
        positions: (P, 3) world.
        colors: (P, 3) uint8, of the first sight.
        sights: (S, 3) int32: point, image, feature.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        features: Sequence[Features],
        pairs: Sequence[PairMatches],
        max_error: float,
        min_angle: float,
    ) -> None:
        self._cameras, self._features, self._pairs = cameras, features, pairs
        self._max_error, self._min_angle = max_error, min_angle
        self._rays = [c.unproject(f.pixels)[0] for c, f in zip(cameras, features, strict=True)]
        self._point_of = [np.full(len(f), -1, np.int64) for f in features]
        self.positions: np.ndarray = np.zeros((0, 3))
        self.colors: np.ndarray = np.zeros((0, 3), np.uint8)
        self.sights: np.ndarray = np.zeros((0, 3), np.int32)

    def add_image(self, image: int, poses: Sequence[np.ndarray | None]) -> None:
        """Extends the tracks to an image, and begins new ones with the posed images before it.

        Args:
            image: index; posed.
            poses: (4, 4) camera_from_world of all images, None where there is none.
        """
        for pair in self._pairs:  # the widest baselines first: pairs are sorted by their images
            first, second, matches = pair.first, pair.second, pair.matches
            if second == image:
                first, second, matches = second, first, matches[:, ::-1]
            if first != image or second > image or poses[second] is None:
                continue
            mine, other = self._point_of[image], self._point_of[second]
            free = mine[matches[:, 0]] < 0
            known = free & (other[matches[:, 1]] >= 0)
            self._extend(image, matches[known, 0], other[matches[known, 1]], poses)
            self._begin(image, second, matches[free & ~known], poses)

    def _extend(
        self,
        image: int,
        features: np.ndarray,
        points: np.ndarray,
        poses: Sequence[np.ndarray | None],
    ) -> None:
        _, once = np.unique(points, return_index=True)
        good = once[self._errors(image, features[once], self.positions[points[once]], poses)]
        self._see(points[good], image, features[good])

    def _begin(
        self, image: int, other: int, matches: np.ndarray, poses: Sequence[np.ndarray | None]
    ) -> None:
        rays = [
            self._rays[i][matches[:, k]] @ _rotation(poses[i]) for k, i in enumerate((image, other))
        ]
        centers = [_center(poses[i]) for i in (image, other)]
        cosine = np.einsum("nk,nk->n", *rays)
        met, distances = _meet(centers, rays, cosine)
        good = (distances > 0).all(axis=0) & (np.cos(self._min_angle) > cosine)
        for k, i in enumerate((image, other)):
            good[good] = self._errors(i, matches[good, k], met[good], poses)
        new = len(self.positions) + np.arange(int(good.sum()))
        self.positions = np.concatenate([self.positions, met[good]])
        self.colors = np.concatenate([self.colors, self._features[image].colors[matches[good, 0]]])
        for k, i in enumerate((image, other)):
            self._see(new, i, matches[good, k])

    def _see(self, points: np.ndarray, image: int, features: np.ndarray) -> None:
        self._point_of[image][features] = points
        rows = np.stack([points, np.full(len(points), image), features], axis=1)
        self.sights = np.concatenate([self.sights, rows.astype(np.int32)])

    def _errors(
        self,
        image: int,
        features: np.ndarray,
        positions: np.ndarray,
        poses: Sequence[np.ndarray | None],
    ) -> np.ndarray:
        """(N,) bool: the projection lies near enough to the feature."""
        residuals = self.residuals(image, features, positions, poses)
        return np.linalg.norm(residuals, axis=1) < self._max_error  # NaN: False

    def residuals(
        self,
        image: int,
        features: np.ndarray,
        positions: np.ndarray,
        poses: Sequence[np.ndarray | None],
    ) -> np.ndarray:
        """(N, 2) projections minus features, pixels; NaN outside the lens' domain."""
        pose = _matrix(poses[image])
        seen = self._cameras[image].project(positions @ pose[:3, :3].T + pose[:3, 3])[0]
        return seen - self._features[image].pixels[features]

    def adjust(self, poses: Sequence[np.ndarray | None]) -> None:
        """Moves each point to where its rays come nearest to each other, least squares."""
        total = np.zeros((len(self.positions), 3, 3))
        right = np.zeros((len(self.positions), 3))
        for image in np.unique(self.sights[:, 1]):
            of_image = self.sights[:, 1] == image
            points, features = self.sights[of_image, 0], self.sights[of_image, 2]
            rays = self._rays[image][features] @ _rotation(poses[image])
            across: np.ndarray = np.eye(3) - rays[:, :, None] * rays[:, None, :]
            # Errors are of angle: a far point's distance from the ray counts less.
            weight = 1.0 / np.sum((self.positions[points] - _center(poses[image])) ** 2, axis=1)
            across = across * weight[:, None, None]
            np.add.at(total, points, across)
            np.add.at(right, points, across @ _center(poses[image]))
        if len(total):
            self.positions = np.linalg.solve(total, right[:, :, None])[:, :, 0]


def _meet(
    centers: Sequence[np.ndarray], rays: Sequence[np.ndarray], cosine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) middles of the shortest segments between pairs of rays, and (2, N) distances."""
    base = centers[1] - centers[0]
    first, second = rays[0] @ base, rays[1] @ base
    with np.errstate(divide="ignore", invalid="ignore"):
        sine2 = 1.0 - cosine**2
        distances = np.stack([(first - cosine * second) / sine2, (cosine * first - second) / sine2])
        ends = [c + d[:, None] * r for c, d, r in zip(centers, distances, rays, strict=True)]
        return 0.5 * (ends[0] + ends[1]), distances


def _matrix(pose: np.ndarray | None) -> np.ndarray:
    if pose is None:
        raise AssertionError("the image has no pose")
    return pose


def _rotation(pose: np.ndarray | None) -> np.ndarray:
    return _matrix(pose)[:3, :3]


def _center(pose: np.ndarray | None) -> np.ndarray:
    return -_rotation(pose).T @ _matrix(pose)[:3, 3]
