"""Checks what masks leave out: nothing, nearly all, or what they were meant to keep."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding
from gsut.check.samples import shrink_to_grey
from gsut.data import Scene
from gsut.data.images import decode_mask
from gsut.sampling import MAJORITY, choose_evenly


def check_masks(scene: Scene) -> Iterator[Finding]:
    """Reads some of the masks; yields the share that they leave out, and what is wrong with it."""
    masked = [i for i, view in enumerate(scene.views) if view.mask_path is not None]
    shares, details = [], []
    for index in choose_evenly(masked):
        with contextlib.suppress(InputError):  # reported by other checks
            share, detail = _measure_mask(scene, index)
            shares.append(share)
            details.append(detail)
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


def _measure_mask(scene: Scene, index: int) -> tuple[float, float]:
    """Returns the share that a mask leaves out, and the detail there over that of the rest."""
    import cv2

    path = scene.views[index].mask_path
    assert path is not None
    kept, grey = decode_mask(path), shrink_to_grey(scene.image(index))
    small = cv2.resize(kept.view(np.uint8), grey.shape[::-1], interpolation=cv2.INTER_AREA)
    edges, inside = np.abs(cv2.Laplacian(grey, cv2.CV_32F)), small > 0
    share = 1 - float(kept.mean())
    if not inside.any() or inside.all():
        return share, 0.0
    return share, float(edges[~inside].mean() / max(float(edges[inside].mean()), 1e-6))
