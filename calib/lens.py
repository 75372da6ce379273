"""What a solved lens does: projection with derivatives, rays of pixels, gsut's camera of it."""

from __future__ import annotations

import cv2
import numpy as np

import gsut
from calib.bundle import Projector
from calib.solution import LENSES, CameraSolution

PIXEL_SHIFT = 0.5  # calib, OpenCV and mrcal have a pixel's centre at whole numbers, gsut at halves


def gsut_camera(camera: CameraSolution) -> gsut.Camera:
    """The solved lens as gsut's camera.

    Raises:
        gsut.InputError: the parameters are no lens.
    """
    params = _shifted(camera.params)
    if camera.lens == "splined":
        params = np.concatenate([splined_configuration(camera.model), params])
    return gsut.Camera(LENSES[camera.lens][0], params, camera.width, camera.height)


def splined_configuration(model: str) -> list[float]:
    """Order, Nx, Ny and horizontal field in degrees out of mrcal's name of a splined lens."""
    words = ("order", "Nx", "Ny", "fov_x_deg")
    return [float(model.split(f"_{word}=")[1].split("_")[0]) for word in words]


def rays(camera: CameraSolution, pixels: np.ndarray) -> np.ndarray:
    """(N, 3) unit rays of pixels (N, 2); NaN where the lens has none."""
    found, _ = gsut_camera(camera).unproject(np.asarray(pixels, float) + PIXEL_SHIFT)
    return found


def projector(camera: CameraSolution) -> Projector:
    """The projection that the solver used, for lenses other than splined.

    Radial-tangential lenses by OpenCV's formula, which knows no domain: a fit with a pole must be
    seen for what the solver saw. The fisheye by gsut, since OpenCV's is wrong behind the camera.
    """
    return (
        fisheye_projector(camera.width, camera.height)
        if camera.lens == "fisheye"
        else radial_projector
    )


def fisheye_projector(width: int, height: int) -> Projector:
    """gsut's Kannala-Brandt lens in calib's pixels."""

    def project(params: np.ndarray, points: np.ndarray):
        lens = gsut.Camera("kannala_brandt", _shifted(params), width, height)
        pixels, _ = lens.project(points)
        by_point, by_params = lens.project_jacobian(points)
        return pixels - PIXEL_SHIFT, by_point, by_params

    return project


def radial_projector(params: np.ndarray, points: np.ndarray):
    """OpenCV's radial-tangential projection; a `Projector`."""
    fx, fy, cx, cy = params[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    zero = np.zeros(3)
    pixels, jacobian = cv2.projectPoints(points, zero, zero, matrix, params[4:])
    rows = jacobian.reshape(len(points), 2, -1)
    # OpenCV's columns: rotation 0-2, translation 3-5, focal lengths, centre, coefficients.
    return pixels.reshape(-1, 2), rows[..., 3:6], rows[..., 6 : 6 + len(params)]


def _shifted(params: np.ndarray) -> np.ndarray:
    shifted = np.array(params, dtype=float)
    shifted[2:4] += PIXEL_SHIFT
    return shifted
