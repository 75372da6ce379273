"""Reads videos: upright frames with their time stamps, and sentences on what is wrong with a file.

The decoder is FFmpeg, through PyAV, which says whether a packet can be decoded. Frames have the
time stamps of the file, so that a variable frame rate does not matter.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.capture.boxes import check_tables, count_films, is_without_index
from gsut.capture.streams import find_quarter_turns, is_mirrored, is_woven, list_films, show_upright
from gsut.files import check_regular, find_kind, open_binary, register_reader
from gsut.lens import MOST_STRETCH

# GoPro's firmware names since HERO9; before, HD8 is HERO8.
_GOPRO = {
    "HD9": "HERO9", "H19": "Max", "H21": "HERO10", "H22": "HERO11", "H23": "HERO12",
    "H24": "HERO13",
}  # fmt: skip
# Of FFmpeg's durations, a second.
_DURATION_UNITS = 1e6
# Frames per second of a file that does not say.
_USUAL_RATE = 30.0
# Curves of films for bright screens, by their numbers in ITU-T H.273.
_BRIGHT_CURVES = {16: "PQ", 18: "HLG"}
# Bytes at either end of a file that are searched for the camera's name.
_METADATA_BYTES = 4_000_000
# Decoders that drop damaged pictures in silence unless they are to report them. Others then drop
# more than is damaged.
_SILENT = ("hevc",)
# Returns a frame as (H, W, 3) uint8 BGR, or None if it is damaged. On any thread.
Decode = Callable[[], np.ndarray | None]
# Advice for a codec that cannot be decoded.
_CONVERT = "convert it: ffmpeg -i IN -c:v libx264 -crf 16 OUT.mp4"


def is_video(path: str | os.PathLike[str]) -> bool:
    """Returns whether a file is a video; of one that is not there, whether its name is."""
    return find_kind(path) == "video"


@register_reader("film", ".mp4", ".mov", ".avi", ".mkv", ".webm")
class Video:
    """Reads an open video.

    Args:
        path: the file.
        beside: file of the other lens of a 360-degree camera, or None; the file itself: its second
            stream.

    Attributes:
        width, height: of the upright frames in square pixels; frames of two lenses are side by
            side.
        stretch: width of the file's pixels to their height.
        interlaced: frames read so far whose even and odd lines were taken at two moments.
        frame_rate: mean number of frames per second.
        frame_count, duration: according to the file, in frames and seconds; 0 if it does not say.
        untimed: frames read so far whose time stamps do not rise; the frame rate times them.
        damaged: seconds of the frames read so far that are damaged, refer to damaged ones, or
            (`resized` of them) have another size than the first.

    Raises:
        InputError: no video, a missing index, or a codec that cannot be decoded.
    """

    def __init__(
        self, path: str | os.PathLike[str], beside: str | os.PathLike[str] | None = None
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(f"{path}: no such file; give a video or a folder of photographs")
        self._container = _open_video(self.path)
        stream = list_films(self._container)[0]
        self._frames = _decode_film(self._container, 0)
        self._other: Iterator[_Timed] | None = None
        if beside is not None:
            self._beside = _open_video(Path(beside))
            number = int(Path(beside) == self.path)
            self._other = _decode_film(self._beside, number)
        self.frame_rate = float(stream.guessed_rate or 0) or _USUAL_RATE
        self.duration = (self._container.duration or 0) / _DURATION_UNITS
        self.frame_count = stream.frames or round(self.duration * self.frame_rate)
        self.untimed = 0
        self.damaged: list[float] = []
        self.resized = 0
        self.interlaced = self._converted = self._woven = 0
        self.stretch = _find_stretch(stream)
        self._curve = _BRIGHT_CURVES.get(stream.codec_context.color_trc, "")
        self.width, self.height = _stretch_size(stream, self.stretch)
        self._shape: tuple[int, int, int] | None = None
        self._is_mirrored = False
        first = next(self._frames, None)
        if first is not None:
            self._frames = itertools.chain([first], self._frames)
            self._shape = _find_shape(first[1])
            self._is_mirrored = is_mirrored(first[1])
            self.width, self.height = _stretch_size(first[1], self.stretch)
        if self._other is not None:
            self.width *= 2  # whose frames are not turned
        elif first is not None and find_quarter_turns(first[1]) % 2:
            self.width, self.height = self.height, self.width

    def read_frames(self) -> Iterator[tuple[int, float, Decode]]:
        """Yields (number, seconds, decode) of every frame, once; seconds rise."""
        last = -1 / self.frame_rate
        for number, (seconds, frame, is_sound) in enumerate(self._frames):
            if not seconds > last:
                seconds = last + 1 / self.frame_rate
                self.untimed += 1
            last = seconds
            pair = [frame]
            if self._other is not None:
                beside = next(self._other, None)
                if beside is None:
                    return
                pair.append(beside[1])
                is_sound &= beside[2]
            self.interlaced += frame.interlaced_frame
            if is_sound and _find_shape(frame) != self._shape:
                self.resized, is_sound = self.resized + 1, False
            if not is_sound:
                self.damaged.append(seconds)
            yield number, seconds, functools.partial(self._convert, pair) if is_sound else _skip

    def _convert(self, frames: list[Any]) -> np.ndarray | None:
        pictures = [
            f.reformat(
                *_stretch_size(f, self.stretch), format="bgr24", interpolation="BICUBIC"
            ).to_ndarray()
            for f in frames
        ]
        if len(pictures) == 1:
            self._converted += 1
            self._woven += is_woven(pictures[0])
            return show_upright(pictures[0], find_quarter_turns(frames[0]), self._is_mirrored)
        return np.hstack(pictures) if pictures[0].shape == pictures[1].shape else None

    def list_notes(self, count: int) -> list[str]:
        """Lists what is wrong with the file and its `count` frames read, one sentence each."""
        name, notes = self.path.name, []
        films = count_films(self.path)
        if films > 1:
            notes.append(
                f"{name} is {films} films pasted together, of which the first is read; give each "
                "as a file of its own"
            )
        if self._curve:
            notes.append(
                f"{name} is an HDR film ({self._curve}), whose colours are kept as they are stored "
                "and look pale on a plain screen: film without HDR, or convert it with tone mapping"
            )
        if self.stretch != 1:
            notes.append(
                f"the pixels of {name} are {self.stretch:.4g} times as wide as high: its frames are"
                f" stretched to square ones ({self.width} x {self.height})"
            )
        woven = count if 2 * self._woven > self._converted else 0  # without the film saying so
        if self.interlaced or woven:
            notes.append(
                f"{self.interlaced or woven} of {count} frames of {name} are interlaced: every "
                "other line was taken at another moment, which blurs what moves; make whole frames "
                "of it: ffmpeg -i IN -vf bwdif -c:v libx264 -crf 16 OUT.mp4"
            )
        if self.untimed:
            notes.append(
                f"the time stamps of {self.untimed} frames of {name} do not rise: they are taken "
                f"to be {1 / self.frame_rate:.3g} s apart, as the frame rate says"
            )
        if self.resized:
            notes.append(
                f"{self.resized} of {count} frames of {name} have another size or turn than the "
                "first and are left out; cut the film there and make a scene of each part"
            )
        if len(self.damaged) > self.resized:
            notes.append(
                f"frames of {name} between {self.damaged[0]:.1f} and {self.damaged[-1]:.1f} s are "
                f"damaged and left out ({len(self.damaged) - self.resized} of {count}); copy the "
                "film from the camera again"
            )
        return notes

    def close(self) -> None:
        self._container.close()
        if self._other is not None:
            self._beside.close()

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _find_stretch(stream: Any) -> float:
    """Finds how many times as wide as high a stream's pixels are; 1 where it says nothing usual."""
    ratio = float(stream.sample_aspect_ratio or 1)
    return ratio if 1 / MOST_STRETCH < ratio < MOST_STRETCH else 1.0  # else the header is damaged


