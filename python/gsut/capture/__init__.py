"""Turns videos and photographs into a folder of pictures that poses can be found for."""

from gsut.capture.frames import Capture
from gsut.capture.inputs import capture, needs_capture, read_state

__all__ = ["Capture", "capture", "needs_capture", "read_state"]
