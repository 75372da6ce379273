"""What `gsut render` writes of values that were lifted onto the Gaussians."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import write_npy
from gsut.formats import load_gaussians
from gsut.lifting import Lifted
from gsut.render import write_png
from gsut.run import RunFile, RunFolder

_FOLDER = "lifted"
_NO_LABEL = np.iinfo(np.uint16).max  # of the 16-bit pictures


class LiftedOutput:
    """Lifted values of images as they are rendered.

    Args:
        arguments: of `gsut render`.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        place = Path(arguments.folder)
        # In the order of their file, which a run's are not once they are made small for drawing.
        file = place if place.is_file() else RunFolder.open(place).path / RunFile.SCENE
        self._lifted = Lifted.load(arguments.lifted)
        self._gaussians = load_gaussians(file)
        found, known = len(self._gaussians), len(self._lifted.weights)
        if found != known:
            raise InputError(
                f"{arguments.lifted} was lifted onto {known:,} Gaussians and {file} has {found:,}; "
                "lift onto these with `gsut lift`"
            )
        ids = self._lifted.ids
        if ids is not None and ids.max() >= _NO_LABEL:
            raise InputError(
                f"{arguments.lifted} has the label {ids.max()}, pictures of 16 bits hold those "
                f"below {_NO_LABEL}; give smaller labels to `gsut lift`"
            )

    @classmethod
    def from_flags(cls, arguments: argparse.Namespace, film: bool) -> LiftedOutput | None:
        """Makes the writer that the flags request; None without lifted values.

        Raises:
            InputError: lifted values of a film, or those of other Gaussians.
        """
        if arguments.lifted is None:
            return None
        if film:
            raise InputError("a film has no lifted values: give a folder by -o, not a film's name")
        return cls(arguments)

    def add(self, folder: Path, shot: Any, result: Any, image: np.ndarray) -> None:
        """Writes one image's values: .npy, or .png of labels."""
        shown = self._lifted.render(self._gaussians, shot.camera, shot.place)
        (folder / _FOLDER).mkdir(exist_ok=True)
        if self._lifted.ids is not None:
            labels = np.where(shown < 0, _NO_LABEL, shown).astype(np.uint16)
            write_png(folder / _FOLDER / f"{shot.name}.png", labels)
            return
        write_npy(folder / _FOLDER / f"{shot.name}.npy", shown)

    def finish(self) -> dict[str, Any]:
        """Returns figures: none."""
        return {}
