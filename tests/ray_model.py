"""A second renderer, written from the equations alone: numpy, double, one formula a line.

It shares nothing with the C++: rotations by Rodrigues' form, responses by minimising the quadratic
form of the inverse covariance along each ray, harmonics from Legendre polynomials.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.polynomial import legendre, polynomial

import gsut


@dataclasses.dataclass
class Traced:
    """Per pixel (P) and Gaussian (N) in the given order of Gaussians; pixels with a ray only."""

    distance2: np.ndarray  # (P, N) squared Mahalanobis distance of the ray
    along: np.ndarray  # (P, N) distance along the unit ray to the nearest point
    alpha: np.ndarray  # (P, N) min(alpha_max, opacity x response); 0 behind the origin
    keys: np.ndarray  # (N,) what orders them
    colors: np.ndarray  # (N, 3)
    valid: np.ndarray  # (H, W) pixels that have a ray


def rotations(quats: np.ndarray) -> np.ndarray:
    """(N, 3, 3) of (N, 4) quaternions w x y z of any norm."""
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    w, v = unit[:, 0], unit[:, 1:]
    cross = np.zeros((len(quats), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    cross -= cross.transpose(0, 2, 1).copy()
    square = (w**2 - np.sum(v**2, axis=1))[:, None, None] * np.eye(3)
    return square + 2 * v[:, :, None] * v[:, None, :] + 2 * w[:, None, None] * cross


def covariances(g: gsut.Gaussians) -> np.ndarray:
    """(N, 3, 3) R diag(scale^2) R^T."""
    axes = rotations(g.quats)
    return axes @ (np.exp(2 * g.log_scales)[:, :, None] * axes.transpose(0, 2, 1))


def harmonics(degree: int, directions: np.ndarray) -> np.ndarray:
    """(N, (degree + 1)^2) real harmonics with the Condon-Shortley phase, of unit directions."""
    x, y, z = directions.T
    columns = []
    for order in range(degree + 1):
        for m in range(-order, order + 1):
            a = abs(m)
            norm = math.sqrt(
                (2 * order + 1)
                / (4 * math.pi)
                * math.factorial(order - a)
                / math.factorial(order + a)
                * (2 if m else 1)
            )
            series = polynomial.polyder(legendre.leg2poly([0] * order + [1]), a)
            turning = (x + 1j * y) ** a
            around = turning.imag if m < 0 else turning.real
            columns.append((-1) ** a * norm * around * polynomial.polyval(z, series))
    return np.stack(columns, axis=1)


def trace(
    g: gsut.Gaussians,
    camera: gsut.Camera,
    camera_from_world: np.ndarray,
    rule: gsut.BlendRule,
    sh_degree: int = 3,
    pixels: np.ndarray | None = None,
) -> Traced:
    """Every Gaussian at every ray, or at the rays of `pixels` (P, 2): row, column."""
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    rays, valid = camera.rays()
    chosen = rays[valid] if pixels is None else rays[pixels[:, 0], pixels[:, 1]]
    directions = chosen @ rotation  # into world axes
    origin = -rotation.T @ translation
    precision = np.linalg.inv(covariances(g))
    toward = g.means - origin
    through = np.einsum("nij,pj->pni", precision, directions)
    along = np.einsum("pni,ni->pn", through, toward) / np.einsum("pni,pi->pn", through, directions)
    miss = along[:, :, None] * directions[:, None, :] - toward[None]
    distance2 = np.einsum("pni,nij,pnj->pn", miss, precision, miss)
    response = np.where(along > 0, np.exp(-0.5 * distance2), 0.0)
    response[response <= rule.response_min] = 0.0
    opacity = 1 / (1 + np.exp(-g.opacity_logits))
    alpha = np.minimum(opacity * response, rule.alpha_max)
    distance = np.linalg.norm(toward, axis=1)
    z = toward @ rotation[2]
    alpha[:, (z < rule.near_z) | (z > rule.far_z)] = 0.0
    degree = min(sh_degree, g.sh_degree)
    basis = harmonics(degree, toward / distance[:, None])
    color = 0.5 + np.einsum("nk,nkc->nc", basis, g.sh[:, : (degree + 1) ** 2])
    return Traced(
        distance2, along, alpha, z if rule.order_by_z else distance, np.maximum(color, 0), valid
    )


def render(
    g: gsut.Gaussians,
    camera: gsut.Camera,
    camera_from_world: np.ndarray,
    rule: gsut.BlendRule,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sh_degree: int = 3,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """image (H, W, 3), alpha (H, W) and depth (H, W), as `gsut.render` with dtype float64."""
    traced = trace(g, camera, camera_from_world, rule, sh_degree)
    left = np.ones(len(traced.alpha))
    going = np.ones(len(left), bool)
    color = np.zeros((len(left), 3))
    depth = np.zeros(len(left))
    for i in np.argsort(traced.keys.astype(np.float32), kind="stable"):
        alpha = traced.alpha[:, i]
        hit = going & (alpha >= rule.alpha_min)
        after = left * (1 - alpha)
        if rule.stop_before:
            going &= ~(hit & (after <= rule.transmittance_min))
            hit &= going
        weight = np.where(hit, alpha * left, 0.0)
        color += weight[:, None] * traced.colors[i]
        depth += weight * traced.along[:, i]
        left = np.where(hit, after, left)
        if not rule.stop_before:
            going &= left >= rule.transmittance_min
    color += left[:, None] * np.asarray(background)
    image = np.zeros((camera.height, camera.width, 3))
    alpha_image, depth_image = np.zeros(image.shape[:2]), np.zeros(image.shape[:2])
    image[traced.valid], alpha_image[traced.valid] = color, 1 - left
    depth_image[traced.valid] = depth
    return image, alpha_image, depth_image
