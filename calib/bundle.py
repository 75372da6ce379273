"""Least squares over lenses, the board's bend, the rig's and the boards' poses; covariance.

Small and dense: a rig with 60 boards has some 400 unknowns. Poses change by a left perturbation
(rotation vector, translation): p' = p + rotation x p + translation.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.errors import SolveError
from calib.rigid import compose, rotation_matrix, skew, transform_points
from gsut.least_squares import minimize_least_squares

# params (K,), points (N, 3) -> pixels (N, 2), dpixel_dpoint (N, 2, 3), dpixel_dparams (N, 2, K);
# NaN where the lens has no image of the point.
Projector = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

_MOST_STEPS = 60
_DONE = 1e-12  # relative decrease of the cost


@dataclass
class Observation:
    """One board seen by one camera.

    Args:
        camera, board: indices. pixels: (N, 2). points: (N, 3) in the board's frame.
        bow: (N, 2) what a warp of 1 adds to their z (`Board.bow`); needed where lenses are free.
    """

    camera: int
    board: int
    pixels: np.ndarray
    points: np.ndarray
    bow: np.ndarray | None = None

    def bent(self, warp: np.ndarray) -> np.ndarray:
        """(N, 3) the points of the bent board."""
        if self.bow is None:
            return self.points
        points = self.points.copy()
        points[:, 2] += self.bow @ warp
        return points


@dataclass
class State:
    """Unknowns: lenses' params, camera_from_reference (C, 6), reference_from_board (B, 6), and the
    board's warp (2,), free where the lenses are."""

    params: list[np.ndarray]
    cameras: np.ndarray
    boards: np.ndarray
    warp: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def packed(self) -> np.ndarray:
        """(numbers,) all of it in a row."""
        return np.concatenate([*self.params, self.cameras.ravel(), self.boards.ravel(), self.warp])

    def unpacked(self, numbers: np.ndarray) -> State:
        """A state of the same shape out of what `packed` gives."""
        parts = [*self.params, self.cameras, self.boards, self.warp]
        pieces = np.split(numbers, np.cumsum([part.size for part in parts])[:-1])
        *params, cameras, boards, warp = pieces
        return State(params, cameras.reshape(-1, 6), boards.reshape(-1, 6), warp)

    def moved(self, step: np.ndarray, layout: Layout) -> State:
        """The state after a step (unknowns,)."""
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
    """Where each unknown stands in a step; params as (start, count), others as start or None."""

    params: list[tuple[int, int]]
    cameras: list[int | None]
    boards: list[int]
    warp: int | None
    size: int

    @classmethod
    def of(cls, state: State, free_params: bool, free_cameras: bool) -> Layout:
        """The first camera is the reference and never moves."""
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


def linearise(
    state: State, layout: Layout, observations: Sequence[Observation], lenses: Sequence[Projector]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Half the sum of squares, its gradient (unknowns,) and J^T J; the cost is inf where NaN."""
    cost, gradient = 0.0, np.zeros(layout.size)
    normal = np.zeros((layout.size, layout.size))
    for seen, in_reference, in_camera, pixels, by_point, by_params in _projected(
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
            blocks.append(_by_left_step(by_point, in_camera))
            columns.append(layout.cameras[seen.camera] + np.arange(6))
        rotated = by_point @ rotation_matrix(camera[:3])
        blocks.append(_by_left_step(rotated, in_reference))
        columns.append(layout.boards[seen.board] + np.arange(6))
        if layout.warp is not None:
            if seen.bow is None:
                raise ValueError("free lenses need the bow of every observation")
            normal_of_board = rotation_matrix(state.boards[seen.board][:3])[:, 2]
            blocks.append((rotated @ normal_of_board)[:, :, None] * seen.bow[:, None, :])
            columns.append(layout.warp + np.arange(2))
        jacobian = np.concatenate(blocks, axis=2).reshape(len(residual), -1)
        index = np.concatenate(columns)
        cost += 0.5 * residual @ residual
        gradient[index] += jacobian.T @ residual
        normal[np.ix_(index, index)] += jacobian.T @ jacobian
    return cost, gradient, normal


def _projected(state: State, observations: Sequence[Observation], lenses: Sequence[Projector]):
    """Each observation, its points in the reference's and its camera's frame, and what the lens
    makes of them; a lens is called once for all of its boards."""
    for index, lens in enumerate(lenses):
        mine = [seen for seen in observations if seen.camera == index]
        if not mine:
            continue
        in_reference = [transform_points(state.boards[o.board], o.bent(state.warp)) for o in mine]
        in_camera = [transform_points(state.cameras[index], points) for points in in_reference]
        answers = lens(state.params[index], np.concatenate(in_camera))
        ends = np.cumsum([len(points) for points in in_camera])[:-1]
        parts = (np.split(answer, ends) for answer in answers)
        yield from zip(mine, in_reference, in_camera, *parts, strict=True)


def minimise(
    state: State,
    observations: Sequence[Observation],
    lenses: Sequence[Projector],
    free_params: bool = False,
    free_cameras: bool = False,
) -> State:
    """Levenberg-Marquardt from `state`; boards are always free.

    Raises:
        SolveError: a corner has no image at the start.
    """
    layout = Layout.of(state, free_params, free_cameras)

    @functools.lru_cache(maxsize=2)  # the cost and the normal equations of a state come together
    def equations(numbers: bytes) -> tuple[float, np.ndarray, np.ndarray]:
        return linearise(state.unpacked(np.frombuffer(numbers)), layout, observations, lenses)

    start = state.packed()
    if not np.isfinite(equations(start.tobytes())[0]):
        raise SolveError("a corner of a board lies outside the lens' domain; try another --lens")
    found, _ = minimize_least_squares(
        start,
        lambda at: equations(at.tobytes())[0],
        lambda at: equations(at.tobytes())[1:],
        max_steps=_MOST_STEPS,
        least_gain=_DONE,
        apply=lambda at, step: state.unpacked(at).moved(step, layout).packed(),
    )
    return state.unpacked(found)


def covariance(
    state: State,
    observations: Sequence[Observation],
    lenses: Sequence[Projector],
    free_cameras: bool = False,
) -> tuple[np.ndarray, Layout, float]:
    """Covariance (unknowns, unknowns) of all unknowns at the minimum, its layout, and the noise.

    The noise of a pixel coordinate comes from the residuals: sigma^2 = 2 cost / (2 N - unknowns).

    Raises:
        SolveError: the boards do not determine the lens.
    """
    layout = Layout.of(state, free_params=True, free_cameras=free_cameras)
    cost, _, normal = linearise(state, layout, observations, lenses)
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


def _by_left_step(by_point: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, 2, 6): derivative to (rotation, translation) of the points' own frame."""
    return np.concatenate([-by_point @ skew(points), by_point], axis=2)
