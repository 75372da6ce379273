"""Holds the scene and poses of a video that grows image by image, see `find_video_poses`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.data import Scene, View
from gsut.data.poses import find_centers
from gsut.gaussians import Gaussians, merge_gaussians, seed_from_points
from gsut.lens import Camera
from gsut.refine import RefinedPose, refine_pose
from gsut.render import render
from gsut.run import TrainOptions
from gsut.sfm import PosesOptions
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import Features, Photographs
from gsut.sfm.points import BearingPoints
from gsut.sfm.solution import (
    MIN_ANGLE_DEGREES,
    Solution,
    evaluate_observations,
    measure_diagonal,
    transform_to_cameras,
)
from gsut.training.loop import TrainingLoop

# Pixels of the images that are compared; more take longer at the same accuracy.
_PIXELS = 60_000
# Steps of the training, which ends before: rates stay those of the first step.
_MOST_STEPS = 10_000_000
# Training steps after each of the first images.
_FIRST_STEPS = 60
# Training steps after each later image.
_STEPS = 20
# Latest images that every second step is spent on: they are trained least.
_RECENT = 4
# Latest images whose poses are refined again.
_WINDOW = 6
# Images between these refinements.
_WINDOW_EVERY = 3
# Training steps for each image before such a round.
_ROUND_STEPS = 3
# Levels of the image pyramid for a new image, whose predicted pose is off by many pixels.
_LEVELS = 3
# Pixels that `refine_pose` compares.
_COMPARED = 6000
# Pixels between new Gaussians.
_STRIDE = 3
# Alpha below which a pixel gets a new Gaussian.
_TRANSPARENT = 0.7
# Colour difference, values in [0, 1], above which a pixel gets a new Gaussian.
_WRONG = 0.06
# Points that give a new Gaussian its distance.
_NEIGHBORS = 4
# Learning rate of the centres, x median distance of the points.
_RATE = 2e-3
# Colour difference, x its median so far, above which an image is left out.
_LOST = 4.0


@dataclasses.dataclass(frozen=True)
class Video:
    """The images of a video and what is known of them before registration.

    Attributes:
        photographs: in order of time.
        cameras: the lens of each.
        features, pairs: of the images; verified.
        options: seed and max_error.
    """

    photographs: Photographs
    cameras: list[Camera]
    features: Sequence[Features]
    pairs: Sequence[PairMatches]
    options: PosesOptions


class _VideoLoop(TrainingLoop):
    """Trains on the images registered so far, every second step on the latest of them."""

    posed: list[int]
    recent = _RECENT

    def _choose_view(self, step: int) -> int:
        rng = np.random.default_rng([self.options.seed, step])
        latest = self.posed[-self.recent :] if rng.random() < 0.5 else self.posed
        return latest[int(rng.integers(len(latest)))]


class VideoScene:
    """Holds the scene and the poses so far.

    Args:
        video: its images.
        first: poses of the first images and how they were found.

    Attributes:
        points: triangulated from matched bearings.
        next: index of the next image to register.
        rounds: over all poses, done at the end.
    """

    def __init__(self, video: Video, first: dict[str, Any]) -> None:
        self._video = video
        photographs, cameras = video.photographs, video.cameras
        self._poses = np.full((len(photographs), 4, 4), np.nan)
        self._found: dict[int, RefinedPose] = {}
        max_error = video.options.max_error * measure_diagonal(cameras) / 1000
        self.points = BearingPoints(
            cameras, video.features, video.pairs, max_error, np.radians(MIN_ANGLE_DEGREES)
        )
        self._first, self.next, self.rounds = first, len(first["poses"]), 0
        for image, pose in enumerate(first["poses"]):
            self._poses[image] = pose
            self.points.add_image(image, self._poses)
        lenses = list(dict.fromkeys(cameras))
        self._lens_of = [lenses.index(camera) for camera in cameras]
        pixels = max(c.width * c.height for c in lenses)
        self._scene = Scene(
            photographs.root, tuple(lenses), self._list_views(), self.points.positions,
            self.points.colors, tuple(range(len(photographs))), (), np.zeros(3),
        ).scale_images(min(1.0, (_PIXELS / pixels) ** 0.5))  # fmt: skip
        self._options = TrainOptions(
            steps=_MOST_STEPS, max_gaussians=100_000_000, sh_degree=0, strategy="mini",
            init="points", seed=video.options.seed,
        )  # fmt: skip
        self._recipe = dataclasses.replace(
            self._options.recipe, coarse_to_fine=(0.0, 0.0), densify_every=_MOST_STEPS + 1,
            noise=False, lr_means_final_factor=1.0, lr_final_factor=1.0,
        )  # fmt: skip
        self._loop = _VideoLoop(self._scene, self._options, recipe=self._recipe)
        self._update_loop()

    def begin(self) -> None:
        """Trains the scene of the first images."""
        self._train(_FIRST_STEPS)
        for image in range(0, self.next, 3):
            self._add_gaussians(image)
            self._train(_FIRST_STEPS)

    def state_dict(self) -> dict[str, Any]:
        """Returns everything that later images depend on."""
        found = {
            str(image): {
                field.name: getattr(pose, field.name) for field in dataclasses.fields(pose)
            }
            for image, pose in self._found.items()
        }
        return {
            "first": self._first,
            "next": self.next,
            "rounds": self.rounds,
            "poses": self._poses,
            "found": found,
            "points": self.points.state_dict(),
            "loop": self._loop.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state that `state_dict` returned; what follows has the same bits."""
        self.next, self.rounds, self._poses = state["next"], state["rounds"], state["poses"]
        self._found = {int(image): RefinedPose(**pose) for image, pose in state["found"].items()}
        self.points.load_state_dict(state["points"])
        self._loop.load_state_dict(state["loop"])
        self._update_loop()

    @property
    def posed(self) -> np.ndarray:
        """Indices of the images with a pose."""
        return np.flatnonzero(~np.isnan(self._poses).any(axis=(1, 2)))

    def add_next(self) -> None:
        """Finds the pose of the next image and adds what it shows to the scene."""
        image = self.next
        self.next += 1
        try:
            found = self._refine_one(image, self._predict_pose(image), _LEVELS)
        except SolveError:
            return
        usual = [other.rms for other in self._found.values()]
        if usual and found.rms > _LOST * float(np.median(usual)):
            return
        self._accept(image, found)
        self.points.add_image(image, self._poses)
        self._update_loop()
        self._add_gaussians(image)
        self._train(_STEPS)
        if image % _WINDOW_EVERY == 0:
            self._refine_again(self._loop.posed[-_WINDOW:])

    def refine_all(self) -> None:
        """Trains on all images and refines all poses but the first."""
        self._loop.recent = len(self._loop.posed)
        self._train(_ROUND_STEPS * len(self.posed))
        self._refine_again(self._loop.posed[1:])
        self.rounds += 1

    def make_solution(self) -> Solution:
        """Returns poses and points as the solver does."""
        points, observations, n = (
            self.points.positions,
            self.points.observations,
            len(self._video.photographs),
        )
        pixels, residuals, angles = evaluate_observations(
            observations,
            transform_to_cameras(points, observations, self._poses),
            self._video.cameras,
            self._video.features,
        )
        lengths = np.linalg.norm(residuals, axis=1)
        seen = np.isfinite(lengths)
        counts = np.bincount(observations[seen, 0], minlength=len(points)).clip(1)
        sums = np.bincount(observations[seen, 0], lengths[seen], minlength=len(points))
        covariances = np.full((n, 6, 6), np.nan)
        for image, found in self._found.items():
            covariances[image] = found.covariance
        return Solution(
            self._video.photographs.names, self._video.cameras, np.isin(np.arange(n), self.posed),
            self._fill_in_poses(), covariances, points, self.points.colors,
            sums / counts, observations, pixels, residuals, angles,
            tuple(self._first["initial_pair"]), self._first["restarts"],
            float(np.sqrt(np.mean(lengths[seen] ** 2))), float(np.median(lengths[seen])), None,
            np.zeros((0, 3), np.int32),
        )  # fmt: skip

    def _fill_in_poses(self) -> np.ndarray:
        """Returns poses (N, 4, 4), the identity for images without one, which nothing reads."""
        return np.where(np.isnan(self._poses), np.eye(4), self._poses)

    def _list_views(self) -> tuple[View, ...]:
        p = self._video.photographs
        return tuple(
            View(p.names[i], p.paths[i], self._lens_of[i], pose, mask_path=p.masks[i])
            for i, pose in enumerate(self._fill_in_poses())
        )

    def _update_loop(self) -> None:
        """Passes the current poses to the training loop and scales its learning rate."""
        loop = self._loop
        loop.views.move(self._fill_in_poses())
        loop.posed = self.posed.tolist()
        middle = find_centers(self._poses[loop.posed]).mean(axis=0)
        distance = float(np.median(np.linalg.norm(self.points.positions - middle, axis=1)))
        loop.recipe = dataclasses.replace(
            self._recipe, lr_means=_RATE * distance / loop.scene.extent
        )

    def _train(self, steps: int) -> None:
        for _ in range(steps):
            self._loop.advance()

    def _predict_pose(self, image: int) -> np.ndarray:
        """Extrapolates the motion between the last two images."""
        before, last = self.posed[-2:]
        step = self._poses[last] @ np.linalg.inv(self._poses[before])
        steps = round((image - last) / (last - before))
        return np.linalg.matrix_power(step, steps) @ self._poses[last]

    def _refine_one(self, image: int, start: np.ndarray, levels: int) -> RefinedPose:
        return refine_pose(
            self._loop.gaussians, self._scene.camera(image), start, self._scene.image(image),
            self._scene.mask(image), levels=levels, max_pixels=_COMPARED,
        )  # fmt: skip

    def _accept(self, image: int, found: RefinedPose) -> None:
        self._poses[image], self._found[image] = found.camera_from_world, found

    def _refine_again(self, images: Sequence[int]) -> None:
        for image in images:
            try:
                self._accept(image, self._refine_one(image, self._poses[image], 1))
            except SolveError:
                continue  # it keeps its pose
        self.points.adjust(self._poses)
        self._update_loop()

    def _add_gaussians(self, image: int) -> None:
        """Adds Gaussians on a grid of pixels where the image is not yet rendered."""
        camera, pose = self._scene.camera(image), self._poses[image]
        photograph, gaussians = self._scene.image(image), self._loop.gaussians
        drawn = render(gaussians, camera, pose)
        difference = np.abs(drawn.image - photograph / np.float32(255)).mean(axis=-1)
        wanted = (drawn.alpha < _TRANSPARENT) | (difference > _WRONG)
        rows, columns = np.nonzero(wanted & self._scene.mask(image))
        on_grid = (rows + image) % _STRIDE + (columns + image // _STRIDE) % _STRIDE == 0
        rows, columns = rows[on_grid], columns[on_grid]
        distances = self._estimate_distances(camera, pose, np.stack([columns, rows], axis=1) + 0.5)
        if distances is None:
            return
        in_camera = camera.rays()[0][rows, columns] * distances[:, None]
        positions = (in_camera - pose[:3, 3]) @ pose[:3, :3]
        seeds = self._seed_gaussians(positions, photograph[rows, columns])
        alike = dataclasses.replace(seeds, response=gaussians.response, order=gaussians.order)
        both = merge_gaussians([gaussians, alike.to_primitive(gaussians.primitive)])
        self._loop.optimizer = self._loop.optimizer.restart_with(both)

    def _estimate_distances(
        self, camera: Any, pose: np.ndarray, pixels: np.ndarray
    ) -> np.ndarray | None:
        """Returns the geometric mean distance of the points seen nearest to each pixel."""
        in_camera = self.points.positions @ pose[:3, :3].T + pose[:3, 3]
        seen, valid = camera.project(in_camera)
        valid &= ((seen >= 0) & (seen < (camera.width, camera.height))).all(axis=1)
        seen, logarithms = seen[valid], np.log(np.linalg.norm(in_camera[valid], axis=1))
        count = min(_NEIGHBORS, len(seen))
        if count == 0 or len(pixels) == 0:
            return None
        squares = ((pixels[:, None] - seen[None]) ** 2).sum(axis=-1)
        near = np.argpartition(squares, count - 1, axis=1)[:, :count]
        weights = 1.0 / (np.take_along_axis(squares, near, axis=1) + 1.0)
        return np.exp((weights * logarithms[near]).sum(axis=1) / weights.sum(axis=1))

    def _seed_gaussians(self, positions: np.ndarray, colors: np.ndarray) -> Gaussians:
        """Seeds Gaussians as large as the distance to their neighbours, new and old."""
        o, old = self._options, np.asarray(self._loop.gaussians.means, np.float64)
        return seed_from_points(
            np.concatenate([positions, old]),
            np.concatenate([colors, np.zeros((len(old), 3), np.uint8)]),
            sh_degree=o.sh_degree, seed=o.seed,
        )[: len(positions)]  # fmt: skip
