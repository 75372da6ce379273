"""Leaves out of the loss what one photograph shows and the others contradict."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gsut import _core
from gsut.gaussians import Gaussians
from gsut.run import TrainOptions
from gsut.training.photograph.movers import Movers
from gsut.training.photograph.photograph_model import PhotographModel

# Fraction of the steps at which movers are looked for: the Gaussians show surfaces by then, and do
# not yet show what only one photograph does.
_MOVERS_AT = 0.28
# Fraction of the steps after which pixels that differ are left out: before, most do.
_ROBUST_FROM = 0.15


class Outliers:
    """Finds what moved while photographs were taken, and keeps it out of the loss.

    Args:
        options: of the run; with `robust` what differs is left out, too.
        is_new: whether the Gaussians start from nothing; others may show movers already.

    Attributes:
        movers: what moved in the training views, as far as it is known.
    """

    def __init__(self, options: TrainOptions, is_new: bool) -> None:
        self._robust_from = _ROBUST_FROM * options.steps if options.robust else None
        self._movers_at = round(_MOVERS_AT * options.steps) if is_new else None
        self.movers = Movers()

    def observe(
        self, step: Any, draw: Callable[[], Gaussians], photographs: PhotographModel
    ) -> None:
        """Finds what moved in the training views, once.

        Args:
            step: that was made: its number and its level.
            draw: returns the Gaussians as they are drawn.
            photographs: their light.
        """
        if step.number == self._movers_at:
            scene, light = step.level.scene, photographs.find_light()
            self.movers = Movers.find(draw(), scene, scene.train_indices, light)

    def find_moving(self, view: int, width: int, height: int) -> np.ndarray | None:
        """Returns a view's mask (height, width) of what moved, as far as it is known yet."""
        return self.movers.scale_mask(view, width, height)

    def leave_out(
        self, step: int, view: int, target: _core.PhotometricTarget, image: np.ndarray,
        dimage: np.ndarray,
    ) -> None:  # fmt: skip
        """Zeros the loss' gradient (H, W, 3) where the view's photograph is not believed."""
        moving = self.find_moving(view, dimage.shape[1], dimage.shape[0])
        if moving is not None:
            dimage[moving] = 0
        if self._robust_from is not None and step >= self._robust_from:
            _core.trim_gradient(target, image, dimage)

    def state_dict(self) -> dict[str, Any]:
        """Returns what later steps depend on."""
        return {str(view): mask for view, mask in self.movers.masks.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what `state_dict` returned."""
        masks = {int(view): np.asarray(mask, bool) for view, mask in state.items()}
        self.movers = Movers(masks)
