"""Two rooms with the same furniture are not taken for one; one room visited twice is one."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.sfm.mapping import Findings, Mapping, PosesLog
from gsut.sfm.matches import RawMatches
from gsut.sfm.matches.matching import match_images
from gsut.sfm.matches.verification import verify_matches
from gsut.sfm.photographs import Images, Photographs
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.report.verdict import judge_solution
from gsut.sfm.solution.look_alikes import separate_look_alikes
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.starts import leave_out_look_alikes, register_left_out
from gsut.sfm.world.comparison import compare_poses
from synthetic_walk import Synthetic, observe, quiet, shuffled

VISIT = 12  # images of one visit to a room
NEAR = 8
# The camera is elsewhere for twenty frames.
TIMES = np.arange(2 * VISIT) + 20 * (np.arange(2 * VISIT) >= VISIT)
OPTIONS = PosesOptions()
FURNITURE, WALLS = 120, 220


def two_visits(rng, same_room, visit_images=VISIT, furniture=FURNITURE):
    """Features and verified pairs of two walks on nearly the same path, by the furniture alone.

    In the other room the furniture is the same, the walls are not.
    """
    camera = gsut.Camera(
        "kannala_brandt", [300, 301, 500, 505, 0.02, -0.01, 0.002, -0.0003], 1000, 1010
    )
    count = furniture + 2 * WALLS
    points = rng.uniform([-4, -4, -3], [4, 4, 5], (count, 3))
    identity = rng.random((count, 128)) ** 4
    poses, features = [], []
    for image in range(2 * visit_images):
        visit, step = divmod(image, visit_images)
        pose = _core.exp_pose([0, 0, 0, 0.02 * step, 0.12 * step, 0.01 * step])
        center = np.array([0.25 * step, 0.03 * step * step, 0.1 * (step % 2)])
        center += 0.05 * visit * rng.standard_normal(3)
        pose[:3, 3] = -pose[:3, :3] @ center
        pixels, valid = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
        walls = np.arange(count) - furniture
        valid &= (walls < 0) | (walls // WALLS == (0 if same_room else visit))
        poses.append(pose)
        features.append(shuffled(rng, observe(rng, camera, pixels, valid, 0.2, identity)[1]))
    names = [f"f{image:03d}.jpg" for image in range(2 * visit_images)]
    raw = match_images(names, features, OPTIONS, quiet)
    pairs = verify_matches(Images(names, [camera] * len(names), features), raw, OPTIONS)
    return SimpleNamespace(
        names=names, camera=camera, features=features, pairs=pairs, poses=np.array(poses)
    )


def find_look_alikes(solution, times=None, near=0):
    """Finds what speaks for places taken for one, where nothing is mapped again."""
    return separate_look_alikes(solution, [], None, times, near)[2]


def images_of(scene):
    return Images(scene.names, [scene.camera] * len(scene.names), scene.features)


def mapped(scene, pairs):
    return solve_poses(images_of(scene), pairs, OPTIONS)


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
    left, pairs, doubt = separate_look_alikes(
        solution, scene.pairs, lambda pairs: mapped(scene, pairs), times, NEAR
    )
    assert len(scene.pairs) - len(pairs) > VISIT
    registered = left.registered
    assert registered.reshape(2, VISIT).all(axis=1).sum() == 1 and registered.sum() == VISIT
    errors = compare_poses(left.camera_from_world[registered], scene.poses[registered])
    assert errors.ate_percent < tolerances.SFM_TOLD_APART_ATE_PERCENT
    assert doubt is None and find_look_alikes(left, times, NEAR) is None


def test_one_room_visited_twice_is_left_as_it_is(rng):
    scene = two_visits(rng, same_room=True)
    solution = mapped(scene, scene.pairs)
    assert solution.registered.all()
    assert find_look_alikes(solution, TIMES, NEAR) is None
    same, pairs, _ = separate_look_alikes(
        solution, scene.pairs, lambda pairs: pytest.fail("mapped again"), TIMES
    )
    assert same is solution and pairs == scene.pairs


def few_photographs(rng, same_room):
    """The solution and pairs of three photographs of each visit, with little furniture."""
    scene = two_visits(rng, same_room, visit_images=3, furniture=25)
    solution = mapped(scene, scene.pairs)
    assert solution.registered.all()
    return solution, scene.pairs


@pytest.mark.parametrize("same_room", [False, True])
def test_two_rooms_of_six_numbered_photographs_are_doubted(rng, same_room):
    solution, pairs = few_photographs(rng, same_room)
    same, kept, found = separate_look_alikes(
        solution, pairs, lambda pairs: pytest.fail("mapped again"), np.arange(6), NEAR
    )
    assert same is solution and kept == pairs
    assert found is None if same_room else found.images == solution.names


def test_photographs_of_another_room_are_left_out_and_the_others_keep_their_places(rng):
    scene = two_visits(rng, False, visit_images=3, furniture=25)
    solution = mapped(scene, scene.pairs)
    count = len(scene.names)
    photographs = Photographs(
        Path(), scene.names, [Path(name) for name in scene.names], [None] * count,
        [scene.camera] * count,
    )  # fmt: skip
    raw = RawMatches(
        np.array([(pair.first, pair.second) for pair in scene.pairs]),
        [pair.matches for pair in scene.pairs],
    )
    mapping = Mapping(
        photographs, OPTIONS, PosesLog(), features=scene.features, raw=raw, pairs=scene.pairs,
        solution=solution,
    )  # fmt: skip
    assert leave_out_look_alikes(mapping, None) is mapping
    found = separate_look_alikes(solution, scene.pairs, None)[2]
    views = np.bincount(solution.observations[:, 1]).reshape(2, 3).sum(axis=1)
    assert found.smaller == np.reshape(scene.names, (2, 3))[np.argmin(views)].tolist()
    left = leave_out_look_alikes(mapping, found)
    visits = left.solved.registered.reshape(2, 3)
    assert sorted(visits.all(axis=1)) == [False, True] and left.solved.num_registered == 3
    assert all(name in left.log.notes[-1] for name in scene.names)
    assert len(left.raw.pairs) == len(left.pairs) < len(scene.pairs)
    assert register_left_out(left).solved is left.solved
    assert separate_look_alikes(left.solved, left.pairs, None)[2] is None
    kept = left.solved.registered
    errors = compare_poses(left.solved.camera_from_world[kept], scene.poses[kept])
    assert errors.ate_percent < tolerances.SFM_TOLD_APART_ATE_PERCENT


def test_one_photograph_without_matches_does_not_make_a_doubt(rng):
    solution, pairs = few_photographs(rng, same_room=True)
    others = [pair for pair in pairs if 0 not in (pair.first, pair.second)]
    assert separate_look_alikes(solution, others, None)[2] is None


def test_three_images_are_too_few_to_doubt(rng):
    scene = Synthetic(rng, images=3)
    pairs = scene.verified()
    solution = solve_poses(scene.images(), pairs, OPTIONS)
    assert solution.registered.all() and separate_look_alikes(solution, pairs, None)[2] is None


def test_two_rooms_stay_as_they_are_where_nothing_is_left(folded):
    scene, solution = folded
    few = dataclasses.replace(solution, registered=np.arange(2 * VISIT) < 2)
    same, pairs, doubt = separate_look_alikes(solution, scene.pairs, lambda pairs: few)
    assert same is solution and pairs == scene.pairs and doubt is not None

    def nothing(pairs):
        raise _core.SolveError("nothing")

    assert separate_look_alikes(solution, scene.pairs, nothing)[0] is solution


def test_verdict_of_two_rooms_as_one_is_poor_and_names_images(folded):
    scene, solution = folded
    found = find_look_alikes(solution)
    verdict = judge_solution(solution, scene.features, Findings(look_alikes=found, agreement=0.9))
    assert verdict.level == "poor" and "look alike" in verdict.reasons[0]
    assert all(name in verdict.reasons[0] for name in found.pairs[0])
    assert "folder" in verdict.advice
    assert found.to_figures()["images"] == found.images
