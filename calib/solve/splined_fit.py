"""Fits a splined-stereographic lens to a Kannala-Brandt one: linear in its control points."""

from __future__ import annotations

import numpy as np

from calib.camera import (
    LENSES,
    CameraSolution,
    make_projector,
    parse_splined_name,
    to_gsut_camera,
)
from gsut.lens import fit_control_points

_PITCH_DEGREES = 9.0  # between knots: leaves less than a thousandth of a pixel on real fisheyes
_SAMPLES = 120  # of the splined field, each way: several per knot
_EDGE = np.radians(0.2)  # distance from the fold, where derivatives run away
_SPLINE_ORDER = 3  # mrcal's default
_FEWEST_KNOTS = 6  # each way: a cubic patch and one more on either side
_SPLINE_MARGIN = 1.04  # ratio of the splined field to the image's, so that no edge is cut
_WIDEST_DEGREES = 320.0  # of the splined field: the projection ends at 360


def fit_splined(camera: CameraSolution, domain: float) -> tuple[str, list[float], float]:
    """Fits a splined lens over the fisheye's domain, which may end inside the image.

    Args:
        camera: a fisheye solution. domain: radians to its fold.

    Returns:
        mrcal's name of the lens, its parameters, and the largest error in pixels.
    """
    model = name_splined_model(camera, _PITCH_DEGREES)
    return model, *_fit(camera, domain, model)


def fit_splined_params(camera: CameraSolution, model: str) -> list[float]:
    """Fits the parameters of the splined lens of mrcal's name `model` to a fisheye solution."""
    return _fit(camera, float(to_gsut_camera(camera).max_angle), model)[0]


def _fit(camera: CameraSolution, domain: float, model: str) -> tuple[list[float], float]:
    _, columns, rows, field_degrees = parse_splined_name(model)
    columns, rows = int(columns), int(rows)
    knots_per_u = (columns - 1 - 2) / (4 * np.tan(np.radians(field_degrees) / 4))
    reach = [(count - 1 - 2) / (2 * knots_per_u) for count in (columns, rows)]
    ux, uy = np.meshgrid(*(np.linspace(-r, r, _SAMPLES) for r in reach))
    u = np.stack([ux, uy], axis=-1).reshape(-1, 2)
    angle = 2 * np.arctan(np.linalg.norm(u, axis=1) / 2)
    u = u[angle < min(domain, np.pi) - _EDGE]
    square = np.sum(u**2, axis=1, keepdims=True) / 4
    points = np.concatenate([u / (1 + square), (1 - square) / (1 + square)], axis=1)
    pixels = make_projector(camera)(camera.params, points)[0]
    target = (pixels - camera.params[2:4]) / camera.params[:2] - u
    control, fitted = fit_control_points(u, target, knots_per_u, (columns, rows))
    error = np.abs((fitted - target) * camera.params[:2]).max()
    return [*camera.params[:4].tolist(), *control.ravel().tolist()], float(error)


def name_splined_model(fisheye: CameraSolution, pitch_degrees: float) -> str:
    """Names the splined lens, in mrcal's way, that covers the image with evenly spaced knots.

    Args:
        fisheye: the Kannala-Brandt lens of the same boards.
        pitch_degrees: between knots at the axis.
    """
    fx, fy, cx, cy = fisheye.params[:4]
    half_x = _invert_radius(max(cx, fisheye.width - 1 - cx) / fx, fisheye.params[4:])
    half_y = _invert_radius(max(cy, fisheye.height - 1 - cy) / fy, fisheye.params[4:])
    degrees = min(2 * np.degrees(half_x) * _SPLINE_MARGIN, _WIDEST_DEGREES)
    # Stereographic: u = 2 tan(angle / 2). One cell of a cubic spline lies beyond either edge.
    reach_x, reach_y = 2 * np.tan(np.radians(degrees) / 4), 2 * np.tan(half_y / 2)
    pitch = 2 * np.tan(np.radians(pitch_degrees) / 2)
    columns = max(_FEWEST_KNOTS, int(np.ceil(2 * reach_x / pitch)) + _SPLINE_ORDER)
    pitch = 2 * reach_x / (columns - _SPLINE_ORDER)
    rows = max(_FEWEST_KNOTS, int(np.ceil(2 * reach_y / pitch)) + _SPLINE_ORDER)
    return (
        f"{LENSES['splined'][1]}_order={_SPLINE_ORDER}_Nx={columns}_Ny={rows}"
        f"_fov_x_deg={round(float(degrees))}"
    )


def _invert_radius(distorted: float, coefficients: np.ndarray) -> float:
    """Returns the radians at a distorted radius: by the lens up to its fold, then equidistant."""
    angle = np.linspace(0.0, np.pi, 2000)
    radius = angle * (1 + np.polyval([*coefficients[::-1], 0.0], angle**2))
    folds = np.flatnonzero(np.diff(radius) <= 0)
    last = folds[0] if len(folds) else len(radius) - 1
    if distorted <= radius[last]:
        return float(np.interp(distorted, radius[: last + 1], angle[: last + 1]))
    return float(min(max(distorted, angle[last]), np.pi))
