"""gsplat's functions of covariances, relocation and projection, on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from gsut import InputError
from gsut.torch.arguments import Cameras, Lenses, make_view
from gsut.torch.arrays import to_tensor
from gsut.torch.info import invert_covariances, project_view

# Of the nine numbers of a symmetric 3 x 3 matrix, its upper triangle row by row.
_UPPER = [0, 1, 2, 4, 5, 8]


def make_rotations(quats: torch.Tensor) -> torch.Tensor:
    """Converts quaternions w, x, y, z [..., 4] of any norm into matrices [..., 3, 3]."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def make_covariances(
    quats: torch.Tensor,
    scales: torch.Tensor,
    compute_covar: bool = True,
    compute_preci: bool = True,
    triu: bool = False,
) -> tuple[torch.Tensor | None, torch.Tensor | None]:
    """Makes covariances and their inverses, as gsplat's `quat_scale_to_covar_preci`.

    Args:
        quats: [..., 4] of any norm.
        scales: [..., 3] standard deviations.
        compute_covar, compute_preci: whether to make each; None otherwise.
        triu: as the upper triangle [..., 6] in place of [..., 3, 3].
    """
    rotations = make_rotations(quats)
    out = []
    for is_wanted, factors in ((compute_covar, scales), (compute_preci, 1.0 / scales)):
        matrix = None
        if is_wanted:
            root = rotations * factors[..., None, :]
            matrix = root @ root.transpose(-1, -2)
            matrix = matrix.flatten(-2)[..., _UPPER] if triu else matrix
        out.append(matrix)
    return out[0], out[1]


@torch.no_grad()
def compute_relocation(
    opacities: torch.Tensor,
    scales: torch.Tensor,
    ratios: torch.Tensor,
    binoms: torch.Tensor,
    min_opacity: float = 0.0,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Computes what each of n copies of a Gaussian must be for the n to look like the one.

    Equation 9 of Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", in
    double, since its sum alternates.

    Args:
        opacities: (N,) from 0 to 1.
        scales: (N, 3).
        ratios: (N,) the number of copies; from 1 to the size of `binoms`.
        binoms: (M, M) binomial coefficients, n over k at [n, k].
        min_opacity: least opacity that is returned.

    Returns:
        Opacities (N,) and scales (N, 3) of the copies.
    """
    count = ratios.clamp(1, len(binoms)).to(torch.int64)
    old = opacities.to(torch.float64)
    new = 1.0 - (1.0 - old) ** (1.0 / count)
    k = torch.arange(len(binoms), dtype=torch.float64)
    weights = torch.cumsum(binoms.to(torch.float64), 0) * ((-1.0) ** k / torch.sqrt(k + 1.0))
    powers = new[:, None] ** (k + 1.0)
    shrink = old / (weights[count - 1] * powers).sum(1)
    shrink = torch.where(count == 1, torch.ones_like(shrink), shrink)  # 0 / 0 at opacity 0
    new = new.clamp(min=min_opacity).to(opacities.dtype)
    return new, scales * shrink[:, None].to(scales.dtype)


@torch.no_grad()
def project_cameras(
    means: torch.Tensor, quats: torch.Tensor, scales: torch.Tensor,
    opacities: torch.Tensor | None, viewmats: torch.Tensor, Ks: torch.Tensor | None,
    width: int, height: int, eps2d: float = 0.3, near_plane: float = 0.01,
    far_plane: float = 1e10, radius_clip: float = 0.0, calc_compensations: bool = False,
    camera_model: str = "pinhole", ut_params: Any = None, *,
    radial_coeffs: torch.Tensor | None = None, tangential_coeffs: torch.Tensor | None = None,
    thin_prism_coeffs: torch.Tensor | None = None, ftheta_coeffs: Any = None,
    rolling_shutter: Any = 4, viewmats_rs: torch.Tensor | None = None,
    global_z_order: bool = True, **others: Any,
) -> tuple[torch.Tensor | None, ...]:  # fmt: skip
    """Projects Gaussians as gsplat's `fully_fused_projection_with_ut`, without gradients.

    Args:
        means, quats, scales, opacities: [..., N, 3], [..., N, 4], [..., N, 3], [..., N]; without
            opacities 1 bounds the radii.
        viewmats, Ks, width, height, near_plane, far_plane, camera_model, coefficients,
            rolling_shutter, viewmats_rs: as in `rasterization`.
        eps2d: variance that is added along both axes of the image, pixels squared.
        radius_clip: a Gaussian whose radii do not exceed it counts as unseen.
        calc_compensations: also the ratio by which `eps2d` thins each Gaussian.
        ut_params: not read: the transform's weights are alpha 1, beta 2, kappa 0.
        global_z_order: False: depths are distances.

    Returns:
        radii [..., C, N, 2] int32, means2d [..., C, N, 2], depths [..., C, N], conics
        [..., C, N, 3] and compensations [..., C, N] or None.

    Raises:
        InputError: as of `rasterization`.
    """
    for name, value in others.items():
        if value is not None:
            raise InputError(f"{name} is not supported by gsut's fully_fused_projection_with_ut")
    lenses = Lenses(
        camera_model, Ks, (radial_coeffs, tangential_coeffs, thin_prism_coeffs), ftheta_coeffs
    )
    view = make_view(
        lenses, width, height, near_plane, far_plane, rolling_shutter, global_z_order
    )  # fmt: skip
    if opacities is None:
        opacities = torch.ones_like(means[..., 0])
    cameras = Cameras(view, (means, quats, scales, opacities), viewmats, viewmats_rs, lenses)
    found = []
    for place in cameras:
        arrays = project_view(view, place, radius_clip)
        thinned = invert_covariances(arrays["covariances"], arrays["radii"], eps2d)
        found.append({**arrays, **thinned})
    names = ("radii", "means2d", "depths", "conics", "compensations")
    out = [
        to_tensor(np.stack([a[name] for a in found])).reshape(*cameras.lead, *found[0][name].shape)
        for name in names
    ]
    return (*out[:4], out[4] if calc_compensations else None)
