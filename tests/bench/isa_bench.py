"""How far the instruction sets differ: a render, and a short training, with each."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import gsut
import random_scenes
import rendered_dataset

HELP = "how far instruction sets differ: a render, and a short training"
_SEED, _SIDE = 3, 256


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--steps", type=int, default=150, metavar="N", help="[default 150]")


def run(arguments: argparse.Namespace) -> int:
    gaussians = rendered_dataset.truth(np.random.default_rng(_SEED), 2000)
    camera, pose = random_scenes.pinhole(_SIDE), rendered_dataset.poses()[1]
    options = gsut.TrainOptions(steps=arguments.steps, preset="fast")
    with tempfile.TemporaryDirectory(prefix="gsut-isa-") as folder:
        data = rendered_dataset.write_dataset(Path(folder) / "data", np.random.default_rng(_SEED))
        first = None
        print(f"{'':12} {'render, most':>12} {'PSNR':>9}  after {arguments.steps} steps")
        for isa in gsut.available_isas():
            gsut.set_isa(isa)
            image = gsut.render(gaussians, camera, pose).image
            first = image if first is None else first
            result = gsut.train(gsut.load_dataset(data), options, progress=False)
            apart = float(np.abs(image - first).max())
            print(f"{isa:12} {apart:12.1e} {result.metrics['psnr']:6.2f} dB", flush=True)
    return 0
