"""`lab/run bench isa`: how far instruction sets differ in a render and in a short training."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
import random_scenes
import rendered_dataset
from tests.bench.harness import Benchmark, Column, Option, Row, Settings

_SEED = 3
_SIDE = 256  # pixels of the render
_GAUSSIANS = 2000


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the instruction sets of this machine."""
    for isa in gsut.machine.available_isas():
        yield {"isa": isa}


def measure(case: Row, settings: Settings) -> Row:
    """Renders and trains; the first instruction set is what others are compared with."""
    gaussians = rendered_dataset.truth(np.random.default_rng(_SEED), _GAUSSIANS)
    camera, pose = random_scenes.pinhole(_SIDE), rendered_dataset.poses()[1]
    images = []
    for isa in (gsut.machine.available_isas()[0], case["isa"]):
        gsut.machine.set_isa(isa)
        images.append(gsut.render(gaussians, camera, pose).image)

    def write(path: Path) -> None:
        rendered_dataset.write_dataset(path, np.random.default_rng(_SEED))

    scene = gsut.load_dataset(settings.make("rendered", write))
    options = gsut.TrainOptions(steps=settings.steps, preset="fast")
    result = gsut.train(scene, options, progress=False)
    return {
        "apart": float(np.abs(images[1] - images[0]).max()), "psnr": result.metrics["psnr"]
    }  # fmt: skip


BENCHMARK = Benchmark(
    help="how far instruction sets differ: a render, and a short training",
    columns=(
        Column("isa", "instructions"),
        Column("apart", "largest difference of a render", form=".1e"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(Option("steps", 150, "of the training"),),
)
