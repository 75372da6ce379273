"""PSNR on chosen views of a scene, quickly: for curves, searches and stopping rules."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.metrics import psnr
from gsut.render import (
    Light,
    choose_solid,
    place_about,
    with_surroundings,
)


def mean_psnr(
    scene: Scene,
    gaussians: Gaussians,
    indices: Sequence[int],
    background: tuple[float, float, float] | None,
    renderer: Any = None,
    light: Light | None = None,
) -> float:
    """Averages PSNR in dB over views, inside their masks.

    Args:
        scene: at the resolution to measure at.
        gaussians: float32.
        indices: of the views, at least one.
        background: colour behind everything; None: see `render`.
        renderer: a `_core.Renderer` whose buffers are used; None: a new one.
        light: by which images are multiplied; None: 1.
    """
    renderer = _core.Renderer() if renderer is None else renderer
    values: list[concurrent.futures.Future[float]] = []
    with concurrent.futures.ThreadPoolExecutor(1, "gsut-psnr") as thread:
        for index in indices:
            image = render_view_image(scene, gaussians, index, background, renderer)
            if values:
                values[-1].result()  # no more than two images at a time
            values.append(thread.submit(_psnr, scene, index, image, light))
        return float(np.mean([value.result() for value in values]))


def _psnr(scene: Scene, index: int, image: np.ndarray, light: Light | None) -> float:
    """Computes the PSNR of a view's image against its photograph."""
    if light is not None:
        image *= light.on(scene.camera(index), index, scene.views[index].camera_index)
    truth = scene.image(index).astype(np.float32) / np.float32(255)
    return psnr(np.clip(image, 0.0, 1.0), truth, scene.mask(index))


def render_view_image(
    scene: Scene,
    gaussians: Gaussians,
    index: int,
    background: tuple[float, float, float] | None,
    renderer: Any,
) -> np.ndarray:
    """Renders the image of one view, (H, W, 3) float32; nothing is kept for a backward pass.

    Args:
        scene: at the resolution to render at.
        gaussians: float32.
        index: of the view.
        background: colour behind everything; None: see `render`.
        renderer: a `_core.Renderer`.
    """
    camera = scene.camera(index)
    shape = (camera.height, camera.width)
    image = np.zeros((*shape, 3), np.float32)
    alpha = np.zeros(shape, np.float32) if background is None else None
    job = _core.RenderJob(
        camera, place_about(scene.views[index].motion, gaussians.origin),
        background=choose_solid(background), sh_degree=gaussians.sh_degree, keep=False,
    )  # fmt: skip
    renderer.render(gaussians, job, image, alpha)
    return image if alpha is None else with_surroundings(image, alpha, camera)
