"""Writes what was found in the photographs: corners as mrcal's .vnl, and annotated pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calib.boards.board import Board, Photograph
from calib.boards.images import read_grey
from calib.errors import BoardError
from gsut.files import write_file

_LEGEND = "# filename x y level"
_LEVEL = "0"  # mrcal's pyramid level: found at the image's full size
_WIDEST = 1600  # pixels of a picture: enough to check every corner
_JPEG_QUALITY = 85  # no visible blocks at half the size of lossless files


def write_vnl(
    path: Path, photographs: Sequence[Photograph], names: Sequence[str] | None = None
) -> None:
    """Writes corners as mrcal reads them: one line each, "- - -" for an image without a board.

    Args:
        path: the file. photographs: with or without corners.
        names: of the images; None: their paths.
    """
    names = names or [str(photograph.path) for photograph in photographs]
    lines = [_LEGEND]
    for photograph, name in zip(photographs, names, strict=True):
        if any(character.isspace() for character in name):
            raise BoardError(f"{name}: mrcal's corner files cannot hold names with spaces; rename")
        if photograph.corners is None:
            lines.append(f"{name} - - -")
            continue
        lines += [f"{name} {x:.5f} {y:.5f} {_LEVEL}" for x, y in photograph.corners]
    write_file(path, "\n".join(lines) + "\n")


def _draw_board(photograph: Photograph, board: Board, outliers: np.ndarray | None) -> np.ndarray:
    """Draws the corners in their order over the photograph, with outliers crossed out: BGR."""
    image = cv2.cvtColor(read_grey(photograph.path), cv2.COLOR_GRAY2BGR)
    scale = min(1.0, _WIDEST / image.shape[1])
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if photograph.corners is None:
        text = f"left out: {photograph.reason}"
        cv2.putText(image, text, (10, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 255), 1)
        return image
    # The pixel centre (0, 0) moves to scale/2 - 1/2 in the smaller picture.
    corners = (photograph.corners + 0.5) * scale - 0.5
    size = (board.columns, board.rows)
    cv2.drawChessboardCorners(image, size, corners.reshape(-1, 1, 2).astype(np.float32), True)
    if outliers is not None:
        for x, y in corners[outliers]:
            at = (round(float(x)), round(float(y)))
            cv2.drawMarker(image, at, (0, 0, 255), cv2.MARKER_TILTED_CROSS, 18, 2)
    return image


def write_board_picture(
    folder: Path, photograph: Photograph, board: Board, outliers: np.ndarray | None = None
) -> Path:
    """Writes the photograph with its corners as FOLDER/CAMERA-STEM.jpg and returns the path."""
    path = folder / f"{photograph.camera}-{photograph.path.stem}.jpg"
    image = _draw_board(photograph, board, outliers)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    write_file(path, data.tobytes())
    return path
