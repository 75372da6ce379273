"""Finds the chessboard's corners in photographs, orders them alike and judges their quality."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np

from calib.boards.board import Board, Photograph
from calib.boards.images import read_grey
from calib.errors import BoardError
from gsut.run import Progress

FEWEST_BOARDS = 4  # a lens with 8 coefficients needs 3 tilted boards; one more to see a mistake
_LARGEST_WINDOW = 5  # half-side in pixels of cornerSubPix: 11 x 11 pixels
_SUBPIX_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)  # steps, pixels
_BLURRED = 0.4  # edge width over corner spacing; sharp boards have 0.05 to 0.17
_SOFT_PX = 6.0  # width of the sharpest edges of a blurred image; in focus they have 2 to 3
_FEWEST_PX_A_SQUARE = 2  # of the image's shorter side: OpenCV's detectors fail on less
_FEWEST_PX = 16  # the image's shorter side in all, for the same reason
_EMPTY_GREY = 5.0  # grey levels of standard deviation below which an image shows nothing
_DARK_PERCENT = 2.0  # of the pixels that count as dark, and as light
_SHARPEST_PERCENT = 0.1  # of the pixels, those with the steepest slope, count as sharp
_COARSER = (2, 4, 8)  # reductions; a board that is found only after one of them is blurred
_PROBE = 3  # corners a side of the smallest board when searching for a board of any size
_ENOUGH_OF_ANOTHER = 5  # first photographs without the board, after which another size is tried


def find_boards(photographs: Sequence[Photograph], board: Board, progress: bool = True) -> None:
    """Finds the board in every photograph and fills in size, corners, or why there are none.

    Raises:
        BoardError: an unreadable file, images of one camera of different sizes, no board in any
            image of a camera, too few boards, or a board of another size.
    """
    first: dict[str, Photograph] = {}
    for photograph in Progress(progress).iterate("boards", photographs):
        image = read_grey(photograph.path)
        photograph.height, photograph.width = image.shape
        reference = first.setdefault(photograph.camera, photograph)
        if (photograph.width, photograph.height) != (reference.width, reference.height):
            raise BoardError(
                f"{photograph.path} has {photograph.width} x {photograph.height} pixels, "
                f"{reference.path} {reference.width} x {reference.height}: all images of one "
                "camera must have one size; leave the others out"
            )
        find_board(image, photograph, board)
        looked = photographs[: photographs.index(photograph) + 1]
        if len(looked) == _ENOUGH_OF_ANOTHER and all(p.corners is None for p in looked):
            _refuse_other_boards(looked, board)
    for name in first:
        _require_enough([p for p in photographs if p.camera == name], name, board)


def find_board(image: np.ndarray, photograph: Photograph, board: Board) -> None:
    """Finds the board in one grey image (H, W) uint8 and fills in the photograph's findings."""
    if _is_too_small(image, board):
        photograph.reason = (
            f"its {image.shape[1]} x {image.shape[0]} pixels are too few for a board of {board}"
        )
        return
    found, photograph.detector = _detect(image, board)
    if found is None:
        photograph.reason = _explain_missing_board(image, photograph, board)
        return
    grid = order_corners(found.reshape(board.rows, board.columns, 2), image)
    if not _is_grid(grid):
        photograph.reason = "the corners that were found do not form a grid"
        return
    spacing = measure_smallest_spacing(grid)
    window = int(max(1, min(_LARGEST_WINDOW, spacing / 2 - 1)))
    refined = cv2.cornerSubPix(
        image,
        grid.reshape(-1, 1, 2).astype(np.float32),
        (window, window),
        (-1, -1),
        _SUBPIX_STOP,
    )
    corners = refined.reshape(-1, 2).astype(np.float64)
    size = (board.columns, board.rows)
    sharpness, _ = cv2.estimateChessboardSharpness(image, size, refined)
    photograph.edge_width = float(sharpness[0])
    if photograph.edge_width > _BLURRED * spacing:
        photograph.reason = (
            f"the board is blurred: its edges are {photograph.edge_width:.0f} px wide, "
            f"its squares {spacing:.0f} px"
        )
        return
    photograph.corners = corners


def _is_too_small(image: np.ndarray, board: Board) -> bool:
    least = max(_FEWEST_PX_A_SQUARE * max(board.columns, board.rows), _FEWEST_PX)
    return min(image.shape) < least


def _detect(image: np.ndarray, board: Board) -> tuple[np.ndarray | None, str]:
    """Returns (corners, 1, 2) of the first detector that finds the whole board, and its name."""
    size = (board.columns, board.rows)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(image, size, flags=flags)
    if found:
        return corners, "findChessboardCorners"
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    for extra in (0, cv2.CALIB_CB_NORMALIZE_IMAGE):
        found, corners = cv2.findChessboardCornersSB(image, size, flags=flags | extra)
        if found:
            return corners, "findChessboardCornersSB"
    return None, ""


def find_any_board(image: np.ndarray) -> tuple[int, int] | None:
    """Returns how many corners a board of any size has along its longer and its shorter side."""
    # Without accuracy and normalisation a small pattern often does not grow to the whole board.
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    flags |= cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, _, meta = cv2.findChessboardCornersSBWithMeta(image, (_PROBE, _PROBE), flags)
    return (max(meta.shape[:2]), min(meta.shape[:2])) if found else None


def measure_sharpest_edge(image: np.ndarray) -> float:
    """Measures over how many pixels the sharpest edges of an image go from dark to light."""
    calm = cv2.medianBlur(image, 3).astype(np.float32)  # removes single noisy pixels
    slope = np.hypot(np.diff(calm, axis=1)[1:], np.diff(calm, axis=0)[:, 1:])
    dark, light = np.percentile(calm, (_DARK_PERCENT, 100 - _DARK_PERCENT))
    return float((light - dark) / max(np.percentile(slope, 100 - _SHARPEST_PERCENT), 1e-6))


