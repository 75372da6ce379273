"""gsplat's PyTorch reference on a CPU: what it takes from CUDA and from nerfacc, in torch."""

from __future__ import annotations

import importlib
import sys
import time
import types
from types import ModuleType

import torch

_LEAST_ALPHA = 1.0 / 255.0
_MOST_ALPHA = 0.999


def make_reference(gsplat: ModuleType) -> ModuleType:
    """Puts gsplat's own torch functions where its reference calls CUDA.

    Args:
        gsplat: of version 1.5, not patched.

    Returns:
        `gsplat.rendering`, whose `_rasterization` runs.
    """
    rendering = importlib.import_module("gsplat.rendering")
    own = importlib.import_module("gsplat.cuda._torch_impl")
    rendering.isect_tiles = lambda means, radii, depths, side, across, down, **_: own._isect_tiles(
        means, radii, depths, side, across, down
    )
    rendering.isect_offset_encode = own._isect_offset_encode
    rendering.spherical_harmonics = lambda degree, dirs, coeffs, masks=None: (
        own._spherical_harmonics(degree, torch.nn.functional.normalize(dirs, dim=-1), coeffs)
    )
    importlib.import_module("gsplat.cuda._wrapper").rasterize_to_indices_in_range = list_pairs
    rays = types.ModuleType("nerfacc")
    rays.render_weight_from_alpha = weigh_along_rays
    rays.accumulate_along_rays = sum_along_rays
    sys.modules["nerfacc"] = rays
    return rendering


class PairClock:
    """Processor seconds in `list_pairs`, whose original is a CUDA kernel."""

    seconds = 0.0


@torch.no_grad()
def list_pairs(
    first: int, last: int, transmittances: torch.Tensor, means2d: torch.Tensor,
    conics: torch.Tensor, opacities: torch.Tensor, width: int, height: int, side: int,
    offsets: torch.Tensor, ids: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
    """Lists the pairs of a Gaussian and a pixel that it reaches, of one image, near to far."""
    begin = time.process_time()
    starts = [*offsets.flatten().tolist(), len(ids)]
    across = offsets.shape[-1]
    v, u = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    gaussians, pixels = [], []
    for tile in range(len(starts) - 1):
        listed = ids[starts[tile] : starts[tile + 1]].long()
        x, y = (tile % across) * side + u.flatten(), (tile // across) * side + v.flatten()
        inside = (x < width) & (y < height)
        x, y = x[inside], y[inside]
        delta = torch.stack([x, y], -1)[:, None] + 0.5 - means2d.reshape(-1, 2)[listed]
        a, b, c = conics.reshape(-1, 3)[listed].unbind(-1)
        power = 0.5 * (a * delta[..., 0] ** 2 + c * delta[..., 1] ** 2)
        power = power + b * delta[..., 0] * delta[..., 1]
        alphas = (opacities.flatten()[listed] * torch.exp(-power)).clamp(max=_MOST_ALPHA)
        pixel, which = torch.where((alphas >= _LEAST_ALPHA) & (power >= 0))
        gaussians.append(listed[which])
        pixels.append((y * width + x)[pixel])
    PairClock.seconds += time.process_time() - begin
    found = torch.cat(gaussians)
    return found, torch.cat(pixels), torch.zeros_like(found)


def weigh_along_rays(
    alphas: torch.Tensor, *, ray_indices: torch.Tensor, n_rays: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Weighs samples by their alpha and what those before them on the ray let through."""
    logs = torch.log1p(-alphas.double())
    before = torch.cumsum(logs, 0) - logs
    is_first = torch.ones_like(ray_indices, dtype=torch.bool)
    is_first[1:] = ray_indices[1:] != ray_indices[:-1]
    ray = torch.cumsum(is_first, 0) - 1
    through = torch.exp(before - before[is_first][ray]).to(alphas.dtype)
    return alphas * through, through


def sum_along_rays(
    weights: torch.Tensor, values: torch.Tensor | None, *, ray_indices: torch.Tensor, n_rays: int
) -> torch.Tensor:
    """Sums weighted values of each ray."""
    rows = weights[:, None] if values is None else weights[:, None] * values
    return torch.zeros(n_rays, rows.shape[1]).index_add(0, ray_indices, rows)
