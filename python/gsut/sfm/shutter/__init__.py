"""Rolling shutters: how long a readout takes, from the frames of a video."""

from gsut.sfm.shutter.readout import readout_time
from gsut.sfm.shutter.video import VideoShutter, find_video_shutter, probably_rolling

__all__ = ["VideoShutter", "find_video_shutter", "probably_rolling", "readout_time"]
