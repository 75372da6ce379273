"""Small MP4 files whose tracks of metadata are made here: GPMF and camm."""

import struct


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
    """An MP4 with an empty film and a track of metadata with one sample a payload."""
    a, b = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[rotation]
    matrix = struct.pack(">9i", a << 16, b << 16, 0, -b << 16, a << 16, 0, 0, 0, 1 << 30)
    header = box(b"tkhd", bytes(40), matrix, bytes(8))
    ftyp = box(b"ftyp", b"isom", bytes(4))
    starts = [len(ftyp) + 8 + sum(map(len, payloads[:i])) for i in range(len(payloads))]

    def track(kind, name, offsets, sizes):
        tables = box(
            b"stbl",
            box(b"stsd", bytes(4), struct.pack(">I", 1), box(name, bytes(8))),
            box(b"stts", bytes(4), struct.pack(">3I", 1, len(sizes), round(1000 * seconds))),
            box(b"stsc", bytes(4), struct.pack(">4I", 1, 1, 1, 1)),
            box(b"stsz", bytes(4), struct.pack(f">2I{len(sizes)}I", 0, len(sizes), *sizes)),
            box(b"stco", bytes(4), struct.pack(f">I{len(offsets)}I", len(offsets), *offsets)),
        )
        mdhd = box(b"mdhd", bytes(12), struct.pack(">I", 1000), bytes(8))
        hdlr = box(b"hdlr", bytes(8), kind, bytes(12))
        return box(b"trak", header, box(b"mdia", mdhd, hdlr, box(b"minf", tables)))

    moov = box(
        b"moov",
        track(b"vide", b"avc1", [], []),
        track(b"meta", form, starts, [len(payload) for payload in payloads]),
    )
    path.write_bytes(ftyp + box(b"mdat", *payloads) + moov)
    return path
