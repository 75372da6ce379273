"""Solving for lenses: truth recovered, its uncertainty right, bad lenses refused; real boards."""

import ast

import numpy as np
import pytest

import gsut
import tolerances
from calib.boards.board import Board, assign_cameras
from calib.boards.corners import find_boards
from calib.camera.projection import to_gsut_camera, unproject_pixels
from calib.camera.rigid import compose, invert, matrix_from_rodrigues, rodrigues_from_matrix
from calib.errors import MisfitError
from calib.report.lens_files import ANGLE_KEY, SIGMA_KEY, write_lens
from calib.solve import solve_by_mrcal, solve_by_opencv
from calib.solve.mrcal_process import ask, has_mrcal
from calib.trust.cross_validation import compare, hold_out
from calib.trust.halves import find_agreement_angle, fit_rotation
from calib.trust.trust import judge
from calib.trust.uncertainty import map_uncertainty, spread_pixels
from calib_fakes import BOARD, FISHEYE, corner_photographs
from calib_oracles import measure_coverage
from tests.synthetic_boards import photographs as see
from tests.synthetic_boards import random_poses

needs_mrcal = pytest.mark.skipif(
    not has_mrcal(), reason="mrcal is not installed: apt-get install mrcal python3-mrcal"
)
NOISE_PX = 0.1


@pytest.fixture(scope="module")
def noisy():
    """Twenty boards through a fisheye with noise, and OpenCV's solution of them."""
    photographs, _ = corner_photographs(20, NOISE_PX, np.random.default_rng(11))
    return photographs, solve_by_opencv(photographs, BOARD, "fisheye")


def test_rigid_compose_and_inverse_cancel(rng):
    for size in (1e-12, 1e-3, 1.0, 3.14):
        axis = rng.standard_normal(3)
        pose = np.concatenate([axis / np.linalg.norm(axis) * size, rng.standard_normal(3)])
        assert np.abs(compose(pose, invert(pose))).max() < tolerances.CALIB_RIGID
        again = rodrigues_from_matrix(matrix_from_rodrigues(pose[:3]))
        assert np.abs(again - pose[:3]).max() < tolerances.CALIB_RIGID


def test_solve_fisheye_without_noise_recovers_the_lens(rng):
    photographs, _ = corner_photographs(10, 0.0, rng)
    found = solve_by_opencv(photographs, BOARD, "fisheye")
    assert (
        np.abs(to_gsut_camera(found).params - FISHEYE.params).max() < tolerances.CALIB_EXACT_PARAMS
    )
    assert found.outliers.sum() == 0


def test_solve_fisheye_boards_past_ninety_degrees_are_used(rng):
    wide = gsut.Camera("kannala_brandt", [90.0, 91.0, 212.0, 209.0, 0.02, -0.01, 0, 0], 420, 420)
    board = Board(7, 5, 0.03)
    poses = random_poses(wide, board, 14, 95.0, rng)
    found = solve_by_opencv(see(wide, board, poses, 0.05, rng), board, "fisheye")
    assert np.degrees(found.measure_field_angles(board).max()) > 100.0
    assert found.rms_axis_px == pytest.approx(0.05, rel=tolerances.CALIB_NOISE_RELATIVE)
    assert np.abs(to_gsut_camera(found).params - wide.params)[:4].max() < tolerances.CALIB_WIDE_PX


def test_rms_both_conventions_differ_by_root_two(noisy):
    _, solution = noisy
    assert solution.rms_2d_px == pytest.approx(np.sqrt(2) * solution.rms_axis_px, rel=1e-12)
    assert solution.rms_axis_px == pytest.approx(NOISE_PX, rel=tolerances.CALIB_NOISE_RELATIVE)


def test_solve_displaced_corners_are_the_outliers(noisy):
    photographs, _ = corner_photographs(12, NOISE_PX, np.random.default_rng(5))
    moved = [(0, 3), (4, 17), (9, 30)]
    for board, corner in moved:
        photographs[board].corners[corner] += (3.0, -2.0)
    found = solve_by_opencv(photographs, BOARD, "fisheye")
    assert {tuple(map(int, index)) for index in np.argwhere(found.outliers)} == set(moved)


