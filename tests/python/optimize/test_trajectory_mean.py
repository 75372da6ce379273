"""The mean of the Gaussians over the last steps."""

import dataclasses

import numpy as np
import pytest

from gsut.optimize.trajectory_mean import TrajectoryMean
from random_scenes import random_gaussians


def states(rng, count, n=7):
    return [random_gaussians(rng, n) for _ in range(count)]


def test_mean_is_over_every_fourth_step_after_the_beginning(rng):
    of_step = states(rng, 200)
    mean = TrajectoryMean()
    for step, g in enumerate(of_step, 1):
        mean.observe(step, step / 200, g)
    taken = of_step[183::4]
    assert len(taken) == 5
    for field in dataclasses.fields(of_step[0]):
        expected = np.mean([getattr(g, field.name) for g in taken], axis=0, dtype=np.float64)
        found = getattr(mean.average(of_step[-1]), field.name)
        np.testing.assert_allclose(found, expected, atol=5e-7)  # worst observed: 1.8e-7


def test_before_the_beginning_and_after_a_restart_it_is_the_present_state(rng):
    now, before = states(rng, 2)
    mean = TrajectoryMean()
    mean.observe(4, 0.9, before)
    assert mean.average(now) is now
    mean.observe(8, 0.95, before)
    assert mean.average(now) is not now
    mean.restart()
    assert mean.average(now) is now


def test_another_number_of_gaussians_begins_anew(rng):
    mean = TrajectoryMean()
    mean.observe(4, 0.91, states(rng, 1)[0])
    (larger,) = states(rng, 1, n=9)
    mean.observe(8, 0.92, larger)
    np.testing.assert_array_equal(mean.average(larger).means, larger.means)


@pytest.mark.parametrize("broken_at", [0, 6, 20])
def test_state_goes_on_to_the_same_bits(rng, broken_at):
    of_step = states(rng, 30)
    whole, part = TrajectoryMean(), TrajectoryMean()
    for step, g in enumerate(of_step, 1):
        whole.observe(step, 0.9 + step / 300, g)
        part.observe(step, 0.9 + step / 300, g)
        if step == broken_at:
            state = part.state_dict()
            part = TrajectoryMean()
            part.load_state_dict(state)
    for field in dataclasses.fields(of_step[0]):
        np.testing.assert_array_equal(
            getattr(whole.average(of_step[0]), field.name),
            getattr(part.average(of_step[0]), field.name),
        )
