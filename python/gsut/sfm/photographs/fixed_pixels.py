"""Masks pixels that show the same in all photographs while the scene moves."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.images import (
    COMPARED_SIDE,
    FEWEST_COMPARED,
    decode_scaled,
    describe_fixed_pixels,
    find_fixed_pixels,
    is_shown,
    read_header,
)
from gsut.files import write_picture
from gsut.sampling import choose_evenly
from gsut.sfm.photographs.listing import Photographs

MASK = "mask.png"  # white where the scene is seen


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
    if count < FEWEST_COMPARED or any(photographs.masks) or several:
        return photographs
    pictures: list[np.ndarray] = []
    sizes: set[tuple[int, int]] = set()
    for i in choose_evenly(range(count)):
        with contextlib.suppress(InputError):  # unreadable: reported when features are sought
            header = read_header(photographs.paths[i])
            full = header.width, header.height
            factor = min(1.0, COMPARED_SIDE / max(full))
            size = max(1, round(factor * full[0])), max(1, round(factor * full[1]))
            pixels, alpha = decode_scaled(photographs.paths[i], full, size, in_parts=True)
            if alpha is not None:
                return photographs
            sizes.add(full)
            pictures.append(pixels)
    if len(pictures) < FEWEST_COMPARED or len(sizes) > 1:
        return photographs
    fixed = find_fixed_pixels(np.stack(pictures))
    lens = photographs.cameras[0]
    if not fixed.any() or (lens is not None and not is_shown(lens, fixed)):
        return photographs
    import cv2

    valid = cv2.resize((~fixed).astype(np.uint8), sizes.pop(), interpolation=cv2.INTER_NEAREST)
    write_picture(folder / MASK, 255 * valid)
    note(
        f"{describe_fixed_pixels(float(fixed.mean()))}: {folder / MASK} leaves it out; "
        "--keep-all-pixels keeps it"
    )
    return dataclasses.replace(photographs, masks=[folder / MASK] * count)
