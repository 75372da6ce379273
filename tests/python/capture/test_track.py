"""Where a video's camera was, by what its file or the subtitles beside it say."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from gsut.capture.track import _read_positions, interpolate_places, read_track

_BESIDE = Path(__file__).resolve().parents[4] / "shared"
KARMA = Path(os.environ.get("GSUT_SHARED", _BESIDE)) / "data/karma/karma.mp4"
CUE = """{number}
00:00:{number:02d},500 --> 00:00:{number:02d},533
[iso: 100] [latitude: 47.{number}] [longitude: 8.5] [rel_alt: 12.300 abs_alt: 412.100]

"""


def record(key, kind, size, count, data):
    """Of GPMF, filled up to four bytes."""
    padded = data + bytes(-len(data) % 4)
    return struct.pack(">4scBH", key, kind, size, count) + padded


def payload(fix):
    """A second of a HERO's GPS: two places."""
    rows = struct.pack(">10i", 470000000, 85000000, 430000, 1, 2, 470000100, 85000000, 431000, 1, 2)
    stream = b"".join([
        record(b"GPSF", b"L", 4, 1, struct.pack(">I", fix)),
        record(b"SCAL", b"l", 4, 5, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100)),
        record(b"GPS5", b"l", 20, 2, rows),
    ])  # fmt: skip
    inner = record(b"STRM", b"\0", 1, len(stream), stream)
    return record(b"DEVC", b"\0", 1, len(inner), inner)


def test_positions_of_a_gopro_are_scaled_and_need_a_fix():
    ((name, rows),) = _read_positions(payload(3))
    assert name == "GPS5" and np.allclose(rows, [[47, 8.5, 430], [47.00001, 8.5, 431]])
    assert list(_read_positions(payload(0))) == []
    assert list(_read_positions(payload(3)[:40])) == []  # cut off


def test_subtitles_of_a_drone_give_its_track(tmp_path):
    (tmp_path / "DJI_1.SRT").write_text("".join(CUE.format(number=i) for i in range(1, 5)))
    track = read_track(tmp_path / "DJI_1.MP4")
    assert np.allclose(track[:, 0], [1.5, 2.5, 3.5, 4.5])
    found = interpolate_places(track, np.array([1.0, 2.0, 4.5]))
    assert found[0] is None and found[1] == pytest.approx((47.15, 8.5, 412.1))
    assert interpolate_places(track[:1], np.array([1.0])) == [None]


def test_video_without_positions_has_no_track(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"no film")
    assert read_track(tmp_path / "film.mp4").shape == (0, 4)


def test_track_of_a_real_flight():
    if not KARMA.is_file():
        pytest.skip("shared data is absent")
    track = read_track(KARMA)
    assert len(track) == 47 and 11 < track[-1, 0] < 12.1
    assert np.ptp(track[:, 3]) < 2 and abs(track[0, 1] - 33.125) < 0.001
