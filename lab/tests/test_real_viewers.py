"""What real viewers show of our files: axes and half turns, compared as pictures."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import formats
from gsut.gaussians import transform_gaussians
from gsut.metrics import psnr
from gsut.training.tuning.ewa import render_ewa
from lab_tolerances import REAL_VIEWER_DB, REAL_VIEWER_TURNED_DB, THREE_VIEWER_DB
from real_viewers import (
    level_pose,
    picture_of,
    pinhole,
    viewer_pages,
    viewer_window,
)

WIDTH, HEIGHT, FIELD = 480, 360, 70.0
UP = np.array([0.2, -1.0, 0.3])
UP /= np.linalg.norm(UP)
EYE, FORWARD = np.array([0.5, -0.4, -6.0]), np.array([0.05, 0.1, 1.0])


@pytest.fixture(scope="module")
def scene():
    """Blobs without symmetry, with harmonics that turn with them."""
    rng = np.random.default_rng(5)
    count = 400
    sh = 0.25 * rng.normal(size=(count, 16, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.5, (count, 3))
    return gsut.Gaussians(
        (rng.uniform([-2.5, -1.5, -2], [3, 1, 2.5], (count, 3))).astype(np.float32),
        rng.normal(size=(count, 4)), np.log(rng.uniform(0.04, 0.3, (count, 3))),
        rng.uniform(-1, 3, count), sh,
    )  # fmt: skip


def assert_shows(found, scene, camera, pose, least=REAL_VIEWER_DB):
    """The scene's picture, and not that of the scene mirrored or half turned."""
    truth = np.clip(render_ewa(scene, camera, pose).image, 0, 1)
    assert truth.std() > 0.1
    assert psnr(found, truth) >= least
    for turn in (np.diag([-1.0, -1, 1]), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1])):
        other = np.clip(render_ewa(transform_gaussians(scene, turn), camera, pose).image, 0, 1)
        assert psnr(found, other) <= REAL_VIEWER_TURNED_DB
    if not scene.sh[:, 1:].any():
        return
    plain = gsut.Gaussians(scene.means, scene.quats, scene.log_scales, scene.opacity_logits,
                           scene.sh[:, :1])  # fmt: skip
    without = np.clip(render_ewa(plain, camera, pose).image, 0, 1)
    assert psnr(found, without) <= REAL_VIEWER_TURNED_DB


@pytest.mark.parametrize(
    "name", ["a.ply", "a.compressed.ply", "a.spz", "a.sog", "a.splat", "a.glb"]
)
def test_spark_and_three_show_the_scene(scene, tmp_path, name):
    camera, pose = pinhole(WIDTH, HEIGHT, FIELD), level_pose(EYE, FORWARD, UP)
    if name == "a.splat":  # holds no harmonics
        scene = dataclasses.replace(scene, sh=scene.sh * (np.arange(16) == 0)[:, None])
    formats.save_gaussians(tmp_path / name, scene)
    with viewer_pages(tmp_path) as page, viewer_window(WIDTH, HEIGHT) as window:
        window.open(page(name, camera, pose))
        window.wait("document.body.dataset.ready")
        found = picture_of(window)
    least = THREE_VIEWER_DB if name.endswith(".glb") else REAL_VIEWER_DB
    assert_shows(found, scene, camera, pose, least)
