"""A small dataset and the options that tests train it with in blocks."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from pathlib import Path
from unittest import mock

import numpy as np

import gsut
from rendered_dataset import write_dataset

OPTIONS = gsut.TrainOptions(
    steps=60, max_gaussians=400, sh_degree=1, seed=3, threads=1, init="points"
)
# States of three blocks that are together larger than the least object store of Ray, 80 MB.
LARGE_OPTIONS = dataclasses.replace(OPTIONS, max_gaussians=330_000, init="random", steps=50)
RESULTS = ("scene.ply", "blocks/layout.json")


def small_scene(path: Path) -> gsut.Scene:
    """Ten training views of a ball of blobs, two held out."""
    return gsut.load_dataset(write_dataset(path, np.random.default_rng(20260821)))


def train(
    scene: gsut.Scene,
    out: Path,
    blocks: str = "3",
    resume: bool = False,
    report: bool = False,
    training: gsut.TrainOptions = OPTIONS,
    **given,
):
    """A training of the small scene in blocks; a report takes as long as the training."""
    options = gsut.BlockOptions(blocks, **given)
    with contextlib.ExitStack() as stack:
        if not report:
            stack.enter_context(mock.patch("gsut.training.record.results.write_report"))
        return gsut.train_blocks(scene, training, options, out=out, resume=resume, progress=False)


def same_bits(one: Path, other: Path) -> bool:
    """Whether two runs have the same Gaussians and layout."""
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in RESULTS)


def states(run: Path) -> list[Path]:
    """The blocks' states, in order."""
    return sorted(run.glob("blocks/b*/state*.npz"), key=os.fspath)
