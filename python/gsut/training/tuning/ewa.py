"""Pictures as viewers draw them: EWA splats with a widening of the screen, by the exact renderer.

A viewer projects a Gaussian affinely (Zwicker et al., EWA Splatting, 2001; Kerbl et al. 2023) and
adds a variance of 0.3 pixels squared. Seen by a pinhole, that ellipse is exactly what a Gaussian
without thickness draws that lies across the optical axis at the centre's depth: so each Gaussian is
replaced by such a disc, and the renderer and its gradients stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut._core import BlendRule, InputError
from gsut.gaussians import (
    Gaussians,
    multiply_quaternions,
    quaternion_from_rotation,
    rotations_from_quaternions,
)
from gsut.render import Render, render

_DILATION = 0.3  # px^2: what the screen of every viewer adds
_NEAR = 0.2  # of 3DGS: centres nearer than this along the axis are not drawn
# Beyond this many times the half field of view the affine map is taken at the edge (3DGS).
_FIELD = 1.3
_THICKNESS = 1e-3  # of a disc, of its smaller radius
# Discs nearly round turn without a change; the ratio of 0 to 0 is kept from growing beyond this.
_LEAST_DIFFERENCE = 1e-4


def make_viewer_rule() -> BlendRule:
    """Returns the blend rule of web viewers: ordered by distance, without what is too near."""
    rule = BlendRule()
    rule.near_z = _NEAR
    return rule


class EwaSplats:
    """One camera's discs in place of Gaussians, and the way back for gradients.

    Args:
        gaussians: N Gaussians.
        camera: of the model "pinhole".
        camera_from_world: (4, 4).

    Attributes:
        discs: N Gaussians that the exact renderer draws as EWA splats of `gaussians`.

    Raises:
        InputError: another model, or pixels that are not square.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        camera: _core.Camera,
        camera_from_world: np.ndarray,
    ) -> None:
        focal = camera.params[0]
        if camera.model != "pinhole" or abs(camera.params[1] - focal) > 1e-6 * focal:
            raise InputError("EWA splats need a pinhole camera with square pixels")
        g, dtype, pose = gaussians, gaussians.dtype, np.asarray(camera_from_world, np.float64)
        self._g, self._rotation = g, pose[:3, :3]
        zero = pose[:3, 3] + self._rotation @ g.origin  # of the means, in the camera's frame
        self._widening = _DILATION / focal**2
        at = g.means @ self._rotation.T.astype(dtype) + zero.astype(dtype)
        # What lies behind is not drawn; it only must not divide by zero.
        self._z = np.maximum(at[:, 2], _NEAR)
        size = np.array([camera.width, camera.height])
        most = (_FIELD * size / (2 * focal)).astype(dtype)
        slope = at[:, :2] / self._z[:, None]
        self._inside = np.abs(slope) < most
        self._slope = np.clip(slope, -most, most)
        self._norm = np.linalg.norm(g.quats, axis=1, keepdims=True)
        self._axes = rotations_from_quaternions(g.quats / self._norm)  # world <- Gaussian
        self._turned = self._rotation.astype(dtype) @ self._axes
        self._scales = np.exp(g.log_scales)
        # Shadow along the ray on the plane across the axis: two rows of x - slope z, then scaled.
        flat = self._turned[:, :2] - self._slope[:, :, None] * self._turned[:, 2:]
        self._map = flat * self._scales[:, None]
        plane = self._map @ self._map.transpose(0, 2, 1)
        plane[:, [0, 1], [0, 1]] += (self._widening * self._z**2)[:, None]
        self._make_discs(plane)

    def _make_discs(self, plane: np.ndarray) -> None:
        """Makes discs of these covariances (N, 2, 2) on the plane across the axis."""
        a, b, c = plane[:, 0, 0], plane[:, 0, 1], plane[:, 1, 1]
        middle, half = (a + c) / 2, np.hypot((a - c) / 2, b)
        self._large = middle + half
        self._small = np.maximum((a * c - b * b) / self._large, 1e-6 * self._large)
        angle = 0.5 * np.arctan2(2 * b, a - c)
        self._cos, self._sin = np.cos(angle), np.sin(angle)
        world, zero = quaternion_from_rotation(self._rotation.T), np.zeros_like(angle)
        c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
        quats = multiply_quaternions(world, np.stack([c, zero, zero, s], axis=1))
        # Its derivative by the angle.
        self._tangent = multiply_quaternions(world, np.stack([-s, zero, zero, c], axis=1) / 2)
        logs = 0.5 * np.log(np.stack([self._large, self._small], axis=1))
        thin = logs[:, 1:] + np.log(_THICKNESS)
        g = self._g
        self.discs = Gaussians(
            g.means, quats, np.concatenate([logs, thin], axis=1),
            g.opacity_logits, g.sh, g.origin,
        )  # fmt: skip

    def backpropagate(self, gradients: Gaussians) -> None:
        """Turns gradients to the discs into those to the Gaussians, in place.

        Gradients to opacities, harmonics and, for their own part, means pass through.
        """
        s = self._scales
        of_large = (gradients.log_scales[:, 0]) / (2 * self._large)
        thickness = gradients.log_scales[:, 2]  # follows the smaller radius
        of_small = (gradients.log_scales[:, 1] + thickness) / (2 * self._small)
        of_angle = np.sum(gradients.quats * self._tangent, axis=1)
        difference = np.maximum(self._large - self._small, _LEAST_DIFFERENCE * self._large)
        mixed = of_angle / (2 * difference)
        p, q = self._cos, self._sin
        g = np.empty((len(s), 2, 2), s.dtype)  # dL_dplane
        g[:, 0, 0] = p * p * of_large - 2 * p * q * mixed + q * q * of_small
        g[:, 1, 1] = q * q * of_large + 2 * p * q * mixed + p * p * of_small
        g[:, 0, 1] = g[:, 1, 0] = p * q * (of_large - of_small) + (p * p - q * q) * mixed
        of_map = 2 * g @ self._map  # (N, 2, 3)
        of_flat = of_map * s[:, None]
        flat = self._map / s[:, None]
        gradients.log_scales[:] = np.sum(of_map * flat, axis=1) * s
        of_slope = -np.sum(of_flat * self._turned[:, 2:], axis=2) * self._inside
        of_turned = np.concatenate(
            [of_flat, -np.sum(of_flat * self._slope[:, :, None], axis=1, keepdims=True)], axis=1
        )
        of_axes = self._rotation.T.astype(s.dtype) @ of_turned
        gradients.quats[:] = (
            _backpropagate_rotations(self._g.quats / self._norm, of_axes) / self._norm
        )
        of_depth = 2 * self._widening * self._z * (g[:, 0, 0] + g[:, 1, 1])
        of_depth -= np.sum(of_slope * self._slope, axis=1) / self._z
        of_point = np.concatenate([of_slope / self._z[:, None], of_depth[:, None]], axis=1)
        of_point *= (self._z > _NEAR)[:, None]
        gradients.means[:] += of_point @ self._rotation.astype(s.dtype)


def render_ewa(
    gaussians: Gaussians,
    camera: _core.Camera,
    camera_from_world: np.ndarray,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    dtype: str = "float32",
) -> Render:
    """Renders the picture that viewers draw of Gaussians, see `EwaSplats` and `render`."""
    g = gaussians.to_dtype(np.dtype(dtype))
    discs = EwaSplats(g, camera, camera_from_world).discs
    rule = make_viewer_rule()
    return render(discs, camera, camera_from_world, background=background, blend=rule, dtype=dtype)


def _backpropagate_rotations(q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Carries gradients (N, 3, 3) to rotations back to their unit quaternions (N, 4).

    The results are tangent to the unit sphere: a quaternion's norm does not change its rotation.
    """
    w, x, y, z = q.T
    skew = [r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    xx, yy, zz = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    gradient = 2 * np.stack([
        x * skew[0] + y * skew[1] + z * skew[2],
        w * skew[0] + y * xy + z * xz - 2 * x * (yy + zz),
        w * skew[1] + x * xy + z * yz - 2 * y * (xx + zz),
        w * skew[2] + x * xz + y * yz - 2 * z * (xx + yy),
    ], axis=1)  # fmt: skip
    return gradient - q * np.sum(q * gradient, axis=1, keepdims=True)
