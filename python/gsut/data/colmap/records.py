"""What a COLMAP model's files hold, whether read from text or binary."""

from __future__ import annotations

from typing import NamedTuple


class ImageRow(NamedTuple):
    """One image: its camera-from-world rotation and translation."""

    image_id: int
    quat_wxyz: list[float]
    translation: list[float]
    camera_id: int
    name: str
    where: str
