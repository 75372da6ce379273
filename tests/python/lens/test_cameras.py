"""Tests gsut.cameras: every lens against OpenCV and the oracle, derivatives, the Python class."""

import itertools
import pickle

import cv2
import numpy as np
import pytest

import tolerances as tol
from gsut import InputError, set_num_threads
from gsut.lens.camera import Camera, camera_models
from lens_cases import OPENCV, all_lenses, polar_grid, traits
from raising import raises_saying

pytestmark = pytest.mark.quick

LENSES = all_lenses()
OPENCV_LENSES = [camera for camera in LENSES if camera.model in OPENCV]
each_lens = pytest.mark.parametrize("camera", LENSES, ids=lambda c: f"{c.model}-{c.width}")
# Coordinates below which the comparisons with absolute tolerances are made.
NEAR_PIXELS = 1e4


def cv2_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """OpenCV's projection in gsut's pixel convention."""
    fx, fy, cx, cy = camera.params[:4]
    matrix = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1.0]])
    zero = np.zeros(3)
    if camera.model == "kannala_brandt":
        coefficients = np.zeros(4)
        coefficients[: len(camera.params) - 4] = camera.params[4:]
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, matrix, coefficients)
    else:
        pixels, _ = cv2.projectPoints(points[:, None], zero, zero, matrix, camera.params[4:])
    return pixels[:, 0] + 0.5


@pytest.mark.parametrize("camera", OPENCV_LENSES, ids=lambda c: f"{c.model}-{c.width}")
def test_project_any_lens_agrees_with_cv2(camera):
    if camera.model == "kannala_brandt":  # cv2 has four coefficients
        camera = Camera(camera.model, camera.params[:8], camera.width, camera.height)
    # cv2.fisheye is wrong behind the camera.
    points = 2.5 * polar_grid(min(0.999 * camera.max_angle, np.radians(89.0)))
    pixels, valid = camera.project(points)
    assert valid.all()
    near = np.abs(pixels).max(axis=1) < NEAR_PIXELS
    assert near.sum() > 100
    expected = cv2_pixels(camera, points[near])
    np.testing.assert_allclose(pixels[near], expected, rtol=0, atol=tol.CV2_PIXELS)


@pytest.mark.parametrize("case", ["fisheye", "opencv12", "pinhole"])
def test_rays_of_oracle_cameras_agree(shared, case):
    oracle = np.load(shared / "oracle" / f"{case}.npz")
    matrix = oracle["K"]
    params = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    if case == "opencv12":
        k1, k2, k3, k4, k5, k6 = oracle["radial"]
        params += [k1, k2, *oracle["tangential"], k3, k4, k5, k6, *oracle["thin_prism"]]
    elif case == "fisheye":
        params += list(oracle["radial"])
    model = {"fisheye": "kannala_brandt"}.get(case, case)
    rays, valid = Camera(model, params, int(oracle["width"]), int(oracle["height"])).rays()
    assert valid.all()
    expected = oracle["rays"][:, 3:] @ oracle["viewmat"][:3, :3].T
    np.testing.assert_allclose(rays.reshape(-1, 3), expected, rtol=0, atol=tol.ORACLE_RAYS)


@each_lens
def test_project_jacobian_matches_central_differences(camera, rng):
    # Short of the seam, where a difference would jump.
    widest = 80 if camera.is_panorama else 120
    points = polar_grid(0.95 * min(camera.max_angle, np.radians(widest)), 16, 20)
    pixels, valid = camera.project(points)
    points = points[valid & (np.abs(pixels).max(axis=1) < NEAR_PIXELS)]
    points = points * rng.uniform(0.5, 3.0, (len(points), 1))
    dpixel_dpoint, dpixel_dparams = camera.project_jacobian(points)
    assert dpixel_dpoint.shape == (len(points), 2, 3)
    assert dpixel_dparams.shape == (len(points), 2, len(camera.params))
    alone, none = camera.project_jacobian(points, with_params=False)
    assert np.array_equal(alone, dpixel_dpoint) and none.shape == (0, 2, len(camera.params))

    def difference(plus: np.ndarray, minus: np.ndarray, step: float) -> np.ndarray:
        return (plus - minus) / (2 * step)

    # A jump of the second derivative: of a quadratic spline, or of a power of theta on the axis.
    jumps = camera.model in ("ftheta", "ocam") or (
        camera.model == "splined_stereographic" and camera.params[0] == 2
    )
    tolerance = tol.JUMPING_JACOBIAN if jumps else tol.CAMERA_JACOBIAN
    compared = 0
    for axis, shift in enumerate(1e-5 * np.eye(3)):
        plus, minus = camera.project(points + shift)[0], camera.project(points - shift)[0]
        difference_of_point = difference(plus, minus, 1e-5)
        check_jacobian(dpixel_dpoint[:, :, axis], difference_of_point, dpixel_dpoint, tolerance)
        compared += 1
    at_bound = 0
    choices = traits(camera.model).choices
    for k, value in enumerate(camera.params):
        if k in choices:
            continue
        step = parameter_step(camera.model, k, value)
        one = np.arange(len(camera.params)) == k
        try:
            lenses = [camera.with_params(camera.params + s * step * one) for s in (1, -1)]
        except InputError:
            at_bound += 1  # alpha or xi at the end of its range
            continue
        plus, minus = (lens.project(points)[0] for lens in lenses)
        # Coefficients of any size: per relative change.
        unit = abs(value) if in_pixels(camera.model, k) else 1.0
        check_jacobian(
            unit * dpixel_dparams[:, :, k],
            unit * difference(plus, minus, step),
            unit * dpixel_dparams,
            tolerance,
        )
        compared += 1
    assert at_bound <= 1
    assert compared + at_bound + len(choices) == 3 + len(camera.params)


