"""Fits a splined stereographic lens: linear in its control points, the only spline fit there is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import InputError

_REACH = 1.02  # the grid over the farthest point
# Largest radius of the stereographic plane, 168.6 degrees, as in special_inverses.cpp.
_LARGEST = 20.0
# Weight of the bend of neighbouring control points beside the points' own: holds the ones that no
# point touches, and moves the others by less than 1e-6 px.
_SMOOTH = 1e-5


@dataclasses.dataclass(frozen=True)
class SplineGrid:
    """The configuration of a splined_stereographic lens.

    Attributes:
        order: 3 (cubic) or 2 (quadratic).
        columns: control points across the image.
        rows: control points down the image; None: the number that the same pitch needs.
    """

    order: int = 3
    columns: int = 16
    rows: int | None = None


def fit_spline(
    focal: np.ndarray, centre: np.ndarray, points: np.ndarray, pixels: np.ndarray, grid: SplineGrid
) -> np.ndarray:
    """Fits the parameters of a splined_stereographic lens that sends points to pixels.

    Args:
        focal, centre: (2,) pixels: of the projection that the spline bends.
        points: (N, 3) in the camera frame; the grid reaches a little beyond the farthest.
        pixels: (N, 2).
        grid: the control points.

    Raises:
        InputError: a grid that is none, or too small; points that no such lens sees.
    """
    if grid.order not in (2, 3):
        raise InputError(f"the order of a spline must be 2 or 3, found {grid.order}")
    if grid.columns <= grid.order:
        raise InputError(
            f"a spline of order {grid.order} needs at least {grid.order + 1} control points "
            f"across, found {grid.columns}"
        )
    plane = project_stereographic(points)
    if not np.hypot(*plane.T).max() < _LARGEST:
        raise InputError(
            "'splined_stereographic' sees at most 168 degrees from the axis, and the image has "
            "rays beyond; leave them out (--max-angle)"
        )
    reach = _REACH * np.abs(plane).max(axis=0)
    density = (grid.columns - grid.order) / (2.0 * reach[0])
    needed = max(grid.order + 1, math.ceil(grid.order + 2.0 * reach[1] * density))
    rows = needed if grid.rows is None else grid.rows
    if rows < needed:
        raise InputError(
            f"{grid.columns} control points across need at least {needed} down for this image, "
            f"found {rows}"
        )
    offsets = (pixels - centre) / focal - plane
    control, _ = fit_control_points(plane, offsets, density, (grid.columns, rows), grid.order)
    fov = math.degrees(4.0 * math.atan(0.5 * reach[0]))
    return np.array([grid.order, grid.columns, rows, fov, *focal, *centre, *control.ravel()])


def project_stereographic(points: np.ndarray) -> np.ndarray:
    """Returns the coordinates 2 (X, Y) / (|P| + Z) (N, 2) of points (N, 3)."""
    norm = np.linalg.norm(points, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return 2.0 * points[:, :2] / (norm + points[:, 2])[:, None]


def fit_control_points(
    plane: np.ndarray, offsets: np.ndarray, density: float, grid: tuple[int, int], order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Fits a B-spline to offsets at places of a plane by least squares.

    Args:
        plane: (N, 2) places; (0, 0) is the middle of the grid.
        offsets: (N, 2) values there.
        density: control points per unit of the plane.
        grid: control points across and down.
        order: 2 or 3.

    Returns:
        (columns * rows, 2) control points, row by row, and the spline (N, 2) at the places.
    """
    columns, rows = grid
    weights = (
        _evaluate_basis(plane[:, 0] * density, columns, order)[:, None, :]
        * _evaluate_basis(plane[:, 1] * density, rows, order)[:, :, None]
    ).reshape(len(plane), -1)
    bends = _SMOOTH * math.sqrt(len(weights)) * _differentiate_twice(columns, rows)
    normal = weights.T @ weights + bends.T @ bends
    control = np.linalg.solve(normal, weights.T @ offsets)
    return control, weights @ control


def _evaluate_basis(place: np.ndarray, count: int, order: int) -> np.ndarray:
    """Returns the weights (N, count) of a B-spline's control points; place 0 is their middle."""
    at = place + 0.5 * (count - 1)
    middle = np.floor(at) if order == 3 else np.floor(at + 0.5)
    middle = np.clip(middle, 1, count - (3 if order == 3 else 2)).astype(int)
    t = at - middle
    if order == 3:
        taps = [(1 - t) ** 3 / 6, 2 / 3 - t**2 * (1 - t / 2),
                2 / 3 - (1 - t) ** 2 * (1 + t) / 2, t**3 / 6]  # fmt: skip
    else:
        taps = [(0.5 - t) ** 2 / 2, 0.75 - t**2, (0.5 + t) ** 2 / 2]
    weights = np.zeros((len(place), count))
    for k, tap in enumerate(taps):
        weights[np.arange(len(place)), middle - 1 + k] = tap
    return weights


def _differentiate_twice(columns: int, rows: int) -> np.ndarray:
    """Returns the second differences of a grid along both axes, one a row."""
    index = np.arange(columns * rows).reshape(rows, columns)
    triples = [
        np.stack([index[:, :-2], index[:, 1:-1], index[:, 2:]], axis=-1).reshape(-1, 3),
        np.stack([index[:-2], index[1:-1], index[2:]], axis=-1).reshape(-1, 3),
    ]
    places = np.concatenate(triples)
    matrix = np.zeros((len(places), columns * rows))
    for column, weight in enumerate((1.0, -2.0, 1.0)):
        matrix[np.arange(len(places)), places[:, column]] = weight
    return matrix
