"""Finds pixels that show the same in all pictures while the scene moves, and masks them."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.images import decode_scaled, read_header
from gsut.files import write_picture
from gsut.sfm.photographs.listing import Photographs

MASK = "mask.png"  # white where the scene is seen
_SIZE = 400  # pixels of the longer side at which pictures are compared: a clock's frame is wider
_FEWEST = 6  # pictures compared: fewer agree by chance
_MOST = 16  # pictures compared: more hardly change what agrees
_SAME = 10  # grey levels: compression and noise of one colour
_LEAST_AREA = 1e-3  # of the picture: smaller marks cost little
# Width over the diagonal of the ring about a patch where the scene moves, and the largest share of
# the ring that most pictures agree in. A sky's edge differs from picture to picture, so that most
# of them agree about the patch that all agree in.
_RING = 0.015
_CALM = 0.35
_MOST_FIXED = 0.8  # of the picture: beyond that the camera stood still
_FILLED = 0.25  # area of a hole, such as a clock's digits, over that of the patch around it


def mask_fixed_pixels(
    photographs: Photographs, folder: Path, note: Callable[[str], None]
) -> Photographs:
    """Masks the black around a fisheye's circle, letterbox bars, logos and frames of clocks.

    Photographs with masks or alpha, of several sizes or cameras, and fewer than six stay as they
    are.

    Args:
        folder: where the mask is written.
        note: called with a sentence if pixels are masked.
    """
    count = len(photographs)
    several = photographs.frames is not None or len(photographs.unknown_groups) > 1
    if count < _FEWEST or any(photographs.masks) or several:
        return photographs
    chosen = np.unique(np.linspace(0, count - 1, _MOST).round().astype(int))
    pictures: list[np.ndarray] = []
    sizes: set[tuple[int, int]] = set()
    for i in chosen:
        with contextlib.suppress(InputError):  # unreadable: reported when features are sought
            header = read_header(photographs.paths[i])
            full = header.width, header.height
            factor = min(1.0, _SIZE / max(full))
            size = max(1, round(factor * full[0])), max(1, round(factor * full[1]))
            pixels, alpha = decode_scaled(photographs.paths[i], full, size, in_parts=True)
            if alpha is not None:
                return photographs
            sizes.add(full)
            pictures.append(pixels)
    if len(pictures) < _FEWEST or len(sizes) > 1:
        return photographs
    fixed = find_fixed_pixels(np.stack(pictures))
    lens = photographs.cameras[0]
    if lens is not None:
        has_ray = np.asarray(lens.resize(*fixed.shape[::-1]).rays()[1])
        if 2 * np.count_nonzero(fixed & has_ray) < np.count_nonzero(fixed):
            return photographs  # the lens leaves them out already
    if not fixed.any():
        return photographs
    import cv2

    valid = cv2.resize((~fixed).astype(np.uint8), sizes.pop(), interpolation=cv2.INTER_NEAREST)
    write_picture(folder / MASK, 255 * valid)
    note(
        f"{100 * fixed.mean():.0f} % of the picture shows the same in all images while the scene "
        f"moves, as the black around a lens' circle, bars or a logo do: {folder / MASK} leaves it "
        "out; --keep-all-pixels keeps it"
    )
    return dataclasses.replace(photographs, masks=[folder / MASK] * count)


def find_fixed_pixels(pictures: np.ndarray) -> np.ndarray:
    """Returns (H, W) bool, True for patches that are alike in all pictures (N, H, W, 3) uint8.

    A patch ends at the same pixels in all pictures: right beside it most of them differ.
    """
    import cv2

    middle = np.median(pictures, axis=0)
    apart = np.abs(pictures - middle).max(axis=3)
    alike = (apart.max(axis=0) <= _SAME).astype(np.uint8)
    mostly = np.median(apart, axis=0) <= _SAME
    width = max(2, round(_RING * np.hypot(*alike.shape)))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1, 2 * width + 1))
    edge = cv2.getStructuringElement(cv2.MORPH_RECT, (5, 5))  # blurred by lens and compression
    count, labels, rows, _ = cv2.connectedComponentsWithStats(alike)
    fixed = np.zeros(alike.shape, bool)
    for number in range(1, count):
        area = rows[number, cv2.CC_STAT_AREA]
        if area < _LEAST_AREA * alike.size:
            continue
        patch = _fill_holes((labels == number).astype(np.uint8), _FILLED * area)
        near = cv2.dilate(patch, edge)
        ring = (cv2.dilate(near, disk) > 0) & (near == 0)
        if ring.any() and mostly[ring].mean() < _CALM:
            fixed |= near > 0
    return fixed if fixed.mean() < _MOST_FIXED else np.zeros_like(fixed)


def _fill_holes(patch: np.ndarray, largest: float) -> np.ndarray:
    """Fills the holes of a patch up to this area in pixels."""
    import cv2

    _, labels, rows, _ = cv2.connectedComponentsWithStats(1 - patch)
    small = np.flatnonzero(rows[:, cv2.CC_STAT_AREA] <= largest)
    return patch | np.isin(labels, small[small > 0]).astype(np.uint8)
