"""Rolling shutters: how long a readout takes, from the frames of a video."""

from gsut.sfm.shutter.video import find_shutter, is_probably_rolling

__all__ = ["find_shutter", "is_probably_rolling"]
