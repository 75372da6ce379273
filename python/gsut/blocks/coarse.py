"""The coarse model of everything: poses, lens and light are found in it, and stay from then on."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from gsut.blocks.plan import coarse_scale
from gsut.blocks.task import gaussian_arrays
from gsut.blocks.workers import write_state
from gsut.data import Scene, TrainingViews
from gsut.gaussians import Gaussians
from gsut.render import Falloff, Light
from gsut.run import Progress, TrainOptions, read_checkpoint
from gsut.training import TrainingLoop, refine_first_poses

_EVERY = 250  # steps between checkpoints


@dataclasses.dataclass(frozen=True)
class Coarse:
    """The coarse model.

    Attributes:
        gaussians: in the scene's coordinates.
        scene: at the size to train at, with the poses and lenses found.
        light: of the photographs; None where they do not differ.
        seconds, pixels: of its steps, and rendered by them.
        figures: of the refinement, for metrics.json; None without one.
    """

    gaussians: Gaussians
    scene: Scene
    light: Light | None
    seconds: float
    pixels: int
    figures: dict[str, Any] | None


def train_coarse(
    scene: Scene, options: TrainOptions, folder: Path, progress: bool, keep_bytes: int
) -> Coarse:
    """Trains the coarse model, or goes on with it, or reads it where it is done.

    Args:
        scene: at the size to train at, about its cameras.
        options: of `coarse_options`.
        folder: gets coarse.npz, and its checkpoint meanwhile.
        progress: show a bar.
        keep_bytes: of decoded photographs.
    """
    done, checkpoint = folder / "coarse.npz", folder / "coarse-checkpoint.npz"
    if not done.is_file():
        scale = coarse_scale(scene)
        small = scene if scale == 1.0 else scene.scaled(scale)
        state = read_checkpoint(checkpoint) if checkpoint.is_file() else None
        tracks = None if state is not None else refine_first_poses(small, options, progress)
        loop = TrainingLoop(small, options, tracks=tracks)
        loop.views.keep_at_most(keep_bytes)
        if state is not None:
            loop.load_state_dict(state)
        pixels = 0 if state is None else state["pixels"]
        with Progress(progress) as bar:
            while loop.step < options.steps:
                loss = loop.advance()
                camera = loop.views.at(loop.step / options.steps).scene.cameras[0]
                pixels += int(np.count_nonzero(camera.rays()[1]))
                bar.show("coarse", loop.step, options.steps, f"loss {loss:.4f}")
                if loop.step % _EVERY == 0 and loop.step < options.steps:
                    write_state(checkpoint, loop.state_dict() | {"pixels": pixels})
        loop.finish_scene()
        write_state(done, _state_of(loop, pixels))
        checkpoint.unlink(missing_ok=True)
    return _read(done, scene)


def _state_of(loop: TrainingLoop, pixels: int) -> dict[str, Any]:
    light = loop.photographs.find_light()
    return {
        "gaussians": gaussian_arrays(loop.make_result()),
        "views": loop.views.state_dict(),
        "gains": None if light is None else light.gains,
        "falloffs": []
        if light is None
        else [None if each is None else each.as_dict() for each in light.falloffs],
        "seconds": loop.seconds,
        "pixels": pixels,
        "figures": None if loop.refiner is None else loop.refiner.summarize(),
    }


def _read(path: Path, scene: Scene) -> Coarse:
    state = read_checkpoint(path)
    light = None
    if state["gains"] is not None:
        falloffs = tuple(Falloff.from_dict(each) for each in state["falloffs"])
        light = Light(state["gains"], falloffs)
    views = TrainingViews(scene, (0.0, 0.0))
    if state["figures"] is not None:
        views.load_state_dict(state["views"])
    return Coarse(
        Gaussians(**state["gaussians"]), views.scene, light, float(state["seconds"]),
        int(state["pixels"]), state["figures"],
    )  # fmt: skip
