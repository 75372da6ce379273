"""Which pixels of an image count: those with a ray, and those that a mask file leaves."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from gsut.data.errors import DatasetError
from gsut.data.images.decode import decode_mask, shrink_mask
from gsut.data.images.lookup import PictureLookup
from gsut.data.images.names import find_named
from gsut.lens import Camera

_LONGER_SIDE = 512  # of the smaller image, pixels


def make_lens_mask(camera: Camera, full: Camera) -> np.ndarray:
    """Returns (H, W) bool: pixels that have a ray, as have all their source pixels.

    A lens' domain has no holes of a pixel: where all neighbours in a smaller image have rays, or
    none, the pixels between them are taken to be alike. Only those at the domain's edge and at the
    image's border are asked one by one, which saves the rays of a large photograph.

    Args:
        camera: of the scene's image.
        full: the same lens on the file's image.
    """
    longer = max(full.width, full.height)
    smaller = (camera.width, camera.height) != (full.width, full.height)
    if not smaller and longer <= _LONGER_SIDE:
        return np.array(camera.rays()[1], bool)
    sizes = [max(1, side * _LONGER_SIDE // longer) for side in (full.width, full.height)]
    valid = np.array((camera if smaller else camera.resize(*sizes)).rays()[1], bool)
    source = _make_source_mask(valid, full)
    return valid & shrink_mask(source, camera.width, camera.height) if smaller else source


def _make_source_mask(valid: np.ndarray, full: Camera) -> np.ndarray:
    """Returns (H, W) bool: the file's pixels with a ray, from those of a smaller image."""
    import cv2

    square, size = np.ones((3, 3), np.uint8), (full.width, full.height)
    inside = valid.view(np.uint8)
    inner = cv2.erode(inside, square, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    asked = (cv2.dilate(inside, square) > 0) & ~inner
    source, edge = (
        cv2.resize(each.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        for each in (inner, asked)
    )
    rows, columns = np.nonzero(edge)
    source[rows, columns] = full.unproject(np.stack([columns, rows], axis=-1) + 0.5)[1]
    return source


def read_mask(path: Path, full: Camera, width: int, height: int) -> np.ndarray:
    """Reads the mask of an image of camera `full`, of any size but of its shape, and resizes it.

    Raises:
        DatasetError: unreadable, or of another shape.
    """
    valid = decode_mask(path)
    found_height, found_width = valid.shape
    ratio = found_width / full.width
    if abs(full.height * ratio - found_height) > max(1, 0.5 * ratio):
        raise DatasetError(
            path,
            f"the mask is {found_width} x {found_height}, the image {full.width} x {full.height}",
            "make the mask in the image's shape",
        )
    return shrink_mask(valid, width, height)


def find_common_mask(*folders: Path) -> Path | None:
    """Finds the mask of all images of a folder, mask.png, in the first of these that has one."""
    masks = (folder / "mask.png" for folder in folders)
    return next((mask for mask in masks if mask.is_file()), None)


def find_mask_folder(root: Path) -> Path | None:
    """Finds the folder of masks of a dataset: masks or mask, in capitals or not."""
    return find_named(root, "masks", "mask")


class MaskLookup:
    """Finds masks by the names of their images.

    Args:
        folder: that holds them; a file is the mask of all images; None: there are none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._common = folder if folder is not None and folder.is_file() else None
        self._pictures = None if folder is None else PictureLookup(folder)

    def find(self, name: str) -> Path | None:
        """Finds an image's mask: its name with .png added (COLMAP's rule) or in place of its
        ending, with _mask (Metashape's), or as it is."""
        if self._common is not None or self._pictures is None:
            return self._common
        stem = PurePosixPath(name).with_suffix("")
        places = (f"{name}.png", f"{stem}.png", f"{stem}_mask.png", name)
        return next(filter(None, map(self._pictures.find, places)), None)
