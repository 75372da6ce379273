"""Computes what a projected Gaussian truly is: moments, and alpha at every pixel."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.polynomial import hermite_e

from gsut import _core
from gsut.gaussians import Gaussians

# Nodes an axis of the product rule, doubled until the centre moves by less than this (pixels).
_ORDERS = (8, 16, 32)
_SETTLED_PX = 1e-5
_FULL = np.array([[0, 1], [1, 2]])  # where a symmetric (2, 2) has the entries xx, xy, yy
# Share of the Gaussian that may have no pixel; with more the moments are not defined.
_LOST = 1e-6


def _find_axes(gaussians: Gaussians) -> np.ndarray:
    """Returns (N, 3, 3), columns the axes of each Gaussian times its scales."""
    quats = gaussians.quats / np.linalg.norm(gaussians.quats, axis=1, keepdims=True)
    w, x, y, z = quats.T
    rotation = np.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ], axis=1).reshape(-1, 3, 3)  # fmt: skip
    return rotation * np.exp(gaussians.log_scales)[:, None, :]


def compute_moments(gaussians: Gaussians, camera: _core.Camera) -> tuple[np.ndarray, np.ndarray]:
    """Integrates mean (N, 2) and covariance (N, 2, 2) of pixels, camera at the origin.

    Gauss-Hermite product rules of 8^3, 16^3 and 32^3 nodes in double: NaN where the last two still
    differ by more than 1e-5 px (or 1e-4 of the standard deviation, if that is more), or more than
    1e-6 of the Gaussian has no pixel.
    """
    centers = np.full((len(gaussians), 2), np.nan)
    covariances = np.full((len(gaussians), 2, 2), np.nan)
    axes = _find_axes(gaussians)
    for i in range(len(gaussians)):
        before = None
        for order in _ORDERS:
            moments = _integrate(gaussians.means[i], axes[i], camera, order)
            if moments is None:
                break
            if before is not None:
                moved = np.linalg.norm(moments[0] - before[0])
                if moved < max(_SETTLED_PX, 1e-4 * np.sqrt(np.trace(moments[1]))):
                    centers[i], covariances[i] = moments
                    break
            before = moments
    return centers, covariances


def _integrate(
    mean: np.ndarray, axes: np.ndarray, camera: _core.Camera, order: int
) -> tuple[np.ndarray, np.ndarray] | None:
    node, weight = hermite_e.hermegauss(order)
    weight = weight / weight.sum()
    grid = np.stack(np.meshgrid(node, node, node, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = (weight[:, None, None] * weight[:, None] * weight).ravel()
    pixels, valid = camera.project(mean + grid @ axes.T)
    if weights[~valid].sum() > _LOST:
        return None
    pixels, weights = pixels[valid], weights[valid] / weights[valid].sum()
    middle, _ = camera.project(mean[None])
    off = _unwrap(pixels - middle, camera)
    shift = weights @ off
    off = off - shift
    return middle[0] + shift, np.einsum("n,ni,nj->ij", weights, off, off)


def _unwrap(difference: np.ndarray, camera: _core.Camera) -> np.ndarray:
    """Takes differences of pixels (N, 2) the short way round a panorama."""
    period = find_periods(camera)
    return difference - period * np.round(difference / period)


def find_periods(camera: _core.Camera) -> np.ndarray:
    """Returns (2,) pixels after which the image repeats along u and v; 1e30 where it does not."""
    period = np.array(camera.period)
    return np.where(period > 0, period, 1e30)


@dataclasses.dataclass(frozen=True)
class SampledMoments:
    """Mean and covariance of projected samples, each with its standard error.

    Attributes:
        center, center_error: (2,) pixels.
        covariance, covariance_error: (2, 2) pixels^2.
        lost: share of the samples without a pixel; the moments are those of the others.
    """

    center: np.ndarray
    center_error: np.ndarray
    covariance: np.ndarray
    covariance_error: np.ndarray
    lost: float


def sample_moments(
    gaussians: Gaussians, camera: _core.Camera, samples: int, rng: np.random.Generator
) -> list[SampledMoments]:
    """Estimates moments by random points of each Gaussian, camera at the origin."""
    axes = _find_axes(gaussians)
    found = []
    for mean, own_axes in zip(gaussians.means, axes, strict=True):
        pixels, valid = camera.project(mean + rng.standard_normal((samples, 3)) @ own_axes.T)
        middle, _ = camera.project(mean[None])
        off = _unwrap(pixels[valid] - middle, camera)
        root = np.sqrt(len(off))
        shift = off.mean(axis=0)
        x, y = (off - shift).T.copy()  # contiguous: several times faster than rows of two
        products = (x * x, x * y, y * y)
        covariance, error = np.array([(p.mean(), p.std() / root) for p in products]).T
        center_error = np.sqrt(covariance[[0, 2]]) / root
        lost = 1 - len(off) / samples
        found.append(
            SampledMoments(middle[0] + shift, center_error, covariance[_FULL], error[_FULL], lost)
        )
    return found


def compute_alphas(gaussians: Gaussians, camera: _core.Camera, alpha_min: float) -> np.ndarray:
    """Computes (N, H, W) opacity times response, 0 below alpha_min; camera at the origin."""
    rays, valid = camera.rays()
    directions = np.where(valid[..., None], rays, 0.0).reshape(-1, 3)
    origins = np.where(valid[..., None], camera.origins(), 0.0).reshape(-1, 3)
    alphas = np.zeros((len(gaussians), len(directions)))
    axes = _find_axes(gaussians)
    opacity = 1 / (1 + np.exp(-gaussians.opacity_logits))
    for i in range(len(gaussians)):
        inverse = np.linalg.inv(axes[i])
        # Of a central lens one row, for all rays.
        from_origin = gaussians.means[i] - (origins[:1] if camera.is_central else origins)
        center, through = from_origin @ inverse.T, directions @ inverse.T
        square = np.sum(through**2, axis=1)
        miss = np.sum(np.cross(center, through) ** 2, axis=1) / np.where(square > 0, square, 1)
        alpha = opacity[i] * np.exp(-0.5 * miss)
        ahead = np.sum(through * center, axis=1) > 0
        alphas[i] = np.where(ahead & (alpha >= alpha_min), alpha, 0.0)
    return alphas.reshape(len(gaussians), *valid.shape)
