"""Benchmarks of captures: films' lenses, the time left, a command that is watched."""

import argparse
import json
import os

import pytest

import gsut
from gsut.cli.poses import pose_seconds
from gsut.sfm.options import PosesOptions
from tests.bench.frames_bench import _left_is_right
from tests.bench.photographs_bench import _usage, watched
from tests.bench.walk_bench import FILMS, _filmed, lens_difference

STAGES = ("features", "preview", "matching", "lens", "mapping", "shutter")


def test_films_of_the_database_are_read_in_the_order_of_their_sensor():
    assert FILMS["action camera"](8.0).readout == pytest.approx(0.0166)
    assert FILMS["read upwards"](8.0).readout < 0
    upright = FILMS["phone upright"](8.0)
    # The sensor's first row is the last column of the upright picture.
    assert upright.sideways and upright.readout < 0
    assert upright.camera.width < upright.camera.height


def test_film_of_another_size_has_the_same_lens():
    film = FILMS["dual fisheye"](8.0)
    asked = argparse.Namespace(scale=0.5, samples=2, frame_rate=5.0)
    small = _filmed(film, asked)
    assert (small.camera.width, small.back.width, len(small.times)) == (192, 192, 40)
    assert lens_difference(small.camera.resized(384, 384), film.camera) < 1e-9


@pytest.mark.parametrize(("slower", "right"), [(1.0, True), (4.0, False)])
def test_time_left_is_right_where_stages_take_what_is_expected(tmp_path, slower, right):
    taken = {"kind": "video", "size": [960, 520]}
    (tmp_path / "capture.json").write_text(json.dumps(taken))
    expected = pose_seconds(taken, "auto", False)
    told, now = [], 100.0
    for stage in STAGES:
        cores = 2 if stage in ("features", "preview", "matching") else 1
        # The last stage alone is slower than expected.
        seconds = expected[stage] * (slower if stage == STAGES[-1] else 1.0)
        for done in range(11):
            told.append((now + cores * seconds * done / 10, stage, 6 * done, 60))
        now += cores * seconds
    told.append((now, "end", 0, 0))
    share = _left_is_right(tmp_path, told, 100.0, PosesOptions()).mean()
    assert (share == 1.0) == right


def test_a_command_that_ends_early_is_named_with_its_stage(tmp_path):
    with pytest.raises(gsut.InputError, match=r"scene absent .*ended in photographs with 2"):
        watched(["scene", "absent", "-o", str(tmp_path / "run")], tmp_path / "run")
    assert _usage(2**30) is None
    seconds, peak_mb = _usage(os.getpid())
    assert seconds > 0 and peak_mb > 10
