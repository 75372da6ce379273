"""Compares poses with a reference: best similarity, then errors of centres and rotations."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.data import load_dataset
from gsut.data.poses import find_centers
from gsut.gaussians import measure_rotation_angles
from gsut.sfm.solution import similarity_from_points
from gsut.sfm.world.control_file import FEWEST_CONTROL


@dataclasses.dataclass(frozen=True)
class PoseErrors:
    """Errors after the best similarity.

    Args:
        images: number of compared images.
        ate: root of the mean squared distance of the centres, in the reference's unit.
        metric_ate: the same after the best rotation and shift alone, for poses in the reference's
            unit.
        scale: of the similarity: the reference's unit over that of the poses.
        extent: of the reference: diagonal of the box around its camera centres.
        rotation_degrees: (N,) angles between the rotations.
        center_distances: (N,) in the reference's unit.
        reference_from_world: (4, 4) similarity.
    """

    images: int
    ate: float
    metric_ate: float
    scale: float
    extent: float
    rotation_degrees: np.ndarray
    center_distances: np.ndarray
    reference_from_world: np.ndarray

    @property
    def ate_percent(self) -> float:
        """ATE in percent of the extent."""
        return 100.0 * self.ate / self.extent

    @property
    def scale_error_percent(self) -> float:
        """Excess of lengths over the reference's, in percent."""
        return 100.0 * (1.0 / self.scale - 1.0)


@name_wrong_kinds
def compare_poses(camera_from_world: np.ndarray, reference: np.ndarray) -> PoseErrors:
    """Measures the errors of poses against a reference.

    Args:
        camera_from_world: (N, 4, 4).
        reference: (N, 4, 4) camera_from_reference of the same images.

    Returns:
        Errors after the similarity that brings the camera centres closest.

    Raises:
        InputError: fewer than three images, or shapes that do not fit.
    """
    if camera_from_world.shape != reference.shape or camera_from_world.shape[1:] != (4, 4):
        raise InputError(
            f"poses must be two arrays (N, 4, 4), found {camera_from_world.shape} and "
            f"{reference.shape}"
        )
    if len(reference) < FEWEST_CONTROL:
        raise InputError(
            f"{len(reference)} poses determine no similarity; at least {FEWEST_CONTROL} are needed"
        )
    centers, targets = find_centers(camera_from_world), find_centers(reference)
    scale, rotation, translation = similarity_from_points(centers, targets)
    distances = np.linalg.norm(scale * centers @ rotation.T + translation - targets, axis=1)
    about_mean = (centers - centers.mean(axis=0)) @ rotation.T - (targets - targets.mean(axis=0))
    relative = camera_from_world[:, :3, :3] @ rotation.T @ reference[:, :3, :3].transpose(0, 2, 1)
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation
    matrix[:3, 3] = translation
    return PoseErrors(
        images=len(reference),
        ate=float(np.sqrt((distances**2).mean())),
        metric_ate=float(np.sqrt((about_mean**2).sum(axis=1).mean())),
        scale=scale,
        extent=float(np.linalg.norm(targets.max(axis=0) - targets.min(axis=0))),
        rotation_degrees=np.degrees(measure_rotation_angles(relative)),
        center_distances=distances,
        reference_from_world=matrix,
    )


def read_poses_by_path(data: str | os.PathLike[str]) -> dict[Path, np.ndarray]:
    """Reads (4, 4) camera_from_world of a dataset's images."""
    return {
        view.image_path.resolve(): view.camera_from_world
        for view in load_dataset(data, test_every=0).views
    }


def compare_datasets(
    reference: str | os.PathLike[str], found: str | os.PathLike[str]
) -> PoseErrors:
    """Measures the errors of a dataset's poses against a reference dataset's, by shared images.

    Raises:
        InputError: a dataset cannot be read, or they share fewer than three images.
    """
    truth, own = read_poses_by_path(reference), read_poses_by_path(found)
    shared = [path for path in own if path in truth]
    return compare_poses(
        np.array([own[path] for path in shared]).reshape(-1, 4, 4),
        np.array([truth[path] for path in shared]).reshape(-1, 4, 4),
    )
