"""Disturbs poses, lenses, points and rigs by known amounts, and measures what is left."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from gsut._core import InputError, exp_pose
from gsut.data import Scene
from gsut.data.poses import invert_pose
from gsut.data.rigs.rig import Rig
from gsut.lens import Camera


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """How far a dataset is moved from the truth.

    Args:
        name: heading of its rows.
        degrees: angle by which each pose is turned, about an axis of its own.
        distance: length by which each camera's centre is moved, world units.
        focal: all focal lengths are multiplied by 1 + focal.
        first_coefficient: the same of the lens' first coefficient after fx fy cx cy.
    """

    name: str
    degrees: float = 0.0
    distance: float = 0.0
    focal: float = 0.0
    first_coefficient: float = 0.0

    @property
    def of_lens(self) -> bool:
        """Whether the lens is disturbed."""
        return bool(self.focal or self.first_coefficient)


DISTURBANCES = (
    Disturbance("small", degrees=0.5, distance=0.02),
    Disturbance("large", degrees=2.0, distance=0.08),
    Disturbance("lens", focal=0.02, first_coefficient=0.2),
)


def disturb_pose(
    rng: np.random.Generator, camera_from_world: np.ndarray, degrees: float, distance: float
) -> np.ndarray:
    """Turns a pose by exactly `degrees` and moves it by exactly `distance`, at random."""
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    turn *= np.radians(degrees) / np.linalg.norm(turn)
    shift *= distance / np.linalg.norm(shift)
    out = np.eye(4)
    out[:3, :3] = exp_pose(np.concatenate([np.zeros(3), turn]))[:3, :3] @ camera_from_world[:3, :3]
    center = shift - camera_from_world[:3, :3].T @ camera_from_world[:3, 3]
    out[:3, 3] = -out[:3, :3] @ center
    return out


def jitter_points(scene: Scene, sigma: float, seed: int) -> Scene:
    """Moves the points by normal noise: a dataset's may be exact, which poses would use."""
    noise = np.random.default_rng([seed, 0]).normal(0.0, sigma, scene.points.shape)
    return scene.replace(points=scene.points + noise)


def disturb_scene(scene: Scene, by: Disturbance, seed: int) -> Scene:
    """Disturbs all poses, those of the test views too, and the lenses."""
    rng = np.random.default_rng([seed, 1])
    poses = [
        disturb_pose(rng, view.camera_from_world, by.degrees, by.distance)
        if by.degrees or by.distance
        else view.camera_from_world
        for view in scene.views
    ]
    out = scene.with_poses(range(len(scene.views)), np.array(poses))
    if by.of_lens:
        out = out.with_lenses([_disturb_lens(camera, by) for camera in scene.file_cameras])
    return out


def measure_lens_errors(scene: Scene, truth: Scene) -> tuple[float, float]:
    """Returns relative errors of the focal length and the first coefficient (NaN where it is 0)."""
    found, true = scene.file_cameras[0].params, truth.file_cameras[0].params
    first = abs(found[4] / true[4] - 1.0) if len(true) > 4 and true[4] else float("nan")
    return float(np.mean(np.abs(found[:2] / true[:2] - 1.0))), float(first)


def _disturb_lens(camera: Camera, by: Disturbance) -> Camera:
    params = np.array(camera.params)
    if len(params) < 4 or (by.first_coefficient and len(params) < 5):
        raise InputError(f"the lens {camera.model} has no focal length or coefficient to disturb")
    params[:2] *= 1.0 + by.focal
    if by.first_coefficient:
        params[4] *= 1.0 + by.first_coefficient
    return camera.with_params(params)


def disturb_rig(rig: Rig, degrees: float = 0.5, share: float = 0.01, seed: int = 1) -> Rig:
    """Turns and moves each camera but the first, across its distance from the first.

    The distance itself stays: it is the scale, which no image could show.

    Args:
        rig: the true one.
        degrees: of the turn.
        share: of the distance, by which each is moved.
        seed: of the directions.
    """
    rng = np.random.default_rng(seed)
    poses = [rig.camera_from_reference[0]]
    first = invert_pose(poses[0])[:3, 3]
    for pose in rig.camera_from_reference[1:]:
        axis, side = rng.standard_normal((2, 3))
        turn = cv2.Rodrigues(np.radians(degrees) * axis / np.linalg.norm(axis))[0]
        apart = invert_pose(pose)[:3, 3] - first
        across = np.cross(apart, side)
        length = max(float(np.linalg.norm(across)), 1e-300)
        across *= share * np.linalg.norm(apart) / length
        moved = (apart + across) / np.hypot(1.0, share)
        changed = np.eye(4)
        changed[:3, :3] = turn @ pose[:3, :3]
        changed[:3, 3] = -changed[:3, :3] @ (first + moved)
        poses.append(changed)
    return dataclasses.replace(rig, camera_from_reference=np.array(poses))
