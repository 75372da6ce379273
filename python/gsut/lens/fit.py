"""Finds the parameters of a lens that sends given points to given pixels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut._core import InputError
from gsut.least_squares import minimize_least_squares
from gsut.lens.camera import Camera, camera_models

# What follows fx fy cx cy, to start from; the best of several is kept.
_STARTS: dict[str, list[list[float]]] = {
    "pinhole": [[]],
    "opencv4": [[0.0] * 4],
    "opencv5": [[0.0] * 5],
    "opencv8": [[0.0] * 8],
    "opencv12": [[0.0] * 12],
    "opencv14": [[0.0] * 14],
    "kannala_brandt": [[0.0] * 4],
    "thin_prism_fisheye": [[0.0] * 8],
    "fisheye624": [[0.0] * 12],
    "unified": [[0.5]],
    "extended_unified": [[0.5, 1.0]],
    "double_sphere": [[0.0, 0.5]],
    "division": [[-0.1]],
    "fov": [[0.5]],
    "mei": [[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]],
    "stereographic": [[]],
    "cahvor": [[0.0] * 5],
    # The linearity of a lens with more and of one with less than equidistance.
    "cahvore": [[0.0] * 8 + [linearity] for linearity in (0.5, -0.5)],
    "lonlat": [[]],
    "latlon": [[]],
    "orthographic": [[]],
}
_FIXED: dict[str, tuple[int, ...]] = {"mei": (4,)}  # skew stays 0
_PUPIL = (9, 10, 11)  # of cahvore: e0 e1 e2, which points at infinity say nothing about
_MAX_STEPS = 300
_STEPS_WIDENING = 60  # while the field still widens
_LEAST_GAIN = 1e-12  # of the cost in a step, below which the search ends

# ftheta: cx cy reference B0..B5 A0..A5 max_angle c d e.
_FTHETA_B, _FTHETA_A, _FTHETA_LINEAR, _FTHETA_DEGREE = 3, 9, 16, 5
_FTHETA_FREE = (0, 1, *range(_FTHETA_A + 1, _FTHETA_A + 1 + _FTHETA_DEGREE), 16, 17, 18)
_FTHETA_BEYOND = 1e-3  # radians by which the polynomials may be used beyond the last point

_SPLINE_POINTS = 8  # index of the first control point
_SPLINE_REACH = 1.02  # the grid over the farthest point
# Largest radius of the stereographic plane that the lens looks at (spline_map.cpp), 168.6 degrees.
_SPLINE_LARGEST = 20.0
# Weight of the bend of neighbouring control points beside the points' own: holds the ones that no
# point touches, and moves the others by less than 1e-6 px.
_SPLINE_SMOOTH = 1e-5


@dataclasses.dataclass(frozen=True)
class SplineGrid:
    """The configuration of a splined_stereographic lens.

    Attributes:
        order: 3 (cubic) or 2 (quadratic).
        columns: control points across the image.
        rows: control points down the image; None: as many as the same pitch needs.
    """

    order: int = 3
    columns: int = 16
    rows: int | None = None


@dataclasses.dataclass(frozen=True)
class FitTarget:
    """What the new lens is to do.

    Attributes:
        camera: the lens to imitate.
        points: (N, 3) in the camera frame.
        pixels: (N, 2) where they are to be seen.
        distance: of the points from the camera, for the scale of lenses of parallel rays.
        several_distances: whether the points tell lenses apart whose rays do not meet.
    """

    camera: Camera
    points: np.ndarray
    pixels: np.ndarray
    distance: float
    several_distances: bool


def angles_of(points: np.ndarray) -> np.ndarray:
    """(N,) radians from the axis of points (N, 3)."""
    return np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])


def check_model(model: str, num_params: int | None) -> None:
    """Raises InputError if there is no such lens, or not with that many coefficients."""
    if model not in camera_models():
        raise InputError(f"unknown camera model '{model}'; known: {', '.join(camera_models())}")
    if num_params is not None and (model != "kannala_brandt" or num_params < 4):
        raise InputError(f"'{model}' does not take {num_params} parameters")


def fit_lens(
    target: FitTarget, model: str, num_params: int | None = None, grid: SplineGrid | None = None
) -> np.ndarray:
    """The parameters of a lens of `model`, by least squares of the pixel distances.

    Args:
        target: points and pixels.
        model: see `camera_models()`.
        num_params: of kannala_brandt; None: fx fy cx cy and four coefficients.
        grid: of splined_stereographic; None: `SplineGrid()`.

    Raises:
        InputError: no such model or number of parameters; points that the lens cannot see.
    """
    check_model(model, num_params)
    if model == "equirectangular":  # the image's size is the lens
        return np.empty(0)
    if model == "splined_stereographic":
        return _fit_spline(target, grid or SplineGrid())
    if model == "ftheta":
        return _fit_ftheta(target)
    free_tail = _STARTS[model]
    if num_params is not None:
        free_tail = [[0.0] * (num_params - 4)]
    focal, centre = _axis(target, model)
    fixed: tuple[int, ...] = _FIXED.get(model, ())
    if model == "cahvore" and not target.several_distances:
        fixed = _PUPIL
    found = []
    for tail in free_tail:
        # A lens that divides by 1 + xi on the axis has a longer focal length.
        stretch = 1.0 + tail[1] if model == "mei" else 1.0
        start = np.array([*(focal * stretch), *centre, *tail])
        found.append(_widening(model, start, fixed, target))
    return min(found, key=lambda one: one[1])[0]


def _axis(target: FitTarget, model: str) -> tuple[np.ndarray, np.ndarray]:
    """Focal lengths (2,) on the axis and its pixel (2,)."""
    axis = np.array([[0.0, 0.0, target.distance]])
    (centre,), valid = target.camera.project(axis)
    if not valid[0]:
        raise InputError("the lens does not see its own axis: nothing to start a fit from")
    jacobian, _ = target.camera.project_jacobian(axis)
    focal = np.abs([jacobian[0, 0, 0], jacobian[0, 1, 1]])
    return (focal if model == "orthographic" else focal * target.distance), centre


def _widening(
    model: str, start: np.ndarray, fixed: tuple[int, ...], target: FitTarget
) -> tuple[np.ndarray, float]:
    """From the centre of the field outwards, so that no ray starts outside the domain."""
    params, cost = start, math.inf
    angles = angles_of(target.points)
    for share in (0.25, 0.5, 0.75, 1.0):
        near = angles <= max(share * angles.max(), np.sort(angles)[min(60, len(angles) - 1)])
        part = dataclasses.replace(target, points=target.points[near], pixels=target.pixels[near])
        # What fits the centre may have a pole just beyond it: the first guess gets its chance too.
        steps = _MAX_STEPS if share == 1.0 else _STEPS_WIDENING
        tries = [_refine(model, guess, fixed, part, steps) for guess in (params, start)]
        params, cost = min(tries, key=lambda found: found[1])
    return params, cost


def _refine(
    model: str, params: np.ndarray, fixed: tuple[int, ...], target: FitTarget, steps: int
) -> tuple[np.ndarray, float]:
    """The parameters that fit best, from `params` on, and their cost."""
    free = [i for i in range(len(params)) if i not in fixed]

    def lens_of(values: np.ndarray) -> Camera:
        moved = params.copy()
        moved[free] = values
        return Camera(model, moved, target.camera.width, target.camera.height)

    def cost_of(values: np.ndarray) -> float:
        try:
            lens = lens_of(values)
        except InputError:  # a parameter left its range
            return math.inf
        residual, valid = _residuals(lens, target)
        # A point that the lens does not see counts as one at the image's own size.
        unseen = float(lens.width**2 + lens.height**2)
        return float((residual**2).sum() + unseen * (~valid).sum())

    def normal_equations(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lens = lens_of(values)
        residual, valid = _residuals(lens, target)
        jacobian = -lens.project_jacobian(target.points)[1][valid][:, :, free]
        jacobian = jacobian.reshape(-1, len(free))
        return jacobian.T @ residual[valid].ravel(), jacobian.T @ jacobian

    values, cost = minimize_least_squares(
        params[free], cost_of, normal_equations, max_steps=steps, least_gain=_LEAST_GAIN
    )
    return np.array(lens_of(values).params), float(cost)


def _residuals(lens: Camera, target: FitTarget) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) pixels by which the lens misses, 0 for points that it does not see; which it sees."""
    found, valid = lens.project(target.points)
    return np.where(valid[:, None], target.pixels - np.nan_to_num(found), 0.0), valid


