"""Tests harmonics and seeding through Python."""

import numpy as np
import pytest
from scipy import special
from scipy.spatial import cKDTree

import tolerances
from gsut import InputError, _core, set_num_threads
from gsut.gaussians import rotations_from_quaternions, seeding
from random_scenes import arrays_of, assert_same, fisheye


def unit_vectors(rng, count):
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def scipy_real_harmonics(degree, directions):
    """Real harmonics with the Condon-Shortley phase, from scipy's complex ones."""
    polar = np.arccos(np.clip(directions[:, 2], -1, 1))
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for order_l in range(degree + 1):
        for m in range(-order_l, order_l + 1):
            if hasattr(special, "sph_harm_y"):
                value = special.sph_harm_y(order_l, abs(m), polar, azimuth)
            else:
                value = special.sph_harm(abs(m), order_l, azimuth, polar)
            part = value.real if m >= 0 else value.imag
            columns.append(part * (1.0 if m == 0 else np.sqrt(2.0)))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_basis_on_random_directions_matches_scipy(rng, degree):
    directions = unit_vectors(rng, 500)
    basis = _core.harmonics_basis(degree, directions)
    expected = scipy_real_harmonics(degree, directions)
    assert basis.shape == (500, (degree + 1) ** 2)
    np.testing.assert_allclose(basis, expected, rtol=0, atol=tolerances.HARMONICS)


def test_eval_harmonics_with_zero_coefficients_is_mid_grey(rng):
    colors = _core.eval_harmonics(unit_vectors(rng, 5), np.zeros((5, 16, 3)))
    assert np.all(colors == 0.5)


def test_eval_harmonics_below_zero_is_clamped():
    colors = _core.eval_harmonics(np.array([[0, 0, 1.0]]), np.full((1, 1, 3), -9.0))
    assert np.all(colors == 0.0)


def test_harmonics_basis_of_degree_4_raises():
    with pytest.raises(InputError, match="degree is 4"):
        _core.harmonics_basis(4, np.zeros((1, 3)))


def distances_to_neighbors(points):
    """(N,): mean to the three nearest other points, by scipy."""
    return cKDTree(points).query(points, k=min(4, len(points)))[0][:, 1:].mean(axis=1)


@pytest.mark.parametrize("count", [2, 3, 4, 13, 50, 3000])
@pytest.mark.parametrize("shape", ["volume", "line", "grid"])
def test_seed_from_points_is_as_wide_as_neighbors_are_far(rng, count, shape):
    points = rng.normal(size=(count, 3)) * [10, 1, 0.01]
    if shape == "line":
        points[:, 1:] = 1.5
    if shape == "grid":  # of which many are as far as others
        points = np.stack(np.unravel_index(rng.permutation(count), (15, 15, 15)), 1) / 4.0
    made = []
    for threads in (1, 8):
        set_num_threads(threads)
        made.append(arrays_of(seeding.seed_from_points(points, scale_factor=0.4)))
    set_num_threads(0)
    assert made[0] == made[1]
    g = seeding.seed_from_points(points, scale_factor=0.4)
    if shape == "line":  # it has no plane
        assert np.array_equal(g.log_scales[:, 2], g.log_scales[:, 0])
    expected = np.log(0.4 * distances_to_neighbors(points))
    for axis in (0, 1):
        np.testing.assert_allclose(
            g.log_scales[:, axis], expected, rtol=tolerances.FLOAT32, atol=tolerances.FLOAT32
        )


def test_seed_from_points_lies_in_the_plane_of_ten_points(rng):
    points = rng.normal(size=(200, 3)) * [1, 1, 0.1]
    g = seeding.seed_from_points(points)
    near = cKDTree(points).query(points, k=10)[1]
    for row in range(200):
        offsets = points[near[row]] - points[near[row]].mean(axis=0)
        _, lengths, axes = np.linalg.svd(offsets)
        found = rotations_from_quaternions(g.quats[row : row + 1].astype(np.float64))[0]
        # A direction turns by rounding over the difference of two lengths.
        rounding = tolerances.FLOAT32 / (1 - lengths[2] / lengths[1])
        assert abs(abs(found[:, 2] @ axes[2]) - 1) < rounding
        assert np.linalg.det(found) > 0
        ratio = np.exp(g.log_scales[row, 2] - g.log_scales[row, 0])
        expected = max(0.2, lengths[2] / lengths[1])
        np.testing.assert_allclose(ratio, expected, rtol=tolerances.ACTIVATED_FLOAT32)


def test_seed_from_points_takes_color_and_opacity_from_the_recipe(rng):
    points = rng.normal(size=(200, 3))
    colors = rng.integers(0, 256, size=(200, 3), dtype=np.uint8)
    g = seeding.seed_from_points(points, colors, sh_degree=2)
    assert g.sh.shape == (200, 9, 3) and g.dtype == np.float32
    np.testing.assert_array_equal(g.means, points.astype(np.float32))
    assert np.all(g.opacity_logits == 0.0)
    np.testing.assert_allclose(
        g.log_scales[:, 0],
        np.log(0.7 * distances_to_neighbors(points)),
        rtol=tolerances.FLOAT32,
        atol=tolerances.FLOAT32,
    )
    shown = _core.eval_harmonics(np.tile([0, 0, 1.0], (200, 1)), g.sh[:, :1])
    np.testing.assert_allclose(shown, colors / 255.0, rtol=0, atol=tolerances.FLOAT32)
    assert np.all(g.sh[:, 1:] == 0)


