"""Checks pixels: every image decodes; blur, exposure, brightness, repeats."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding, finding_from_error
from gsut.check.samples import SIDE
from gsut.data import Scene, list_some
from gsut.data.images import find_largest_value, shrink_mask
from gsut.run import Progress
from gsut.sampling import MAJORITY, choose_evenly

_THUMB = 32  # pixels a side of a thumbnail: enough to distinguish two frames of a film
_BLURRY = 0.3  # share of the dataset's median sharpness below which an image counts as blurred
_SATURATED = 0.1  # share of over-exposed pixels from which detail is lost
_OVER_EXPOSED = 254  # grey level in all channels; JPEG turns 255 into this
_DARKEST = 2  # grey level up to which a pixel counts as black; JPEG turns 0 into this
_MASKED_MOST = 0.9  # share of masked pixels from which a mask may be inverted


@dataclasses.dataclass(frozen=True, eq=False)
class ImageStats:
    """Figures of one image that are cheap to compute."""

    index: int
    brightness: float  # mean of the valid pixels, 0 to 255
    sharpness: float  # standard deviation of the Laplacian over that of the image
    saturated: float  # share of valid pixels at the top in all channels
    black: float
    valid: float  # share of unmasked pixels
    thumb: np.ndarray  # (_THUMB, _THUMB) grey


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
    stats: list[ImageStats] = []
    for index in Progress(progress).iterate("images", range(len(scene))):
        try:
            stats.append(_measure_image(scene, index))
        except InputError as error:
            yield finding_from_error(error)
    if not stats:
        return
    names = [scene.views[s.index].name for s in stats]
    yield from _find_outliers(stats, names, str(scene.path))
    yield from _find_repeats(scene, stats)


def _measure_image(scene: Scene, index: int) -> ImageStats:
    """Decodes image and mask of a view and measures them.

    Raises:
        DatasetError: the image or the mask cannot be used.
    """
    import cv2

    pixels, mask = scene.image(index), scene.mask(index)
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    width = min(SIDE, grey.shape[1])
    height = max(1, round(grey.shape[0] * width / grey.shape[1]))
    small = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    valid = shrink_mask(mask, width, height)
    inside = small[valid] if valid.any() else small.ravel()
    # Laplacian of the inside only: the edge of a mask or of a fisheye's circle is sharp in any case
    edges = cv2.Laplacian(small, cv2.CV_32F)
    core = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    spread = float(inside.std())
    sharpness = float(edges[core].std() / spread) if core.any() and spread > 0 else 0.0
    bright = cv2.inRange(pixels, (_OVER_EXPOSED,) * 3, (255,) * 3).astype(bool)
    thumb = cv2.resize(small, (_THUMB, _THUMB), interpolation=cv2.INTER_AREA)
    return ImageStats(
        index,
        float(inside.mean()),
        sharpness,
        float(bright[mask].mean()) if mask.any() else 0.0,
        float((inside <= _DARKEST).mean()),
        float(mask.mean()),
        thumb,
    )


def _find_outliers(stats: list[ImageStats], names: list[str], where: str) -> Iterator[Finding]:
    """Names blurred, over-exposed, black and masked images."""
    brightness = np.array([s.brightness for s in stats])
    sharpness = np.array([s.sharpness for s in stats])
    cases = (
        (
            sharpness < _BLURRY * np.median(sharpness),
            f"less than {_BLURRY:.0%} as sharp as the median image",
            "leave blurred images out",
        ),
        (
            np.array([s.saturated for s in stats]) > _SATURATED,
            f"more than {_SATURATED:.0%} of the pixels are over-exposed",
            "expose for the bright parts",
        ),
        (
            np.array([s.black for s in stats]) > MAJORITY,
            f"more than {MAJORITY:.0%} of the valid pixels are black",
            "mask areas that show nothing, or check the exposure",
        ),
        (
            np.array([s.valid for s in stats]) < 1 - _MASKED_MOST,
            f"more than {_MASKED_MOST:.0%} of the pixels are masked",
            "masks must be white where the image is valid: they may be inverted",
        ),
    )
    for rows, what, advice in cases:
        if rows.any():
            listed = list_some([names[i] for i in np.flatnonzero(rows)])
            text = f"{rows.sum()} of {len(stats)} images: {what}: {listed}"
            yield Finding("warning", where, text, advice)
    relative = sharpness / max(float(np.median(sharpness)), 1e-9)
    yield Finding(
        "info",
        where,
        f"brightness {brightness.min():.0f} to {brightness.max():.0f}"
        f" (median {np.median(brightness):.0f}) of 255, relative sharpness"
        f" {relative.min():.2f} to {relative.max():.2f} of the median",
    )


def _find_repeats(scene: Scene, stats: list[ImageStats]) -> Iterator[Finding]:
    """Names files with the same picture, and whether training and test share one."""
    same: dict[bytes, list[int]] = {}
    for each in stats:
        same.setdefault(each.thumb.tobytes(), []).append(each.index)
    pairs = [pair for indices in same.values() for pair in itertools.combinations(indices, 2)]
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
