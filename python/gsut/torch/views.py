"""One view of Gaussians as a step of autograd: values and gradients are those of `gsut.render`."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from gsut import (
    BlendRule,
    Camera,
    CameraMotion,
    InputError,
    LinearGaussians,
    Shutter,
    render,
    render_backward,
)
from gsut.torch.arrays import to_array, to_tensor

# Cameras whose table of rays is kept: a lens that stands still is computed once.
_CAMERAS_KEPT = 64
# Gaussians whose Jacobians are made at a time: their arrays stay in the processor's cache.
_ROWS = 4096


@dataclasses.dataclass(frozen=True)
class View:
    """What one picture shows, apart from the tensors that have gradients.

    Attributes:
        model: name of the lens, see `gsut.lens.camera_models`.
        width, height: size of the image in pixels.
        rule: how Gaussians become a pixel.
        sh_degree: harmonics above this degree are ignored.
        shutter: of a moving camera; None: all lines at once.
        valid_field_angle: of the lens, radians from its axis; None: as far as its formula goes.
    """

    model: str
    width: int
    height: int
    rule: BlendRule = dataclasses.field(default_factory=BlendRule)
    sh_degree: int = 3
    shutter: Shutter | None = None
    valid_field_angle: float | None = None

    def make_camera(self, params: torch.Tensor) -> Camera:
        """Makes the camera of lens parameters (K,), or takes the one that was made of them."""
        values = to_array(params.to(torch.float64), "lens parameters")
        return _make_camera(
            self.model, values.tobytes(), self.width, self.height, self.valid_field_angle
        )

    def make_motion(self, pose: torch.Tensor, pose_end: torch.Tensor | None) -> Any:
        """Makes the camera's place: one pose (4, 4), or a motion between two."""
        start = to_array(pose.to(torch.float64), "viewmats")
        if self.shutter is None:
            return start
        if pose_end is None:
            raise InputError("a rolling shutter needs viewmats_rs, the poses at its end")
        end = to_array(pose_end.to(torch.float64), "viewmats_rs")
        return CameraMotion(start, end, self.shutter)


@functools.lru_cache(maxsize=_CAMERAS_KEPT)
def _make_camera(
    model: str, params: bytes, width: int, height: int, valid_field_angle: float | None
) -> Camera:
    camera = Camera(model, np.frombuffer(params, np.float64), width, height)
    return camera if valid_field_angle is None else camera.with_valid_field_angle(valid_field_angle)


