"""Fits a splined stereographic lens: linear in its control points, the only spline fit there is."""

from __future__ import annotations

import math

import numpy as np

from gsut._core import InputError

_ORDER = 3  # cubic
_REACH = 1.02  # the grid over the farthest point
# Largest radius of the stereographic plane, 168.6 degrees, as in special_inverses.cpp.
_LARGEST = 20.0
# Weight of the bend of neighbouring control points beside the points' own: holds the ones that no
# point touches, and moves the others by less than 1e-6 px.
_SMOOTH = 1e-5


def fit_spline(
    focal: np.ndarray, centre: np.ndarray, points: np.ndarray, pixels: np.ndarray, columns: int
) -> np.ndarray:
    """Fits the parameters of a cubic splined_stereographic lens that sends points to pixels.

    Args:
        focal, centre: (2,) pixels: of the projection that the spline bends.
        points: (N, 3) in the camera frame; the control points reach a little beyond the farthest.
        pixels: (N, 2).
        columns: control points across the image; their number down it follows from the pitch.

    Raises:
        InputError: too few control points; points that no such lens sees.
    """
    if columns <= _ORDER:
        raise InputError(
            f"a cubic spline needs at least {_ORDER + 1} control points across, found {columns}"
        )
    plane = project_stereographic(points)
    if not np.hypot(*plane.T).max() < _LARGEST:
        raise InputError(
            "'splined_stereographic' sees at most 168 degrees from the axis, and the image has "
            "rays beyond; leave them out (--max-angle)"
        )
    reach = _REACH * np.abs(plane).max(axis=0)
    density = (columns - _ORDER) / (2.0 * reach[0])
    rows = max(_ORDER + 1, math.ceil(_ORDER + 2.0 * reach[1] * density))
    offsets = (pixels - centre) / focal - plane
    control, _ = fit_control_points(plane, offsets, density, (columns, rows))
    fov = math.degrees(4.0 * math.atan(0.5 * reach[0]))
    return np.array([_ORDER, columns, rows, fov, *focal, *centre, *control.ravel()])


def project_stereographic(points: np.ndarray) -> np.ndarray:
    """Returns the coordinates 2 (X, Y) / (|P| + Z) (N, 2) of points (N, 3)."""
    norm = np.linalg.norm(points, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return 2.0 * points[:, :2] / (norm + points[:, 2])[:, None]


def fit_control_points(
    plane: np.ndarray, offsets: np.ndarray, density: float, grid: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Fits a cubic B-spline to offsets at places of a plane by least squares.

    Args:
        plane: (N, 2) places; (0, 0) is the middle of the grid.
        offsets: (N, 2) values there.
        density: control points per unit of the plane.
        grid: control points across and down.

    Returns:
        (columns * rows, 2) control points, row by row, and the spline (N, 2) at the places.
    """
    columns, rows = grid
    weights = (
        _evaluate_basis(plane[:, 0] * density, columns)[:, None, :]
        * _evaluate_basis(plane[:, 1] * density, rows)[:, :, None]
    ).reshape(len(plane), -1)
    bends = _SMOOTH * math.sqrt(len(weights)) * _differentiate_twice(columns, rows)
    normal = weights.T @ weights + bends.T @ bends
    control = np.linalg.solve(normal, weights.T @ offsets)
    return control, weights @ control


def _evaluate_basis(place: np.ndarray, count: int) -> np.ndarray:
    """Returns the weights (N, count) of a B-spline's control points; place 0 is their middle."""
    at = place + 0.5 * (count - 1)
    middle = np.clip(np.floor(at), 1, count - 3).astype(int)
    t = at - middle
    taps = [(1 - t) ** 3 / 6, 2 / 3 - t**2 * (1 - t / 2),
            2 / 3 - (1 - t) ** 2 * (1 + t) / 2, t**3 / 6]  # fmt: skip
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
