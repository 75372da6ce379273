"""Checks pixels: every image decodes; blur, exposure, repeats."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding, finding_from_error
from gsut.check.samples import pair_equal, shrink_to_grey
from gsut.data import Scene, list_some
from gsut.data.images import find_largest_value, shrink_mask
from gsut.run import Progress
from gsut.sampling import MAJORITY, choose_evenly

_BLURRY = 0.3  # share of the dataset's median sharpness below which an image counts as blurred
_SATURATED = 0.1  # share of over-exposed pixels from which detail is lost
_ROUNDING = 2  # grey levels by which JPEG changes black and white
_MASKED_MOST = 0.9  # share of masked pixels from which a mask may be inverted


class ImageStats(NamedTuple):
    """Figures of one image that are cheap to compute.

    Attributes:
        sharpness: standard deviation of the Laplacian over that of the image.
        saturated, black: shares of the valid pixels that are so in all channels.
        valid: share of unmasked pixels.
    """

    sharpness: float
    saturated: float
    black: float
    valid: float


def check_bits(scene: Scene) -> Iterator[Finding]:
    """Checks whether files of 16 bits hold 10, 12 or 14; decodes some of them."""
    largest = 0
    for index in choose_evenly(range(len(scene))):
        try:
            found = find_largest_value(scene.views[index].image_path)
        except InputError:  # reported by the other checks
            continue
        if found is None:
            return
        largest = max(largest, found)
    bits = next((bits for bits in (10, 12, 14) if 0 < largest < 2**bits), None)
    if bits is None:
        return
    yield Finding(
        "warning" if bits == 14 else "error",  # a quarter of the range is dark, a 16th is none
        str(scene.path),
        f"the pictures have 16 bits a channel and values of up to {largest} of 65535: do they hold "
        f"{bits} bits?",
        f"multiply their values by {2 ** (16 - bits)}, or write them with 8 bits",
    )


def check_images(scene: Scene, *, progress: bool = True) -> Iterator[Finding]:
    """Decodes every image once and yields findings about files and pixels.

    Args:
        scene: at full size.
        progress: show a bar.
    """
    yield from check_bits(scene)
    stats: dict[int, ImageStats] = {}
    pictures: dict[int, int] = {}
    for index in Progress(progress).iterate("images", range(len(scene))):
        try:
            pixels = scene.image(index)
            stats[index] = _measure_image(pixels, scene.mask(index))
            pictures[index] = hash(pixels.tobytes())
        except InputError as error:
            yield finding_from_error(error)
    if stats:
        names = [scene.views[index].name for index in stats]
        yield from _find_outliers(
            ImageStats(*np.array([*stats.values()]).T), names, str(scene.path)
        )
        yield from _find_repeats(scene, pair_equal(pictures))


def _measure_image(pixels: np.ndarray, mask: np.ndarray) -> ImageStats:
    """Measures an image (H, W, 3) inside its mask (H, W)."""
    import cv2

    small = shrink_to_grey(pixels)
    valid = shrink_mask(mask, *small.shape[::-1])
    inside = small[valid] if valid.any() else small.ravel()
    # Laplacian of the inside only: the edge of a mask or of a fisheye's circle is sharp in any case
    edges = cv2.Laplacian(small, cv2.CV_32F)
    core = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    spread = float(inside.std())
    bright = cv2.inRange(pixels, (255 - _ROUNDING,) * 3, (255,) * 3).astype(bool)
    return ImageStats(
        sharpness=float(edges[core].std() / spread) if core.any() and spread > 0 else 0.0,
        saturated=float(bright[mask].mean()) if mask.any() else 0.0,
        black=float((inside <= _ROUNDING).mean()),
        valid=float(mask.mean()),
    )


def _find_outliers(stats: Any, names: list[str], where: str) -> Iterator[Finding]:
    """Names blurred, over-exposed, black and masked images, of figures (N,) of all."""
    cases = (
        (
            stats.sharpness < _BLURRY * np.median(stats.sharpness),
            f"less than {_BLURRY:.0%} as sharp as the median image",
            "leave blurred images out",
        ),
        (
            stats.saturated > _SATURATED,
            f"more than {_SATURATED:.0%} of the pixels are over-exposed",
            "expose for the bright parts",
        ),
        (
            stats.black > MAJORITY,
            f"more than {MAJORITY:.0%} of the valid pixels are black",
            "mask areas that show nothing, or check the exposure",
        ),
        (
            stats.valid < 1 - _MASKED_MOST,
            f"more than {_MASKED_MOST:.0%} of the pixels are masked",
            "masks must be white where the image is valid: they may be inverted",
        ),
    )
    for rows, what, advice in cases:
        if rows.any():
            listed = list_some([names[i] for i in np.flatnonzero(rows)])
            text = f"{rows.sum()} of {len(names)} images: {what}: {listed}"
            yield Finding("warning", where, text, advice)


def _find_repeats(scene: Scene, pairs: list[tuple[int, int]]) -> Iterator[Finding]:
    """Names files with the same picture, and whether training and test share one."""
    if not pairs:
        return
    split = set(scene.test_indices)
    leaks = [p for p in pairs if (p[0] in split) != (p[1] in split)]
    shown = list_some([f"{scene.views[a].name} = {scene.views[b].name}" for a, b in pairs])
    advice = "leave one of each out"
    if leaks:
        advice += f"; {len(leaks)} pairs have one in training and one in test, which flatters PSNR"
    yield Finding(
        "warning", str(scene.path), f"{len(pairs)} pairs of equal images: {shown}", advice
    )
