"""Images that no pair of verified matches connects, registered by the points their matches join."""

import dataclasses

import numpy as np
import pytest

import tolerances
from gsut import Shutter
from gsut.sfm import PosesOptions, compare_poses
from gsut.sfm.lens import join_points
from gsut.sfm.matches import RawMatches, verify_matches
from gsut.sfm.solution import Adjustment, solve_poses
from gsut.sfm.starts import leave_out_contradicted, leaving_out, register_left_out
from gsut.sfm.starts.left_out import _find_poses
from synthetic_walk import Synthetic

OPTIONS = PosesOptions()
LEFT_OUT = 7


@pytest.fixture(scope="module")
def scene():
    return Synthetic(np.random.default_rng(20261124))


def solve_without_one(scene):
    """A run in which no pair of the last image was verified."""
    mapping = scene.mapping(OPTIONS)
    pairs = verify_matches(mapping.images, mapping.raw, OPTIONS)
    mapping = mapping.replace(
        pairs=[pair for pair in pairs if LEFT_OUT not in (pair.first, pair.second)]
    )
    mapping = mapping.replace(solution=solve_poses(mapping.images, mapping.pairs, OPTIONS))
    assert mapping.solved.unregistered_names == [mapping.photographs.names[LEFT_OUT]]
    return mapping


def test_image_without_verified_pairs_gets_a_pose_by_points_of_all_others(scene):
    mapping = solve_without_one(scene)
    # Few features with each of the others, as from far away.
    few = [
        matches[:: 12 if LEFT_OUT in pair else 1]
        for pair, matches in zip(mapping.raw.pairs, mapping.raw.matches, strict=True)
    ]
    mapping = mapping.replace(raw=RawMatches(mapping.raw.pairs, few))
    mapping = register_left_out(mapping)
    assert mapping.solved.registered.all()
    errors = compare_poses(mapping.solved.camera_from_world, np.array(scene.poses))
    assert errors.ate_percent < tolerances.LEFT_OUT_ATE_PERCENT
    added = [pair for pair in mapping.pairs if LEFT_OUT in (pair.first, pair.second)]
    assert added and all(0 < pair.parallax < 1.5 for pair in added)


def thin_out(mapping, every, others):
    """Leaves the image every n-th of its matches with these others, and one with each other."""
    few = [
        matches[:: every if set(pair.tolist()) - {LEFT_OUT} <= set(others) else len(matches)]
        if LEFT_OUT in pair
        else matches
        for pair, matches in zip(mapping.raw.pairs, mapping.raw.matches, strict=True)
    ]
    return mapping.replace(raw=RawMatches(mapping.raw.pairs, few))


def test_image_that_fits_fewer_points_than_others_need_is_held_by_what_it_predicts(scene):
    mapping = solve_without_one(scene)
    mapping = mapping.replace(options=OPTIONS)
    mapping = thin_out(mapping, every=60, others=[5])
    joined = join_points(mapping.solved, mapping.features, mapping.raw)[LEFT_OUT]
    assert 8 <= len(joined) < Adjustment.min_inliers
    mapping = register_left_out(mapping)
    assert mapping.solved.registered[LEFT_OUT]
    assert mapping.photographs.names[LEFT_OUT] in mapping.log.notes[-1]
    errors = compare_poses(mapping.solved.camera_from_world, np.array(scene.poses))
    assert errors.ate_percent < tolerances.LEFT_OUT_ATE_PERCENT


def test_image_that_meets_only_one_that_was_left_out_joins_after_it(scene):
    mapping = scene.mapping(OPTIONS)
    pairs = verify_matches(mapping.images, mapping.raw, OPTIONS)
    out = {LEFT_OUT - 1, LEFT_OUT}
    mapping = mapping.replace(pairs=[pair for pair in pairs if not out & {pair.first, pair.second}])
    mapping = mapping.replace(solution=solve_poses(mapping.images, mapping.pairs, OPTIONS))
    mapping = thin_out(mapping, every=1, others=[LEFT_OUT - 1])
    assert [image for _, image, _ in _find_poses(mapping)] == [LEFT_OUT - 1]
    mapping = register_left_out(mapping)
    assert mapping.solved.registered.all()


