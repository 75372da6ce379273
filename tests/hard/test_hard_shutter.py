"""Hard case 17: fast turns, fixed points that do not converge, lines beyond the image."""

import numpy as np
import pytest

import gsut
import tolerances
from random_scenes import blob, joined, pinhole


def turned(angle, axis=0):
    xi = np.zeros(6)
    xi[3 + axis] = angle
    return gsut.exp_pose(xi)


def assert_float_matches_double(g, camera, pair):
    """Alpha agrees, but for a few pixels exactly on a discontinuity."""
    truth, image = (
        gsut.render(g, camera, pair, shutter="top_to_bottom", dtype=dtype).alpha
        for dtype in ("float64", "float32")
    )
    off = np.abs(image - truth) > tolerances.RENDER_FLIP
    assert off.sum() <= tolerances.HARD_JUMPS_AN_IMAGE


def test_hard_turn_with_the_readout_shows_one_gaussian_on_every_line(rng):
    # The camera turns as fast as it reads: every line looks the same way, and a point in that
    # direction has no line of its own (any is a fixed point); against it, points pass twice as
    # fast. Both are drawn as the double reference draws them.
    camera = pinhole(48, focal=48.0)
    view = 2 * np.arctan(0.5)
    rows = []
    for angle in (view, -view, 3 * view, -3 * view):
        pair = (turned(-0.5 * angle), turned(0.5 * angle))
        image = gsut.render(blob(scale=0.05), camera, pair, shutter="top_to_bottom")
        rows.append(np.count_nonzero(image.alpha.max(axis=1) > 0.1))
    assert len(rows) == 4 and min(rows) > 0
    assert max(rows[:2]) > 40 and min(rows[:2]) < 20


def test_hard_fixed_point_that_does_not_settle_says_so_and_is_drawn_all_the_same(rng):
    # Lines run down while the image runs up, by more than a line a line: the iteration never
    # settles.
    camera = pinhole(48, focal=48.0)
    unsettled = ran = 0
    for factor in (0.2, 1.0, 1.5, 3.0, -3.0):
        angle = 2 * np.arctan(0.5) * factor
        pair = (turned(-0.5 * angle), turned(0.5 * angle))
        places = [blob((0.0, y, 2.0), 0.05) for y in np.linspace(-0.6, 0.6, 7)]
        g = joined(*places)
        found = gsut.project(g, camera, pair, shutter="top_to_bottom")
        assert np.isnan(found.centers[~found.converged]).all()
        assert not np.any(found.valid & ~found.converged)
        unsettled += (~found.converged).sum()
        assert_float_matches_double(g, camera, pair)
        ran += 1
    assert ran == 5 and unsettled > 5


def test_hard_points_beyond_the_first_and_last_line_take_the_poses_of_the_ends(rng):
    camera = pinhole(40, focal=40.0)
    pair = (np.eye(4), turned(0.1))
    g = joined(blob((0.0, -1.6, 2.0), 1e-3), blob((0.0, 1.8, 2.0), 1e-3))
    found = gsut.project(g, camera, pair, shutter="top_to_bottom", dtype="float64")
    assert found.converged.all() and found.valid.all()
    assert found.centers[0, 1] < 0 and found.centers[1, 1] > 40
    for which in range(2):
        still = gsut.project(g, camera, pair[which], dtype="float64").centers[which]
        assert found.centers[which] == pytest.approx(still, abs=1e-3)
