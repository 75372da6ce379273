"""Trains one block: a pure function from a task and a state to the next state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gsut import _core
from gsut.blocks.plan import make_block_recipe
from gsut.blocks.task import BlockTask, Trained, list_arrays
from gsut.data import Scene
from gsut.data.scene import Level
from gsut.render import Light, compute_field_angles
from gsut.training import TrainingLoop

# Side of a tile in pixels, as in the renderer.
TILE = 16
# Steps between those in which the whole view counts: what grows beyond a block's silhouette would
# otherwise never be seen in the views that it was cut out of.
_WHOLE_EVERY = 10
# Distance in pixels over which the gradient depends on other pixels: twice SSIM's window's reach.
_SSIM_REACH = 10


class BlockLoop(TrainingLoop):
    """Trains one block: its Gaussians among those of others, on the pixels that show it.

    Gradients of the pixels that count are those of the whole view: the loss' neighbourhood of these
    pixels is rendered, too.

    Args:
        task: what to train.

    Attributes:
        pixels: number of pixels with a ray rendered so far.
    """

    def __init__(self, task: BlockTask) -> None:
        self._task = task
        context = task.context if len(task.context) else None
        super().__init__(
            task.scene, task.options, task.own.gaussians, context=context,
            recipe=make_block_recipe(task.options, task.share),
        )  # fmt: skip
        if task.own.moments:
            for row, given in zip(self.optimizer.moments, task.own.moments, strict=True):
                for name, values in list_arrays(given).items():
                    getattr(row, name)[...] = values
            self.optimizer.steps = task.begin
        self.views.keep_at_most(task.keep_bytes)
        self.photographs: Any = KnownLight(task.scene, task.light)
        self._order = order_views(task.rates, task.options.steps, task.options.seed)
        self.step, self.pixels = task.begin, 0
        self._chosen: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, int]] = {}

    @property
    def extent(self) -> float:
        """The extent of the whole scene."""
        return self._task.extent

    def _choose_view(self, step: int) -> int:
        return int(self._order[step - 1])

    def _choose_tiles(self, step: Any) -> np.ndarray | None:
        if step.number % _WHOLE_EVERY == 0:
            self.pixels += int(np.count_nonzero(step.level.scene.camera(step.view).rays()[1]))
            return None
        _, tiles, pixels = self._choose_shown(step)
        self.pixels += pixels
        return tiles

    def _choose_pixels(self, step: Any, dimage: np.ndarray) -> None:
        if step.number % _WHOLE_EVERY:
            dimage *= self._choose_shown(step)[0][..., None]

    def _choose_shown(self, step: Any) -> tuple[np.ndarray, np.ndarray, int]:
        """Returns a view's pixels that count (H, W), tiles to render, and number of rendered
        pixels."""
        camera = step.level.scene.camera(step.view)
        key = (step.view, camera.width)
        if key not in self._chosen:
            self._chosen = {k: v for k, v in self._chosen.items() if k[1] == camera.width}
            full = self._task.scene.camera(step.view)
            counts = spread_tiles(
                self._task.tiles[step.view], (camera.height, camera.width),
                (full.height, full.width),
            )  # fmt: skip
            tiles = widen_tiles(counts)
            rendered = spread_tiles(tiles > 0, counts.shape, counts.shape) > 0
            pixels = int(np.count_nonzero(rendered & camera.rays()[1]))
            self._chosen[key] = counts, tiles, pixels
        return self._chosen[key]

    def state_dict(self) -> dict[str, Any]:
        """Returns everything that later steps depend on."""
        return super().state_dict() | {"pixels": self.pixels}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state that `state_dict` returned; the following steps have the same bits."""
        super().load_state_dict(state)
        self.pixels = int(state["pixels"])


def order_views(rates: np.ndarray, steps: int, seed: int) -> np.ndarray:
    """Returns the view of each step (steps,): in each epoch every view at most once, shuffled.

    Args:
        rates: (V,) share of the epochs in which each takes part, above 0 and at most 1, spread
            evenly.
        steps: number of steps.
        seed: of the shuffling.
    """
    phases = np.random.default_rng(seed).random(len(rates))
    epochs: list[np.ndarray] = []
    count = 0
    while count < steps:
        order = np.random.default_rng([seed, len(epochs)]).permutation(len(rates))
        now, then = (np.floor(phases + rates * (len(epochs) + i)) for i in (0, 1))
        epochs.append(order[(then > now)[order]])
        count += len(epochs[-1])
    return np.concatenate(epochs)[:steps]