def in_pixels(model: str, k: int) -> bool:
    """Whether the parameter is a coefficient of a polynomial in pixels, of any size."""
    return (model == "ftheta" and k < 16) or (model == "ocam" and k > 4)


def parameter_step(model: str, k: int, value: float) -> float:
    if in_pixels(model, k):
        return 1e-6 * abs(value)
    # Pixels are linear in the focal lengths.
    focal = (4, 5) if model == "splined_stereographic" else (0, 1)
    return 0.01 * value if k in focal else 1e-6 * max(1.0, abs(value))


def check_jacobian(
    exact: np.ndarray, difference: np.ndarray, whole: np.ndarray, tolerance: float
) -> None:
    """Relative to the largest entry of each point's Jacobian."""
    scale = np.maximum(1.0, np.abs(whole).reshape(len(exact), -1).max(axis=1))[:, None]
    inside = ~np.isnan(difference).any(axis=1)  # a shifted point or lens may leave the domain
    assert inside.mean() > 0.9
    assert (np.abs(exact - difference) / scale)[inside].max() < tolerance


@each_lens
def test_project_jacobian_by_some_parameters_has_the_bits_of_all(camera, rng):
    points = polar_grid(0.9 * camera.max_angle, 5, 7)
    by_point, by_params = camera.project_jacobian(points)
    for count in (0, 1, len(camera.params)):
        chosen = rng.permutation(len(camera.params))[:count]
        alone, some = camera.project_jacobian(points, chosen)
        assert np.array_equal(alone, by_point, equal_nan=True)
        assert np.array_equal(some, by_params[:, :, chosen], equal_nan=True)
    with raises_saying(["with_params names parameter -1 of"]):
        camera.project_jacobian(points, [-1])


@each_lens
def test_project_jacobian_is_zero_along_the_ray(camera):
    points = 3.0 * polar_grid(0.9 * camera.max_angle, 8, 20)
    pixels, _ = camera.project(points)
    points = points[np.abs(pixels).max(axis=1) < NEAR_PIXELS]
    dpixel_dpoint, _ = camera.project_jacobian(points)
    along = np.einsum("nij,nj->ni", dpixel_dpoint, points)
    scale = np.abs(dpixel_dpoint).max(axis=(1, 2))[:, None]
    assert (np.abs(along) / scale).max() < tol.JACOBIAN_ALONG_RAY
    far, _ = camera.project_jacobian(1e120 * points)
    np.testing.assert_allclose(
        1e120 * far / scale[:, None], dpixel_dpoint / scale[:, None], atol=tol.JACOBIAN_ALONG_RAY
    )


@each_lens
def test_project_of_hard_points_is_valid_only_with_finite_pixels_and_derivatives(camera):
    values = (0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e-8, 1e300, -1e300, np.inf, -np.inf, np.nan)
    points = np.array(list(itertools.product(values, repeat=3)))
    pixels, valid = camera.project(points)
    dpixel_dpoint, dpixel_dparams = camera.project_jacobian(points)
    assert valid.sum() > 50 and not valid[(points == 0).all(axis=1)].any()
    np.testing.assert_array_equal(np.asarray(valid), np.isfinite(pixels).all(axis=1))
    assert np.isfinite(dpixel_dparams[valid]).all()
    assert np.isnan(dpixel_dpoint[~valid]).all() and np.isnan(dpixel_dparams[~valid]).all()


