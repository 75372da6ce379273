"""Triangulates points from matched bearings of posed images, image by image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.data.poses import find_centers
from gsut.lens import Camera
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features


class BearingPoints:
    """Points where matched rays of posed images meet.

    Args:
        cameras, features: of all images.
        pairs: verified matches, `first` < `second`.
        max_error: largest distance between a feature and its point's projection, pixels.
        min_angle: smallest angle between two rays that make a point, radians.

    Attributes:
        positions: (P, 3) world.
        colors: (P, 3) uint8, of the first observation.
        observations: (S, 3) int32: point, image, feature.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        features: Sequence[Features],
        pairs: Sequence[PairMatches],
        max_error: float,
        min_angle: float,
    ) -> None:
        self._cameras, self._features = cameras, features
        self._pairs_of: list[list[PairMatches]] = [[] for _ in features]
        for pair in pairs:
            self._pairs_of[pair.second].append(pair)
        self._max_error, self._min_angle = max_error, min_angle
        self._rays = [c.unproject(f.pixels)[0] for c, f in zip(cameras, features, strict=True)]
        self._point_of = [np.full(len(f), -1, np.int64) for f in features]
        self.positions: np.ndarray = np.zeros((0, 3))
        self.colors: np.ndarray = np.zeros((0, 3), np.uint8)
        self.observations: np.ndarray = np.zeros((0, 3), np.int32)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Returns the points and their observations."""
        return {
            "positions": self.positions,
            "colors": self.colors,
            "observations": self.observations,
        }

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Restores what `state_dict` returned."""
        self.positions, self.colors = state["positions"], state["colors"]
        self.observations = state["observations"]
        self._point_of = [np.full(len(f), -1, np.int64) for f in self._features]
        for point, image, feature in self.observations:
            self._point_of[image][feature] = point

    def add_image(self, image: int, poses: np.ndarray) -> None:
        """Extends tracks to an image, and begins new ones with the posed images before it.

        Args:
            image: index of an image with a pose.
            poses: (N, 4, 4) camera_from_world of all images, NaN where there is none.
        """
        for pair in self._pairs_of[image]:  # the widest baselines first: pairs are sorted
            if np.isnan(poses[pair.first]).any():
                continue
            others, mine = pair.matches.T
            points = self._point_of[pair.first][others]
            free = self._point_of[image][mine] < 0
            known = free & (points >= 0)
            self._extend(image, mine[known], points[known], poses)
            new = free & (points < 0)
            self._begin((pair.first, image), pair.matches[new], poses)

    def _extend(
        self, image: int, features: np.ndarray, points: np.ndarray, poses: np.ndarray
    ) -> None:
        _, once = np.unique(points, return_index=True)
        good = once[self._is_near(image, features[once], self.positions[points[once]], poses)]
        self._add_observations(points[good], image, features[good])

    def _begin(self, images: tuple[int, int], matches: np.ndarray, poses: np.ndarray) -> None:
        rays = [self._rays[i][matches[:, k]] @ poses[i, :3, :3] for k, i in enumerate(images)]
        cosine = np.einsum("nk,nk->n", *rays)
        met, distances = _intersect_rays(find_centers(poses[list(images)]), rays, cosine)
        good = (distances > 0).all(axis=0) & (np.cos(self._min_angle) > cosine)
        for k, i in enumerate(images):
            good[good] = self._is_near(i, matches[good, k], met[good], poses)
        new = len(self.positions) + np.arange(int(good.sum()))
        self.positions = np.concatenate([self.positions, met[good]])
        colors = self._features[images[0]].colors[matches[good, 0]]
        self.colors = np.concatenate([self.colors, colors])
        for k, i in enumerate(images):
            self._add_observations(new, i, matches[good, k])

    def _add_observations(self, points: np.ndarray, image: int, features: np.ndarray) -> None:
        self._point_of[image][features] = points
        rows = np.stack([points, np.full(len(points), image), features], axis=1)
        self.observations = np.concatenate([self.observations, rows.astype(np.int32)])

    def _is_near(
        self, image: int, features: np.ndarray, positions: np.ndarray, poses: np.ndarray
    ) -> np.ndarray:
        """Returns (N,) bool: the projection lies near enough to the feature."""
        pose = poses[image]
        seen = self._cameras[image].project(positions @ pose[:3, :3].T + pose[:3, 3])[0]
        distances = np.linalg.norm(seen - self._features[image].pixels[features], axis=1)
        return distances < self._max_error  # NaN, outside the lens' domain: False

    def adjust(self, poses: np.ndarray) -> None:
        """Moves each point to where its rays come nearest to each other in least squares."""
        total = np.zeros((len(self.positions), 3, 3))
        right = np.zeros((len(self.positions), 3))
        centers = find_centers(poses)
        for image in np.unique(self.observations[:, 1]):
            of_image = self.observations[:, 1] == image
            points, features = self.observations[of_image, 0], self.observations[of_image, 2]
            rays = self._rays[image][features] @ poses[image, :3, :3]
            across: np.ndarray = np.eye(3) - rays[:, :, None] * rays[:, None, :]
            # Errors are angles: the distance of a far point from its ray counts less.
            weight = 1.0 / np.sum((self.positions[points] - centers[image]) ** 2, axis=1)
            across = across * weight[:, None, None]
            np.add.at(total, points, across)
            np.add.at(right, points, across @ centers[image])
        if len(total):
            self.positions = np.linalg.solve(total, right[:, :, None])[:, :, 0]


def _intersect_rays(
    centers: np.ndarray, rays: Sequence[np.ndarray], cosine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (N, 3) middles of the shortest segments between rays, and (2, N) distances."""
    base = centers[1] - centers[0]
    first, second = rays[0] @ base, rays[1] @ base
    with np.errstate(divide="ignore", invalid="ignore"):
        sine2 = 1.0 - cosine**2
        distances = np.stack([(first - cosine * second) / sine2, (cosine * first - second) / sine2])
        ends = [c + d[:, None] * r for c, d, r in zip(centers, distances, rays, strict=True)]
        return 0.5 * (ends[0] + ends[1]), distances
