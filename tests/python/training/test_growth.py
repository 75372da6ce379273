"""What growth goes by, and how large Gaussians may become."""

import dataclasses

import numpy as np
import pytest

from gsut import TrainOptions
from gsut.training import TrainingLoop

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
