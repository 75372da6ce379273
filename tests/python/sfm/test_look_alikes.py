"""Two rooms with the same furniture are not taken for one; one room visited twice is one."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.sfm.core.correspondences import match_images
from gsut.sfm.core.look_alikes import find_look_alikes, tell_apart
from gsut.sfm.core.options import PosesOptions
from gsut.sfm.core.solution import solve
from gsut.sfm.core.verification import verify
from gsut.sfm.report.verdict import poses_verdict
from gsut.sfm.world.comparison import compare_poses
from synthetic_walk import observe, quiet, shuffled

VISIT = 12  # images of one visit to a room
NEAR = 8
# The camera is elsewhere for twenty frames.
TIMES = np.arange(2 * VISIT) + 20 * (np.arange(2 * VISIT) >= VISIT)
OPTIONS = PosesOptions(extend_rounds=1)
FURNITURE, WALLS = 120, 220


def two_visits(rng, same_room):
    """Features and verified pairs of two walks on nearly the same path, by the furniture alone.

    In the other room the furniture is the same, the walls are not.
    """
    camera = gsut.Camera(
        "kannala_brandt", [300, 301, 500, 505, 0.02, -0.01, 0.002, -0.0003], 1000, 1010
    )
    count = FURNITURE + 2 * WALLS
    points = rng.uniform([-4, -4, -3], [4, 4, 5], (count, 3))
    identity = rng.random((count, 128)) ** 4
    poses, features = [], []
    for image in range(2 * VISIT):
        visit, step = divmod(image, VISIT)
        pose = _core.exp_pose([0, 0, 0, 0.02 * step, 0.12 * step, 0.01 * step])
        center = np.array([0.25 * step, 0.03 * step * step, 0.1 * (step % 2)])
        center += 0.05 * visit * rng.standard_normal(3)
        pose[:3, 3] = -pose[:3, :3] @ center
        pixels, valid = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
        walls = np.arange(count) - FURNITURE
        valid &= (walls < 0) | (walls // WALLS == (0 if same_room else visit))
        poses.append(pose)
        features.append(shuffled(rng, observe(rng, camera, pixels, valid, 0.2, identity)[1]))
    names = [f"f{image:03d}.jpg" for image in range(2 * VISIT)]
    raw = match_images(names, features, OPTIONS, quiet)
    pairs = verify(features, [camera] * len(names), raw, OPTIONS)
    return SimpleNamespace(
        names=names, camera=camera, features=features, pairs=pairs, poses=np.array(poses)
    )


def mapped(scene, pairs):
    return solve(
        scene.names, [scene.camera] * len(scene.names), scene.features, pairs, OPTIONS, quiet
    )


@pytest.fixture
def folded(rng):
    """Two rooms as one, and their scene."""
    scene = two_visits(rng, same_room=False)
    solution = mapped(scene, scene.pairs)
    assert solution.registered.all()  # silently, and with small errors
    assert solution.median < 0.5
    return scene, solution


@pytest.mark.parametrize("times", [TIMES, None], ids=["in time", "no order"])
def test_two_rooms_as_one_are_found_and_told_apart(folded, times):
    scene, solution = folded
    found = find_look_alikes(solution, times, NEAR)
    assert found is not None and len(found.images) > VISIT
    assert max(found.shares) < 0.65
    for one, other in found.pairs:
        assert (scene.names.index(one) < VISIT) != (scene.names.index(other) < VISIT)
    told = tell_apart(solution, scene.pairs, lambda pairs: mapped(scene, pairs), times, NEAR)
    assert told.dropped > VISIT and told.words()
    registered = told.solution.registered
    assert registered.reshape(2, VISIT).all(axis=1).sum() == 1 and registered.sum() == VISIT
    errors = compare_poses(told.solution.camera_from_world[registered], scene.poses[registered])
    assert errors.ate_percent < tolerances.SFM_TOLD_APART_ATE_PERCENT
    assert told.doubt is None and find_look_alikes(told.solution, times, NEAR) is None


@pytest.mark.parametrize("times", [TIMES, None], ids=["in time", "no order"])
def test_one_room_visited_twice_is_left_as_it_is(rng, times):
    scene = two_visits(rng, same_room=True)
    solution = mapped(scene, scene.pairs)
    assert solution.registered.all()
    assert find_look_alikes(solution, times, NEAR) is None
    told = tell_apart(solution, scene.pairs, lambda pairs: pytest.fail("mapped again"), times)
    assert told.solution is solution and told.pairs == scene.pairs and told.words() == []


def test_two_rooms_stay_as_they_are_where_nothing_is_left(folded):
    scene, solution = folded
    few = dataclasses.replace(solution, registered=np.arange(2 * VISIT) < 2)
    told = tell_apart(solution, scene.pairs, lambda pairs: few)
    assert told.solution is solution and not told.dropped and told.doubt is not None

    def nothing(pairs):
        raise _core.SolveError("nothing")

    assert tell_apart(solution, scene.pairs, nothing).solution is solution


def test_verdict_of_two_rooms_as_one_is_poor_and_names_images(folded):
    scene, solution = folded
    found = find_look_alikes(solution)
    verdict = poses_verdict(solution, scene.features, 0.9, None, alike=found)
    assert verdict.level == "poor" and "look alike" in verdict.reasons[0]
    assert all(name in verdict.reasons[0] for name in found.pairs[0])
    assert "folder" in verdict.advice
    assert found.figures()["images"] == found.images
