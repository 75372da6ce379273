"""The 3D low-pass filter, which keeps Gaussians from being thinner than a camera's pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians.arrays import Gaussians

# Share of the image's size by which a point may lie outside and still count as seen.
_BORDER = 0.1


def compute_pixel_density(points: np.ndarray, camera: _core.Camera, pose: np.ndarray) -> np.ndarray:
    """Computes how many pixels an image spends on a unit of area across the ray.

    Args:
        points: (N, 3) float64, world coordinates.
        camera: the lens.
        pose: (4, 4) camera_from_world.

    Returns:
        (N,) pixels per unit of area; 0 at points outside the image and a tenth of it around.
    """
    density = np.zeros(len(points))
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    size = np.array([camera.width, camera.height])
    places, valid = camera.project(in_camera)
    with np.errstate(invalid="ignore"):
        seen = valid & np.all((places > -_BORDER * size) & (places < (1 + _BORDER) * size), 1)
    if seen.any():
        slope, _ = camera.project_jacobian(in_camera[seen])
        # s1 s2 of a 2 x 3 matrix: the length of the cross product of its rows.
        here = np.linalg.norm(np.cross(slope[:, 0], slope[:, 1]), axis=1)
        density[seen] = np.nan_to_num(here, posinf=0.0)
    return density


def find_filter_radii(
    means: np.ndarray, cameras: Sequence[_core.Camera], camera_from_world: Any, pixels: float
) -> np.ndarray:
    """Finds the standard deviation of each Gaussian's low-pass filter.

    The size of a pixel at a point is taken through the real lens: 1 / sqrt(s1 s2), with s1 and s2
    the singular values of the derivative of the pixel by the point. The smallest over all cameras
    whose image, and a tenth of it around, contains the point decides.

    Args:
        means: (N, 3) world coordinates.
        cameras: C cameras.
        camera_from_world: (C, 4, 4), one a camera.
        pixels: standard deviation of the filter in pixels; that of a pixel itself is about 0.3.

    Returns:
        (N,) float64 world units. Points that no camera sees get the largest of the others.

    Raises:
        InputError: pixels is not positive, or the numbers of poses and cameras differ.
    """
    if not (np.isfinite(pixels) and pixels > 0):
        raise InputError(f"low_pass must be a positive number of pixels, found {pixels}")
    poses = np.asarray(camera_from_world, np.float64)
    if poses.shape != (len(cameras), 4, 4):
        raise InputError(
            f"camera_from_world must have shape ({len(cameras)}, 4, 4), one pose a camera, found "
            f"{poses.shape}"
        )
    points = np.asarray(means, np.float64)
    density = np.zeros(len(points))  # pixels a unit of length, squared
    for camera, pose in zip(cameras, poses, strict=True):
        density = np.maximum(density, compute_pixel_density(points, camera, pose))
    radii = np.full(len(points), np.nan)
    known = density > 0
    radii[known] = pixels / np.sqrt(density[known])
    radii[~known] = radii[known].max() if known.any() else 0.0
    return radii


def apply_low_pass(gaussians: Gaussians, radii: np.ndarray) -> Gaussians:
    """Convolves Gaussians with isotropic ones of standard deviation `radii`.

    Scales become sqrt(scale^2 + radius^2). Opacities are multiplied by the ratio of the projected
    areas before and after (root mean square over all directions), so that as much light passes.
    Means, quaternions and harmonics are those of the argument, not copies.

    Args:
        gaussians: N Gaussians.
        radii: (N,) world units; 0 does not change a Gaussian.

    Returns:
        N Gaussians of the same dtype.

    Raises:
        InputError: radii that are negative or not finite, or not one a Gaussian.
    """
    out = dataclasses.replace(
        gaussians,
        log_scales=np.empty_like(gaussians.log_scales),
        opacity_logits=np.empty_like(gaussians.opacity_logits),
    )
    _core.low_pass(gaussians, _as_radii(gaussians, radii), out)
    return out


def apply_low_pass_backward(gaussians: Gaussians, radii: np.ndarray, gradients: Gaussians) -> None:
    """Carries gradients of `apply_low_pass(gaussians, radii)` back to `gaussians`, in place.

    The radii count as constants.

    Args:
        gaussians: N Gaussians, before the filter.
        radii: (N,) world units.
        gradients: shaped like the Gaussians: by the filtered ones on entry, by these on return.

    Raises:
        InputError: radii that are negative or not finite, or not one a Gaussian.
    """
    _core.low_pass_backward(gaussians, _as_radii(gaussians, radii), gradients)


class LowPassFilter:
    """The low-pass filter of Gaussians in training.

    Radii are found on first use and kept until `renew` or until the number of Gaussians changes.

    Args:
        pixels: see `find_filter_radii`; 0: no filter.
        views: returns the cameras and poses (C, 4, 4) that see the Gaussians now.
    """

    def __init__(
        self, pixels: float, views: Callable[[], tuple[Sequence[_core.Camera], np.ndarray]]
    ) -> None:
        self._pixels, self._views = pixels, views
        self._radii: np.ndarray | None = None

    def apply(self, gaussians: Gaussians) -> Gaussians:
        """Filters the Gaussians for rendering; returns them unchanged without a filter."""
        if not self._pixels:
            return gaussians
        if self._radii is None or len(self._radii) != len(gaussians):
            radii = find_filter_radii(gaussians.means, *self._views(), self._pixels)
            self._radii = radii.astype(np.float32)
        return apply_low_pass(gaussians, self._radii)

    def backpropagate(self, gaussians: Gaussians, gradients: Gaussians) -> None:
        """Carries gradients of `apply(gaussians)` back to `gaussians`, in place."""
        if self._radii is not None:
            apply_low_pass_backward(gaussians, self._radii, gradients)

    def renew(self) -> None:
        """Discards the radii, so that the next use finds them again."""
        self._radii = None

    def state_dict(self) -> dict[str, Any]:
        """Returns the radii, if there are any."""
        return {} if self._radii is None else {"radii": self._radii}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state of `state_dict`."""
        self._radii = state.get("radii")


def _as_radii(gaussians: Gaussians, radii: np.ndarray) -> np.ndarray:
    out = np.ascontiguousarray(radii, dtype=gaussians.dtype)
    if not np.all(out >= 0) or not np.isfinite(out).all():
        raise InputError("radii must be finite and not negative")
    return out
