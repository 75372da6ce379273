"""Finding chessboards: corners in their places and in one order, and a clear sentence otherwise."""

import cv2
import numpy as np
import pytest

import tolerances
from calib.boards.board import Board, Photograph, assign_cameras
from calib.boards.corner_files import write_board_picture, write_vnl
from calib.boards.corners import find_board, find_boards, order_corners
from calib.boards.images import read_grey
from calib.camera.rigid import transform_points
from calib.errors import BoardError
from calib_fakes import BOARD, FISHEYE, write_pictures


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Six drawn boards through a fisheye and their poses."""
    folder = tmp_path_factory.mktemp("boards")
    return write_pictures(folder, 6, np.random.default_rng(7))


def _found(paths, board=BOARD):
    photographs = assign_cameras(paths, [])
    find_boards(photographs, board, progress=False)
    return photographs


def test_corners_drawn_boards_lie_where_the_lens_puts_them(pictures):
    paths, poses = pictures
    photographs = _found(paths)
    for photograph, pose in zip(photographs, poses, strict=True):
        truth = FISHEYE.project(transform_points(pose, BOARD.locate_corners()))[0] - 0.5
        assert photograph.corners is not None, photograph.reason
        # 7 + 5 is even: the board may be numbered from either end
        error = min(
            (corners - truth for corners in (photograph.corners, photograph.corners[::-1])),
            key=lambda difference: np.abs(difference).max(),
        )
        assert np.abs(error.mean(axis=0)).max() < tolerances.CALIB_DRAWN_OFFSET_PX
        rms = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        assert rms < tolerances.CALIB_DRAWN_CORNER_PX


def test_corners_image_upside_down_keep_their_order_where_colours_tell(tmp_path):
    board = Board(6, 5, 0.03)  # 6 + 5 is odd: the first square's colour tells the ends apart
    (path, *_), _ = write_pictures(tmp_path, 1, np.random.default_rng(3), board=board)
    image = read_grey(path)
    upright = Photograph(path, "camera", "0")
    find_board(image, upright, board)
    turned = Photograph(path, "camera", "0")
    find_board(np.ascontiguousarray(image[::-1, ::-1]), turned, board)
    back = np.array(image.shape[::-1]) - 1 - turned.corners
    assert np.abs(back - upright.corners).max() < tolerances.CALIB_SAME_CORNER_PX


def test_ordered_mirrored_grid_is_turned_back(pictures):
    photograph = _found(pictures[0])[0]
    grid = photograph.corners.reshape(BOARD.rows, BOARD.columns, 2)
    image = read_grey(photograph.path)
    assert np.array_equal(order_corners(grid[:, ::-1], image), grid)
    assert np.array_equal(order_corners(grid[::-1], image), grid)


def test_vnl_written_and_read_gives_the_same_corners(pictures, tmp_path):
    photographs = _found(pictures[0])
    write_vnl(tmp_path / "corners.vnl", photographs)
    assert (tmp_path / "corners.vnl").read_text().startswith("# filename x y level\n")
    rows = [line.split() for line in (tmp_path / "corners.vnl").read_text().splitlines()[1:]]
    read = np.array([row[1:3] for row in rows], float).reshape(6, BOARD.corners, 2)
    assert [row[0] for row in rows[:: BOARD.corners]] == [str(p.path) for p in photographs]
    for photograph, corners in zip(photographs, read, strict=True):
        assert np.abs(corners - photograph.corners).max() < 1e-5


def test_board_picture_is_written_for_found_and_missed_boards(pictures, tmp_path):
    found = _found(pictures[0])[0]
    missed = Photograph(found.path, "other", "0", reason="no board")
    for photograph in (found, missed):
        path = write_board_picture(tmp_path, photograph, BOARD)
        assert cv2.imread(str(path)).shape == (320, 420, 3)


def test_assign_cameras_pairs_by_name():
    from pathlib import Path

    paths = [Path(name) for name in ("left1.png", "right1.png", "left2.png")]
    photographs = assign_cameras(paths, ["left", "right"])
    assert [p.camera for p in photographs] == ["left", "right", "left"]
    assert photographs[0].frame == photographs[1].frame != photographs[2].frame


def test_board_parse_nonsense_is_refused():
    for text in ("9", "9x", "2x2", "axb"):
        with pytest.raises(BoardError, match="board"):
            Board.parse(text, 0.02)
    with pytest.raises(BoardError, match="side of a square"):
        Board.parse("9x6", 0.0)
    assert Board.parse("9x6", 0.02).corners == 54


def test_find_boards_real_rig_finds_all(shared):
    folder = shared / "data" / "boards" / "fisheye_stereo"
    photographs = assign_cameras(sorted(folder.glob("*.jpg")), ["left", "right"])
    find_boards(photographs, Board(9, 6, 0.02423), progress=False)
    assert len(photographs) == 58
    assert all(photograph.corners is not None for photograph in photographs)


def test_find_boards_real_wide_fisheye_finds_all_but_one(shared):
    folder = shared / "data" / "boards" / "ocam_fisheye1"
    photographs = assign_cameras(sorted(folder.glob("*.jpg")), [])
    find_boards(photographs, Board(6, 8, 0.0325), progress=False)
    assert sum(photograph.corners is not None for photograph in photographs) >= 14