def test_seed_from_points_with_duplicates_has_a_floor(rng):
    points = np.concatenate([rng.normal(size=(100, 3)), np.ones((5, 3))])
    g = seeding.seed_from_points(points)
    distances = distances_to_neighbors(points)
    floor = 0.01 * np.sort(distances[distances > 0])[50]
    np.testing.assert_allclose(
        np.exp(g.log_scales[100:, :2]), 0.7 * floor, rtol=tolerances.ACTIVATED_FLOAT32
    )


@pytest.mark.parametrize("count", [0, 1, 7])
def test_seed_from_points_without_extent_uses_one_world_unit(count):
    g = seeding.seed_from_points(np.full((count, 3), 3.0), scale_factor=0.25)
    assert len(g) == count
    np.testing.assert_allclose(np.exp(g.log_scales), 0.25, rtol=tolerances.ACTIVATED_FLOAT32)


def test_seed_from_points_above_the_limit_chooses_distinct_points_in_order(rng):
    points = np.arange(300.0)[:, None] * [1.0, 0, 0]
    first = seeding.seed_from_points(points, max_gaussians=100, seed=1)
    again = seeding.seed_from_points(points, max_gaussians=100, seed=1)
    other = seeding.seed_from_points(points, max_gaussians=100, seed=2)
    assert len(first) == 100 and np.all(np.diff(first.means[:, 0]) > 0)
    np.testing.assert_array_equal(first.means, again.means)
    assert not np.array_equal(first.means, other.means)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": np.zeros((3, 2))}, "points must have shape"),
        ({"points": np.zeros((3, 3)), "colors": np.zeros((2, 3))}, "colors must have shape"),
        ({"points": np.zeros((3, 3)), "colors": np.zeros((3, 3), np.int64)}, "uint8 or floating"),
        ({"points": np.zeros((3, 3)), "colors": np.full((3, 3), 200.0)}, "give those .* as uint8"),
        ({"points": np.full((3, 3), np.nan)}, "points row 0"),
        ({"points": np.zeros((3, 3)), "opacity": 1.0}, "opacity is"),
        ({"points": np.zeros((3, 3)), "scale_factor": 0.0}, "scale_factor is"),
        ({"points": np.zeros((3, 3)), "sh_degree": 4}, "sh_degree is 4"),
        ({"points": np.zeros((3, 3)), "max_gaussians": -1}, "max_gaussians is -1"),
    ],
)
def test_seed_from_points_with_bad_input_raises(arguments, message):
    with pytest.raises(InputError, match=message):
        seeding.seed_from_points(**arguments)


def turned_pose():
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = [3.0, -2.0, 1.0]
    return pose


def test_points_in_view_lie_on_valid_rays_between_the_bounds():
    pose = turned_pose()
    points = seeding.sample_points_in_view(
        fisheye(degrees=200.0), pose[None], 5000, near=0.5, far=8.0, seed=3
    )
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    distance = np.linalg.norm(in_camera, axis=1)
    assert distance.min() >= 0.5 - tolerances.VIEW_DISTANCE
    assert distance.max() <= 8.0 + tolerances.VIEW_DISTANCE
    angle = np.degrees(np.arccos(in_camera[:, 2] / distance))
    assert 90 < angle.max() < 100  # the field beyond a half-space is filled, and not more
    assert abs(np.median(distance) / 2.0 - 1) < tolerances.VIEW_MEDIAN


def test_seed_in_view_with_the_same_seed_gives_the_same_bits():
    poses, camera = np.stack([np.eye(4), turned_pose()]), fisheye()
    settings = {"near": 1.0, "far": 5.0}
    first = seeding.seed_in_view([camera, camera], poses, 300, seed=4, **settings)
    again = seeding.seed_in_view(camera, poses, 300, seed=4, **settings)
    other = seeding.seed_in_view(camera, poses, 300, seed=5, **settings)
    assert_same(again, first)
    assert np.all(first.sh == 0) and np.any(first.means != other.means)


def test_seed_in_view_that_is_impossible_is_refused():
    params = [60, 60, -90, -90, 0, 0, 0, 0]
    corner = _core.Camera("kannala_brandt", params, 8, 8, valid_field_angle=1)
    with pytest.raises(InputError, match="no valid pixel"):
        seeding.seed_in_view(corner, np.eye(4)[None], 5, near=1.0, far=2.0)
    with pytest.raises(InputError, match="near < far"):
        seeding.seed_in_view(fisheye(), np.eye(4)[None], 5, near=2.0, far=1.0)
