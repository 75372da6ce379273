"""Checks pose matrices of dataset files and turns them into OpenCV's axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gsut._core import interpolate_pose
from gsut.bounds import FARTHEST
from gsut.data.errors import DatasetError
from gsut.gaussians import find_nearest_rotation

# Largest entry of R^T R - I. Files with 4 decimals reach 2e-4, a real scale or shear is far above.
ROTATION_TOLERANCE = 1e-3
# OpenGL's camera (x right, y up, z backward) against OpenCV's (x right, y down, z forward).
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def check_rigid(values: object, where: object) -> np.ndarray:
    """Checks a 4x4 or 3x4 matrix and returns the nearest rigid transform.

    Args:
        values: nested lists or an array, rotation and translation.
        where: file and frame, for messages.
    Returns:
        (4, 4) float64; the rotation is orthonormal to rounding.
    Raises:
        DatasetError: not numbers, not finite, a wrong shape, last row or rotation.
    """
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DatasetError(
            where, "the pose is not a matrix of numbers", "write 4 rows of 4 numbers"
        ) from error
    if matrix.shape not in ((4, 4), (3, 4)):
        raise DatasetError(
            where,
            f"the pose has shape {matrix.shape}, expected (4, 4)",
            "write 4 rows of 4 numbers",
        )
    usable = np.abs(matrix) <= FARTHEST  # NaN is not
    if not usable.all():
        row, column = np.argwhere(~usable)[0]
        raise DatasetError(
            where,
            f"the pose holds {matrix[row, column]} in row {row}, column {column}",
            "estimate this pose again or leave the frame out",
        )
    if matrix.shape == (4, 4) and np.abs(matrix[3] - [0, 0, 0, 1]).max() > ROTATION_TOLERANCE:
        raise DatasetError(
            where,
            f"the pose's last row is {matrix[3].tolist()}, expected [0, 0, 0, 1]",
            "write the matrix by rows, not transposed",
        )
    _require_rotation(matrix[:3, :3], where)
    rigid = np.eye(4)
    rigid[:3, :3] = find_nearest_rotation(matrix[:3, :3])
    rigid[:3, 3] = matrix[:3, 3]
    return rigid


def _require_rotation(rotation: np.ndarray, where: object) -> None:
    gram = rotation.T @ rotation
    deviation = np.abs(gram - np.eye(3)).max()
    if deviation > ROTATION_TOLERANCE:
        scale = np.sqrt(np.trace(gram) / 3)
        if scale > 0 and np.abs(gram / scale**2 - np.eye(3)).max() < ROTATION_TOLERANCE:
            raise DatasetError(
                where,
                f"the pose is a rotation times a uniform scale of {scale:.6g}",
                "divide the upper left 3 x 3 block by that scale",
            )
        raise DatasetError(
            where,
            f"the pose is not a rotation: R^T R differs from the identity by {deviation:.3g}"
            f" (tolerance {ROTATION_TOLERANCE:g})",
            "export the pose again as a rotation and a translation",
        )
    if np.linalg.det(rotation) < 0:
        raise DatasetError(
            where,
            "the pose mirrors the scene (determinant -1)",
            "flip two axes of the camera, not one or three",
        )


def pose_from_quaternion(quat_wxyz: ArrayLike, translation: ArrayLike, where: object) -> np.ndarray:
    """Makes a transform (4, 4) of a unit quaternion w, x, y, z and a translation.

    Raises:
        DatasetError: not finite, or the norm is not 1 within `ROTATION_TOLERANCE`.
    """
    quat = np.array(quat_wxyz, dtype=np.float64)
    pose = np.eye(4)
    pose[:3, 3] = np.asarray(translation, dtype=np.float64)
    if not ((np.abs(quat) <= FARTHEST).all() and (np.abs(pose) <= FARTHEST).all()):
        raise DatasetError(
            where,
            "the pose holds NaN or infinity, or an absurd number",
            "estimate it again, or leave it out",
        )
    norm = np.linalg.norm(quat)
    if abs(norm - 1) > ROTATION_TOLERANCE:
        raise DatasetError(
            where,
            f"the quaternion's norm is {norm:.6g}, expected 1",
            "check the order of the numbers, or normalise it",
        )
    w, x, y, z = quat / norm
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return pose


def invert_pose(pose: np.ndarray) -> np.ndarray:
    """Inverts a rigid transform (4, 4), exactly in the rotation."""
    result = np.eye(4)
    result[:3, :3] = pose[:3, :3].T
    result[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return result


def average_poses(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Averages two poses: mean translation, rotation half way along the shorter arc."""
    relative = start[:3, :3].T @ end[:3, :3]
    # (I + R) is twice the half rotation's projection: its polar factor is the square root of R.
    pose = np.eye(4)
    pose[:3, :3] = start[:3, :3] @ find_nearest_rotation(np.eye(3) + relative)
    pose[:3, 3] = (start[:3, 3] + end[:3, 3]) / 2
    return pose


def find_centers(camera_from_world: np.ndarray) -> np.ndarray:
    """Returns the camera centres (N, 3) of poses (N, 4, 4)."""
    return -np.einsum("nji,nj->ni", camera_from_world[:, :3, :3], camera_from_world[:, :3, 3])


def move_poses(
    camera_from_world: np.ndarray, scale: float, rotation: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Carries poses (..., 4, 4) to the world scale rotation x + shift; they stay rigid."""
    moved = np.array(camera_from_world)
    moved[..., :3, :3] = camera_from_world[..., :3, :3] @ rotation.T
    moved[..., :3, 3] = scale * camera_from_world[..., :3, 3] - moved[..., :3, :3] @ shift
    return moved


def split_similarity(matrix: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Splits a similarity (4, 4) into scale, rotation (3, 3) and shift (3,)."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return scale, matrix[:3, :3] / scale, matrix[:3, 3]


def interpolate_between(one: np.ndarray, two: np.ndarray, share: float) -> np.ndarray:
    """Interpolates two poses: the origin along the line, the rotation along the shorter arc."""
    if share == 0.0:
        return one
    turns = one.copy(), two.copy()
    for turn in turns:
        turn[:3, 3] = 0.0
    pose = np.array(interpolate_pose(*turns, share))
    pose[:3, 3] = (1.0 - share) * one[:3, 3] + share * two[:3, 3]
    return pose