def _fit_ftheta(target: FitTarget) -> np.ndarray:
    """Angle to pixel; the other polynomial, which only starts its inverse, is fitted to it."""
    focal, centre = _axis(target, "ftheta")
    limit = min(float(angles_of(target.points).max()) + _FTHETA_BEYOND, math.pi)
    start = np.zeros(19)
    start[:3] = (*centre, 1.0)
    start[_FTHETA_B + 1] = 1.0 / focal[1]
    start[_FTHETA_A + 1] = focal[1]
    start[_FTHETA_LINEAR - 1] = limit
    start[_FTHETA_LINEAR] = focal[0] / focal[1]
    fixed = tuple(i for i in range(len(start)) if i not in _FTHETA_FREE)
    params, _ = _widening("ftheta", start, fixed, target)
    theta = np.linspace(0.0, limit, 400)[1:]
    powers = np.arange(1, _FTHETA_DEGREE + 1)
    radius = (theta[:, None] ** powers) @ params[_FTHETA_A + 1 : _FTHETA_A + 1 + _FTHETA_DEGREE]
    share = radius / radius[-1]
    back = np.linalg.lstsq(share[:, None] ** powers, theta, rcond=None)[0]
    params[_FTHETA_B + 1 : _FTHETA_B + 1 + _FTHETA_DEGREE] = back / radius[-1] ** powers
    return params