def test_solve_wrongly_found_board_is_named(noisy):
    photographs, _ = corner_photographs(8, NOISE_PX, np.random.default_rng(6))
    photographs[3].corners = np.roll(photographs[3].corners, 11, axis=0)
    with pytest.raises(MisfitError, match=r"synthetic003\.png: its corners do not fit") as caught:
        solve_by_opencv(photographs, BOARD, "fisheye")
    assert caught.value.indices == [3]


def test_uncertainty_repeated_solves_cover_the_truth_in_95_percent():
    solves, parameters = 8, 8
    within, projected, ratio = measure_coverage(solves)
    # 64 parameters, correlated: 3 standard deviations of a share of 95 % are 7 % and more.
    assert len(within) == parameters
    assert within.mean() > tolerances.CALIB_COVERAGE_LEAST
    assert projected > tolerances.CALIB_COVERAGE_LEAST
    assert ratio == pytest.approx(1.0, abs=tolerances.CALIB_NOISE_RELATIVE)


def test_uncertainty_map_grows_away_from_the_boards(noisy):
    _, solution = noisy
    sigma = map_uncertainty(solution, BOARD)
    rows, columns = sigma.shape
    assert sigma.shape == spread_pixels(420, 320).shape[:2]
    assert sigma[rows // 2, columns // 2] < 0.1 * np.nanmax(sigma)


def test_trust_good_fisheye_reaches_as_far_as_its_boards(noisy):
    _, solution = noisy
    trust = judge(solution, BOARD, map_uncertainty(solution, BOARD))
    assert not trust.refusal
    assert trust.valid_angle <= trust.reach < trust.domain
    assert np.degrees(trust.valid_angle) > 50


def test_trust_lens_with_a_pole_inside_the_boards_is_refused(noisy):
    _, solution = noisy
    radial = solve_by_opencv(solution.photographs, BOARD, "opencv8")
    radial.params[8:] = 0.0  # the denominator
    radial.params[9] = -1.0  # 1 - r^4: a pole at 45 degrees
    trust = judge(radial, BOARD, np.full((2, 2), np.nan))
    assert "pole or fold at" in trust.refusal
    assert np.degrees(trust.domain) <= 45.0 + 1e-6


def test_cross_validation_prefers_the_lens_that_predicts(noisy):
    photographs = noisy[0][:10]
    radial, fisheye = (solve_by_opencv(photographs, BOARD, lens) for lens in ("opencv4", "fisheye"))
    results = [
        hold_out(
            full.lens,
            full,
            photographs,
            BOARD,
            lambda part, full=full: solve_by_opencv(part, BOARD, full.lens),
        )
        for full in (radial, fisheye)
    ]
    reason = compare(results, [radial.outliers, fisheye.outliers])
    assert [result.chosen for result in results] == [False, True]
    assert "fisheye predicts unseen boards best" in reason
    assert np.isfinite(results[1].errors).all()


def test_agreement_angle_same_lens_turned_agrees_everywhere(noisy):
    _, solution = noisy
    assert find_agreement_angle(solution, solution, 1.0) == 1.0
    turn = matrix_from_rodrigues([0.1, -0.2, 0.3])
    directions = unproject_pixels(solution, spread_pixels(420, 320).reshape(-1, 2))
    directions = directions[np.isfinite(directions).all(axis=1)]
    found = fit_rotation(directions, directions @ turn.T)
    assert np.abs(found - turn).max() < tolerances.CALIB_RIGID


def test_lens_file_fisheye_reads_back_exactly_and_as_nearest_splined(noisy, tmp_path):
    _, solution = noisy
    trust = judge(solution, BOARD, map_uncertainty(solution, BOARD))
    notes = write_lens(tmp_path / "lens.cameramodel", solution, trust, "made by a test")
    exact = gsut.load_camera(tmp_path / "lens.yaml")
    assert exact.model == "kannala_brandt"
    assert np.abs(exact.params - to_gsut_camera(solution).params).max() < tolerances.CALIB_WRITTEN
    assert exact.valid_field_angle == pytest.approx(trust.valid_angle, rel=1e-12)
    text = (tmp_path / "lens.cameramodel").read_text()
    values = ast.literal_eval(text)
    assert text.startswith("# made by a test\n")
    assert values["lensmodel"].startswith("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3")
    assert np.array(values[SIGMA_KEY]).shape == trust.sigma.shape
    assert values[ANGLE_KEY] == trust.valid_angle
    assert "px off at most" in notes[-1]
    if not has_mrcal():
        return
    directions = unproject_pixels(solution, spread_pixels(420, 320).reshape(-1, 2))
    seen = np.isfinite(directions).all(axis=1) & (directions[:, 2] > 0)
    answer = ask({"do": "project", "model": text, "points": directions[seen].tolist()})
    off = np.array(answer["pixels"]) - spread_pixels(420, 320).reshape(-1, 2)[seen]
    assert np.abs(off).max() < tolerances.CALIB_SPLINE_LIKE_PX


@pytest.fixture(scope="module")
def by_mrcal(noisy):
    """mrcal's solution of the same boards with a rational lens, and its uncertainty."""
    found = solve_by_mrcal(noisy[0], BOARD, "opencv8")
    return found, map_uncertainty(found, BOARD)


@needs_mrcal
def test_mrcal_opencv8_agrees_with_the_fisheye_of_opencv(noisy, by_mrcal):
    found, _ = by_mrcal
    assert found.rms_axis_px == pytest.approx(NOISE_PX, rel=tolerances.CALIB_NOISE_RELATIVE)
    assert find_agreement_angle(found, noisy[1], 0.8) == 0.8


@needs_mrcal
def test_mrcal_lens_file_is_read_by_mrcal_and_gsut(by_mrcal, tmp_path):
    found, sigma = by_mrcal
    trust = judge(found, BOARD, sigma)
    write_lens(tmp_path / "lens.cameramodel", found, trust, "made by a test")
    lens = gsut.load_camera(tmp_path / "lens.cameramodel")
    assert lens.model == "opencv8"
    assert lens.valid_field_angle == pytest.approx(trust.valid_angle, rel=1e-12)
    text = (tmp_path / "lens.cameramodel").read_text()
    assert (
        ask({"do": "describe_solve", "model": text})["cameras"][0]["model"] == "LENSMODEL_OPENCV8"
    )


@needs_mrcal
def test_mrcal_uncertainty_agrees_with_ours_for_the_same_lens(noisy, by_mrcal):
    ours = solve_by_opencv(noisy[0], BOARD, "opencv8")
    middle = (slice(10, 20), slice(12, 28))  # where both know most
    ratio = by_mrcal[1][middle] / map_uncertainty(ours, BOARD)[middle]
    # mrcal also solves for the board's shape and pulls coefficients to 0
    low, high = tolerances.CALIB_SIGMA_RATIO
    assert low < np.median(ratio) < high


@pytest.fixture(scope="module")
def real_left(shared):
    """The left camera's photographs of the real rig, with corners."""
    folder = shared / "data" / "boards" / "fisheye_stereo"
    photographs = assign_cameras(sorted(folder.glob("left*.jpg")), [])
    board = Board(9, 6, 0.02423)
    find_boards(photographs, board, progress=False)
    return photographs, board


def test_solve_real_fisheye_meets_the_anchor(real_left):
    photographs, board = real_left
    assert len(photographs) == 29
    found = solve_by_opencv(photographs, board, "fisheye")
    assert found.rms_2d_px <= tolerances.CALIB_REAL_FISHEYE_PX


@needs_mrcal
def test_solve_real_fisheye_with_mrcal_meets_the_anchors(real_left):
    photographs, board = real_left
    for lens, anchor in (
        ("opencv8", tolerances.CALIB_REAL_OPENCV8_PX),
        ("splined", tolerances.CALIB_REAL_SPLINED_PX),
    ):
        assert solve_by_mrcal(photographs, board, lens).rms_2d_px <= anchor
