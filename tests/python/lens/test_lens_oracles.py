"""Tests the lenses against pycolmap, libmrcal, cv2.omnidir and closed forms in long double."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import tolerances as tol
from gsut import _core
from gsut.lens.camera import Camera
from lens_cases import examples, polar_grid
from raising import raises_saying

VECTORS = json.loads(
    (Path(__file__).parents[2] / "oracles" / "lens_vectors.json").read_text(encoding="utf-8")
)
# Coordinates below which the absolute tolerance holds.
NEAR_PIXELS = 1e4
Real = np.longdouble


def test_lens_vectors_cover_the_lenses():
    assert len(VECTORS) == 22
    assert len({vector["model"] for vector in VECTORS}) == 13


@pytest.mark.parametrize("vector", VECTORS, ids=lambda v: f"{v['model']}-{v['width']}")
def test_project_agrees_with_pycolmap_and_libmrcal(vector):
    camera = Camera(vector["model"], vector["params"], vector["width"], vector["height"])
    points, expected = np.array(vector["points"]), np.array(vector["pixels"])
    pixels, valid = camera.project(points)
    assert valid.all()
    near = np.abs(expected).max(axis=1) < NEAR_PIXELS
    assert near.sum() >= 30
    np.testing.assert_allclose(pixels[near], expected[near], rtol=0, atol=tol.LENS_ORACLE_PIXELS)


@pytest.mark.parametrize("camera", examples("mei"), ids=lambda c: f"mei-{c.width}")
def test_mei_agrees_with_cv2_omnidir(camera):
    fx, fy, cx, cy, skew, xi, *distortion = camera.params
    matrix = np.array([[fx, skew, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])
    points = 1.7 * polar_grid(0.999 * camera.max_angle, 48, 60)
    zero = np.zeros(3)
    expected, _ = cv2.omnidir.projectPoints(
        points[:, None], zero, zero, matrix, xi, np.array(distortion)
    )
    pixels, valid = camera.project(points)
    assert valid.all()
    near = np.abs(pixels).max(axis=1) < NEAR_PIXELS
    assert near.sum() > 2000
    expected = expected.reshape(-1, 2)[near] + 0.5
    np.testing.assert_allclose(pixels[near], expected, rtol=0, atol=tol.LENS_ORACLE_PIXELS)


def unified_direction(points, xi, alpha):
    """Two casts onto unit spheres and a division, in the words of the paper of double sphere."""
    n = np.sqrt((points**2).sum(axis=1))
    first = points / n[:, None] + np.array([0, 0, xi], Real)
    second = first / np.sqrt((first**2).sum(axis=1))[:, None]
    shift = alpha / (1 - alpha)
    return second[:, :2] / (second[:, 2:] + shift) * (1 + shift)


def scaled(ratio, params):
    """The division above is by (z + shift), the lens' by alpha d + (1 - alpha) z."""
    fx, fy, cx, cy = params[:4]
    return ratio * (np.array([fx, fy], Real)) + np.array([cx, cy], Real)


@pytest.mark.parametrize("camera", examples("double_sphere"), ids=lambda c: f"ds-{c.width}")
def test_double_sphere_agrees_with_long_double(camera):
    points = polar_grid(0.99 * camera.max_angle, 48, 60)
    params = camera.params.astype(Real)
    ratio = unified_direction(points.astype(Real), params[4], params[5])
    # x / (z + s) (1 + s) = x / (alpha + (1 - alpha) z) for a unit vector, s = alpha / (1 - alpha).
    expected = scaled(ratio, params)
    pixels, valid = camera.project(points)
    assert valid.all()
    near = np.abs(pixels).max(axis=1) < NEAR_PIXELS
    assert near.sum() > 2000
    error = np.abs(pixels[near] - expected[near].astype(float))
    assert error.max() < tol.LENS_ORACLE_PIXELS


@pytest.mark.parametrize("camera", examples("orthographic"))
def test_orthographic_agrees_with_long_double(camera):
    points = np.random.default_rng(5).normal([0, 0, 7.0], 2.0, (500, 3))
    pixels, valid = camera.project(points)
    expected = scaled(points[:, :2].astype(Real), camera.params.astype(Real))
    assert valid.sum() > 400
    error = np.abs(pixels - expected.astype(float))[valid]
    assert error.max() < tol.LENS_ORACLE_PIXELS


