"""Writes films that every browser and phone plays: H.264, VP9 or GIF, by the name's suffix."""

from __future__ import annotations

import fractions
import itertools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import check_number, name_wrong_kinds
from gsut.files import whole_file

# Codec and its settings for each container. crf 18 and 30: what both codecs' makers call visually
# near to lossless; faststart: a browser shows the first frames before it has the last.
_CODECS: dict[str, tuple[str, dict[str, str]]] = {
    ".mp4": ("libx264", {"crf": "18", "preset": "medium"}),
    ".webm": ("libvpx-vp9", {"crf": "30", "b:v": "0", "row-mt": "1", "deadline": "good",
                             "cpu-used": "4"}),
}  # fmt: skip
_GIF = ".gif"
# Frames a second, from a slide show to the fastest cameras.
_RATES = 1e-3, 1e4
FILM_SUFFIXES = (*_CODECS, _GIF)
_MOST_GIF_RATE = 50.0  # browsers play faster ones slowly
# Colours as high-definition players take them, by FFmpeg's numbers.
_BT709 = 1
_LIMITED_RANGE = 1


def is_film(path: Path) -> bool:
    """Returns whether this is the name of a film.

    Raises:
        InputError: its suffix is that of neither a film nor a folder.
    """
    suffix = path.suffix.lower()
    if suffix in FILM_SUFFIXES:
        return True
    if suffix and not path.is_dir():
        raise InputError(
            f"{path}: {suffix} is no film that can be written; give {', '.join(FILM_SUFFIXES)}, or "
            "a folder (without a suffix) for images"
        )
    return False


@name_wrong_kinds
def write_video(path: Path, frames: Iterable[np.ndarray], frames_per_second: float) -> int:
    """Writes a film: .mp4 (H.264), .webm (VP9) or .gif.

    Args:
        path: the file; replaced where it exists.
        frames: (H, W, 3) uint8 red, green, blue, all of one size; at least one. Odd sizes lose
            their last row or column, which the codecs cannot hold.
        frames_per_second: of the film; at most 50 of a GIF.

    Returns:
        The number of frames written.

    Raises:
        InputError: another suffix, no frame, frames of several sizes, or the file cannot be
            written.
    """
    path = Path(path)
    if not is_film(path):
        raise InputError(f"{path}: a film's name ends in {', '.join(FILM_SUFFIXES)}")
    frames_per_second = check_number(frames_per_second, "frames_per_second", *_RATES)
    suffix = path.suffix.lower()
    if suffix == _GIF and frames_per_second > _MOST_GIF_RATE:
        raise InputError(f"a GIF has at most {_MOST_GIF_RATE:.0f} frames a second")
    counted = _Counted(frames, path)
    write: Callable[..., None] = _write_gif if suffix == _GIF else _encode
    with whole_file(path) as temporary:
        write(temporary, counted, frames_per_second)
    return counted.count


class _Counted:
    """The frames, of one even size, and how many there were."""

    def __init__(self, frames: Iterable[np.ndarray], path: Path) -> None:
        self._frames, self.count = iter(frames), 0
        first = next(self._frames, None)
        if first is None:
            raise InputError(f"{path}: a film needs at least one frame")
        self._first = first
        self._shape = first.shape
        self.height, self.width = (max(2, side - side % 2) for side in first.shape[:2])

    def __iter__(self) -> Iterator[np.ndarray]:
        for frame in itertools.chain([self._first], self._frames):
            if frame.shape != self._shape:
                raise InputError(
                    f"the frames of a film must have one size, found {self._shape[1]} x "
                    f"{self._shape[0]} and {frame.shape[1]} x {frame.shape[0]}"
                )
            self.count += 1
            yield np.ascontiguousarray(frame[: self.height, : self.width])


def _encode(path: Path, frames: _Counted, frames_per_second: float) -> None:
    import av

    codec, options = _CODECS[path.suffix.lower()]
    container_options = {"movflags": "faststart"} if path.suffix.lower() == ".mp4" else {}
    with av.open(str(path), "w", options=container_options) as container:
        rate = fractions.Fraction(frames_per_second).limit_denominator(1001)
        stream: Any = container.add_stream(codec, rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = frames.width, frames.height, "yuv420p"
        context = stream.codec_context
        context.color_range, context.colorspace = _LIMITED_RANGE, _BT709
        context.color_primaries = context.color_trc = _BT709
        for pixels in frames:
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            container.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
        container.mux(stream.encode())


def _write_gif(path: Path, frames: _Counted, frames_per_second: float) -> None:
    """Writes a GIF in which each frame has a palette of its own, dithered."""
    import av

    with av.open(str(path), "w") as container:
        rate = fractions.Fraction(frames_per_second).limit_denominator(1001)
        stream: Any = container.add_stream("gif", rate=rate)
        stream.width, stream.height, stream.pix_fmt = frames.width, frames.height, "pal8"
        graph = av.filter.Graph()
        size: dict[str, Any] = {"width": frames.width, "height": frames.height}
        source = graph.add_buffer(**size, format=av.VideoFormat("rgb24"), time_base=1 / rate)
        split, palette, mapped, sink = (
            graph.add("split"), graph.add("palettegen", "stats_mode=single"),
            graph.add("paletteuse", "new=1"), graph.add("buffersink"),
        )  # fmt: skip
        source.link_to(split)
        split.link_to(mapped, 0, 0)
        split.link_to(palette, 1, 0)
        palette.link_to(mapped, 0, 1)
        mapped.link_to(sink)
        graph.configure()
        for number, pixels in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = number, 1 / rate
            graph.push(frame)
            _drain(graph, stream, container)
        graph.push(None)
        _drain(graph, stream, container)
        container.mux(stream.encode())


def _drain(graph: Any, stream: Any, container: Any) -> None:
    """Encodes the frames that have come through."""
    import av

    while True:
        try:
            container.mux(stream.encode(graph.pull()))
        except (av.error.BlockingIOError, av.error.EOFError):
            return