class KnownLight:
    """Holds light that an earlier training has found, in place of a `PhotographModel`.

    Args:
        scene: at any resolution.
        light: None: photographs are used unchanged.
    """

    def __init__(self, scene: Scene, light: Light | None) -> None:
        self._scene, self._light = scene, light
        self._planes: dict[tuple[int, int], Any] = {}

    def observe(self, fraction: float, level: Level, view: int, target: Any, image: Any) -> None:
        """Passes a view's light to its target."""
        if self._light is None:
            return
        camera, index = level.scene.camera(view), self._scene.views[view].camera_index
        falloff, key = self._light.falloffs[index], (index, camera.width)
        if falloff is not None and key not in self._planes:
            inverse = 1.0 / falloff.evaluate(compute_field_angles(camera))
            self._planes[key] = _core.FalloffPlane(inverse.astype(np.float32))
        target.set_light(1.0 / self._light.gains[view], self._planes.get(key))

    def find_light(self) -> Light | None:
        """Returns the given light."""
        return self._light

    def state_dict(self) -> dict[str, Any]:
        """Returns nothing, since the light does not change."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Does nothing, since the light does not change."""


def spread_tiles(tiles: np.ndarray, shape: tuple[int, ...], full: tuple[int, ...]) -> np.ndarray:
    """Returns (H, W) float32, 1 or 0 for each pixel by the tile that contains it.

    Args:
        tiles: (rows, columns) bool of an image of the size `full`.
        shape: (H, W) of the result.
        full: (H, W) of the image that the tiles divide.
    """
    rows, columns = (
        ((np.arange(size) + 0.5) * (whole / size) / TILE).astype(int)
        for size, whole in zip(shape, full, strict=True)
    )
    return tiles[np.ix_(rows, columns)].astype(np.float32)


def widen_tiles(counts: np.ndarray) -> np.ndarray:
    """Returns (rows, columns) uint8: the tiles that the loss at pixels that count depends on."""
    import cv2

    reach = np.ones((2 * _SSIM_REACH + 1, 2 * _SSIM_REACH + 1), np.uint8)
    near = cv2.dilate((counts > 0).astype(np.uint8), reach)
    height, width = (-(-side // TILE) * TILE for side in near.shape)
    whole = np.zeros((height, width), np.uint8)
    whole[: near.shape[0], : near.shape[1]] = near
    return whole.reshape(height // TILE, TILE, width // TILE, TILE).max(axis=(1, 3))


def run_segment(
    task: BlockTask,
    state: dict[str, Any] | None,
    kept: list[BlockLoop],
    on_step: Callable[[int, float, int], object] = lambda step, loss, count: None,
) -> dict[str, Any]:
    """Trains a block by one segment and returns its next state.

    Args:
        task: the block in a round.
        state: the result of the segment before; None: the first one.
        kept: holds the loop of the last call, which is used again if it fits task and state: that
            saves reading the photographs; the bits do not depend on it.
        on_step: called after each step with its number, loss and the number of Gaussians.

    Returns:
        segment: number of finished ones; step, seconds, pixels: of the round so far; views: of the
            task; finished: whether it was the last segment; and "loop", the state of training, or
            after the last segment the result of `Trained.as_dict`, with moments if steps are left.
    """
    done = 0 if state is None else int(state["segment"])
    loop = next((each for each in kept if each._task is task), None)
    if loop is None or loop.step != (task.begin if state is None else state["step"]):
        kept.clear()  # its photographs go before others are read
        loop = BlockLoop(task)
        if state is not None:
            loop.load_state_dict(state["loop"])
    kept[:] = [loop]
    while loop.step < task.find_last_step(done):
        on_step(loop.step, loop.advance(), len(loop.gaussians))
    out = {
        "segment": done + 1, "step": loop.step, "seconds": loop.seconds, "pixels": loop.pixels,
        "views": len(task.scene.views), "finished": done + 1 == task.segments,
    }  # fmt: skip
    if not out["finished"]:
        return out | {"loop": loop.state_dict()}
    kept.clear()
    moments = loop.optimizer.moments if loop.step < task.options.steps else ()
    return out | Trained(loop.make_result(), moments).as_dict()
