"""Turns videos and photographs into a folder of pictures that poses can be found for."""

from gsut.capture.frames import Capture, extract_frames
from gsut.capture.inputs import capture, needs_capture, read_state
from gsut.capture.photographs import collect_photographs
from gsut.capture.video import is_video

__all__ = [
    "Capture",
    "capture",
    "collect_photographs",
    "extract_frames",
    "is_video",
    "needs_capture",
    "read_state",
]
