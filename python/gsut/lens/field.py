"""The field of view of any lens across its image, and lenses of a wanted one."""

from __future__ import annotations

import math

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import LEAST_SCALE, check_number
from gsut.lens.camera import Camera

_SAMPLES = 129  # of the middle row
_SEARCH_STEPS = 60  # bisections of the focal length
_GRID_COLUMNS = 40  # of pixels spread over an image
_CLOSE = (0.01, 0.1)  # relative, degrees: of what was wanted


def measure_field_of_view(camera: Camera) -> float | None:
    """Measures the degrees across the middle row, from its first to its last pixel with a ray.

    None where no two pixels of that row have one.
    """
    columns = np.linspace(0.0, camera.width, _SAMPLES)
    rays, valid = camera.unproject(np.column_stack([columns, np.full(_SAMPLES, camera.height / 2)]))
    if valid.sum() < 2:
        return None
    seen = rays[valid]
    cosines = np.clip(np.sum(seen[1:] * seen[:-1], axis=1), -1.0, 1.0)
    return float(np.degrees(np.arccos(cosines).sum()))


def spread_pixels(width: int, height: int) -> np.ndarray:
    """Spreads pixels (rows, columns, 2) evenly over an image, corner pixels included."""
    rows = max(2, round(_GRID_COLUMNS * height / width))
    x = np.linspace(0.5, width - 0.5, _GRID_COLUMNS)
    return np.stack(np.meshgrid(x, np.linspace(0.5, height - 0.5, rows)), axis=-1)


def measure_pixel_angle(camera: _core.Camera) -> float:
    """Measures the median angle between the rays of neighbouring pixels, radians; 1 without any."""
    rays, valid = camera.rays()
    both = valid[:, 1:] & valid[:, :-1]
    apart = np.linalg.norm((rays[:, 1:] - rays[:, :-1])[both], axis=1)
    return float(np.median(apart)) if len(apart) else 1.0


def has_focal_length(camera: Camera) -> bool:
    """Returns whether the lens has fx and fy, which `with_scaled_focal` scales."""
    return {"fx", "fy"} <= set(camera.param_names.split())


def find_focal_params(camera: Camera) -> list[int]:
    """Returns the indices of fx and fy among the parameters of a lens that has them."""
    names = camera.param_names.split()
    return [names.index("fx"), names.index("fy")]


def with_scaled_focal(camera: Camera, factor: float) -> Camera:
    """Returns the lens with its focal lengths times a factor."""
    factor = check_number(factor, "factor", LEAST_SCALE, 1 / LEAST_SCALE)
    params = np.array(camera.params)
    params[find_focal_params(camera)] *= factor
    return camera.with_params(params)


def with_field_of_view(camera: Camera, degrees: float) -> Camera:
    """Returns the lens with its focal lengths scaled so that the image spans this field across.

    Raises:
        InputError: the lens has no focal length, or cannot span that.
    """
    if not has_focal_length(camera):
        raise InputError(f"{camera.model} has no focal length that a field of view could change")
    degrees = check_number(degrees, "degrees", 0, 360, above=True)
    low, high = math.log(1e-3), math.log(1e3)
    for _ in range(_SEARCH_STEPS):
        middle = (low + high) / 2
        across = measure_field_of_view(with_scaled_focal(camera, math.exp(middle)))
        low, high = (low, middle) if across is None or across < degrees else (middle, high)
    found = with_scaled_focal(camera, math.exp((low + high) / 2))
    across = measure_field_of_view(found)
    if across is None or abs(across - degrees) > _CLOSE[0] * degrees + _CLOSE[1]:
        nearest = "" if across is None else f"; the nearest is {across:.0f}"
        raise InputError(f"a {camera.model} lens cannot span {degrees:g} degrees{nearest}")
    return found
