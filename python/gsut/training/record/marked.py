"""Writes photographs on which pixels are marked, for the report."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.data import Scene
from gsut.orientation import turn_picture
from gsut.render import write_png
from gsut.run import RunFolder

_SIDE = 640  # pixels of the longer side: what a page shows beside text
_PAINT = (255, 0, 160)  # a colour that photographs rarely have


def write_marked(
    run: RunFolder, scene: Scene, view: int, where: np.ndarray, name: str, text: str
) -> dict[str, Any]:
    """Writes a view's photograph with painted pixels into the run's folder of renders.

    Args:
        run: the folder.
        scene, view: of the photograph.
        where: (h, w) bool at any size, True for the pixels to paint.
        name: of the file.
        text: says below the picture what the pixels are.

    Returns:
        A row of "marked" in metrics.json.
    """
    import cv2

    photograph = scene.image(view)
    height, width = photograph.shape[:2]
    factor = min(1.0, _SIDE / max(height, width))
    size = max(1, round(factor * width)), max(1, round(factor * height))
    picture = cv2.resize(photograph, size, interpolation=cv2.INTER_AREA)
    mark = cv2.resize(where.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    picture[mark] = (picture[mark].astype(np.float32) + _PAINT) / 2
    write_png(run.renders / name, turn_picture(picture, scene.views[view].turns))
    return {"picture": name, "text": f"{scene.views[view].name}: {text}"}
