"""Benchmarks of captures: films' lenses, a command that is watched."""

import argparse
import os

import pytest

import gsut
from tests.bench.photographs_bench import _usage, watched
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


def test_a_command_that_ends_early_is_named_with_its_stage(tmp_path):
    with pytest.raises(gsut.InputError, match=r"scene absent .*ended in photographs with 2"):
        watched(["scene", "absent", "-o", str(tmp_path / "run")], tmp_path / "run")
    assert _usage(2**30) is None
    seconds, peak_mb = _usage(os.getpid())
    assert seconds > 0 and peak_mb > 10
