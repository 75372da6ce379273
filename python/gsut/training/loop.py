"""Makes training steps: the state of a run between two steps, and one step, stage by stage."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np

from gsut import _core
from gsut.compact import compact, list_seen_views
from gsut.data import Scene
from gsut.data.scene import Level, TrainingViews
from gsut.gaussians import Gaussians, LowPassFilter
from gsut.lens import CalibrationWeights
from gsut.optimize import (
    GaussianOptimizer,
    LearningRates,
    TrajectoryMean,
    choose_view,
    compute_learning_rates,
    find_last_densification,
    make_optimizer,
)
from gsut.refine import TracksResult, TrainingRefiner
from gsut.render import Light
from gsut.run import Stopwatch, TrainOptions
from gsut.run.options import FLAT_PRIMITIVES
from gsut.training.context import Context
from gsut.training.densification import DensificationStep, load_strategy
from gsut.training.first import choose_first_gaussians
from gsut.training.photograph import BlurRenderer, Exposure, Outliers, PhotographModel
from gsut.training.surface import SurfaceTerms, SurfaceWeights

# Steps between updates of the low-pass filter's radii, as in Mip-Splatting.
_RADII_EVERY = 100
# Share of the steps from which Gaussians are drawn along the ray, if they are to be: until then the
# distance, in less than half the time, leads to the same quality.
RAY_FROM = 0.6
# Training without a background of its own draws one a step from this stream of the run's seed.
_BACKGROUND_STREAM = 0xBAC6


def draw_background(seed: int, step: int) -> tuple[float, float, float]:
    """Draws the colour behind all Gaussians in one step of training."""
    red, green, blue = np.random.default_rng([seed, _BACKGROUND_STREAM, step]).random(3).tolist()
    return red, green, blue


@dataclasses.dataclass(frozen=True)
class _Step:
    """What is fixed at the beginning of a step.

    Attributes:
        number: of the step, from 1.
        fraction: of all steps.
        view: whose photograph is trained on.
        level: resolution of the step.
        degree: of the harmonics in use.
        rates: learning rates in world units.
    """

    number: int
    fraction: float
    view: int
    level: Level
    degree: int
    rates: LearningRates


class TrainingLoop:
    """Holds the state of a run between two steps; `advance` makes a step.

    Args:
        scene: training views, cameras and points, at the resolution to train at.
        options: resolved.
        start: the first Gaussians; None: `choose_first_gaussians`. `MixedGaussians` keep their
            number and degrees.
        tracks: gives the first poses if they come from tracks of features; None: the scene's.
        light: of the photographs, if an earlier run has found it.
        context: Gaussians that are drawn with the trained ones and not changed.

    Attributes:
        views: photographs, poses and lenses; the only owner of the latter two.
        photographs: their exposure, white balance and falloff.
        outliers: what moved in them.
        optimizer: owner of the Gaussians.
        notes: sentences on the first Gaussians for the report.
        step: number of steps made.
        seconds, cpu_seconds: of the steps alone, without reading images and measuring PSNR.
        stopwatch: of the stages of a step, for ./run bench train.
    """

    def __init__(
        self,
        scene: Scene,
        options: TrainOptions,
        start: Any = None,
        tracks: TracksResult | None = None,
        light: Light | None = None,
        context: Gaussians | None = None,
    ) -> None:
        scene = scene if tracks is None else tracks.scene
        self.options = options = dataclasses.replace(options, max_gaussians=options.most_gaussians)
        self.step, self.seconds, self.cpu_seconds = 0, 0.0, 0.0
        self._by_distance_until = RAY_FROM if start is None and options.order == "ray" else 0.0
        self.outliers = Outliers(options, is_new=start is None)
        start, self.notes = choose_first_gaussians(scene, options) if start is None else (start, [])
        self.densification = load_strategy(options, len(start))
        primitive, capacity = options.primitive, self.densification.capacity
        self.optimizer = make_optimizer(start, capacity, options.seed, primitive)
        self.views = TrainingViews(scene, options.coarse_to_fine)
        lens = options.calibration_weights
        self.weights = None if lens is None else CalibrationWeights(lens, scene.cameras)
        refine, flat, moving = options.refine_poses, options.surface, self.outliers.find_moving
        self.refiner = TrainingRefiner(self.views, options, tracks, moving) if refine else None
        self.renderer: Any = _core.Renderer() if options.motion_blur is None else BlurRenderer()
        self._exposure = Exposure(scene, options.motion_blur)
        self.rule, self.stopwatch = _core.BlendRule(), Stopwatch()
        self._context = Context(context)
        self._gradients: Any = None  # of all that is drawn
        self._touched = np.zeros(0, np.uint8)
        self.photographs = PhotographModel(scene, options, light)
        self.surface = SurfaceTerms(SurfaceWeights(), scene, options.known_depth) if flat else None
        self._filter = LowPassFilter(options.low_pass, self.views.list_training_cameras)
        self._mean = TrajectoryMean(options.average_from, primitive in FLAT_PRIMITIVES)

    @property
    def scene(self) -> Scene:
        """The scene at full resolution, with the current poses and lenses."""
        return self.views.scene

    @property
    def extent(self) -> float:
        """The scene's extent in world units, to which rates and sizes are proportional."""
        return self.scene.extent

    @property
    def gaussians(self) -> Gaussians:
        """The current Gaussians: views, valid until the next step."""
        return self.optimizer.gaussians

    def get_drawn(self) -> Gaussians:
        """Returns the Gaussians as they are rendered: low-pass filtered, then the context."""
        return self._context.append_to(self._filter.apply(self.gaussians))

    def make_result(self) -> Gaussians:
        """Returns what the run would give now: the mean over the last steps, filtered."""
        return self._filter.apply(self._mean.average(self.gaussians))

    def finish_scene(self) -> Scene:
        """Returns the scene with the poses and lenses that fit the run's result best."""
        if self.refiner is not None:
            self.refiner.finish(self.make_result(), self.views.select_level(1.0), self.step)
        return self.scene

    def advance(self) -> float:
        """Makes one training step on one image and returns its loss."""
        step = self._begin_step()  # view, resolution, degree of harmonics, learning rates
        target, image, dimage = step.level.get_target(step.view), *step.level.get_buffers(step.view)
        self._prepare_next_image()  # decoded beside the step
        began, cpu_began = time.perf_counter(), time.process_time()
        self.stopwatch.start()
        self._render(step, image)  # projection, raster
        self.photographs.observe(step.fraction, step.level, step.view, target, image)  # exposure
        self.stopwatch.record_lap("light")
        loss = self._compare(step, target)  # loss and its gradient to the image
        taken = self._backpropagate(step, dimage)  # to the Gaussians
        self._optimize(step, with_harmonics=not taken)  # Adam
        self.step = step.number
        self._densify(step)  # more, fewer or other Gaussians
        self._refine(step)  # poses and lenses
        self.outliers.observe(step, self.get_drawn, self.photographs)  # what moved
        self._mean.observe(step.number, step.fraction, self.gaussians)  # of the last steps
        self.seconds += time.perf_counter() - began
        self.cpu_seconds += time.process_time() - cpu_began
        return loss

    def _begin_step(self) -> _Step:
        o, number = self.options, self.step + 1
        fraction = number / o.steps
        _choose_order(self, fraction)
        rates = compute_learning_rates(o, fraction, self.extent)
        degree = min(o.sh_degree, number // o.sh_every)
        view = choose_view(self.scene.train_indices, number, o.seed)
        return _Step(number, fraction, view, self.views.select_level(fraction), degree, rates)

    def _prepare_next_image(self) -> None:
        after = self.step + 2
        if after <= self.options.steps:
            view = choose_view(self.scene.train_indices, after, self.options.seed)
            self.views.prepare(view, after / self.options.steps)

    def _render(self, step: _Step, image: np.ndarray) -> None:
        """Renders the step's view: cameras and poses, projection, raster."""
        if step.number % _RADII_EVERY == 0:
            self._filter.renew()
        drawn = self.get_drawn()
        if len(self._touched) != len(drawn):
            self._gradients = drawn.make_zeros()
            self._touched = np.zeros(len(drawn), np.uint8)
        behind = self.options.background or draw_background(self.options.seed, step.number)
        camera = step.level.scene.camera(step.view)
        poses = self._exposure.find_poses(self.scene, step.level, step.view)
        look: dict[str, Any] = {
            "rule": self.rule, "background": behind, "sh_degree": step.degree,
            "tiles": self._choose_tiles(step),
        }  # fmt: skip
        several = isinstance(poses, list)
        jobs = [_core.RenderJob(camera, pose, **look) for pose in (poses if several else [poses])]
        self.renderer.render(drawn, jobs if several else jobs[0], image)
        self.stopwatch.record_lap("render")

    def _choose_tiles(self, step: _Step) -> np.ndarray | None:
        """Returns a flag (0 or 1) for each tile of 16 x 16 pixels to render; None: all."""
        return None

    def _choose_pixels(self, step: _Step, dimage: np.ndarray) -> None:
        """Zeros the loss' gradient (H, W, 3) in pixels that do not concern the step; none here."""

    def _compare(self, step: _Step, target: _core.PhotometricTarget) -> float:
        """Returns the loss against the photograph and writes its gradient to the image's buffer."""
        image, dimage = step.level.get_buffers(step.view)
        loss, _ = _core.photometric_loss(target, image, dimage, self.options.ssim_weight)
        self._choose_pixels(step, dimage)
        if self.weights is not None:
            self.weights.apply(dimage)
        self.outliers.leave_out(self.step, step.view, target, image, dimage)
        self.stopwatch.record_lap("loss")
        return loss

    def _backpropagate(self, step: _Step, dimage: np.ndarray) -> bool:
        """Propagates the image's gradient to the Gaussians; returns whether harmonics took their
        step."""
        how = _choose_backward_settings(self, step) | _measure_pixel_errors(self, step, dimage)
        self.renderer.backward(dimage, self._gradients, self._touched, **how)
        self._filter.backpropagate(self.gaussians, self._context.select_trained(self._gradients))
        self.stopwatch.record_lap("backward")
        return "harmonics_step" in how

    def _optimize(self, step: _Step, with_harmonics: bool) -> None:
        """Collects statistics for densification and makes one step of Adam."""
        optimizer, trained = self.optimizer, self._context.select_trained
        gradients, touched = trained(self._gradients), trained(self._touched)
        self.densification.add_gradients(optimizer, gradients)
        optimizer.accumulate(gradients.means, trained(self.renderer.distances()), touched)
        self.stopwatch.record_lap("statistics")
        self._add_surface(step)
        visible = touched if self.options.sparse_adam else None
        optimizer.step(gradients, step.rates, visible, step.degree, with_harmonics)
        self.stopwatch.record_lap("adam")
        self.densification.explore(optimizer, step.rates.means)
        self.stopwatch.record_lap("noise")

    def _add_surface(self, step: _Step) -> None:
        """Adds the gradients of the surface terms, which densification does not count."""
        if self.surface is None or not self.surface.is_due(step.number, step.fraction):
            return
        more = self.surface.compute_gradients(
            self.get_drawn(), step.level.scene, step.view, self.rule, step.fraction
        )
        self._filter.backpropagate(self.gaussians, self._context.select_trained(more))
        for name in ("means", "quats", "log_scales", "opacity_logits"):
            getattr(self._gradients, name)[...] += getattr(more, name)
        self.stopwatch.record_lap("surface")

    def _densify(self, step: _Step) -> None:
        """Adds and removes Gaussians at a step of densification; compacts them at `compact_at`."""
        o = self.options
        if step.fraction >= o.densify_from and step.number % o.densify_every == 0:
            full = o.compact_at is not None and step.number >= o.compact_at
            now = DensificationStep(step.number, step.fraction, step.level.scene, self.extent, full)
            if step.fraction <= o.densify_until:
                self.optimizer = self.densification.densify(self.optimizer, now)
                self.optimizer.sort_by_place()
                self._begin_anew()
            else:
                self.densification.settle(self.optimizer, now)
        if step.number == o.compact_at:
            self.optimizer = _compact(self)
            self._begin_anew()

    def _begin_anew(self) -> None:
        """Discards what was kept about Gaussians that are no longer the same."""
        self._filter.renew()
        self._mean.restart()
        self.stopwatch.record_lap("densify")

    def _refine(self, step: _Step) -> None:
        """Refines poses and lenses against the Gaussians if a sweep is due."""
        if self.refiner is not None and self.refiner.is_due(step.number):
            self.refiner.sweep(self.get_drawn(), step.level, step.number, step.degree)
            self._filter.renew()
            if self.surface is not None:
                self.surface.known.forget()
            self.stopwatch.record_lap("refine")

    def _list_parts(self) -> dict[str, Any]:
        """Lists the parts that have a state of their own."""
        parts = {"optimizer": self.optimizer, "mean": self._mean, "refiner": self.refiner,
                 "photographs": self.photographs, "outliers": self.outliers}  # fmt: skip
        return {name: part for name, part in parts.items() if part is not None}

    def state_dict(self) -> dict[str, Any]:
        """Returns everything that later steps depend on."""
        return {
            "step": self.step, "seconds": self.seconds, "cpu_seconds": self.cpu_seconds,
            "first_count": self.densification.first_count,
            **{name: part.state_dict() for name, part in self._list_parts().items()},
            **self._filter.state_dict(),
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state that `state_dict` returned; the following steps have the same bits."""
        self.step = int(state["step"])
        self.seconds, self.cpu_seconds = state["seconds"], state.get("cpu_seconds", 0.0)
        self.densification.first_count = int(state["first_count"])
        for name, part in self._list_parts().items():
            part.load_state_dict(state.get(name, {}))  # "outliers" is not in older checkpoints
        self._filter.load_state_dict(state)


def _choose_order(loop: TrainingLoop, fraction: float) -> None:
    """Has Gaussians along the ray drawn by the distance in the first steps."""
    if loop._by_distance_until > 0.0:
        late = fraction >= loop._by_distance_until
        loop.optimizer.arrays[0].order = loop.options.order if late else "distance"


def _choose_backward_settings(loop: TrainingLoop, step: _Step) -> dict[str, Any]:
    """Returns the settings of the backward pass.

    The backward pass also makes the harmonics' step, which saves the memory of their gradients, if
    the picture shows trained Gaussians only and those that it does not show stay.
    """
    o, optimizer = loop.options, loop.optimizer
    settings: dict[str, Any] = {"write_untouched": not o.sparse_adam, "with_poses": False}
    is_plain = o.sparse_adam and o.motion_blur is None and loop._context.is_empty
    if is_plain and isinstance(optimizer, GaussianOptimizer):
        settings["harmonics_step"] = optimizer.prepare_harmonics_step(step.rates, step.degree)
    return settings


def _measure_pixel_errors(loop: TrainingLoop, step: _Step, dimage: np.ndarray) -> dict[str, Any]:
    """Returns the errors that the backward pass sums for a densification that uses them.

    With a context there are none: the next densification uses gradients alone.
    """
    needed = loop.densification.by_error and step.number <= find_last_densification(loop.options)
    if not needed or not loop._context.is_empty:
        return {}
    target, (image, _) = step.level.get_target(step.view), step.level.get_buffers(step.view)
    errors = np.empty(image.shape[:2], np.float32)
    _core.pixel_errors(target, image, dimage, errors)
    return {"errors": errors, "error_sums": loop.optimizer.error_sum}


def _compact(loop: TrainingLoop) -> Any:
    """Compacts the Gaussians to the share `keep` and returns a fresh optimizer of them."""
    o, views = loop.options, list_seen_views(loop.scene, loop.scene.train_indices)
    small = compact(loop.gaussians, o.keep, method=o.compact_method, views=views, seed=o.seed)
    return loop.optimizer.restart_with(small.gaussians)
