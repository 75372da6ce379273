"""The training loop: the state of a run between two steps, and one step, stage by stage."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np

from gsut import _core
from gsut.compact import compact, seen_views
from gsut.data import Level, Scene, TrainingViews
from gsut.gaussians import Gaussians, LowPassFilter
from gsut.lens import CalibrationWeights
from gsut.optimize import (
    GaussianOptimizer,
    LearningRates,
    TrajectoryMean,
    last_densification,
    learning_rates,
    optimizer_of,
    view_of_step,
)
from gsut.refine import TracksResult, TrainingRefiner
from gsut.render import DEFAULT_UNSCENTED, Light, random_background
from gsut.run import Stopwatch, TrainOptions
from gsut.training.context import Context
from gsut.training.densification import DensificationStep, densification_of
from gsut.training.motion_blur import BlurRenderer, Exposure
from gsut.training.photograph_model import PhotographModel
from gsut.training.start import first_gaussians
from gsut.training.surface_terms import SurfaceTerms, SurfaceWeights

# Steps after which the low-pass filter's radii are found again (Mip-Splatting: 100).
_RADII_EVERY = 100
# Fraction of the steps after which areas that differ are left out: before, much of a scene does.
_ROBUST_FROM = 0.15


@dataclasses.dataclass(frozen=True)
class _Step:
    """What is given at the beginning of a step.

    Attributes:
        number: from 1; fraction: of all steps.
        view: whose photograph is trained on, at `level`.
        degree: of the harmonics in use.
    """

    number: int
    fraction: float
    view: int
    level: Level
    degree: int
    rates: LearningRates


class TrainingLoop:
    """The state of a run between two steps; `advance` makes one.

    Args:
        scene: training views, cameras and points, at the resolution to train at.
        options: resolved.
        start: the first Gaussians; None: `first_gaussians`. Of `MixedGaussians` neither number nor
            degrees change.
        tracks: gives the first poses where they come from tracks of features; None: the scene's.
        light: of the photographs, where a run before has found it.
        context: drawn with those that are trained, and stay as they are.

    Attributes:
        views: photographs, poses and lenses; the only owner of the latter.
        photographs: their exposure, white balance and falloff.
        optimizer: owner of the Gaussians.
        notes: what was found in the photographs before the first step.
        step: steps made.
        seconds, cpu_seconds: of the steps alone, without reading images and measuring PSNR.
        stopwatch: of the steps' stages, for ./run bench train.
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
        start, self.notes = first_gaussians(scene, options) if start is None else (start, [])
        self.densification = densification_of(options, len(start))
        surfels = options.primitive == "surfel"
        self.optimizer = optimizer_of(start, self.densification.capacity(), options.seed, surfels)
        self.views = TrainingViews(scene, options.coarse_to_fine)
        lens = options.calibration_weights
        self.weights = None if lens is None else CalibrationWeights(lens, scene.cameras)
        refine, flat = options.refine_poses, options.surface
        self.refiner = TrainingRefiner(self.views, options, tracks) if refine else None
        self.renderer: Any = _core.Renderer() if options.motion_blur is None else BlurRenderer()
        self._exposure = Exposure(scene, options.motion_blur)
        self.rule, self.stopwatch = _core.BlendRule(), Stopwatch()
        self._context = Context(context)
        self._gradients: Any = None  # of all that is drawn
        self._touched = np.zeros(0, np.uint8)
        self.photographs = PhotographModel(scene, options, light)
        self.surface = SurfaceTerms(SurfaceWeights(), scene, options.known_depth) if flat else None
        self._filter = LowPassFilter(options.low_pass, self.views.list_training_cameras)
        self._mean = TrajectoryMean(options.average_from, surfels)

    @property
    def scene(self) -> Scene:
        """At full resolution, with the poses and lenses as they are now."""
        return self.views.scene

    @property
    def extent(self) -> float:
        """Of the scene, world units: what rates and sizes are in proportion to."""
        return self.scene.extent

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now: views, valid until the next step."""
        return self.optimizer.gaussians

    def drawn(self) -> Gaussians:
        """The Gaussians as they are rendered: behind the low-pass filter, then the context."""
        return self._context.around(self._filter.apply(self.gaussians))

    def result(self) -> Gaussians:
        """What the run gives, were this its last step: the mean over the last steps, filtered."""
        return self._filter.apply(self._mean.of(self.gaussians))

    def finished_scene(self) -> Scene:
        """The scene with the poses and lenses that fit `result` best, were this the last step."""
        if self.refiner is not None:
            self.refiner.finish(self.result(), self.views.at(1.0), self.step)
        return self.scene

    def advance(self) -> float:
        """One training step on one image; returns its loss."""
        step = self._begin_step()
        target, image, dimage = step.level.target(step.view), *step.level.buffers(step.view)
        self._prepare_next_image()
        began, cpu_began = time.perf_counter(), time.process_time()
        self.stopwatch.start()
        self._render(step, image)
        self.photographs.observe(step.fraction, step.level, step.view, target, image)
        self.stopwatch.lap("light")
        loss = self._compare(step, target)
        taken = self._backpropagate(step, dimage)
        self._optimize(step, with_harmonics=not taken)
        self.step = step.number
        self._densify(step)
        self._refine(step)
        self._mean.observe(step.number, step.fraction, self.gaussians)
        self.seconds += time.perf_counter() - began
        self.cpu_seconds += time.process_time() - cpu_began
        return loss

    def _begin_step(self) -> _Step:
        o, number = self.options, self.step + 1
        fraction = number / o.steps
        return _Step(
            number, fraction, self._view_of(number), self.views.at(fraction),
            min(o.sh_degree, number // o.sh_every), learning_rates(o, fraction, self.extent),
        )  # fmt: skip

    def _view_of(self, step: int) -> int:
        """Every training view once an epoch, in an order that depends on seed and epoch only."""
        return view_of_step(self.scene.train_indices, step, self.options.seed)

    def _prepare_next_image(self) -> None:
        after = self.step + 2
        if after <= self.options.steps:
            self.views.prepare(self._view_of(after), after / self.options.steps)

    def _render(self, step: _Step, image: np.ndarray) -> None:
        """Cameras and poses -> projection -> raster."""
        if step.number % _RADII_EVERY == 0:
            self._filter.renew()
        drawn = self.drawn()
        if len(self._touched) != len(drawn):
            self._gradients = drawn.make_zeros()
            self._touched = np.zeros(len(drawn), np.uint8)
        behind = self.options.background or random_background(self.options.seed, step.number)
        place = self._exposure.places(self.scene, step.level, step.view)
        self.renderer.render(
            drawn, step.level.camera(step.view), place, self.rule, behind, step.degree,
            DEFAULT_UNSCENTED, image, None, None, True, None, self._tiles(step),
        )  # fmt: skip
        self.stopwatch.lap("render")

    def _tiles(self, step: _Step) -> np.ndarray | None:
        """Which tiles of 16 x 16 pixels the step renders, 0 or 1 each; None: all."""
        return None

    def _choose_pixels(self, step: _Step, dimage: np.ndarray) -> None:
        """Zeroes the loss' gradient (H, W, 3) in the pixels that the step is not about: none."""

    def _compare(self, step: _Step, target: _core.PhotometricTarget) -> float:
        """The loss against the photograph, and its gradient to the image."""
        image, dimage = step.level.buffers(step.view)
        loss, _ = _core.photometric_loss(target, image, dimage, self.options.ssim_weight)
        self._choose_pixels(step, dimage)
        if self.weights is not None:
            self.weights.apply(dimage)
        if self.options.robust and self.step >= _ROBUST_FROM * self.options.steps:
            _core.trim_gradient(target, image, dimage)
        self.stopwatch.lap("loss")
        return loss

    def _backpropagate(self, step: _Step, dimage: np.ndarray) -> bool:
        """From the image back through raster and projection; whether harmonics took their step."""
        how = _backward_settings(self, step) | _errors_to_sum(self, step, dimage)
        self.renderer.backward(dimage, None, None, self._gradients, self._touched, **how)
        self._filter.backpropagate(self.gaussians, self._context.trained(self._gradients))
        self.stopwatch.lap("backward")
        return "harmonics_step" in how

    def _optimize(self, step: _Step, with_harmonics: bool) -> None:
        """Statistics for densification, one step of Adam, and what the strategy adds to both."""
        optimizer, trained = self.optimizer, self._context.trained
        gradients, touched = trained(self._gradients), trained(self._touched)
        self.densification.add_gradients(optimizer, gradients)
        optimizer.accumulate(gradients.means, trained(self.renderer.distances()), touched)
        self.stopwatch.lap("statistics")
        self._add_surface(step)
        visible = touched if self.options.sparse_adam else None
        optimizer.step(gradients, step.rates, visible, step.degree, with_harmonics)
        self.stopwatch.lap("adam")
        self.densification.explore(optimizer, step.rates.means)
        self.stopwatch.lap("noise")

    def _add_surface(self, step: _Step) -> None:
        """The gradients of `--surface`, which densification does not count."""
        if self.surface is None or self.surface.share(step.fraction) == 0.0:
            return
        more = self.surface.gradients(
            self.drawn(), step.level.scene, step.view, self.rule, step.fraction
        )
        self._filter.backpropagate(self.gaussians, self._context.trained(more))
        for name in ("means", "quats", "log_scales", "opacity_logits"):
            getattr(self._gradients, name)[...] += getattr(more, name)
        self.stopwatch.lap("surface")

    def _densify(self, step: _Step) -> None:
        """Where it is due: more and fewer Gaussians; or once, many fewer (`compact_at`)."""
        o, scene = self.options, self.scene
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
            views = seen_views(scene, scene.train_indices)
            small = compact(
                self.gaussians, o.keep, method=o.compact_method, views=views, seed=o.seed
            )
            self.optimizer = self.optimizer.restarted(small.gaussians)
            self._begin_anew()

    def _begin_anew(self) -> None:
        """The Gaussians are others: what was kept of the old ones does not hold."""
        self._filter.renew()
        self._mean.restart()
        self.stopwatch.lap("densify")

    def _refine(self, step: _Step) -> None:
        """Poses and lenses against the Gaussians, where a sweep is due."""
        if self.refiner is not None and self.refiner.is_due(step.number):
            self.refiner.sweep(self.drawn(), step.level, step.number, step.degree)
            self._filter.renew()
            if self.surface is not None:
                self.surface.known.forget()
            self.stopwatch.lap("refine")

    def state_dict(self) -> dict[str, Any]:
        """Everything that later steps depend on."""
        return {
            "step": self.step,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "first_count": self.densification.first_count,
            "optimizer": self.optimizer.state_dict(),
            "mean": self._mean.state_dict(),
            "photographs": self.photographs.state_dict(),
            **({} if self.refiner is None else {"refiner": self.refiner.state_dict()}),
            **self._filter.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on exactly where `state_dict` was taken."""
        self.step = int(state["step"])
        self.seconds, self.cpu_seconds = state["seconds"], state.get("cpu_seconds", 0.0)
        self.densification.first_count = int(state["first_count"])
        self.optimizer.load_state_dict(state["optimizer"])
        self._mean.load_state_dict(state["mean"])
        self.photographs.load_state_dict(state["photographs"])
        if self.refiner is not None:
            self.refiner.load_state_dict(state["refiner"])
        self._filter.load_state_dict(state)


def _backward_settings(loop: TrainingLoop, step: _Step) -> dict[str, Any]:
    """What the backward pass is told beside the arrays.

    It takes the harmonics' step, which saves their gradients' memory, where one picture is made of
    what is trained alone, and what it does not show stays.
    """
    o, optimizer = loop.options, loop.optimizer
    settings: dict[str, Any] = {"write_untouched": not o.sparse_adam, "with_poses": False}
    is_plain = o.sparse_adam and o.motion_blur is None and loop._context.is_empty
    if is_plain and isinstance(optimizer, GaussianOptimizer):
        settings["harmonics_step"] = optimizer.harmonics_step(step.rates, step.degree)
    return settings


def _errors_to_sum(loop: TrainingLoop, step: _Step, dimage: np.ndarray) -> dict[str, Any]:
    """What the backward pass is told of errors that a densification will go by.

    Nothing beside Gaussians that stay: the next densification goes by gradients alone.
    """
    needed = loop.densification.by_error and step.number <= last_densification(loop.options)
    if not needed or not loop._context.is_empty:
        return {}
    target, (image, _) = step.level.target(step.view), step.level.buffers(step.view)
    errors = np.empty(image.shape[:2], np.float32)
    _core.pixel_errors(target, image, dimage, errors)
    return {"errors": errors, "error_sums": loop.optimizer.error_sum}
