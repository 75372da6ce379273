"""What growth goes by, and how large Gaussians may become."""

import dataclasses

import numpy as np
import pytest

from gsut import TrainOptions
from gsut.training import TrainingLoop
from random_scenes import arrays_of

OPTIONS = TrainOptions(steps=20, max_gaussians=300)
RECIPE = dataclasses.replace(OPTIONS.recipe, densify_every=5)


def loop_of(scene, context=None, **options):
    changed = dataclasses.replace(OPTIONS, **options)
    return TrainingLoop(scene, changed, context=context, recipe=RECIPE)


def test_errors_are_measured_until_the_last_densification(scene):
    loop = loop_of(scene)
    while loop.step < 17:
        loop.advance()
        densified = loop.step % 5 == 0 and loop.step <= 15
        measured = loop.step < 15 and not densified
        assert loop.optimizer.error_sum.any() == measured, loop.step


def test_other_strategies_go_by_gradients(scene):
    loop = loop_of(scene, strategy="mini")
    loop.advance()
    assert loop.optimizer.gradient_max.any()
    assert not loop.optimizer.error_sum.any()


def test_beside_gaussians_that_stay_growth_goes_by_gradients(scene):
    context = loop_of(scene).gaussians.copy()
    loop = loop_of(scene, context)
    loop.advance()
    assert loop.optimizer.gradient_max.any()
    assert not loop.optimizer.error_sum.any()


def test_growth_beyond_a_small_cap_is_merged_to_it_and_goes_on_from_a_state(scene):
    recipe = dataclasses.replace(RECIPE, densify_every=2, overgrowth=2.0)
    loop, other = (TrainingLoop(scene, OPTIONS, recipe=recipe) for _ in range(2))
    sizes = []
    while loop.step < OPTIONS.steps:
        sizes.append(len(loop.gaussians))
        loop.advance()
        if loop.step in (7, 11):  # before and after the merging
            other.load_state_dict(loop.state_dict())
        elif loop.step > 7:
            other.advance()
            assert arrays_of(other.gaussians) == arrays_of(loop.gaussians), loop.step
    assert max(sizes) == sizes[9]
    assert set(sizes[10:]) == {len(loop.gaussians)} == {300}


def test_gaussians_that_are_given_do_not_outgrow_a_cap(scene):
    start = loop_of(scene).gaussians.copy()
    recipe = dataclasses.replace(RECIPE, densify_every=2, overgrowth=2.0)
    loop = TrainingLoop(scene, OPTIONS, start, recipe=recipe)
    while loop.step < 10:
        loop.advance()
        assert len(loop.gaussians) <= 300


@pytest.mark.parametrize("until", [0.8, 0.1], ids=["while it grows", "afterwards"])
def test_a_plate_is_cut_to_a_fifth_of_its_distance(scene, until, monkeypatch):
    monkeypatch.setattr("gsut.training.loop.DENSIFY_UNTIL", until)
    loop = loop_of(scene)
    middle = np.mean([scene.views[i].camera_center for i in scene.train_indices], axis=0)
    plate = loop.gaussians
    plate.log_scales[0] = np.log([1e-3, 50.0, 40.0]) + np.log(scene.extent)
    before = plate.log_scales[1:].copy()
    while loop.step < 5:
        loop.advance()
    g = loop.gaussians
    distances = np.linalg.norm(g.means - middle, axis=1)
    limit = np.log(0.2 * np.maximum(distances, loop.extent))
    assert np.exp(g.log_scales.max(axis=1) - limit).max() < 1 + 1e-5
    assert np.median(g.log_scales) < np.median(before) + 1.0
