"""What many images tell of a lens and a readout adds up over windows of them."""

import dataclasses

import numpy as np
import pytest

import tolerances
from gsut import _core
from gsut.sfm.lens import information
from gsut.sfm.lens.covariance import estimate_focal_spread, estimate_lens_sigmas
from gsut.sfm.solution import Adjustment, adjust_registered
from made_flight import FREE, OPTIONS, fly

IMAGES, POINTS, SHARED = 5, 30, 3


@pytest.fixture(scope="module")
def flight():
    """A dozen pictures of deep relief, whose features share errors of scale."""
    return fly(np.random.default_rng(36), relief=0.3, turn=0.3, stretch=0.002)


def test_windows_are_of_images_that_share_points(monkeypatch):
    place = np.arange(40) % 2  # images of two places in turn
    image = np.repeat(np.arange(40), POINTS)
    point = np.tile(np.arange(POINTS), 40) + POINTS * place[image]
    monkeypatch.setattr(information, "_WINDOW", 20)
    windows = information.split_windows(image, point, 41)
    assert [window.tolist() for window in windows] == [[*range(0, 40, 2)], [*range(1, 40, 2)]]
    monkeypatch.setattr(information, "_WINDOW", 10)
    quarters = information.split_windows(image, point, 41)
    assert [len(window) for window in quarters] == [10] * 4
    assert sorted(np.concatenate(quarters)) == list(range(40))
    assert all(len(set(place[window])) == 1 for window in quarters)


@pytest.mark.parametrize("is_open", [False, True])
def test_eliminated_poses_leave_the_schur_complement(is_open, rng):
    image, point = (a.ravel() for a in np.meshgrid(np.arange(IMAGES), np.arange(POINTS)))
    by_pose, by_shared, by_point = (rng.normal(size=(len(image), 2, n)) for n in (6, SHARED, 3))
    if is_open:  # one point that images of one place see, and whose distance nothing says
        by_point[point == 5] = by_point[point == 5][:1]
    held = [*range(6), 6 * 3 + 1]
    normal, determined = _core.shared_information(
        image, point, by_pose, by_shared, by_point, np.zeros(6), held
    )
    gone = np.zeros((len(image), 2, 6 * IMAGES + 3 * POINTS))
    for row, (i, p) in enumerate(zip(image, point, strict=True)):
        gone[row, :, 6 * i : 6 * i + 6] = by_pose[row]
        gone[row, :, 6 * IMAGES + 3 * p :][:, :3] = by_point[row]
    gone = np.delete(gone.reshape(2 * len(image), -1), held, axis=1)
    kept = by_shared.reshape(-1, SHARED)
    wanted = kept.T @ (kept - gone @ np.linalg.lstsq(gone, kept, rcond=None)[0])
    np.testing.assert_allclose(normal, wanted, rtol=0, atol=tolerances.SCHUR_DENSE)
    assert determined == np.linalg.matrix_rank(gone) == gone.shape[1] - is_open


def test_images_that_do_not_hold_together_tell_nothing(rng):
    image, point = (a.ravel() for a in np.meshgrid(np.arange(IMAGES), np.arange(POINTS)))
    columns = [rng.normal(size=(len(image), 2, n)) for n in (6, SHARED, 3)]
    columns[0][image == 2] = 0.0  # nothing says where this image is
    normal, determined = _core.shared_information(image, point, *columns, np.zeros(6), range(7))
    assert not normal.any() and determined == 2 * len(image)


def test_information_numbers_that_are_not_there_are_rejected():
    rows = [np.zeros((2, 2, n)) for n in (6, 1, 3)]
    with pytest.raises(_core.InputError, match="numbered from 0"):
        _core.shared_information([0, 2], [0, 0], *rows, np.zeros(6), [])
    with pytest.raises(_core.InputError, match="held names no unknown"):
        _core.shared_information([0, 1], [0, 0], *rows, np.zeros(6), [12])


@pytest.mark.parametrize(("size", "most"), [(12, tolerances.ONE_WINDOW), (6, 2.0)])
def test_lens_covariance_by_windows_is_a_little_larger(flight, monkeypatch, size, most):
    given = (flight.solution, FREE)
    whole = estimate_lens_sigmas(*given)[0]
    monkeypatch.setattr(information, "_MOST_IMAGES", 4)
    monkeypatch.setattr(information, "_WINDOW", size)
    split = estimate_lens_sigmas(*given)[0]
    free = FREE > 0
    assert (split[free] > whole[free] / tolerances.ONE_WINDOW).all()
    assert (split[free] < most * whole[free]).all() and not split[~free].any()


def test_focal_spread_is_that_of_adjusting_without_each_group(flight):
    logs = []
    for group in np.array_split(np.arange(12), information.GROUPS):
        registered = ~np.isin(np.arange(12), group)
        found = adjust_registered(
            dataclasses.replace(flight.solution, registered=registered),
            flight.features, flight.pairs, OPTIONS, adjustment=Adjustment(FREE, lens_settled=True),
        )  # fmt: skip
        logs.append(np.log(found.cameras[0].params[0]))
    adjusted = np.sqrt((len(logs) - 1) * np.var(logs))
    spread = estimate_focal_spread(flight.solution, FREE)
    assert spread == pytest.approx(adjusted, rel=tolerances.LINEAR_JACKKNIFE)


def test_focal_spread_of_windows_is_about_that_at_once(flight, monkeypatch):
    at_once = estimate_focal_spread(flight.solution, FREE)
    monkeypatch.setattr(information, "_MOST_IMAGES", 4)
    monkeypatch.setattr(information, "_WINDOW", 6)
    assert at_once / 3 < estimate_focal_spread(flight.solution, FREE) < 3 * at_once
