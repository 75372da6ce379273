"""Turns videos and photographs into a folder of pictures that poses can be found for."""

from gsut.capture.frames import Capture
from gsut.capture.inputs import capture, find_changed_inputs, needs_capture
