"""The result of one camera's solve: its lens, its boards' poses, and the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.board import Board, Photograph
from calib.rigid import transform_points

# Names that a user gives: gsut's name, mrcal's name (None: mrcal has no such lens), coefficients.
LENSES = {
    "fisheye": ("kannala_brandt", None, 4),
    "opencv4": ("opencv4", "LENSMODEL_OPENCV4", 4),
    "opencv8": ("opencv8", "LENSMODEL_OPENCV8", 8),
    "splined": ("splined_stereographic", "LENSMODEL_SPLINED_STEREOGRAPHIC", None),
}
# A corner further off than this many robust standard deviations (one axis) is an outlier: in
# Gaussian noise one of 270 000 is.
OUTLIER_SIGMAS = 5.0
_EXACT_PX = 1e-4  # no corner is found better than that, whatever the others say
_MEDIAN_OF_RAYLEIGH = 1.17741  # median length of a 2-D Gaussian vector over its sigma in one axis


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
        warp: how far the board is bent in its middle, along and across (`Board.points`).
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
        """Root mean square length of the residuals, as OpenCV counts; outliers left out."""
        return float(np.sqrt(np.mean(np.sum(self.residuals[~self.outliers] ** 2, axis=1))))

    @property
    def rms_axis_px(self) -> float:
        """Root mean square of the residuals' coordinates, as mrcal counts: sqrt(2) smaller."""
        return float(np.sqrt(np.mean(self.residuals[~self.outliers] ** 2)))

    def corners(self) -> np.ndarray:
        """(V, corners, 2) observed pixels."""
        return np.stack([photograph.corners for photograph in self.photographs])

    def points(self, board: Board) -> np.ndarray:
        """(V, corners, 3) the boards' corners in the camera's frame."""
        flat = board.points(self.warp)
        return np.stack([transform_points(pose, flat) for pose in self.camera_from_board])

    def field_angles(self, board: Board) -> np.ndarray:
        """(V, corners) radians between the axis and each corner."""
        points = self.points(board)
        return np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])


def find_outliers(residuals: np.ndarray) -> np.ndarray:
    """(V, corners) bool: residuals (V, corners, 2) beyond OUTLIER_SIGMAS robust deviations, and
    those that are NaN because the lens has no image there."""
    length = np.linalg.norm(residuals, axis=-1)
    sigma = np.nanmedian(length) / _MEDIAN_OF_RAYLEIGH
    return ~(length <= max(OUTLIER_SIGMAS * sigma, _EXACT_PX))
