"""Photographs blurred by the camera's motion, compared with the mean of renders along it."""

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut import InputError, _core
from gsut.data.scene import Level, find_time_neighbours, split_exposure
from gsut.metrics import psnr
from gsut.training.photograph.motion_blur import BlurRenderer, Exposure
from random_scenes import pinhole
from rendered_dataset import truth

FRAMES, PERIOD, SHARE = 24, 12.0, 0.9
CAMERA = pinhole(48)


def place(frame):
    """Camera_from_world of a camera that sways by 1 before blobs, 4 away; some 6 pixels a frame."""
    pose = np.eye(4)
    phase = 2 * np.pi * frame / PERIOD
    pose[:3, 3] = [np.sin(phase), 0.5 * np.sin(phase + frame / FRAMES), 4.0]
    return pose


@pytest.fixture(scope="module")
def blobs():
    return truth(np.random.default_rng(5))


@pytest.fixture(scope="module")
def scene(blobs):
    """Each photograph is the mean of light over the exposure."""
    images = []
    for frame in range(FRAMES):
        moments = frame + SHARE * (np.arange(9) - 4) / 9
        shown = [np.clip(gsut.render(blobs, CAMERA, place(at)).image, 0, 1) for at in moments]
        images.append(np.rint(255 * np.mean(np.power(shown, 2.2), axis=0) ** (1 / 2.2)))
    return gsut.scene_from_arrays(
        [image.astype(np.uint8) for image in images], CAMERA,
        np.array([place(frame) for frame in range(FRAMES)]), points=blobs.means,
        names=[f"f{frame:03d}.png" for frame in range(FRAMES)],
    )  # fmt: skip


def test_views_within_lie_evenly_in_the_exposure_at_the_velocity_between_neighbours(scene):
    before, after, time = find_time_neighbours(scene.views)[7]
    assert (before, after, time) == (6, 8, 2.0)
    around = (scene.views[7], scene.views[before], scene.views[after])
    views = split_exposure(*around, 0.6 / time, 3)
    velocity = (around[2].camera_center - around[1].camera_center) / 2
    for view, at in zip(views, (-0.2, 0.0, 0.2), strict=True):
        expected = scene.views[7].camera_center + at * velocity
        np.testing.assert_allclose(view.camera_center, expected, atol=tol.POSE_ROUNDING)
    assert np.array_equal(views[1].camera_from_world, scene.views[7].camera_from_world)


def test_more_poses_where_the_camera_moves_further_and_one_at_a_coarse_level(scene):
    exposure, level = Exposure(scene, SHARE), Level(scene)
    counts = [
        len(found) if isinstance(found, list) else 1
        for found in (exposure.find_poses(scene, level, view) for view in range(1, FRAMES - 1))
    ]
    assert max(counts) == 3 and min(counts) == 1
    small = Level(scene.scale_images(0.25))
    assert not any(isinstance(exposure.find_poses(scene, small, v), list) for v in range(FRAMES))
    assert np.array_equal(Exposure(scene, None).find_poses(scene, level, 1), scene.views[1].motion)


def test_one_frame_has_no_velocity(scene):
    with pytest.raises(InputError, match="at least two frames"):
        Exposure(scene.replace(views=scene.views[:1], train_indices=(0,), test_indices=()), SHARE)


def rendered(renderer, gaussians, places):
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.float32)
    look = {"background": (0.2, 0.3, 0.4), "sh_degree": 0}
    several = isinstance(places, list)
    jobs = [_core.RenderJob(CAMERA, place, **look) for place in (places if several else [places])]
    renderer.render(gaussians, jobs if several else jobs[0], image)
    return image


def backward(renderer, gaussians, dimage):
    gradients, touched = gaussians.make_zeros(), np.zeros(len(gaussians), np.uint8)
    renderer.backward(dimage, gradients, touched, with_poses=False)
    return gradients, touched


def test_one_place_twice_has_image_and_gradients_of_one(blobs, rng):
    renderer, gaussians = BlurRenderer(), blobs.to_dtype(np.float32)
    dimage = rng.normal(size=(CAMERA.height, CAMERA.width, 3)).astype(np.float32)
    found = []
    for places in (place(2), [place(2), place(2)]):
        image = rendered(renderer, gaussians, places)
        found.append((image, *backward(renderer, gaussians, dimage)))
    (image, one, touched), (again, twice, touched_again) = found
    np.testing.assert_allclose(again, image, rtol=tol.BLUR_ROUNDING)
    assert np.array_equal(touched, touched_again)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        a, b = getattr(one, name), getattr(twice, name)
        assert np.linalg.norm(a - b) < tol.BLUR_ROUNDING * np.linalg.norm(a)


@pytest.mark.parametrize("name", ["sh", "means"])
def test_gradient_of_two_places_matches_central_differences(blobs, rng, name):
    renderer, gaussians = BlurRenderer(), blobs.to_dtype(np.float32)
    places = [place(1.6), place(2.4)]
    weights = rng.normal(size=(CAMERA.height, CAMERA.width, 3)).astype(np.float32)
    rendered(renderer, gaussians, places)
    gradients, _ = backward(renderer, gaussians, weights)
    way = getattr(gradients, name) / np.linalg.norm(getattr(gradients, name))
    values = []
    for side in (1, -1):
        moved = gaussians.copy()
        getattr(moved, name)[...] += side * tol.BLUR_STEP * way
        values.append(np.sum(weights.astype(np.float64) * rendered(renderer, moved, places)))
    slope = (values[0] - values[1]) / (2 * tol.BLUR_STEP)
    expected = np.linalg.norm(getattr(gradients, name))
    print("slope", slope, "gradient", expected)
    assert slope == pytest.approx(expected, rel=tol.BLUR_GRADIENT)


def test_training_on_blurred_photographs_finds_the_sharp_scene(scene, blobs):
    found = {}
    for share in (None, SHARE):
        options = gsut.TrainOptions(
            steps=200, max_gaussians=300, sh_degree=0, eval_every=0, exposure="off",
            motion_blur=share, coarse_to_fine=(0.0, 0.0),
        )  # fmt: skip
        gaussians = gsut.train(scene, options, progress=False).gaussians
        sharp = [
            psnr(
                np.clip(gsut.render(gaussians, CAMERA, place(frame)).image, 0, 1),
                np.clip(gsut.render(blobs, CAMERA, place(frame)).image, 0, 1),
            )
            for frame in scene.test_indices
        ]
        found[share] = float(np.mean(sharp))
    print(found)
    assert found[SHARE] > found[None] + tol.BLUR_GAINED_DB
