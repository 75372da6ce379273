"""Finds the parameters of a lens that sends given points to given pixels."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import MOST_WHOLE
from gsut.least_squares import LEAST_GAIN, minimize_least_squares
from gsut.lens.camera import Camera, camera_models
from gsut.lens.fit_spline import fit_spline

CONTROL_COLUMNS = 16  # control points across the image, of a splined lens
_MOST_PARAMS = 64
_MAX_STEPS = 300
_STEPS_WIDENING = 60  # while the field still widens
_GOOD_PX = 1e-4  # root mean square with which no other start is tried
_GAIN_WIDENING = 1e-6  # the same while the field still widens: where the next one starts


@dataclasses.dataclass(frozen=True)
class FitTarget:
    """What the new lens is to do.

    Attributes:
        camera: the lens to imitate.
        points: (N, 3) in the camera frame.
        pixels: (N, 2) where they are to be seen.
        distance: of the points from the camera, for the scale of lenses of parallel rays.
        several_distances: whether the points distinguish lenses whose rays do not meet.
    """

    camera: Camera
    points: np.ndarray
    pixels: np.ndarray
    distance: float
    several_distances: bool


def find_angles(points: np.ndarray) -> np.ndarray:
    """Returns the angles (N,) of points (N, 3) from the axis, in radians."""
    return np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])


def check_model(model: str, num_params: int | None) -> None:
    """Raises InputError if there is no such lens, or not with that many coefficients."""
    if model not in camera_models():
        raise InputError(f"unknown camera model '{model}'; known: {', '.join(camera_models())}")
    if num_params is None:
        return
    if not 0 <= num_params <= MOST_WHOLE or not _core.camera_accepts_params(model, num_params):
        raise InputError(
            f"'{model}' does not take {num_params} parameters; it takes"
            f" {_core.camera_param_names(model)}"
        )
    if num_params > _MOST_PARAMS and not model.startswith("splined"):
        raise InputError(
            f"{num_params} parameters for '{model}'; more than {_MOST_PARAMS} fit nothing but noise"
        )


def fit_lens(
    target: FitTarget, model: str, num_params: int | None = None, columns: int = CONTROL_COLUMNS
) -> np.ndarray:
    """Fits the parameters of a lens of `model` by least squares of the pixel distances.

    Where to start and what to hold stands in the lens' own file (cpp/gsut/cameras/models).

    Args:
        target: points and pixels.
        model: see `camera_models()`.
        num_params: of a lens with any number of coefficients; None: the number its file starts
            with.
        columns: control points across the image, of a lens with a table of them.

    Raises:
        InputError: no such model or number of parameters; points that the lens cannot see.
    """
    check_model(model, num_params)
    traits = _core.camera_traits(model)
    focal, centre = _find_axis(target, traits.is_parallel)
    if traits.has_table:
        return fit_spline(focal, centre, target.points, target.pixels, columns)
    fixed = tuple(traits.fit_held)
    if not target.several_distances:
        fixed += tuple(traits.fit_near)
    found = []
    widest = float(find_angles(target.points).max())
    for values in _core.camera_fit_starts(model, tuple(focal), tuple(centre), widest):
        start = np.array(values)
        if num_params is not None:
            start = np.pad(start, (0, max(0, num_params - len(start))))[:num_params]
        if len(start) == 0:  # the image's size is the lens
            return start
        found.append(_widen(model, start, fixed, target))
        if found[-1][1] <= _find_enough(target):
            break
    return min(found, key=lambda one: one[1])[0]


def _find_axis(target: FitTarget, is_parallel: bool) -> tuple[np.ndarray, np.ndarray]:
    """Returns the focal lengths (2,) on the axis, and the axis' pixel (2,)."""
    axis = np.array([[0.0, 0.0, target.distance]])
    (centre,), valid = target.camera.project(axis)
    if not valid[0]:
        raise InputError("the lens does not see its own axis: nothing to start a fit from")
    jacobian, _ = target.camera.project_jacobian(axis, with_params=False)
    focal = np.abs([jacobian[0, 0, 0], jacobian[0, 1, 1]])
    return (focal if is_parallel else focal * target.distance), centre


def _find_enough(target: FitTarget) -> float:
    """Returns the cost below which no other start is tried."""
    return _GOOD_PX**2 * len(target.points)


def _widen(
    model: str, start: np.ndarray, fixed: tuple[int, ...], target: FitTarget
) -> tuple[np.ndarray, float]:
    """Fits from the centre of the field outwards, so that no ray starts outside the domain."""
    params, cost = start, math.inf
    angles = find_angles(target.points)
    for share in (0.25, 0.5, 0.75, 1.0):
        near = angles <= max(share * angles.max(), np.sort(angles)[min(60, len(angles) - 1)])
        part = dataclasses.replace(target, points=target.points[near], pixels=target.pixels[near])
        enough = _find_enough(part)
        ends = (_MAX_STEPS, LEAST_GAIN, 0.0)
        if share < 1.0:
            ends = (_STEPS_WIDENING, _GAIN_WIDENING, enough)
        cost = math.inf
        # What fits the centre may have a pole just beyond it: the first guess gets its chance too.
        for guess in (params, start):
            if cost > enough:
                found = _refine(model, guess, fixed, part, *ends)
                params, cost = min((params, cost), found, key=lambda one: one[1])
    return params, cost


def _refine(
    model: str,
    params: np.ndarray,
    fixed: tuple[int, ...],
    target: FitTarget,
    steps: int,
    least_gain: float,
    enough: float,
) -> tuple[np.ndarray, float]:
    """Minimizes the pixel distances from `params` on; returns the parameters and their cost."""
    free = [i for i in range(len(params)) if i not in fixed]

    # Cost and derivatives are asked of the same lens, and making one is dear.
    @functools.lru_cache(maxsize=1)
    def try_params(values: bytes) -> tuple[_core.Camera, np.ndarray, np.ndarray]:
        moved = params.copy()
        moved[free] = np.frombuffer(values)
        lens = _core.Camera(  # on the way through numbers that no lens has
            model, moved.tolist(), target.camera.width, target.camera.height
        )
        return lens, *_find_residuals(lens, target)

    def rate_params(values: np.ndarray) -> float:
        try:
            lens, residual, valid = try_params(values.tobytes())
        except InputError:  # a parameter left its range
            return math.inf
        # A point that the lens does not see counts as one at the image's own size.
        unseen = float(lens.width**2 + lens.height**2)
        return float((residual**2).sum() + unseen * (~valid).sum())

    def build_normal_equations(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lens, residual, valid = try_params(values.tobytes())
        jacobian = -lens.project_jacobian(target.points, free)[1][valid]
        jacobian = jacobian.reshape(-1, len(free))
        return jacobian.T @ residual[valid].ravel(), jacobian.T @ jacobian

    values, cost = minimize_least_squares(
        params[free],
        rate_params,
        build_normal_equations,
        max_steps=steps,
        least_gain=least_gain,
        enough=enough,
    )
    return np.array(try_params(values.tobytes())[0].params), float(cost)


def _find_residuals(lens: _core.Camera, target: FitTarget) -> tuple[np.ndarray, np.ndarray]:
    """Returns the misses (N, 2) in pixels, 0 for unseen points, and which points are seen."""
    found, valid = lens.project(target.points)
    return np.where(valid[:, None], target.pixels - np.nan_to_num(found), 0.0), valid
