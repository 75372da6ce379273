"""The surface behind each pixel of a render: kinds of depth, normals, their gradients."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.gaussians import Gaussians, StoredGaussians
from gsut.render.renderer import Render


@dataclasses.dataclass(frozen=True)
class Surface:
    """The surface behind each pixel, all in world units along the pixel's ray from its origin.

    Attributes:
        expected: (H, W) weighted mean of the Gaussians' distances; blurs where a pixel sees a near
            and a far surface. NaN where nothing is.
        median: (H, W) distance of the Gaussian at which half of the light is gone (2DGS, RaDe-GS);
            NaN where that never happens.
        strongest: (H, W) distance of the Gaussian with the largest blend weight; NaN: none.
        normals: (H, W, 3) world axes, towards the camera: sum of weight x unit normal, each taken
            analytically where the ray meets the Gaussian. Shorter than alpha where they disagree.
        spread: (H, W) standard deviation of the blended distances; NaN where nothing is.
    """

    expected: np.ndarray
    median: np.ndarray
    strongest: np.ndarray
    normals: np.ndarray
    spread: np.ndarray


@name_wrong_kinds
def render_surface(result: Render) -> Surface:
    """Computes depth of several kinds, normals and the spread of a render.

    A Gaussian's distance is that of its strongest response along the ray, which is exact for any
    lens and shutter. Evaluated in double along the rays of the render.

    Args:
        result: what `render` returned in float32; its Gaussians must not have changed since.

    Returns:
        The maps, float32.

    Raises:
        InputError: a render of the double reference.
    """
    median, strongest, normals, spread = _get_renderer(result).surface()
    expected = _divide(result.depth, result.alpha)
    return Surface(expected.astype(np.float32), median, strongest, normals, spread)


DEPTHS = ("mean", "median", "smooth", "strongest", "sum")
ALONG = ("ray", "z")
# Share of a pixel's inverse distance within which its neighbours are on the same surface.
_ONE_SURFACE = 0.05


@name_wrong_kinds
def measure_depth(result: Render, kind: str = "median", along: str = "ray") -> np.ndarray:
    """Measures the depth of each pixel of a render, by its name.

    Args:
        result: what `render` returned in float32; its Gaussians must not have changed since.
        kind: "mean": weighted mean of the Gaussians' distances; "median": where half of the light
            is gone; "smooth": its mean, as inverse distance, over those of 5 x 5 pixels that lie
            on one surface; "strongest": of the Gaussian with the largest weight; "sum": weight
            times distance, summed and not divided, as `Render.depth`.
        along: "ray": distance from the lens; "z": along the camera's axis.

    Returns:
        (H, W) float32, world units; NaN where there is none, but 0 of a sum. Mean and sum have
        gradients by `render_backward`: of the mean m, dL_dm / alpha to depth and -dL_dm m / alpha
        to alpha; of a z the same times the z of `camera.rays()`.

    Raises:
        InputError: an unknown kind or direction; z through a lens that sees 90 degrees from its
            axis; of median, smooth and strongest, a render that `render_surface` refuses.
    """
    if kind not in DEPTHS:
        raise InputError(f'depth "{kind}" is unknown; known: {", ".join(DEPTHS)}')
    if along not in ALONG:
        raise InputError(f'depth along "{along}" is unknown; known: {", ".join(ALONG)}')
    if kind in ("mean", "sum"):
        distance = result.depth
    else:
        median, strongest, _, _ = _get_renderer(result).surface()
        distance = strongest if kind == "strongest" else median
    if kind == "smooth":
        distance = _smooth(distance)
    if kind == "mean":
        distance = _divide(distance, result.alpha)
    if along == "z":
        share = result.alpha if kind == "sum" else 1.0
        distance = z_from_distance(distance, result.camera, share)
        if kind == "sum":
            distance = np.nan_to_num(distance)
    return distance.astype(np.float32)


def _smooth(distance: np.ndarray) -> np.ndarray:
    """Averages the inverse distances of 5 x 5 pixels that differ little from their median."""
    import cv2  # here, because gsut --help needs none

    known = np.isfinite(distance)
    inverse = np.where(known, 1 / np.where(known, distance, 1), 0).astype(np.float32)
    middle = cv2.medianBlur(inverse, 5)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(inverse, 2), (5, 5))
    total, count = np.zeros((2, *inverse.shape), np.float32)
    for row, column in np.ndindex(5, 5):
        same = np.abs(around[..., row, column] - middle) < _ONE_SURFACE * middle
        total += np.where(same, around[..., row, column], 0)
        count += same
    return np.where(known, np.where(count > 0, count / np.maximum(total, 1e-30), distance), np.nan)


def _divide(depth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Divides sums of weight times distance by those of the weights; NaN where these are 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(alpha > 0, depth / alpha, np.float32(np.nan))


@name_wrong_kinds
def render_surface_backward(result: Render, dnormals: np.ndarray) -> Gaussians:
    """Computes gradients of L = sum(dnormals * normals), exact but for the blend rule's cut-offs.

    The expected distance has its gradient through `render_backward`; median and strongest distance
    jump from Gaussian to Gaussian and have none worth the name.

    Args:
        result: what `render` returned in float32; its Gaussians must not have changed since.
        dnormals: (H, W, 3) dL_dnormals.

    Returns:
        Shaped like the Gaussians; 0 to the harmonics.

    Raises:
        InputError: shapes differ from the image's.
    """
    gradients = result.gaussians.make_zeros()
    _get_renderer(result).surface_backward(np.ascontiguousarray(dnormals, np.float32), gradients)
    return gradients


@name_wrong_kinds
def z_from_distance(
    distance: np.ndarray, camera: _core.Camera, share: np.ndarray | float = 1.0
) -> np.ndarray:
    """Converts distances along each pixel's ray to distances along the camera's axis (z).

    Args:
        distance: (H, W) along the rays; NaN stays NaN.
        camera: the lens.
        share: (H, W) sums of the weights by which distances were added up and not divided.

    Returns:
        (H, W) z, NaN where the pixel has no ray.

    Raises:
        InputError: the lens sees 90 degrees from its axis or more, where z says nothing.
    """
    rays, valid = camera.rays()
    widest = float(rays[..., 2][valid].min(initial=1.0))
    if widest <= 0.0 and not camera.is_parallel:
        raise InputError(
            f"the lens sees {math.degrees(math.acos(widest)):.0f} degrees from its axis, where z "
            "is not positive; use the distance along the ray (--depth ray)"
        )
    return distance * np.where(valid, rays[..., 2], np.nan) + share * camera.origins()[..., 2]


def _get_renderer(result: Render):
    if result.renderer is None and isinstance(result.gaussians, StoredGaussians):
        raise InputError(
            "depths of the surface need all that the lens sees in memory at once: give more "
            "--memory, or compact the scene (gsut compact)"
        )
    if result.renderer is None:
        raise InputError('depth kinds and normals are of float32 renders; use dtype="float32"')
    return result.renderer
