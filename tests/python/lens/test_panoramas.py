"""Tests the panoramas: every direction, the seam, the poles, and pixels beyond them."""

import numpy as np
import pytest

import tolerances as tol
from gsut.lens.camera import Camera
from lens_cases import real_lenses

CAMERAS = [camera for camera in real_lenses() if camera.is_panorama]
each = pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.model}-{c.width}")


def poles(camera: Camera) -> np.ndarray:
    up = [0.0, 1.0, 0.0] if camera.model != "latlon" else [1.0, 0.0, 0.0]
    return np.array([up, [-value for value in up]])


def test_panoramas_are_all_there():
    assert len(CAMERAS) >= 5


@each
def test_whole_sphere_is_valid_but_the_poles(camera, rng):
    assert camera.max_angle == np.pi
    rays = rng.normal(size=(20_000, 3))
    axes = np.array([[0, 0, 1.0], [0, 0, -1.0], [-0.0, -0.0, -1.0], [1, 0, -1], [0, 1, -1]])
    pixels, valid = camera.project(np.concatenate([axes, rays]))
    assert valid.all() and np.isfinite(pixels).all()
    pixels, valid = camera.project(poles(camera))
    assert not valid.any() and np.isnan(pixels).all()
    # As near a pole as the square of a double can say.
    _, valid = camera.project(poles(camera) + np.array([[1e-150, 1e-150, 1e-150]]))
    assert valid.all()


@each
def test_unproject_around_seam_and_poles_returns_the_ray(camera):
    offsets = np.array([0.0, 1e-15, 1e-9, 1e-3, 0.5])
    angles = np.concatenate([np.pi - offsets, -np.pi + offsets])
    latitudes = np.concatenate([[-0.5, 0.0, 1.2], np.pi / 2 - offsets[2:], offsets[2:] - np.pi / 2])
    lon, lat = (grid.ravel() for grid in np.meshgrid(angles, latitudes))
    across, up, ahead = np.sin(lon) * np.cos(lat), np.sin(lat), np.cos(lon) * np.cos(lat)
    order = (up, across, ahead) if camera.model == "latlon" else (across, up, ahead)
    points = np.stack(order, axis=1)
    pixels, valid = camera.project(points)
    assert valid.all() and len(points) == 90
    rays, found = camera.unproject(pixels)
    assert found.all()
    assert np.abs(rays - points).max() < tol.PANORAMA_RAYS
    back, valid = camera.project(rays)
    assert valid.all()
    # A degree of longitude is nothing next to a pole: pixels there are as exact as the ray allows.
    clear = np.abs(lat) < 1.5
    assert np.abs(back - pixels)[clear].max() < tol.ROUND_TRIP_PIXELS


@each
def test_pixels_beyond_seam_and_poles_are_invalid(camera):
    right, left, down, up = (
        camera.project(np.array([point]))[0][0]
        for point in ([1e-12, 0, -1], [-1e-12, 0, -1], [1e-12, 1, 1e-12], [1e-12, -1, 1e-12])
    )
    if camera.model == "latlon":
        down, up = (
            camera.project(np.array([point]))[0][0] for point in ([1, 0, 1e-12], [-1, 0, 1e-12])
        )
        right, left = (
            camera.project(np.array([point]))[0][0] for point in ([0, 1e-12, -1], [0, -1e-12, -1])
        )
    for edge, other in ((right, left), (left, right), (down, up), (up, down)):
        outward = (edge - other) / np.linalg.norm(edge - other)
        for distance, inside in ((-1e-3, True), (1e-3, False), (10.0, False)):
            _, valid = camera.unproject((edge + distance * outward)[None])
            assert valid[0] == inside


def test_equirectangular_image_edges_are_the_seam_and_the_poles():
    camera = Camera("equirectangular", [], 360, 180)
    points = np.array([[0, 0, 1.0], [1, 0, 0], [-1, 0, 0], [0, 1, 1], [0.0, 0, -1], [-0.0, 0, -1]])
    pixels, valid = camera.project(points)
    expected = [[180, 90], [270, 90], [90, 90], [180, 135], [360, 90], [0, 90]]
    assert valid.all()
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=tol.LENS_ORACLE_PIXELS)
    rays, valid = camera.unproject(np.array([[0.0, 90], [360, 90], [180, 0], [180, 180]]))
    np.testing.assert_array_equal(valid, [True, True, False, False])
    assert np.abs(rays[:2] - [0, 0, -1]).max() < tol.PANORAMA_RAYS
    _, valid = camera.rays()
    assert valid.all()
    assert camera.params.shape == (0,)
    assert camera.project_jacobian(points)[1].shape == (6, 2, 0)


@each
def test_valid_field_angle_cuts_a_cone_out_of_the_sphere(camera):
    cut = camera.with_valid_field_angle(2.0)
    assert cut.max_angle == 2.0
    points = np.array([[np.sin(a), 0.01, np.cos(a)] for a in (1.9, 2.1, -1.9, -2.1, np.pi)])
    np.testing.assert_array_equal(cut.project(points)[1], [True, False, True, False, False])
    pixels, _ = camera.project(points)
    np.testing.assert_array_equal(cut.unproject(pixels)[1], [True, False, True, False, False])


@each
def test_pixel_difference_goes_the_short_way_round(camera, rng):
    pixels = rng.uniform(0, [camera.width, camera.height], (200, 2))
    small = rng.normal(0, 3.0, pixels.shape)
    copies = rng.integers(-1, 2, pixels.shape) * np.array(camera.period)
    difference = camera.subtract_pixels(pixels + small + copies, pixels)
    np.testing.assert_allclose(difference, small, rtol=0, atol=tol.LENS_FILE_PARAMS)
