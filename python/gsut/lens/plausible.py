"""Whether a lens that somebody's file states can be one: numbers that no camera has are named."""

from __future__ import annotations

import numpy as np

from gsut.lens.camera import Camera
from gsut.lens.field import has_focal_length

_MOST_STRETCH = 4.0  # of one focal length over the other; anamorphic lenses have 2
_FOCAL_RANGE = (1e-3, 1e4)  # focal length over the image's longer side
_NARROWEST = 1e-4  # radians between the farthest rays: a telescope's field is ten times that
_GRID = 9  # pixels a side that are asked for their ray


def implausible(camera: Camera) -> str | None:
    """What no camera has, as a clause; None where the lens may be one.

    The focal lengths' ratio and size, and whether pixels have rays that differ.
    """
    doubt = _of_focal_lengths(camera) if has_focal_length(camera) else None
    if doubt is not None:
        return doubt
    sides = (np.linspace(0.5, side - 0.5, _GRID) for side in (camera.width, camera.height))
    x, y = np.meshgrid(*sides)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    rays, valid = camera.unproject(pixels)[:2]
    if not valid.any():
        return "no pixel has a ray; its coefficients are not of this model, or in another order"
    rays = rays[valid]
    if camera.is_parallel or max(camera.width, camera.height) == 1 or len(rays) < 2:
        return None
    if np.linalg.norm(rays - rays[0], axis=1).max() < _NARROWEST:
        return "all pixels look in one direction; its coefficients are not of this model"
    return None


def _of_focal_lengths(camera: Camera) -> str | None:
    names = camera.param_names.split()
    fx, fy = (camera.params[names.index(name)] for name in ("fx", "fy"))
    stretch = max(fx / fy, fy / fx)
    if stretch > _MOST_STRETCH:
        return (
            f"fx = {fx:g} and fy = {fy:g} differ by a factor of {stretch:.1f}; real lenses have "
            "nearly equal ones"
        )
    size = max(camera.width, camera.height)
    if not (camera.is_parallel or _FOCAL_RANGE[0] <= fx / size <= _FOCAL_RANGE[1]):
        return f"fx = {fx:g} pixels does not go with an image {camera.width} x {camera.height}"
    return None
