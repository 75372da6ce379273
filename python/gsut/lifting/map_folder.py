"""A folder of maps, one a view, read one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import read_npy, read_picture, register_reader

_SUFFIXES = (".npy", ".png", ".tif", ".tiff")


class MapFolder(Mapping[str, np.ndarray]):
    """Maps by the names of a dataset's views.

    A view's map is FOLDER/NAME with .npy (any numbers), .png or .tif (8 or 16 bits, one channel or
    three) in place of the image's extension; or so with the last folder and the file's name, or the
    file's name alone, where no two views share it.

    Args:
        folder: of the maps.
        scene: the dataset.

    Raises:
        InputError: the folder does not exist or holds no map of a view.
    """

    def __init__(self, folder: Path, scene: Any) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder; give the folder of the maps")
        self._files: dict[str, Path] = {}
        names = [view.name for view in scene.views]
        tails = [[_take_tail(name, parts) for name in names] for parts in (2, 1)]
        for number, name in enumerate(names):
            stems = [Path(name).with_suffix("")]
            stems += [tail[number] for tail in tails if tail.count(tail[number]) == 1]
            # Joined as text: a view may be named 1.5.png, whose stem is no file of extension .5.
            files = (folder / f"{stem}{suffix}" for stem in stems for suffix in _SUFFIXES)
            found = next((file for file in files if file.is_file()), None)
            if found is not None:
                self._files[name] = found
        if not self._files:
            raise InputError(
                f"{folder} has no map of a view of {scene.path}: they are named like its images, "
                f"such as {Path(names[0]).with_suffix('.npy').name} or .png"
            )

    def __getitem__(self, name: str) -> np.ndarray:
        return read_map(self._files[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)


@register_reader("map of a view", *_SUFFIXES)
def read_map(file: Path) -> np.ndarray:
    """Reads the map of a view, see `MapFolder`.

    Raises:
        InputError: it is damaged or none.
    """
    if file.suffix == ".npy":
        return read_npy(file)
    import cv2  # here, because gsut --help needs none

    picture = read_picture(file, cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise InputError(f"{file}: no picture that can be decoded")
    return picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., 2::-1])


def _take_tail(name: str, parts: int) -> Path:
    return Path(*Path(name).with_suffix("").parts[-parts:])