@pytest.mark.parametrize("camera", examples("ftheta"), ids=["angle-to-pixel", "pixel-to-angle"])
def test_ftheta_agrees_with_long_double(camera):
    points = polar_grid(0.999 * camera.max_angle, 48, 60)
    x, y, z = points.T.astype(Real)
    theta = np.arctan2(np.hypot(x, y), z)
    params = camera.params.astype(Real)
    pixel_to_angle, angle_to_pixel = params[3:9], params[9:15]
    if params[2] == 1:
        radius = sum(a * theta**i for i, a in enumerate(angle_to_pixel))
    else:  # bisection of B(r) = theta
        low, high = np.zeros_like(theta), np.full_like(theta, 1000)
        for _ in range(90):
            middle = (low + high) / 2
            below = sum(b * middle**i for i, b in enumerate(pixel_to_angle)) < theta
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        radius = low
    phi = np.arctan2(y, x)
    dx, dy = radius * np.cos(phi), radius * np.sin(phi)
    c, d, e = params[16:]
    expected = np.stack([c * dx + d * dy + params[0], e * dx + dy + params[1]], axis=1)
    pixels, valid = camera.project(points)
    assert valid.all() and len(points) > 2000
    assert np.abs(pixels - expected.astype(float)).max() < tol.LENS_ORACLE_PIXELS


def test_unified_is_mei_without_distortion():
    checked = 0
    for camera in examples("unified"):
        fx, fy, cx, cy, alpha = camera.params
        xi = alpha / (1 - alpha)
        mei = Camera("mei", [fx * (1 + xi), fy * (1 + xi), cx, cy, 0, xi, 0, 0, 0, 0], 8, 8)
        assert mei.max_angle == pytest.approx(camera.max_angle, abs=1e-6)
        points = polar_grid(0.98 * camera.max_angle, 32, 40)
        np.testing.assert_allclose(
            mei.project(points)[0], camera.project(points)[0], rtol=tol.LENS_ORACLE_RELATIVE
        )
        checked += len(points)
    assert checked > 3000


def test_domain_ends_of_closed_forms():
    def angle(model, *tail):
        return Camera(model, [200, 200, 320, 240, *tail], 640, 480).max_angle

    def cosine(value):
        return pytest.approx(np.arccos(value), abs=tol.DOMAIN_ANGLE)

    # Folds: where the derivative of the radius vanishes.
    assert angle("unified", 0.6) == cosine(-0.4 / 0.6)
    assert angle("unified", 0.8) == cosine(-0.2 / 0.8)
    assert angle("extended_unified", 0.6, 1.0) == cosine(-0.4 / 0.6)
    assert angle("double_sphere", 0.0, 0.6) == cosine(-0.4 / 0.6)
    assert angle("mei", 0.0, 2.5, 0, 0, 0, 0) == cosine(-1 / 2.5)
    assert angle("division", 0.3) == pytest.approx(
        np.arctan(0.5 / np.sqrt(0.3)), abs=tol.DOMAIN_ANGLE
    )
    # Poles: less the angle whose pixels lie beyond 5e8.
    assert angle("unified", 0.3) == pytest.approx(np.arccos(-0.3 / 0.7), abs=1e-5)
    assert angle("double_sphere", -0.5, 0.0) == pytest.approx(np.arccos(0.5), abs=1e-5)
    assert angle("mei", 0.0, 0.5, 0, 0, 0, 0) == pytest.approx(np.arccos(-0.5), abs=1e-5)
    assert angle("stereographic") == pytest.approx(np.pi, abs=1e-5)
    assert angle("fov", 0.9) == np.pi


@pytest.mark.parametrize(
    ("model", "params", "words"),
    [
        ("unified", [1, 1, 0, 0, 1.1], ["alpha", "1.1", "between 0 and 1"]),
        ("extended_unified", [1, 1, 0, 0, 0.5, -1], ["beta", "-1"]),
        ("double_sphere", [1, 1, 0, 0, 1.5, 0.5], ["xi", "1.5"]),
        ("fov", [1, 1, 0, 0, 0], ["omega", "0"]),
        ("mei", [1, 1, 0, 0, 0, -1, 0, 0, 0, 0], ["xi", "-1"]),
        ("equirectangular", [1], ["none", "1 values"]),
        ("splined_stereographic", [4, 4, 4, 90, 1, 1, 0, 0, 0], ["order is 4"]),
        ("splined_stereographic", [3, 4, 4, 90, 1, 1, 0, 0, 0], ["40 values", "found 9"]),
        ("splined_stereographic", [3, 4, 3, 90, 1, 1, 0, 0, 0], ["Nx, Ny are 4, 3"]),
        ("ftheta", [0, 0, 2, *[0.0] * 16], ["reference", "2"]),
    ],
)
def test_lens_of_bad_parameters_raises_and_says_why(model, params, words):
    with raises_saying([model, *words]):
        Camera(model, params, 8, 8)


def test_ftheta_of_inconsistent_polynomials_raises():
    params = examples("ftheta")[1].params.copy()
    params[10] *= -0.5
    with pytest.raises(_core.InputError, match="A1"):
        Camera("ftheta", params, 8, 8)
    params = examples("ftheta")[1].params.copy()
    params[11:15] = [4000.0, -9000.0, 0.0, 0.0]
    with pytest.raises(_core.InputError, match="not the inverse of the reference B"):
        Camera("ftheta", params, 8, 8)
