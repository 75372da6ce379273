"""Where Gaussians fall in an image: centre, covariance and bound, by two methods."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.gaussians import Gaussians, LinearGaussians
from gsut.render.motion import convert_about_camera, place_about, read_motion

METHODS = ("unscented", "ewa")
# alpha, beta, kappa of the unscented transform (gsplat: alpha 0.1; 3dgrut: alpha 1).
DEFAULT_UNSCENTED = (1.0, 2.0, 0.0)


@dataclasses.dataclass
class Projection:
    """Footprints of N Gaussians in an image.

    Attributes:
        centers: (N, 2) pixels; NaN where a point of the method has no pixel.
        covariances: (N, 2, 2) pixels squared, no dilation; NaN likewise.
        extents: (N, 2) half width and height in pixels that hold alpha >= alpha_min.
        depths: (N,) distances from the camera centre.
        valid: (N,) bool, every point of the method has a pixel.
        converged: (N,) bool, with a rolling shutter: every sigma point settled on the line that
            sees it; where it is False the footprint is NaN. Without one always True.
    """

    centers: np.ndarray
    covariances: np.ndarray
    extents: np.ndarray
    depths: np.ndarray
    valid: np.ndarray
    converged: np.ndarray

    def __repr__(self) -> str:
        valid = np.count_nonzero(self.valid)
        return f"Projection({len(self.centers)} Gaussians, {valid} valid, {self.centers.dtype})"


@name_wrong_kinds
def project(
    gaussians: Gaussians | LinearGaussians,
    camera: _core.Camera,
    camera_from_world: Any,
    *,
    shutter: _core.Shutter | str | None = None,
    method: str = "unscented",
    unscented: Sequence[float] = DEFAULT_UNSCENTED,
    alpha_min: float = 1.0 / 255.0,
    dtype: str = "float32",
) -> Projection:
    """Projects Gaussians through the lens.

    Args:
        gaussians: N Gaussians.
        camera: the lens and image size.
        camera_from_world: (4, 4) rigid transform, or an object with such a `matrix`; with a rolling
            shutter the pair of them at the start and at the end of the exposure.
        shutter: of a pair of poses, for the method "unscented" only. Each sigma point is then
            placed by the pose of the line that sees it, found by iteration in double; depths are
            those at the middle of the exposure.
        method: "unscented": 7 sigma points, as the renderer does. "ewa": the lens' Jacobian at the
            mean (Zwicker et al., 2001), a baseline to compare with, computed in double.
        unscented: alpha, beta, kappa of the unscented transform.
        alpha_min: opacity times response below which a Gaussian is not drawn; sets the extents.
        dtype: "float32" (vectorised) or "float64" (the scalar reference).

    Returns:
        The footprints. Centres in float32 are within 1e-4 px of the reference for alpha >= 0.1.

    Raises:
        InputError: unknown method or dtype, shapes, weights, pose or shutter.
    """
    if method not in METHODS:
        raise InputError(f'projection method "{method}" is unknown; known: {", ".join(METHODS)}')
    if dtype not in ("float32", "float64"):
        raise InputError(f'dtype "{dtype}" is unknown; known: float32, float64')
    alpha, beta, kappa = (float(x) for x in unscented)
    weights = alpha, beta, kappa
    motion = read_motion(camera_from_world, shutter)
    gaussians = convert_about_camera(gaussians, motion, dtype)
    place = place_about(motion, gaussians.origin)
    if isinstance(place, _core.CameraMotion):
        if method != "unscented":
            raise InputError(
                f'method "{method}" knows no rolling shutter; give method="unscented", or one pose'
            )
        return _project_moving(gaussians, camera, place, weights, float(alpha_min), dtype)
    if dtype == "float32" and method == "unscented":
        g = gaussians.to_dtype(np.float32)
        out = _core.project(g, camera, place, *weights, float(alpha_min))
        valid = np.isfinite(out["centers"][:, 0])
        return Projection(
            out["centers"], out["covariances"], out["extents"], out["depths"], valid,
            np.ones(len(g), bool),
        )  # fmt: skip
    g = gaussians.to_dtype(np.float64)
    if method == "unscented":
        found = _core.project_reference(g, camera, place, *weights)
    else:
        found = _core.project_ewa_reference(g, camera, place)
    return _pack_double(g, found, place, np.ones(len(g), bool), float(alpha_min), dtype)


def _pack_double(
    g: Any, found: Any, pose: np.ndarray, converged: np.ndarray, alpha_min: float, dtype: str
) -> Projection:
    """Makes a Projection of centres, covariances and validity found in double."""
    cov = found["covariances"]
    extents = _compute_extents(g, cov, alpha_min)
    with np.errstate(invalid="ignore", over="ignore"):
        depths = np.linalg.norm(g.means @ pose[:3, :3].T + pose[:3, 3], axis=1)
        return Projection(
            found["centers"].astype(dtype), cov.astype(dtype), extents.astype(dtype),
            depths.astype(dtype), found["valid"].astype(bool), converged,
        )  # fmt: skip


def _compute_extents(g: Any, cov: np.ndarray, alpha_min: float) -> np.ndarray:
    """Computes half widths and heights (N, 2) of what holds alpha >= alpha_min, in float64."""
    variances = np.stack([cov[:, 0, 0], cov[:, 1, 1]], axis=1)
    with np.errstate(over="ignore"):
        is_linear = isinstance(g, LinearGaussians)
        opacity = g.opacities if is_linear else 1.0 / (1.0 + np.exp(-g.opacity_logits))
    cutoff = 2.0 * np.log(np.maximum(opacity / alpha_min, 1.0))
    return np.sqrt(cutoff[:, None] * variances)


def _project_moving(
    gaussians: Gaussians | LinearGaussians,
    camera: _core.Camera,
    motion: _core.CameraMotion,
    weights: tuple[float, ...],
    alpha_min: float,
    dtype: str,
) -> Projection:
    """Projects by the unscented transform through a moving camera, in double."""
    g = gaussians.to_dtype(np.float64)
    found = _core.project_moving(g, camera, motion, *weights)
    converged = found["converged"].astype(bool)
    return _pack_double(g, found, motion.at(0.5), converged, alpha_min, dtype)
