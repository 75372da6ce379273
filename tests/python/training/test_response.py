"""A training with the extinction: it learns, resumes to the same bits, and its files say so."""

import json

import pytest

import gsut
import tolerances
from gsut import TrainOptions
from gsut.run.folder import RunFile
from gsut.training.loop import TrainingLoop

SHORT = {"steps": 100, "max_gaussians": 150, "response": "extinction"}


@pytest.mark.parametrize("strategy", ["mcmc", "mini"])
def test_train_with_extinction_learns_and_the_run_carries_it(scene, tmp_path, strategy):
    options = TrainOptions(**SHORT, strategy=strategy)
    result = gsut.train(scene, options, out=tmp_path / "run", progress=False)
    assert result.metrics["psnr"] > tolerances.TRAIN_LEAST_PSNR
    assert result.gaussians.response == "extinction"
    run = gsut.load_run(tmp_path / "run")
    assert run.gaussians.response == "extinction"
    said = json.loads((tmp_path / "run" / RunFile.OPTIONS).read_text(encoding="utf-8"))
    assert said["response"] == "extinction"
    # Another rule shows another picture: what was measured is what is drawn.
    index = scene.test_indices[0]
    pose = scene.views[index].camera_from_world
    images = [
        gsut.render(result.gaussians, scene.camera(index), pose, response=each).image
        for each in (None, "extinction", "maximum")
    ]
    assert images[0].tobytes() == images[1].tobytes() != images[2].tobytes()


def test_train_with_extinction_goes_on_from_a_state_to_the_same_bits(scene):
    options = TrainOptions(**SHORT).resolve()
    whole = TrainingLoop(scene, options)
    for _ in range(40):
        whole.advance()
    state = whole.optimizer.state_dict()
    again = TrainingLoop(scene, options)
    again.optimizer.load_state_dict(state)
    assert again.gaussians.response == "extinction"
    assert again.gaussians.means.tobytes() == whole.gaussians.means.tobytes()
