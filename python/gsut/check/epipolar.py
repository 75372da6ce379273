"""Rates how well matches fit poses and lenses: angles to epipolar planes, in pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut.check.matches import ImagePair
from gsut.data import Scene
from gsut.lens import Camera
from gsut.sfm.points import compute_readout_poses, find_readout_moments

# Error of a match beyond which it counts as plainly wrong, in thousandths of the image's diagonal:
# one and a half pixels of the small images that features are sought in.
TOLERANCE = 3.0


@dataclasses.dataclass(frozen=True)
class Matches:
    """All matches of all pairs as arrays.

    Args:
        pair: (M,) which pair each belongs to.
        pairs: (P, 2) the views.
        pixels: (2, M, 2) of the two images.
        lens: (2, M) index of the lens.
        diagonal: of the images, pixels.
    """

    pair: np.ndarray
    pairs: np.ndarray
    pixels: np.ndarray
    lens: np.ndarray
    diagonal: float

    def __len__(self) -> int:
        return len(self.pair)

    def select(self, rows: np.ndarray | slice) -> Matches:
        """Returns some of the matches, of the same pairs."""
        return dataclasses.replace(
            self, pair=self.pair[rows], pixels=self.pixels[:, rows], lens=self.lens[:, rows]
        )


def gather_matches(scene: Scene, pairs: Sequence[ImagePair]) -> Matches:
    """Gathers the matches of pairs of a scene's views into arrays."""
    number = np.repeat(np.arange(len(pairs)), [p.pixels.shape[1] for p in pairs])
    views = np.array([(p.first, p.second) for p in pairs], np.int64).reshape(-1, 2)
    lens = np.array([view.camera_index for view in scene.views])[views]  # (P, 2)
    camera = scene.cameras[0]
    return Matches(
        number, views, np.concatenate([p.pixels for p in pairs], axis=1), lens[number].T,
        float(np.hypot(camera.width, camera.height)),
    )  # fmt: skip


def find_rays(
    cameras: Sequence[Camera], matches: Matches, pixels: np.ndarray | None = None
) -> np.ndarray:
    """Returns unit rays (..., 2, M, 3) in camera axes, NaN where a pixel has none.

    Args:
        cameras: the lenses.
        matches: what the pixels belong to.
        pixels: (..., 2, M, 2) beside the matches; None: those of the matches.
    """
    pixels = matches.pixels if pixels is None else pixels
    rays = np.full((*pixels.shape[:-1], 3), np.nan)
    for side in (0, 1):
        for number in np.unique(matches.lens[side]):
            rows = np.flatnonzero(matches.lens[side] == number)
            found, valid = cameras[number].unproject(pixels[..., side, rows, :].reshape(-1, 2))
            found = np.where(np.asarray(valid)[:, None], found, np.nan)
            rays[..., side, rows, :] = found.reshape(*pixels.shape[:-3], len(rows), 3)
    return rays


@dataclasses.dataclass(frozen=True)
class PoseTable:
    """Where the cameras are: one pose a view, or one for each of some moments of its readout.

    Args:
        poses: (V, B, 4, 4) world_from_camera.
        rows: (2, M, 2) view and moment of each match's two images.
    """

    poses: np.ndarray
    rows: np.ndarray

    def select_poses(self, poses: np.ndarray | None = None) -> np.ndarray:
        """Returns the pose of each match's two images.

        Args:
            poses: (V, B, 4, 4) to select from; None: the table's own.

        Returns:
            (2, M, 4, 4) world_from_camera.
        """
        poses = self.poses if poses is None else poses
        return poses[self.rows[..., 0], self.rows[..., 1]]


def make_pose_table(scene: Scene, matches: Matches) -> PoseTable:
    """Makes the table of the dataset's poses, and of each match's place in it."""
    of_views = [compute_readout_poses(view) for view in scene.views]
    moments = max(len(poses) for poses in of_views)
    table = np.array([np.resize(poses, (moments, 4, 4)) for poses in of_views])
    rows = np.zeros((2, len(matches), 2), np.int64)
    for side in (0, 1):
        of_match = matches.pairs[matches.pair, side]
        rows[side, :, 0] = of_match
        for index in np.unique(of_match):
            here = of_match == index
            view = scene.views[index]
            rows[side, here, 1] = find_readout_moments(
                view, scene.cameras[view.camera_index], matches.pixels[side, here]
            )
    return PoseTable(table, rows)


def rate_pairs(errors: np.ndarray, matches: Matches, focal: float) -> np.ndarray:
    """Returns the mean capped error (P,) of each pair: 0 if all its matches fit, 1 if none does.

    Args:
        errors: (M,) radians, NaN where there is no ray.
        matches: of all pairs.
        focal: pixels a radian.
    """
    tolerance = TOLERANCE * matches.diagonal / 1000 / focal
    capped = np.minimum(np.where(np.isfinite(errors), errors, np.inf) / tolerance, 1.0)
    sums = np.bincount(matches.pair, capped, len(matches.pairs))
    return sums / np.bincount(matches.pair, minlength=len(matches.pairs))


def rate_matches(errors: np.ndarray, matches: Matches, focal: float) -> float:
    """Returns the mean of `rate_pairs`."""
    return float(np.mean(rate_pairs(errors, matches, focal)))
