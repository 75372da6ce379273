"""The cameras of a rig: their poses recovered, lens by lens or all in one solve; real boards."""

import numpy as np
import pytest

import tolerances
from calib.boards.board import Board, assign_cameras
from calib.boards.corners import find_boards
from calib.camera.rigid import compose, invert
from calib.errors import SolveError
from calib.solve import solve_by_mrcal, solve_by_opencv
from calib.solve.mrcal_process import has_mrcal
from calib.solve.mrcal_rig import solve_rig_together, solve_together
from calib.solve.rig import SHAKY, compute_rms, solve_rig, unify_turns
from calib_fakes import BOARD, FISHEYE
from calib_oracles import calibrate_stereo
from tests.synthetic_boards import photographs as see
from tests.synthetic_boards import random_poses

needs_mrcal = pytest.mark.skipif(
    not has_mrcal(), reason="mrcal is not installed: apt-get install mrcal python3-mrcal"
)
NOISE_PX = 0.1


def _by_opencv(photographs, board):
    return solve_by_opencv(photographs, board, "fisheye")


def _by_mrcal(photographs, board):
    return solve_by_mrcal(photographs, board, "opencv8")


def _rig(generator, board, noise_px, turned_ones=(), solve=_by_opencv):
    """Two cameras 11 cm apart that see the same boards; some numbered upside down by the second."""
    pose = np.array([0.02, -0.05, 0.01, -0.11, 0.002, 0.004])
    cameras = []
    left = random_poses(FISHEYE, board, 12, 25.0, generator)
    right = np.stack([compose(pose, board_pose) for board_pose in left])
    for name, poses in (("left", left), ("right", right)):
        photographs = see(FISHEYE, board, poses, noise_px, generator)
        for index, photograph in enumerate(photographs):
            photograph.camera = name
            if name == "right" and index in turned_ones:
                photograph.corners = photograph.corners[::-1]
        cameras.append(solve(photographs, board))
    return cameras, pose


def test_rig_relative_pose_is_recovered(rng):
    noise_px = 0.02
    cameras, truth = _rig(rng, BOARD, noise_px)
    rms, notes = solve_rig(cameras, BOARD)
    error = compose(cameras[1].camera_from_reference, invert(truth))
    assert np.degrees(np.linalg.norm(error[:3])) < tolerances.CALIB_RIG_DEGREES
    assert np.linalg.norm(error[3:]) < tolerances.CALIB_RIG_METRES
    assert rms < 2 * noise_px
    assert not notes


def test_rig_boards_seen_upside_down_are_found(rng):
    cameras, _ = _rig(rng, BOARD, NOISE_PX, turned_ones=(1, 5, 6))
    right = cameras[1].photographs
    assert unify_turns(cameras, BOARD) == [right[1], right[5], right[6]]


def test_rig_without_common_frame_is_an_error(rng):
    cameras, _ = _rig(rng, BOARD, NOISE_PX)
    for photograph in cameras[1].photographs:
        photograph.frame += "-later"
    with pytest.raises(SolveError, match="right has no frame"):
        solve_rig(cameras, BOARD)


@needs_mrcal
def test_rig_in_one_solve_recovers_the_pose_and_keeps_the_noise(rng):
    noise_px = 0.02
    cameras, truth = _rig(rng, BOARD, noise_px, solve=_by_mrcal)
    alone = [camera.params.copy() for camera in cameras]
    together, rms, notes = solve_rig_together(cameras, BOARD)
    error = compose(together[1].camera_from_reference, invert(truth))
    assert np.degrees(np.linalg.norm(error[:3])) < tolerances.CALIB_RIG_DEGREES
    assert np.linalg.norm(error[3:]) < tolerances.CALIB_RIG_METRES
    assert rms == pytest.approx(np.sqrt(2) * noise_px, rel=tolerances.CALIB_NOISE_RELATIVE)
    assert not notes
    assert all(np.any(c.params != p) for c, p in zip(together, alone, strict=True))
    assert all("optimization_inputs" in camera.model_text for camera in together)


@needs_mrcal
def test_rig_in_one_solve_frames_apart_keep_the_lenses(rng):
    """A board that moved between the two exposures: one pose cannot fit, lenses must not bend."""
    cameras, _ = _rig(rng, BOARD, 0.02, solve=_by_mrcal)
    for photograph, shift in zip(
        cameras[1].photographs, rng.normal(0, 3.0, (len(cameras[1].photographs), 2)), strict=True
    ):
        photograph.corners = photograph.corners + shift
    cameras[1] = _by_mrcal(cameras[1].photographs, BOARD)
    alone = [camera.params.copy() for camera in cameras]
    placed, rms, notes = solve_rig_together(cameras, BOARD)
    assert rms > SHAKY * compute_rms(cameras)
    assert "were not taken together" in notes[0]
    assert all(np.array_equal(c.params, p) for c, p in zip(placed, alone, strict=True))
    assert np.linalg.norm(placed[1].camera_from_reference[3:]) > 0.05


@needs_mrcal
def test_rig_of_real_fisheyes_agrees_with_opencv_on_the_same_boards_and_lenses(shared):
    folder = shared / "data" / "boards" / "fisheye_stereo"
    board = Board(9, 6, 0.02423)
    photographs = assign_cameras(sorted(folder.glob("*.jpg")), ["left", "right"])
    find_boards(photographs, board, progress=False)
    cameras = [
        _by_mrcal([p for p in photographs if p.camera == name], board) for name in ("left", "right")
    ]
    assert [len(camera.photographs) for camera in cameras] == [29, 29]
    solve_rig(cameras, board)
    for hold in (True, False):
        first, second = solve_together(cameras, board, hold)
        theirs = calibrate_stereo(first, second, board)
        error = compose(second.camera_from_reference, invert(theirs))
        assert np.degrees(np.linalg.norm(error[:3])) <= tolerances.CALIB_REAL_RIG_DEGREES
        metres = np.linalg.norm(second.camera_from_reference[3:] - theirs[3:])
        assert metres <= tolerances.CALIB_REAL_RIG_METRES
