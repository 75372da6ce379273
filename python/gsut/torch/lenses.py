"""gsplat's camera models and coefficients as lens parameters of ours, with their gradients."""

from __future__ import annotations

from typing import Any

import torch

from gsut import InputError

# gsplat's name -> ours; with coefficients a pinhole is an opencv12.
_MODELS = {
    "pinhole": "pinhole",
    "ortho": "orthographic",
    "fisheye": "kannala_brandt",
    "ftheta": "ftheta",
}
# Of k1 .. k6, p1, p2, s1 .. s4 in gsplat's three tensors to OpenCV's order.
_OPENCV12 = (0, 1, 6, 7, 2, 3, 4, 5, 8, 9, 10, 11)


def find_model(camera_model: str, has_coefficients: bool) -> str:
    """Finds our model of a gsplat camera model.

    Raises:
        InputError: an unknown one, or coefficients that it does not have.
    """
    if camera_model not in _MODELS:
        raise InputError(
            f'camera_model "{camera_model}" is not supported; known: {", ".join(_MODELS)}; '
            "camera= takes any lens of gsut"
        )
    if has_coefficients and camera_model == "pinhole":
        return "opencv12"
    if has_coefficients and camera_model in ("ortho", "ftheta"):
        raise InputError(f'camera_model "{camera_model}" takes no distortion coefficients')
    return _MODELS[camera_model]


def make_params(
    model: str,
    matrix: torch.Tensor,
    radial: torch.Tensor | None = None,
    tangential: torch.Tensor | None = None,
    thin_prism: torch.Tensor | None = None,
    ftheta: Any = None,
) -> torch.Tensor:
    """Makes the lens parameters of one camera; gradients reach the matrix and the coefficients.

    Args:
        model: ours, of `find_model`.
        matrix: (3, 3) K.
        radial, tangential, thin_prism: (4,) or (6,), (2,), (4,); None: zeros.
        ftheta: gsplat's object of F-theta coefficients, constants.

    Returns:
        (K,) float64 parameters in the model's order.

    Raises:
        InputError: a skewed K, or coefficients of another number.
    """
    matrix = matrix.to(torch.float64)
    if float(matrix[0, 1].detach()) != 0.0:
        raise InputError(
            "Ks with a skew (K[0, 1]) are not supported: gsplat ignores it; for gradcheck make Ks "
            "of fx, fy, cx and cy, and check these"
        )
    center = torch.stack([matrix[0, 2], matrix[1, 2]])
    if model == "ftheta":
        if ftheta is None:
            raise InputError('camera_model "ftheta" needs ftheta_coeffs')
        return torch.cat([center, _list_ftheta(ftheta)])
    focal = torch.stack([matrix[0, 0], matrix[1, 1]])
    if model == "kannala_brandt":
        return torch.cat([focal, center, _fill(radial, 4, "radial_coeffs")])
    if model == "opencv12":
        coefficients = torch.cat([
            _fill(radial, 6, "radial_coeffs"), _fill(tangential, 2, "tangential_coeffs"),
            _fill(thin_prism, 4, "thin_prism_coeffs"),
        ])  # fmt: skip
        return torch.cat([focal, center, coefficients[list(_OPENCV12)]])
    return torch.cat([focal, center])


def _fill(values: torch.Tensor | None, count: int, name: str) -> torch.Tensor:
    if values is None:
        return torch.zeros(count, dtype=torch.float64)
    if values.ndim != 1 or not 0 < len(values) <= count:
        raise InputError(f"{name} must have at most {count} numbers a camera, found {values.shape}")
    rest = torch.zeros(count - len(values), dtype=torch.float64)
    return torch.cat([values.to(torch.float64), rest])


def _list_ftheta(coefficients: Any) -> torch.Tensor:
    reference = coefficients.reference_poly
    numbers = [
        float(getattr(reference, "value", reference)),
        *coefficients.pixeldist_to_angle_poly,
        *coefficients.angle_to_pixeldist_poly,
        coefficients.max_angle,
        *coefficients.linear_cde,
    ]
    return torch.tensor([float(number) for number in numbers], dtype=torch.float64)
