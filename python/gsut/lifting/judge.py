"""Judges lifted values on views that were held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gsut.bounds import name_wrong_kinds
from gsut.lifting.back_projection import choose_camera, resize_mask
from gsut.lifting.lifted import UNKNOWN, Lifted


@name_wrong_kinds
def judge_lifted(
    lifted: Lifted,
    gaussians: Any,
    scene: Any,
    maps: Mapping[str, np.ndarray],
    *,
    unknown: int | None = None,
    indices: Sequence[int] | None = None,
) -> dict[str, float]:
    """Compares lifted values, as views show them, with the views' own maps.

    Args:
        lifted, gaussians: what was lifted, and onto which.
        scene, maps, unknown: as of `lift`.
        indices: which of `scene.views`; None: the held-out ones.

    Returns:
        pixels: the number of pixels that count; right: of labels, the share of these that show
        theirs; rms: of values, the root mean square difference where both are known. Empty where no
        pixel counts.

    Raises:
        InputError: a map has another size than its image.
    """
    good = square = pixels = 0.0
    for index in scene.test_indices if indices is None else indices:
        view = scene.views[index]
        if view.name not in maps:
            continue
        truth = np.asarray(maps[view.name])
        camera = choose_camera(scene, index, truth)
        shown = lifted.render(gaussians, camera, view.motion)
        valid = resize_mask(scene.mask(index), camera.height, camera.width)
        if lifted.ids is not None:
            valid = valid & (truth >= 0) & (truth != (UNKNOWN if unknown is None else unknown))
            good += np.count_nonzero(valid & (shown == truth))
            pixels += np.count_nonzero(valid)
        else:
            apart = shown - truth.reshape(shown.shape)
            apart = apart[valid & np.isfinite(apart).all(axis=2)].astype(np.float64)
            square += float(np.square(apart).mean(axis=1).sum())
            pixels += len(apart)
    if pixels == 0:
        return {}
    if lifted.ids is not None:
        return {"right": float(good / pixels), "pixels": int(pixels)}
    return {"rms": float(np.sqrt(square / pixels)), "pixels": int(pixels)}
