"""What people hold, in: videos and photographs become a folder of pictures worth keeping."""

from gsut.capture.frames import Capture, extract_frames
from gsut.capture.video import VIDEO_SUFFIXES, is_video

__all__ = ["VIDEO_SUFFIXES", "Capture", "extract_frames", "is_video"]
