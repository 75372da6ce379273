"""The lenses that gsut has, through its public names: projection, rays and domain of a solution."""

from __future__ import annotations

import gsut
import numpy as np

from calib.solution import LENSES, CameraSolution

PIXEL_SHIFT = 0.5  # calib, OpenCV and mrcal have a pixel's centre at whole numbers, gsut at halves


def gsut_camera(camera: CameraSolution) -> gsut.Camera | None:
    """The solved lens as gsut's camera, or None where gsut has no such lens.

    Raises:
        gsut.InputError: the parameters are no lens.
    """
    model = LENSES[camera.lens][0]
    if model not in gsut.camera_models():
        return None
    return gsut.Camera(model, _gsut_params(camera, camera.params), camera.width, camera.height)


def _gsut_params(camera: CameraSolution, params: np.ndarray) -> np.ndarray:
    shifted = np.array(params, dtype=float)
    shifted[2:4] += PIXEL_SHIFT
    if camera.lens != "splined":
        return shifted
    fields = dict(field.split("=") for field in camera.model.split("_") if "=" in field)
    order, columns, rows = int(fields["order"]), int(fields["Nx"]), int(fields["Ny"])
    angle = float(camera.model.rsplit("=", 1)[1])
    return np.concatenate([[order, columns, rows, angle], shifted])


def projector(camera: CameraSolution):
    """A `bundle.Projector` of the camera's kind of lens, with params as in `CameraSolution`."""
    model, size = LENSES[camera.lens][0], (camera.width, camera.height)

    def project(params: np.ndarray, points: np.ndarray):
        shifted = np.array(params, dtype=float)
        shifted[2:4] += PIXEL_SHIFT
        lens = gsut.Camera(model, shifted, *size)
        pixels, _ = lens.project(points)
        by_point, by_params = lens.project_jacobian(points)
        return pixels - PIXEL_SHIFT, by_point, by_params

    return project
