"""Writes a run's refined poses and lenses to its folder, and reads them back."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import InputError
from gsut.data import Frame, Scene, write_transforms
from gsut.data.poses import invert_pose
from gsut.lens.files import camera_from_values, values_from_camera
from gsut.run import RunFile, RunFolder


def write_refined(run: RunFolder, scene: Scene) -> None:
    """Writes refined.json, and transforms.json with its lens files.

    refined.json holds `lenses` (model, params at the size of the files, width, height) and `views`
    (name, lens, camera_from_world in the dataset's coordinates): refined poses of training views,
    aligned poses of test views.

    Raises:
        InputError: the folder cannot be written.
    """
    values = {
        "lenses": [values_from_camera(camera) for camera in scene.file_cameras],
        "views": [
            {
                "name": view.name,
                "lens": view.camera_index,
                "split": "test" if index in scene.test_indices else "train",
                "camera_from_world": scene.to_dataset(view.camera_from_world).tolist(),
            }
            for index, view in enumerate(scene.views)
        ],
    }
    run.write_json(RunFile.REFINED, values)
    cameras = scene.file_cameras
    frames = [
        Frame(
            view.name, view.image_path, cameras[view.camera_index],
            invert_pose(scene.to_dataset(view.camera_from_world)), mask_path=view.mask_path,
        )
        for view in scene.views
    ]  # fmt: skip
    test = [scene.views[index].name for index in scene.test_indices]
    try:
        write_transforms(run.path / RunFile.TRANSFORMS, frames, test=test)
    except OSError as error:
        raise InputError(
            f"cannot write {run.path / RunFile.TRANSFORMS}: {error.strerror}"
        ) from None


def read_refined(run: RunFolder, scene: Scene) -> Scene:
    """Returns the scene with the run's refined poses and lenses, or unchanged if it has none.

    Raises:
        InputError: refined.json is damaged, or belongs to other images.
    """
    values = run.read_json(RunFile.REFINED)
    if values is None:
        return scene
    path = run.path / RunFile.REFINED
    try:
        cameras = [camera_from_values(lens) for lens in values["lenses"]]
        rows = {row["name"]: np.array(row["camera_from_world"]) for row in values["views"]}
        views = []
        for view in scene.views:
            pose = scene.from_dataset(rows[view.name].reshape(4, 4))
            views.append(dataclasses.replace(view, camera_from_world=pose))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} does not fit {scene.path}: {error!r}; train again") from None
    sizes = [[(c.width, c.height) for c in each] for each in (cameras, scene.file_cameras)]
    if sizes[0] != sizes[1]:
        raise InputError(f"{path} has lenses for images of {sizes[0]}, {scene.path} of {sizes[1]}")
    return scene.replace(views=views).with_lenses(cameras)
