"""The models that `./run bench compact` starts from when given datasets, and their seconds."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.run import TrainOptions

# Seconds of training in metrics.json: processor time of the whole of it over the threads.
TRAIN_CPU = "train_seconds_processor"
# 3DGS' density control: until half of the steps, first opacity and size of a Gaussian; as good as
# no cap. Every 10 steps, so that there are about as many rounds as in its 15 000 steps: on
# sponza_fisheye at half size, 1000 steps, 62 000 Gaussians; every 50 steps hardly more than points.
_ADC: dict[str, Any] = {
    "strategy": "adaptive",
    "densify_until": 0.5,
    "densify_every": 10,
    "init_opacity": 0.1,
    "init_scale": 1.0,
    "max_gaussians": 10_000_000,
}


@dataclasses.dataclass(frozen=True)
class StartRecipe:
    """How starts are trained.

    Attributes:
        steps: of each.
        cap: most Gaussians of "mcmc" (the field's default is 500 000).
        lean: most Gaussians of "lean".
        scale: size of the images, of the originals'.

    Raises:
        InputError: a value out of range.
    """

    steps: int = 1500
    cap: int = 500_000
    lean: int = 100_000
    scale: float = 1.0

    def __post_init__(self) -> None:
        for start in STARTS:
            start_options(start, self)


def _mcmc(recipe: StartRecipe) -> dict[str, Any]:
    return {"max_gaussians": recipe.cap}


def _adc(recipe: StartRecipe) -> dict[str, Any]:
    return _ADC


def _lean(recipe: StartRecipe) -> dict[str, Any]:
    return {"max_gaussians": recipe.lean}


_RECIPES: dict[str, Callable[[StartRecipe], dict[str, Any]]] = {
    "mcmc": _mcmc,
    "adc": _adc,
    "lean": _lean,
}
# mcmc: gsut's recipe up to the cap; adc: adaptive density control as published but for the learning
# rates, uncapped; lean: gsut's recipe with few Gaussians.
STARTS = tuple(_RECIPES)


def check_start(start: str) -> None:
    """Raises InputError for a start that is unknown."""
    if start not in _RECIPES:
        raise InputError(f'start "{start}" is unknown; known: {", ".join(STARTS)}')


def start_options(start: str, recipe: StartRecipe) -> TrainOptions:
    """The options that a start is trained with.

    Raises:
        InputError: an unknown start, or a recipe out of range.
    """
    check_start(start)
    return TrainOptions(
        steps=recipe.steps, scale=recipe.scale, checkpoint_every=0, eval_every=0,
        **_RECIPES[start](recipe),
    )  # fmt: skip


def trained_start(data: str, start: str, recipe: StartRecipe, folder: str) -> Path:
    """The run of a start, FOLDER/DATASET_START; trained if it is not there yet.

    Raises:
        InputError: the run that is there was trained with other options.
    """
    import gsut
    from gsut.run import METRICS, RunFolder

    scene = gsut.load_dataset(data)
    path = Path(folder) / f"{scene.path.resolve().name}_{start}"
    options = start_options(start, recipe)
    if (path / METRICS).is_file():
        saved = RunFolder.open(path).read_options()  # the data may have chosen the background
        if saved != dataclasses.replace(options.resolved(), background=saved.background):
            raise InputError(f"{path} was trained with other options; give another --folder")
        return path
    clock = ThreadSeconds()
    gsut.train(scene, options, out=path, resume=path.exists(), progress=False)
    run = RunFolder.open(path)
    run.write_json(METRICS, run.read_json(METRICS) | {TRAIN_CPU: clock.seconds()})
    return path


class ThreadSeconds:
    """Processor seconds since it was made, over the number of threads."""

    def __init__(self) -> None:
        self._begun = time.process_time()

    def seconds(self) -> float:
        """Since it was made."""
        return (time.process_time() - self._begun) / _core.num_threads()
