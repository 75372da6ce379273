"""Objects that were cut out of their photographs: where alpha is 0 there is nothing.

A mask says of a pixel that it is not known, alpha 0 of a cut-out that its ray meets nothing. Rays
there are trained to show the background of the step, a random colour, whatever it is: that leaves
alpha 0 as the only answer, and no dark shell grows around the object.
"""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.sampling import choose_evenly

_EMPTY = 1 / 3  # share of the pixels above which alpha 0 may be a cut-out
# Share of the pixels that are empty in some photographs and not in others: a lens' circle or a
# logo is the same in all.
_DIFFERING = 0.05
_MARGIN = np.ones((5, 5), np.uint8)  # pixels at the object's outline, whose alpha is between


class CutOut:
    """The empty pixels of an object's photographs.

    Args:
        share: of the pixels of the photographs that are empty.
    """

    def __init__(self, share: float) -> None:
        self.share = share

    @classmethod
    def find(cls, scene: Scene) -> CutOut | None:
        """Finds whether the training photographs are of an object that was cut out."""
        empty: list[np.ndarray] = []
        for index in choose_evenly(scene.train_indices):
            alpha = scene.alpha(index)
            if alpha is None or (empty and alpha.shape != empty[0].shape):
                return None
            empty.append(~alpha)
        always, ever = np.all(empty, axis=0), np.any(empty, axis=0)
        share = float(np.mean(empty))
        differing = float(np.mean(ever & ~always))
        return cls(share) if share > _EMPTY and differing > _DIFFERING else None

    def add_gradient(
        self, scene: Scene, view: int, image: np.ndarray, dimage: np.ndarray,
        behind: tuple[float, float, float],
    ) -> None:  # fmt: skip
        """Adds the gradient of the mean absolute difference from the background.

        Args:
            scene: at the step's resolution.
            view: of the step.
            image, dimage: (H, W, 3) as rendered, and the loss' gradient to it, which is changed.
            behind: colour that the step draws behind all Gaussians.
        """
        import cv2

        alpha = scene.alpha(view)
        if alpha is None:
            return
        empty = cv2.erode((~alpha).astype(np.uint8), _MARGIN).astype(bool)
        off = image[empty] - np.array(behind, np.float32)
        dimage[empty] = np.sign(off) / np.float32(image.size)
