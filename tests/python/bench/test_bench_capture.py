"""Benchmarks of captures: films' lenses, the time left, a command that is watched."""

import argparse
import json
import os

import numpy as np
import pytest

import gsut
from gsut.demo import make_demo_scene
from tests.bench.__main__ import main as bench_main
from tests.bench.photographs_bench import _usage, watched
from tests.bench.time_left import right_percent
from tests.bench.walk_bench import FILMS, _filmed, lens_difference


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


def test_time_left_is_right_where_what_is_shown_falls_with_the_time():
    honest = [(t, 100.0 - t) for t in np.arange(100.0, step=2.0)]
    assert right_percent([*honest, (100.0, 0.0)]) == 100
    late = [(t, left if t < 60 else 2 * left) for t, left in honest]
    # From 60 to the end of the 10 to 100 seconds.
    assert right_percent([*late, (100.0, 0.0)]) == pytest.approx(100 * (1 - 40 / 90), abs=0.5)
    assert right_percent([(0.0, 1.0), (3.0, 0.0)]) == 100  # over before the first seconds are


def test_bench_time_left_watches_a_command(tmp_path, capsys):
    make_demo_scene(tmp_path / "hall", 5, 1, 48, progress=False)
    words = [
        "time_left",
        "train",
        str(tmp_path / "hall"),
        "--words",
        "--steps 6 --max-gaussians 50",
    ]
    assert bench_main([*words, "--json", str(tmp_path / "rows.json")]) == 0
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    lefts = [left for _, left in row["shown"]]
    assert len(lefts) == 8 and lefts[-1] == 0 and min(lefts[1:-1]) > 0
    assert "right [%]" in capsys.readouterr().out


def test_a_command_that_ends_early_is_named_with_its_stage(tmp_path):
    with pytest.raises(gsut.InputError, match=r"scene absent .*ended in photographs with 2"):
        watched(["scene", "absent", "-o", str(tmp_path / "run")], tmp_path / "run")
    assert _usage(2**30) is None
    seconds, peak_mb = _usage(os.getpid())
    assert seconds > 0 and peak_mb > 10
