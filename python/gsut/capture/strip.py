"""Draws the chosen pictures as one strip, which shows at a glance what a scene is made from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import STRIP
from gsut.data.images import decode_image
from gsut.files import write_picture
from gsut.orientation import count_turns, turn_picture
from gsut.sampling import choose_evenly

# Height of a picture in pixels.
_HEIGHT = 96
# Most width of a picture, x its height; wider ones are squeezed.
_WIDEST = 4
# Pictures in a line.
_COLUMNS = 10
# Most pictures, evenly chosen.
_MOST = 60
# Colour of a blurred picture's frame: blue, green, red.
_BLURRED_COLOR = (40, 40, 220)


def write_strip(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes strip.jpg: the pictures in order, with their times; blurred ones framed in red.

    Args:
        folder: of a capture.
        rows: "frames" of capture.json.
    """
    tiles = [_draw_tile(folder / row["path"], row) for row in choose_evenly(rows, _MOST)]
    width = max(tile.shape[1] for tile in tiles)
    lines = []
    for start in range(0, len(tiles), _COLUMNS):
        line = np.full((_HEIGHT + 4, _COLUMNS * (width + 4), 3), 255, np.uint8)
        for place, tile in enumerate(tiles[start : start + _COLUMNS]):
            left = place * (width + 4)
            line[: tile.shape[0], left : left + tile.shape[1]] = tile
        lines.append(line)
    write_picture(folder / STRIP, np.concatenate(lines))


def _draw_tile(path: Path, row: dict[str, Any]) -> np.ndarray:
    import cv2

    try:
        pixels = decode_image(path, 2)[0]
    except InputError:
        return np.full((_HEIGHT, _HEIGHT, 3), 200, np.uint8)
    turns = count_turns(row.get("orientation") or 1)
    pixels = turn_picture(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), turns)
    width = round(pixels.shape[1] * _HEIGHT / pixels.shape[0])
    width = min(max(1, width), _WIDEST * _HEIGHT)
    tile = cv2.resize(pixels, (width, _HEIGHT), interpolation=cv2.INTER_AREA)
    if row.get("time") is not None:
        text = f"{row['time']:.1f} s"
        for color, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            where = (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42
            cv2.putText(tile, text, *where, color, thick, cv2.LINE_AA)
    if row.get("blurred"):
        cv2.rectangle(tile, (0, 0), (width - 1, _HEIGHT - 1), _BLURRED_COLOR, 3)
    return tile
