"""`rasterization` with gsplat's signature: every camera of a batch through `gsut.render`."""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import warnings
from typing import Any

import numpy as np
import torch

from gsut import BlendRule, Camera, InputError, Shutter
from gsut.torch.info import BatchInfo, project_view
from gsut.torch.lenses import find_model, make_params
from gsut.torch.views import View, render_view

_APIS = ("1.4", "1.5", "1.6")
_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED", "d", "Ed", "RGB-d", "RGB-Ed")
# gsplat's numbers of rolling shutters, and ours.
_SHUTTERS = ("top_to_bottom", "left_to_right", "bottom_to_top", "right_to_left", None)
_SHUTTER_NAMES = {
    "ROLLING_TOP_TO_BOTTOM": 0,
    "ROLLING_LEFT_TO_RIGHT": 1,
    "ROLLING_BOTTOM_TO_TOP": 2,
    "ROLLING_RIGHT_TO_LEFT": 3,
    "GLOBAL": 4,
}
_TILE_SIZE = 16
_LEAST_ALPHA = 1e-10  # gsplat's, below which an expected depth is not divided further


def rasterization(
    means: torch.Tensor, quats: torch.Tensor, scales: torch.Tensor, opacities: torch.Tensor,
    colors: torch.Tensor | None, viewmats: torch.Tensor, Ks: torch.Tensor | None,
    width: int, height: int, near_plane: float = 0.01, far_plane: float = 1e10,
    radius_clip: float = 0.0, eps2d: float = 0.3, sh_degree: int | None = None,
    packed: bool = True, tile_size: int | None = None, backgrounds: torch.Tensor | None = None,
    render_mode: str = "RGB", sparse_grad: bool = False, absgrad: bool = False,
    rasterize_mode: str = "classic", channel_chunk: int = 32, distributed: bool = False,
    camera_model: str = "pinhole", segmented: bool = False, covars: torch.Tensor | None = None,
    with_ut: bool = False, with_eval3d: bool = False, *,
    radial_coeffs: torch.Tensor | None = None, tangential_coeffs: torch.Tensor | None = None,
    thin_prism_coeffs: torch.Tensor | None = None, ftheta_coeffs: Any = None,
    rolling_shutter: Any = 4, viewmats_rs: torch.Tensor | None = None,
    masks: torch.Tensor | None = None, global_z_order: bool = True,
    camera: Camera | None = None, camera_params: torch.Tensor | None = None,
    api: str | None = None, **others: Any,
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:  # fmt: skip
    """Renders Gaussians as gsplat's `rasterization` does with_ut and with_eval3d, on the CPU.

    Every pixel's ray meets the Gaussians in 3D, whatever `with_ut` and `with_eval3d` say: the 2D
    approximation, and what belongs to it (eps2d, radius_clip), has no equal here, which a warning
    says once. Arguments that choose how a GPU works (packed aside) change nothing.

    Args:
        means, quats, scales, opacities: [..., N, 3], [..., N, 4], [..., N, 3], [..., N].
        colors: [..., (C,) N, D] as they are, or with sh_degree [(..., C,) N, K, 3].
        viewmats, Ks: [..., C, 4, 4], [..., C, 3, 3]; both have gradients, as have coefficients.
        width, height, near_plane, far_plane, sh_degree, backgrounds, camera_model, radial_coeffs,
            tangential_coeffs, thin_prism_coeffs, ftheta_coeffs, rolling_shutter, viewmats_rs,
            global_z_order: as in gsplat.
        packed: shapes of `info`: one row for each pair of a camera and a Gaussian that it sees.
        render_mode: "RGB", "D", "ED", "RGB+D", "RGB+ED": the centres' z; "d", "Ed", "RGB-d",
            "RGB-Ed": the distance along the ray to where it meets the Gaussian. With E: divided by
            the alphas.
        masks: [..., C, rows, columns] of tiles; where False the background shows.
        camera: any lens of gsut in place of camera_model, Ks and coefficients.
        camera_params: (K,) or [..., C, K] its parameters, for their gradients; None: its own.
        api: "1.4", "1.5" or "1.6", whose shapes `info` has; None: of the gsplat that is installed,
            else "1.6".

    Returns:
        colors [..., C, H, W, X], alphas [..., C, H, W, 1] and `info` for gsplat's strategies.

    Raises:
        InputError: shapes disagree, tensors on a device, or an argument that is not supported.
    """
    _refuse(render_mode, rasterize_mode, sparse_grad, absgrad, distributed, covars, others)
    if not (with_ut and with_eval3d):
        _warn_of_3d()
    batch = means.shape[:-2]
    direction = _SHUTTERS[_read_shutter(rolling_shutter)]
    shutter = None if direction is None else Shutter(direction, "gsplat")
    rule = BlendRule("gsplat")
    rule.near_z, rule.far_z, rule.order_by_z = near_plane, far_plane, global_z_order
    coefficients = (radial_coeffs, tangential_coeffs, thin_prism_coeffs)
    model = find_model(camera_model, any(c is not None for c in coefficients))
    angle = None
    if camera is not None:
        model, angle = camera.model, camera.valid_field_angle
        if camera_params is None:
            camera_params = torch.tensor(camera.params.tolist(), dtype=torch.float64)
    view = View(
        model, width, height, rule, 3 if sh_degree is None else sh_degree, shutter, angle
    )  # fmt: skip
    lead = (*batch, viewmats.shape[-3])
    shots = []
    for index in np.ndindex(*lead):
        of_scene, c = index[:-1], index[-1]
        rows = [None if t is None else t[index] for t in coefficients]
        shots.append(
            _Shot(
                [t[of_scene] for t in (means, quats, scales, opacities)],
                _choose_colors(colors, sh_degree, of_scene, c, lead),
                viewmats[index],
                None if viewmats_rs is None or shutter is None else viewmats_rs[index],
                _choose_lens(model, Ks, rows, ftheta_coeffs, camera_params, index),
                None if backgrounds is None else backgrounds[index],
                None if masks is None else masks[index],
            )
        )
    projections = [project_view(view, s.scene, s.pose, s.pose_end, s.lens) for s in shots]
    version = _read_api(api)
    info = BatchInfo(projections, lead, opacities, packed, version, means.requires_grad)
    side = tile_size or _TILE_SIZE
    found = [
        shot.render(view, render_mode, sh_degree is not None, info.get_means2d(number), side)
        for number, shot in enumerate(shots)
    ]
    image, alpha = (torch.stack(list(pictures)) for pictures in zip(*found, strict=True))
    tiles = {"tile_width": -(-width // side), "tile_height": -(-height // side), "tile_size": side}
    meta = {**info.values, **tiles, "width": width, "height": height}
    return image.reshape(*lead, *image.shape[1:]), alpha.reshape(*lead, *alpha.shape[1:]), meta


@dataclasses.dataclass
class _Shot:
    """One camera of a batch and the tensors that it sees."""

    scene: list[torch.Tensor]  # means, quats, scales, opacities
    colors: torch.Tensor | None
    pose: torch.Tensor
    pose_end: torch.Tensor | None
    lens: torch.Tensor
    background: torch.Tensor | None
    mask: torch.Tensor | None

    def render(
        self, view: View, render_mode: str, is_sh: bool, means2d: torch.Tensor, tile_size: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Renders (H, W, X) and alphas (H, W, 1)."""
        with_color, with_z = "RGB" in render_mode, render_mode.endswith("D")
        if with_color and self.colors is None:
            raise InputError(f'render_mode "{render_mode}" needs colors')
        channels = []
        if with_color and not is_sh:
            channels.append(self.colors)
        if with_z:
            channels.append(self._find_depths(view)[:, None])
        image, alpha, distances, values = render_view(
            view, self.scene[0], self.scene[1], self.scene[2], self.scene[3], self.pose, self.lens,
            sh=self.colors if with_color and is_sh else None,
            features=torch.cat(channels, 1) if channels else None,
            pose_end=self.pose_end, means2d=means2d,
        )  # fmt: skip
        alpha = alpha[..., None]
        num_colors = values.shape[-1] - int(with_z)
        depths, picture = values[..., num_colors:], values[..., :num_colors]
        if render_mode.endswith("d"):
            depths = distances[..., None]
        if with_color and is_sh:
            picture = image
        if self.mask is not None:
            seen = self.mask.repeat_interleave(tile_size, 0).repeat_interleave(tile_size, 1)
            seen = seen[: view.height, : view.width, None].to(alpha.dtype)
            picture, alpha, depths = picture * seen, alpha * seen, depths * seen
        if self.background is not None and with_color:
            picture = picture + (1.0 - alpha) * self.background
        if "E" in render_mode:
            depths = depths / alpha.clamp(min=_LEAST_ALPHA)
        return torch.cat([picture, depths], -1), alpha

    def _find_depths(self, view: View) -> torch.Tensor:
        """Finds the centres' z in the camera, of a rolling shutter in the middle of exposure."""
        pose, means = self.pose, self.scene[0]
        if self.pose_end is not None:
            middle = view.make_motion(pose, self.pose_end).at(0.5)
            pose = torch.tensor(middle.tolist(), dtype=means.dtype)
        return means @ pose[2, :3] + pose[2, 3]


def _choose_lens(
    model: str, matrices: torch.Tensor | None, rows: list[torch.Tensor | None], ftheta: Any,
    camera_params: torch.Tensor | None, index: tuple[int, ...],
) -> torch.Tensor:  # fmt: skip
    if camera_params is not None:
        return camera_params if camera_params.ndim == 1 else camera_params[index]
    if matrices is None:
        raise InputError("Ks is None: give it, or camera=")
    radial, tangential, thin_prism = rows
    return make_params(model, matrices[index], radial, tangential, thin_prism, ftheta)


def _refuse(
    render_mode: str, rasterize_mode: str, sparse_grad: bool, absgrad: bool, distributed: bool,
    covars: Any, others: dict[str, Any],
) -> None:  # fmt: skip
    reasons = {
        "rasterize_mode": (rasterize_mode != "classic", "antialiased belongs to the 2D kernels"),
        "sparse_grad": (sparse_grad, "gradients are dense"),
        "absgrad": (absgrad, "means2d has no absolute gradient; use absgrad=False"),
        "distributed": (distributed, "one process renders; gsut train --cluster shares a scene"),
        "covars": (covars is not None, "give quats and scales"),
    }
    for name, (is_given, reason) in reasons.items():
        if is_given:
            raise InputError(f"{name} is not supported by gsut.torch.rasterization: {reason}")
    if render_mode not in _MODES:
        raise InputError(
            f'render_mode "{render_mode}" is not supported; known: {", ".join(_MODES)}'
        )
    accepted = {"ut_params", "renderer_config"}  # how gsplat bounds and schedules, nothing drawn
    for name, value in others.items():
        if name not in accepted and value is not None and value is not False:
            raise InputError(f"{name} is not supported by gsut.torch.rasterization")


@functools.cache
def _warn_of_3d() -> None:
    warnings.warn(
        "gsut evaluates Gaussians in 3D along each ray (with_ut=True, with_eval3d=True): the 2D "
        "approximation, with its eps2d and radius_clip, is not made",
        RuntimeWarning,
        stacklevel=3,
    )


def _read_shutter(rolling_shutter: Any) -> int:
    name = getattr(rolling_shutter, "name", None)
    number = _SHUTTER_NAMES.get(name, -1) if name is not None else rolling_shutter
    if number not in range(len(_SHUTTERS)):
        raise InputError(f"rolling_shutter {rolling_shutter} is unknown; known: 0 to 4")
    return int(number)


def _read_api(api: str | None) -> str:
    if api is None:
        try:
            api = ".".join(importlib.metadata.version("gsplat").split(".")[:2])
        except importlib.metadata.PackageNotFoundError:
            return _APIS[-1]
        return min(max(api, _APIS[0]), _APIS[-1])
    if api not in _APIS:
        raise InputError(f'api "{api}" is unknown; known: {", ".join(_APIS)}')
    return api


def _choose_colors(
    colors: torch.Tensor | None, sh_degree: int | None, of_scene: tuple[int, ...], camera: int,
    arrangement: tuple[int, ...],
) -> torch.Tensor | None:  # fmt: skip
    """Chooses one camera's colours: shared by all, one set a scene, or one a camera."""
    if colors is None:
        return None
    num_batch, num_cameras = len(arrangement) - 1, arrangement[-1]
    own = 2 if sh_degree is None else 3  # dimensions of one set
    lead = colors.ndim - own
    if lead == 0:
        return colors
    if lead == num_batch:
        return colors[of_scene]
    if lead == num_batch + 1 and colors.shape[num_batch] == num_cameras:
        return colors[(*of_scene, camera)]
    raise InputError(f"colors has shape {tuple(colors.shape)}, which fits no batch of this size")
