"""Finds out which layout a dataset has and loads it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from gsut.data.assemble import assemble
from gsut.data.errors import DatasetError, OnError, raise_error
from gsut.data.layouts import (
    Layout,
    find_foreign_files,
    find_layout,
    list_layouts,
    require_pictures,
)
from gsut.data.listing import Listing
from gsut.data.recordings import pair_recording
from gsut.data.scene import TEST_EVERY, Scene
from gsut.files import reading, register_reader

_ADVICE = "is one of its files damaged?"


@register_reader("dataset", advice=_ADVICE, fails=DatasetError)
def load_dataset(
    path: str | os.PathLike,
    *,
    test_every: int = TEST_EVERY,
    test_names: Sequence[str] | None = None,
    scale: float = 1.0,
) -> Scene:
    """Loads a dataset of any layout (docs/datasets.md); images are decoded on demand.

    Args:
        path: the dataset's folder, or a transforms.json or dataset.yaml itself.
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
    return scene if scale == 1 else scene.scale_images(scale)


def read_dataset(path: Path, *, on_error: OnError = raise_error) -> Listing:
    """Reads a dataset of any known layout, without a look at the images.

    Raises:
        DatasetError: it does not exist, or has no known layout (says what was looked for).
    """
    if not path.exists():
        raise DatasetError(path, "the folder does not exist", "check the path")
    if not (path.is_dir() or path.is_file()):
        raise DatasetError(path, "a pipe or a device", "give the dataset's folder")
    layout = find_layout(path)
    if layout is None and path.is_file():
        raise DatasetError(
            path,
            find_foreign_files(path)
            or "a file that is neither a transforms.json nor a dataset.yaml",
            f"give the dataset's folder; of a video `gsut scene {path} -o RUN` makes a scene",
        )
    if layout is None:
        looked = "; ".join(
            f"{each.name}: {each.files}" for each in list_layouts() if each.read or each.record
        )
        raise DatasetError(
            path,
            "; ".join(filter(None, ["no dataset found", find_foreign_files(path)]))
            + f"; looked for {looked}",
            "lay them out in one of these ways (docs/datasets.md), or make a scene of photographs "
            "by `gsut scene`",
        )
    with reading(path, _ADVICE, DatasetError):
        return _read(layout, path, on_error)


def _read(layout: Layout, path: Path, on_error: OnError) -> Listing:
    if layout.read is not None:
        return layout.read(path, on_error)
    require_pictures(path)
    assert layout.record is not None
    return pair_recording(layout.record(path), on_error)
