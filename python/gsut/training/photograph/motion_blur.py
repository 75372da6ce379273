"""Models motion blur: a photograph shows the mean of what the camera sees while it moves.

A photograph is compared with the mean of renders from several poses within its exposure, in linear
light. The camera's velocity is that between its neighbours in time. What is trained is the scene
without blur.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene, View
from gsut.data.scene import Level, find_time_neighbours, split_exposure
from gsut.gaussians import Gaussians

# Pixels between renders within an exposure; wider gaps would show as ghosts.
_APART = 2.0
# Most poses in an exposure: each takes the time of a render, and more gain little.
_MOST = 3
# Points of the scene whose motion in the image is measured; more do not change the median.
_POINTS = 200
# Value below which the slope of the square root is held, since it is infinite at zero.
_DARKEST = 1e-3


class Exposure:
    """Finds where cameras are during the exposure of their photographs.

    Args:
        scene: at full resolution.
        share: `--motion-blur`, of the time between frames; None: no blur.

    Raises:
        InputError: a share is given for fewer than two frames.
    """

    def __init__(self, scene: Scene, share: float | None) -> None:
        self._share = share
        if share is None:
            return
        if len(scene.views) < 2:
            raise InputError(
                "--motion-blur needs at least two frames to find the camera's velocity"
            )
        self._neighbours = find_time_neighbours(scene.views)

    def find_poses(self, scene: Scene, level: Level, view: int) -> Any:
        """Returns the motion of a view, or a list of several if the photograph is blurred.

        Args:
            scene: at full resolution, with the current poses.
            level: resolution of the step.
            view: its number.
        """
        if self._share is None:
            return scene.views[view].motion
        # Two moments lie half of the exposure apart. Computed anew in each step, so that a resumed
        # run depends on nothing but its poses.
        pixels = 2.0 * _measure_motion(scene, view, *self._spread_views(scene, view, 2))
        pixels *= level.scene.camera(view).width / scene.camera(view).width
        count = int(np.clip(round(pixels / _APART), 1, _MOST))
        places = [each.motion for each in self._spread_views(scene, view, count)]
        return places if count > 1 else places[0]

    def _spread_views(self, scene: Scene, view: int, count: int) -> list[View]:
        """Returns the view at `count` moments of its exposure."""
        before, after, time = self._neighbours[view]
        moment = (scene.views[view], scene.views[before], scene.views[after])
        return split_exposure(*moment, (self._share or 0.0) / time, count)


def _measure_motion(scene: Scene, view: int, first: View, second: View) -> float:
    """Returns the median motion in pixels of the scene's points between two poses of a view.

    Without visible points, points at the distance of the scene's extent are used.
    """
    camera = scene.camera(view)
    pose = first.camera_from_world
    points = scene.points[:: -(-max(1, len(scene.points)) // _POINTS)]
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    if not _project_inside(camera, seen)[1].any():
        rays, valid = camera.rays()
        seen = scene.extent * rays[valid][:: -(-int(valid.sum()) // _POINTS)].astype(np.float64)
    step = second.camera_from_world @ np.linalg.inv(pose)
    (before, one), (after, other) = (
        _project_inside(camera, each) for each in (seen, seen @ step[:3, :3].T + step[:3, 3])
    )
    both = one & other
    return float(np.median(np.linalg.norm(after - before, axis=1)[both])) if both.any() else 0.0


def _project_inside(camera: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns pixels (N, 2) of points in the camera's frame, and which lie in the image."""
    pixels, valid = camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    return pixels, inside & np.asarray(valid, bool)


class BlurRenderer:
    """Renders from one pose, as `_core.Renderer` does, or the mean of several.

    The mean is taken of squared values, which are close to linear light.
    """

    def __init__(self) -> None:
        self._renderers = [_core.Renderer()]
        self._shown: list[np.ndarray] = []  # of each place; empty: there was one
        self._mean = np.zeros(0, np.float32)

    def render(
        self,
        gaussians: Any,
        job: _core.RenderJob | list[_core.RenderJob],
        image: np.ndarray,
        *more: Any,
    ) -> None:
        """Renders one job, as `_core.Renderer.render` does, or the mean of a list of them."""
        jobs = job if isinstance(job, list) else [job]
        while len(self._renderers) < len(jobs):
            self._renderers.append(_core.Renderer())
        several = len(jobs) > 1
        self._shown = [np.zeros_like(image) for _ in jobs] if several else []
        for each, renderer, shown in zip(
            jobs, self._renderers, self._shown or [image], strict=False
        ):
            renderer.render(gaussians, each, shown, *more)
        if several:
            np.sqrt(np.mean(np.square(np.maximum(self._shown, 0.0)), axis=0), out=image)
            self._mean = np.maximum(image, _DARKEST)

    def backward(
        self, dimage: np.ndarray, gradients: Gaussians, touched: np.ndarray, **how: Any
    ) -> None:
        """Propagates as `_core.Renderer.backward` does; no depth gradients with several poses."""
        if not self._shown:
            self._renderers[0].backward(dimage, gradients, touched, **how)
            return
        sums, any_touched = gradients.make_zeros(), np.zeros_like(touched)
        arrays = [
            (getattr(sums, name), getattr(gradients, name)) for name in gradients.list_arrays()
        ]
        for renderer, shown in zip(self._renderers, self._shown, strict=False):
            part = dimage * np.maximum(shown, 0.0) / (len(self._shown) * self._mean)
            renderer.backward(part, gradients, touched, **how | {"write_untouched": True})
            np.maximum(any_touched, touched, out=any_touched)
            for total, one in arrays:
                total += one
        for total, one in arrays:
            one[...] = total
        touched[...] = any_touched

    def distances(self) -> np.ndarray:
        """Returns what `_core.Renderer.distances` does, for the middle pose."""
        return self._renderers[len(self._shown) // 2].distances()
