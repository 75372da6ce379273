"""Recordings: pictures of several cameras, brought together with a trajectory's poses."""

from gsut.data.recordings.pairing import listing_of
from gsut.data.recordings.recording import MASK, Recording, Stream, pictures_in, stream_of

__all__ = [
    "MASK",
    "Recording",
    "Stream",
    "listing_of",
    "pictures_in",
    "stream_of",
]
