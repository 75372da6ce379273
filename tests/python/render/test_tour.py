"""The tour of a scene: near photographs, looking where they looked, smooth, rigid."""

import numpy as np
import pytest

from gsut.render import make_tour_path, turn_path
from small_run import inward_pose
from tolerances.evaluate import RIGID_POSE
from tolerances.view import TOUR_AWAY, TOUR_TURN_DEGREES


def centers_of(poses):
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])


def ring(count, seed=0):
    order = np.random.default_rng(seed).permutation(count)
    return np.stack([inward_pose(2 * np.pi * k / count) for k in order])


def walk(count):
    """A straight walk that looks ahead, as names of photographs seldom are: shuffled."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = -np.random.default_rng(1).permutation(count)
    return poses


@pytest.mark.parametrize("keys", [ring(40), walk(30), ring(5)], ids=["ring", "walk", "few"])
def test_tour_stays_near_photographs_and_looks_where_they_did(keys):
    path = make_tour_path(keys, 200)
    assert path.shape == (200, 4, 4)
    gram = path[:, :3, :3] @ path[:, :3, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(gram, np.tile(np.eye(3), (200, 1, 1)), atol=RIGID_POSE)
    there = centers_of(keys)
    spacing = np.sort(np.linalg.norm(there[:, None] - there[None], axis=2), axis=1)[:, 1].max()
    apart = np.linalg.norm(centers_of(path)[:, None] - there[None], axis=2)
    assert apart.min(axis=1).max() <= TOUR_AWAY * spacing
    cosine = np.einsum("ni,ni->n", path[:, 2, :3], keys[apart.argmin(axis=1), 2, :3])
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() <= (
        TOUR_TURN_DEGREES if len(keys) > 5 else 360 / len(keys)
    )


def test_tour_of_a_ring_comes_around_without_a_jump():
    centers = centers_of(make_tour_path(ring(40), 200))
    steps = np.linalg.norm(np.diff(np.concatenate([centers, centers[:1]]), axis=0), axis=1)
    assert steps.max() < 2 * np.median(steps)


def test_tour_of_a_walk_goes_from_end_to_end():
    centers = centers_of(make_tour_path(walk(30), 200))[:, 2]
    assert {round(centers[0]), round(centers[-1])} == {0, 29}
    assert np.all(np.diff(centers) * np.sign(centers[-1] - centers[0]) > -0.1)


@pytest.mark.parametrize("count", [1, 2])
def test_tour_of_one_or_two_photographs_is_rigid(count):
    path = make_tour_path(ring(5)[:count], 7)
    assert path.shape == (7, 4, 4)
    assert np.isfinite(path).all()


def test_turn_keeps_distance_and_height():
    pose = inward_pose(0.3)
    path = turn_path(pose, np.array([0.5, 0, 0]), np.array([0, 0, 2.0]), 12)
    np.testing.assert_allclose(path[0], pose, atol=RIGID_POSE)
    from_axis = centers_of(path) - [0.5, 0, 0]
    np.testing.assert_allclose(np.linalg.norm(from_axis, axis=1), np.linalg.norm(from_axis[0]))
    np.testing.assert_allclose(from_axis[:, 2], from_axis[0, 2])
