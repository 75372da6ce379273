"""Colours that merged Gaussians take from the whole scene's pictures."""

import numpy as np
import pytest

import gsut
from gsut.compact.compaction import compact
from gsut.compact.refit import refit_colors
from gsut.compact.scores import SeenView, blend_weights
from gsut.gaussians import SH_C0
from random_scenes import arrays_of, fisheye, gaussians_in_view, random_pose


@pytest.fixture
def views(rng):
    camera, pose = fisheye(40), random_pose(rng)
    return [SeenView(camera, pose, np.array(camera.rays()[1], bool))]


@pytest.fixture
def scene(rng, views):
    return gaussians_in_view(rng, views[0].camera, views[0].camera_from_world, 300)


def test_refit_brings_the_pictures_nearer_to_the_whole_scenes(rng):
    camera, pose = fisheye(96), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 2000, sh_degree=1, opacity=1.0)
    mask = np.array(camera.rays()[1], bool)
    views = [SeenView(camera, pose, mask)]
    truth = gsut.render(g, camera, pose).image
    plain = compact(g, 0.1, method="field", views=views).gaussians
    before = plain.copy()
    psnrs = [gsut.psnr(gsut.render(plain, camera, pose).image, truth, mask)]
    for rounds in (1, 2, 4):
        made = refit_colors(plain, g, views, rounds)
        psnrs.append(gsut.psnr(gsut.render(made, camera, pose).image, truth, mask))
    assert arrays_of(plain) == arrays_of(before)
    assert np.all(np.diff(psnrs) > 0)
    assert psnrs[1] > psnrs[0] + 0.3
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert np.array_equal(getattr(made, name), getattr(plain, name))
    assert np.array_equal(made.sh[:, 1:], plain.sh[:, 1:])
    default = compact(g, 0.1, views=views).gaussians
    assert arrays_of(default) == arrays_of(refit_colors(plain, g, views, 2))


def test_refit_moves_what_is_hardly_seen_by_no_more_than_it_is_seen(rng):
    """A faint Gaussian before a bright wall that the others lost: it must not make up for that."""
    camera, pose = fisheye(64), np.eye(4)
    mask = np.array(camera.rays()[1], bool)
    views = [SeenView(camera, pose, mask)]
    wall = gsut.Gaussians(
        np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 2.0]]), np.tile([1.0, 0, 0, 0], (2, 1)),
        np.log([[1.0] * 3, [0.05] * 3]), np.array([5.0, -4.0]), np.full((2, 1, 3), 1.5),
    ).to_dtype(np.float32)  # fmt: skip
    faint = wall[np.array([1])]
    faint.sh[:] = -1.0
    weight = blend_weights(faint, views)[0]
    assert 0.01 < weight < 0.5  # pixels
    moved = refit_colors(faint, wall, views, 1).sh - faint.sh
    assert np.all(moved > 0)
    assert SH_C0 * moved.max() < weight


def test_refit_leaves_what_no_view_sees(scene, views):
    hidden = scene.copy()
    hidden.means[:5] = 1e4
    made = refit_colors(hidden, scene, views)
    assert np.array_equal(made.sh[:5], hidden.sh[:5])
    assert np.isfinite(made.sh).all()
