"""Files of the corners: mrcal's .vnl in and out, and a picture of every board with its corners."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calib.board import Board, Photograph
from calib.errors import BoardError
from calib.images import read_grey
from gsut.files import write_file

LEGEND = "# filename x y level"
_LEVEL = "0"  # found at the image's full size
_WIDEST = 1600  # pixels of a picture
_JPEG_QUALITY = 85


def write_vnl(
    path: Path, photographs: Sequence[Photograph], names: Sequence[str] | None = None
) -> None:
    """Writes corners as mrcal reads them: one line a corner, "- - -" for an image without.

    Args:
        path: the file. photographs: with or without corners.
        names: what to call the images instead of their paths.
    """
    names = names or [str(photograph.path) for photograph in photographs]
    lines = [LEGEND]
    for photograph, name in zip(photographs, names, strict=True):
        if any(character.isspace() for character in name):
            raise BoardError(f"{name}: mrcal's corner files cannot hold names with spaces; rename")
        if photograph.corners is None:
            lines.append(f"{name} - - -")
            continue
        lines += [f"{name} {x:.5f} {y:.5f} {_LEVEL}" for x, y in photograph.corners]
    write_file(path, "\n".join(lines) + "\n")


def read_vnl(path: Path, board: Board) -> dict[str, np.ndarray]:
    """Corners (corners, 2) by image name; images without a whole board are left out.

    Raises:
        BoardError: a line is not "filename x y level", or a board has another number of corners.
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if not words or words[1:2] == ["-"]:
            continue
        try:
            found.setdefault(words[0], []).append((float(words[1]), float(words[2])))
        except (IndexError, ValueError):
            raise BoardError(
                f"{path}, line {number}: expected `filename x y level`, found {line!r}"
            ) from None
    for name, corners in found.items():
        if len(corners) != board.corners:
            raise BoardError(
                f"{path}: {name} has {len(corners)} corners, a board of {board} has {board.corners}"
            )
    return {name: np.array(corners) for name, corners in found.items()}


def draw_board(photograph: Photograph, board: Board, outliers: np.ndarray | None) -> np.ndarray:
    """(H, W, 3) BGR: the photograph, its corners in their order, outliers crossed out."""
    image = cv2.cvtColor(read_grey(photograph.path), cv2.COLOR_GRAY2BGR)
    scale = min(1.0, _WIDEST / image.shape[1])
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if photograph.corners is None:
        text = f"left out: {photograph.reason}"
        cv2.putText(image, text, (10, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 255), 1)
        return image
    # A pixel's centre (0, 0) moves to scale/2 - 1/2 of the smaller picture.
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
    """Writes the picture as FOLDER/CAMERA-STEM.jpg and returns its path."""
    path = folder / f"{photograph.camera}-{photograph.path.stem}.jpg"
    image = draw_board(photograph, board, outliers)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    write_file(path, data.tobytes())
    return path
