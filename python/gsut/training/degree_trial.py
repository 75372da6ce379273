"""Decides the degree of the harmonics by two short trainings, judged on views set aside from both.

Whether colours depend on the viewing direction enough for harmonics of a higher degree to show
unseen views better, and not only to learn noise, depends on scene, light and photographs together.
Two short trainings that differ in the degree alone measure it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from gsut.data import Scene
from gsut.data.scene import TEST_EVERY
from gsut.evaluate import mean_psnr
from gsut.run import TrainOptions
from gsut.run.options import is_from_preset, raise_degree
from gsut.training.first import choose_first_gaussians, find_plain_background
from gsut.training.loop import TrainingLoop

# The degrees compared: that of most presets, and that of 3DGS.
_DEGREES = (1, 3)
# Most views set aside: more cost time and do not change the decision.
_MOST_ASIDE = 32
# Fewest training views of which some can be set aside.
_FEWEST_VIEWS = 12
# Least mean gain in dB that decides for the higher degree: any scene gains a little in so few
# steps. Of few views aside the standard error says less than the mean.
_LEAST_GAIN = 0.1
# Bytes of photographs that a short training keeps; others are decoded again.
_KEPT_BYTES = 1 << 29


@dataclasses.dataclass(frozen=True)
class TrialSize:
    """The size of both short trainings of a run.

    Attributes:
        scale: of their images, to those of the run.
        gaussians: the most that each has.
        steps: of each; in half of them, any scene gains by a higher degree.
    """

    scale: float
    gaussians: int
    steps: int = 300

    def estimate_share(self, options: TrainOptions) -> float:
        """Estimates the processor time of both trainings, as a share of the run's.

        Half of a step's time goes by pixels, half by Gaussians, as in `Pace`.
        """
        step = (self.scale**2 + min(1.0, self.gaussians / options.most_gaussians)) / 2
        return len(_DEGREES) * self.steps * step / options.steps


# What a run can take, the best first.
_SIZES = (TrialSize(0.5, 15_000), TrialSize(0.25, 6_000))
# Largest share of a run's processor time that both short trainings may take.
_MOST_SHARE = 0.12


def choose_degree(
    scene: Scene, options: TrainOptions, show: Callable[[str, int, int], None] = lambda *_: None
) -> tuple[TrainOptions, str]:
    """Raises the degree of the harmonics if it is open and short trainings gain by it.

    Runs too short for these take the high degree: in few steps most scenes gain by it.

    Args:
        scene: as it is trained on.
        options: of the run.
        show: receives stage, steps done and steps in total of the short trainings.

    Returns:
        The options, and a sentence on the reason; "" if the user has given the degree.
    """
    if not is_from_preset(options, "sh_degree"):
        return options, ""
    low, high = _DEGREES
    views = len(scene.train_indices)
    if views < _FEWEST_VIEWS:
        return options, (
            f"harmonics of degree {options.sh_degree}, the preset's: {views} photographs are too "
            "few to compare degrees in short trainings (--sh-degree)"
        )
    sizes = [each for each in _SIZES if each.estimate_share(options) <= _MOST_SHARE]
    if not sizes:  # nor do so few steps show the noise that a higher degree learns
        chosen = raise_degree(options, high)
        return chosen, (
            f"harmonics of degree {chosen.sh_degree}: {options.steps} steps are too few to compare "
            "degrees in short trainings (--sh-degree)"
        )
    gains = measure_gains(scene, options, sizes[0], show)
    gain, error = gains.mean(), gains.std(ddof=1) / np.sqrt(len(gains))
    chosen = raise_degree(options, high) if gain > _LEAST_GAIN else options
    return chosen, (
        f"harmonics of degree {chosen.sh_degree}: in two short trainings, degree {high} showed "
        f"{len(gains)} photographs set aside {gain:+.2f} +- {error:.2f} dB better than degree "
        f"{low} (--sh-degree)"
    )


def measure_gains(
    scene: Scene,
    options: TrainOptions,
    size: TrialSize,
    show: Callable[[str, int, int], None] = lambda *_: None,
) -> np.ndarray:
    """Measures by how much a high degree of harmonics shows views better than a low one.

    Both trainings have the same first Gaussians and the same photographs, at a part of their size.

    Args:
        scene: as it is trained on; only its training photographs are used.
        options: of the run.
        size: of the short trainings.
        show: see `choose_degree`.

    Returns:
        (n,) differences of PSNR in dB on the views set aside from both trainings.
    """
    low, high = _DEGREES
    small = _set_aside(scene).scale_images(size.scale, keep_larger=True)
    o = dataclasses.replace(
        options, steps=size.steps, max_gaussians=min(size.gaussians, options.most_gaussians),
        sh_degree=high, refine_poses=False, refine_lens=False, surface=False,
        order="distance" if options.order == "ray" else options.order,
        background=options.background or find_plain_background(small),
    )  # fmt: skip
    first, _ = choose_first_gaussians(small, o)
    values: list[np.ndarray] = []
    for degree in (low, high):
        start = dataclasses.replace(first, sh=first.sh[:, : (degree + 1) ** 2].copy())
        loop = TrainingLoop(small, dataclasses.replace(o, sh_degree=degree), start)
        loop.views.keep_at_most(_KEPT_BYTES)
        while loop.step < size.steps:
            loop.advance()
            show("degree", len(values) * size.steps + loop.step, len(_DEGREES) * size.steps)
        values.append(_judge(loop))
    return values[1] - values[0]


def _set_aside(scene: Scene) -> Scene:
    """Returns the scene with some of its training views as its test views."""
    train = scene.train_indices
    aside = train[:: max(TEST_EVERY, -(-len(train) // _MOST_ASIDE))]
    rest = tuple(index for index in train if index not in aside)
    return scene.replace(train_indices=rest, test_indices=aside)


def _judge(loop: TrainingLoop) -> np.ndarray:
    """Returns PSNR in dB of each test view of a finished training."""
    scene, gaussians, light = loop.scene, loop.make_result(), loop.photographs.find_light()
    renderer, background = loop.drawing.renderer, loop.options.background
    return np.array([
        mean_psnr(scene, gaussians, [index], background, renderer, light)
        for index in scene.test_indices
    ])  # fmt: skip
