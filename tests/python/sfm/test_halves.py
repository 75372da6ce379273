"""Poses adjusted with either half of the points: how far they differ, and what that tells."""

import dataclasses
import math

import numpy as np
import pytest

import tolerances
from gsut import _core
from gsut.sfm.starts.halves import compare_halves, measure_differences, split_matches
from made_flight import CENTERS, fly_again


@pytest.fixture(scope="module")
def flight():
    return fly_again(36, relief=0.3, turn=0.3)


def keep_points(flight, count):
    """The flight with the matches of so many points of each pair only."""
    pairs = [dataclasses.replace(p, matches=p.matches[:count]) for p in flight.pairs]
    return dataclasses.replace(flight, pairs=pairs, found=type(flight.found)())


def test_halves_share_no_point_and_lose_no_match(flight):
    halves = split_matches(flight)
    assert [len(half) for half in halves] == [len(flight.pairs)] * 2
    for pair, one, other in zip(flight.pairs, *halves, strict=True):
        rows = {tuple(row) for half in (one, other) for row in half.matches}
        assert len(one.matches) + len(other.matches) == min(len(pair.matches), 150) == len(rows)
    seen = [{(p.first, f) for p in half for f in p.matches[:, 0]} for half in halves]
    assert seen[0] and seen[1] and not seen[0] & seen[1]


def test_difference_of_halves_is_about_the_error_of_the_poses(flight):
    flight = compare_halves(flight)
    tenth, most = flight.found.halves_px
    assert 0 < most < tenth
    truth = []
    for i, center in enumerate(CENTERS):
        pose = _core.exp_pose([0, 0, 0, 0, 0.3 * (i % 3), 0.3 * i])
        pose[:3, 3] = -pose[:3, :3] @ center
        truth.append(pose)
    solution = flight.solved
    right = dataclasses.replace(solution, camera_from_world=np.array(truth))
    error = np.quantile(measure_differences(solution, right, solution), 0.9)
    print("error over half the difference", error / tenth)
    assert 1 / tolerances.HALVES_FACTOR < error / tenth < tolerances.HALVES_FACTOR


def test_few_points_make_halves_differ_more_or_lose_images(flight):
    whole, few, none = (compare_halves(keep_points(flight, count)) for count in (150, 16, 4))
    assert few.found.halves_px[0] > 1.5 * whole.found.halves_px[0]
    assert none.found.halves_px == (math.inf, math.inf)
