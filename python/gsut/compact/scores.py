"""How much each Gaussian counts, seen through the real lenses of a scene's views."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.gaussians import SH_C0, Gaussians
from gsut.render import place_about

# Pixels of the longer side at which renders are compared with photographs.
LONGER_SIDE = 480


@dataclasses.dataclass(frozen=True)
class SeenView:
    """A view without its photograph: what scores and weights need.

    Attributes:
        camera: lens and image size.
        camera_from_world: (4, 4), or the camera's motion behind a rolling shutter.
        mask: (H, W) bool, pixels that count.
    """

    camera: Any
    camera_from_world: Any
    mask: np.ndarray


@name_wrong_kinds
def list_seen_views(scene: Any, indices: Sequence[int]) -> list[SeenView]:
    """Lists views of a scene without their photographs, for `compact` to look through.

    Args:
        scene: a `Scene`.
        indices: which of its views.

    Returns:
        One a view, with the dataset's mask inside the lens' valid field.
    """
    return [SeenView(scene.camera(i), scene.views[i].motion, scene.mask(i)) for i in indices]


def blend_weights(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """Sums each Gaussian's blend weights (alpha x transmittance) over all valid pixels.

    The image is linear in the colours, and the blend weight is the factor: so this is the gradient
    of the images' sum to the colours, exactly, by the backward pass that trains.

    Args:
        gaussians: N Gaussians.
        views: at least one.
        on_view: called after each.

    Returns:
        (N,) float64, in pixels; 0 for what no valid pixel sees.
    """
    sums = np.zeros(len(gaussians))
    for each in _look_through(gaussians, require_views(views)):
        sums += each
        on_view()
    return np.maximum(sums / SH_C0, 0.0)


def blend_by_view(gaussians: Gaussians, views: Iterable[SeenView]) -> Iterator[np.ndarray]:
    """Yields the blend weights of one view after the other."""
    for sums in _look_through(gaussians, views):
        yield np.maximum(sums.astype(np.float64) / SH_C0, 0.0)


def _look_through(gaussians: Gaussians, views: Iterable[SeenView]) -> Iterator[np.ndarray]:
    """Yields the gradients (N,) of each view's sum of red to the base colours."""
    passes = Passes(paint_grey(gaussians))
    for view in views:
        dimage = np.zeros((*view.mask.shape, 3), np.float32)
        dimage[..., 0] = view.mask
        passes.render(view)
        yield passes.backpropagate(dimage).sh[:, 0, 0]


def find_strongest(gaussians: Gaussians, view: SeenView) -> tuple[np.ndarray, np.ndarray]:
    """Finds the Gaussian with the largest blend weight at each pixel of a view.

    Args:
        gaussians: N Gaussians.
        view: whose valid pixels are looked at.

    Returns:
        (H, W) int32, the Gaussian's number, -1 where there is none, and (H, W, 3) float32, the
        point of the pixel's ray that is nearest to the Gaussian's centre, about the Gaussians'
        origin as their means are.
    """
    passes = Passes(paint_grey(gaussians))
    passes.render(view)
    return passes.add_significance(view.mask, np.zeros(len(gaussians)))


class Passes:
    """Forward and backward passes of one set of Gaussians with shared buffers.

    Views are given in world coordinates, wherever the Gaussians' `origin` lies. Models along the
    ray are drawn by the distance, see `Gaussians.order_by_centers`.
    """

    def __init__(self, gaussians: Gaussians, background: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.gaussians = gaussians.order_by_centers().to_dtype(np.float32)
        self._background = tuple(background)
        self.touched = np.zeros(len(gaussians), np.uint8)
        self._gradients = self.gaussians.make_zeros()
        self._renderer = _core.Renderer()
        self._rule = _core.BlendRule()

    def render(self, view: SeenView, keep: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Renders image (H, W, 3) and alpha (H, W); keep: for the passes below."""
        image = np.zeros((view.camera.height, view.camera.width, 3), np.float32)
        alpha = np.zeros(image.shape[:2], np.float32)
        place = place_about(view.camera_from_world, self.gaussians.origin)
        job = _core.RenderJob(
            view.camera, place, rule=self._rule, background=self._background,
            sh_degree=self.gaussians.sh_degree, keep=keep,
        )  # fmt: skip
        self._renderer.render(self.gaussians, job, image, alpha)
        return image, alpha

    def backpropagate(self, dimage: np.ndarray) -> Gaussians:
        """Computes the gradients of sum(dimage * image); valid until the next call."""
        self._renderer.backward(dimage, self._gradients, self.touched)
        return self._gradients

    def add_significance(self, mask: np.ndarray, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Adds to sums (N,); returns each pixel's strongest Gaussian (-1: none) and its place."""
        return self._renderer.add_significance(mask.view(np.uint8), sums)

    def add_fisher(self, mask: np.ndarray, sums: np.ndarray) -> None:
        """Adds to sums (N, 21): the upper triangles."""
        self._renderer.add_fisher(mask.view(np.uint8), sums)

    def add_support(self, photograph: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Returns (N, 2): growth of the squared error without each, and its blend weights."""
        sums = np.zeros((len(self.gaussians), 2))
        self._renderer.add_support(photograph, mask.view(np.uint8), sums)
        return sums


def paint_grey(gaussians: Gaussians) -> Gaussians:
    """Paints Gaussians mid-grey: no colour is clamped, so no gradient is cut."""
    return Gaussians(
        gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.opacity_logits,
        np.zeros((len(gaussians), 1, 3), gaussians.dtype), gaussians.origin,
        **gaussians.rule,
    )  # fmt: skip


def require_views(views: Sequence[SeenView]) -> Sequence[SeenView]:
    """Returns the views; raises InputError if there is none."""
    if not views:
        raise InputError("scores need at least one view; give the views of the scene")
    return views
