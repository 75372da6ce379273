"""The splined-stereographic lens nearest to a Kannala-Brandt one: linear in its control points."""

from __future__ import annotations

import numpy as np

from calib.lens import projector
from calib.solution import CameraSolution
from calib.solve_mrcal import splined_model

_PITCH_DEGREES = 9.0  # between knots: leaves less than a thousandth of a pixel on real fisheyes
_SAMPLES = 120  # each way over the splined field
_EDGE = np.radians(0.2)  # kept from the fold
_RIDGE = 1e-9  # holds control points that no sample touches at 0


def splined_like(camera: CameraSolution, domain: float) -> tuple[str, list[float], float]:
    """Fits over the lens' domain, which may end inside the image.

    Args:
        camera: a fisheye solution. domain: radians to its fold.

    Returns:
        mrcal's name of the lens, its parameters, and the largest error in pixels.
    """
    model = splined_model(camera, _PITCH_DEGREES)
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
    basis = _basis(u[:, 0], columns, knots_per_u), _basis(u[:, 1], rows, knots_per_u)
    design = np.einsum("ni,nj->nij", basis[1], basis[0]).reshape(len(u), rows * columns)
    normal = design.T @ design
    normal[np.diag_indices_from(normal)] += _RIDGE
    control = np.linalg.solve(normal, design.T @ target)
    error = np.abs((design @ control - target) * camera.params[:2]).max()
    return model, [*camera.params[:4].tolist(), *control.ravel().tolist()], float(error)


def _basis(u: np.ndarray, count: int, knots_per_u: float) -> np.ndarray:
    """(N, count) weights of a uniform cubic B-spline's control points at coordinates u (N,)."""
    position = u * knots_per_u + (count - 1) / 2
    cell = np.clip(np.floor(position).astype(int), 1, count - 3)
    t = position - cell
    weights = np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1
    )
    basis = np.zeros((len(u), count))
    np.put_along_axis(basis, cell[:, None] + np.arange(-1, 3), weights / 6, axis=1)
    return basis
