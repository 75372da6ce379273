"""Poses of a video without bundle adjustment: a scene of Gaussians grows image by image.

The first images are solved by their features. From then on the pose of each image is the one from
which the Gaussians look like it (`refine_pose`), and where they do not yet, new Gaussians are
placed along the pixels' rays, as far away as the points that matched bearings make near them. This
is CF-3DGS (Fu et al., 2024) with bearings through the exact lens in place of a depth network.

Errors add up along the way: on two videos of 41 images through the demo's fisheye poses end 0.25
and 0.47 degrees off on average (0.5 % of the way), where bundle adjustment of features gives 0.08.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.data import Scene, View
from gsut.data.poses import centers_of
from gsut.gaussians import Gaussians, seed_from_points
from gsut.lens import Camera
from gsut.refine import RefinedPose, refine_pose
from gsut.render import render
from gsut.run import RunFolder, TrainOptions, read_checkpoint, write_checkpoint
from gsut.sfm import PosesOptions
from gsut.sfm.core import (
    Features,
    Images,
    PairMatches,
    Photographs,
    Solution,
    evaluate_observations,
    measure_diagonal,
    solve_poses,
    transform_to_cameras,
)
from gsut.sfm.points import BearingPoints
from gsut.training.loop import TrainingLoop

_FIRST_IMAGES = (8, 12, 16, 24, 40)  # solved by features: the fewest that can be
_PIXELS = 60_000  # of the images that are looked at
_FIRST_STEPS, _STEPS = 60, 20  # training steps after each image
_RECENT = 4  # images that every second step is spent on
_WINDOW, _WINDOW_EVERY = 6, 3  # poses refined again, and after how many images
_ROUNDS, _ROUND_STEPS = 3, 3  # at the end: all poses, then so many steps an image
_LEVELS, _COMPARED = 3, 6000  # of refine_pose
_STRIDE = 3  # pixels between new Gaussians
_TRANSPARENT, _WRONG = 0.7, 0.06  # alpha below, colour difference above which there are new ones
_NEIGHBORS = 4  # points that give a new Gaussian its distance
_RATE = 2e-3  # of the centres, x median distance of the points
_KEEP_EVERY = 5  # images
_LOST = 4.0  # times the median colour difference so far: the image is left out


def grow_poses(
    photographs: Photographs,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
    *,
    keep: Path | None = None,
) -> Solution:
    """A mapper for `find_poses` that registers images by their colours, in order of names.

    Args:
        photographs: of a video, with known lenses of one centre.
        features, pairs: of the images; verified.
        options: seed, max_error and min_angle.
        on_progress: told (registered, images, points, step).
        keep: a file that holds what has grown, written every few images: a run that was killed goes
            on from there, to the same bits. It belongs to these photographs and options, which
            the caller sees to. None: nothing is kept.

    Returns:
        Poses with the covariances of `refine_pose`, a lower bound; points where bearings meet.

    Raises:
        InputError: a lens is unknown or has not one centre.
        SolveError: the first images give no structure.
    """
    cameras = [c for c in photographs.cameras if c is not None]
    if len(cameras) < len(photographs) or not all(c.is_central for c in cameras):
        raise InputError("--photometric needs a known lens with one centre; give it by --camera")
    kept = None if keep is None else _read_kept(keep)
    if kept is None:
        first = _start(photographs, cameras, features, pairs, options, on_progress)
        growth = _Growth(photographs, cameras, features, pairs, options, first)
        growth.begin()
    else:
        growth = _Growth(photographs, cameras, features, pairs, options, kept["first"])
        growth.load_state_dict(kept)

    def show(step: str, to_keep: bool) -> None:
        if keep is not None and to_keep:
            RunFolder(keep.parent).write(
                keep.name, lambda path: write_checkpoint(path, growth.state_dict())
            )
        on_progress(len(growth.posed), len(photographs), len(growth.points.positions), step)

    show("grow", kept is None)
    while growth.next < len(photographs):
        growth.add_next()
        show("grow", growth.next % _KEEP_EVERY == 0)
    while growth.rounds < _ROUNDS:
        growth.round()
        show("all poses", True)
    return growth.solution()


def _read_kept(path: Path) -> dict[str, Any] | None:
    """What was kept; None where there is nothing, or a damaged file: it is made again."""
    try:
        return read_checkpoint(path) if path.exists() else None
    except InputError:
        return None


def _start(
    photographs: Photographs,
    cameras: Sequence[Camera],
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    options: PosesOptions,
    on_progress: Callable[[int, int, int, str], None],
) -> dict[str, Any]:
    """The poses of the first images by their features, and how they were found."""
    failure: SolveError | None = None
    for wanted in _FIRST_IMAGES:
        count = min(wanted, len(photographs))
        try:
            images = Images(photographs.names[:count], cameras[:count], features[:count])
            own = [pair for pair in pairs if pair.second < count]
            found = solve_poses(images, own, options, on_progress)
            if found.num_registered == count:
                return {
                    "poses": found.camera_from_world,
                    "initial_pair": list(found.initial_pair),
                    "restarts": found.restarts,
                }
        except SolveError as error:
            failure = error
        if count == len(photographs):
            break
    raise SolveError(
        f"the first {count} images give no structure to begin with"
        + (f" ({failure})" if failure else "; not all of them could be registered")
        + ": begin the video where the camera moves sideways past something with texture"
    )


class _VideoLoop(TrainingLoop):
    """Training on the images posed so far, every second step on the latest of them."""

    posed: list[int]
    recent = _RECENT

    def _view_of(self, step: int) -> int:
        rng = np.random.default_rng([self.options.seed, step])
        latest = self.posed[-self.recent :] if rng.random() < 0.5 else self.posed
        return latest[int(rng.integers(len(latest)))]


class _Growth:
    """The scene and the poses so far.

    Attributes:
        points: where bearings meet.
        next: the image to be posed next.
        rounds: over all poses, done at the end.
    """

    def __init__(
        self,
        photographs: Photographs,
        cameras: Sequence[Camera],
        features: Sequence[Features],
        pairs: Sequence[PairMatches],
        options: PosesOptions,
        first: dict[str, Any],
    ) -> None:
        self._photographs, self._cameras, self._features = photographs, list(cameras), features
        self._poses = np.full((len(photographs), 4, 4), np.nan)
        self._found: dict[int, RefinedPose] = {}
        max_error = options.max_error * measure_diagonal(self._cameras) / 1000
        self.points = BearingPoints(
            cameras, features, pairs, max_error, np.radians(options.min_angle)
        )
        self._first, self.next, self.rounds = first, len(first["poses"]), 0
        for image, pose in enumerate(first["poses"]):
            self._poses[image] = pose
            self.points.add_image(image, self._poses)
        lenses = list(dict.fromkeys(self._cameras))
        self._lens_of = [lenses.index(camera) for camera in self._cameras]
        pixels = max(c.width * c.height for c in lenses)
        self._scene = Scene(
            photographs.root, tuple(lenses), self._views(), self.points.positions,
            self.points.colors, tuple(range(len(photographs))), (), np.zeros(3),
        ).scaled(min(1.0, (_PIXELS / pixels) ** 0.5))  # fmt: skip
        self._options = TrainOptions(
            steps=10_000_000, max_gaussians=100_000_000, sh_degree=0, coarse_to_fine=(0.0, 0.0),
            strategy="adaptive", densify_until=0.0, densify_from=0.0, noise=False, eval_every=0,
            lr_means_final_factor=1.0, lr_final_factor=1.0, average_from=1.0,
            init="points", seed=options.seed,
        ).resolved()  # fmt: skip
        self._loop = _VideoLoop(self._scene, self._options)
        self._follow()

    def begin(self) -> None:
        """Makes the scene of the first images."""
        self._train(_FIRST_STEPS)
        for image in range(0, self.next, 3):
            self._fill(image)
            self._train(_FIRST_STEPS)

    def state_dict(self) -> dict[str, Any]:
        """All that later images depend on."""
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
        """Goes on exactly where `state_dict` was taken."""
        self.next, self.rounds, self._poses = state["next"], state["rounds"], state["poses"]
        self._found = {int(image): RefinedPose(**pose) for image, pose in state["found"].items()}
        self.points.load_state_dict(state["points"])
        self._loop.load_state_dict(state["loop"])
        self._follow()

    @property
    def posed(self) -> np.ndarray:
        """Indices of the images with a pose."""
        return np.flatnonzero(~np.isnan(self._poses).any(axis=(1, 2)))

    def add_next(self) -> None:
        """Finds the pose of the next image and grows the scene by what it shows."""
        image = self.next
        self.next += 1
        try:
            found = self._refined(image, self._guess(image), _LEVELS)
        except SolveError:
            return
        usual = [other.rms for other in self._found.values()]
        if usual and found.rms > _LOST * float(np.median(usual)):
            return
        self._take(image, found)
        self.points.add_image(image, self._poses)
        self._follow()
        self._fill(image)
        self._train(_STEPS)
        if image % _WINDOW_EVERY == 0:
            self._refine_again(self._loop.posed[-_WINDOW:])

    def round(self) -> None:
        """All poses against all that has been seen."""
        self._loop.recent = len(self._loop.posed)
        self._train(_ROUND_STEPS * len(self.posed))
        self._refine_again(self._loop.posed[1:])
        self.rounds += 1

    def solution(self) -> Solution:
        """In the form of the mapper by features."""
        points, observations, n = (
            self.points.positions,
            self.points.observations,
            len(self._photographs),
        )
        pixels, residuals, angles = evaluate_observations(
            observations,
            transform_to_cameras(points, observations, self._poses),
            self._cameras,
            self._features,
        )
        lengths = np.linalg.norm(residuals, axis=1)
        seen = np.isfinite(lengths)
        counts = np.bincount(observations[seen, 0], minlength=len(points)).clip(1)
        sums = np.bincount(observations[seen, 0], lengths[seen], minlength=len(points))
        covariances = np.full((n, 6, 6), np.nan)
        for image, found in self._found.items():
            covariances[image] = found.covariance
        return Solution(
            self._photographs.names, self._cameras, np.isin(np.arange(n), self.posed),
            self._all_poses(), covariances, points, self.points.colors,
            sums / counts, observations, pixels, residuals, angles,
            tuple(self._first["initial_pair"]), self._first["restarts"],
            float(np.sqrt(np.mean(lengths[seen] ** 2))), float(np.median(lengths[seen])), None,
            np.zeros((0, 3), np.int32),
        )  # fmt: skip

    def _all_poses(self) -> np.ndarray:
        """(N, 4, 4), the identity for images without a pose, which nothing looks at."""
        return np.where(np.isnan(self._poses), np.eye(4), self._poses)

    def _views(self) -> tuple[View, ...]:
        p = self._photographs
        return tuple(
            View(p.names[i], p.paths[i], self._lens_of[i], pose, mask_path=p.masks[i])
            for i, pose in enumerate(self._all_poses())
        )

    def _follow(self) -> None:
        """The training loop uses the poses as they are now."""
        loop = self._loop
        loop.views.move(self._all_poses())
        loop.posed = self.posed.tolist()
        middle = centers_of(self._poses[loop.posed]).mean(axis=0)
        distance = float(np.median(np.linalg.norm(self.points.positions - middle, axis=1)))
        loop.options = dataclasses.replace(
            self._options, lr_means=_RATE * distance / loop.scene.extent
        )

    def _train(self, steps: int) -> None:
        for _ in range(steps):
            self._loop.advance()

    def _guess(self, image: int) -> np.ndarray:
        """The motion between the last two images goes on."""
        before, last = self.posed[-2:]
        step = self._poses[last] @ np.linalg.inv(self._poses[before])
        steps = round((image - last) / (last - before))
        return np.linalg.matrix_power(step, steps) @ self._poses[last]

    def _refined(self, image: int, start: np.ndarray, levels: int) -> RefinedPose:
        return refine_pose(
            self._loop.gaussians, self._scene.camera(image), start, self._scene.image(image),
            self._scene.mask(image), levels=levels, max_pixels=_COMPARED,
        )  # fmt: skip

    def _take(self, image: int, found: RefinedPose) -> None:
        self._poses[image], self._found[image] = found.camera_from_world, found

    def _refine_again(self, images: Sequence[int]) -> None:
        for image in images:
            try:
                self._take(image, self._refined(image, self._poses[image], 1))
            except SolveError:
                continue  # it keeps its pose
        self.points.adjust(self._poses)
        self._follow()

    def _fill(self, image: int) -> None:
        """New Gaussians on a grid of pixels where the image is not yet rendered."""
        camera, pose = self._scene.camera(image), self._poses[image]
        photograph, gaussians = self._scene.image(image), self._loop.gaussians
        drawn = render(gaussians, camera, pose)
        difference = np.abs(drawn.image - photograph / np.float32(255)).mean(axis=-1)
        wanted = (drawn.alpha < _TRANSPARENT) | (difference > _WRONG)
        rows, columns = np.nonzero(wanted & self._scene.mask(image))
        on_grid = (rows + image) % _STRIDE + (columns + image // _STRIDE) % _STRIDE == 0
        rows, columns = rows[on_grid], columns[on_grid]
        distances = self._distances(camera, pose, np.stack([columns, rows], axis=1) + 0.5)
        if distances is None:
            return
        in_camera = camera.rays()[0][rows, columns] * distances[:, None]
        positions = (in_camera - pose[:3, 3]) @ pose[:3, :3]
        seeds = self._seeds(positions, photograph[rows, columns])
        both = [
            np.concatenate([getattr(gaussians, field.name), getattr(seeds, field.name)])
            for field in dataclasses.fields(gaussians)
        ]
        self._loop.optimizer = self._loop.optimizer.restarted(Gaussians(*both))

    def _distances(self, camera: Any, pose: np.ndarray, pixels: np.ndarray) -> np.ndarray | None:
        """Geometric mean of the distances of the points that are seen nearest to each pixel."""
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

    def _seeds(self, positions: np.ndarray, colors: np.ndarray) -> Gaussians:
        """Gaussians as large as the distance to their neighbours, new and old."""
        o, old = self._options, np.asarray(self._loop.gaussians.means, np.float64)
        return seed_from_points(
            np.concatenate([positions, old]),
            np.concatenate([colors, np.zeros((len(old), 3), np.uint8)]),
            sh_degree=o.sh_degree, scale_factor=o.init_scale, opacity=o.init_opacity, seed=o.seed,
        )[: len(positions)]  # fmt: skip