def _stretch_size(stored: Any, stretch: float) -> tuple[int, int]:
    """Returns width and height of a frame in square pixels; neither loses any."""
    return round(stored.width * max(stretch, 1)), round(stored.height / min(stretch, 1))


def _skip() -> None:
    """Returns no picture, in place of a damaged one."""


def read_stream_start(
    path: Path, stream: int, count: int
) -> tuple[np.ndarray, tuple[Any, ...]] | None:
    """Reads the first frames of a stream of a video, and what two lenses of one camera share.

    Returns:
        (N, H, W, 3) uint8, N at most `count`, with size, number and rate of the frames; None if
        there is no such stream, or no frame in it can be decoded.
    """
    import av

    try:
        container = open_container(path)
        if container is None:
            return None
        with container:
            streams = list_films(container)
            if stream >= len(streams):
                return None
            of = streams[stream]
            size = of.codec_context.width, of.codec_context.height
            about = size, of.frames, of.average_rate
            frames = itertools.islice(container.decode(of), count)
            pictures = [frame.to_ndarray(format="bgr24") for frame in frames]
    except (av.FFmpegError, OSError):
        return None  # reading the frames reports what is wrong with the file
    return (np.array(pictures), about) if pictures else None


_Timed = tuple[float, Any, bool]  # seconds, frame, and whether it is sound


