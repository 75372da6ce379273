"""Projects through solved lenses: pixels with derivatives, rays of pixels, gsut's camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

import gsut
from calib.camera.bundle import Projector
from calib.camera.solution import LENSES, CameraSolution

PIXEL_SHIFT = 0.5  # gsut's pixel centres lie at halves, those of calib at whole numbers


def to_gsut_camera(camera: CameraSolution) -> gsut.Camera:
    """Converts the solved lens to gsut's camera.

    Raises:
        gsut.InputError: the parameters are no lens.
    """
    params = np.concatenate([_list_configuration(camera), _shift_center(camera.params)])
    return gsut.Camera(LENSES[camera.lens][0], params, camera.width, camera.height)


def parse_splined_name(model: str) -> list[float]:
    """Reads order, Nx, Ny and the horizontal field in degrees from mrcal's name of the lens."""
    words = ("order", "Nx", "Ny", "fov_x_deg")
    return [float(model.split(f"_{word}=")[1].split("_")[0]) for word in words]


def unproject_pixels(camera: CameraSolution, pixels: np.ndarray) -> np.ndarray:
    """Returns the unit rays (N, 3) of pixels (N, 2); NaN where the lens has none."""
    found, _ = to_gsut_camera(camera).unproject(np.asarray(pixels, float) + PIXEL_SHIFT)
    return found


def make_projector(camera: CameraSolution) -> Projector:
    """Returns the projection that the solver used.

    Radial-tangential lenses use OpenCV's formula, which knows no domain: a fit with a pole must be
    seen as the solver saw it. The fisheye uses gsut's, since OpenCV's is wrong behind the camera;
    so does the splined lens, which gsut projects as mrcal does.
    """
    if camera.lens in ("opencv4", "opencv8"):
        return project_radially
    name, size = LENSES[camera.lens][0], (camera.width, camera.height)
    return make_gsut_projector(name, *size, _list_configuration(camera))


def make_gsut_projector(
    name: str, width: int, height: int, configuration: Sequence[float] = ()
) -> Projector:
    """Returns the projection of gsut's lens `name` in calib's pixels.

    Args:
        name: of the lens in gsut. width, height: in pixels.
        configuration: gsut's first parameters of the lens, which no solve changes.
    """

    def project(params: np.ndarray, points: np.ndarray):
        lens = gsut.Camera(name, [*configuration, *_shift_center(params)], width, height)
        pixels, _ = lens.project(points)
        by_point, by_params = lens.project_jacobian(points)
        return pixels - PIXEL_SHIFT, by_point, by_params[..., len(configuration) :]

    return project


def project_radially(params: np.ndarray, points: np.ndarray):
    """Projects by OpenCV's radial-tangential formula; a `Projector`."""
    fx, fy, cx, cy = params[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    zero = np.zeros(3)
    pixels, jacobian = cv2.projectPoints(points, zero, zero, matrix, params[4:])
    rows = jacobian.reshape(len(points), 2, -1)
    # OpenCV's columns: rotation 0-2, translation 3-5, focal lengths, centre, coefficients.
    return pixels.reshape(-1, 2), rows[..., 3:6], rows[..., 6 : 6 + len(params)]


def _list_configuration(camera: CameraSolution) -> list[float]:
    return parse_splined_name(camera.model) if camera.lens == "splined" else []


def _shift_center(params: np.ndarray) -> np.ndarray:
    shifted = np.array(params, dtype=float)
    shifted[2:4] += PIXEL_SHIFT
    return shifted
