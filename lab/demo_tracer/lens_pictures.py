"""Draws docs/lenses/NAME.jpg: the demo's hall from one place through each lens model.

.venv/bin/python -m lab.demo_tracer.lens_pictures [NAME ...]
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

import gsut
from lab.demo_tracer.hall import make_hall
from lab.demo_tracer.tracing import Tracer
from tests.docs.lens_examples import find_widest_example

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "lenses"
SAMPLES = 3  # a side of a pixel
QUALITY = 80
PLACE, LOOK_AT = (-2.9, -1.3, 1.7), (1.0, 0.35, 1.35)


def pose() -> np.ndarray:
    """(4, 4) world from camera."""
    forward = np.subtract(LOOK_AT, PLACE) / np.linalg.norm(np.subtract(LOOK_AT, PLACE))
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    placed = np.eye(4)
    placed[:3] = np.stack([right, np.cross(forward, right), forward, PLACE], axis=1)
    return placed


def picture(tracer: Tracer, camera: gsut.Camera) -> np.ndarray:
    """(H, W, 3) uint8, grey where the lens has no ray."""
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 1, 2)
    rows, columns = np.indices((camera.height, camera.width))
    pixels = grid + np.stack([columns, rows], axis=-1).reshape(1, -1, 2)
    flat = pixels.reshape(-1, 2)
    rays, valid = camera.unproject(flat)
    origins = camera.ray_origins(flat)[0]
    rays, origins = (a.reshape(*pixels.shape[:2], 3) for a in (rays, origins))
    whole = valid.reshape(pixels.shape[:2]).all(axis=0)
    placed = pose()
    colors = np.full((len(whole), 3), 0.85)
    for rows_of in np.array_split(np.flatnonzero(whole), max(1, whole.sum() // 2000)):
        directions = rays[:, rows_of] @ placed[:3, :3].T
        starts = placed[:3, 3]
        if not camera.is_central:
            starts = starts + origins[:, rows_of] @ placed[:3, :3].T
        colors[rows_of] = tracer.trace_colors(starts, directions)
    return gsut.rendering.to_uint8(colors.reshape(camera.height, camera.width, 3))


def draw(models: list[str]) -> None:
    """Writes the pictures of these lenses."""
    for name in models:
        image = picture(Tracer(make_hall(0), SAMPLES**2), find_widest_example(name)[1])
        path = FOLDER / f"{name}.jpg"
        cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        print(f"{path.name}: {image.shape[1]} x {image.shape[0]}, {path.stat().st_size} bytes")


if __name__ == "__main__":
    draw(sys.argv[1:] or gsut.lens.camera_models())
