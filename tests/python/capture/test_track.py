"""What a camera wrote about a film: places, what its accelerometer felt, and its rotation."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from gsut.capture.telemetry import read_gpmf
from gsut.capture.track import average_ups, interpolate_places, read_film_facts
from small_films import make_film, make_forces, make_gpmf, make_places

_BESIDE = Path(__file__).resolve().parents[4] / "shared"
KARMA = Path(os.environ.get("GSUT_SHARED", _BESIDE)) / "data/karma/karma.mp4"
CUE = """{number}
00:00:{number:02d},500 --> 00:00:{number:02d},533
[iso: 100] [latitude: 47.{number}] [longitude: 8.5] [rel_alt: 12.300 abs_alt: 412.100]

"""


def test_positions_of_a_gopro_are_scaled_and_need_a_fix():
    payload = make_gpmf(make_places(3))
    ((name, rows),) = read_gpmf(payload)
    assert name == "GPS5"
    assert np.allclose(rows[:, :3], [[47, 8.5, 430], [47.00001, 8.5, 431]])
    assert list(read_gpmf(make_gpmf(make_places(0)))) == []
    assert list(read_gpmf(payload[:40])) == []  # cut off


def test_film_facts_of_gpmf_are_timed_by_the_track(tmp_path):
    payload = make_gpmf(make_places(3), make_forces([[9.8, 0, 0]] * 4))
    facts = read_film_facts(make_film(tmp_path / "a.mp4", b"gpmd", [payload] * 3, seconds=2.0))
    assert np.allclose(facts.track[:, 0], [0, 1, 2, 3, 4, 5])
    assert np.allclose(facts.forces[:, 0], np.arange(12) / 2)
    assert np.allclose(facts.forces[:, 1:], [0, -9.8, 0])  # held level, up is -y


@pytest.mark.parametrize(
    ("axes", "values", "felt"),
    [
        (None, (9, 2, 3), (-2, -9, -3)),  # up, left, backward
        ("ZXY", (9, 2, 3), (-2, -9, -3)),
        ("YxZ", (3, -2, 9), (-2, -9, -3)),
        ("zxY", (-9, -2, 3), (-2, -9, -3)),
    ],
)
def test_axes_of_the_accelerometer_become_the_cameras(axes, values, felt):
    ((name, rows),) = read_gpmf(make_gpmf(make_forces([values], axes)))
    assert name == "ACCL" and np.allclose(rows, [felt])


@pytest.mark.parametrize(
    ("rotation", "up"), [(0, (0, -1, 0)), (90, (1, 0, 0)), (180, (0, 1, 0)), (270, (-1, 0, 0))]
)
def test_up_follows_the_rotation_of_the_frames_shown(tmp_path, rotation, up):
    payload = make_gpmf(make_forces([[9.8, 0, 0]] * 10))
    facts = read_film_facts(make_film(tmp_path / "a.mp4", b"gpmd", [payload], rotation))
    assert facts.rotation == rotation
    assert np.allclose(average_ups(facts.forces, np.array([0.5]))[0], up)


def test_up_is_absent_where_nothing_was_measured():
    forces = np.array([[0.0, 0, -9.8, 0], [1.0, 0, 0, 0]])
    found = average_ups(forces, np.array([0.0, 1.0, 9.0]), 0.5)
    assert found == [(0, -1, 0), None, None]


def test_places_of_camm_need_a_fix(tmp_path):
    packets = [
        struct.pack("<HH3d", 0, 5, 47.0, 8.5, 400.0),
        struct.pack("<HHdIddf", 0, 6, 1e9, 3, 47.1, 8.6, 410.0),
        struct.pack("<HHdIddf", 0, 6, 1e9, 0, 1.0, 2.0, 3.0),
        struct.pack("<HH3f", 0, 2, 1.0, 2.0, 3.0),
        b"\0",
    ]
    facts = read_film_facts(make_film(tmp_path / "a.mp4", b"camm", packets))
    assert np.allclose(facts.track, [[0, 47, 8.5, 400], [1, 47.1, 8.6, 410]])


def test_subtitles_of_a_drone_give_its_track(tmp_path):
    (tmp_path / "DJI_1.SRT").write_text("".join(CUE.format(number=i) for i in range(1, 5)))
    (tmp_path / "DJI_1.MP4").write_bytes(b"no film")
    track = read_film_facts(tmp_path / "DJI_1.MP4").track
    assert np.allclose(track[:, 0], [1.5, 2.5, 3.5, 4.5])
    found = interpolate_places(track, np.array([1.0, 2.0, 4.5]))
    assert found[0] is None and found[1] == pytest.approx((47.15, 8.5, 412.1))
    assert interpolate_places(track[:1], np.array([1.0])) == [None]


def test_video_without_metadata_has_no_facts(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"no film")
    facts = read_film_facts(tmp_path / "film.mp4")
    assert facts.track.shape == facts.forces.shape == (0, 4)
    assert (facts.camera, facts.rotation) == ("", 0)


def test_facts_of_a_real_flight():
    if not KARMA.is_file():
        pytest.skip("shared data is absent")
    facts = read_film_facts(KARMA)
    track = facts.track
    assert len(track) == 47 and 11 < track[-1, 0] < 12.1
    assert np.ptp(track[:, 3]) < 2 and abs(track[0, 1] - 33.125) < 0.001
    assert len(facts.forces) == 2397
    x, y, z = facts.forces[:, 1:].mean(axis=0)  # a drone on average hovers
    assert abs(y + 9.8) < 0.3 and abs(x) < 1 and abs(z) < 3
