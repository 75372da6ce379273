"""What cameras record of their turns: GPMF, camm and Gyroflow's log, whole, odd and damaged."""

import struct

import numpy as np
import pytest

import tolerances
from gsut.capture.facts import TurnRecord
from gsut.capture.track import read_film_facts
from gsut.capture.turns import read_gcsv, write_turns
from gsut.files import FileError
from gsut.sfm.photographs.moments import read_turns
from small_films import make_film, make_gpmf, record

LOG = """GYROFLOW IMU LOG
version,1.3
orientation,xYz
tscale,0.001
gscale,0.1
t,gx,gy,gz
"""


def make_rates(values, key=b"GYRO", stamp=None, scale=1000):
    """A stream of rows (N, M) of numbers."""
    rows = np.array(values, float)
    data = np.rint(scale * rows).astype(">i2").tobytes()
    clock = [] if stamp is None else [record(b"STMP", b"J", 8, 1, struct.pack(">Q", stamp))]
    return (
        *clock,
        record(b"SCAL", b"s", 2, 1, struct.pack(">h", scale)),
        record(key, b"s", 2 * rows.shape[1], len(rows), data),
    )


def make_axes(given, shown, matrix):
    """Records of GPMF that name the axes of a sensor's numbers, and of these once turned."""
    return (
        record(b"ORIN", b"c", 1, 3, given.encode()),
        record(b"ORIO", b"c", 1, 3, shown.encode()),
        record(b"MTRX", b"f", 36, 1, np.array(matrix, ">f4").tobytes()),
    )


def read_turned(path):
    return {record.source: record.rates for record in read_film_facts(path).turns}


def test_gyroscope_of_gpmf_is_in_the_cameras_axes(tmp_path):
    payload = make_gpmf(make_rates([[0.1, 0.2, 0.3]] * 20))  # about up, left and backward
    rates = read_turned(make_film(tmp_path / "a.mp4", b"gpmd", [payload] * 2))["gyroscope"]
    assert np.allclose(rates[:, 0], np.arange(40) / 20)
    assert np.allclose(rates[:, 1:], [-0.2, -0.1, -0.3])


@pytest.mark.parametrize(
    ("matrix", "found"),
    [
        ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [-0.1, 0.2, -0.3]),  # as a GoPro MAX has it
        ([[0, -0.8, 0.6], [1, 0, 0], [0, 0.6, 0.8]], [-0.1, -0.02, -0.36]),  # and tilted
        ([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [-0.1, 0.2, -0.3]),  # no turn: ORIN
        ([[np.nan] * 3] * 3, [-0.1, 0.2, -0.3]),
    ],
)
def test_gyroscope_with_a_matrix_is_in_the_axes_it_leads_to(matrix, found, tmp_path):
    axes = make_axes("XzY", "ZXY", matrix)
    payload = make_gpmf((*axes, *make_rates([[0.1, 0.2, 0.3]] * 20)))
    rates = read_turned(make_film(tmp_path / "a.mp4", b"gpmd", [payload]))["gyroscope"]
    assert np.allclose(rates[:, 1:], found, atol=tolerances.TURNS_AXES)


def test_gyroscope_follows_the_rotation_of_the_frames_shown(tmp_path):
    payload = make_gpmf(make_rates([[0.1, 0.2, 0.3]] * 20))
    rates = read_turned(make_film(tmp_path / "a.mp4", b"gpmd", [payload], 90))["gyroscope"]
    assert np.allclose(rates[:, 1:], [0.1, -0.2, -0.3])


def test_gyroscope_with_stamps_follows_the_cameras_clock(tmp_path):
    payloads = [
        make_gpmf(make_rates([[0, 0, 0.1]] * 20, stamp=70_000 + 1_010_000 * i)) for i in range(3)
    ]
    rates = read_turned(make_film(tmp_path / "a.mp4", b"gpmd", payloads))["gyroscope"]
    assert np.allclose(np.diff(rates[:, 0]), 1.01 / 20)
    assert abs(rates[20, 0] - 1.0) < tolerances.TURNS_CLOCK_SECONDS


