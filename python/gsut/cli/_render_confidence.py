"""What `gsut render --confidence` writes beside images: how sure each pixel is."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.compact import measure_confidence
from gsut.evaluate import write_report
from gsut.files import write_npz
from gsut.page import paint_values
from gsut.render import Confidence, write_png
from gsut.run import Progress, RunFile, RunFolder
from gsut.terminal import say
from gsut.training import TrainedRun, load_run

_FOLDER = "confidence"
_FULL = 0.1  # one sigma of the colours, of [0, 1], at the end of the picture's scale
_HATCH = 8  # pixels from one stripe to the next, where nothing was ever seen
_MAPS = ("color_sigma", "depth_sigma", "seen_views")


class ConfidenceOutput:
    """How sure the images of a run are, as they are rendered.

    Args:
        run: of a finished training.
        confidence: of its Gaussians.
    """

    def __init__(self, run: TrainedRun, confidence: Confidence) -> None:
        self.gaussians, self.confidence = run.gaussians, confidence
        self._images = self._unseen = 0.0

    @classmethod
    def from_flags(cls, arguments: argparse.Namespace, film: bool) -> ConfidenceOutput | None:
        """Reads the confidence of a run, or measures it and keeps it there; None: not requested.

        Raises:
            InputError: of a film, or of a file, which has no photographs.
        """
        if not arguments.confidence:
            return None
        place = Path(arguments.folder)
        if film:
            raise InputError("a film has no confidence: give a folder by -o, not a film's name")
        if place.is_file():
            raise InputError(
                f"{place} has no photographs to compare with: give the folder of its run"
            )
        run, kept = load_run(place, arguments.data), place / RunFile.CONFIDENCE
        if kept.is_file():
            confidence = Confidence.load(kept)
            if confidence.is_of(run.gaussians):
                return cls(run, confidence)
        with Progress() as bars:
            confidence = measure_confidence(
                run.scene, run.gaussians, background=run.options.background, light=run.light,
                on_view=lambda done, total: bars.show("views", done, total),
            )  # fmt: skip
        try:
            confidence.save(kept)
            if (place / RunFile.METRICS).is_file():
                write_report(RunFolder.open(place))
        except InputError as error:  # the images need neither
            say(f"note: {error}")
        return cls(run, confidence)

    def add(self, folder: Path, shot: Any, result: Any, image: np.ndarray) -> None:
        """Writes one image's maps, as numbers and as a picture."""
        (folder / _FOLDER).mkdir(exist_ok=True)
        file = folder / _FOLDER / f"{shot.name}.npz"
        write_npz(file, {each: getattr(result, each) for each in _MAPS}, pack=True)
        drawn = result.camera.rays()[1]  # a fisheye's corners show nothing that could be seen
        never = drawn & (result.seen_views == 0)
        write_png(file.with_suffix(".png"), paint_confidence(result.color_sigma, never), shot.turns)
        self._images += 1
        self._unseen += float(never.sum() / max(1, drawn.sum()))

    def finish(self) -> dict[str, Any]:
        """Returns figures."""
        return {
            "confidence": self.confidence.describe(),
            "never_seen": self._unseen / max(1, self._images),
            "levels": self.confidence.levels.tolist(),
            "factors": self.confidence.factors.tolist(),
            "held": [None if np.isnan(each) else each for each in self.confidence.held.tolist()],
        }


def paint_confidence(sigma: np.ndarray, never: np.ndarray) -> np.ndarray:
    """Paints sigmas of colour (H, W) from 0 to 0.1; what was never seen is hatched, not coloured.

    Returns:
        (H, W, 3) RGB uint8.
    """
    import cv2

    colors = paint_values(np.nan_to_num(sigma) / _FULL, cv2.COLORMAP_TURBO)
    rows, columns = np.indices(never.shape)
    stripes = np.where((rows + columns) % _HATCH < _HATCH // 2, 255, 0).astype(np.uint8)
    return np.where(never[..., None], stripes[..., None], colors)