def _fit_spline(target: FitTarget, grid: SplineGrid) -> np.ndarray:
    """Pixels are linear in the control points: one least-squares problem an axis."""
    if grid.order not in (2, 3):
        raise InputError(f"the order of a spline must be 2 or 3, found {grid.order}")
    if grid.columns <= grid.order:
        raise InputError(
            f"a spline of order {grid.order} needs at least {grid.order + 1} control points "
            f"across, found {grid.columns}"
        )
    focal, centre = _axis(target, "splined_stereographic")
    norm = np.linalg.norm(target.points, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = 2.0 * target.points[:, :2] / (norm + target.points[:, 2])[:, None]
    if not np.hypot(*plane.T).max() < _SPLINE_LARGEST:
        raise InputError(
            "'splined_stereographic' sees at most 168 degrees from the axis, and the image has "
            "rays beyond; leave them out (--max-angle)"
        )
    reach = _SPLINE_REACH * np.abs(plane).max(axis=0)
    density = (grid.columns - grid.order) / (2.0 * reach[0])
    needed = max(grid.order + 1, math.ceil(grid.order + 2.0 * reach[1] * density))
    rows = needed if grid.rows is None else grid.rows
    if rows < needed:
        raise InputError(
            f"{grid.columns} control points across need at least {needed} down for this image, "
            f"found {rows}"
        )
    params = np.zeros(_SPLINE_POINTS + 2 * grid.columns * rows)
    fov = math.degrees(4.0 * math.atan(0.5 * reach[0]))
    params[:_SPLINE_POINTS] = (grid.order, grid.columns, rows, fov, *focal, *centre)
    size = target.camera.width, target.camera.height
    flat = Camera("splined_stereographic", params, *size)
    found, valid = flat.project(target.points)
    if not valid.all():
        raise InputError("the control points do not cover the image; use more of them")
    weights = (
        _basis(plane[:, 0] * density, grid.columns, grid.order)[:, None, :]
        * _basis(plane[:, 1] * density, rows, grid.order)[:, :, None]
    ).reshape(len(plane), -1)
    bends = _SPLINE_SMOOTH * math.sqrt(len(weights)) * _bends(grid.columns, rows)
    normal = weights.T @ weights + bends.T @ bends
    points = np.linalg.solve(normal, weights.T @ ((target.pixels - found) / focal))
    params[_SPLINE_POINTS:] = points.ravel()
    return params


def _basis(place: np.ndarray, count: int, order: int) -> np.ndarray:
    """(N, count) weights of the control points of a uniform B-spline; place 0 is their middle."""
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


def _bends(columns: int, rows: int) -> np.ndarray:
    """Second differences of a grid along both axes, one a row."""
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
