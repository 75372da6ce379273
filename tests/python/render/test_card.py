"""Images of the graphics card against the double reference; skipped where there is no adapter."""

import os

import numpy as np
import pytest

import gsut
import small_run
import tolerances as tol
from gsut._core import InputError
from gsut.cli import main
from gsut.evaluate import evaluate
from gsut.formats import save_gaussians
from gsut.gaussians import pack_harmonics
from gsut.render import card as card_module
from gsut.render import render_surface
from gsut.render.card_tiles import CardTiles
from gsut.view import Session, Stage
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


def test_card_with_small_bindings_draws_the_same_bits_in_parts(card, rng, monkeypatch):
    camera, pose = fisheye(64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 2000, sh_degree=3, opacity=0.1)
    whole = gsut.render(gaussians, camera, pose, device="gpu")
    assert len(card._scene[1]) == 1
    other = gaussians_in_view(rng, camera, pose, 100)  # takes the place of the first
    changed = gsut.render(other, camera, pose, device="gpu")
    monkeypatch.setattr(card, "_most", 170_000)
    parted = gsut.render(gaussians, camera, pose, device="gpu")
    assert [first for first, _, _ in card._scene[1]] == [0, 832, 1664]
    assert not np.array_equal(whole.image, changed.image)
    for name in ("image", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(parted, name), getattr(whole, name))
    monkeypatch.setattr(card, "_most", 100_000)
    with pytest.warns(RuntimeWarning, match=r"arrays of 0 MB.* one of 0 MB"):
        assert gsut.render(gaussians, camera, pose, device="gpu").renderer != "card"


def test_card_draws_gaussians_of_several_degrees(card, rng):
    camera, pose = fisheye(64), random_pose(rng)
    gaussians = gaussians_in_view(rng, camera, pose, 300, sh_degree=3)
    gaussians.sh[50:, 4:] = 0.0
    packed = pack_harmonics(gaussians)
    assert type(packed) is not type(gaussians)
    found = gsut.render(packed, camera, pose, device="gpu")
    assert found.renderer == "card"
    truth = gsut.render(packed, camera, pose)
    assert np.sqrt(np.mean((found.image - truth.image) ** 2)) < tol.CARD_IMAGE_RMS


@pytest.fixture
def scene(tmp_path):
    return small_run.scene_from_arrays(tmp_path / "data")


def test_eval_view_and_surface_on_a_card(card, scene, rng):
    pose = scene.views[0].camera_from_world
    gaussians = gaussians_in_view(rng, scene.cameras[0], pose, 100)
    found, truth = (evaluate(gaussians, scene, [0, 3], device=name) for name in ("gpu", "cpu"))
    assert found["psnr"] == pytest.approx(truth["psnr"], abs=tol.CARD_PSNR)
    values = {"pose": pose.ravel().tolist(), "lens": 0, "width": 32, "height": 32, "mode": "color"}
    shown = []
    for device in ("gpu", "cpu"):
        session = Session(Stage("small", "run", gaussians, scene, device=device))
        shown.append(session.frames.draw(session._request(values)).image.astype(int))
    assert np.abs(shown[0] - shown[1]).max() <= 1 and shown[1].std() > 5
    drawn = gsut.render(gaussians, scene.cameras[0], pose, device="gpu")
    with pytest.raises(InputError, match="finds no surface"):
        render_surface(drawn)


@pytest.mark.filterwarnings("default:drawn on the CPU:RuntimeWarning")
def test_commands_on_a_card_draw_as_on_the_cpu_and_say_where_they_cannot(
    tmp_path, rng, monkeypatch, capsys
):
    import cv2

    gaussians = gaussians_in_view(rng, fisheye(48), random_pose(rng), 60)
    save_gaussians(tmp_path / "a.ply", gaussians)
    plain = ["render", str(tmp_path / "a.ply"), "--size", "64x48", "--frames", "2", "-o"]
    assert main([*plain, str(tmp_path / "cpu")]) == 0
    assert main([*plain, str(tmp_path / "gpu"), "--device", "gpu"]) == 0
    monkeypatch.setattr(card_module, "find_card", lambda: "there is no card")
    capsys.readouterr()
    assert main([*plain, str(tmp_path / "none"), "--device", "gpu"]) == 0
    assert capsys.readouterr().err.count("drawn on the CPU: there is no card") == 1
    for name in ("00000.png", "00001.png"):
        cpu, gpu, none = (
            cv2.imread(str(tmp_path / each / name)).astype(int) for each in ("cpu", "gpu", "none")
        )
        assert np.abs(cpu - gpu).max() <= 1 and cpu.std() > 5
        np.testing.assert_array_equal(cpu, none)
    cloud = ["--cloud", str(tmp_path / "b.ply"), "--device", "gpu"]
    assert main([*plain, str(tmp_path / "depth"), *cloud]) == 2
    assert "leave --device gpu out" in capsys.readouterr().err


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
