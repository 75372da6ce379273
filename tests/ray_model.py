"""A second renderer, written from the equations alone: numpy, double, one formula a line.

It shares nothing with the C++: rotations by Rodrigues' form, responses by minimising the quadratic
form of the inverse covariance along each ray, harmonics from Legendre polynomials.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
from numpy.polynomial import legendre, polynomial

import gsut


@dataclasses.dataclass
class Traced:
    """Per pixel (P) and Gaussian (N) in the given order of Gaussians; pixels with a ray only."""

    distance2: np.ndarray  # (P, N) squared Mahalanobis distance of the ray
    along: np.ndarray  # (P, N) distance along the unit ray to the nearest point
    width: np.ndarray  # (P, N) standard deviation along the unit ray
    line_alpha: np.ndarray  # (P, N) of a ray that is infinite in both directions, unclamped
    alpha: np.ndarray  # (P, N) at most alpha_max; 0 behind the origin
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
    width = 1 / np.sqrt(np.einsum("pni,pi->pn", through, directions))
    along = np.einsum("pni,ni->pn", through, toward) * width**2
    miss = along[:, :, None] * directions[:, None, :] - toward[None]
    distance2 = np.einsum("pni,nij,pnj->pn", miss, precision, miss)
    response = np.exp(-0.5 * distance2)
    opacity = 1 / (1 + np.exp(-g.opacity_logits))
    if g.response == "maximum":
        line_alpha = alpha = opacity * response
    else:
        thickness = -np.log(1 - opacity) * response
        if g.response == "density":
            thickness = thickness * width * np.mean(np.exp(-g.log_scales), axis=1)
        line_alpha = alpha = 1 - np.exp(-thickness)
        if g.response == "density":
            ahead = np.vectorize(lambda x: (1 + math.erf(x / math.sqrt(2))) / 2)(along / width)
            alpha = 1 - np.exp(-thickness * ahead)
    drawn = (along > 0) & (response > rule.response_min)
    alpha = np.where(drawn, np.minimum(alpha, rule.alpha_max), 0.0)
    distance = np.linalg.norm(toward, axis=1)
    z = toward @ rotation[2]
    alpha[:, (z < rule.near_z) | (z > rule.far_z)] = 0.0
    degree = min(sh_degree, g.sh_degree)
    basis = harmonics(degree, toward / distance[:, None])
    color = 0.5 + np.einsum("nk,nkc->nc", basis, g.sh[:, : (degree + 1) ** 2])
    return Traced(
        distance2, along, width, line_alpha, alpha, z if rule.order == "z" else distance,
        np.maximum(color, 0), valid,
    )  # fmt: skip


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
    order = np.argsort(traced.keys.astype(np.float32), kind="stable")
    turns = np.broadcast_to(order, traced.alpha.shape)
    if rule.order == "ray":  # an order of its own for each pixel
        turns = np.argsort(traced.along, axis=1, kind="stable")
    for turn in turns.T:
        i = (np.arange(len(turn)), turn)
        alpha = traced.alpha[i]
        hit = going & (alpha >= rule.alpha_min)
        after = left * (1 - alpha)
        if rule.stop_before:
            going &= ~(hit & (after <= rule.transmittance_min))
            hit &= going
        weight = np.where(hit, alpha * left, 0.0)
        color += weight[:, None] * traced.colors[turn]
        depth += weight * traced.along[i]
        left = np.where(hit, after, left)
        if not rule.stop_before:
            going &= left >= rule.transmittance_min
    color += left[:, None] * np.asarray(background)
    image = np.zeros((camera.height, camera.width, 3))
    alpha_image, depth_image = np.zeros(image.shape[:2]), np.zeros(image.shape[:2])
    image[traced.valid], alpha_image[traced.valid] = color, 1 - left
    depth_image[traced.valid] = depth
    return image, alpha_image, depth_image


def integrate(
    g: gsut.Gaussians,
    camera: gsut.Camera,
    camera_from_world: np.ndarray,
    rule: gsut.BlendRule,
    steps: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour (P, 3), alpha and depth (P,) of overlapping densities, without error functions.

    The densities are sampled at equal steps, the optical depth is their trapezoidal sum, and what a
    number of steps misses is extrapolated (Romberg) from 1, 2, 4 and 8 times `steps`.
    """
    traced = trace(g, camera, camera_from_world, rule)
    depth = -np.log(1 - np.minimum(traced.line_alpha, rule.alpha_max))
    far = np.max(traced.along + 9 * traced.width)
    levels = []
    for count in (steps, 2 * steps, 4 * steps, 8 * steps):
        t, step = np.linspace(0, far, count + 1, retstep=True)
        out = np.zeros((len(depth), 5))
        for pixel in range(len(depth)):
            near = t[:, None] - traced.along[pixel]
            width = traced.width[pixel]
            density = depth[pixel] / (width * math.sqrt(2 * math.pi))
            density = density * np.exp(-0.5 * (near / width) ** 2)
            whole = density.sum(axis=1)
            passed = np.concatenate([[0], np.cumsum(whole[1:] + whole[:-1]) * step / 2])
            light = np.exp(-passed)
            shown = np.concatenate(
                [density @ traced.colors, density.sum(1, keepdims=True) * t[:, None]], axis=1
            )
            weights = np.full(count + 1, step)
            weights[[0, -1]] /= 2
            out[pixel, :4] = (weights * light) @ shown
            out[pixel, 4] = 1 - light[-1]
        levels.append(out)
    for power in (4, 16, 64):
        levels = [
            (power * fine - coarse) / (power - 1) for coarse, fine in itertools.pairwise(levels)
        ]
    return levels[0][:, :3], levels[0][:, 4], levels[0][:, 3]
