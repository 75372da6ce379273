"""Tests the lenses' domains and inverses: one-to-one, tight, and invertible up to the edge."""

import numpy as np
import pytest

import tolerances as tol
from gsut import InputError
from gsut.lens.camera import Camera, camera_models
from lens_cases import HARD_LENSES, all_lenses, centre, circle, polar_grid, traits

LENSES = all_lenses()
CONES = [camera for camera in LENSES if camera.is_cone]
each_cone = pytest.mark.parametrize("camera", CONES, ids=lambda c: f"{c.model}-{c.width}")
each_lens = pytest.mark.parametrize("camera", LENSES, ids=lambda c: f"{c.model}-{c.width}")


def determinants(camera: Camera, rays: np.ndarray) -> np.ndarray:
    """Pixels squared per steradian along unit rays: positive where the lens does not fold."""
    dpixel_dpoint, _ = camera.project_jacobian(rays)
    rows = [dpixel_dpoint[:, 0], dpixel_dpoint[:, 1], rays]
    return np.linalg.det(np.stack(rows, axis=1))


def test_lens_cases_hold_every_model():
    central = {model for model in camera_models() if traits(model).is_central}
    # The others, whose rays do not meet, have tests of their own in test_lines.py.
    assert {camera.model for camera in LENSES} == central
    assert len(LENSES) >= 32 + len(HARD_LENSES) and len(central) >= 20


@each_lens
@pytest.mark.parametrize("part", [0.999, 1 - 1e-6])
def test_unproject_whole_domain_returns_the_ray(camera, part):
    points = polar_grid(part * camera.max_angle)
    pixels, valid = camera.project(points)
    if not camera.is_cone:
        # Not between two sectors, where rounding chooses the edge.
        for turn in (1e-9, -1e-9):
            x, y, z = points.T
            valid &= camera.project(np.stack([x - turn * y, y + turn * x, z], axis=1))[1]
        assert valid.sum() > 2000
        points, pixels, valid = points[valid], pixels[valid], valid[valid]
    assert valid.all()
    rays, found = camera.unproject(pixels)
    assert found.all()
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, rtol=0, atol=tol.UNIT_LENGTH)
    back, valid = camera.project(rays)
    assert valid.all()
    error = np.abs(back - pixels).max(axis=1)
    # Where rounding of the pixel or of the ray is larger than the promise: next to a pole.
    gain = np.linalg.norm(camera.project_jacobian(rays)[0], axis=(1, 2))
    rounding = tol.ROUND_TRIP_ULPS * np.maximum(np.abs(pixels).max(axis=1), gain)
    assert (error < np.maximum(tol.ROUND_TRIP_PIXELS, rounding)).all()
    usable = (np.abs(pixels).max(axis=1) < 1e5) & (gain < 1e5)
    assert usable.sum() > 100
    assert (error[usable] < tol.ROUND_TRIP_PIXELS).all()


@each_lens
def test_project_beyond_domain_is_invalid_and_nan(camera):
    if camera.max_angle == np.pi:
        return  # nothing lies beyond
    rest = np.pi - camera.max_angle
    for angle in (0.001 * rest, 0.1 * rest, 0.5 * rest, 0.999 * rest, 1e-9 * camera.max_angle):
        pixels, valid = camera.project(circle(camera.max_angle + min(angle, rest), 50))
        assert not valid.any()
        assert np.isnan(pixels).all()


@each_lens
def test_unproject_far_and_bad_pixels_are_invalid_and_nan(camera):
    bad = np.array([[np.nan, 1], [1, np.nan], [np.inf, 1], [1, -np.inf], [1e12, 1], [1, -1e300]])
    rays, valid = camera.unproject(bad)
    assert not valid.any()
    assert np.isnan(rays).all()


@each_cone
def test_unproject_around_edge_is_valid_inside_only(camera):
    if camera.is_panorama:
        return  # see test_panoramas.py
    # The image of a circle just inside the edge, scaled about the image of the axis.
    edge, valid = camera.project(circle(camera.max_angle * (1 - 1e-12), 64))
    assert valid.all()
    axis = centre(camera)
    rays, valid = camera.unproject(axis + (edge - axis) * 1.001)
    assert not valid.any()
    assert np.isnan(rays).all()
    _, valid = camera.unproject(axis + (edge - axis) * 0.999)
    assert valid.all()


@each_cone
def test_domain_is_one_to_one(camera):
    for part in (0.1, 0.5, 0.9, 0.999, 1 - 1e-6):
        rays = circle(part * camera.max_angle, 721)
        assert (determinants(camera, rays) > 0).all()
        if camera.is_panorama:
            continue
        # Once around the image of the axis, strictly forward.
        offset = camera.project(rays)[0] - centre(camera)
        turn = np.angle(np.roll(offset @ [1, 1j], -1) / (offset @ [1, 1j]))
        assert (turn > 0).all() and turn.sum() == pytest.approx(2 * np.pi)


@each_cone
def test_domain_is_tight(camera):
    if camera.max_angle > np.radians(175.0):
        return  # next to nothing lies beyond
    if "max_angle" in camera.param_names:
        return  # the lens says itself where it ends
    edge = circle((1 - 1e-9) * camera.max_angle, 4096)
    pixels, valid = camera.project(edge)
    assert valid.all()
    if np.abs(pixels).max() > 1e8:
        return  # ended where pixels go to infinity
    # Somewhere on the edge the map folds: the determinant is nearly gone. Per area of the plane
    # (X/Z, Y/Z), for the lenses that have it: a steradian near 90 degrees is a large part of it.
    same = [other for other in LENSES if other.model == camera.model]
    gnomonic = all(other.max_angle <= 0.5 * np.pi for other in same)
    area = np.abs(edge[:, 2]) ** 3 if gnomonic else 1.0
    axis = determinants(camera, np.array([[0, 0, 1.0]]))[0]
    left = (area * determinants(camera, edge)).min()
    before = determinants(camera, circle((1 - 1e-6) * camera.max_angle, 4096)).min()
    at_fold = left < max(tol.DOMAIN_EDGE * axis, tol.DOMAIN_EDGE_STEP * before)
    # Or the pixel's derivative grows without bound.
    assert at_fold or left > before / tol.DOMAIN_EDGE_STEP


