"""Checks what masks leave out: nothing, nearly all, or what they were meant to keep."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding
from gsut.check.samples import SIDE
from gsut.data import Scene
from gsut.data.images import decode_mask, shrink_image, shrink_mask
from gsut.sampling import MAJORITY, choose_evenly


def check_masks(scene: Scene) -> Iterator[Finding]:
    """Reads some of the masks; yields the share that they leave out, and what is wrong with it."""
    masked = [i for i, view in enumerate(scene.views) if view.mask_path is not None]
    shares, details = [], []
    for index in choose_evenly(masked):
        path = scene.views[index].mask_path
        assert path is not None
        try:
            kept = decode_mask(path)
            details.append(_compare_detail(scene.image(index), kept))
        except InputError:  # reported by other checks
            continue
        shares.append(1 - float(kept.mean()))
    if not shares:
        return
    share, where = float(np.mean(shares)), str(scene.path)
    said = f"the masks leave out {100 * share:.0f} % of the pixels"
    if share == 0:
        yield Finding(
            "warning", where, "the masks leave nothing out",
            "masks are white where the picture counts and black elsewhere: are they in another "
            "channel, or all white?",
        )  # fmt: skip
    elif share > MAJORITY and np.median(details) > 1:
        yield Finding(
            "warning", where, f"{said}, with more detail than the rest",
            "masks are white where the picture counts: are they inverted?",
        )  # fmt: skip
    else:
        yield Finding("info", where, said)


def _compare_detail(pixels: np.ndarray, kept: np.ndarray) -> float:
    """Returns how much more detail a mask leaves out than it keeps, as a ratio."""
    import cv2

    width = min(SIDE, pixels.shape[1])
    size = width, max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    grey = cv2.cvtColor(shrink_image(pixels, *size), cv2.COLOR_RGB2GRAY)
    edges = np.abs(cv2.Laplacian(grey, cv2.CV_32F))
    inside = shrink_mask(kept, *size) if kept.shape >= grey.shape else kept
    if inside.shape != grey.shape or not inside.any() or inside.all():
        return 0.0
    return float(edges[~inside].mean() / max(float(edges[inside].mean()), 1e-6))
