"""Pixels that show the same in all images of a camera are left out of training."""

import numpy as np
import pytest
from test_movers import SIZE, VIEWS, make_pose, wall  # noqa: F401

import gsut
from gsut.data import scene_from_arrays
from gsut.run import RunFolder, TrainOptions
from gsut.training.first import describe_fixed, find_plain_background, prepare_scene
from random_scenes import pinhole

Y, X = np.mgrid[:SIZE, :SIZE]
OUTSIDE = np.hypot(X - 31.5, Y - 31.5) > 26


@pytest.fixture
def circle(wall):  # noqa: F811
    """Views of a wall through a circle, black outside it, and no mask."""
    images, poses = [], [make_pose(view) for view in range(VIEWS)]
    for pose in poses:
        image = np.round(255 * np.clip(gsut.render(wall, pinhole(SIZE), pose).image, 0, 1))
        image[OUTSIDE] = 2
        images.append(image.astype(np.uint8))
    return scene_from_arrays(images, pinhole(SIZE), poses, test_every=0)


def test_fixed_pixels_are_left_out_of_every_mask(circle):
    scene = prepare_scene(circle, TrainOptions())
    (note,) = describe_fixed(scene)
    assert "--keep-all-pixels" in note
    for size in (scene, scene.scale_images(0.5, keep_larger=True)):
        shape = size.mask(0).shape
        outside = np.hypot(*(np.indices(shape) - shape[0] / 2 + 0.5)) > 26 * shape[0] / SIZE
        assert not (size.mask(0) & outside).any() and size.mask(0)[~outside].mean() > 0.7
    assert find_plain_background(scene) is None  # what is left out is no cut-out


def test_fixed_pixels_are_kept_on_request(circle):
    scene = prepare_scene(circle, TrainOptions(keep_all_pixels=True))
    assert describe_fixed(scene) == [] and scene.mask(0).all()


def test_photographs_of_a_mask_keep_all_that_it_lets_in(circle):
    views = [
        gsut.View(**vars(view) | {"valid": np.ones((SIZE, SIZE), bool)}) for view in circle.views
    ]
    scene = prepare_scene(circle.replace(views=views), TrainOptions())
    assert scene.fixed == ()


def test_fixed_pixels_are_marked_in_the_report(circle, tmp_path):
    options = TrainOptions(steps=3, sh_degree=0, max_gaussians=100)
    result = gsut.train(circle, options, out=tmp_path / "run", progress=False)
    row, *_ = result.metrics["marked"]
    assert (RunFolder(tmp_path / "run").renders / row["picture"]).is_file()
    assert row["text"] in (tmp_path / "run" / "report.html").read_text("utf-8")