def _decode_film(container: Any, number: int) -> Iterator[_Timed]:
    """Yields the frames of a film; `number` is that of its stream among those of video."""
    stream = list_films(container)[number]
    zero = stream.start_time or 0
    for frame, is_sound in _decode_stream(container, stream):
        yield float((_find_stamp(frame, -math.inf) - zero) * frame.time_base), frame, is_sound


def _decode_stream(container: Any, stream: Any) -> Iterator[tuple[Any, bool]]:
    """Yields the frames of a stream, and of each whether it is sound.

    After damage none is, up to the next frame that refers to no other: a key frame whose packet
    comes after the damage is known, which the decoder's threads delay.
    """
    import av

    stream.thread_type = "AUTO"
    if stream.codec_context.name in _SILENT:
        stream.codec_context.options = {"err_detect": "explode"}
    is_sound, sound_from = True, math.inf  # the time stamp of that key frame, once known
    with contextlib.suppress(av.FFmpegError, OSError):  # a file that ends within a packet
        for packet in container.demux(stream):
            if packet.is_keyframe and not is_sound:
                sound_from = min(sound_from, _find_stamp(packet, math.inf))
            try:
                frames = packet.decode()
            except av.FFmpegError:
                is_sound, sound_from = False, math.inf
                continue
            for frame in frames:
                if frame.is_corrupt:
                    is_sound, sound_from = False, math.inf
                is_sound = is_sound or _find_stamp(frame, 0) >= sound_from
                yield frame, is_sound


def _find_shape(frame: Any) -> tuple[int, int, int]:
    """Returns width, height and turn of a frame, which are those of all that can be used."""
    return frame.width, frame.height, find_quarter_turns(frame)


def _find_stamp(given: Any, absent: float) -> float:
    """Returns when a packet or a frame is shown, in the stream's unit of time."""
    stamp = given.dts if given.pts is None else given.pts
    return absent if stamp is None else stamp


def _open_video(path: Path) -> Any:
    container = open_container(path)
    if container is not None:
        return container
    if is_without_index(path):
        raise InputError(
            f"{path}: the video was cut off before its index (no 'moov') was written, so no "
            "frame of it can be found; copy it from the camera again, or let the camera repair it"
        )
    raise InputError(
        f"{path}: cannot be decoded as a video: it is damaged, or its codec is not known here; "
        + _CONVERT
    )


def open_container(path: Path) -> Any:
    """Opens a film; None if FFmpeg decodes no stream of video in it.

    Raises:
        InputError: its tables claim more than there can be.
        OSError: it is no file.
    """
    import av

    check_tables(check_regular(path))
    with contextlib.suppress(av.FFmpegError, OSError):
        # A name with a colon may be an address; one of an absolute path is none.
        container = av.open(str(path.absolute()), metadata_errors="replace")
        # A stream whose codec is not known has no width.
        if any(getattr(stream, "width", 0) > 0 for stream in list_films(container)[:1]):
            return container
        container.close()
    return None


def read_camera_name(path: Path) -> str:
    """Reads the camera's name for `find_lenses` from an MP4 or MOV; "" if it has none."""
    size = path.stat().st_size
    with open_binary(path) as file:  # the index stands at the beginning or at the end
        data = file.read(_METADATA_BYTES)
        if size > len(data):
            file.seek(max(len(data), size - _METADATA_BYTES))
            data += file.read()
    firmware = re.search(rb"FIRM(HD\d+|H\d\d)\.", data)
    if firmware:
        code = firmware[1].decode()
        return f"GoPro {_GOPRO.get(code, code.replace('HD', 'HERO'))}"
    apple = re.search(rb"(iPhone|iPad) ?[A-Za-z0-9 ]{0,16}", data)
    return f"Apple {apple[0].decode().strip()}" if apple else ""
