"""Chooses the streams of a file that are films, and finds frames woven of two moments."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

# Least difference of neighbouring lines to that of lines two apart, of which a frame is woven: in
# pictures of one moment it is the smaller one.
_WOVEN = 1.1
_MATRIX = struct.Struct("=9i")  # of a film's display, as FFmpeg stores it
_COLUMNS = 4  # columns from one that is looked at to the next


def list_films(container: Any) -> list[Any]:
    """Lists a file's streams of video, the largest pictures first, so that previews come last.

    Without pictures of its cover, if there are others.
    """
    from av.stream import Disposition

    streams = list(container.streams.video)
    no_film = Disposition.attached_pic | Disposition.still_image
    films = [each for each in streams if not each.disposition & no_film] or streams
    # Streams that cannot be decoded have neither.
    sizes = {each.index: getattr(each, "width", 0) * getattr(each, "height", 0) for each in films}
    return sorted(films, key=lambda film: sizes[film.index], reverse=True)


def find_quarter_turns(frame: Any) -> int:
    """Returns by how many quarter turns, 0 to 3, a frame is turned counterclockwise to be shown."""
    # A damaged matrix gives FFmpeg's answer for none, which is no angle.
    return round(frame.rotation / 90) % 4 if abs(frame.rotation) <= 360 else 0


def is_mirrored(frame: Any) -> bool:
    """Returns whether a frame's display matrix mirrors it.

    To be asked of one frame of a film: what holds a frame's side data keeps the frame in memory.
    """
    given = [bytes(each) for each in frame.side_data if each.type.name == "DISPLAYMATRIX"]
    if not given or len(given[0]) != _MATRIX.size:
        return False
    a, b, _, c, d, *_ = _MATRIX.unpack(given[0])
    return a * d < b * c


def show_upright(picture: np.ndarray, turns: int, mirrored: bool) -> np.ndarray:
    """Turns a frame's picture counterclockwise by quarter turns, and mirrors it."""
    if mirrored:  # its angle is that of the mirrored picture, and a half
        picture, turns = picture[:, ::-1], turns + 2
    return np.ascontiguousarray(np.rot90(picture, turns))


def is_woven(picture: np.ndarray) -> bool:
    """Returns whether even and odd lines of a picture (H, W, 3) show two moments."""
    rows = picture[:, ::_COLUMNS, 1].astype(np.int16)
    one, two = (float(np.abs(rows[by:] - rows[:-by]).mean()) for by in (1, 2))
    return one > _WOVEN * two
