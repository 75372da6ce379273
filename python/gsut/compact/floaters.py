"""Gaussians that the photographs contradict: blobs in the air that one or no photograph wants."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.compact.scores import LONGER_SIDE, Passes, SeenView
from gsut.gaussians import Gaussians
from gsut.render import Light

_UNSEEN = 0.05  # pixels of weight in all photographs together, below which nothing shows a Gaussian
# Squared error per pixel of weight that the photographs must lose without a contradicted Gaussian;
# the one that needs it most does not count. With less, Gaussians that replace each other would all
# be removed.
_HARM = 0.05


@dataclasses.dataclass(frozen=True)
class Support:
    """The evidence of photographs for N Gaussians.

    Attributes:
        total: (N,) by how much their squared error, summed over pixels and channels, grows without
            the Gaussian; below 0: they are better without.
        most: (N,) the same of the one photograph that wants it most, at least 0.
        weight: (N,) sum of blend weights, in pixels.
        other_weight: (N,) the same without the photograph that wants it most.
    """

    total: np.ndarray
    most: np.ndarray
    weight: np.ndarray
    other_weight: np.ndarray

    @property
    def unseen(self) -> np.ndarray:
        """(N,) bool: no photograph shows it."""
        return self.weight < _UNSEEN

    @property
    def contradicted(self) -> np.ndarray:
        """The rows (N,) that make renders of all photographs but one worse."""
        return ~self.unseen & (self.total - self.most < -_HARM * self.other_weight)


@name_wrong_kinds
def find_support(
    scene: Any,
    gaussians: Gaussians,
    indices: Sequence[int],
    *,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    light: Light | None = None,
    on_view: Callable[[int], object] = lambda done: None,
) -> Support:
    """Finds the evidence of photographs for each Gaussian: how renders would err without it.

    An image is linear in what one Gaussian covers, so this is exact, one Gaussian at a time.

    Args:
        scene: a `Scene`; its photographs are used at up to 480 pixels.
        gaussians: N, in the scene's coordinates.
        indices: of the views, at least two.
        background: colour behind everything; None: black.
        light: of the photographs, if the run has found it.
        on_view: called after each with how many there were.

    Returns:
        Sums in pixels of the photographs as they are used.

    Raises:
        InputError: fewer than two views.
    """
    if len(indices) < 2:
        raise InputError(f"{len(indices)} photographs cannot contradict each other; 2 at least")
    longest = max(max(camera.width, camera.height) for camera in scene.cameras)
    small = scene.scale_images(min(1.0, LONGER_SIDE / longest))
    passes = Passes(gaussians, background or (0.0, 0.0, 0.0))
    count = len(gaussians)
    total, most, weight, most_weight = np.zeros((4, count))
    for done, index in enumerate(indices, 1):
        view, camera = small.views[index], small.camera(index)
        photograph = small.image(index).astype(np.float32) / np.float32(255)
        if light is not None:
            photograph = photograph / light.on(camera, index, view.camera_index)
        mask = small.mask(index)
        passes.render(SeenView(camera, view.motion, mask))
        here = passes.add_support(np.ascontiguousarray(photograph, np.float32), mask)
        more = here[:, 0] > most
        most_weight = np.where(more, here[:, 1], most_weight)
        most = np.where(more, here[:, 0], most)
        total += here[:, 0]
        weight += here[:, 1]
        on_view(done)
    return Support(total, most, weight, weight - most_weight)
