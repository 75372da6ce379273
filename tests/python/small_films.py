"""Small MP4 files whose tracks of metadata are made here: GPMF and camm."""

import struct

import av
import numpy as np


def record(key, kind, size, count, data):
    """A GPMF record, filled up to four bytes."""
    return struct.pack(">4scBH", key, kind, size, count) + data + bytes(-len(data) % 4)


def make_gpmf(*streams):
    """A payload of one device; a stream is the records in it."""
    inner = b"".join(
        record(b"STRM", b"\0", 1, sum(map(len, records)), b"".join(records)) for records in streams
    )
    return record(b"DEVC", b"\0", 1, len(inner), inner)


def make_places(fix):
    """A second of a HERO's GPS: two places."""
    rows = struct.pack(">10i", 470000000, 85000000, 430000, 1, 2, 470000100, 85000000, 431000, 1, 2)
    return (
        record(b"GPSF", b"L", 4, 1, struct.pack(">I", fix)),
        record(b"SCAL", b"l", 4, 5, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100)),
        record(b"GPS5", b"l", 20, 2, rows),
    )


def make_forces(values, axes=None):
    """Accelerations (N, 3) in m/s^2 in the order of `axes`."""
    rows = b"".join(struct.pack(">3h", *(round(100 * value) for value in row)) for row in values)
    named = [] if axes is None else [record(b"ORIN", b"c", 1, 3, axes.encode())]
    return (
        *named,
        record(b"SCAL", b"s", 2, 1, struct.pack(">h", 100)),
        record(b"ACCL", b"s", 6, len(values), rows),
    )


def box(kind, *contents):
    data = b"".join(contents)
    return struct.pack(">I4s", 8 + len(data), kind) + data


def make_film(path, form, payloads, rotation=0, seconds=1.0):
    """An MP4 with a grey frame and a track of metadata with one sample a payload."""
    with av.open(str(path), "w", format="mp4") as film:
        stream = film.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 16, 16, "yuv420p"
        stream.set_display_rotation(-rotation)
        grey = av.VideoFrame.from_ndarray(np.full((16, 16, 3), 128, np.uint8), format="rgb24")
        for packet in (*stream.encode(grey), *stream.encode()):
            film.mux(packet)
    data = path.read_bytes()
    index = data.index(b"moov") - 4
    frames, moov = data[:index], data[index + 8 :]  # the index ends the file
    starts = [len(frames) + 8 + sum(map(len, payloads[:i])) for i in range(len(payloads))]
    sizes = [len(payload) for payload in payloads]
    tables = box(
        b"stbl",
        box(b"stsd", bytes(4), struct.pack(">I", 1), box(form, bytes(6), struct.pack(">H", 1))),
        box(b"stts", bytes(4), struct.pack(">3I", 1, len(sizes), round(1000 * seconds))),
        box(b"stsc", bytes(4), struct.pack(">4I", 1, 1, 1, 1)),
        box(b"stsz", bytes(4), struct.pack(f">2I{len(sizes)}I", 0, len(sizes), *sizes)),
        box(b"stco", bytes(4), struct.pack(f">I{len(starts)}I", len(starts), *starts)),
    )
    matrix = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    header = box(b"tkhd", bytes(12), struct.pack(">I", 2), bytes(24), matrix, bytes(8))
    mdhd = box(b"mdhd", bytes(12), struct.pack(">I", 1000), bytes(8))
    hdlr = box(b"hdlr", bytes(8), b"meta", bytes(13))
    track = box(b"trak", header, box(b"mdia", mdhd, hdlr, box(b"minf", tables)))
    path.write_bytes(frames + box(b"mdat", *payloads) + box(b"moov", moov, track))
    return path
