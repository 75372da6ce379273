"""Spherical harmonics of any degree and number of channels, as steps of autograd."""

from __future__ import annotations

import math

import torch

from gsut import InputError


def compute_basis(degree: int, directions: torch.Tensor) -> torch.Tensor:
    """Computes the real basis in the order and with the signs of PLY files.

    Args:
        degree: 0 or more.
        directions: [..., 3] of any length.

    Returns:
        [..., (degree + 1)^2]: order m of band l stands at l (l + 1) + m. The associated Legendre
        functions follow the recurrence in l, divided by sin^m, which (x + iy)^m brings back.
    """
    x, y, z = torch.nn.functional.normalize(directions, dim=-1).unbind(-1)
    columns: dict[tuple[int, int], torch.Tensor] = {}
    cosine, sine = torch.ones_like(x), torch.zeros_like(x)  # of (x + iy)^m
    diagonal = 1.0  # (2m - 1)!!
    for m in range(degree + 1):
        before, legendre = torch.zeros_like(x), torch.full_like(x, diagonal)
        for band in range(m, degree + 1):
            norm = (2 * band + 1) / (4 * math.pi)
            norm *= math.factorial(band - m) / math.factorial(band + m)
            factor = (-1) ** m * math.sqrt(norm * (2 if m else 1))
            columns[band, m] = factor * legendre * cosine
            if m:
                columns[band, -m] = factor * legendre * sine
            ahead = ((2 * band + 1) * z * legendre - (band + m) * before) / (band - m + 1)
            before, legendre = legendre, ahead
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        diagonal *= 2 * m + 1
    return torch.stack([columns[key] for key in sorted(columns)], -1)


def evaluate_harmonics(
    degrees_to_use: int,
    dirs: torch.Tensor,
    coeffs: torch.Tensor,
    masks: torch.Tensor | None = None,
) -> torch.Tensor:
    """Evaluates harmonics as gsplat 1.4 and 1.5 do, without the offset of 0.5 and without a clamp.

    Args:
        degrees_to_use: higher bands are ignored.
        dirs: [..., 3] of any length.
        coeffs: [..., K, D].
        masks: [...], False: 0 there.

    Returns:
        [..., D] with gradients to `dirs` and `coeffs`.

    Raises:
        InputError: `coeffs` lacks bands.
    """
    count = (degrees_to_use + 1) ** 2
    if coeffs.shape[-2] < count:
        raise InputError(
            f"degree {degrees_to_use} needs {count} coefficients, found {coeffs.shape[-2]}"
        )
    basis = compute_basis(degrees_to_use, dirs)
    values = torch.einsum("...k,...kd->...d", basis, coeffs[..., :count, :])
    return values if masks is None else torch.where(masks[..., None], values, values.new_zeros(()))


def evaluate_view_harmonics(
    degree: int,
    means: torch.Tensor,
    viewmats: torch.Tensor,
    coeffs: torch.Tensor,
    masks: torch.Tensor | None = None,
    *,
    viewmats_rs: torch.Tensor | None = None,
    **others: object,
) -> torch.Tensor:
    """Evaluates harmonics as gsplat 1.6 does, from cameras to centres.

    Args:
        degree: higher bands are ignored.
        means: [..., N, 3].
        viewmats: [..., C, 4, 4].
        coeffs: [N, K, D], or one set a scene or a camera before that.
        masks: [..., C, N], False: 0 there.
        viewmats_rs: poses at the end of a rolling shutter; directions are from the middle.
        **others: packed indices, which are not supported.

    Returns:
        [..., C, N, D].

    Raises:
        InputError: packed indices, or `coeffs` lacks bands.
    """
    for name, value in others.items():
        if value is not None:
            raise InputError(f"{name} is not supported by gsut's spherical_harmonics: packed=False")
    if coeffs.ndim == means.ndim + 1:
        coeffs = coeffs[..., None, :, :, :]  # one set a scene
    directions = means[..., None, :, :] - find_centers(viewmats, viewmats_rs)[..., None, :]
    return evaluate_harmonics(degree, directions, coeffs, masks)


def find_centers(poses: torch.Tensor, poses_end: torch.Tensor | None) -> torch.Tensor:
    """Finds the cameras' centres [..., 3]; of a rolling shutter the mean of both ends'."""
    centers = -torch.einsum("...ji,...j->...i", poses[..., :3, :3], poses[..., :3, 3])
    return centers if poses_end is None else 0.5 * (centers + find_centers(poses_end, None))
