"""The splined-stereographic lens nearest to a Kannala-Brandt one: linear in its control points."""

from __future__ import annotations

import numpy as np

from calib.lens import gsut_camera, projector
from calib.solution import LENSES, CameraSolution
from gsut.lens import fit_control_points

_PITCH_DEGREES = 9.0  # between knots: leaves less than a thousandth of a pixel on real fisheyes
_SAMPLES = 120  # each way over the splined field
_EDGE = np.radians(0.2)  # kept from the fold
_SPLINE_ORDER = 3
_FEWEST_KNOTS = 6  # each way: a cubic patch and one more on either side
_SPLINE_MARGIN = 1.04  # of the field beyond the image's edge
_WIDEST_DEGREES = 320.0  # of the splined field: the projection ends at 360


def splined_like(
    camera: CameraSolution, domain: float, pitch_degrees: float = _PITCH_DEGREES
) -> tuple[str, list[float], float]:
    """Fits over the lens' domain, which may end inside the image.

    Args:
        camera: a fisheye solution. domain: radians to its fold. pitch_degrees: between knots.

    Returns:
        mrcal's name of the lens, its parameters, and the largest error in pixels.
    """
    model = splined_model(camera, pitch_degrees)
    return model, *_fit(camera, domain, model)


def nearest_params(camera: CameraSolution, model: str) -> list[float]:
    """Parameters of the splined lens of mrcal's name `model` nearest to a fisheye solution."""
    return _fit(camera, float(gsut_camera(camera).max_angle), model)[0]


def _fit(camera: CameraSolution, domain: float, model: str) -> tuple[list[float], float]:
    fields = model.split("_")
    columns, rows = (int(f[3:]) for f in fields if f.startswith(("Nx=", "Ny=")))
    field_degrees = float(fields[-1].split("=")[1])
    knots_per_u = (columns - 1 - 2) / (4 * np.tan(np.radians(field_degrees) / 4))
    reach = [(count - 1 - 2) / (2 * knots_per_u) for count in (columns, rows)]
    ux, uy = np.meshgrid(*(np.linspace(-r, r, _SAMPLES) for r in reach))
    u = np.stack([ux, uy], axis=-1).reshape(-1, 2)
    angle = 2 * np.arctan(np.linalg.norm(u, axis=1) / 2)
    u = u[angle < min(domain, np.pi) - _EDGE]
    square = np.sum(u**2, axis=1, keepdims=True) / 4
    points = np.concatenate([u / (1 + square), (1 - square) / (1 + square)], axis=1)
    pixels = projector(camera)(camera.params, points)[0]
    target = (pixels - camera.params[2:4]) / camera.params[:2] - u
    control, fitted = fit_control_points(u, target, knots_per_u, (columns, rows), _SPLINE_ORDER)
    error = np.abs((fitted - target) * camera.params[:2]).max()
    return [*camera.params[:4].tolist(), *control.ravel().tolist()], float(error)


def splined_model(fisheye: CameraSolution, pitch_degrees: float) -> str:
    """mrcal's name of a splined lens that covers the image, its knots a fixed angle apart.

    Args:
        fisheye: the Kannala-Brandt lens of the same boards.
        pitch_degrees: between knots, at the axis.
    """
    fx, fy, cx, cy = fisheye.params[:4]
    half_x = _field_angle(max(cx, fisheye.width - 1 - cx) / fx, fisheye.params[4:])
    half_y = _field_angle(max(cy, fisheye.height - 1 - cy) / fy, fisheye.params[4:])
    degrees = min(2 * np.degrees(half_x) * _SPLINE_MARGIN, _WIDEST_DEGREES)
    # Stereographic u = 2 tan(angle / 2); one cell of a cubic spline lies beyond either edge.
    reach_x, reach_y = 2 * np.tan(np.radians(degrees) / 4), 2 * np.tan(half_y / 2)
    pitch = 2 * np.tan(np.radians(pitch_degrees) / 2)
    columns = max(_FEWEST_KNOTS, int(np.ceil(2 * reach_x / pitch)) + _SPLINE_ORDER)
    pitch = 2 * reach_x / (columns - _SPLINE_ORDER)
    rows = max(_FEWEST_KNOTS, int(np.ceil(2 * reach_y / pitch)) + _SPLINE_ORDER)
    return (
        f"{LENSES['splined'][1]}_order={_SPLINE_ORDER}_Nx={columns}_Ny={rows}"
        f"_fov_x_deg={round(float(degrees))}"
    )


def _field_angle(distorted: float, coefficients: np.ndarray) -> float:
    """Radians at a distorted radius: by the lens where it is one-to-one, else equidistant."""
    angle = np.linspace(0.0, np.pi, 2000)
    radius = angle * (1 + np.polyval([*coefficients[::-1], 0.0], angle**2))
    folds = np.flatnonzero(np.diff(radius) <= 0)
    last = folds[0] if len(folds) else len(radius) - 1
    if distorted <= radius[last]:
        return float(np.interp(distorted, radius[: last + 1], angle[: last + 1]))
    return float(min(max(distorted, angle[last]), np.pi))
