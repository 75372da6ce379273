"""Recordings: pictures of several cameras, brought together with a trajectory's poses."""

from gsut.data.recordings.pairing import pair_recording
from gsut.data.recordings.recording import (
    MASK,
    TIME_TOLERANCE,
    Recording,
    Stream,
    find_stream,
    list_pictures,
)
