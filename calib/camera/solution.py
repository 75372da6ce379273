"""Holds the result of one camera's solve: its lens, its boards' poses and the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.boards import Board, Photograph
from calib.camera.rigid import transform_points

# By the name that a user gives: gsut's name, mrcal's (None: it has no such lens), coefficients.
LENSES = {
    "fisheye": ("kannala_brandt", None, 4),
    "opencv4": ("opencv4", "LENSMODEL_OPENCV4", 4),
    "opencv8": ("opencv8", "LENSMODEL_OPENCV8", 8),
    "splined": ("splined_stereographic", "LENSMODEL_SPLINED_STEREOGRAPHIC", None),
}
# Robust standard deviations (one axis) beyond which a corner is an outlier: in Gaussian noise one
# of 270 000 is.
OUTLIER_SIGMAS = 5.0
_EXACT_PX = 1e-4  # no detector is more accurate: residuals below this are never outliers


@dataclass
class CameraSolution:
    """One camera's lens and the residuals of its boards.

    Args:
        name: of the camera. lens: a key of LENSES. solver: "opencv" or "mrcal".
        width, height: in pixels.
        model: mrcal's full name of the lens ("LENSMODEL_OPENCV8"), or "KANNALA_BRANDT".
        params: fx fy cx cy and the coefficients in mrcal's order; pixel (0, 0) is a centre.
        camera_from_reference: (6,) Rodrigues rotation and translation.
        photographs: V photographs that were solved with.
        camera_from_board: (V, 6) poses of their boards.
        residuals: (V, corners, 2) pixels, predicted - observed.
        outliers: (V, corners) bool: corners that the solve left out.
        model_text: the .cameramodel as mrcal wrote it, with its optimization_inputs; or None.
        warp: how far the board is bent in its middle, along and across (`Board.locate_corners`).
    """

    name: str
    lens: str
    solver: str
    width: int
    height: int
    model: str
    params: np.ndarray
    camera_from_reference: np.ndarray
    photographs: list[Photograph]
    camera_from_board: np.ndarray
    residuals: np.ndarray
    outliers: np.ndarray
    model_text: str | None = None
    warp: Sequence[float] | None = None

    @property
    def rms_2d_px(self) -> float:
        """The root mean square length of the residuals of inliers, as OpenCV defines it."""
        return float(np.sqrt(np.mean(np.sum(self.residuals[~self.outliers] ** 2, axis=1))))

    @property
    def rms_axis_px(self) -> float:
        """The root mean square of the residuals' coordinates, as mrcal defines it: / sqrt(2)."""
        return float(np.sqrt(np.mean(self.residuals[~self.outliers] ** 2)))

    @property
    def corners(self) -> np.ndarray:
        """The observed pixels (V, corners, 2)."""
        return np.stack([photograph.corners for photograph in self.photographs])

    def locate_corners(self, board: Board) -> np.ndarray:
        """Returns the boards' corners (V, corners, 3) in the camera's frame."""
        flat = board.locate_corners(self.warp)
        return np.stack([transform_points(pose, flat) for pose in self.camera_from_board])

    def measure_field_angles(self, board: Board) -> np.ndarray:
        """Measures the radians (V, corners) between the optical axis and each corner."""
        points = self.locate_corners(board)
        return np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])


def find_outliers(residuals: np.ndarray) -> np.ndarray:
    """Finds residuals (V, corners, 2) beyond OUTLIER_SIGMAS robust deviations, or that are NaN.

    A residual is NaN if the lens has no image of the corner.
    """
    length = np.linalg.norm(residuals, axis=-1)
    sigma = np.nanmedian(length) / np.sqrt(2 * np.log(2))  # the median of Rayleigh's law
    return ~(length <= max(OUTLIER_SIGMAS * sigma, _EXACT_PX))