@pytest.mark.parametrize(
    "camera", [c for c in LENSES if not c.is_cone], ids=lambda c: f"{c.model}-{c.params[0]:g}"
)
def test_domain_of_every_direction_ends_at_a_fold_or_the_control_points(camera):
    order, nx, ny, fov = camera.params[:4]
    density = (nx - order) / (4 * np.tan(np.radians(fov) / 4))
    angles = np.linspace(0.001, camera.max_angle, 2000)
    directions = np.linspace(0, 2 * np.pi, 37)[:-1]
    for x, y in zip(np.cos(directions), np.sin(directions), strict=True):
        rays = np.stack([np.sin(angles) * x, np.sin(angles) * y, np.cos(angles)], axis=1)
        _, valid = camera.project(rays)
        last = len(rays) if valid.all() else int(valid.argmin())
        assert last > 200 and not valid[last:].any()  # connected to the axis
        inside = determinants(camera, rays[:last])
        assert (inside > 0).all()
        radius = 2 * np.tan(angles[last - 1] / 2)
        points_end = min((nx - 1) / 2 / max(abs(x), 1e-9), (ny - 1) / 2 / max(abs(y), 1e-9))
        # Sectors end early by what their sides differ.
        near_end = radius > tol.SPLINE_SECTOR * points_end / density
        assert near_end or inside[-1] < tol.SPLINE_EDGE * inside[0]


def test_max_angle_of_known_lenses_is_the_closed_form():
    fisheye = Camera("kannala_brandt", [300, 310, 320, 240, -0.2], 640, 480)
    assert fisheye.max_angle == pytest.approx(np.sqrt(1 / 0.6), abs=tol.DOMAIN_ANGLE)
    whole = Camera("kannala_brandt", [300, 310, 320, 240], 640, 480)
    assert whole.max_angle == np.pi
    barrel = Camera("opencv4", [300, 310, 320, 240, -0.2, 0, 0, 0], 640, 480)
    assert barrel.max_angle == pytest.approx(np.arctan(np.sqrt(1 / 0.6)), abs=tol.DOMAIN_ANGLE)
    # x + 3 p2 x^2 + p2 y^2, y + 2 p2 x y: the first factor of the determinant to vanish is
    # 1 + 6 p2 x, on the x axis.
    tangential = Camera("opencv4", [300, 300, 320, 240, 0, 0, 0, 0.1], 640, 480)
    assert tangential.max_angle == pytest.approx(np.arctan(1 / 0.6), rel=tol.DOMAIN_MARGIN)


def test_max_angle_of_pole_ends_at_pixels_of_5e8():
    pole = Camera("opencv8", [500, 500, 320, 240, 0, 0, 0, 0, 0, -0.25, 0, 0], 640, 480)
    assert np.arctan(2.0) - 1e-5 < pole.max_angle < np.arctan(2.0)
    pinhole = Camera("pinhole", [500, 500, 320, 240], 640, 480)
    assert pinhole.max_angle == pytest.approx(np.arctan(1e6), abs=tol.DOMAIN_ANGLE)


def test_real_rational_lens_with_fold_masks_the_corners():
    # OPENCV8 fitted to a fisheye: rising only to 75 degrees, while the image reaches further.
    params = next(
        camera.params for camera in LENSES if camera.model == "opencv8" and camera.width == 960
    )
    _, valid = Camera("opencv8", params, 960, 600).rays()
    assert valid[300, 480] and not valid[0, 0] and not valid[-1, -1]
    assert 0.4 < valid.mean() < 0.6


def test_kannala_brandt_behind_and_beside_camera_projects():
    camera = Camera("kannala_brandt", [100, 100, 50, 60], 100, 120)
    points = np.array([[1.0, 0, 0], [0, -2.0, 0], [3.0, 0, -3.0], [0, 0, 5.0]])
    pixels, valid = camera.project(points)
    assert valid.all()
    expected = [[50 + 50 * np.pi, 60], [50, 60 - 50 * np.pi], [50 + 75 * np.pi, 60], [50, 60]]
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=tol.CV2_PIXELS)
    _, valid = camera.project(np.array([[0, 0, -1.0], [0, 0, 0.0]]))
    assert not valid.any()


def test_valid_field_angle_masks_points_and_pixels():
    whole = Camera("kannala_brandt", [100, 100, 50, 60], 100, 120)
    camera = Camera("kannala_brandt", [100, 100, 50, 60], 100, 120, valid_field_angle=1.0)
    assert camera.max_angle == 1.0 and camera.valid_field_angle == 1.0
    assert whole.valid_field_angle is None and whole.with_valid_field_angle(1.0) == camera
    assert camera.with_valid_field_angle(None) == whole
    with pytest.raises(InputError, match=r"give math.radians\(95\)"):
        camera.with_valid_field_angle(95)
    points = np.concatenate([circle(0.999, 1), circle(1.001, 1)])
    pixels, _ = whole.project(points)
    np.testing.assert_array_equal(camera.project(points)[1], [True, False])
    np.testing.assert_array_equal(camera.unproject(pixels)[1], [True, False])
