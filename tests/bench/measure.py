"""Times of the fast renderer, the scalar baseline and a training step on one scene."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.render import DEFAULT_UNSCENTED
from tests.bench.accuracy import empty_gradients
from tests.bench.scenes import BenchScene

try:
    import gsut_scalar_baseline as scalar_baseline
except ModuleNotFoundError:
    scalar_baseline = None  # only a developer's build has it, see tests/bench/scalar_baseline

if TYPE_CHECKING:
    from gsut.training import TrainingLoop

FORWARD_STAGES = ("project", "records", "bin", "forward")
BACKWARD_STAGES = ("backward", "gradients")
# A measurement is repeated until both are reached, or for this long.
_LEAST_REPEATS = 3
_MOST_SECONDS = 8.0
_BACKGROUND = (0.0, 0.0, 0.0)


@dataclasses.dataclass
class Times:
    """The shortest times over some repeats, in seconds.

    Attributes:
        stages: stage -> (wall, processor) seconds, each the shortest of its own.
        repeats: how many there were.
    """

    stages: dict[str, tuple[float, float]]
    repeats: int

    def wall_ms(self, *stages: str) -> float:
        """Sum over stages, by the wall clock."""
        return 1e3 * sum(self.stages[stage][0] for stage in stages)

    def cpu_ms(self, *stages: str) -> float:
        """Sum over stages, processor time over the number of threads."""
        return 1e3 * sum(self.stages[stage][1] for stage in stages) / _core.num_threads()


def best_times(
    run: Callable[[], dict[str, tuple[float, float]]], repeats: int, warmups: int = 1
) -> Times:
    """Runs until `repeats` runs are done or some seconds have passed, at least 3 times.

    Args:
        run: makes one run and returns stage -> (wall, processor) seconds.
        repeats: at most; fewer than 3 are done as told.
        warmups: runs before that are not counted.
    """
    for _ in range(warmups):
        run()
    best: dict[str, tuple[float, float]] = {}
    began, done = time.perf_counter(), 0
    while done < repeats:
        if done >= _LEAST_REPEATS and time.perf_counter() - began > _MOST_SECONDS:
            break
        for stage, (wall, cpu) in run().items():
            old = best.get(stage, (np.inf, np.inf))
            best[stage] = (min(old[0], wall), min(old[1], cpu))
        done += 1
    return Times(best, done)


class FastRun:
    """The tiled renderer on one scene, with its buffers.

    Args:
        scene: what to render.
        rule: of blending.
        seed: of the loss' gradient at the pixels.

    Attributes:
        image: (H, W, 3), the last one.
        gradients: the last ones, all rows written.
        renderer: for its statistics.
    """

    def __init__(self, scene: BenchScene, rule: _core.BlendRule, seed: int = 0) -> None:
        self.scene, self.rule = scene, rule
        size = (scene.camera.height, scene.camera.width)
        self.image = np.zeros((*size, 3), np.float32)
        self.gradients = empty_gradients(scene.gaussians)
        self.renderer = _core.Renderer()
        self._touched = np.zeros(len(scene.gaussians), np.uint8)
        self._dimage = np.random.default_rng(seed).standard_normal((*size, 3), np.float32)

    def once(self, dimage: np.ndarray | None = None) -> dict[str, tuple[float, float]]:
        """Forward and backward; returns the times of their stages."""
        s = self.scene
        job = _core.RenderJob(
            s.camera, s.camera_from_world, rule=self.rule, background=_BACKGROUND,
            sh_degree=s.gaussians.sh_degree,
        )  # fmt: skip
        self.renderer.render(s.gaussians, job, self.image)
        self.renderer.backward(
            self._dimage if dimage is None else dimage,
            self.gradients,
            self._touched,
            with_poses=False,
        )
        return self.renderer.timings()


class ScalarRun:
    """The scalar baseline on one scene; as `FastRun`. widen: see ScalarRenderer.

    Raises:
        InputError: this installation was built without it.
    """

    def __init__(
        self, scene: BenchScene, rule: _core.BlendRule, widen: float = 1.0, seed: int = 0
    ) -> None:
        if scalar_baseline is None:
            raise InputError("the scalar baseline is not built here: ./run build in a clone does")
        self.scene, self.rule = scene, rule
        size = (scene.camera.height, scene.camera.width)
        self.image = np.zeros((*size, 3), np.float32)
        self.gradients = empty_gradients(scene.gaussians)
        self.renderer = scalar_baseline.ScalarRenderer(widen)
        self._alpha = np.zeros(size, np.float32)
        self._dimage = np.random.default_rng(seed).standard_normal((*size, 3), np.float32)

    def once(self, dimage: np.ndarray | None = None) -> dict[str, tuple[float, float]]:
        """Forward and backward; returns the times of their stages."""
        s = self.scene
        scalar_baseline.set_num_threads(_core.num_threads())
        try:
            self.renderer.render(
                s.gaussians, s.camera, s.camera_from_world, self.rule, _BACKGROUND,
                s.gaussians.sh_degree, DEFAULT_UNSCENTED, self.image, self._alpha,
            )  # fmt: skip
            self.renderer.backward(self._dimage if dimage is None else dimage, self.gradients)
        finally:
            scalar_baseline.set_num_threads(0)  # oneTBB obeys the least of all limits
        return self.renderer.timings()


def measure_step(scene: BenchScene, repeats: int) -> Times:
    """Times of whole training steps on a scene, see `step_loop` and `step_times`."""
    return step_times(step_loop(scene, repeats), repeats)


def step_loop(scene: BenchScene, repeats: int) -> TrainingLoop:
    """The training loop itself, on one view of the scene.

    The photograph is the scene's own picture, so the loss' gradient is rounding noise, and the
    learning rates are 0: the work of each step is that of the scene as it is. Sparse Adam, as by
    default; without MCMC noise and without densification, which `./run bench train` shows, but with
    the errors that it goes by.

    Args:
        scene: copied.
        repeats: steps that will be made, at most.
    """
    from gsut.optimize import GaussianOptimizer
    from gsut.run import TrainOptions
    from gsut.training import TrainingLoop

    steps = 1000 * max(1, repeats)
    rates: dict[str, Any] = dict.fromkeys(
        ("lr_means", "lr_scales", "lr_quats", "lr_opacity", "lr_sh0", "lr_sh_rest"), 0.0
    )
    degree = scene.gaussians.sh_degree
    options = TrainOptions(steps=steps, max_gaussians=_SEEDS, sh_degree=degree)
    recipe = dataclasses.replace(
        options.recipe, sh_every=1, coarse_to_fine=(0.0, 0.0), densify_every=steps // 2,
        noise=False, **rates,
    )  # fmt: skip
    loop = TrainingLoop(_one_view_scene(scene), options, recipe=recipe)
    loop.optimizer = GaussianOptimizer(scene.gaussians, seed=0)
    return loop


def _time_method(owner: Any, name: str, stage: str, stages: dict[str, tuple[float, float]]) -> None:
    """Lets a method write its (wall, processor) seconds to `stages` at each call."""
    method = getattr(owner, name)

    def run(*words: Any, **named: Any) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            return method(*words, **named)
        finally:
            stages[stage] = time.perf_counter() - wall, time.process_time() - cpu

    setattr(owner, name, run)


def step_times(loop: TrainingLoop, repeats: int) -> Times:
    """Steps `loop` up to `repeats` times.

    Returns:
        Times of the stages of `gsut.train`, with "render" and "backward" in their own stages, and
        "step", the whole step.
    """

    stages: dict[str, tuple[float, float]] = {}
    _time_method(loop, "_compare", "loss", stages)
    _time_method(loop.optimizer, "accumulate", "statistics", stages)
    _time_method(loop.optimizer, "step", "adam", stages)
    _time_method(loop, "advance", "step", stages)

    def step() -> dict[str, tuple[float, float]]:
        loop.advance()
        return stages | loop.drawing.renderer.timings()

    # Harmonics are switched on one degree a step.
    return best_times(step, repeats, warmups=2 + loop.options.sh_degree)


_SEEDS = 4  # Gaussians the loop is started with, before it gets the scene's


def _one_view_scene(scene: BenchScene) -> Any:
    """What the training loop needs of a dataset: one view with its picture."""
    camera = scene.camera  # by itself: the scene may go before the loop does
    image = np.zeros((camera.height, camera.width, 3), np.float32)
    job = _core.RenderJob(
        scene.camera, scene.camera_from_world, background=_BACKGROUND,
        sh_degree=scene.gaussians.sh_degree, keep=False,
    )  # fmt: skip
    _core.Renderer().render(scene.gaussians, job, image)
    pixels = (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    valid = np.asarray(camera.rays()[1], bool)
    view = SimpleNamespace(
        name="0", motion=scene.camera_from_world, camera_index=0, depth_path=None
    )
    return SimpleNamespace(
        path="bench", cameras=[camera], train_indices=[0], test_indices=[], extent=1.0,
        views=[view],
        points=np.eye(_SEEDS, 3), point_colors=np.eye(_SEEDS, 3, dtype=np.uint8),
        camera=lambda index: camera, image=lambda index: pixels, mask=lambda index: valid,
        alpha=lambda index: None,
    )  # fmt: skip