def _explain_missing_board(image: np.ndarray, photograph: Photograph, board: Board) -> str:
    edge = measure_sharpest_edge(image)
    if edge > _SOFT_PX and image.std() > _EMPTY_GREY:
        return f"the image is blurred: its sharpest edges are {edge:.0f} px wide"
    size = (board.columns, board.rows)
    for factor in _COARSER:
        small = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
        if _is_too_small(small, board):
            break
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        if cv2.findChessboardCorners(small, size, flags=flags)[0]:
            return f"the board is blurred: it is seen only at 1/{factor} of the size"
    seen = find_any_board(image)
    wanted = (max(board.columns, board.rows), min(board.columns, board.rows))
    if seen is not None and seen != wanted:
        photograph.other_size = seen
        if seen[0] <= wanted[0] and seen[1] <= wanted[1]:
            return (
                f"only {seen[0]} x {seen[1]} of {board} inner corners are seen: the board is "
                "cropped, covered or too oblique"
            )
        return f"it shows a board of {seen[0]} x {seen[1]} inner corners"
    return "no board is seen: it is outside, cropped, blurred or too dark"


def order_corners(grid: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Brings the corners into the order that all photographs share.

    The order is never mirrored. Of the orders that a turn of the board allows, only those with a
    dark first square count; of these (there are two if columns + rows is even) the one whose rows
    point most to the right is taken. `turn_corners` gives the other, for the cameras of a rig that
    see the board upside down.

    Args:
        grid: (rows, columns, 2) pixels in any of the board's orders. image: (H, W).
    """
    along = np.diff(grid, axis=1)[:-1]
    across = np.diff(grid, axis=0)[:, :-1]
    if np.sum(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]) < 0:
        grid = grid[:, ::-1]
    turns = range(0, 4, 1 if grid.shape[0] == grid.shape[1] else 2)
    candidates = [np.rot90(grid, turn) for turn in turns]
    dark = [candidate for candidate in candidates if _is_first_dark(candidate, image)]
    return max(dark or candidates, key=lambda c: np.diff(c[..., 0], axis=1).sum())


def turn_corners(corners: np.ndarray, board: Board) -> np.ndarray:
    """Returns corners (corners, 2) in the order of the board turned by 180 degrees."""
    return corners[::-1] if corners.shape[0] == board.corners else corners


def _is_first_dark(grid: np.ndarray, image: np.ndarray) -> bool:
    """Returns whether the square between the first four corners is darker than its neighbours."""
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    grey = cv2.remap(image, centres.astype(np.float32), None, cv2.INTER_LINEAR).astype(float)
    rows, columns = np.indices(grey.shape)
    even = (rows + columns) % 2 == 0
    return bool(grey[even].mean() < grey[~even].mean())


def measure_smallest_spacing(grid: np.ndarray) -> float:
    """Measures the pixels between the closest neighbours of a grid (rows, columns, 2)."""
    return float(min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)))


def _is_grid(grid: np.ndarray) -> bool:
    """Returns whether every square is convex and oriented like the others."""
    along, across = np.diff(grid, axis=1), np.diff(grid, axis=0)
    for a, b in ((along[:-1], across[:, :-1]), (along[1:], across[:, 1:])):
        if np.any(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0] <= 0):
            return False
    return True


def _require_enough(photographs: Sequence[Photograph], camera: str, board: Board) -> None:
    found = [photograph for photograph in photographs if photograph.corners is not None]
    count = len(photographs)
    if len(found) < FEWEST_BOARDS:
        _refuse_other_boards(photographs, board)
    missed = next((p for p in photographs if p.corners is None), None)
    example = f"; {missed.path}: {missed.reason}" if missed else ""
    if not found:
        images = "the image" if count == 1 else f"any of the {count} images of {camera}"
        raise BoardError(f"no board of {board} inner corners in {images}{example}")
    if len(found) < FEWEST_BOARDS:
        raise BoardError(
            f"too few boards: {len(found)} found in {count} images of {camera}, the last one in "
            f"{found[-1].path}; at least {FEWEST_BOARDS} are needed, and 20 to 30 make a good lens"
            f"{example}"
        )
    _refuse_part_of_a_board(found[0], board)


def _refuse_other_boards(photographs: Sequence[Photograph], board: Board) -> None:
    """Raises BoardError if most photographs show one board of another size."""
    sizes = Counter(p.other_size for p in photographs if p.other_size is not None)
    if not sizes:
        return
    (size, count), half = sizes.most_common(1)[0], len(photographs) / 2
    if count > half:
        shown = next(p for p in photographs if p.other_size == size)
        raise BoardError(
            f"wrong board size: {shown.path} and {count - 1} more of {len(photographs)} images "
            f"show {size[0]} x {size[1]} inner corners, not {board}; "
            f"give --board {size[0]}x{size[1]}, or show the whole board where it is cropped"
        )


def _refuse_part_of_a_board(photograph: Photograph, board: Board) -> None:
    """Raises BoardError if the board is larger than given: a detector may settle for a part."""
    seen = find_any_board(read_grey(photograph.path))
    if (
        seen is not None
        and sum(seen) > board.columns + board.rows
        and min(seen) >= min(board.columns, board.rows)
    ):
        raise BoardError(
            f"wrong board size: {photograph.path} shows {seen[0]} x {seen[1]} inner corners, not "
            f"{board}; give --board {seen[0]}x{seen[1]}"
        )
