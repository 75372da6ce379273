"""Minimizes reprojection errors over lenses, poses and the board's bend; gives the covariance.

The problem is small and dense: a rig with 60 boards has some 400 unknowns. Poses change by a left
perturbation (rotation vector, translation): p' = p + rotation x p + translation.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.boards import Board
from calib.camera.rigid import (
    compose,
    cross_matrix_from_vector,
    matrix_from_rodrigues,
    transform_points,
)
from calib.errors import SolveError
from gsut.least_squares import LEAST_GAIN, minimize_least_squares

# params (K,), points (N, 3) -> pixels (N, 2), dpixel_dpoint (N, 2, 3), dpixel_dparams (N, 2, K);
# NaN where the lens has no image of the point.
Projector = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

_MOST_STEPS = 60  # of Levenberg-Marquardt; good starts need ten


@dataclass
class Observation:
    """One board seen by one camera.

    Args:
        camera, board: indices. pixels: (N, 2). points: (N, 3) in the board's frame.
        bow: (N, 2) what a warp of 1 adds to their z (`Board.bow`); required if lenses are free.
    """

    camera: int
    board: int
    pixels: np.ndarray
    points: np.ndarray
    bow: np.ndarray | None = None

    def bend_points(self, warp: np.ndarray) -> np.ndarray:
        """Returns the points (N, 3) of the board bent by `warp`."""
        if self.bow is None:
            return self.points
        points = self.points.copy()
        points[:, 2] += self.bow @ warp
        return points


@dataclass
class State:
    """The unknowns of a solve.

    Args:
        params: of each lens. cameras: (C, 6) camera from reference.
        boards: (B, 6) reference from board. warp: (2,) of the board, free if the lenses are.
    """

    params: list[np.ndarray]
    cameras: np.ndarray
    boards: np.ndarray
    warp: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def pack(self) -> np.ndarray:
        """Concatenates all unknowns into one vector."""
        return np.concatenate([*self.params, self.cameras.ravel(), self.boards.ravel(), self.warp])

    def unpack(self, numbers: np.ndarray) -> State:
        """Returns the state of the same shape whose `pack` gives these numbers."""
        parts = [*self.params, self.cameras, self.boards, self.warp]
        pieces = np.split(numbers, np.cumsum([part.size for part in parts])[:-1])
        *params, cameras, boards, warp = pieces
        return State(params, cameras.reshape(-1, 6), boards.reshape(-1, 6), warp)

    def move(self, step: np.ndarray, layout: Layout) -> State:
        """Returns the state after a step (unknowns,)."""
        params = [p.copy() for p in self.params]
        cameras, boards = self.cameras.copy(), self.boards.copy()
        for index, (start, count) in enumerate(layout.params):
            params[index][:count] += step[start : start + count]
        for poses, starts in ((cameras, layout.cameras), (boards, layout.boards)):
            for index, start in enumerate(starts):
                if start is not None:
                    poses[index] = compose(step[start : start + 6], poses[index])
        warp = self.warp.copy()
        if layout.warp is not None:
            warp += step[layout.warp : layout.warp + 2]
        return State(params, cameras, boards, warp)


@dataclass
class Layout:
    """The place of each unknown in a step; params as (start, count), others as start or None."""

    params: list[tuple[int, int]]
    cameras: list[int | None]
    boards: list[int]
    warp: int | None
    size: int

    @classmethod
    def from_state(cls, state: State, free_params: bool, free_cameras: bool) -> Layout:
        """Numbers the free unknowns; the first camera is the reference and never moves."""
        size, params, cameras, boards = 0, [], [], []
        for values in state.params:
            count = len(values) if free_params else 0
            params.append((size, count))
            size += count
        for index in range(len(state.cameras)):
            free = free_cameras and index > 0
            cameras.append(size if free else None)
            size += 6 if free else 0
        for _ in range(len(state.boards)):
            boards.append(size)
            size += 6
        warp = size if free_params else None
        return cls(params, cameras, boards, warp, size + (2 if free_params else 0))


def observe_boards(corners: np.ndarray, keep: np.ndarray, board: Board) -> list[Observation]:
    """Lists the boards that one camera saw.

    Args:
        corners: (V, corners, 2) pixels. keep: (V, corners) bool. board: the chessboard.
    """
    points, bow = board.locate_corners(), board.bow
    return [
        Observation(0, index, pixels[good], points[good], bow[good])
        for index, (pixels, good) in enumerate(zip(corners, keep, strict=True))
    ]


def linearize(
    state: State, layout: Layout, observations: Sequence[Observation], lenses: Sequence[Projector]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Evaluates the cost and its normal equations.

    Returns:
        Half the sum of squares (inf if a residual is NaN), its gradient (unknowns,), and J^T J.
    """
    cost, gradient = 0.0, np.zeros(layout.size)
    normal = np.zeros((layout.size, layout.size))
    for seen, in_reference, in_camera, pixels, by_point, by_params in _project_all(
        state, observations, lenses
    ):
        camera = state.cameras[seen.camera]
        residual = (pixels - seen.pixels).ravel()
        if not np.all(np.isfinite(residual)):
            return np.inf, gradient, normal
        blocks, columns = [], []
        start, count = layout.params[seen.camera]
        if count:
            blocks.append(by_params)
            columns.append(np.arange(start, start + count))
        if layout.cameras[seen.camera] is not None:
            blocks.append(_differentiate_left_step(by_point, in_camera))
            columns.append(layout.cameras[seen.camera] + np.arange(6))
        rotated = by_point @ matrix_from_rodrigues(camera[:3])
        blocks.append(_differentiate_left_step(rotated, in_reference))
        columns.append(layout.boards[seen.board] + np.arange(6))
        if layout.warp is not None:
            if seen.bow is None:
                raise ValueError("free lenses need the bow of every observation")
            normal_of_board = matrix_from_rodrigues(state.boards[seen.board][:3])[:, 2]
            blocks.append((rotated @ normal_of_board)[:, :, None] * seen.bow[:, None, :])
            columns.append(layout.warp + np.arange(2))
        jacobian = np.concatenate(blocks, axis=2).reshape(len(residual), -1)
        index = np.concatenate(columns)
        cost += 0.5 * residual @ residual
        gradient[index] += jacobian.T @ residual
        normal[np.ix_(index, index)] += jacobian.T @ jacobian
    return cost, gradient, normal


