"""Tests that Adam may step the harmonics in the backward pass: to the same bits as after it."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import _core
from gsut.optimize import GaussianOptimizer, LearningRates, find_last_densification
from gsut.run import TrainOptions
from gsut.training import TrainingLoop
from random_scenes import arrays_of, fisheye, gaussians_in_view, list_isas, random_pose, roll

RATES = LearningRates(1e-3, 2e-3, 3e-3, 4e-2, 5e-3, 6e-4)
CAMERA = fisheye(40)
STEPS = 3


def passes(optimizer, place, degree, dimage, in_backward):
    """A few passes; returns the harmonics' gradients as the last left them."""
    g = optimizer.gaussians
    renderer, gradients = _core.Renderer(), g.make_zeros()
    touched, image = np.zeros(len(g), np.uint8), np.zeros_like(dimage)
    for _ in range(STEPS):
        renderer.render(g, _core.RenderJob(CAMERA, place, sh_degree=degree), image)
        step = optimizer.prepare_harmonics_step(RATES, degree) if in_backward else None
        renderer.backward(
            dimage, gradients, touched, write_untouched=False, with_poses=False, harmonics_step=step
        )
        optimizer.step(gradients, RATES, touched, degree, harmonics=not in_backward)
    assert 0 < touched.sum() < len(g)
    return gradients.sh


@pytest.mark.parametrize("motion", [lambda pose: pose, roll], ids=["still", "rolling"])
def test_step_in_backward_gives_the_bits_of_a_step_after_it(rng, motion):
    pose = random_pose(rng)
    in_view = gaussians_in_view(rng, CAMERA, pose, 301, sh_degree=3)
    in_view.means[::5] += 100.0  # some are far off
    dimage = rng.normal(size=(CAMERA.height, CAMERA.width, 3)).astype(np.float32)
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        for degree in range(4):
            after, within = (GaussianOptimizer(in_view, 400) for _ in range(2))
            assert np.any(passes(after, motion(pose), degree, dimage, False))
            assert not np.any(passes(within, motion(pose), degree, dimage, True))
            for expected, found in zip(after.arrays, within.arrays, strict=True):
                assert arrays_of(found) == arrays_of(expected), (isa, degree)
            assert np.any(after.arrays[1].sh)


def test_step_in_backward_of_what_was_not_rendered_raises(rng):
    pose = random_pose(rng)
    optimizer = GaussianOptimizer(gaussians_in_view(rng, CAMERA, pose, 50))
    g, renderer = optimizer.gaussians, _core.Renderer()
    image, touched = np.zeros((CAMERA.height, CAMERA.width, 3), np.float32), np.zeros(50, np.uint8)

    def backward(drawn, write_untouched):
        renderer.render(drawn, _core.RenderJob(CAMERA, pose, sh_degree=1), image)
        again(write_untouched)

    def again(write_untouched):
        step = optimizer.prepare_harmonics_step(RATES)
        renderer.backward(
            image,
            g.make_zeros(),
            touched,
            write_untouched=write_untouched,
            with_poses=False,
            harmonics_step=step,
        )

    for drawn, write_untouched in ((g.copy(), False), (g, True)):
        with pytest.raises(gsut.InputError, match="the array that was rendered"):
            backward(drawn, write_untouched)
    backward(g, False)
    with pytest.raises(gsut.InputError, match="needs a render before it"):
        again(False)


def backpropagate_alone(loop, step, dimage):
    """As `TrainingLoop._backpropagate`, but Adam is left to make the step of the harmonics."""
    how = {}
    last = find_last_densification(loop.recipe, loop.options.steps)
    if step.number <= last:
        how |= loop._measure_pixel_errors(step, dimage)
    loop.drawing.backpropagate(dimage, **how)
    return False


def test_training_steps_harmonics_in_backward_to_the_same_bits(scene, monkeypatch):
    options = TrainOptions(steps=8, sh_degree=2)
    recipe = dataclasses.replace(options.recipe, sh_every=2, densify_every=3)
    runs = []
    for in_backward in (True, False):
        if not in_backward:
            monkeypatch.setattr(TrainingLoop, "_backpropagate", backpropagate_alone)
        loop = TrainingLoop(scene, options, recipe=recipe)
        for _ in range(7):
            loop.advance()
        assert np.any(loop.drawing.gradients.sh) != in_backward
        runs.append([arrays_of(rows) for rows in loop.optimizer.arrays])
    assert runs[0] == runs[1]
