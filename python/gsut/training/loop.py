"""Makes training steps: the state of a run between two steps, and one step, stage by stage."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.data.scene import Level, TrainingViews
from gsut.gaussians import Gaussians
from gsut.optimize import (
    DENSIFY_FROM,
    DENSIFY_UNTIL,
    GaussianOptimizer,
    LearningRates,
    TrajectoryMean,
    choose_view,
    compute_learning_rates,
    find_last_densification,
)
from gsut.refine import TracksResult, TrainingRefiner
from gsut.render import Light
from gsut.run import TrainOptions
from gsut.run.options import FLAT_PRIMITIVES, Recipe
from gsut.training.densification import DensificationStep, load_strategy
from gsut.training.drawing import Drawing
from gsut.training.first import choose_first_gaussians
from gsut.training.photograph import CutOut, Outliers, PhotographModel
from gsut.training.surface import SurfaceTerms

# Share of the steps from which Gaussians are drawn along the ray, if they are to be: until then the
# distance, in less than half the time, leads to the same quality.
RAY_FROM = 0.6
# Weight of 1 - SSIM in the loss, beside that of the mean absolute difference (published).
SSIM_WEIGHT = 0.2
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
        options: of the run.
        start: the first Gaussians; None: `choose_first_gaussians`.
        tracks: gives the first poses if they come from tracks of features; None: the scene's.
        light: of the photographs, if an earlier run has found it.
        context: Gaussians that are drawn with the trained ones and not changed.
        recipe: None: the one that follows from the options, without growth beyond the cap if
            `start` is given.

    Attributes:
        views: photographs, poses and lenses; the only owner of the latter two.
        photographs: their exposure, white balance and falloff.
        outliers: what moved in them.
        drawing: the renderer, and its gradients of the last picture.
        optimizer: owner of the Gaussians.
        notes: sentences on the first Gaussians for the report.
        step: number of steps made.
        seconds, cpu_seconds: of the steps alone, without reading images and measuring PSNR.
    """

    def __init__(
        self,
        scene: Scene,
        options: TrainOptions,
        start: Gaussians | None = None,
        tracks: TracksResult | None = None,
        light: Light | None = None,
        context: Gaussians | None = None,
        recipe: Recipe | None = None,
    ) -> None:
        scene = scene if tracks is None else tracks.scene
        self.options = options = dataclasses.replace(options, max_gaussians=options.most_gaussians)
        self.recipe = options.recipe if recipe is None else recipe
        if start is not None:
            self.recipe = dataclasses.replace(self.recipe, overgrowth=1.0)
        self.step, self.seconds, self.cpu_seconds = 0, 0.0, 0.0
        self._by_distance_until = RAY_FROM if start is None and options.order == "ray" else 0.0
        self.outliers, self.cut_out = Outliers(options, is_new=start is None), CutOut.find(scene)
        start, self.notes = choose_first_gaussians(scene, options) if start is None else (start, [])
        if self.cut_out is not None:
            self.notes.append(
                f"The photographs are cut out ({round(100 * self.cut_out.share)} % of their pixels "
                "are transparent): nothing is where alpha is 0. Use masks for what is only unknown."
            )
        self.densification = load_strategy(options, self.recipe, len(start))
        is_flat = options.primitive in FLAT_PRIMITIVES
        self.optimizer = GaussianOptimizer(
            start, self.densification.capacity, seed=options.seed, surfels=is_flat,
            atoms=options.primitive == "atom",
        )  # fmt: skip
        self.views = TrainingViews(scene, self.recipe.coarse_to_fine)
        refine, flat, moving = options.refine_poses, options.surface, self.outliers.find_moving
        self.refiner = TrainingRefiner(self.views, options, tracks, moving) if refine else None
        self.drawing = Drawing(context)
        self.photographs = PhotographModel(scene, options, light)
        self.surface = SurfaceTerms.choose(scene, flat)
        self._mean = TrajectoryMean(is_flat)

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
        """Returns the Gaussians as they are rendered: the trained ones, then the context."""
        return self.drawing.join(self.gaussians)

    def make_result(self) -> Gaussians:
        """Returns what the run would give now: the mean over the last steps."""
        return self._mean.average(self.gaussians)

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
        self._render(step, image)  # projection, raster
        self.photographs.observe(step.fraction, step.level, step.view, target, image)  # exposure
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
        if self._by_distance_until > 0.0:  # then along the ray
            late = fraction >= self._by_distance_until
            self.optimizer.arrays[0].order = o.order if late else "distance"
        rates = compute_learning_rates(self.recipe, fraction, self.extent)
        degree = min(o.sh_degree, number // self.recipe.sh_every)
        return _Step(
            number,
            fraction,
            self._choose_view(number),
            self.views.select_level(fraction),
            degree,
            rates,
        )

    def _choose_view(self, step: int) -> int:
        """Returns a step's view: each once an epoch, in an order set by seed and epoch only."""
        return choose_view(self.scene.train_indices, step, self.options.seed)

    def _prepare_next_image(self) -> None:
        after = self.step + 2
        if after <= self.options.steps:
            self.views.prepare(self._choose_view(after), after / self.options.steps)

    def _render(self, step: _Step, image: np.ndarray) -> None:
        """Renders the step's view: cameras and poses, projection, raster."""
        behind = self._choose_background(step)
        self.drawing.render(
            self.gaussians, step.level.scene.camera(step.view), self.scene.views[step.view].motion,
            image, background=behind, sh_degree=step.degree, tiles=self._choose_tiles(step),
        )  # fmt: skip

    def _choose_background(self, step: _Step) -> tuple[float, float, float]:
        """Returns the colour behind all Gaussians; behind objects a random one shows gaps."""
        fixed = self.options.background if self.cut_out is None else None
        return fixed or draw_background(self.options.seed, step.number)

    def _choose_tiles(self, step: _Step) -> np.ndarray | None:
        """Returns a flag (0 or 1) for each tile of 16 x 16 pixels to render; None: all."""
        return None

    def _choose_pixels(self, step: _Step, dimage: np.ndarray) -> None:
        """Zeros the loss' gradient (H, W, 3) in pixels that do not concern the step; none here."""

    def _compare(self, step: _Step, target: _core.PhotometricTarget) -> float:
        """Returns the loss against the photograph and writes its gradient to the image's buffer."""
        image, dimage = step.level.get_buffers(step.view)
        loss, _ = _core.photometric_loss(target, image, dimage, SSIM_WEIGHT)
        self._choose_pixels(step, dimage)
        self.outliers.leave_out(self.step, step.view, target, image, dimage)
        if self.cut_out is not None:
            behind = self._choose_background(step)
            self.cut_out.add_gradient(step.level.scene, step.view, image, dimage, behind)
        return loss

    def _backpropagate(self, step: _Step, dimage: np.ndarray) -> bool:
        """Propagates the image's gradient to the Gaussians; returns whether harmonics took their
        step, which saves the memory of their gradients.

        With a context they do not, and densification goes by gradients alone.
        """
        how: dict[str, Any] = {}
        if self.drawing.is_alone:
            how["harmonics_step"] = self.optimizer.prepare_harmonics_step(step.rates, step.degree)
            last = find_last_densification(self.recipe, self.options.steps)
            if self.densification.by_error and step.number <= last:
                how |= self._measure_pixel_errors(step, dimage)
        self.drawing.backpropagate(dimage, **how)
        return "harmonics_step" in how

    def _measure_pixel_errors(self, step: _Step, dimage: np.ndarray) -> dict[str, Any]:
        """Returns the errors that the backward pass sums for densification."""
        image, _ = step.level.get_buffers(step.view)
        errors = np.empty(image.shape[:2], np.float32)
        _core.pixel_errors(step.level.get_target(step.view), image, dimage, errors)
        return {"errors": errors, "error_sums": self.optimizer.error_sum}

    def _optimize(self, step: _Step, with_harmonics: bool) -> None:
        """Collects statistics for densification and makes one step of Adam."""
        optimizer, (gradients, touched, distances) = self.optimizer, self.drawing.get_trained()
        self.densification.add_gradients(optimizer, gradients)
        optimizer.accumulate(gradients.means, distances, touched)
        self._add_surface(step)
        optimizer.step(gradients, step.rates, touched, step.degree, with_harmonics)
        self.densification.explore(optimizer, step.rates.means)

    def _add_surface(self, step: _Step) -> None:
        """Adds the gradients of the surface terms, which densification does not count."""
        if self.surface is None or not self.surface.is_due(step.number, step.fraction):
            return
        more = self.surface.compute_gradients(
            self.get_drawn(), step.level.scene, step.view, self.drawing.rule, step.fraction
        )
        for name in ("means", "quats", "log_scales", "opacity_logits"):
            getattr(self.drawing.gradients, name)[...] += getattr(more, name)

    def _densify(self, step: _Step) -> None:
        """Adds and removes Gaussians at a step of densification."""
        if step.fraction < DENSIFY_FROM or step.number % self.recipe.densify_every:
            return
        now = DensificationStep(step.number, step.fraction, step.level.scene, self.extent)
        if step.fraction > DENSIFY_UNTIL:
            self.densification.settle(self.optimizer, now)
            return
        self.optimizer = self.densification.densify(self.optimizer, now)
        self.optimizer.sort_by_place()
        self._mean.restart()

    def _refine(self, step: _Step) -> None:
        """Refines poses and lenses against the Gaussians if a sweep is due."""
        if self.refiner is not None and self.refiner.is_due(step.number):
            self.refiner.sweep(self.get_drawn(), step.level, step.number, step.degree)
            if self.surface is not None:
                self.surface.known.forget()

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
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state that `state_dict` returned; the following steps have the same bits."""
        self.step = int(state["step"])
        self.seconds, self.cpu_seconds = state["seconds"], state.get("cpu_seconds", 0.0)
        self.densification.first_count = int(state["first_count"])
        for name, part in self._list_parts().items():
            part.load_state_dict(state.get(name, {}))  # "outliers" is not in older checkpoints
