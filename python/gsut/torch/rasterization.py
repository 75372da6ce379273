"""`rasterization` with gsplat's signature: every camera of a batch through `gsut.render`."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch

from gsut import Camera
from gsut.torch.arguments import Cameras, Lenses, make_view, read_api, refuse, warn_of_3d
from gsut.torch.arrays import to_tensor
from gsut.torch.info import BatchInfo
from gsut.torch.looks import Look

_TILE_SIZE = 16


def rasterization(
    means: torch.Tensor, quats: torch.Tensor, scales: torch.Tensor, opacities: torch.Tensor,
    colors: torch.Tensor | None, viewmats: torch.Tensor, Ks: torch.Tensor | None,
    width: int, height: int, near_plane: float = 0.01, far_plane: float = 1e10,
    radius_clip: float = 0.0, eps2d: float = 0.3, sh_degree: int | None = None,
    packed: bool = True, tile_size: int | None = None, backgrounds: torch.Tensor | None = None,
    render_mode: str = "RGB", sparse_grad: bool = False, absgrad: bool = False,
    rasterize_mode: str = "classic", channel_chunk: int = 32, distributed: bool = False,
    camera_model: str = "pinhole", segmented: bool = False, covars: torch.Tensor | None = None,
    with_ut: bool = False, with_eval3d: bool = False, *, return_normals: bool = False,
    global_z_order: bool = True, rays: torch.Tensor | None = None,
    radial_coeffs: torch.Tensor | None = None, tangential_coeffs: torch.Tensor | None = None,
    thin_prism_coeffs: torch.Tensor | None = None, ftheta_coeffs: Any = None,
    lidar_coeffs: Any = None, external_distortion_coeffs: Any = None,
    rolling_shutter: Any = 4, viewmats_rs: torch.Tensor | None = None, ut_params: Any = None,
    extra_signals: torch.Tensor | None = None, extra_signals_sh_degree: int | None = None,
    renderer_config: Any = None, masks: torch.Tensor | None = None,
    camera: Camera | None = None, camera_params: torch.Tensor | None = None,
    api: str | None = None,
) -> tuple[torch.Tensor, torch.Tensor, BatchInfo]:  # fmt: skip
    """Renders Gaussians as gsplat's `rasterization` does with_ut and with_eval3d, on the CPU.

    Every pixel's ray meets the Gaussians in 3D, whatever `with_ut` and `with_eval3d` say: the 2D
    approximation has no equal here, which a warning says once. Arguments that choose how a GPU
    works (tile_size, channel_chunk, segmented, ut_params, renderer_config) change no pixel.

    Args:
        means, quats, scales, opacities: [..., N, 3], [..., N, 4], [..., N, 3], [..., N].
        colors: [..., (C,) N, D] as they are, or with sh_degree [(..., C,) N, K, D].
        viewmats, Ks: [..., C, 4, 4], [..., C, 3, 3]; both have gradients, as have coefficients.
            That of viewmats is along rigid transforms: an optimizer of its 16 numbers leaves them,
            and gradcheck fails; optimize a rotation and a translation behind it.
        width, height, near_plane, far_plane, sh_degree, backgrounds, camera_model, radial_coeffs,
            tangential_coeffs, thin_prism_coeffs, ftheta_coeffs, rolling_shutter, viewmats_rs,
            global_z_order: as in gsplat.
        radius_clip: a Gaussian whose radii do not exceed it, in pixels, is left out.
        eps2d: variance added to `info["conics"]`, pixels squared; the image does not have it.
        packed: shapes of `info`: one row for each pair of a camera and a Gaussian that it sees.
        render_mode: "RGB", "D", "ED", "RGB+D", "RGB+ED": the centres' z; "d", "Ed", "RGB-d",
            "RGB-Ed": the distance along the ray to where it meets the Gaussian. With E: divided by
            the alphas.
        return_normals: also `info["normals"]` [..., C, H, W, 3], the Gaussians' z axes in the
            world, turned to the camera, blended.
        extra_signals, extra_signals_sh_degree: [..., (C,) N, E], or harmonics [(..., C,) N, K, E]:
            also `info["render_extra_signals"]` [..., C, H, W, E].
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
    refuse(
        render_mode, rasterize_mode=rasterize_mode, sparse_grad=sparse_grad, absgrad=absgrad,
        distributed=distributed, covars=covars, rays=rays, lidar_coeffs=lidar_coeffs,
        external_distortion_coeffs=external_distortion_coeffs,
    )  # fmt: skip
    if not (with_ut and with_eval3d):
        warn_of_3d()
    coefficients = (radial_coeffs, tangential_coeffs, thin_prism_coeffs)
    lenses = Lenses(camera_model, Ks, coefficients, ftheta_coeffs, camera, camera_params)
    view = make_view(
        lenses, width, height, near_plane, far_plane, rolling_shutter, global_z_order, sh_degree
    )
    cameras = Cameras(view, (means, quats, scales, opacities), viewmats, viewmats_rs, lenses)
    side = tile_size or _TILE_SIZE
    look = Look(
        cameras.lead, render_mode, colors, sh_degree, extra_signals, extra_signals_sh_degree,
        backgrounds, masks, return_normals, side,
    )  # fmt: skip
    size = {"width": width, "height": height, "tile_size": side}
    tiles = {"tile_width": -(-width // side), "tile_height": -(-height // side)}
    info = BatchInfo(cameras, packed, read_api(api), radius_clip, eps2d, {**size, **tiles})
    small = info.list_small() if radius_clip > 0.0 else {}
    found = []
    for place in cameras:
        if place.index in small:
            shown = to_tensor((~small[place.index]).astype(np.float32)).to(opacities.dtype)
            place = dataclasses.replace(place, scene=(*place.scene[:3], place.scene[3] * shown))
        found.append(look.render(view, place, info))
    pictures = {name: _join([f[name] for f in found], cameras.lead) for name in found[0]}
    image, alpha = pictures.pop("colors"), pictures.pop("alphas")
    info.update(pictures)
    return image, alpha, info


def _join(pictures: list[torch.Tensor], lead: tuple[int, ...]) -> torch.Tensor:
    """Arranges the cameras' pictures as a batch (..., C, H, W, X); a single one is not copied."""
    joined = pictures[0][None] if len(pictures) == 1 else torch.stack(pictures)
    return joined.reshape(*lead, *joined.shape[1:])
