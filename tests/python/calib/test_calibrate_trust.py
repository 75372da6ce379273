"""How far a lens is trusted: the board's bend, other lenses of the same boards, odd and even."""

import dataclasses

import numpy as np
import pytest

import tolerances
from calib.boards.board import Board
from calib.camera.projection import PIXEL_SHIFT, unproject_pixels
from calib.solve import opencv_solver, solve_by_opencv
from calib.trust.halves import AGREEMENT_DEGREES, compare_lenses, find_agreement_angle
from calib.trust.second_lens import (
    SecondLens,
    compare_with,
    cut_where_lenses_differ,
    refuse_narrow_field,
)
from calib.trust.trust import Trust, judge, measure_field_angle
from calib.trust.uncertainty import map_uncertainty, spread_pixels
from calib_fakes import BOARD, FISHEYE, corner_photographs
from tests.synthetic_boards import photographs as see
from tests.synthetic_boards import random_poses

WARP = (0.0008, -0.0003)  # metres, of a board of 18 x 12 cm
NOISE_PX = 0.05
LIMIT = np.radians(60.0)


@pytest.fixture(scope="module")
def bent():
    """Boards through a fisheye, as near as boards are, bent; and the solution of them."""
    generator = np.random.default_rng(23)
    poses = random_poses(FISHEYE, BOARD, 20, 50.0, generator)
    photographs = see(FISHEYE, BOARD, poses, NOISE_PX, generator, WARP)
    return photographs, solve_by_opencv(photographs, BOARD, "fisheye")


@pytest.fixture(scope="module")
def truth(bent):
    """The lens that is behind the photographs, as a solution."""
    params = np.array(FISHEYE.params)
    params[2:4] -= PIXEL_SHIFT
    return dataclasses.replace(bent[1], params=params)


def test_board_points_of_a_bent_board_are_parabolas_between_its_edges():
    board = Board(5, 3, 0.1)
    z = board.locate_corners((0.01, -0.002))[:, 2].reshape(3, 5)
    assert z[0] == pytest.approx([0, 0.0075, 0.01, 0.0075, 0], abs=1e-15)
    assert z[1] == pytest.approx(z[0] - 0.002, abs=1e-15)
    assert np.array_equal(z[2], z[0])
    assert np.all(board.locate_corners()[:, 2] == 0)


def test_solve_bent_board_finds_its_warp_and_the_lens(bent, truth):
    found = bent[1]
    assert np.abs(np.array(found.warp) - WARP).max() < tolerances.CALIB_WARP_METRES
    assert found.rms_axis_px == pytest.approx(NOISE_PX, rel=tolerances.CALIB_NOISE_RELATIVE)
    worst = compare_lenses(found, truth, LIMIT).worst_degrees
    assert worst < tolerances.CALIB_BENT_DEGREES


def test_solve_bent_board_taken_for_flat_is_another_lens(bent, truth, monkeypatch):
    """What the bend is modelled for: without it the rays are wrong, and more so far away."""

    def flat(params, poses, *_):
        return params, poses, np.zeros(2)

    monkeypatch.setattr(opencv_solver, "_solve_with_warp", flat)
    found = solve_by_opencv(bent[0], BOARD, "fisheye")
    worst = compare_lenses(found, truth, LIMIT).worst_degrees
    assert worst > 3 * tolerances.CALIB_BENT_DEGREES


def test_uncertainty_of_a_bent_board_holds_the_truth(bent, truth):
    found = bent[1]
    sigma = map_uncertainty(found, BOARD).ravel()
    directions = unproject_pixels(truth, spread_pixels(420, 320).reshape(-1, 2))
    inside = measure_field_angle(directions) < np.radians(40.0)
    difference = np.radians(compare_lenses(found, truth, np.radians(40.0)).degrees.ravel())
    pixels = difference * FISHEYE.params[0]
    assert inside.sum() > 100
    assert np.median((pixels / sigma)[inside]) < 2.0


def test_agreement_angle_shifted_lens_agrees_near_but_not_far(truth):
    """A lens whose centre lies elsewhere by 2 mm fits boards at 0.1 m, and turns far rays."""
    shift, distance = np.array([0.0, 0.0, 0.002]), 0.1
    angle = np.linspace(0.05, 1.2, 60)
    seen = np.arctan2(distance * np.sin(angle), distance * np.cos(angle) - shift[2])
    # The radial lens that puts what lies at `seen` where the true one puts `angle`.
    powers = seen[:, None] ** (2 * np.arange(5) + 1)
    radius = np.polyval([*truth.params[:3:-1], 1.0], angle**2) * angle
    fit = np.linalg.lstsq(powers, radius, rcond=None)[0]
    params = np.concatenate([truth.params[:2] * fit[0], truth.params[2:4], fit[1:] / fit[0]])
    other = dataclasses.replace(truth, params=params)
    limit = np.radians(50.0)
    assert find_agreement_angle(truth, other, limit, distance) == limit
    assert find_agreement_angle(truth, other, limit) < np.radians(40.0)


def test_compare_with_true_kind_and_rational_lens_agree_on_a_flat_board():
    photographs, _ = corner_photographs(20, NOISE_PX, np.random.default_rng(11))
    fisheye, radial = (solve_by_opencv(photographs, BOARD, lens) for lens in ("fisheye", "opencv8"))
    trust = judge(fisheye, BOARD, map_uncertainty(fisheye, BOARD))
    second = compare_with(fisheye, trust, radial, BOARD)
    assert second.compared_to <= trust.valid_angle
    assert second.agrees_to > np.radians(40.0)
    assert second.agrees_near_to > np.radians(40.0)
    hopeless = dataclasses.replace(radial, residuals=10 * radial.residuals)
    assert compare_with(fisheye, trust, hopeless, BOARD) is None


def _trust(degrees):
    return Trust(np.radians(degrees), 1.3, 2.0, np.full((2, 2), np.nan), 0.0)


def _second(compared, far, near):
    return SecondLens("opencv8", "mrcal", 0.2, *np.radians([compared, far, near]), 0.3)


def test_trusted_field_ends_where_another_lens_differs():
    trust = _trust(70.0)
    others = [_second(65.0, 40.0, 60.0), _second(30.0, 30.0, 30.0)]
    cut_where_lenses_differ(trust, np.radians(55.0), others, "left")
    assert np.degrees(trust.valid_angle) == pytest.approx(40.0)
    assert len(trust.notes) == 2  # the second lens agreed as far as it is trusted itself
    assert "odd and of the even photographs differ" in trust.notes[0]
    assert f"more than {AGREEMENT_DEGREES} degree for things far away" in trust.notes[1]
    assert "at the boards' own distance of 0.3 both agree to 60" in trust.notes[1]
    assert not trust.refusal


def test_trusted_field_stays_where_all_agree():
    trust = _trust(70.0)
    cut_where_lenses_differ(trust, np.radians(70.0), [_second(33.0, 33.0, 33.0)], "left")
    assert np.degrees(trust.valid_angle) == pytest.approx(70.0)
    assert not trust.notes


def test_trusted_field_of_nothing_is_a_refusal():
    trust = _trust(70.0)
    cut_where_lenses_differ(trust, None, [_second(60.0, 0.0, 0.0)], "left")
    assert "do not determine the lens of left" in trust.refusal


@pytest.mark.parametrize(("degrees", "is_refused"), [(5.0, True), (40.0, False)])
def test_trusted_field_of_one_pixel_in_a_hundred_is_a_refusal(degrees, is_refused, truth):
    trust = _trust(degrees)
    refuse_narrow_field(trust, truth)
    assert ("one camera at one zoom" in trust.refusal) == is_refused
