"""How well matches fit given poses and lenses: angles to epipolar planes, in pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut._core import CameraMotion
from gsut.check.matches import ImagePair
from gsut.data import Scene, inverse
from gsut.lens import Camera

# Error of a match beyond which it counts as plainly wrong, in thousandths of the image's diagonal:
# 2 pixels of the small images that features are sought in.
TOLERANCE = 3.0
_MOMENTS = 16  # of a rolling shutter's readout
_TINY = 1e-12


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


def gather(scene: Scene, pairs: Sequence[ImagePair]) -> Matches:
    """The matches of pairs of a scene's views as arrays."""
    number = np.repeat(np.arange(len(pairs)), [p.pixels.shape[1] for p in pairs])
    views = np.array([(p.first, p.second) for p in pairs], np.int64).reshape(-1, 2)
    lens = np.array([view.camera_index for view in scene.views])[views]  # (P, 2)
    camera = scene.cameras[0]
    return Matches(
        number, views, np.concatenate([p.pixels for p in pairs], axis=1), lens[number].T,
        float(np.hypot(camera.width, camera.height)),
    )  # fmt: skip


def rays_of(cameras: Sequence[Camera], matches: Matches) -> np.ndarray:
    """(2, M, 3) unit rays in camera axes; NaN where a pixel has none."""
    rays = np.full((2, len(matches), 3), np.nan)
    for side in (0, 1):
        for number in np.unique(matches.lens[side]):
            rows = matches.lens[side] == number
            found, valid = cameras[number].unproject(matches.pixels[side, rows])
            rays[side, rows] = np.where(np.asarray(valid)[:, None], found, np.nan)
    return rays


def pixels_per_radian(camera: Camera) -> float:
    """On the axis, or of a panorama the mean."""
    place, valid = camera.project(np.array([[0.0, 0.0, 1.0], [1e-4, 0.0, 1.0], [0.0, 1e-4, 1.0]]))
    if not np.all(valid):
        return float(np.hypot(camera.width, camera.height)) / 2
    return float(np.mean(np.linalg.norm(place[1:] - place[0], axis=1))) / 1e-4


@dataclasses.dataclass(frozen=True)
class PoseTable:
    """Where the cameras are: one pose a view, or one for each of some moments of its readout.

    Args:
        poses: (V, B, 4, 4) world_from_camera.
        rows: (2, M, 2) view and moment of each match's two images.
    """

    poses: np.ndarray
    rows: np.ndarray

    def of_matches(self, poses: np.ndarray | None = None) -> np.ndarray:
        """(2, M, 4, 4), of these poses (V, B, 4, 4) or the table's own."""
        poses = self.poses if poses is None else poses
        return poses[self.rows[..., 0], self.rows[..., 1]]


def pose_table(scene: Scene, matches: Matches) -> PoseTable:
    """The poses as the dataset gives them."""
    rolling = any(isinstance(view.motion, CameraMotion) for view in scene.views)
    moments = _MOMENTS if rolling else 1
    poses = np.empty((len(scene), moments, 4, 4))
    rows = np.zeros((2, len(matches), 2), np.int64)
    for side in (0, 1):
        rows[side, :, 0] = matches.pairs[matches.pair, side]
    for index, view in enumerate(scene.views):
        motion = view.motion
        if not isinstance(motion, CameraMotion):
            poses[index] = inverse(np.asarray(motion))
            continue
        poses[index] = [inverse(np.asarray(motion.at((b + 0.5) / moments))) for b in range(moments)]
        direction = motion.shutter.direction
        along = 1 if direction in ("top_to_bottom", "bottom_to_top") else 0
        camera = scene.cameras[view.camera_index]
        for side in (0, 1):
            here = rows[side, :, 0] == index
            share = matches.pixels[side, here, along] / (camera.width, camera.height)[along]
            if direction in ("bottom_to_top", "right_to_left"):
                share = 1 - share
            rows[side, here, 1] = np.clip((share * moments).astype(int), 0, moments - 1)
    return PoseTable(poses, rows)


def angular_errors(
    rays: np.ndarray, world_from_camera: np.ndarray, signed: bool = False
) -> np.ndarray:
    """(M,) radians by which two rays miss each other, or would meet behind a camera; NaN: no ray.

    Args:
        rays: (2, M, 3) in camera axes.
        world_from_camera: (2, M, 4, 4), or (2, M, 3, 4).
        signed: only by how much they miss each other, to which side: for least squares.
    """
    one, two = np.einsum("smij,smj->smi", world_from_camera[..., :3, :3], rays)
    base = world_from_camera[1, :, :3, 3] - world_from_camera[0, :, :3, 3]
    length = np.linalg.norm(base, axis=1)
    base = base / np.maximum(length, _TINY)[:, None]
    first, second = _cross(base, one), _cross(base, two)
    sizes = [np.sqrt(np.einsum("mi,mi->m", normal, normal)) for normal in (first, second)]
    across = np.einsum("mi,mi->m", two, first) / np.maximum(np.hypot(*sizes), _TINY)
    if signed:
        return across
    # Seen from further along the baseline a point lies at a larger angle to it.
    angles = [
        np.arctan2(size, np.einsum("mi,mi->m", base, ray))
        for size, ray in zip(sizes, (one, two), strict=True)
    ]
    behind = np.maximum(angles[0] - angles[1], 0.0) / np.sqrt(2)
    found = np.hypot(across, behind)
    still = length <= _TINY
    if still.any():
        apart = np.linalg.norm(_cross(one[still], two[still]), axis=1)
        turned = np.arctan2(apart, np.einsum("mi,mi->m", one[still], two[still]))
        found[still] = turned / np.sqrt(2)
    return found


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross of (M, 3), several times quicker for few rows."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def pair_costs(errors: np.ndarray, matches: Matches, focal: float) -> np.ndarray:
    """(P,) mean capped error of each pair: 0: all its matches fit; 1: none does.

    Args:
        errors: (M,) radians, NaN where there is no ray. focal: pixels a radian.
    """
    tolerance = TOLERANCE * matches.diagonal / 1000 / focal
    capped = np.minimum(np.where(np.isfinite(errors), errors, np.inf) / tolerance, 1.0)
    sums = np.bincount(matches.pair, capped, len(matches.pairs))
    return sums / np.bincount(matches.pair, minlength=len(matches.pairs))


def cost(errors: np.ndarray, matches: Matches, focal: float) -> float:
    """The mean of `pair_costs`: 0: all matches fit; 1: none does."""
    return float(np.mean(pair_costs(errors, matches, focal)))