def test_image_with_a_rolling_shutter_gets_a_pose_and_keeps_the_others_velocities():
    scene = Synthetic(np.random.default_rng(20261128), readout=0.02)
    shutter = Shutter("top_to_bottom")
    mapping = scene.mapping(OPTIONS, shutter=shutter)
    pairs = verify_matches(mapping.images, mapping.raw, OPTIONS)
    mapping = mapping.replace(
        pairs=[pair for pair in pairs if LEFT_OUT not in (pair.first, pair.second)]
    )
    mapping = mapping.replace(solution=solve_poses(mapping.images, mapping.pairs, OPTIONS))
    before = mapping.solved
    assert before.unregistered_names == [mapping.photographs.names[LEFT_OUT]]
    mapping = register_left_out(mapping)
    assert mapping.solved.registered.all() and mapping.solved.shutter == shutter
    turned = mapping.solved.velocities[:LEFT_OUT, 3:] - before.velocities[:LEFT_OUT, 3:]
    assert np.abs(turned).max() < tolerances.LEFT_OUT_TURN


def test_image_whose_matches_are_wrong_stays_without_a_pose(scene):
    mapping = solve_without_one(scene)
    rng = np.random.default_rng(1)
    wrong = [
        np.stack([m[:, 0], rng.permutation(m[:, 1])], axis=1) if LEFT_OUT in pair else m
        for pair, m in zip(mapping.raw.pairs, mapping.raw.matches, strict=True)
    ]
    mapping = mapping.replace(raw=RawMatches(mapping.raw.pairs, wrong))
    before = mapping.solution
    mapping = register_left_out(mapping)
    assert mapping.solution is before


@pytest.mark.parametrize("kind", ["SIFT", "right", "held", "wrong"])
def test_image_most_of_whose_matches_contradict_its_pose_is_left_out(scene, kind, monkeypatch):
    mapping = scene.mapping(OPTIONS)
    pairs = verify_matches(mapping.images, mapping.raw, OPTIONS)
    solution = solve_poses(mapping.images, pairs, OPTIONS)
    if kind != "right":
        for index, pair in enumerate(pairs):
            if LEFT_OUT in (pair.first, pair.second):
                wrong = np.stack([np.roll(pair.matches[:, 0], 7), pair.matches[:, 1]], axis=1)
                matches = np.concatenate([pair.matches, wrong, wrong])
                pairs[index] = dataclasses.replace(pair, matches=matches)
    if kind != "SIFT":
        learned = [
            dataclasses.replace(each, is_learned=np.ones(len(each), bool))
            for each in mapping.features
        ]
        mapping = mapping.replace(features=learned)
    mapping = mapping.replace(pairs=pairs, solution=solution)
    if kind == "wrong":  # halves as of a pose that few points hold
        monkeypatch.setattr(leaving_out, "measure_halves", lambda _: (90.0, 0.1))
    found = leave_out_contradicted(mapping)
    if kind != "wrong":
        assert found is mapping and not found.log.notes
        return
    name = mapping.photographs.names[LEFT_OUT]
    assert found.solved.unregistered_names == [name] and name in found.log.notes[-1]
    assert not any(LEFT_OUT in (pair.first, pair.second) for pair in found.pairs)
    assert LEFT_OUT not in found.raw.pairs
    assert register_left_out(found).solved is found.solved
    errors = compare_poses(
        found.solved.camera_from_world[:LEFT_OUT], np.array(scene.poses[:LEFT_OUT])
    )
    assert errors.ate_percent < tolerances.LEFT_OUT_ATE_PERCENT


def test_matches_that_its_pose_chose_do_not_hold_an_image(scene, monkeypatch):
    mapping = register_left_out(solve_without_one(scene))
    added = [pair for pair in mapping.pairs if LEFT_OUT in (pair.first, pair.second)]
    assert added and all(pair.is_predicted for pair in added)
    learned = [
        dataclasses.replace(each, is_learned=np.ones(len(each), bool)) for each in mapping.features
    ]
    monkeypatch.setattr(leaving_out, "measure_halves", lambda _: None)
    found = leave_out_contradicted(mapping.replace(features=learned))
    assert found.solved.unregistered_names == [mapping.photographs.names[LEFT_OUT]]
