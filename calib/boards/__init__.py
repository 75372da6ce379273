"""The chessboard in photographs: which image shows what, and its corners."""

from calib.boards.board import Board, Photograph, assign_cameras, split_numbers
from calib.boards.corner_files import write_board_picture, write_vnl
from calib.boards.corners import FEWEST_BOARDS, find_boards, turn_corners
