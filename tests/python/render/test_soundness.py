"""Tests what a render says about Gaussians that it cannot draw, or that changed after it."""

import dataclasses
import warnings

import numpy as np
import pytest

import gsut
import tolerances as tol
from random_scenes import gaussians_in_view, pinhole, random_pose


def make_scene(rng):
    camera, pose = pinhole(40, 30), random_pose(rng)
    return gaussians_in_view(rng, camera, pose, 20).to_dtype(np.float32), camera, pose


UNSOUND = {
    **{name: (name, slice(3), np.nan, "3 have a parameter that is not")
       for name in ("means", "quats", "log_scales", "opacity_logits", "sh")},
    **{f"scale {length:g}": ("log_scales", slice(4, 6), np.log(length), "2 have a scale")
       for length in (1e-14, 1e14, np.exp(44.0))},
    **{f"norm {norm:g}": ("quats", 5, (norm, 0.0, 0.0, 0.0), "1 have a quaternion of a norm")
       for norm in (1e-40, 1e38)},
    "needles": ("log_scales", slice(5, 8), np.log((0.1, 1e-7, 1e-8)), "3 are more than .* as wide"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNSOUND)
def test_render_gaussians_that_cannot_be_drawn_warns_with_their_number(rng, name):
    g, camera, pose = make_scene(rng)
    array, rows, value, said = UNSOUND[name]
    getattr(g, array)[rows] = value
    with pytest.warns(RuntimeWarning, match=f"of 20 Gaussians {said}"):
        gsut.render(g, camera, pose)


def test_render_scene_in_large_or_small_units_follows_the_reference():
    camera, pose = pinhole(40, 30), np.eye(4)
    one = gsut.Gaussians([[0.1, 0.05, 3.0]], [[0.9, 0.2, 0.3, 0.1]], np.log([[0.3, 0.2, 0.1]]),
                         [2.0], np.full((1, 1, 3), 0.7))  # fmt: skip
    for factor in (1e-10, 1.0, 1e10):
        g = dataclasses.replace(
            one, means=one.means * factor, log_scales=one.log_scales + np.log(factor)
        )
        image = gsut.render(g, camera, pose).image
        exact = gsut.render(g, camera, pose, dtype="float64").image
        assert exact.max() > 0.5
        assert np.sqrt(np.mean((image - exact) ** 2)) < tol.RENDER_IMAGE_RMS


def test_render_thin_discs_and_needles_within_the_bound_says_nothing(rng):
    g, camera, pose = make_scene(rng)
    g.log_scales[5:8] = np.log((0.1, 0.1, 1e-8))
    g.log_scales[8:10] = np.log((0.1, 2e-6, 2e-6))
    image = gsut.render(g, camera, pose).image
    exact = gsut.render(g, camera, pose, dtype="float64").image
    assert np.sqrt(np.mean((image - exact) ** 2)) < tol.RENDER_IMAGE_RMS


def test_double_gaussians_far_from_zero_are_drawn_as_near(rng):
    g, camera, pose = make_scene(rng)
    g, far = g.to_dtype(np.float64), np.array([5e5, -6e6, 300.0])
    moved = pose.copy()
    moved[:3, 3] -= pose[:3, :3] @ far
    near = gsut.render(g, camera, pose)
    away = gsut.render(dataclasses.replace(g, means=g.means + far), camera, moved)
    assert near.image.max() > 0.1
    assert np.sqrt(np.mean((away.image - near.image) ** 2)) < tol.RENDER_IMAGE_RMS
    centers = [
        gsut.project(each, camera, place).centers
        for each, place in ((g, pose), (dataclasses.replace(g, means=g.means + far), moved))
    ]
    assert np.nanmax(np.abs(centers[0] - centers[1])) < tol.PROJECTION_FLOAT_PIXELS


def test_render_warns_once_at_a_line(rng):
    g, camera, pose = make_scene(rng)
    g.means[0] = np.nan
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("default")
        for _ in range(3):
            gsut.render(g, camera, pose)
    assert len(seen) == 1


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "opacity_logits", "sh"])
def test_backward_of_gaussians_changed_since_is_refused(rng, name, dtype):
    g, camera, pose = make_scene(rng)
    g = g.to_dtype(dtype)
    result = gsut.render(g, camera, pose, dtype=dtype)
    gsut.render_backward(result, np.ones((30, 40, 3)))
    before = getattr(g, name).copy()

    def add_little(values):
        values.flat[5] += 0.01

    def exchange_rows(values):
        values[[3, 9]] = values[[9, 3]]

    def turn_signs(values):
        values *= -1

    for change in (add_little, exchange_rows, turn_signs):
        change(getattr(g, name))
        with pytest.raises(gsut.InputError, match=r"have changed since .* render them again"):
            gsut.render_backward(result, np.ones((30, 40, 3)))
        getattr(g, name)[:] = before
    gsut.render_backward(result, np.ones((30, 40, 3)))
    getattr(g, name).flat[5] += 0.01
    gsut.render_backward(gsut.render(g, camera, pose, dtype=dtype), np.ones((30, 40, 3)))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_background_of_one_colour_as_an_image_gives_the_same(rng, dtype):
    g, camera, pose = make_scene(rng)
    color = (0.2, 0.5, 0.9)
    as_image = np.broadcast_to(color, (30, 40, 3))
    one, other = (
        gsut.render(g, camera, pose, background=b, dtype=dtype) for b in (color, as_image)
    )
    assert np.sqrt(np.mean((one.image - other.image) ** 2)) < tol.RENDER_IMAGE_RMS
    weights = rng.normal(size=(30, 40, 3))
    first, second = (gsut.render_backward(r, weights).gaussians for r in (one, other))
    for name in ("means", "opacity_logits", "sh"):
        a, b = getattr(first, name), getattr(second, name)
        assert np.abs(a - b).max() <= tol.SURROUNDINGS_GRADIENT * np.abs(a).max(), name


@pytest.mark.parametrize(
    ("background", "words"),
    [
        (np.zeros((30, 41, 3)), r"an image of shape \(30, 40, 3\)"),
        (np.full((30, 40, 3), 255, np.uint8), r"divide by 255"),
        ((255, 0, 0), r"found int64 of 0 to 255; divide by 255"),
        ((0.0, np.nan, 0.0), r"found NaN"),
        (0.5, r"3 finite numbers"),
    ],
)
def test_background_of_another_shape_or_kind_is_refused(rng, background, words):
    with pytest.raises(gsut.InputError, match=words):
        gsut.render(*make_scene(rng), background=background)


def test_photometric_loss_takes_what_render_backward_takes(rng):
    truth, image = rng.random((2, 30, 40, 3))
    target = gsut.PhotometricTarget(truth)
    loss, gradient = gsut.photometric_loss(target, image.astype(np.float32))
    doubles = gsut.photometric_loss(target, np.asfortranarray(image))
    assert doubles[0] == loss and np.array_equal(doubles[1], gradient)
    with pytest.raises(gsut.InputError, match="floating point, as it was rendered"):
        gsut.photometric_loss(target, np.zeros((30, 40, 3), np.uint8))