def _project_all(state: State, observations: Sequence[Observation], lenses: Sequence[Projector]):
    """Yields each observation with its points in the reference's and in its camera's frame, their
    pixels and derivatives. A lens is called once for all of its boards."""
    for index, lens in enumerate(lenses):
        mine = [seen for seen in observations if seen.camera == index]
        if not mine:
            continue
        in_reference = [
            transform_points(state.boards[o.board], o.bend_points(state.warp)) for o in mine
        ]
        in_camera = [transform_points(state.cameras[index], points) for points in in_reference]
        answers = lens(state.params[index], np.concatenate(in_camera))
        ends = np.cumsum([len(points) for points in in_camera])[:-1]
        parts = (np.split(answer, ends) for answer in answers)
        yield from zip(mine, in_reference, in_camera, *parts, strict=True)


def minimize(
    state: State,
    observations: Sequence[Observation],
    lenses: Sequence[Projector],
    free_params: bool = False,
    free_cameras: bool = False,
) -> State:
    """Minimizes the cost by Levenberg-Marquardt from `state`; boards are always free.

    Raises:
        SolveError: a corner has no image at the start.
    """
    layout = Layout.from_state(state, free_params, free_cameras)

    # The solver takes cost and normal equations of a state separately; both come together.
    @functools.lru_cache(maxsize=2)
    def linearize_at(numbers: bytes) -> tuple[float, np.ndarray, np.ndarray]:
        return linearize(state.unpack(np.frombuffer(numbers)), layout, observations, lenses)

    start = state.pack()
    if not np.isfinite(linearize_at(start.tobytes())[0]):
        raise SolveError("a corner of a board lies outside the lens' domain; try another --lens")
    found, _ = minimize_least_squares(
        start,
        lambda at: linearize_at(at.tobytes())[0],
        lambda at: linearize_at(at.tobytes())[1:],
        max_steps=_MOST_STEPS,
        least_gain=LEAST_GAIN,
        apply=lambda at, step: state.unpack(at).move(step, layout).pack(),
    )
    return state.unpack(found)


def estimate_covariance(
    state: State,
    observations: Sequence[Observation],
    lenses: Sequence[Projector],
) -> tuple[np.ndarray, Layout, float]:
    """Estimates the covariance (unknowns, unknowns) at the minimum, its layout, and the noise.

    The noise of a pixel coordinate follows from the residuals: sigma^2 = 2 cost / (2 N - unknowns).

    Raises:
        SolveError: the boards do not determine the lens.
    """
    layout = Layout.from_state(state, free_params=True, free_cameras=False)
    cost, _, normal = linearize(state, layout, observations, lenses)
    freedom = 2 * sum(len(seen.points) for seen in observations) - layout.size
    scale = 1 / np.sqrt(np.diag(normal))
    try:
        if freedom <= 0 or not np.all(np.isfinite(scale)):
            raise np.linalg.LinAlgError
        inverse = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    except np.linalg.LinAlgError:
        raise SolveError(
            "these boards do not determine the lens: tilt the board, and show it near every edge"
        ) from None
    sigma = float(np.sqrt(2 * cost / freedom))
    return sigma**2 * inverse, layout, sigma


def _differentiate_left_step(by_point: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns d pixel / d (rotation, translation) (N, 2, 6) of the frame that the points are in."""
    return np.concatenate([-by_point @ cross_matrix_from_vector(points), by_point], axis=2)
