"""Which pixels of an image count: those with a ray, and those that a mask file leaves."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from gsut.data.findings import DatasetError
from gsut.data.images import decode_mask, shrink_mask
from gsut.lens import Camera


def lens_mask(camera: Camera, full: Camera) -> np.ndarray:
    """(H, W) bool: pixels of `camera` that have a ray, all of whose source pixels have one too.

    A lens' domain has no holes of a pixel: where all neighbours have rays, the source pixels
    between them are taken to have them. Only those at the domain's edge and at the image's border
    are asked one by one, which saves the rays of a large photograph.

    Args:
        camera: of the scene's image.
        full: the same lens on the file's image.
    """
    import cv2

    valid = np.array(camera.rays()[1], bool)
    if (camera.width, camera.height) == (full.width, full.height):
        return valid
    inner = cv2.erode(
        valid.view(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).view(bool)  # fmt: skip
    asked = cv2.resize(
        (valid & ~inner).view(np.uint8), (full.width, full.height), interpolation=cv2.INTER_NEAREST
    )
    rows, columns = np.nonzero(cv2.dilate(asked, np.ones((3, 3), np.uint8)))
    source = np.ones((full.height, full.width), bool)
    source[rows, columns] = full.unproject(np.stack([columns, rows], axis=-1) + 0.5)[1]
    return valid & shrink_mask(source, camera.width, camera.height)


def read_mask(path: Path, full: Camera, width: int, height: int) -> np.ndarray:
    """A mask file of an image of the size of camera `full`, shrunk to `width` x `height`.

    Raises:
        DatasetError: unreadable, or neither of the image's size nor a larger copy of it.
    """
    valid = decode_mask(path)
    found_height, found_width = valid.shape
    ratio = found_width / full.width
    larger = found_width >= full.width and found_height >= full.height
    if not larger or abs(full.height * ratio - found_height) > max(1, 0.5 * ratio):
        raise DatasetError(
            path,
            f"the mask is {found_width} x {found_height}, the image {full.width} x {full.height}",
            "make the mask at the image's size",
        )
    return shrink_mask(valid, width, height)


def find_mask(folder: Path, name: str) -> Path | None:
    """The mask of an image: folder/name.png, or folder/name with .png added (COLMAP's rule)."""
    for candidate in (folder / f"{name}.png", folder / PurePosixPath(name).with_suffix(".png")):
        if candidate.is_file():
            return candidate
    return None
