"""Trains the coarse model of everything, which gives poses, lens and light for all blocks."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from gsut.blocks.plan import choose_coarse_scale
from gsut.blocks.task import list_arrays, pack_light, unpack_light
from gsut.blocks.workers import write_state
from gsut.data import Scene
from gsut.data.scene import TrainingViews
from gsut.gaussians import Gaussians
from gsut.render import Light
from gsut.run import Progress, TrainOptions, read_checkpoint
from gsut.training import TrainingLoop
from gsut.training.first import refine_first_poses

# Steps between checkpoints.
_EVERY = 250


@dataclasses.dataclass(frozen=True)
class Coarse:
    """The coarse model.

    Attributes:
        gaussians: in the scene's coordinates.
        scene: at the size to train at, with the refined poses and lenses.
        light: of the photographs; None if they do not differ.
        seconds: of its steps.
        pixels: rendered by its steps.
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
    """Trains the coarse model from its last checkpoint, or reads the finished one.

    Args:
        scene: at the size to train at, centred on its cameras.
        options: of `make_coarse_options`.
        folder: gets coarse.npz, and before it is finished a checkpoint.
        progress: show a bar.
        keep_bytes: of decoded photographs.
    """
    done, checkpoint = folder / "coarse.npz", folder / "coarse-checkpoint.npz"
    if not done.is_file():
        scale = choose_coarse_scale(scene)
        small = scene if scale == 1.0 else scene.scale_images(scale)
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
                camera = loop.views.select_level(loop.step / options.steps).scene.cameras[0]
                pixels += int(np.count_nonzero(camera.rays()[1]))
                bar.show("coarse", loop.step, options.steps, f"loss {loss:.4f}")
                if loop.step % _EVERY == 0 and loop.step < options.steps:
                    write_state(checkpoint, loop.state_dict() | {"pixels": pixels})
        loop.finish_scene()
        write_state(done, _make_state(loop, pixels))
        checkpoint.unlink(missing_ok=True)
    return _read(done, scene)


def _make_state(loop: TrainingLoop, pixels: int) -> dict[str, Any]:
    light = loop.photographs.find_light()
    return {
        "gaussians": list_arrays(loop.make_result()),
        "views": loop.views.state_dict(),
        "light": None if light is None else pack_light(light),
        "seconds": loop.seconds,
        "pixels": pixels,
        "figures": None if loop.refiner is None else loop.refiner.summarize(),
    }


def _read(path: Path, scene: Scene) -> Coarse:
    state = read_checkpoint(path)
    light = None if state["light"] is None else unpack_light(state["light"])
    views = TrainingViews(scene, (0.0, 0.0))
    if state["figures"] is not None:
        views.load_state_dict(state["views"])
    return Coarse(
        Gaussians(**state["gaussians"]), views.scene, light, float(state["seconds"]),
        int(state["pixels"]), state["figures"],
    )  # fmt: skip
