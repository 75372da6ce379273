"""Hard case 17: fast turns, fixed points that do not converge, lines beyond the image."""

import numpy as np
import pytest
from precision_paths import FIELDS, blob, every_path, joined

import gsut
import tolerances
from random_scenes import fisheye, gaussians_in_view, pinhole, random_weights, relative_error


def turned(angle, axis=0):
    xi = np.zeros(6)
    xi[3 + axis] = angle
    return gsut.exp_pose(xi)


def run(g, camera, pair, shutter, rng, rule=None):
    """Every path forward and backward, finite; the float ones against the first."""
    weights = random_weights(rng, camera)
    worst = {"alpha": 0.0, "gradient": 0.0}
    truth = None
    ran = 0
    for path in every_path():
        gsut.machine.set_isa("" if path == "float64" else path)
        dtype = "float64" if path == "float64" else "float32"
        result = gsut.render(g, camera, pair, shutter=shutter, dtype=dtype, blend=rule)
        slopes = gsut.render_backward(result, *weights)
        arrays = [result.image, result.alpha, result.depth, slopes.pose]
        arrays += [getattr(slopes.gaussians, name) for name in FIELDS]
        assert all(np.isfinite(array).all() for array in arrays), path
        ran += 1
        if truth is None:
            truth = (result, slopes)
            continue
        off = np.abs(result.alpha - truth[0].alpha)
        assert np.sum(off > tolerances.RENDER_FLIP) <= tolerances.HARD_JUMPS_AN_IMAGE, path
        worst["alpha"] = max(worst["alpha"], off[off <= tolerances.RENDER_FLIP].max())
        if not np.any(off > tolerances.RENDER_FLIP):
            floor = tolerances.HARD_ZERO_GRADIENT * max(
                np.linalg.norm(getattr(truth[1].gaussians, name)) for name in FIELDS
            )
            for name in FIELDS:
                a, b = (getattr(s.gaussians, name) for s in (slopes, truth[1]))
                size = max(np.linalg.norm(b), floor, 1e-30)
                worst["gradient"] = max(worst["gradient"], np.linalg.norm(a - b) / size)
            error = relative_error(slopes.pose, truth[1].pose)
            worst["gradient"] = max(worst["gradient"], error)
    assert ran == len(every_path())
    assert worst["alpha"] < tolerances.HARD_ROLLING_ALPHA, worst
    assert worst["gradient"] < tolerances.HARD_GRADIENT, worst
    return truth[0]


def test_hard_turn_with_the_readout_shows_one_gaussian_on_every_line(rng):
    # The camera turns as fast as it reads: every line looks the same way, and a point in that
    # direction has no line of its own (any is a fixed point); against it, points pass twice as
    # fast. Both are drawn as the double reference draws them.
    camera = pinhole(48, focal=48.0)
    view = 2 * np.arctan(0.5)
    rows = []
    for angle in (view, -view, 3 * view, -3 * view):
        pair = (turned(-0.5 * angle), turned(0.5 * angle))
        image = run(blob(scale=0.05), camera, pair, "top_to_bottom", rng)
        rows.append(np.count_nonzero(image.alpha.max(axis=1) > 0.1))
    assert len(rows) == 4 and min(rows) > 0
    assert max(rows[:2]) > 40 and min(rows[:2]) < 20


@pytest.mark.parametrize("turn", [0.5, 2.0, 3.1])
@pytest.mark.parametrize("direction", ["top_to_bottom", "right_to_left"])
def test_hard_fast_turn_is_finite_and_misses_nothing(rng, turn, direction):
    rule = gsut.BlendRule()
    rule.transmittance_min = 0.0
    camera = fisheye(48, degrees=170.0)
    drawn = 0
    for axis in range(3):
        pair = (turned(-0.5 * turn, axis), turned(0.5 * turn, axis))
        g = gaussians_in_view(rng, camera, np.eye(4), 40, sizes=(0.01, 0.4), opacity=0.0)
        drawn += (run(g, camera, pair, direction, rng, rule).alpha > 0.1).sum()
    assert drawn > 1000


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
        run(g, camera, pair, "top_to_bottom", rng)
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
    run(g, camera, pair, "top_to_bottom", rng)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (17, 33)])
def test_hard_images_of_few_lines(rng, size):
    camera = pinhole(*size, focal=20.0)
    pair = (turned(-0.05), turned(0.05))
    ran = 0
    for direction in ("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"):
        for parity in (None, "gsplat"):
            run(blob(), camera, pair, gsut.Shutter(direction, parity), rng)
            ran += 1
    assert ran == 8


def test_hard_camera_that_moves_through_a_gaussian(rng):
    camera = pinhole(32)
    start, end = np.eye(4), np.eye(4)
    start[2, 3], end[2, 3] = -1.0, 1.0  # from behind to before the Gaussian at the origin
    g = joined(blob((0.01, 0.02, 0.03), 0.3), blob((0.1, 0.0, 5.0), (2.0, 0.01, 0.4)))
    run(g, camera, (start, end), "top_to_bottom", rng)


def test_hard_rolling_scene_far_from_the_origin(rng):
    camera = pinhole(40)
    pair = (turned(-0.1), turned(0.1))
    g = gaussians_in_view(rng, camera, np.eye(4), 60)
    near = gsut.render(g, camera, pair, shutter="top_to_bottom")
    offset = 2.0**20 * np.array([1.0, -1.0, 0.5])
    # Means on a grid that float holds at that distance.
    g.means = np.round(g.means * 8).astype(np.float32) / 8
    near = gsut.render(g, camera, pair, shutter="top_to_bottom")
    far = g.copy()
    far.means = (g.means + offset).astype(np.float32)
    moved = []
    for pose in pair:
        shift = pose.copy()
        shift[:3, 3] -= pose[:3, :3] @ offset
        moved.append(shift)
    found = gsut.render(far, camera, tuple(moved), shutter="top_to_bottom")
    assert np.sum(np.abs(found.alpha - near.alpha) > tolerances.RENDER_FLIP) <= 2
    run(far, camera, tuple(moved), "top_to_bottom", rng)
    assert near.alpha.max() > 0.5
