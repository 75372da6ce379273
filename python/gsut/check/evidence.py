"""Gathers what photographs show, and rates poses and lenses by it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from gsut._core import CameraMotion
from gsut.check.matches import NOISE, ImagePair, match_neighbours, order_in_time
from gsut.data import Scene
from gsut.data.poses import OPENGL_FROM_OPENCV, invert_pose
from gsut.data.scene import find_line_times
from gsut.judge import (
    MOMENTS,
    SURE,
    Dataset,
    Matches,
    Structure,
    compute_cross_products,
    measure_angular_errors,
    score_errors,
)
from gsut.lens import Camera
from gsut.sfm.photographs import FEWEST_OF_MODEL

_FEWEST_SHARED = 6  # features that three images share, from which their scales are compared
_SAMPLE = 800  # matches, and shared features, by which hypotheses are tried: enough to choose
_FITTING = 0.5  # share of right matches, before anything is known of it


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Matches of neighbouring photographs, in groups: pairs of images, then triples.

    Args:
        scene: in the dataset's coordinates.
        given: its poses and lenses.
        pairs: the photographs that were matched.
        images: views of each group: of all pairs, then of the triples.
        pixels: (2, M, 2) of the matches.
        pair: (M,) which pair each belongs to.
        moments: (2, M) of a readout in moments.
        shared: (3, T) features that three images share: their matches before and after the middle
            image, and their group.
        diagonal: of the images, pixels.
    """

    scene: Scene
    given: Dataset
    pairs: list[ImagePair]
    images: list[tuple[int, ...]]
    pixels: np.ndarray
    pair: np.ndarray
    moments: np.ndarray
    shared: np.ndarray
    diagonal: float

    def __len__(self) -> int:
        return len(self.pair)

    @functools.cached_property
    def views(self) -> np.ndarray:
        """The two views (2, M) of each match."""
        return np.array([(p.first, p.second) for p in self.pairs], np.int64)[self.pair].T

    @functools.cached_property
    def sample(self) -> Evidence:
        """A sample of each pair's matches and each triple's features: errors are found faster."""
        shared = self.shared[:, :: -(-self.shared.shape[1] // _SAMPLE) or 1]
        every = np.arange(0, len(self), -(-len(self) // _SAMPLE))
        rows = np.unique(np.concatenate([every, shared[0], shared[1]]))
        return dataclasses.replace(
            self, pixels=self.pixels[:, rows], pair=self.pair[rows], moments=self.moments[:, rows],
            shared=np.concatenate([np.searchsorted(rows, shared[:2]), shared[2:]]),
        )  # fmt: skip

    @functools.cached_property
    def noise(self) -> float:
        """Returns the standard deviation of errors in pixels before anything is known of it."""
        return NOISE * self.diagonal

    @property
    def best_score(self) -> float:
        """Returns the score of a group of images all of whose matches fit exactly."""
        return float(self._score_errors(np.zeros(1))[0])

    @property
    def tolerance(self) -> float:
        """Returns the error in pixels beyond which a match is wrong, whatever the others are."""
        return SURE * self.noise

    @functools.cached_property
    def _rays_of_data(self) -> tuple[np.ndarray, np.ndarray]:
        return self._find_rays(self.given.cameras)

    def _find_rays(self, cameras: tuple[Camera, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Returns unit rays (2, M, 3) of the matches through lenses, NaN where there is none.

        And (2, M) the pixels that a radian covers there.
        """
        of_view = self.given.lens[self.views]
        rays = np.full((*of_view.shape, 3), np.nan)
        density = np.full(of_view.shape, np.nan)
        for number in np.unique(of_view):
            rows, camera = of_view == number, cameras[number]
            found, valid = camera.unproject(self.pixels[rows])
            rays[rows] = found = np.where(np.asarray(valid)[:, None], found, np.nan)
            x, y = np.moveaxis(camera.project_jacobian(found, with_params=False)[0], 1, 0)
            density[rows] = np.sqrt(np.linalg.norm(np.cross(x, y), axis=1))
        return rays, density

    def measure_errors(self, data: Dataset) -> np.ndarray:
        """Measures how far the matches, then shared features, are from what a dataset says.

        Of a match the distance from the epipolar lines, or from in front of the cameras (Sampson's
        distance; Hartley and Zisserman, "Multiple view geometry", 2003, equation 11.9), in pixels:
        a longer lens makes angles smaller and fits no better for it. Of a shared feature also by
        how far the distances disagree that the images before and after give.
        """
        is_given = data.cameras is self.given.cameras
        rays, density = self._rays_of_data if is_given else self._find_rays(data.cameras)
        moments = self.moments if data.poses.shape[1] > 1 else 0
        poses = data.poses[self.views, moments]
        with np.errstate(invalid="ignore"):
            errors = measure_angular_errors(rays, poses) * np.sqrt(density[0] * density[1])
        if not self.shared.size:
            return errors
        before, after, _ = self.shared
        distance, sine = triangulate_distances(rays, poses)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.log(distance[0, after] / distance[1, before])
            known = np.sqrt(sine[before] ** -2 + sine[after] ** -2)
            scale = np.abs(off) * density[0, after] / known
        both = np.maximum(errors[before], errors[after])
        return np.concatenate([errors, np.fmax(scale, both) + 0 * both])

    def score(self, data: Dataset) -> np.ndarray:
        """Returns the score (G,) of each group of images: nats a match, 0 if none fits."""
        group = np.concatenate([self.pair, self.shared[2]]) if self.shared.size else self.pair
        scores = self._score_errors(self.measure_errors(data))
        count = np.bincount(group, minlength=len(self.images))
        return np.bincount(group, scores, len(self.images)) / np.maximum(count, 1)

    def _score_errors(self, errors: np.ndarray) -> np.ndarray:
        return score_errors(errors, self.noise, _FITTING, self.diagonal)

    def shuffle(self, seed: int) -> np.ndarray:
        """Exchanges the rows (M,) of each pair's matches: what fits them so fits by chance."""
        order = np.arange(len(self))
        for number in range(len(self.pairs)):
            rows = np.flatnonzero(self.pair == number)
            order[rows] = np.random.default_rng([seed, number]).permutation(rows)
        return order

    def match_with(self, order: np.ndarray) -> Evidence:
        """Matches the first pixels with the second ones of other rows (M,)."""
        pixels, moments = (
            np.stack([each[0], each[1, order]]) for each in (self.pixels, self.moments)
        )
        return dataclasses.replace(self, pixels=pixels, moments=moments)

    def make_structure(self, data: Dataset, free: int = 0) -> Structure:
        """Makes what `prefer` compares of a dataset, with its number of estimated numbers."""
        errors = self.measure_errors(data)
        with np.errstate(invalid="ignore"):
            return Structure(np.where(errors < self.tolerance, errors, np.nan), free)

    @functools.cached_property
    def matches(self) -> Matches:
        """The images of matches and shared features, for `prefer`."""
        outer = [self.images[group][::2] for group in self.shared[2]]
        images = np.concatenate([self.views.T, np.array(outer, np.int64).reshape(-1, 2)])
        return Matches(images, self.diagonal)

    def find_shares(self, data: Dataset) -> np.ndarray:
        """Returns the share of each pair's matches (P,) that a dataset explains."""
        scores = self._score_errors(self.measure_errors(data)[: len(self)])
        share = 1 - (1 - _FITTING) * np.exp(-scores)
        count = len(self.pairs)
        return np.bincount(self.pair, share, count) / np.bincount(self.pair, minlength=count)

    @functools.cached_property
    def _triangulated(self) -> tuple[np.ndarray, np.ndarray]:
        """Computes distances (2, M) from both cameras, and (M,) whether a match shows them."""
        rays, density = self._rays_of_data
        distance, sine = triangulate_distances(rays, self._poses)
        good = self.measure_errors(self.given)[: len(self)] < self.tolerance
        good &= sine * density[0] > SURE * self.tolerance
        good &= np.isfinite(distance).all(axis=0)
        return distance, good

    @property
    def _poses(self) -> np.ndarray:
        """Returns the given poses (2, M, 4, 4) of the matches."""
        return self.given.poses[self.views, self.moments if self.given.poses.shape[1] > 1 else 0]

    def triangulate(self) -> np.ndarray:
        """Returns the points (N, 3) of matches that fit the given dataset, in the world."""
        (distance, good), poses = self._triangulated, self._poses[0]
        away = np.einsum("mij,mj->mi", poses[good, :3, :3], self._rays_of_data[0][0, good])
        return poses[good, :3, 3] + distance[0, good, None] * away

    def measure_distances(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns view (N,), pixel (N, 2) and distance (N,) of both images of these matches."""
        distance, good = self._triangulated
        return (
            self.views[:, good].ravel(),
            self.pixels[:, good].reshape(-1, 2),
            distance[:, good].ravel(),
        )

    def describe(self) -> str:
        """Counts matches and pairs, in words."""
        return f"{len(self):,} matches in {len(self.pairs)} pairs of neighbouring images"


def gather_evidence(scene: Scene, pairs: list[ImagePair] | None = None) -> Evidence | None:
    """Matches some neighbouring photographs; returns None if they share too few features.

    Args:
        scene: in the dataset's coordinates; some of its images are decoded.
        pairs: from `match_neighbours`, if already computed.
    """
    pairs = match_neighbours(scene) if pairs is None else pairs
    # Things that repeat along a path may mislead all pairs of three.
    if len({view for pair in pairs for view in (pair.first, pair.second)}) < FEWEST_OF_MODEL:
        return None
    shared, triples = _find_shared(scene, pairs)
    camera = scene.cameras[0]
    return Evidence(
        scene, make_dataset(scene), pairs, [(p.first, p.second) for p in pairs] + triples,
        np.concatenate([p.pixels for p in pairs], axis=1),
        np.repeat(np.arange(len(pairs)), [p.pixels.shape[1] for p in pairs]),
        np.concatenate([_find_moments(scene, pair) for pair in pairs], axis=1),
        shared, float(np.hypot(camera.width, camera.height)),
    )  # fmt: skip


def make_dataset(scene: Scene) -> Dataset:
    """Takes poses and lenses of a scene."""
    of_views = [_list_poses(view.motion) for view in scene.views]
    moments = max(len(poses) for poses in of_views)
    is_opengl = (scene.path / "transforms.json").is_file() or scene.path.suffix == ".json"
    return Dataset(
        np.array([np.resize(poses, (moments, 4, 4)) for poses in of_views]), tuple(scene.cameras),
        np.array([view.camera_index for view in scene.views], np.int64),
        OPENGL_FROM_OPENCV[:3, :3] if is_opengl else np.eye(3), order_in_time(scene),
    )  # fmt: skip


def _list_poses(motion: CameraMotion | np.ndarray) -> list[np.ndarray]:
    """Lists world_from_camera (4, 4): one, or one for each moment of a rolling readout."""
    if not isinstance(motion, CameraMotion):
        return [invert_pose(motion)]
    return [invert_pose(np.asarray(motion.at((k + 0.5) / MOMENTS))) for k in range(MOMENTS)]


def _find_moments(scene: Scene, pair: ImagePair) -> np.ndarray:
    """Returns the moment (2, M) of the readout at which each pixel is read, down the image."""
    found = []
    for index, pixels in zip((pair.first, pair.second), pair.pixels, strict=True):
        camera, motion = scene.camera(index), scene.views[index].motion
        times = pixels[:, 1] / camera.height
        if isinstance(motion, CameraMotion):
            times = find_line_times(camera, motion, pixels)
        found.append(np.clip((MOMENTS * times).astype(np.int64), 0, MOMENTS - 1))
    return np.stack(found)


def _find_shared(
    scene: Scene, pairs: Sequence[ImagePair]
) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Finds the features that a pair shares with the next one, and both pairs' three views.

    Both steps have as many frames, so that errors of a lens change both distances alike.
    """
    place = {view: k for path in order_in_time(scene) for k, view in enumerate(path)}
    steps = {(p.first, place[p.second] - place[p.first]): k for k, p in enumerate(pairs)}
    start = np.concatenate([[0], np.cumsum([p.pixels.shape[1] for p in pairs])])
    rows: list[tuple[int, int, int]] = []
    views: list[tuple[int, ...]] = []
    for number, pair in enumerate(pairs):
        other = steps.get((pair.second, place[pair.second] - place[pair.first]))
        if other is None:
            continue
        places = {tuple(pixel): k for k, pixel in enumerate(pair.pixels[1].tolist())}
        found = [
            (start[number] + places[tuple(pixel)], start[other] + k, len(pairs) + len(views))
            for k, pixel in enumerate(pairs[other].pixels[0].tolist()) if tuple(pixel) in places
        ]  # fmt: skip
        if len(found) >= _FEWEST_SHARED:
            rows += found
            views.append((pair.first, pair.second, pairs[other].second))
    return np.array(rows, np.int64).reshape(-1, 3).T, views


def triangulate_distances(rays: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangulates the features of matches (law of sines).

    Args:
        rays: (2, M, 3) in camera axes.
        poses: (2, M, 4, 4) world_from_camera.

    Returns:
        Distances (2, M) from both cameras, and (M,) the sine of the angle between both rays.
    """
    one, two = np.einsum("smij,smj->smi", poses[..., :3, :3], rays)
    base = poses[1, :, :3, 3] - poses[0, :, :3, 3]
    sine = np.linalg.norm(compute_cross_products(one, two), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = [compute_cross_products(base, ray) for ray in (two, one)]
        across = [np.linalg.norm(side, axis=1) / sine for side in sides]
    return np.array(across), sine
