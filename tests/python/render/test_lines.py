"""Rays that start anywhere, in float: rolling shutters and lenses without one centre."""

import dataclasses
import os

import numpy as np
import pytest
from test_shutter import DIRECTIONS, moved

import flips
import gsut
import rendered_dataset
import tolerances
from gsut import InputError, _core
from random_scenes import (
    blob,
    fisheye,
    gaussians_in_view,
    hold_to_differences,
    list_isas,
    open_rule,
    pinhole,
    random_pose,
    random_weights,
    small_camera,
)

FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))
BACKGROUND = (0.3, 0.1, 0.6)
PARITIES = (None, "gsplat", "3dgrut")
NON_CENTRAL = [
    (model, example)
    for model in gsut.lens.camera_models()
    for example in range(len(_core.camera_examples(model)))
    if not small_camera(model, example, 16).is_central
]


def central_cameras(width=48):
    return [
        pinhole(width, 40),
        fisheye(width),
        small_camera("opencv5", 0, width),
        small_camera("equirectangular", 0, width),
    ]


def lines_case(seed):
    """(label, camera, pair, shutter) by turns of central lenses that move and others, still."""
    rng = np.random.default_rng([seed, 11])
    start = random_pose(rng)
    if seed % 3 == 2:
        model, example = NON_CENTRAL[seed // 3 % len(NON_CENTRAL)]
        camera = small_camera(model, example)
        if seed % 2:
            return rng, (seed, model), camera, start, None
    else:
        camera = central_cameras()[seed // 2 % 4]
    shutter = gsut.Shutter(DIRECTIONS[seed % 4])
    return rng, (seed, camera.model, shutter.direction), camera, (start, moved(rng, start)), shutter


def in_view(rng, camera, place, shutter, count, **options):
    """Gaussians that the camera sees in the middle of its exposure."""
    middle = place if shutter is None else gsut.CameraMotion(*place, shutter).at(0.5)
    return gaussians_in_view(rng, camera, middle, count, **options)


SCENES = 36


def test_render_float_lines_every_isa_matches_double():
    pixels = flipped = 0
    for seed in range(SCENES):
        rng, label, camera, place, shutter = lines_case(seed)
        g = in_view(rng, camera, place, shutter, 120, sh_degree=seed % 4, sizes=(0.01, 0.3))
        options = {
            "shutter": shutter,
            "parity": PARITIES[seed % 3],
            "background": BACKGROUND,
        }
        expected = gsut.render(g, camera, place, dtype="float64", **options)
        assert (expected.alpha > 0.2).mean() > 0.05, label
        weights = random_weights(rng, camera)
        flipped += flips.assert_isas_match(expected, weights, camera, place, **options)
        pixels += len(list_isas()) * camera.width * camera.height
    assert flipped <= tolerances.RENDER_FLIPS_A_PIXEL * pixels


MISS_ROUNDS = 24 if os.environ.get("GSUT_EVERY_LENS") else 12
MISS_GAUSSIANS = 120


@pytest.mark.parametrize("kind", flips.SHAPES)
def test_render_float_lines_miss_no_gaussian_that_double_sees(kind):
    # As the test of central lenses in test_render.py, with fast turns.
    pairs = seen = 0
    for seed in range(MISS_ROUNDS):
        rng, label, camera, place, shutter = lines_case(seed)
        if shutter is not None:
            place = (place[0], moved(rng, place[0], 0.5, (0.1, 1.0, 2.5)[seed % 3]))
        shape = {"sh_degree": 0, "opacity": -2.0, **flips.SHAPES[kind]}
        g = in_view(rng, camera, place, shutter, MISS_GAUSSIANS, **shape)
        g.means[::10] += rng.normal(size=g.means[::10].shape) * 3  # some out of view
        pairs += len(g)
        seen += flips.assert_none_missed(g, camera, place, label, shutter=shutter)
    print(f"{kind}: none missed of {seen} seen in {pairs} (Gaussian, camera) pairs")
    assert pairs == MISS_ROUNDS * MISS_GAUSSIANS and seen > pairs / 10


def test_render_lines_large_image_no_tile_is_missed(rng):
    # Wide enough for a pyramid of three levels; every pixel is compared.
    camera = pinhole(1200, 40, focal=500.0)
    start = np.eye(4)
    pair = (start, moved(rng, start, 0.1, 0.2))
    g = in_view(rng, camera, pair, gsut.Shutter("left_to_right"), 150, sizes=(1e-3, 0.1))
    expected = gsut.render(g, camera, pair, shutter="left_to_right", dtype="float64")
    found = gsut.render(g, camera, pair, shutter="left_to_right")
    off = np.abs(found.image - expected.image).max(axis=2) > tolerances.RENDER_FLIP
    assert off.sum() <= tolerances.RENDER_FLIPS_A_PIXEL * off.size
    assert (expected.alpha > 0.2).sum() > 1000


def test_render_lines_of_a_still_central_camera_are_its_rays(rng):
    camera, pose = fisheye(48), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 200)
    rays = gsut.render(g, camera, pose)
    lines = gsut.render(g, camera, (pose, pose), shutter="top_to_bottom")
    off = np.abs(rays.image - lines.image).max(axis=2)
    assert np.sum(off > tolerances.RENDER_FLIP) <= 1 and np.median(off) < 1e-6


def test_render_lines_without_pose_gradients_give_the_same_others(rng):
    camera, start = fisheye(48), random_pose(rng)
    motion = gsut.CameraMotion(start, moved(rng, start), gsut.Shutter("top_to_bottom"))
    g = gaussians_in_view(rng, camera, motion.at(0.5), 100)
    result = gsut.render(g, camera, motion)
    dimage = random_weights(rng, camera)[0].astype(np.float32)
    out = [g.copy(), g.copy()]
    touched = np.zeros(len(g), np.uint8)
    for with_poses, gradients in zip((True, False), out, strict=True):
        found = result.renderer.backward(dimage, gradients, touched, with_poses=with_poses)
        assert (found is None) != with_poses
    for field in FIELDS:
        assert np.array_equal(getattr(out[0], field), getattr(out[1], field))


@pytest.mark.parametrize(("model", "example"), NON_CENTRAL)
class TestNonCentral:
    def test_points_on_a_pixels_ray_project_to_it(self, rng, model, example):
        camera = small_camera(model, example, 64)
        pixels = rng.uniform(0, 1, (500, 2)) * (camera.width, camera.height)
        rays, valid = camera.unproject(pixels)
        origins, also = camera.ray_origins(pixels)
        assert np.array_equal(valid, also) and valid.sum() > 100
        assert np.linalg.norm(rays[valid], axis=1) == pytest.approx(1.0, abs=1e-15)
        for distance in (0.1, 1.0, 30.0):
            back, inside = camera.project((origins + distance * rays)[valid])
            assert inside.all()
            assert np.abs(back - pixels[valid]).max() < tolerances.ROUND_TRIP_PIXELS

    def test_table_holds_the_rays_and_origins_of_pixel_centres(self, rng, model, example):
        camera = small_camera(model, example, 32)
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        rays, valid = camera.rays()
        shape = (camera.height, camera.width, 3)
        assert np.array_equal(rays, camera.unproject(pixels)[0].reshape(shape), equal_nan=True)
        origins = camera.ray_origins(pixels)[0].reshape(shape)
        assert np.array_equal(camera.origins(), origins, equal_nan=True)
        assert np.ptp(origins[valid].reshape(-1, 3), axis=0).max() > 1e-4

    def test_jacobian_matches_central_differences(self, rng, model, example):
        camera = small_camera(model, example, 64)
        rays, valid = camera.rays()
        chosen = rng.permutation(np.flatnonzero(valid))[:60]
        points = (camera.origins() + 1.7 * rays).reshape(-1, 3)[chosen]
        of_point, of_params = camera.project_jacobian(points)
        step, slopes = 1e-6, np.zeros_like(of_point)
        for k in range(3):
            shift = step * np.eye(3)[k]
            up, down = (camera.project(points + sign * shift)[0] for sign in (1, -1))
            slopes[..., k] = (up - down) / (2 * step)
        inside = np.isfinite(slopes).all(axis=(1, 2))
        assert inside.sum() > 50
        size = np.abs(of_point[inside]).max()
        assert np.abs(of_point - slopes)[inside].max() < 1e-6 * size
        params = np.array(camera.params)
        for k in range(len(params)):
            pixels = []
            for sign in (1, -1):
                near = params.copy()
                near[k] += sign * step
                other = gsut.Camera(model, near, camera.width, camera.height)
                pixels.append(other.project(points)[0])
            slope = (pixels[0] - pixels[1]) / (2 * step)
            kept = np.isfinite(slope).all(axis=1)
            assert kept.sum() > 50
            assert np.abs(of_params[..., k] - slope)[kept].max() < 1e-6 * size

    @pytest.mark.parametrize("shutter", [None, gsut.Shutter("top_to_bottom")])
    def test_render_backward_matches_central_differences(self, rng, model, example, shutter):
        camera = small_camera(model, example, 20)
        place = start = random_pose(rng)
        if shutter is not None:
            place = start, moved(rng, start, 0.1, 0.1)
        g = in_view(rng, camera, place, shutter, 10, sizes=(0.02, 0.05), aspect=0.3)
        options = {"blend": open_rule(), "shutter": shutter, "entries": rng}
        weights, bound = random_weights(rng, camera), tolerances.RENDER_DIFFERENCES
        hold_to_differences(g.to_dtype(np.float64), camera, place, weights, bound, **options)


def test_non_central_lenses_are_there():
    assert {model for model, _ in NON_CENTRAL} >= {"orthographic", "cahvore"}


def test_orthographic_round_gaussian_is_a_gaussian_of_the_plane():
    # Closed form: the response depends on the distance in the plane only, the depth is z.
    camera = gsut.Camera("orthographic", [10.0, 12.0, 8.0, 6.0], 16, 12)
    g = blob((0.2, -0.1, 3.0), opacity=0.5)
    y, x = np.mgrid[:12, :16] + 0.5
    square = ((x - 8) / 10 - 0.2) ** 2 + ((y - 6) / 12 + 0.1) ** 2
    alpha = 0.5 * np.exp(-0.5 * square / 0.09)
    alpha[alpha < 1 / 255] = 0
    for dtype in ("float32", "float64"):
        found = gsut.render(g, camera, np.eye(4), dtype=dtype)
        assert np.abs(found.alpha - alpha).max() < tolerances.RENDER_CLOSED_FORM
        assert np.abs(found.depth - 3 * alpha).max() < 3 * tolerances.RENDER_CLOSED_FORM
        assert (alpha > 0.1).sum() > 20


def test_orthographic_what_lies_behind_the_plane_is_not_drawn():
    camera = gsut.Camera("orthographic", [10.0, 10.0, 8.0, 8.0], 16, 16)
    g = blob((0, 0, -1), opacity=0.5)
    for dtype in ("float32", "float64"):
        assert np.all(gsut.render(g, camera, np.eye(4), dtype=dtype).alpha == 0)


def test_cahvore_with_perspective_and_a_still_pupil_is_cahvor(rng):
    # Linearity 1, e = 0: chi = tan(theta), every ray meets the origin.
    params = [300.0, 305.0, 320.0, 240.0, 0.02, -0.03, 0.01, -0.05, 0.02]
    cahvor = gsut.Camera("cahvor", params, 640, 480)
    cahvore = gsut.Camera("cahvore", [*params, 0.0, 0.0, 0.0, 1.0], 640, 480)
    points = rng.normal(size=(500, 3)) * 0.3 + [0, 0, 1]
    expected, valid = cahvor.project(points)
    found, also = cahvore.project(points)
    assert (valid & also).sum() > 300
    assert np.abs(found - expected)[valid & also].max() < 1e-8
    assert np.abs(cahvore.origins()).max() == 0


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ([300.0, 300, 320, 240, 0, 0, 0, 0, 0, 0, 0, 0, 2.0], "linearity"),
        ([300.0, 300, 320, 240, 0.9, 0, 0, 0, 0, 0, 0, 0, 0.5], "alpha"),
        ([300.0, 300, 320, 240, 0, 0, -1.5, 0, 0, 0, 0, 0, 0.5], "r0"),
        ([300.0, 300, 320, 240], "e0 e1 e2"),
    ],
)
def test_cahvore_wrong_parameters_say_what_to_do(params, says):
    with pytest.raises(InputError, match=says):
        gsut.Camera("cahvore", params, 640, 480)


@pytest.mark.parametrize(
    "camera",
    [
        gsut.Camera("orthographic", [17.0, 17.0, 24.0, 24.0], 48, 48),
        small_camera("cahvore", 0, 48),
    ],
    ids=lambda camera: camera.model,
)
def test_train_from_random_places_through_a_lens_without_one_centre_learns(tmp_path, rng, camera):
    scene = gsut.load_dataset(rendered_dataset.write_dataset(tmp_path / "d", rng, camera=camera))
    options = gsut.TrainOptions(steps=150, max_gaussians=800, init="random", sh_degree=0)
    found = gsut.train(scene, options, progress=False).metrics["psnr"]
    print(camera.model, found)
    assert found > tolerances.LINES_TRAIN_RANDOM_PSNR
