"""Refines poses, and optionally the lens, of the training views against the Gaussians in training.

A sweep holds the Gaussians and moves every training view by a few steps of Levenberg-Marquardt on
its colours (see pose.py), so that its render fits its photograph better; training then continues
with the new poses. Since many views see a Gaussian, the scene is their mean, and the error of a
single view shows as a shift. A similarity of the whole world changes no picture, so each sweep's
mean motion is removed (see motion.py), and the scene stays in the world of the first poses.

Poses from tracks of features, or else the given ones, are a prior, and the two halves of a
photograph's pixels check each other: a view moves only as far as its colours can be trusted (see
trust.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene
from gsut.data.scene import Level, TrainingViews
from gsut.gaussians import Gaussians
from gsut.lens import find_refinable_params
from gsut.refine.agreement import COMPARED_PIXELS
from gsut.refine.motion import extrapolate, measure_pose_changes, remove_mean_motion
from gsut.refine.pose import choose_pixels, select_inner_pixels
from gsut.refine.tracks import TracksResult
from gsut.refine.trust import Halves, Trust, select_half, weigh_lens, weigh_poses
from gsut.render import DEFAULT_UNSCENTED, choose_solid
from gsut.run import TrainOptions

# Fractions of the steps after which a sweep follows tracks: an unfinished scene misplaces views by
# more than tracks do, so poses wait until it is sharp.
_AFTER_TRACKS: tuple[float, ...] = (0.46, 0.56, 0.66, 0.76, 0.86)
# Fractions of the first and last sweep without tracks; the others lie evenly between.
_WITHOUT_TRACKS = (0.3, 0.88)
# Number of sweeps without tracks, at most: each renders all views.
_MOST_SWEEPS = 10
# Factor on the motion of every second sweep. Views that see the same parts hold each other back and
# move slowly; this speeds them up, and the next sweep brings back those that needed no help.
_OVERSHOOT = 2.0
# Colour difference beyond which a pixel counts less: about the noise and texture error of a render.
_LOSS_SCALE = 0.03
# Pixels of a view if all views are solved together for the lens they share.
_PIXELS_JOINT = 4_000
# Steps of the solver in a sweep during training, which moves the scene again anyway.
_ITERATIONS = 1
# Steps in the last sweep, against the finished scene.
_ITERATIONS_END = 3


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Medians over the views of what one sweep did, in degrees and world units.

    Attributes:
        weight: of the poses from colours against those that the views started from.
        error_degrees, error_moved: errors of the colours' poses, from the difference of halves.
        lens_weight, lens_sigma_px: the same for a refined lens.
    """

    step: int
    turned_degrees: float
    moved: float
    rms: float
    weight: float
    error_degrees: float
    error_moved: float
    lens_weight: float | None = None
    lens_sigma_px: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Converts the sweep for metrics.json."""
        return dataclasses.asdict(self)


class TrainingRefiner:
    """Schedules the sweeps that refine the training views, and makes them.

    Args:
        views: whose poses and lenses are refined.
        options: of the run.
        tracks: result of bundle adjustment of tracks before the first step; its poses are then
            the prior of all sweeps.
        find_moving: called with a view, width and height; returns (height, width) bool of pixels
            that show what moved, which no sweep compares, or None.

    Attributes:
        sweeps: figures of each sweep.

    Raises:
        InputError: a rolling shutter, a lens without one centre, or several lenses to refine.
    """

    def __init__(
        self,
        views: TrainingViews,
        options: TrainOptions,
        tracks: TracksResult | None = None,
        find_moving: Callable[[int, int, int], np.ndarray | None] = lambda *_: None,
    ) -> None:
        self._find_moving = find_moving
        self.views, self.options = views, options
        self.sweeps: list[Sweep] = []
        self.tracks: dict[str, Any] = {} if tracks is None else tracks.summarize()
        self.trust: Trust | None = None  # of the last sweep
        check_refinable(views.scene, options)
        tracked = [] if tracks is None else tracks.tracked
        # What sweeps start from.
        self._start: dict[str, Any] = {
            "poses": views.poses,
            "tracked": np.isin(views.scene.train_indices, tracked),
            "has_tracks": tracks is not None and bool(tracks.figures),
            "sigma": self.tracks["sigma_degrees"] if tracked else None,
            "lens": np.array(views.scene.file_cameras[0].params),
        }

    @property
    def _due(self) -> set[int]:
        """The steps after which a sweep follows."""
        steps, fractions = self.options.steps, _AFTER_TRACKS
        if not self._start["has_tracks"]:
            epochs = steps * (_WITHOUT_TRACKS[1] - _WITHOUT_TRACKS[0]) / len(self._start["poses"])
            count = max(2, min(_MOST_SWEEPS, round(epochs)))
            fractions = tuple(np.linspace(*_WITHOUT_TRACKS, count).tolist())
        return {max(1, round(fraction * steps)) for fraction in fractions}

    def is_due(self, step: int) -> bool:
        """Returns whether a sweep follows this step."""
        return step in self._due

    def sweep(self, gaussians: Gaussians, level: Level, step: int, sh_degree: int) -> None:
        """Refines every training view at a level's resolution; changes the views' poses."""
        overshoot = len(self.sweeps) % 2 == 1 and step != max(self._due)
        self._sweep(gaussians, level, step, sh_degree, _ITERATIONS, overshoot)

    def finish(self, gaussians: Gaussians, level: Level, step: int) -> None:
        """Makes the last sweep, with more solver steps, against the finished Gaussians."""
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
        before = self.views.poses
        drawn = gaussians.to_dtype(np.float32)
        halves, lenses, squares = [], [], []
        for half in (0, 1):
            views = [
                self._sample_view(level, index, step, half) for index in level.scene.train_indices
            ]
            groups = [views] if self.options.refine_lens else [[view] for view in views]
            found = [self._solve(drawn, level, group, sh_degree, iterations) for group in groups]
            poses = np.array([pose for each in found for pose in each["camera_from_world"]])
            halves.append(remove_mean_motion(poses, before))
            lenses.append(found[0]["lens_params"][0])
            squares += [each["rms_after"] ** 2 for each in found]
        both = Halves(*halves)
        self.trust = weigh_poses(
            both, *(self._start[name] for name in ("poses", "tracked", "sigma"))
        )
        after = both.average()
        if overshoot:
            after = remove_mean_motion(extrapolate(after, before, _OVERSHOOT), before)
        after = extrapolate(after, self._start["poses"], self.trust.weights)
        self.views.move(after)
        of_lens = self._set_lens(level, lenses) if self.options.refine_lens else {}
        changes = measure_pose_changes(after, before)
        sweep = Sweep(
            step, float(np.median(changes.degrees)), float(np.median(changes.distances)),
            float(np.sqrt(np.mean(squares))), float(np.median(self.trust.weights)),
            *(float(error) for error in self.trust.errors), **of_lens,
        )  # fmt: skip
        self.sweeps.append(sweep)

    def state_dict(self) -> dict[str, Any]:
        """Returns everything that later steps depend on."""
        return {
            **self.views.state_dict(),
            "sweeps": [sweep.as_dict() for sweep in self.sweeps],
            "tracks": self.tracks,
            "start": self._start,
            "trust": None if self.trust is None else dataclasses.asdict(self.trust),
        }

    def summarize(self) -> dict[str, Any]:
        """Summarizes tracks, sweeps and a refined lens for metrics.json."""
        scene = self.views.scene
        lens = [float(value) for value in scene.file_cameras[0].params]
        names = [scene.views[index].name for index in scene.train_indices]
        rejected = [] if self.trust is None else self.trust.list_rejected(names)
        note = "" if self.trust is None else self.trust.note(names)
        return {
            "gauge": "mean motion of the training views taken out after each sweep",
            "tracks": self.tracks,
            "sweeps": [sweep.as_dict() for sweep in self.sweeps],
            "rejected": rejected,
            **({"note": note} if note else {}),
            **({"lens_params": lens} if self.options.refine_lens else {}),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state of `state_dict`, to the bit."""
        self.views.load_state_dict(state)
        self.sweeps = [Sweep(**sweep) for sweep in state["sweeps"]]
        self.tracks, self._start, trust = state["tracks"], state["start"], state["trust"]
        self.trust = None if trust is None else Trust(**trust)

    def _set_lens(self, level: Level, params: list[np.ndarray]) -> dict[str, float]:
        """Moves the lens from its start towards the mean of those that both halves found."""
        (file,) = self.views.scene.file_cameras
        found = [
            level.scene.cameras[0].with_params(each).resize(file.width, file.height)
            for each in params
        ]
        weight, error = weigh_lens(found[0], found[1], file.with_params(self._start["lens"]))
        middle = np.mean([each.params for each in found], axis=0)
        lens = self._start["lens"] + weight * (middle - self._start["lens"])
        self.views.replace_lenses([file.with_params(lens)])
        return {"lens_weight": weight, "lens_sigma_px": error}

    def _sample_view(
        self, level: Level, index: int, step: int, half: int
    ) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """Samples pixels of a view's half, new ones each sweep: lens, pose, pixels and colours."""
        camera = level.scene.camera(index)
        seen = level.scene.mask(index) & camera.rays()[1]
        seen &= select_half(camera.height, camera.width, half)
        moving = self._find_moving(index, camera.width, camera.height)
        if moving is not None:
            seen &= ~moving
        if self.options.refine_lens:
            seen &= select_inner_pixels(camera)
        count = (_PIXELS_JOINT if self.options.refine_lens else COMPARED_PIXELS) // 2
        chosen = choose_pixels(seen, count, (self.options.seed, step, index))
        colors = level.scene.image(index).reshape(-1, 3)[chosen].astype(np.float32)
        view = level.scene.views[index]
        return view.camera_index, view.camera_from_world, chosen, colors / np.float32(255)

    def _solve(
        self,
        gaussians: Gaussians,
        level: Level,
        views: list[Any],
        sh_degree: int,
        iterations: int,
    ) -> dict[str, Any]:
        """Refines views together; those without pixels keep their poses."""
        used = [view for view in views if len(view[2])]
        out: dict[str, Any] = {
            "rms_after": 0.0,
            "lens_params": [c.params for c in level.scene.cameras],
        }
        poses = {id(view): view[1] for view in views}
        if used:
            settings: dict[str, Any] = {"loss_scale": _LOSS_SCALE, "max_iterations": iterations}
            if self.options.refine_lens:
                free = [find_refinable_params(camera) for camera in level.scene.cameras]
                settings["lens_free"] = [flags.astype(int).tolist() for flags in free]
            found = _core.refine_photometric(
                gaussians, level.scene.cameras, used, _core.BlendRule(),
                choose_solid(self.options.background), sh_degree, DEFAULT_UNSCENTED, settings,
            )  # fmt: skip
            poses |= {id(v): p for v, p in zip(used, found["camera_from_world"], strict=True)}
            out |= found
        return {**out, "camera_from_world": [poses[id(view)] for view in views]}


def check_refinable(scene: Scene, options: TrainOptions) -> None:
    """Rejects scenes whose poses cannot be refined.

    Raises:
        InputError: a rolling shutter, a lens without one centre, or several lenses to refine.
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
