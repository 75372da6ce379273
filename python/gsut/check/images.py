"""Checks pixels: every image decodes; blur, exposure, brightness, repeats."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding, finding_from_error
from gsut.check.samples import SIDE
from gsut.data import Scene, list_some
from gsut.data.images import find_largest_value, shrink_mask
from gsut.run import Progress
from gsut.sampling import choose_evenly

_THUMB = 32  # pixels a side of a thumbnail: enough to distinguish two frames of a film
_BLURRY = 0.3  # share of the dataset's median sharpness below which an image counts as blurred
_SATURATED = 0.1  # share of over-exposed pixels from which detail is lost
_OVER_EXPOSED = 254  # grey level in all channels; JPEG turns 255 into this
_BLACK = 0.5  # share of black pixels from which an image shows too little
_DARKEST = 2  # grey level up to which a pixel counts as black; JPEG turns 0 into this
_REPEATED = 0.3  # grey levels RMS between the thumbnails of two copies of a picture
_SURELY_BITS = 12  # of 16: a photograph this dark, a 16th of the range, was not meant to be
_NOISE = 2.0  # grey levels between neighbouring pixels of an even surface
_NO_SEAM = 4.0  # differences across the edges over those beside them; 1 in panoramas
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
    thumb: np.ndarray  # (_THUMB * _THUMB,) grey


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
        "warning" if bits > _SURELY_BITS else "error",
        str(scene.path),
        f"the pictures have 16 bits a channel and values of up to {largest} of 65535: do they hold "
        f"{bits} bits?",
        f"multiply their values by {2 ** (16 - bits)}, or write them with 8 bits",
    )


def check_seams(scene: Scene) -> Iterator[Finding]:
    """Checks whether the left and right edges of panoramas meet; decodes some of them."""
    views = [k for k in range(len(scene)) if scene.camera(k).model == "equirectangular"]
    ratios = []
    for view in choose_evenly(views):
        try:
            pixels, mask = scene.image(view).astype(np.float32), scene.mask(view)
        except InputError:  # reported by the other checks
            continue
        rows = mask[:, [0, 1, -2, -1]].all(axis=1)
        first, second, before, last = (pixels[rows, column] for column in (0, 1, -2, -1))
        if rows.any():
            beside = np.abs(first - second).mean() + np.abs(last - before).mean()
            ratios.append(float(np.abs(first - last).mean() / (beside + _NOISE)))
    if ratios and np.median(ratios) > _NO_SEAM:
        yield Finding(
            "warning",
            str(scene.path),
            "the left and right edges of the pictures do not meet, as those of 360-degree "
            f"panoramas do: they differ {np.median(ratios):.1f} times as much as their neighbours",
            "equirectangular pictures see 360 x 180 degrees: name the lens that took these",
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
        thumb.astype(np.float32).ravel(),
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
            np.array([s.black for s in stats]) > _BLACK,
            f"more than {_BLACK:.0%} of the valid pixels are black",
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
    thumbs = np.array([s.thumb for s in stats])
    squares = (thumbs**2).mean(axis=1)
    pairs = []
    for row in range(len(stats) - 1):
        cross = thumbs[row + 1 :] @ thumbs[row] / thumbs.shape[1]
        rms2 = squares[row] + squares[row + 1 :] - 2 * cross
        for other in np.flatnonzero(rms2 < _REPEATED**2) + row + 1:
            # the product form above loses digits: look again
            if np.sqrt(np.mean((thumbs[row] - thumbs[other]) ** 2)) < _REPEATED:
                pairs.append((stats[row].index, stats[other].index))
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
