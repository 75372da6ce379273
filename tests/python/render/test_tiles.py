"""Tiles that are left out: the pixels of the others, and their gradients, are as without."""

import numpy as np
import pytest

import gsut
from gsut import _core
from random_scenes import fisheye, random_gaussians

SIZE = 100  # seven tiles a side, the last one cut


def passes(gaussians, camera, pose, dimage, tiles=None, rule=None):
    """Image, gradients and touched of one render, leaving out tiles that are 0."""
    renderer = _core.Renderer()
    image = np.zeros((camera.height, camera.width, 3), np.float32)
    job = _core.RenderJob(
        camera, pose, rule=rule or gsut.BlendRule(), background=(0.2, 0.3, 0.4), tiles=tiles
    )
    renderer.render(gaussians, job, image)
    gradients, touched = gaussians.make_zeros(), np.zeros(len(gaussians), np.uint8)
    renderer.backward(dimage, gradients, touched)
    return image, gradients, touched, renderer.statistics()


@pytest.mark.parametrize("kind", ["still", "rolling", "along the ray"])
def test_tiles_left_out_leave_the_others_to_the_bit(rng, kind):
    camera = fisheye(SIZE)
    g = random_gaussians(rng, 400).to_dtype(np.float32)
    pose, rule = np.eye(4), gsut.BlendRule()
    rule.order = "ray" if kind == "along the ray" else "distance"
    if kind == "rolling":
        end = np.eye(4)
        end[0, 3] = 0.05
        pose = gsut.CameraMotion(pose, end, gsut.Shutter("top_to_bottom"))
    tiles = rng.integers(0, 2, (7, 7), dtype=np.uint8)
    kept = np.kron(tiles, np.ones((16, 16), np.uint8))[:SIZE, :SIZE].astype(bool)
    dimage = rng.normal(size=(SIZE, SIZE, 3)).astype(np.float32) * kept[..., None]
    image, gradients, touched, counts = passes(g, camera, pose, dimage, tiles, rule)
    whole, expected, seen, of_all = passes(g, camera, pose, dimage, rule=rule)
    np.testing.assert_array_equal(image[kept], whole[kept])
    rays = camera.rays()[1]
    assert (image[~kept & rays] == np.float32([0.2, 0.3, 0.4])).all()
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(gradients, name), getattr(expected, name))
    assert np.abs(expected.means).max() > 0
    assert 0 < touched.sum() < seen.sum()
    assert counts["num_pairs"] < of_all["num_pairs"]
