"""A structure that took a wrong turn is replaced by one from another start."""

import dataclasses

import numpy as np
import pytest

from gsut import SolveError, _core
from gsut.data.poses import find_centers
from gsut.sfm.solution import adjust_registered
from gsut.sfm.starts import second_start, try_other_starts
from made_flight import CENTERS, DOWN, fly


@pytest.fixture(scope="module")
def flight():
    run = fly(np.random.default_rng(5), relief=0.3, turn=0.3)
    return dataclasses.replace(run, lens_free=None)


def measure_off(solution):
    """The largest distance of a centre from the truth, after the best similarity."""
    found, shift = find_centers(solution.camera_from_world), CENTERS.mean(axis=0)
    off = found - found.mean(axis=0)
    left, sizes, right = np.linalg.svd((CENTERS - shift).T @ off)
    scale = sizes.sum() / (off**2).sum()
    return np.linalg.norm(scale * off @ (left @ right).T - (CENTERS - shift), axis=1).max()


@pytest.mark.parametrize("rotated", [0.0, 0.5])  # share of matches that a rotation explains too
def test_images_beside_their_places_come_back(flight, rotated):
    pairs = [
        dataclasses.replace(pair, rotation_matches=int(rotated * len(pair.matches)))
        for pair in flight.pairs
    ]
    flight = dataclasses.replace(flight, pairs=pairs)
    poses = flight.solved.camera_from_world.copy()
    poses[9:] = poses[9:] @ _core.exp_pose([3, 2, 0, 0.1, 0.2, 0.3])
    wrong = dataclasses.replace(flight.solved, camera_from_world=poses)
    apart = [pair for pair in flight.pairs if (pair.first < 9) == (pair.second < 9)]
    wrong = adjust_registered(wrong, flight.features, apart, flight.options)
    run = dataclasses.replace(flight, solution=wrong)
    assert measure_off(wrong) > 0.5
    run = try_other_starts(run)
    assert run.solved.registered.all()
    assert measure_off(run.solved) < 0.02


def test_each_start_begins_with_another_pair(flight, monkeypatch):
    begun = [flight.solved.initial_pair]
    solve = second_start.solve_poses

    def find(*args):
        found = solve(*args)
        begun.append(found.initial_pair)
        return found

    monkeypatch.setattr(second_start, "solve_poses", find)
    try_other_starts(flight)
    assert len(begun) == 3 and len(set(begun)) == 3


@pytest.mark.parametrize("left", [0, 1])
def test_fewer_than_two_images_cannot_be_adjusted(flight, left):
    few = dataclasses.replace(flight.solved, registered=np.arange(12) < left)
    with pytest.raises(SolveError, match="fewer than two images"):
        adjust_registered(few, flight.features, flight.pairs, flight.options)


def test_a_right_solution_loses_no_match(flight):
    run = dataclasses.replace(flight)
    run = try_other_starts(run)
    assert len(run.solved.observations) >= len(flight.solved.observations)
    assert measure_off(run.solved) < 0.02


def test_velocities_that_nothing_demands_go(flight):
    velocities = np.tile([0, 0, 0, 0.3, 0, 0.2], (12, 1))
    bent = dataclasses.replace(flight.solved, shutter=DOWN, velocities=velocities)
    run = dataclasses.replace(flight, solution=bent)
    run = try_other_starts(run)
    assert run.solved.shutter == DOWN
    assert np.abs(run.solved.velocities[:, 3:]).max() < 0.01
    assert measure_off(run.solved) < 0.05


def test_velocities_that_mend_a_wrong_structure_go_with_it(flight, monkeypatch):
    poses = flight.solved.camera_from_world.copy()
    poses[9:] = poses[9:] @ _core.exp_pose([3, 2, 0, 0.1, 0.2, 0.3])
    wrong = dataclasses.replace(
        flight.solved, camera_from_world=poses, shutter=DOWN, velocities=np.zeros((12, 6))
    )
    plain = second_start.compare_solutions

    def compare(current, rival, *evidence):
        # The velocities explain more than the same structure without them.
        found = plain(current, rival, *evidence)
        is_wrong = rival is wrong and measure_off(current) > 0.5
        return dataclasses.replace(found, is_rival=True) if is_wrong else found

    monkeypatch.setattr(second_start, "compare_solutions", compare)
    run = try_other_starts(dataclasses.replace(flight, solution=wrong))
    assert measure_off(run.solved) < 0.05


def test_velocities_that_matches_demand_stay():
    moving = fly(np.random.default_rng(6), relief=0.3, turn=0.3, speed=1.5)
    moving = dataclasses.replace(moving, lens_free=None)
    before = moving.solved
    moving = try_other_starts(moving)
    assert moving.solved is before


def test_structure_inside_out_shows_nearly_parallel_rays_the_same(flight):
    solution = flight.solved
    found = second_start._turn_inside_out(solution)
    poses, turned = solution.camera_from_world, found.camera_from_world
    middle = np.linalg.svd(poses[:, :3, :3].mean(axis=0))
    axes = middle[0] @ middle[2]
    center = np.median(solution.points, axis=0)
    mirrored = center + (solution.points - center) @ axes.T @ np.diag([1, 1, -1]) @ axes
    for before, after in zip(poses, turned, strict=True):
        seen = solution.points @ before[:3, :3].T + before[:3, 3]
        again = mirrored @ after[:3, :3].T + after[:3, 3]
        np.testing.assert_allclose(again[:, :2], seen[:, :2], atol=1e-9)
        depth = before[2, :3] @ center + before[2, 3]
        np.testing.assert_allclose(again[:, 2] - depth, depth - seen[:, 2], atol=1e-9)


def test_structure_inside_out_comes_back(flight, monkeypatch):
    monkeypatch.setattr(second_start, "MOST_IMAGES", 0)  # no other start
    wrong = adjust_registered(
        second_start._turn_inside_out(flight.solved), flight.features, flight.pairs, flight.options
    )
    assert measure_off(wrong) > 0.5
    run = try_other_starts(dataclasses.replace(flight, solution=wrong))
    assert measure_off(run.solved) < 0.02


def test_structure_inside_out_that_comes_back_by_itself_is_adjusted_no_further(flight, monkeypatch):
    monkeypatch.setattr(second_start, "MOST_IMAGES", 0)  # no other start
    begun, adjust = [], second_start._adjust

    def record(mapping, start, lens_free):
        begun.append(start)
        return adjust(mapping, start, lens_free)

    monkeypatch.setattr(second_start, "_adjust", record)
    monkeypatch.setattr(second_start, "_turn_inside_out", lambda solution: solution)
    try_other_starts(flight)
    assert len(begun) == 1
