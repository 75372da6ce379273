"""The uncertainty that a lens file states: a map of standard deviations in pixels."""

from __future__ import annotations

import ast
import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import CalibrationError, InputError
from gsut.files import read_json, read_text, register_reader, write_file
from gsut.lens.files import load_camera

# Written by `gsut calibrate`: rows of the map over the image, from the centre of the top-left
# pixel to the centre of the bottom-right one; -1 where the lens has no ray.
SIGMA_KEY = "gsut_uncertainty_px"
SIDE_FILE = ".uncertainty.json"  # beside lens files that cannot hold the map
_GRID_COLUMNS = 40
_NO_SIGMA = -1.0
_DIGITS = 6
_SHAPE_SLACK = 0.02  # of width / height: images resized by rounding


@dataclasses.dataclass(frozen=True)
class LensUncertainty:
    """Standard deviations of where a lens projects a distant point.

    Args:
        sigma: (rows, columns) float64, pixels of an image of this size; NaN where unknown.
        width, height: of the image.
    """

    sigma: np.ndarray
    width: int
    height: int

    def resample(self, width: int, height: int) -> np.ndarray:
        """Returns standard deviations (height, width) at the pixel centres of the resized image.

        In its pixels. Where the map has none, the value of the nearest place that has one.

        Raises:
            InputError: an image of another shape.
        """
        if abs(width / height * self.height / self.width - 1) > _SHAPE_SLACK:
            raise InputError(
                f"the uncertainty is that of images of {self.width} x {self.height} pixels, the "
                f"images are {width} x {height}: give the lens file of these images"
            )
        rows, columns = self.sigma.shape
        x = _place_on_grid(width, self.width, columns)
        y = _place_on_grid(height, self.height, rows)
        filled = _fill_gaps(self.sigma)
        left, top = (np.clip(p.astype(int), 0, n - 2) for p, n in ((x, columns), (y, rows)))
        a, b = (x - left)[None, :], (y - top)[:, None]
        upper = filled[top][:, left] * (1 - a) + filled[top][:, left + 1] * a
        lower = filled[top + 1][:, left] * (1 - a) + filled[top + 1][:, left + 1] * a
        return (upper * (1 - b) + lower * b) * (width / self.width)


def spread_pixels(width: int, height: int) -> np.ndarray:
    """Spreads the pixels (rows, columns, 2) of a stored map evenly, corner pixels included."""
    rows = max(2, round(_GRID_COLUMNS * height / width))
    x = np.linspace(0.5, width - 0.5, _GRID_COLUMNS)
    return np.stack(np.meshgrid(x, np.linspace(0.5, height - 0.5, rows)), axis=-1)


def save_uncertainty(path: str | os.PathLike[str], sigma: np.ndarray) -> None:
    """Stores a map with a lens file that exists.

    Args:
        path: lens file; a .cameramodel gets one more key, others NAME.uncertainty.json beside them.
        sigma: (rows, columns) pixels on `spread_pixels`; NaN where the lens has no ray.
    """
    file = Path(path)
    rows = [
        [round(float(value), _DIGITS) if np.isfinite(value) else _NO_SIGMA for value in row]
        for row in sigma
    ]
    if file.suffix.lower() != ".cameramodel":
        write_file(file.with_suffix(SIDE_FILE), json.dumps({SIGMA_KEY: rows}) + "\n")
        return
    head, brace, tail = read_text(file).rpartition("}")
    write_file(file, f"{head}    '{SIGMA_KEY}': {rows},\n{brace}{tail}")


@register_reader("uncertainty of a lens", ".uncertainty.json", ".cameramodel")
def load_uncertainty(path: str | os.PathLike[str]) -> LensUncertainty:
    """Reads the uncertainty that `gsut calibrate` stores with a lens.

    Args:
        path: lens file: a .cameramodel that holds gsut_uncertainty_px, or another one with
            NAME.uncertainty.json beside it.

    Raises:
        InputError: the lens has no uncertainty.
        CalibrationError: not a lens file, or a map that is none; the message names file and key.
        OSError: the file cannot be read.
    """
    file = Path(path)
    camera = load_camera(file)
    source = file
    if file.suffix.lower() == ".cameramodel":
        values = ast.literal_eval(read_text(file))  # load_camera found no fault
    else:
        source = file.with_suffix(SIDE_FILE)
        if not source.is_file():
            raise InputError(
                f"{file} has no uncertainty: {source.name} is not beside it; solve the lens with "
                "`gsut calibrate`, which writes it"
            )
        values = read_json(source, advice="copy it again", fails=_make_error)
    if not isinstance(values, dict) or SIGMA_KEY not in values:
        raise InputError(
            f"{source} has no uncertainty (the key {SIGMA_KEY}); solve the lens with "
            "`gsut calibrate`, which stores it"
        )
    return LensUncertainty(_map(values[SIGMA_KEY], source), camera.width, camera.height)


def _make_error(*said: object) -> CalibrationError:
    return CalibrationError("{}: {}; {}".format(*said))


def _map(rows: Any, source: Path) -> np.ndarray:
    try:
        sigma = np.array(rows, np.float64)
    except (TypeError, ValueError):
        sigma = np.empty(0)
    if sigma.ndim != 2 or min(sigma.shape) < 2:
        raise CalibrationError(
            f"{source}, key {SIGMA_KEY}: expected rows of numbers of one length, at least 2 x 2; "
            "solve the lens again"
        )
    sigma = np.where(sigma >= 0, sigma, np.nan)
    if not np.isfinite(sigma).any():
        raise CalibrationError(
            f"{source}, key {SIGMA_KEY}: the uncertainty is unknown at every pixel; take more "
            "photographs and solve the lens again"
        )
    return sigma


def _place_on_grid(count: int, full: int, cells: int) -> np.ndarray:
    """Places on the map's axis, in its cells, of the pixel centres of an image `count` wide."""
    pixel = (np.arange(count) + 0.5) * full / count - 0.5  # of the full image, first centre at 0
    return np.clip(pixel / max(full - 1, 1), 0.0, 1.0) * (cells - 1)


def _fill_gaps(sigma: np.ndarray) -> np.ndarray:
    known = np.argwhere(np.isfinite(sigma))
    result = sigma.copy()
    for row, column in np.argwhere(~np.isfinite(sigma)):
        nearest = known[np.argmin(np.sum((known - (row, column)) ** 2, axis=1))]
        result[row, column] = sigma[nearest[0], nearest[1]]
    return result
