"""Small videos with known motion, and files whose boxes are changed by hand."""

import functools
import struct
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

WIDTH, HEIGHT = 320, 240


@functools.cache
def texture(size: int = 1400) -> np.ndarray:
    """A picture with corners everywhere, to look at a part of."""
    rng = np.random.default_rng(5)
    small = rng.integers(0, 255, (size // 8, size // 8, 3), np.uint8)
    ground = cv2.resize(small, (size, size), interpolation=cv2.INTER_CUBIC)
    ground.setflags(write=False)
    return ground


def view(ground: np.ndarray, x: float, y: float = 100.0, blur: float = 0.0) -> np.ndarray:
    """The part of the ground at (x, y), blurred by so many pixels."""
    move = np.float32([[1, 0, -x], [0, 1, -y]])
    seen = cv2.warpAffine(ground, move, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)
    return cv2.GaussianBlur(seen, (0, 0), blur) if blur else seen


def write_video(path: Path, pictures, rate: float = 30.0) -> Path:
    """An MPEG-4 video of these pictures."""
    pictures = list(pictures)
    height, width = pictures[0].shape[:2]
    code = cv2.VideoWriter_fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), code, rate, (width, height))
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


def walk_past(path: Path, frames: int = 24) -> Path:
    """A video with depth: strips of the ground at three distances, which move by 2, 4, 6 pixels."""
    ground = texture()

    def picture(i: int) -> np.ndarray:
        layers = [view(ground, 300.0 * k + step * i) for k, step in enumerate((2.0, 4.0, 6.0))]
        rows = np.arange(HEIGHT)[:, None, None] // 20 % 3
        return np.choose(rows, layers)

    return write_video(path, map(picture, range(frames)))


def walk(path: Path, frames: int = 60, step: float = 3.0) -> Path:
    """A video that moves sideways by `step` pixels a frame."""
    ground = texture()
    return write_video(path, (view(ground, 50 + step * i) for i in range(frames)))


def turn_by_quarter(path: Path, height: int = HEIGHT, turns: int = 1) -> None:
    """Sets the rotation flag of the video track, as a phone held upright does: clockwise."""
    data = bytearray(path.read_bytes())
    at = data.find(b"tkhd") + 4 + 40  # version and flags, 36 bytes of times and layers, the matrix
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[turns]
    data[at : at + 36] = struct.pack(
        ">9i", cos << 16, sin << 16, 0, -sin << 16, cos << 16, 0, height << 16, 0, 1 << 30
    )
    path.write_bytes(data)


def stretch_second_half(path: Path) -> None:
    """Doubles the time between frames from the middle on: a variable frame rate."""
    data = bytearray(path.read_bytes())
    at = data.find(b"stts")
    flags, entries, count, delta = struct.unpack(">4I", data[at + 4 : at + 20])
    assert entries == 1
    old = struct.pack(">I4s4I", 24, b"stts", flags, 1, count, delta)
    half = count // 2
    new = struct.pack(">I4s6I", 32, b"stts", flags, 2, half, delta, count - half, 2 * delta)
    where = data.find(old)
    data[where : where + len(old)] = new
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):  # each holds the box that grew
        start = data.find(box) - 4
        size = struct.unpack(">I", data[start : start + 4])[0]
        data[start : start + 4] = struct.pack(">I", size + len(new) - len(old))
    path.write_bytes(data)


def write_stamps(path: Path, source: Path, stamp: Callable[[int], int]) -> Path:
    """Copies a video with other time stamps, a function of the frame's number; `path` is .mkv."""
    with av.open(str(source)) as old, av.open(str(path), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        for number, packet in enumerate(old.demux(old.streams.video[0])):
            if packet.dts is not None:
                packet.pts = packet.dts = stamp(number)
                packet.stream = stream
                new.mux(packet)
    return path


def coded_otherwise(path: Path) -> Path:
    """Says that frames are in a code that nobody knows."""
    path.write_bytes(path.read_bytes().replace(b"mp4v", b"zzzz").replace(b"esds", b"zzzz"))
    return path


def frames_of_noise(path: Path) -> Path:
    """Frames that are nothing, under an index that is whole."""
    data = bytearray(path.read_bytes())
    start, end = data.find(b"mdat") + 4, data.find(b"moov") - 4
    data[start:end] = np.random.default_rng(0).integers(0, 256, end - start, np.uint8).tobytes()
    path.write_bytes(data)
    return path


def damage_packets(path: Path, source: Path, numbers: Sequence[int]) -> Path:
    """Copies a video with noise in the middle of some packets."""
    with av.open(str(source)) as film:
        packets = [p for p in film.demux(film.streams.video[0]) if p.size]
        places = [(packets[n].pos, packets[n].size // 3) for n in numbers]
    data, rng = bytearray(source.read_bytes()), np.random.default_rng(0)
    for start, third in places:
        data[start + third : start + 2 * third] = rng.bytes(third)
    path.write_bytes(data)
    return path


def encode_film(
    path: Path, codec: str, pictures: Iterable[np.ndarray], keys: int = 12, flags: str = "",
    ratio: Fraction = Fraction(1), curve: int = 2,
) -> Path:  # fmt: skip
    """A film of these pictures, with a key frame at each `keys`-th.

    `flags` are the encoder's; `ratio` is the width of a pixel to its height; `curve` is the number
    of its transfer characteristics.
    """
    with av.open(str(path), "w") as film:
        options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
        options |= {"flags": flags} if flags else {}
        stream = film.add_stream(codec, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.gop_size = keys
        stream.codec_context.sample_aspect_ratio = ratio
        stream.codec_context.color_trc = curve
        frames = (av.VideoFrame.from_ndarray(picture, "bgr24") for picture in pictures)
        for frame in (*frames, None):
            film.mux(stream.encode(frame))
    return path
