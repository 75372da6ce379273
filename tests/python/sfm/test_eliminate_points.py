"""Points are eliminated from normal equations exactly, those that images leave open too."""

import numpy as np
import pytest

import tolerances
from gsut import _core
from gsut._core import InputError
from gsut.sfm.lens import eliminate_points

IMAGES, POINTS, COUNT = 4, 12, 3


@pytest.mark.parametrize("is_open", [False, True])
def test_eliminated_points_leave_the_schur_complement(is_open, rng):
    image, point = (a.ravel() for a in np.meshgrid(np.arange(IMAGES), np.arange(POINTS)))
    by_pose, by_lens, by_point = (rng.normal(size=(len(image), 2, size)) for size in (6, COUNT, 3))
    if is_open:  # one point that images of one place see, and whose distance nothing says
        rows = point == 5
        by_point[rows] = by_point[rows][:1]
    normal, freedom = eliminate_points(image, point, by_pose, by_lens, by_point, IMAGES)
    jacobian = np.zeros((len(image), 2, 6 * IMAGES + COUNT + 3 * POINTS))
    for row, (i, p) in enumerate(zip(image, point, strict=True)):
        jacobian[row, :, 6 * i : 6 * i + 6] = by_pose[row]
        jacobian[row, :, 6 * IMAGES + COUNT + 3 * p :][:, :3] = by_point[row]
    jacobian[:, :, 6 * IMAGES : 6 * IMAGES + COUNT] = by_lens
    dense = np.reshape(jacobian, (2 * len(image), -1))
    kept, gone = dense[:, : 6 * IMAGES + COUNT], dense[:, 6 * IMAGES + COUNT :]
    wanted = kept.T @ (kept - gone @ np.linalg.lstsq(gone, kept, rcond=None)[0])
    np.testing.assert_allclose(normal, wanted, rtol=0, atol=tolerances.SCHUR_DENSE)
    assert freedom == -np.linalg.matrix_rank(gone) == -3 * POINTS + is_open


def test_subtract_blocks_goes_through_points_in_order(rng):
    """As numpy's `subtract.at` does, one number after the other."""
    images = np.array([[0, 2, 3], [3, 1, 0], [2, 3, 0], [0, 2, 3]])
    target, blocks = rng.normal(size=(4, 4, 2, 2)), rng.normal(size=(4, 6, 6))
    wanted = target.copy()
    of_pairs = blocks.reshape(4, 3, 2, 3, 2).transpose(0, 3, 1, 4, 2)
    np.subtract.at(wanted, (images[:, :, None], images[:, None, :]), of_pairs)
    _core.subtract_blocks(target, images, blocks)
    assert np.array_equal(target, wanted)


def test_subtract_blocks_rejects_an_image_that_is_not_there():
    with pytest.raises(InputError, match="images holds 2; there are 2"):
        _core.subtract_blocks(np.zeros((2, 2, 1, 1)), [[0, 2]], np.zeros((1, 2, 2)))