def render_view(
    view: View,
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    pose: torch.Tensor,
    lens: torch.Tensor,
    *,
    sh: torch.Tensor | None = None,
    features: torch.Tensor | None = None,
    pose_end: torch.Tensor | None = None,
    means2d: torch.Tensor | None = None,
    wants_means2d: Callable[[], bool] | None = None,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Renders one view before black; gradients reach every tensor.

    Args:
        view: size, lens model and rules.
        means, quats, scales, opacities: (N, 3), (N, 4), (N, 3), (N,), see `gsut.LinearGaussians`;
            float64 takes the double reference, which is slow.
        pose: (4, 4) camera_from_world. Its gradient is across rigid transforms: exact for any
            parameters of a rotation and a translation behind it.
        lens: (K,) the lens' parameters in the model's order.
        sh: (N, K, 3) harmonics of the colour.
        features: (N, D) values as they are.
        pose_end: (4, 4) at the end of a rolling shutter.
        means2d: (N, 2) whose values are not read; its gradient becomes that to the centres in
            pixels, which strategies of densification read.
        wants_means2d: called in the backward pass, returns whether that gradient is wanted; None:
            it is.

    Returns:
        image (H, W, 3), alpha (H, W), depth (H, W), features (H, W, D); see `gsut.Render`.

    Raises:
        InputError: as of `gsut.render`, and for tensors on a device.
    """
    return _RenderView.apply(
        view, means, quats, scales, opacities, pose, lens, sh, features, pose_end, means2d,
        wants_means2d,
    )  # fmt: skip


class _RenderView(torch.autograd.Function):
    """Renders in forward, and calls `gsut.render_backward` once in backward."""

    @staticmethod
    def forward(
        ctx: Any, view: View, means: torch.Tensor, quats: torch.Tensor, scales: torch.Tensor,
        opacities: torch.Tensor, pose: torch.Tensor, lens: torch.Tensor,
        sh: torch.Tensor | None, features: torch.Tensor | None, pose_end: torch.Tensor | None,
        means2d: torch.Tensor | None, wants_means2d: Callable[[], bool] | None,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
        named = {"means": means, "quats": quats, "scales": scales, "opacities": opacities}
        arrays: dict[str, Any] = {name: to_array(tensor, name) for name, tensor in named.items()}
        if sh is not None:
            arrays["sh"] = to_array(sh, "colors")
        gaussians = LinearGaussians(**arrays)
        camera = view.make_camera(lens)
        values = None
        if features is not None and features.shape[1] > 0:
            values = to_array(features, "colors")
        result = render(
            gaussians, camera, view.make_motion(pose, pose_end), blend=view.rule,
            sh_degree=view.sh_degree, features=values, dtype=str(gaussians.dtype), watch=False,
        )  # fmt: skip
        ctx.result = result
        # torch itself knows whether one of them was changed in place: cheaper than to compare.
        ctx.save_for_backward(*(
            t for t in (means, quats, scales, opacities, sh, features) if t is not None
        ))  # fmt: skip
        ctx.inputs = (pose, lens, sh, features, pose_end, means2d, wants_means2d)
        of_features = result.features
        if of_features is None:
            of_features = np.zeros((view.height, view.width, 0), gaussians.dtype)
        ctx.set_materialize_grads(False)
        pictures = (result.image, result.alpha, result.depth, of_features)
        return tuple(to_tensor(picture) for picture in pictures)  # backward reads none of them

    @staticmethod
    def backward(ctx: Any, *outer: torch.Tensor | None) -> Any:
        _ = ctx.saved_tensors  # raises if one of them was changed in place
        result = ctx.result
        pose, lens, sh, features, pose_end, means2d, wants_means2d = ctx.inputs
        dimage, dalpha, ddepth, dfeatures = (
            None if gradient is None else to_array(gradient, "a gradient") for gradient in outer
        )
        if dimage is None:
            dimage = np.zeros_like(result.image)
        if dfeatures is not None and dfeatures.shape[2] == 0:
            dfeatures = None
        wants_lens = lens.requires_grad
        found = render_backward(
            result, dimage, dalpha, ddepth, dfeatures=dfeatures, with_lens=wants_lens
        )
        g = found.gaussians
        ends = [end for end in (pose, pose_end) if end is not None]
        of_poses = [
            _differentiate_pose(twist, end) if end.requires_grad else None
            for twist, end in zip(found.pose.reshape(-1, 6), ends, strict=True)
        ]
        of_lens = None if found.lens is None else to_tensor(found.lens).to(lens.dtype)
        of_features = None
        if features is not None:
            of_features = torch.zeros_like(features)
            if found.features is not None:
                of_features = to_tensor(found.features)
        of_means2d = None
        if means2d is not None and (wants_means2d is None or wants_means2d()):
            of_means2d = to_tensor(find_pixel_slopes(result, g.means)).to(means2d.dtype)
        return (
            None, *(to_tensor(array) for array in (g.means, g.quats, g.scales, g.opacities)),
            of_poses[0], of_lens, None if sh is None else to_tensor(g.sh), of_features,
            of_poses[1] if pose_end is not None and len(of_poses) > 1 else None, of_means2d,
            None,
        )  # fmt: skip


def _differentiate_pose(twist: np.ndarray, pose: torch.Tensor) -> torch.Tensor:
    matrix = to_array(pose.to(torch.float64), "pose")
    return to_tensor(differentiate_matrix(twist, matrix)).to(pose.dtype)


def differentiate_matrix(twist: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Converts a gradient to a twist of a pose into one to its matrix (4, 4).

    A twist (v, w) from the left moves the matrix [R | t] by [w x R | w x t + v]. Of the matrices
    whose product with this is the twist's for all of them, the one along rotations is returned.
    """
    to_translation, to_turn = twist[:3], twist[3:]
    along = 0.5 * (to_turn - np.cross(matrix[:3, 3], to_translation))
    out = np.zeros((4, 4))
    out[:3, 3] = to_translation
    for column in range(3):
        out[:3, column] = np.cross(along, matrix[:3, column])
    return out


def find_pixel_slopes(result: Any, to_means: np.ndarray) -> np.ndarray:
    """Converts gradients to the means (N, 3) into ones to their centres in pixels (N, 2).

    By the pseudo-inverse of the lens' derivative at the centre; 0 where the centre has no pixel.
    """
    motion = result.camera_from_world
    pose = motion.at(0.5) if isinstance(motion, CameraMotion) else motion
    out = np.zeros((len(to_means), 2))
    moved = np.flatnonzero(to_means.any(axis=1))  # few of a large scene
    means = result.gaussians.means
    for first in range(0, len(moved), _ROWS):
        rows = moved[first : first + _ROWS]
        points = means[rows].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        jacobian, _ = result.camera.project_jacobian(points, with_params=False)
        in_camera = pose[:3, :3] @ to_means[rows].T.astype(np.float64)
        out[rows] = _divide_by_jacobians(in_camera, np.ascontiguousarray(jacobian.reshape(-1, 6).T))
    return out


def _divide_by_jacobians(g: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Solves the 2 x 2 systems j j^T x = j g of gradients (3, M) and Jacobians (6, M), row by row.

    Returns:
        x (M, 2); 0 where it is not finite.
    """
    first = j[0] * g[0] + j[1] * g[1] + j[2] * g[2]
    second = j[3] * g[0] + j[4] * g[1] + j[5] * g[2]
    xx = j[0] * j[0] + j[1] * j[1] + j[2] * j[2]
    xy = j[0] * j[3] + j[1] * j[4] + j[2] * j[5]
    yy = j[3] * j[3] + j[4] * j[4] + j[5] * j[5]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (xx * yy - xy * xy)
        x = np.stack([(yy * first - xy * second) * inverse, (xx * second - xy * first) * inverse])
    return np.where(np.isfinite(x).all(axis=0), x, 0.0).T
