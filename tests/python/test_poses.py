"""Tests rigid transforms: the exponential at any angle, and which matrices are one."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core

pytestmark = pytest.mark.quick


def make_twist(rng, angle):
    v, w = rng.uniform(-0.5, 0.5, (2, 3))
    return np.concatenate([0.5 * v / np.linalg.norm(v), angle * w / np.linalg.norm(w)])


def sum_series(xi):
    """exp of the 4 x 4 matrix [[w]x v; 0 0] by its power series."""
    v, (x, y, z) = xi[:3], xi[3:]
    generator = np.array([[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]])
    total = term = np.eye(4)
    for k in range(1, 41):
        term = term @ generator / k
        total = total + term
    return total


@pytest.mark.parametrize("angle", [1e-300, 1e-12, 1e-6, 0.9e-4, 1.1e-4, 0.01, 1.0, 3.0, np.pi, 5.0])
def test_exponential_matches_the_power_series_at_any_angle(rng, angle):
    for _ in range(10):
        xi = make_twist(rng, angle)
        found = gsut.exp_pose(xi)
        assert np.abs(found - sum_series(xi)).max() < tolerances.POSE_SERIES
        turn = found[:3, :3]
        assert np.linalg.norm(turn.T @ turn - np.eye(3)) < tolerances.POSE_ROUNDING


def test_exact_rotation_is_kept_and_a_rounded_one_cleaned(rng):
    exact = gsut.exp_pose(make_twist(rng, 1.0))
    np.testing.assert_array_equal(_core.checked_pose(exact), exact)
    printed = np.round(exact, 5)  # five digits, as some files have
    cleaned = _core.checked_pose(printed)
    turn = cleaned[:3, :3]
    assert np.linalg.norm(turn.T @ turn - np.eye(3)) < tolerances.POSE_ROUNDING
    assert np.linalg.norm(turn - exact[:3, :3]) < 3e-5
    np.testing.assert_array_equal(cleaned[:, 3], printed[:, 3])


def test_matrix_that_is_no_rigid_transform_is_refused(rng):
    good = gsut.exp_pose(make_twist(rng, 1.0))
    scaled, mirrored, sheared, projective = (good.copy() for _ in range(4))
    scaled[:3, :3] *= 1.001
    mirrored[:, 0] *= -1
    sheared[0, 1] += 1e-3
    projective[3, 0] = 0.5
    wrong = [(scaled, "rotation"), (mirrored, "determinant"), (sheared, "rotation"),
             (projective, "last row"), (np.zeros((4, 4)), "last row")]  # fmt: skip
    for k in range(16):
        for value in (np.nan, np.inf):
            bad = good.copy()
            bad.flat[k] = value
            wrong.append((bad, "finite"))
    assert len(wrong) == 37
    for matrix, words in wrong:
        with pytest.raises(gsut.InputError, match=words):
            _core.checked_pose(matrix)
