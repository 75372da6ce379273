"""Known disturbances of a dataset's poses, lens and points, and what is left of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import InputError, exp_pose
from gsut.data import Scene
from gsut.lens import Camera


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """How far a dataset is moved from the truth.

    Args:
        name: heading of its rows.
        degrees: each pose is turned by so much, about an axis of its own.
        distance: each camera's centre is moved by so much, world units.
        focal: all focal lengths are multiplied by 1 + focal.
        first_coefficient: so is the lens' first coefficient after fx fy cx cy.
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


def disturbed_pose(
    rng: np.random.Generator, camera_from_world: np.ndarray, degrees: float, distance: float
) -> np.ndarray:
    """A pose turned by exactly `degrees` and moved by exactly `distance`, in random directions."""
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    turn *= np.radians(degrees) / np.linalg.norm(turn)
    shift *= distance / np.linalg.norm(shift)
    out = np.eye(4)
    out[:3, :3] = exp_pose(np.concatenate([np.zeros(3), turn]))[:3, :3] @ camera_from_world[:3, :3]
    center = shift - camera_from_world[:3, :3].T @ camera_from_world[:3, 3]
    out[:3, 3] = -out[:3, :3] @ center
    return out


def jittered_points(scene: Scene, sigma: float, seed: int) -> Scene:
    """The scene with points moved by normal noise: a dataset's may be exact, which poses use."""
    noise = np.random.default_rng([seed, 0]).normal(0.0, sigma, scene.points.shape)
    return scene.replace(points=scene.points + noise)


def disturbed(scene: Scene, by: Disturbance, seed: int) -> Scene:
    """The scene with all poses, those of the test views too, and the lenses disturbed."""
    rng = np.random.default_rng([seed, 1])
    poses = [
        disturbed_pose(rng, view.camera_from_world, by.degrees, by.distance)
        if by.degrees or by.distance
        else view.camera_from_world
        for view in scene.views
    ]
    out = scene.with_poses(range(len(scene.views)), np.array(poses))
    if by.of_lens:
        out = out.with_lenses([_disturbed_lens(camera, by) for camera in scene.file_cameras])
    return out


def lens_errors(scene: Scene, truth: Scene) -> tuple[float, float]:
    """Relative errors of the focal length and of the first coefficient (NaN where it is 0)."""
    found, true = scene.file_cameras[0].params, truth.file_cameras[0].params
    first = abs(found[4] / true[4] - 1.0) if len(true) > 4 and true[4] else float("nan")
    return float(np.mean(np.abs(found[:2] / true[:2] - 1.0))), float(first)


def _disturbed_lens(camera: Camera, by: Disturbance) -> Camera:
    params = np.array(camera.params)
    if len(params) < 4 or (by.first_coefficient and len(params) < 5):
        raise InputError(f"the lens {camera.model} has no focal length or coefficient to disturb")
    params[:2] *= 1.0 + by.focal
    if by.first_coefficient:
        params[4] *= 1.0 + by.first_coefficient
    return camera.with_params(params)
