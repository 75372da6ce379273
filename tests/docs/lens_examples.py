"""Chooses the camera that shows a lens model on its page."""

from __future__ import annotations

import numpy as np

import gsut
from gsut import _core

SIDE = 256  # pixels of the longer side


def find_widest_example(model: str) -> tuple[str, gsut.Camera]:
    """Finds the example of a lens that sees most; returns its description and camera."""
    best = None
    for about, params, width, height in _core.camera_examples(model):
        camera = gsut.Camera(model, params, width, height)
        camera = camera.resize(
            *(max(1, round(s * SIDE / max(width, height))) for s in (width, height))
        )
        angle = measure_seen_angle(camera)
        if best is None or angle > best[0]:
            best = angle, about, camera
    assert best is not None
    return best[1], best[2]


def measure_seen_angle(camera: gsut.Camera) -> float:
    """Measures the largest field angle in the image, degrees."""
    rays, valid = camera.rays()
    return float(np.degrees(np.arccos(np.clip(rays[valid][:, 2], -1, 1)).max()))
