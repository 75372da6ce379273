"""Poses, and asked for the lens, of the training views refined against the Gaussians in training.

A sweep holds the Gaussians and moves every training view, by a few steps of Levenberg-Marquardt on
its colours (see refine.py), until its render fits its photograph better; training goes on with the
poses it found. Many views see a Gaussian, so that the scene is their mean and each view's own error
shows as a shift. What no view can tell, a similarity of the whole world, is held: each sweep's mean
motion is taken out (see refine_motion.py), and the scene stays in the world of the first poses.

Poses from tracks of features are a prior: how far a sweep leads away from them, against how well
tracks are known to place a view, says how much the colours are worth (see _weight).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.scene import Scene
from gsut.gaussians import Gaussians
from gsut.options import TrainOptions
from gsut.projection import DEFAULT_UNSCENTED
from gsut.pyramid import Level
from gsut.refine import chosen_pixels, inner_pixels
from gsut.refine_motion import moved_on, pose_changes, without_mean_motion

# Fractions of the steps after which a sweep follows. Poses wait for a scene that can tell them: a
# young one misplaces views by 0.2 degrees on sponza_fisheye, more than tracks do (0.03).
_AFTER_TRACKS = (0.46, 0.56, 0.66, 0.76, 0.86)
_WITHOUT_TRACKS, _MOST_SWEEPS = (0.3, 0.88), 10  # first and last, evenly spaced
# Views that share what they see follow each other slowly, single ones at once: every second sweep
# goes twice as far as it found, which quickens the former and leaves the latter to the next sweep.
_OVERSHOOT = 2.0
# Colour difference beyond which a pixel counts less. On sponza_fisheye with its true poses, poses
# wander by 0.0125 degrees with 0.03 and by 0.0135 with 0.1.
_LOSS_SCALE = 0.03
_PIXELS, _PIXELS_JOINT = 20_000, 4_000  # of a view, alone and where all views share the lens
_ITERATIONS, _ITERATIONS_END = 1, 3


@dataclasses.dataclass(frozen=True)
class Sweep:
    """What one sweep did: medians over the views, in degrees and world units."""

    step: int
    turned_degrees: float
    moved: float
    rms: float

    def as_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return dataclasses.asdict(self)


class TrainingRefiner:
    """When and how the training views are refined; `scene` holds their poses and lenses.

    Args:
        scene: at the resolution to train at.
        options: resolved.

    Attributes:
        scene: with the poses and lenses as they are now.
        sweeps: what each sweep did.
        tracks: what bundle adjustment of tracks did before the first step.

    Raises:
        InputError: a rolling shutter, a lens without one centre, or several lenses to refine.
    """

    def __init__(self, scene: Scene, options: TrainOptions) -> None:
        self.scene, self.options = scene, options
        self.sweeps: list[Sweep] = []
        self.tracks: dict[str, Any] = {}
        self._prior: dict[str, np.ndarray] | None = None
        check_refinable(scene, options)
        steps = options.steps
        fractions: Any = _AFTER_TRACKS
        if not options.refine_tracks:
            epochs = steps * (_WITHOUT_TRACKS[1] - _WITHOUT_TRACKS[0]) / len(scene.train_indices)
            count = max(2, min(_MOST_SWEEPS, round(epochs)))
            fractions = np.linspace(*_WITHOUT_TRACKS, count)
        self._due = {max(1, round(float(fraction) * steps)) for fraction in fractions}

    def is_due(self, step: int) -> bool:
        """Whether a sweep follows this step."""
        return step in self._due

    def sweep(self, gaussians: Gaussians, level: Level, step: int, sh_degree: int) -> None:
        """Refines every training view at a level's resolution; changes `scene`."""
        overshoot = len(self.sweeps) % 2 == 1 and step != max(self._due)
        self._sweep(gaussians, level, step, sh_degree, _ITERATIONS, overshoot)

    def finish(self, gaussians: Gaussians, level: Level, step: int) -> None:
        """The last sweep, with more steps, against the finished Gaussians."""
        self._sweep(gaussians, level, step, gaussians.sh_degree, _ITERATIONS_END, False)

    def _sweep(
        self,
        gaussians: Gaussians,
        level: Level,
        step: int,
        sh_degree: int,
        iterations: int,
        overshoot: bool,
    ) -> None:
        indices = self.scene.train_indices
        before = self.poses()
        scene = gaussians.astype(np.float32)
        free = self.options.refine_lens
        views = [
            self._view(level, index, step, _PIXELS_JOINT if free else _PIXELS) for index in indices
        ]
        if free:
            found = [self._solve(scene, level, views, sh_degree, iterations, True)]
            self._set_lens(level, found[0]["lens_params"][0])
        else:
            found = [
                self._solve(scene, level, [view], sh_degree, iterations, False) for view in views
            ]
        after = np.array([pose for each in found for pose in each["camera_from_world"]])
        after = without_mean_motion(after, before)
        if overshoot:
            after = without_mean_motion(moved_on(after, before, _OVERSHOOT), before)
        after = self._held_to_tracks(after)
        self._set_poses(after)
        changes = pose_changes(after, before)
        self.sweeps.append(
            Sweep(
                step,
                float(np.median(changes.degrees)),
                float(np.median(changes.distances)),
                float(np.sqrt(np.mean([each["rms_after"] ** 2 for each in found]))),
            )
        )

    def hold_to(self, tracked: list[int], figures: dict[str, Any]) -> None:
        """Makes the present poses, which came from tracks, the prior of all sweeps.

        Args:
            tracked: indices of the views that tracks have placed.
            figures: of `TracksResult`.
        """
        self.tracks = figures
        if tracked:
            self._prior = {
                "poses": self.poses(),
                "tracked": np.isin(self.scene.train_indices, tracked),
                "lens": np.array(self.scene.file_cameras[0].params),
                "farthest": np.zeros(2),
            }

    def _held_to_tracks(self, after: np.ndarray) -> np.ndarray:
        """Poses between those of the tracks and those of the colours; so is a refined lens."""
        if self._prior is None:
            return after
        prior, tracked = self._prior["poses"], self._prior["tracked"]
        changes = pose_changes(after[tracked], prior[tracked])
        here = np.array([np.median(changes.degrees), np.median(changes.distances)])
        self._prior["farthest"] = np.maximum(self._prior["farthest"], here)
        sigma = [self.tracks["sigma_degrees"], self.tracks["sigma_moved"]]
        weight = _weight(self._prior["farthest"], np.array(sigma))
        out = np.array(after)
        out[tracked] = moved_on(after[tracked], prior[tracked], weight)
        if self.options.refine_lens:
            (file,) = self.scene.file_cameras
            lens = self._prior["lens"] + weight * (np.array(file.params) - self._prior["lens"])
            self.scene = self.scene.with_lenses([file.with_params(lens)])
        return out

    def state_dict(self) -> dict[str, Any]:
        """Everything that later steps depend on."""
        return {
            "poses": self.poses(),
            "lenses": [np.array(camera.params) for camera in self.scene.file_cameras],
            "sweeps": [sweep.as_dict() for sweep in self.sweeps],
            "tracks": self.tracks,
            "prior": self._prior,
        }

    def figures(self) -> dict[str, Any]:
        """For metrics.json: what tracks and sweeps did, and the lens where it was refined."""
        lens = [float(value) for value in self.scene.file_cameras[0].params]
        return {
            "gauge": "mean motion of the training views taken out after each sweep",
            "tracks": self.tracks,
            "sweeps": [sweep.as_dict() for sweep in self.sweeps],
            **({"lens_params": lens} if self.options.refine_lens else {}),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on exactly where `state_dict` was taken."""
        self._set_poses(state["poses"])
        lenses = [
            camera.with_params(params)
            for camera, params in zip(self.scene.file_cameras, state["lenses"], strict=True)
        ]
        if lenses != self.scene.file_cameras:
            self.scene = self.scene.with_lenses(lenses)
        self.sweeps = [Sweep(**sweep) for sweep in state["sweeps"]]
        self.tracks, self._prior = state["tracks"], state["prior"]

    def poses(self) -> np.ndarray:
        """(n, 4, 4) camera_from_world of the training views, in their order."""
        return np.array([self.scene.views[i].camera_from_world for i in self.scene.train_indices])

    def _set_poses(self, poses: np.ndarray) -> None:
        self.scene = with_poses(self.scene, self.scene.train_indices, poses)

    def _set_lens(self, level: Level, params: np.ndarray) -> None:
        """The lens found at a level's size, as that of the files."""
        (file,) = self.scene.file_cameras
        at_level = level.scene.cameras[0].with_params(params)
        full = at_level.resized(file.width, file.height)
        self.scene = self.scene.with_lenses([full])

    def _view(
        self, level: Level, index: int, step: int, count: int
    ) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """Lens, pose, pixels and colours of a view; the pixels differ from sweep to sweep."""
        camera = level.camera(index)
        seen = level.scene.mask(index) & camera.rays()[1]
        if self.options.refine_lens:
            seen &= inner_pixels(camera)
        chosen = chosen_pixels(seen, count, (self.options.seed, step, index))
        colors = level.scene.image(index).reshape(-1, 3)[chosen].astype(np.float32)
        view = self.scene.views[index]
        return view.camera_index, view.camera_from_world, chosen, colors / np.float32(255)

    def _solve(
        self,
        gaussians: Gaussians,
        level: Level,
        views: list[Any],
        sh_degree: int,
        iterations: int,
        free: bool,
    ) -> dict[str, Any]:
        """The views that have pixels, refined together; those without keep their poses."""
        used = [view for view in views if len(view[2])]
        out: dict[str, Any] = {
            "rms_after": 0.0,
            "lens_params": [c.params for c in level.scene.cameras],
        }
        poses = {id(view): view[1] for view in views}
        if used:
            settings: dict[str, Any] = {"loss_scale": _LOSS_SCALE, "max_iterations": iterations}
            if free:
                settings["lens_free"] = [[1] * len(c.params) for c in level.scene.cameras]
            found = _core.refine_photometric(
                gaussians, level.scene.cameras, used, _core.BlendRule(), self.options.background,
                sh_degree, DEFAULT_UNSCENTED, settings,
            )  # fmt: skip
            poses |= {id(v): p for v, p in zip(used, found["camera_from_world"], strict=True)}
            out |= found
        return {**out, "camera_from_world": [poses[id(view)] for view in views]}


def _weight(distance: np.ndarray, sigma: np.ndarray) -> float:
    """What a step away from the tracks' poses is worth, 0 to 1.

    Colours and tracks err independently, so a median view that colours place at this distance from
    the tracks has distance^2 = sigma_tracks^2 + sigma_colours^2, and the best mean of both gives
    the colours sigma_tracks^2 / distance^2. The smaller of both kinds counts.

    Args:
        distance: (2,) degrees and world units. sigma: (2,) of the tracks, likewise.
    """
    return float(np.min(np.minimum(1.0, (sigma / np.maximum(distance, 1e-12)) ** 2)))


def check_refinable(scene: Scene, options: TrainOptions) -> None:
    """Refuses views whose poses cannot be refined.

    Raises:
        InputError: says which and what to do.
    """
    flag = "--refine-lens" if options.refine_lens else "--refine-poses"
    if any(scene.views[index].shutter is not None for index in scene.train_indices):
        raise InputError(
            f"{scene.path} has a rolling shutter, whose motion {flag} does not refine; leave it "
            "out, or train with --shutter global"
        )
    for camera in scene.cameras:
        if not camera.is_central:
            raise InputError(
                f"{flag} needs a lens with one centre, {scene.path} has {camera.model}; leave it "
                "out"
            )
    if options.refine_lens and len(scene.cameras) > 1:
        raise InputError(
            f"--refine-lens refines one lens, {scene.path} has {len(scene.cameras)}; split the "
            "data by lens, or refine the poses only (--refine-poses)"
        )


def with_poses(scene: Scene, indices: list[int], poses: np.ndarray) -> Scene:
    """The scene with other poses (n, 4, 4) of the views `indices`; its images stay decoded."""
    views = list(scene.views)
    for index, pose in zip(indices, poses, strict=True):
        views[index] = dataclasses.replace(views[index], camera_from_world=np.array(pose))
    return scene.with_views(views)
