"""Reads a finished run: options, dataset and Gaussians."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any, NamedTuple

from gsut._core import InputError
from gsut.data import Scene, load_dataset
from gsut.formats import load_ply, open_ply
from gsut.gaussians import Gaussians
from gsut.refine import read_refined
from gsut.render import Light
from gsut.run import RunFile, RunFolder, TrainOptions
from gsut.run.options import parse_size
from gsut.training.first import prepare_scene


def read_trained(run: RunFolder, data: str | None) -> tuple[TrainOptions, Scene, Gaussians]:
    """Reads options, scene with the poses that the run refined (if it did), and Gaussians.

    Args:
        run: of a finished training.
        data: the dataset; None: where training read it.

    Returns:
        Options, scene and Gaussians, the latter two in the dataset's coordinates.
    """
    return *read_scene(run, data), load_ply(run.path / RunFile.SCENE)


def open_trained(
    run: RunFolder, data: str | None, memory: str | None
) -> tuple[TrainOptions, Scene, Any]:
    """Reads what `read_trained` does, with `StoredGaussians` if they do not fit into memory.

    Args:
        run, data: see `read_trained`.
        memory: that the Gaussians may take, such as 2GB; None: most of what is free.
    """
    limit = None if memory is None else parse_size(memory, "--memory")
    return *read_scene(run, data), open_ply(run.path / RunFile.SCENE, limit)


def read_scene(
    run: RunFolder, data: str | None, scale: float | None = None
) -> tuple[TrainOptions, Scene]:
    """Reads the options of a finished run, and its scene with the poses that it refined.

    Args:
        run, data: see `read_trained`.
        scale: of the images relative to the files; None: as they were trained on.

    Raises:
        InputError: the run is not finished, or the dataset is not found.
    """
    path = run.path / RunFile.SCENE
    if not path.is_file():
        raise InputError(f"{path} does not exist: the run is not finished; resume it")
    options = run.read_options()
    data = data or (run.read_json(RunFile.ENVIRONMENT) or {}).get("dataset")
    if data is None:
        raise InputError(f"{run.path} does not say which dataset it was trained on; give --data")
    inside = run.path / Path(data).name  # where `gsut scene` puts it: the run may have been moved
    if not os.path.exists(data) and inside.is_dir():
        data = str(inside)
    if not os.path.exists(data):
        raise InputError(f"the dataset {data} does not exist any more; give its path with --data")
    scene = load_dataset(data, test_every=options.test_every, test_names=options.test_names)
    size = options if scale is None else dataclasses.replace(options, scale=scale, max_side=0)
    return options, read_refined(run, prepare_scene(scene, size))


class TrainedRun(NamedTuple):
    """A finished run, in the dataset's coordinates.

    Attributes:
        options: of the training.
        scene: its dataset, with the poses and lenses that the run refined, if it did.
        gaussians: of its scene.ply.
        light: exposure and falloff that training found in the photographs, or None.
    """

    options: TrainOptions
    scene: Scene
    gaussians: Gaussians
    light: Light | None


def load_run(
    folder: str | os.PathLike[str], data: str | os.PathLike[str] | None = None
) -> TrainedRun:
    """Reads the folder of a finished run.

    Args:
        folder: RUN of `gsut train` or `train(..., out=RUN)`.
        data: the dataset, if it is not where training read it.

    Returns:
        Options, scene, Gaussians, light.

    Raises:
        InputError: it holds no finished run, or the dataset is not there.
    """
    run = RunFolder.open(folder)
    options, scene, gaussians = read_trained(run, None if data is None else os.fspath(data))
    return TrainedRun(options, scene, gaussians, read_light(run, scene))


def read_light(run: RunFolder, scene: Scene) -> Light | None:
    """Reads the light that the run found in the scene's photographs; None if it found none."""
    found = (run.read_json(RunFile.METRICS) or {}).get("light")
    return None if found is None else Light.from_dict(found, [view.name for view in scene.views])
