"""The training loop: the state of a run between two steps, and one step."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import numpy as np

from gsut import _core
from gsut.compact import compact, seen_views
from gsut.data import ImagePyramid, Scene
from gsut.evaluate import mean_psnr
from gsut.gaussians import Gaussians, filter_radii, low_pass, low_pass_backward
from gsut.lens import CalibrationWeights
from gsut.optimize import TrajectoryMean, grown_count, learning_rates, optimizer_of, view_of_step
from gsut.refine import TrainingRefiner
from gsut.render import DEFAULT_UNSCENTED
from gsut.run import Stopwatch, TrainOptions
from gsut.training.growth import GrowthLimit
from gsut.training.mini_splatting import densify_mini
from gsut.training.start import first_gaussians

# Held-out views that the curve of PSNR is measured on: a few, spread evenly.
_CURVE_VIEWS = 8
# 3DGS' adaptive density control: opacities are reset every so many steps of 30 000, and the sizes
# that separate cloning from splitting and that are pruned, in units of the extent.
_RESET_FRACTION = 0.1
_CLONE_SCALE, _PRUNE_SCALE = 0.01, 0.1
# Steps after which the low-pass filter's radii are found again (Mip-Splatting: 100).
_RADII_EVERY = 100


class TrainingLoop:
    """The state of a run between two steps; `advance` makes one.

    Args:
        scene: training views, cameras and points, at the resolution to train at.
        options: resolved.
        start: the first Gaussians; None: `first_gaussians`. Of `MixedGaussians` neither number nor
            degrees change.
    """

    def __init__(self, scene: Scene, options: TrainOptions, start: Any = None) -> None:
        self.limit = GrowthLimit(scene, options)
        options = dataclasses.replace(options, max_gaussians=self.limit.most)
        self.scene, self.options = scene, options
        self.step = 0
        self.seconds = 0.0  # of the steps alone, without reading images and measuring PSNR
        start = first_gaussians(scene, options) if start is None else start
        self.first_count = len(start)
        capacity = max(options.max_gaussians, len(start)) if options.strategy == "mcmc" else None
        self.optimizer = optimizer_of(start, capacity, options.seed)
        self.pyramid = ImagePyramid(scene, options.coarse_to_fine)
        lens = options.calibration_weights
        self.weights = None if lens is None else CalibrationWeights(lens, scene.cameras)
        self.refiner = TrainingRefiner(scene, options) if options.refine_poses else None
        self.renderer = _core.Renderer()
        self.rule = _core.BlendRule()
        self.stopwatch = Stopwatch()  # of the steps' stages, for gsut bench train
        self._gradients = self.optimizer.gaussians.zeros_like()
        self._touched = np.zeros(len(start), np.uint8)
        self._radii: np.ndarray | None = None  # of the low-pass filter, where there is one
        self._mean = TrajectoryMean(options.average_from)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now: views, valid until the next step."""
        return self.optimizer.gaussians

    def drawn(self) -> Gaussians:
        """The Gaussians as they are rendered: behind the low-pass filter, if any."""
        return self._filtered(self.optimizer.gaussians)

    def result(self) -> Gaussians:
        """What the run gives, were this its last step: the mean over the last steps, filtered."""
        return self._filtered(self._mean.of(self.optimizer.gaussians))

    def _filtered(self, g: Gaussians) -> Gaussians:
        if not self.options.low_pass:
            return g
        if self._radii is None or len(self._radii) != len(g):
            self._radii = self._filter_radii(g)
        return low_pass(g, self._radii)

    def advance(self) -> float:
        """One training step on one image; returns its loss."""
        o, step = self.options, self.step + 1
        fraction = step / o.steps
        view = self._view_of(step)
        level = self.pyramid.at(fraction)
        target, image, dimage = level.target(view), *level.buffers(view)
        if step < o.steps:
            self.pyramid.prepare(self._view_of(step + 1), (step + 1) / o.steps)
        degree = min(o.sh_degree, step // o.sh_every)
        rates = learning_rates(o, fraction, self.scene.extent)
        began = time.perf_counter()
        self.stopwatch.start()
        lap = self.stopwatch.lap

        g = self.optimizer.gaussians
        self._make_room(g)
        if step % _RADII_EVERY == 0:
            self._radii = None
        drawn = self.drawn()
        # cameras, poses -> projection -> raster
        self.renderer.render(
            drawn,
            level.camera(view),
            self.scene.views[view].motion,
            self.rule,
            o.background,
            degree,
            DEFAULT_UNSCENTED,
            image,
            None,
            None,
            True,
        )
        lap("render")
        # loss, and back through the raster to every parameter
        loss, _ = _core.photometric_loss(target, image, dimage, o.ssim_weight)
        if self.weights is not None:
            self.weights.apply(dimage)
        lap("loss")
        self.renderer.backward(
            dimage, None, None, self._gradients, self._touched, not o.sparse_adam, False
        )
        if self._radii is not None:
            low_pass_backward(g, self._radii, self._gradients)
        lap("backward")
        # optimize
        if o.strategy == "mcmc":
            self.optimizer.add_regularizer(
                self._gradients, o.opacity_regularizer, o.scale_regularizer
            )
        self.optimizer.accumulate(self._gradients.means, self.renderer.distances(), self._touched)
        lap("statistics")
        visible = self._touched if o.sparse_adam else None
        self.optimizer.step(self._gradients, rates, visible, degree)
        lap("adam")
        self.step = step
        if o.noise and o.strategy == "mcmc":
            self.optimizer.add_noise(rates.means)
            lap("noise")
        if step % o.densify_every == 0 and o.densify_from <= fraction <= o.densify_until:
            self._densify(fraction)
            self.limit.grown(step)
            self._radii = None
            self._mean.restart()
            lap("densify")
        if step == o.compact_at:
            self._compact()
            self._mean.restart()
            lap("densify")
        if self.refiner is not None and self.refiner.is_due(step):
            self.refiner.sweep(self.drawn(), level, step, degree)
            self._take_poses()
            lap("refine")
        self._mean.observe(step, fraction, self.optimizer.gaussians)
        self.seconds += time.perf_counter() - began
        return loss

    def finished_scene(self) -> Scene:
        """The scene with the poses and lenses that fit `result` best, were this the last step."""
        if self.refiner is not None:
            self.refiner.finish(self.result(), self.pyramid.at(1.0), self.step)
            return self.refiner.scene
        return self.scene

    def _take_poses(self) -> None:
        """Goes on with the refined poses and lenses."""
        assert self.refiner is not None
        before, self.scene = self.scene, self.refiner.scene
        if self.scene.file_cameras != before.file_cameras:
            self.pyramid.replace_lenses(self.scene.file_cameras)
        self._radii = None

    def history_row(self, loss: float) -> dict[str, Any] | None:
        """What is written down after this step, with the held-out PSNR when it is due."""
        o = self.options
        measure = self.step == o.steps or (o.eval_every and self.step % o.eval_every == 0)
        if not (measure or self.step % max(1, o.steps // 200) == 0):
            return None
        row = {
            "step": self.step,
            "seconds": self.seconds,
            "loss": loss,
            "num_gaussians": len(self.gaussians),
        }
        if measure and self.scene.test_indices:
            row["psnr"] = self._held_out_psnr()
        return row

    def state_dict(self) -> dict[str, Any]:
        """Everything that later steps depend on."""
        return {
            "step": self.step,
            "seconds": self.seconds,
            "first_count": self.first_count,
            "limit": self.limit.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "mean": self._mean.state_dict(),
            **({} if self.refiner is None else {"refiner": self.refiner.state_dict()}),
            **({} if self._radii is None else {"radii": self._radii}),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on exactly where `state_dict` was taken."""
        self.step = int(state["step"])
        self.seconds = float(state["seconds"])
        self.first_count = int(state["first_count"])
        self.limit.load_state_dict(state["limit"])
        self.optimizer.load_state_dict(state["optimizer"])
        self._mean.load_state_dict(state["mean"])
        if self.refiner is not None:
            self.refiner.load_state_dict(state["refiner"])
            self._take_poses()
        self._radii = state.get("radii")

    def _filter_radii(self, g: Gaussians) -> np.ndarray:
        views = [self.scene.views[i] for i in self.scene.train_indices]
        radii = filter_radii(
            g.means,
            [self.scene.cameras[view.camera_index] for view in views],
            np.array([view.camera_from_world for view in views]),
            self.options.low_pass,
        )
        return radii.astype(np.float32)

    def _view_of(self, step: int) -> int:
        """Every training view once an epoch, in an order that depends on seed and epoch only."""
        aside = self.limit.aside
        views = [view for view in self.scene.train_indices if view not in aside]
        return view_of_step(views, step, self.options.seed)

    def _densify(self, fraction: float) -> None:
        o = self.options
        if self.limit.aside:
            self._measure_growth(fraction)
        if o.strategy == "mcmc":
            self.optimizer.densify_mcmc(self._target_size(fraction), dead_opacity=o.dead_opacity)
            return
        if o.strategy == "mini":
            scene, extent = self.pyramid.at(fraction).scene, self.scene.extent
            self.optimizer = densify_mini(self.optimizer, scene, o, self.step, extent)
            return
        self.optimizer.densify_adaptive(
            clone_scale=_CLONE_SCALE * self.scene.extent,
            max_scale=_PRUNE_SCALE * self.scene.extent,
            prune_opacity=o.dead_opacity,
            max_gaussians=len(self.gaussians) if self._full_grown(fraction) else o.max_gaussians,
        )
        resets = max(1, round(_RESET_FRACTION * o.steps))
        if self.step % (math.ceil(resets / o.densify_every) * o.densify_every) == 0:
            self.optimizer.reset_opacities()

    def _target_size(self, fraction: float) -> int:
        if self._full_grown(fraction):
            return len(self.gaussians)
        return grown_count(self.options, self.first_count, fraction)

    def _full_grown(self, fraction: float) -> bool:
        """Whether the number of Gaussians is to stay."""
        o = self.options
        if o.compact_at is not None and self.step >= o.compact_at:
            return True
        return self.limit.auto and self.limit.ended

    def _measure_growth(self, fraction: float) -> None:
        """With --max-gaussians auto: ends growth when it no longer helps."""
        if self.pyramid.at(fraction).scene.cameras[0].width == self.scene.cameras[0].width:
            background, aside = self.options.background, self.limit.aside
            self.limit.observe(
                mean_psnr(self.scene, self.drawn(), aside, background, self.renderer)
            )

    def _make_room(self, g: Gaussians) -> None:
        if len(self._gradients) != len(g):
            self._gradients = g.zeros_like()
            self._touched = np.zeros(len(g), np.uint8)

    def _compact(self) -> None:
        """Fewer Gaussians from here on, seen through the training views, with new moments."""
        o, views = self.options, seen_views(self.scene, self.scene.train_indices)
        reduced = compact(self.gaussians, o.keep, method=o.compact_method, views=views, seed=o.seed)
        self.optimizer = self.optimizer.restarted(reduced.gaussians)

    def _held_out_psnr(self) -> float:
        test = self.scene.test_indices
        chosen = test[:: math.ceil(len(test) / _CURVE_VIEWS)]
        return mean_psnr(self.scene, self.result(), chosen, self.options.background, self.renderer)
