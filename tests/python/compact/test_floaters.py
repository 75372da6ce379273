"""What photographs say of each Gaussian: exactly, and of planted floaters."""

import dataclasses
import math

import numpy as np
import pytest

import gsut
import small_run
from gsut import InputError
from gsut.compact import find_support
from gsut.compact.scores import Passes, SeenView
from gsut.gaussians import merge_gaussians
from gsut.render import to_uint8, write_png
from random_scenes import fisheye, gaussians_in_view
from tolerances import FLOATERS_LEFT, FLOATERS_WRONG, SUPPORT

VIEWS = 8
SKY = (0.3, 0.4, 0.6)


def test_support_is_the_error_without_each_gaussian(rng):
    camera, pose, background = fisheye(40), np.eye(4), (0.2, 0.5, 0.1)
    g = gaussians_in_view(rng, camera, pose, 60)
    mask = np.array(camera.rays()[1], bool)
    mask[:5] = False
    photograph = rng.uniform(0, 1, (*mask.shape, 3)).astype(np.float32)

    def error(shown):
        image = gsut.render(
            shown.to_dtype(np.float64), camera, pose, background=background, dtype="float64"
        ).image
        return np.sum((image - photograph)[mask] ** 2)

    passes = Passes(g, background)
    passes.render(SeenView(camera, pose, mask))
    found = passes.add_support(photograph, mask)
    whole = error(g)
    truth = [error(g[np.arange(len(g)) != i]) - whole for i in range(len(g))]
    assert np.ptp(truth) > 1
    np.testing.assert_allclose(found[:, 0], truth, atol=SUPPORT * np.abs(truth).max())
    drawn = gsut.render(g, camera, pose, background=background)
    np.testing.assert_allclose(found[:, 1].sum(), drawn.alpha[mask].sum(), rtol=SUPPORT)


@pytest.fixture
def planted(tmp_path, rng):
    """A ball and blobs before cameras, each of which one photograph shows and the others do not."""
    number = 400
    means = rng.normal(size=(number, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    ball = gsut.Gaussians(
        means, rng.normal(size=(number, 4)),
        np.full((number, 3), math.log(0.12)), np.full(number, 3.0),
        rng.uniform(-1.5, 1.5, (number, 1, 3)),
    ).to_dtype(np.float32)  # fmt: skip
    scene = small_run.scene_from_arrays(tmp_path / "data")
    poses = [small_run.inward_pose(2 * math.pi * i / VIEWS) for i in range(VIEWS)]
    camera = gsut.Camera("pinhole", [50.0, 50.0, 32, 32], 64, 64)
    blobs, views = [], []
    for i, pose in enumerate(poses):
        places = rng.uniform([-0.3, -0.3, 0.8], [0.3, 0.3, 1.6], (3, 3))
        blobs.append(gsut.Gaussians(
            (places - pose[:3, 3]) @ pose[:3, :3], rng.normal(size=(3, 4)),
            np.full((3, 3), math.log(0.05)), np.full(3, 1.0), rng.uniform(-1.5, 1.5, (3, 1, 3)),
        ).to_dtype(np.float32))  # fmt: skip
        file = tmp_path / f"data/images/shown-{i}.png"
        image = gsut.render(merge_gaussians([ball, blobs[-1]]), camera, pose, background=SKY)
        write_png(file, to_uint8(image.image))
        views.append(gsut.View(f"images/shown-{i}.png", file, 0, pose))
    scene = dataclasses.replace(
        scene, cameras=(camera,), file_cameras=(camera,), views=tuple(views),
        train_indices=tuple(range(VIEWS)), test_indices=(),
    )  # fmt: skip
    return scene, merge_gaussians([ball, *blobs]), np.arange(number + 3 * VIEWS) >= number


def test_planted_floaters_are_contradicted_and_what_is_there_is_not(planted):
    scene, g, floats = planted
    support = find_support(scene, g, scene.train_indices, background=SKY)
    seen = ~support.unseen
    assert seen[floats].all() and seen[~floats].sum() > 200
    assert np.mean(support.contradicted[~floats]) <= FLOATERS_WRONG
    # Between the photographs' poses, where nobody has seen the blobs, they are what is wrong.
    pose = small_run.inward_pose(math.pi / VIEWS)

    def squares(kept):
        truth, found = (
            gsut.render(g[rows], scene.cameras[0], pose, background=SKY).image
            for rows in (~floats, kept)
        )
        return np.sum((found - truth) ** 2)

    assert squares(~support.contradicted) <= FLOATERS_LEFT * squares(floats >= 0)


def test_one_photograph_contradicts_nothing(planted):
    scene, g, _ = planted
    with pytest.raises(InputError, match="1 photographs cannot contradict each other"):
        find_support(scene, g, [0])
