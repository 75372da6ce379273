"""Finds out which format a dataset has and loads it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from gsut.data.assemble import Listing, assemble
from gsut.data.colmap import find_model, read_colmap
from gsut.data.findings import DatasetError, OnError, stop
from gsut.data.folder import find_images, read_folder
from gsut.data.nerfstudio import FILE_NAME, read_nerfstudio
from gsut.data.scene import Scene
from gsut.data.split import TEST_EVERY


def load_dataset(
    path: str | os.PathLike,
    *,
    test_every: int = TEST_EVERY,
    test_names: Sequence[str] | None = None,
    scale: float = 1.0,
) -> Scene:
    """Loads a nerfstudio, COLMAP or plain dataset; images are decoded when asked for.

    Args:
        path: a folder with transforms.json, a COLMAP model or images with lens and poses; or a
            transforms.json file itself.
        test_every: hold out every n-th image by name, 0 for none. The dataset's own lists win.
        test_names: names, file names or stems to hold out; wins over both.
        scale: of the images, above 0 and at most 1.

    Returns:
        The scene; its `notes` say what was left out.

    Raises:
        DatasetError (an InputError): the first thing that is wrong with the dataset. `gsut doctor`
            lists all of them.
    """
    listing = read_dataset(Path(path))
    scene = assemble(listing, test_every=test_every, test_names=test_names)
    return scene if scale == 1 else scene.scaled(scale)


def read_dataset(path: Path, *, on_error: OnError = stop) -> Listing:
    """Reads a dataset of any known format, without a look at the images.

    Raises:
        DatasetError: it does not exist, or has no known format (says what was looked for).
    """
    if path.is_file():
        if path.suffix.lower() == ".json":
            return read_nerfstudio(path, on_error=on_error)
        raise DatasetError(
            path,
            "a file that is not a transforms.json",
            f"give the dataset's folder; of a video `gsut scene {path} -o RUN` makes a scene",
        )
    if not path.is_dir():
        raise DatasetError(path, "the folder does not exist", "check the path")
    if (path / FILE_NAME).is_file():
        return read_nerfstudio(path, on_error=on_error)
    if find_model(path) is not None:
        return read_colmap(path, on_error=on_error)
    if find_images(path):
        return read_folder(path, on_error=on_error)
    raise DatasetError(
        path,
        f"no dataset found: looked for {FILE_NAME} (nerfstudio), cameras and images (.bin or .txt)"
        " in sparse/0, sparse and the folder (COLMAP), and images beside a lens file and poses",
        "give a folder in one of these formats, or let `gsut scene` make a scene of videos and "
        "photographs",
    )
