"""Mini-Splatting's three parts, each on its own, and a run with all of them."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import TrainOptions
from gsut.compact.scores import blend_weights, list_seen_views
from gsut.gaussians import SH_C0
from gsut.optimize import GaussianOptimizer, split_and_prune
from gsut.training.loop import TrainingLoop
from gsut.training.strategies.mini import OVERGROWN, find_blurred, reinitialize, sample

SHORT = TrainOptions(steps=80, max_gaussians=150, strategy="mini")


@pytest.fixture(scope="module")
def trained(scene):
    loop = TrainingLoop(scene, TrainOptions(steps=40, max_gaussians=400))
    while loop.step < 40:
        loop.advance()
    return loop.gaussians.copy()


def test_blurred_are_the_large_ones_in_front(scene, trained):
    wall = trained.copy()
    camera = scene.views[scene.train_indices[0]].camera_from_world
    wall.means[0] = (np.linalg.inv(camera) @ [0, 0, 0.5, 1])[:3]
    wall.log_scales[0], wall.opacity_logits[0] = np.log(0.2), 4.0
    wall.means[1], wall.opacity_logits[1] = wall.means[0], -9.0  # there, but never the strongest
    found = find_blurred(wall, scene, scene.train_indices)
    assert found[0]
    assert not found[1]


def test_splitting_makes_two_smaller_ones_and_pruning_keeps_the_order(trained):
    optimizer = GaussianOptimizer(trained)
    split, prune = np.zeros(len(trained), bool), np.zeros(len(trained), bool)
    split[[3, 7]] = True
    prune[[0, 7]] = True
    counts = split_and_prune(optimizer, split, prune)
    assert (counts.pruned, counts.split, counts.size) == (2, 1, len(trained) - 1)
    made = optimizer.gaussians
    assert made.means[:2].tobytes() == trained.means[1:3].tobytes()
    smaller = trained.log_scales[3] - np.log(1.6)
    np.testing.assert_allclose(made.log_scales[2], smaller, rtol=1e-5)
    np.testing.assert_allclose(made.log_scales[-1], smaller, rtol=1e-5)
    with pytest.raises(gsut.InputError, match="none of 0"):
        gsut._core.AdaptivePlan(np.array([4], np.uint8))


def test_reinitialised_gaussians_lie_where_the_views_see_them_in_their_colours(scene, trained):
    new = reinitialize(trained, scene, TrainOptions(), 200, [1])
    assert len(new) == 200
    again = reinitialize(trained, scene, TrainOptions(), 200, [1])
    assert new.means.tobytes() == again.means.tobytes()
    low, high = trained.means.min(axis=0) - 1, trained.means.max(axis=0) + 1
    assert np.all((new.means > low) & (new.means < high))
    images = [scene.image(index).reshape(-1, 3) for index in scene.train_indices]
    known = {tuple(color) for color in np.concatenate(images)}
    colors = np.rint(255 * (0.5 + SH_C0 * new.sh[:, 0])).astype(int)
    assert all(tuple(color) in known for color in colors)


def test_sampling_draws_in_proportion_to_blend_weights(scene, trained):
    weights = blend_weights(trained, list_seen_views(scene, scene.train_indices))
    drawn = np.zeros(len(trained))
    for seed in range(20):
        kept = sample(trained, scene, 40, [seed])
        assert np.count_nonzero(kept) == 40
        drawn += kept
    assert np.all(drawn[weights == 0] == 0)
    order = np.argsort(weights)
    fifth = len(order) // 5
    assert drawn[order[-fifth:]].sum() > 2 * drawn[order[:fifth]].sum()
    assert np.count_nonzero(drawn) > 40  # drawn, not the best forty


def test_run_overgrows_and_is_sampled_to_its_number(scene):
    recipe = dataclasses.replace(SHORT.recipe, densify_every=4)
    loop, sizes = TrainingLoop(scene, SHORT, recipe=recipe), {}
    while loop.step < 80:
        loop.advance()
        sizes[loop.step] = len(loop.gaussians)
    assert 150 < max(sizes.values()) <= OVERGROWN * 150
    assert sizes[80] == sizes[40] <= 150
