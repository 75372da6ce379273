"""Poses adjusted with either half of the points: how far they differ, and what that tells."""

import dataclasses
import math

import numpy as np
import pytest

import tolerances
from gsut.sfm.lens import measure_pose_differences
from gsut.sfm.solution import Adjustment, ReadoutMotion
from gsut.sfm.starts import halves
from gsut.sfm.starts.halves import compare_halves, split_matches
from made_flight import DOWN, fly_again, list_true_poses


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
    tenth, most = flight.found.pose_errors_px
    assert 0 < most < tenth
    solution = flight.solved
    right = dataclasses.replace(solution, camera_from_world=list_true_poses(0.3))
    error = np.quantile(measure_pose_differences(solution, right, solution), 0.9)
    print("error over half the difference", error / tenth)
    assert 1 / tolerances.HALVES_FACTOR < error / tenth < tolerances.HALVES_FACTOR


def test_velocities_during_a_readout_add_to_the_difference_of_halves(monkeypatch):
    flight = fly_again(3, relief=0.3, turn=0.3, speed=0.2)
    still = dataclasses.replace(flight.solved, shutter=None, velocities=None)
    motion = ReadoutMotion(DOWN, 1.0, np.zeros((12, 6)))
    flight = flight.replace(solution=flight.adjust(Adjustment(motion=motion), still))
    own = compare_halves(flight).found.pose_errors_px
    monkeypatch.setattr(halves, "_VELOCITY_SIGMA", 0.0)
    held = compare_halves(flight).found.pose_errors_px
    assert own[0] > 1.15 * held[0] and own[1] > 1.15 * held[1]


def test_few_points_make_halves_differ_more_or_lose_images(flight):
    whole, few, none = (compare_halves(keep_points(flight, count)) for count in (150, 16, 4))
    assert few.found.pose_errors_px[0] > 1.5 * whole.found.pose_errors_px[0]
    assert none.found.pose_errors_px == (math.inf, math.inf)
