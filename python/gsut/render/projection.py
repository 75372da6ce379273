"""Where Gaussians fall in an image: centre, covariance and bound, by methods of known error."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians, LinearGaussians
from gsut.render.motion import convert_about_camera, place_about, read_motion

# In the order of the core's enumeration.
METHODS = ("ewa", "unscented", "silhouette")
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
        boxes: (N, 4) low u, low v, high u, high v in pixels: according to the method, every pixel
            with alpha >= alpha_min has its centre inside. Low > high: there is none. On a panorama
            a box may reach across the seam and then means its copy one period further, too.
        bounded: (N,) bool, the method says which pixels see the Gaussian (or that none does).
        converged: (N,) bool, with a rolling shutter: every sigma point settled on the line that
            sees it; where it is False the footprint is NaN. Without one always True.
    """

    centers: np.ndarray
    covariances: np.ndarray
    extents: np.ndarray
    depths: np.ndarray
    valid: np.ndarray
    boxes: np.ndarray
    bounded: np.ndarray
    converged: np.ndarray

    def __repr__(self) -> str:
        valid = np.count_nonzero(self.valid)
        return f"Projection({len(self.centers)} Gaussians, {valid} valid, {self.centers.dtype})"


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
        method: "ewa": the lens' Jacobian at the mean. "unscented": 7 sigma points.
            "silhouette": the cone of rays that touch the ellipsoid where alpha falls to alpha_min,
            through the lens; its boxes are exact, even with the camera inside, across the domain's
            edge and across the seam.
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
    weights = tuple(float(x) for x in unscented)
    motion = read_motion(camera_from_world, shutter)
    gaussians = convert_about_camera(gaussians, motion, dtype)
    place = place_about(motion, gaussians.origin)
    if isinstance(place, _core.CameraMotion):
        if method != "unscented":
            raise InputError(
                f'method "{method}" knows no rolling shutter; give method="unscented", or one pose'
            )
        return _project_moving(gaussians, camera, place, weights, float(alpha_min), dtype)
    g = gaussians.to_dtype(np.dtype(dtype))
    found: dict[str, Any]
    footprinter = _core.Footprinter(METHODS.index(method), weights, float(alpha_min))
    if dtype == "float64":
        found = dict(footprinter.reference(g, camera, place))
    else:
        footprinter.find(g, camera, place)
        found = dict(footprinter.arrays())
    if method == "unscented":  # Gaussians that cannot be seen have centres and extents, too
        found.update(_project_unscented(g, camera, place, weights, float(alpha_min)))
    depths = found.get("depths")
    if depths is None:
        with np.errstate(invalid="ignore", over="ignore"):
            in_camera = g.means.astype(np.float64) @ place[:3, :3].T + place[:3, 3]
            depths = np.linalg.norm(in_camera, axis=1).astype(g.dtype)
    centers, boxes = found["centers"], found["boxes"]
    extents = found.get("extents")
    if extents is None:
        extents = 0.5 * (boxes[:, 2:] - boxes[:, :2])
        extents[found["status"] != _BOX] = np.nan
    return Projection(
        centers, found["covariances"], extents, depths, np.isfinite(centers[:, 0]), boxes,
        found["status"] != _UNKNOWN, np.ones(len(g), bool),
    )  # fmt: skip


# Of the core's FootprintStatus: the box is valid; the method cannot bound the Gaussian.
_BOX = 1
_UNKNOWN = 2


def _project_unscented(
    g: Gaussians | LinearGaussians,
    camera: _core.Camera,
    pose: Any,
    weights: tuple[float, ...],
    alpha_min: float,
) -> dict[str, np.ndarray]:
    """Returns centres, covariances and extents of the renderer's own unscented transform."""
    alpha, beta, kappa = weights
    if g.dtype == np.float64:
        exact = _core.project_reference(g, camera, pose, alpha, beta, kappa)
        cov = exact["covariances"]
        extents = _compute_extents(g, cov, alpha_min)
        return {"centers": exact["centers"], "covariances": cov, "extents": extents}
    out = _core.project(g, camera, pose, alpha, beta, kappa, alpha_min)
    return {
        "centers": out["centers"], "covariances": out["covariances"],
        "extents": out["extents"], "depths": out["depths"],
    }  # fmt: skip


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
    alpha, beta, kappa = weights
    found = _core.project_moving(g, camera, motion, alpha, beta, kappa)
    converged, valid = found["converged"].astype(bool), found["valid"].astype(bool)
    centers, cov, pose = found["centers"], found["covariances"], motion.at(0.5)
    extents = _compute_extents(g, cov, alpha_min)
    depths = np.linalg.norm(g.means @ pose[:3, :3].T + pose[:3, 3], axis=1)
    boxes = np.concatenate([centers - extents, centers + extents], axis=1)
    arrays = (array.astype(dtype) for array in (centers, cov, extents, depths, boxes))
    centers, cov, extents, depths, boxes = arrays
    return Projection(centers, cov, extents, depths, valid, boxes, valid & converged, converged)