def test_rays_match_unproject_and_are_read_only():
    camera = Camera("kannala_brandt", [20, 21, 16, 12, -0.15], 64, 48)
    rays, valid = camera.rays()
    assert rays.shape == (48, 64, 3) and valid.shape == (48, 64) and valid.dtype == bool
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    expected, found = camera.unproject(np.stack([columns, rows], -1).reshape(-1, 2))
    np.testing.assert_array_equal(rays.reshape(-1, 3), expected)
    np.testing.assert_array_equal(valid.ravel(), found)
    assert 0 < valid.sum() < valid.size
    with pytest.raises(ValueError, match="read-only"):
        rays[0, 0, 0] = 1.0
    again, _ = camera.rays()
    assert again.ctypes.data == rays.ctypes.data
    del camera, again
    np.testing.assert_array_equal(rays.reshape(-1, 3), expected)


def test_project_on_any_number_of_threads_has_same_bits():
    camera = next(lens for lens in LENSES if lens.model == "opencv12")
    points = polar_grid(0.999 * camera.max_angle)
    results = []
    for threads in (1, 2, 8):
        set_num_threads(threads)
        pixels, _ = camera.project(points)
        table = camera.resize(80, 60).rays()[0]
        results.append((pixels, camera.unproject(pixels)[0], table))
    assert len(results) == 3
    for result in results[1:]:
        for found, first in zip(result, results[0], strict=True):
            np.testing.assert_array_equal(found, first)


@each_lens
def test_resized_scales_pixels_about_the_corner(camera):
    other = camera.resize(camera.width * 2, camera.height * 3)
    assert (other.width, other.height) == (camera.width * 2, camera.height * 3)
    points = polar_grid(0.9 * camera.max_angle, 16, 20)
    expected, valid = camera.project(points)
    near = valid & (np.abs(expected).max(axis=1) < NEAR_PIXELS)
    pixels, _ = other.project(points[near])
    np.testing.assert_allclose(pixels, expected[near] * [2, 3], rtol=0, atol=tol.CV2_PIXELS)


@each_lens
def test_pickled_camera_compares_equal(camera):
    copy = pickle.loads(pickle.dumps(camera))
    assert copy == camera and hash(copy) == hash(camera)
    np.testing.assert_array_equal(copy.params, camera.params)
    assert camera.model in repr(camera)
    assert copy != camera.resize(camera.width + 1, camera.height)
    assert camera != "camera"


def test_camera_with_extras_keeps_them_through_pickle_and_resize():
    region = [[0, 0], [10, 0], [10, 5]]
    camera = Camera("pinhole", [5, 5, 5, 5], 10, 10, extrinsics=np.arange(6), valid_region=region)
    copy = pickle.loads(pickle.dumps(camera))
    np.testing.assert_array_equal(copy.extrinsics, np.arange(6))
    np.testing.assert_array_equal(copy.valid_region, region)
    np.testing.assert_array_equal(copy.resize(20, 30).valid_region, np.array(region) * [2, 3])


def test_camera_params_are_a_copy():
    camera = Camera("pinhole", [5, 5, 5, 5], 10, 10)
    camera.params[0] = 7.0
    assert camera.params[0] == 5.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fish", [1, 1, 0, 0], 4, 4), ["fish", *camera_models()]),
        (("pinhole", [1, 1, 0], 4, 4), ["pinhole", "fx fy cx cy", "3"]),
        (("opencv5", [1] * 8, 4, 4), ["opencv5", "k3", "8"]),
        (("pinhole", [0, 1, 0, 0], 4, 4), ["fx", "positive"]),
        (("pinhole", [1, np.nan, 0, 0], 4, 4), ["fy", "nan"]),
        (("kannala_brandt", [1, 1, 0, 0, np.inf], 4, 4), ["k1", "finite"]),
        (("pinhole", [1, 1, 0, 0], 0, 4), ["0 x 4"]),
    ],
)
def test_camera_of_bad_arguments_raises_and_says_why(arguments, words):
    with raises_saying(words):
        Camera(*arguments)


def test_project_of_wrong_shape_raises():
    camera = OPENCV_LENSES[0]
    for call, array in [
        (camera.project, np.zeros((3, 2))),
        (camera.project_jacobian, np.zeros(3)),
        (camera.unproject, np.zeros((4, 3))),
    ]:
        with pytest.raises(InputError, match="shape"):
            call(array)


def test_camera_that_was_refused_can_be_printed():
    with pytest.raises(InputError) as error:
        Camera("pinhole", [-1.0, 1.0, 1.0, 1.0], 10, 10)
    made = [entry.frame.f_locals["self"] for entry in error.traceback if "self" in entry.locals]
    assert {repr(camera) for camera in made} == {"Camera(refused)"}


@pytest.mark.parametrize("model", ["kannala_brandt", "ocam"])
def test_lens_of_many_coefficients_is_refused_at_once(model):
    camera = next(lens for lens in LENSES if lens.model == model)
    params = [*camera.params, *[0.0] * 1_000_000]
    with pytest.raises(InputError, match="at most 100 parameters, found 1000"):
        Camera(model, params, camera.width, camera.height)
