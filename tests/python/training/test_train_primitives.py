"""A training of each primitive: it learns, its files say so, it resumes to the same bits."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError, TrainOptions
from gsut.cli import main
from gsut.surface import load_mesh
from gsut.training.loop import TrainingLoop

SHORT = {"steps": 100, "max_gaussians": 150}


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
        out = tmp_path / "soup.off"
        assert main(["mesh", str(tmp_path / "run"), "-o", str(out), "--triangles", "--quiet"]) == 0
        assert 0 < len(load_mesh(out)) <= len(found)


def test_train_of_triangles_goes_on_from_a_state_to_the_same_bits(scene):
    options = TrainOptions(**SHORT, primitive="triangle")
    whole = TrainingLoop(scene, options)
    for _ in range(30):
        whole.advance()
    state = whole.optimizer.state_dict()
    again = TrainingLoop(scene, options)
    again.optimizer.load_state_dict(state)
    assert again.gaussians.primitive == "triangle"
    for name in whole.gaussians.list_arrays():
        same = (getattr(each.gaussians, name).tobytes() for each in (again, whole))
        assert len(set(same)) == 1, name


def test_options_of_a_primitive_that_contradict_are_refused():
    with pytest.raises(InputError, match="--surface cannot be combined with --primitive triangle"):
        TrainOptions(primitive="triangle", surface=True)
    for rule in ({"primitive": "triangle"}, {"response": "extinction"}, {"order": "ray"}):
        with pytest.raises(InputError, match="--refine-poses cannot be combined with --"):
            TrainOptions(**rule, refine_poses=True)
