"""Draws the trained Gaussians of a step and carries its picture's gradient back to them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut.gaussians import Gaussians, merge_gaussians


class Drawing:
    """Draws trained Gaussians, and beside them others that are not changed.

    Args:
        context: the others; None: there are none.

    Attributes:
        renderer: with what the last picture left.
        rule: by which Gaussians are blended.
        gradients: of everything drawn, from the last `backpropagate`.
    """

    def __init__(self, context: Gaussians | None) -> None:
        self.renderer, self.rule = _core.Renderer(), _core.BlendRule()
        self.gradients: Any = None
        self._context = context
        self._joined: Gaussians | None = None
        self._num_trained = 0
        self._touched = np.zeros(0, np.uint8)

    @property
    def is_alone(self) -> bool:
        """Whether only trained Gaussians are drawn."""
        return self._context is None

    def join(self, trained: Gaussians) -> Gaussians:
        """Returns the trained Gaussians followed by the others; valid until the next call."""
        self._num_trained = len(trained)
        if self._context is None:
            return trained
        if self._joined is None or len(self._joined) != self._num_trained + len(self._context):
            self._joined = merge_gaussians([trained, self._context])
        for field in dataclasses.fields(trained):
            getattr(self._joined, field.name)[: self._num_trained] = getattr(trained, field.name)
        return self._joined

    def render(
        self, trained: Gaussians, camera: Any, motion: Any, image: np.ndarray, **look: Any
    ) -> None:
        """Renders everything into `image` (H, W, 3) float32; `look`: background, tiles, ..."""
        drawn = self.join(trained)
        if len(self._touched) != len(drawn):
            self.gradients = drawn.make_zeros()
            self._touched = np.zeros(len(drawn), np.uint8)
        self.renderer.render(drawn, _core.RenderJob(camera, motion, rule=self.rule, **look), image)

    def backpropagate(self, dimage: np.ndarray, **how: Any) -> None:
        """Propagates the gradient (H, W, 3) of the last picture to all that a pixel saw."""
        self.renderer.backward(
            dimage, self.gradients, self._touched, write_untouched=False, with_poses=False, **how
        )

    def get_trained(self) -> tuple[Any, np.ndarray, np.ndarray]:
        """Returns the trained Gaussians' gradients, flags of those seen, and distances."""
        rows = slice(self._num_trained)
        gradients = self.gradients if self._context is None else self.gradients[rows]
        return gradients, self._touched[rows], self.renderer.distances()[rows]
