"""The views of a training: photographs at a step's resolution, poses and lenses as they are now."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut.data.scene.lru_cache import LruCache
from gsut.data.scene.scene import IMAGE_CACHE_BYTES, Scene, keep_at_most
from gsut.lens import Camera

# Shorter side in pixels below which smaller pictures are not trained on: they show nothing.
SMALLEST_SIDE = 64
# Targets kept decoded with their statistics; beyond it the least recently used are made again.
_TARGET_CACHE_BYTES = 2 * IMAGE_CACHE_BYTES
_PIXELS_PART = 8  # of the bytes to keep, for decoded pixels that are not ready for the loss


class Level:
    """The scene at one resolution, its photographs ready for the loss.

    Attributes:
        scene: with images and cameras of that size, and the poses and lenses as they are now.
    """

    def __init__(self, scene: Scene, keep_bytes: int = _TARGET_CACHE_BYTES) -> None:
        self.scene = scene
        self._targets = LruCache(keep_bytes)
        self._buffers: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        self._coming: dict[int, concurrent.futures.Future[_core.PhotometricTarget]] = {}

    def get_target(self, view: int) -> _core.PhotometricTarget:
        """Returns the view's photograph and mask with what the loss precomputes of them."""
        coming = self._coming.pop(view, None)
        make = coming.result if coming is not None else lambda: self._make_target(view)
        return self._targets.get(view, lambda: (make(),))[0]

    def prepare(self, view: int, worker: concurrent.futures.Executor) -> None:
        """Starts making the target of a view on another thread, for the next step."""
        if view not in self._targets and view not in self._coming:
            self._coming[view] = worker.submit(self._make_target, view)

    def _make_target(self, view: int) -> _core.PhotometricTarget:
        return _core.PhotometricTarget(
            self.scene.image(view), self.scene.mask(view), "partial", True
        )

    def get_buffers(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns two (H, W, 3) float32 arrays of the view's size, which are reused."""
        camera = self.scene.camera(view)
        size = (camera.height, camera.width)
        if size not in self._buffers:
            self._buffers[size] = (
                np.zeros((*size, 3), np.float32),
                np.zeros((*size, 3), np.float32),
            )
        return self._buffers[size]


class TrainingViews:
    """Which resolution is trained at when, and the one owner of poses and lenses while they move.

    Args:
        scene: at full resolution.
        until: fractions of the steps: quarter resolution up to the first, half up to the second.

    Attributes:
        scene: at full resolution, with the poses and lenses as they are now.
    """

    def __init__(self, scene: Scene, until: tuple[float, float]) -> None:
        self.scene = scene
        shorter = min(min(c.width, c.height) for c in scene.cameras)
        self._until = [
            (factor, end)
            for factor, end in zip((0.25, 0.5), until, strict=True)
            if end > 0 and factor * shorter >= SMALLEST_SIDE
        ]
        self._factor = 0.0
        self._level: Level | None = None
        self._worker = concurrent.futures.ThreadPoolExecutor(1, "gsut-images")
        self._keep: tuple[int, int] | None = None

    def keep_at_most(self, size: int) -> None:
        """Sets the number of bytes of decoded photographs to keep; others are decoded again.

        What is ready for the loss takes most of it, the pixels alone the rest.
        """
        self._keep = size - size // _PIXELS_PART, size // _PIXELS_PART
        self._level = None

    def select_level(self, fraction: float) -> Level:
        """Returns the level for a step at this fraction of all steps; drops a passed one."""
        factor = self._factor_at(fraction)
        if self._level is None or factor != self._factor:
            self._factor = factor
            self._level = self._make_level(
                self.scene if factor == 1.0 else self.scene.scale_images(factor, keep_larger=True)
            )
        return self._level

    def _make_level(self, scene: Scene) -> Level:
        if self._keep is None:
            return Level(scene)
        for each in {id(scene): scene, id(self.scene): self.scene}.values():
            keep_at_most(each, self._keep[1])
        return Level(scene, self._keep[0])

    def prepare(self, view: int, fraction: float) -> None:
        """Starts decoding the next step's image while this step is computed.

        Args:
            view: of the next step.
            fraction: of the next step. Does nothing where that changes the level, or with one
                thread.
        """
        level = self._level if self._factor_at(fraction) == self._factor else None
        if level is not None and _core.num_threads() > 1:
            level.prepare(view, self._worker)

    @property
    def poses(self) -> np.ndarray:
        """The poses camera_from_world (n, 4, 4) of the training views, in their order."""
        return self.scene.poses(self.scene.train_indices)

    def move(self, camera_from_world: np.ndarray) -> None:
        """Replaces the poses (n, 4, 4) of the training views."""
        self.scene = self.scene.with_poses(self.scene.train_indices, camera_from_world)
        if self._level is not None:
            level = self._level.scene
            self._level.scene = level.with_poses(level.train_indices, camera_from_world)

    def replace_lenses(self, file_cameras: Sequence[Camera]) -> None:
        """Replaces the lenses.

        Args:
            file_cameras: one for each of the scene's, at the size of its files.
        """
        self.scene = self.scene.with_lenses(file_cameras)
        if self._level is not None:
            self._level = self._make_level(self._level.scene.with_lenses(file_cameras))

    def state_dict(self) -> dict[str, Any]:
        """Returns the current poses and lenses."""
        lenses = [np.array(camera.params) for camera in self.scene.file_cameras]
        return {"poses": self.poses, "lenses": lenses}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the poses and lenses of `state_dict`."""
        self.move(state["poses"])
        cameras = self.scene.file_cameras
        lenses = tuple(c.with_params(p) for c, p in zip(cameras, state["lenses"], strict=True))
        if lenses != cameras:
            self.replace_lenses(lenses)

    def _factor_at(self, fraction: float) -> float:
        return next((f for f, end in self._until if fraction <= end), 1.0)
