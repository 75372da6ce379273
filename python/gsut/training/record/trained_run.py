"""Reads a finished run: options, dataset and Gaussians."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.data import Scene, load_dataset
from gsut.data.scene import digest_scene
from gsut.formats import load_ply, open_ply
from gsut.gaussians import Gaussians
from gsut.refine import read_refined
from gsut.render import Light
from gsut.run import RunFile, RunFolder, TrainOptions, read_plan
from gsut.training.first import prepare_scene
from gsut.training.photograph import Movers

# Parts of a dataset (see `digest_scene`) without which a run's figures mean nothing.
_OF_RESULT = ("images", "poses", "lenses")


def read_trained(run: RunFolder, data: str | None) -> tuple[TrainOptions, Scene, Gaussians]:
    """Reads options, scene with the poses that the run refined (if it did), and Gaussians.

    Args:
        run: of a finished training.
        data: the dataset; None: where training read it.

    Returns:
        Options, scene and Gaussians, the latter two in the dataset's coordinates.
    """
    return *read_scene(run, data), load_ply(run.path / RunFile.SCENE)


def open_trained(run: RunFolder, data: str | None) -> tuple[TrainOptions, Scene, Any]:
    """Reads what `read_trained` does, with `StoredGaussians` if they do not fit into free memory.

    Args:
        run, data: see `read_trained`.
    """
    return *read_scene(run, data), open_ply(run.path / RunFile.SCENE)


def read_scene(run: RunFolder, data: str | None) -> tuple[TrainOptions, Scene]:
    """Reads the options of a finished run, and its scene with the poses that it refined.

    Args:
        run, data: see `read_trained`.

    Raises:
        InputError: the run is not finished, or the dataset is not found or not that of the run.
    """
    path = run.path / RunFile.SCENE
    if not path.is_file():
        raise InputError(f"{path} does not exist: the run is not finished; resume it")
    options = run.read_options()
    data = data or (run.read_json(RunFile.ENVIRONMENT) or {}).get("dataset")
    if data is None:
        raise InputError(f"{run.path} does not say which dataset it was trained on")
    inside = run.path / Path(data).name  # where `gsut scene` puts it: the run may have been moved
    if not os.path.exists(data) and inside.exists():
        data = str(inside)
    if not os.path.exists(data):
        raise InputError(
            f"the dataset {data} does not exist any more; put it back, or a link to it, or either "
            f"of them to {inside}"
        )
    scene = load_dataset(data, test_every=options.test_every, test_names=options.test_names)
    if changed := list_changed_data(run, scene):
        raise InputError(
            f"{scene.path} has other {' and '.join(changed)} than {run.path} was trained on; put "
            f"the dataset of the run there, or train again"
        )
    return options, read_refined(run, prepare_scene(scene, options))


def list_changed_data(run: RunFolder, scene: Scene) -> list[str]:
    """Lists which of images, poses and lenses are not those that a run was trained on.

    Args:
        run: a training, finished or not; one that was killed at its start names nothing.
        scene: the dataset as it was loaded, in its own coordinates.
    """
    saved = (run.read_json(RunFile.ENVIRONMENT) or {}).get("digests") or {}
    if not saved:
        return []
    is_whole = read_plan(run) is None
    now = digest_scene(prepare_scene(scene.centred, run.read_options()) if is_whole else scene)
    # Refined poses and lenses are the run's own.
    parts = _OF_RESULT[:1] if (run.path / RunFile.REFINED).is_file() else _OF_RESULT
    return [name for name in parts if saved.get(name, now[name]) != now[name]]


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


@name_wrong_kinds
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


def find_run_movers(
    run: RunFolder, gaussians: Any, scene: Scene, indices: Sequence[int], light: Light | None
) -> Callable[[int, int, int], Any] | None:
    """Finds what moved in views of a finished run, as its training did; None if it found nothing.

    Args:
        run: whose training left movers out, or did not.
        gaussians, scene: of the run.
        indices: of the views.
        light: of the photographs; None: 1.
    """
    if not (run.read_json(RunFile.METRICS) or {}).get("moving_train"):
        return None
    return Movers.find(gaussians, scene, indices, light).scale_mask