def test_orientations_become_the_rates_of_the_picture(tmp_path):
    # The camera turns about y, 0.02 a frame; the picture undoes half of that.
    angles = 0.02 * np.arange(30)
    camera, picture = (
        np.stack([np.cos(a / 2), 0 * a, np.sin(a / 2), 0 * a], axis=1)
        for a in (-angles, angles / 2)
    )
    payload = make_gpmf(
        make_rates(camera, b"CORI", scale=32767), make_rates(picture, b"IORI", scale=32767)
    )
    found = read_turned(make_film(tmp_path / "a.mp4", b"gpmd", [payload]))
    assert list(found) == ["orientations"]
    rates = found["orientations"]
    assert np.abs(rates[:-1, 1:] - [0, 0.01 * 30, 0]).max() < tolerances.TURNS_OF_ORIENTATIONS


def test_gyroscope_of_camm_is_read(tmp_path):
    packets = [struct.pack("<HH3f", 0, 2, 0.1, 0.2, i) for i in range(20)]
    film = make_film(tmp_path / "a.mp4", b"camm", packets, seconds=0.01)
    rates = read_turned(film)["gyroscope"]
    assert np.allclose(rates[:-1, 1:], [[0.1, 0.2, i + 0.5] for i in range(19)])


def test_accelerometer_of_camm_is_in_the_gyroscopes_axes(tmp_path):
    packets = [struct.pack("<HH3f", 0, 2 + i % 2, 0.1, 9.8 * (i % 2), 0) for i in range(40)]
    film = make_film(tmp_path / "a.mp4", b"camm", packets, seconds=0.01)
    facts = read_film_facts(film)
    assert facts.is_askew and len(facts.turns) == 1
    assert np.allclose(facts.forces[:, 1:], [0.1, 9.8, 0])
    film.with_suffix(".gcsv").write_text(LOG + "1,2,3,4\n")
    assert not read_film_facts(film).is_askew


def test_absurd_values_and_gaps_are_left_out_with_a_note(tmp_path):
    packets = [struct.pack("<HH3f", 0, 2, 0.1, 0.2, 1e9 if i == 7 else 0) for i in range(40)]
    film = make_film(tmp_path / "a.mp4", b"camm", packets, seconds=0.08)
    facts = read_film_facts(film)
    (found,) = facts.turns
    assert len(found.rates) == 39 and np.isfinite(found.rates[:, 0]).all()
    unknown = np.isnan(found.rates[:, 1:]).any(axis=1)
    assert np.flatnonzero(unknown).tolist() == [6]  # the next row follows late
    assert "1 of 40 values of the gyroscope are left out" in " ".join(facts.notes)


def test_log_of_gyroflow_stands_for_the_films_own_gyroscope(tmp_path):
    film = make_film(tmp_path / "a.mp4", b"camm", [b"\0"])
    rows = [f"{10 * i},1,2,{i}" for i in range(20)]
    film.with_suffix(".gcsv").write_text(LOG + "\n".join(rows))
    rates = read_turned(film)["gyroscope"]
    assert np.allclose(rates[:, 0], np.arange(20) / 100)
    assert np.allclose(rates[:-1, 1:], [[-0.1, 0.2, -0.1 * (i + 0.5)] for i in range(19)])


@pytest.mark.parametrize(
    "text", ["", "t,gx,gy,gz\n1,2,3,4\n", LOG, LOG.replace("xYz", "XXX") + "1,2,3,4\n"]
)
def test_damaged_log_is_left_out_with_a_note(tmp_path, text):
    film = make_film(tmp_path / "a.mp4", b"camm", [b"\0"])
    log = film.with_suffix(".gcsv")
    log.write_text(text)
    with pytest.raises(FileError, match=r"a\.gcsv"):
        read_gcsv(log)
    facts = read_film_facts(film)
    assert facts.turns == () and "this log is left out" in facts.notes[0]


def test_turns_beside_a_capture_are_read_as_they_were_written(tmp_path):
    rates = np.column_stack([np.arange(20) / 100, np.ones((20, 3))])
    rates[3, 1:] = np.nan
    captured = {"turns": write_turns(tmp_path, [TurnRecord("gyroscope", rates)])}
    (row,) = captured["turns"]["records"]
    assert row["rows"] == 20 and abs(row["hertz"] - 100) < tolerances.TURNS_CLOCK_SECONDS
    found = read_turns(tmp_path, captured)
    assert np.array_equal(found["gyroscope"], rates, equal_nan=True)
    assert read_turns(tmp_path, {}) == {}
