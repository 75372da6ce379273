"""Trainings by other rules and of other primitives: they learn, and their files say so."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError, TrainOptions
from gsut.run.folder import RunFile
from gsut.training.loop import TrainingLoop

SHORT = {"steps": 100, "max_gaussians": 150}
# Kind of rule, its name, and another.
RULES = [("response", "extinction", "maximum"), ("order", "ray", "distance"), ("order", "z", "ray")]


@pytest.mark.parametrize(
    ("kind", "name", "other", "strategy"),
    [(*RULES[0], "mcmc"), (*RULES[0], "mini"), (*RULES[1], "mcmc"), (*RULES[2], "mini")],
)
def test_train_by_a_rule_learns_and_the_run_carries_it(
    scene, tmp_path, kind, name, other, strategy
):
    options = TrainOptions(**SHORT, strategy=strategy, **{kind: name})
    result = gsut.train(scene, options, out=tmp_path / "run", progress=False)
    assert result.metrics["psnr"] > tolerances.TRAIN_LEAST_PSNR
    assert getattr(result.gaussians, kind) == name
    run = gsut.load_run(tmp_path / "run")
    assert getattr(run.gaussians, kind) == name
    said = json.loads((tmp_path / "run" / RunFile.OPTIONS).read_text(encoding="utf-8"))
    assert said[kind] == name
    # Another rule shows another picture: what was measured is what is drawn.
    index = scene.test_indices[0]
    pose = scene.views[index].camera_from_world
    images = [
        gsut.render(result.gaussians, scene.camera(index), pose, **{kind: each}).image
        for each in (None, name, other)
    ]
    assert images[0].tobytes() == images[1].tobytes() != images[2].tobytes()


@pytest.mark.parametrize("primitive", ["atom", "triangle"])
def test_train_of_a_primitive_learns_and_the_run_carries_it(scene, tmp_path, primitive):
    # A triangle's ridges take a few steps more than smooth primitives.
    options = TrainOptions(**SHORT | {"steps": 130}, primitive=primitive)
    result = gsut.train(scene, options, out=tmp_path / "run", progress=False)
    assert result.metrics["psnr"] > tolerances.TRAIN_LEAST_PSNR
    drawn = "gaussian" if primitive == "atom" else primitive
    found = gsut.load_run(tmp_path / "run").gaussians
    assert found.primitive == result.gaussians.primitive == drawn
    if primitive == "atom":
        assert np.ptp(found.log_scales, axis=1).max() == 0
    if primitive == "triangle":
        assert found.are_surfels


def test_train_along_the_ray_draws_by_the_distance_first(scene):
    loops = [TrainingLoop(scene, TrainOptions(**SHORT, order=o)) for o in ("ray", "z")]
    drawn = []
    for _ in range(60):
        loops[0].advance()
        drawn.append(loops[0].gaussians.order)
    assert drawn == ["distance"] * 59 + ["ray"]
    assert loops[1].gaussians.order == "z"


def test_train_along_the_ray_with_refined_poses_is_refused():
    with pytest.raises(gsut.InputError, match="--refine-poses cannot be combined with --order ray"):
        TrainOptions(order="ray", refine_lens=True)


def test_options_of_a_primitive_that_contradict_are_refused():
    with pytest.raises(InputError, match="--surface cannot be combined with --primitive triangle"):
        TrainOptions(primitive="triangle", surface=True)
    for rule in ({"primitive": "triangle"}, {"response": "extinction"}, {"order": "ray"}):
        with pytest.raises(InputError, match="--refine-poses cannot be combined with --"):
            TrainOptions(**rule, refine_poses=True)
