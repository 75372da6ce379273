"""Images of the graphics card against the double reference; skipped where there is no adapter."""

import os

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut._core import InputError
from gsut.render import card as card_module
from gsut.render.card_tiles import CardTiles
from random_scenes import fisheye, gaussians_in_view, pinhole, random_pose, rng_of, small_camera

BACKGROUND = (0.3, 0.1, 0.6)


@pytest.fixture(scope="module")
def card():
    os.environ.setdefault("XDG_RUNTIME_DIR", "/tmp")
    found = card_module.find_card()
    if isinstance(found, str):
        pytest.skip(f"no adapter: {found}")
    return found


def assert_as_reference(gaussians, camera, pose, dtype="float64", **options):
    found = gsut.render(gaussians, camera, pose, device="gpu", **options)
    assert found.renderer == "card"
    truth = gsut.render(gaussians, camera, pose, dtype=dtype, **options)
    off = found.image - truth.image
    assert np.sqrt(np.mean(off**2)) < tol.CARD_IMAGE_RMS
    beyond = np.abs(np.dstack([off, found.alpha - truth.alpha])).max(axis=2)
    assert np.mean(beyond > tol.CARD_CUT_OFF) < tol.CARD_CUT_OFF_SHARE
    assert beyond.max() < tol.CARD_LARGEST_CUT_OFF
    same = beyond < tol.CARD_CUT_OFF
    for name in ("depth", "distortion"):
        expected = getattr(truth, name)
        away = np.abs(getattr(found, name) - expected)[same].max()
        assert away < tol.CARD_DEPTH * max(1.0, np.abs(expected).max()), name
    return found


def test_card_every_central_lens_is_as_the_reference(card):
    drawn = 0
    for number, model in enumerate(gsut.lens.camera_models()):
        camera = small_camera(model, 0, 64)
        if not camera.is_central:
            continue
        rng = rng_of(model)
        pose = random_pose(rng)
        gaussians = gaussians_in_view(rng, camera, pose, 150, sh_degree=number % 4)
        assert_as_reference(gaussians, camera, pose, background=BACKGROUND)
        drawn += 1
    assert drawn > 20


@pytest.mark.parametrize("parity", ["gsplat", "3dgrut"])
def test_card_follows_the_rules_of_others(card, rng, parity):
    camera, pose = fisheye(64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 200, opacity=0.9)
    assert_as_reference(gaussians, camera, pose, parity=parity, background=BACKGROUND)


def test_card_large_gaussians_and_needles_are_as_the_reference(card, rng):
    camera, pose = pinhole(96, 64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 120, sizes=(0.5, 3.0))
    assert_as_reference(gaussians, camera, pose)
    needles = gaussians_in_view(rng, camera, pose, 120)
    needles.log_scales[:, 0] += 3.0
    needles.log_scales[:, 1] -= 3.0
    assert_as_reference(needles, camera, pose)


def test_card_draws_the_same_bits_again_and_sees_changes(card, rng):
    camera, pose = fisheye(64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 100)
    first = gsut.render(gaussians, camera, pose, device="gpu", background=None)
    again = gsut.render(gaussians, camera, pose, device="gpu", background=None)
    assert np.array_equal(first.image, again.image)
    gaussians.means[:] += 0.05
    assert_as_reference(gaussians, camera, pose, background=None)


def test_card_more_gaussians_than_a_workgroup_keep_their_order(card, rng):
    camera, pose = fisheye(64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 5000, opacity=0.05)
    # Distances that float32 tells apart, each of two Gaussians, which are drawn by index.
    center = -pose[:3, :3].T @ pose[:3, 3] - gaussians.origin
    away = gaussians.means - center
    distances = 1.0 + np.repeat(rng.permutation(2500), 2) / 2500
    away[1::2] = away[::2]
    away *= (distances / np.linalg.norm(away, axis=1))[:, None]
    gaussians.means[:] = center + away
    # Pixels stop where little light is left, at another Gaussian in double than in float.
    assert_as_reference(gaussians, camera, pose, dtype="float32")


def test_cones_of_tiles_hold_their_rays():
    checked = 0
    for model in gsut.lens.camera_models():
        camera = small_camera(model, 0, 80)
        tiles = CardTiles(camera)
        rays, valid = camera.rays()
        cones = tiles.cones[-tiles.tiles[0] * tiles.tiles[1] :]
        back = tiles.join(tiles.rays[..., :3] + cones[:, None, :3])
        assert np.abs(back - rays)[valid].max() < tol.CARD_RAYS
        has_ray = tiles.rays[..., 3] > 0
        away = np.linalg.norm(tiles.rays[..., :3].astype(np.float64), axis=2)
        assert (away <= cones[:, None, 3])[has_ray].all()
        assert np.array_equal(cones[:, 3] >= 0, has_ray.any(axis=1))
        checked += 1
    assert checked > 20


def test_without_a_card_the_cpu_draws_and_says_why(rng, monkeypatch):
    monkeypatch.setattr(card_module, "find_card", lambda: "there is no card")
    camera, pose = fisheye(48), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 40)
    with pytest.warns(RuntimeWarning, match="drawn on the CPU: there is no card"):
        found = gsut.render(gaussians, camera, pose, device="gpu")
    assert np.array_equal(found.image, gsut.render(gaussians, camera, pose).image)
    assert gsut.render_backward(found, np.ones_like(found.image)).touched.any()


def test_card_refuses_what_it_cannot_do(card, rng):
    camera, pose = small_camera("cahvore", 0, 64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 40)
    with pytest.warns(RuntimeWarning, match="many origins"):
        found = gsut.render(gaussians, camera, pose, device="gpu")
    assert np.array_equal(found.image, gsut.render(gaussians, camera, pose).image)
    with pytest.raises(InputError, match="known: cpu, gpu"):
        gsut.render(gaussians, camera, pose, device="cuda")
    with pytest.raises(InputError, match="float32"):
        gsut.render(gaussians, camera, pose, device="gpu", dtype="float64")
    drawn = gsut.render(gaussians, fisheye(48), pose, device="gpu")
    with pytest.raises(InputError, match="no gradients"):
        gsut.render_backward(drawn, np.ones_like(drawn.image))
