"""Fits a lens to a table of pixels and their rays."""

from __future__ import annotations

import numpy as np

from gsut._core import InputError, camera_traits
from gsut.bounds import name_wrong_kinds
from gsut.lens.camera import Camera
from gsut.lens.fit import FitTarget, find_angles, fit_lens

_FEWEST = 8  # rays: the four numbers of the first guess, twice over
_NEAR_AXIS = 0.5  # radians: rays from which focal length and principal point are guessed


@name_wrong_kinds
def fit_camera(
    pixels: np.typing.ArrayLike,
    rays: np.typing.ArrayLike,
    *,
    model: str,
    width: int,
    height: int,
) -> Camera:
    """Fits a lens to pixels and their rays, by least squares of the pixel distances.

    Args:
        pixels: (N, 2); (0.5, 0.5) is the centre of the top-left pixel.
        rays: (N, 3) in camera axes (x right, y down, z forward), of any length; rows that are not
            finite do not count.
        model: see `camera_models()`.
        width, height: of the image in pixels.

    Returns:
        The lens; `project(rays)` against `pixels` says how well it fits.

    Raises:
        InputError: wrong shapes, unknown model, too few rays, or rays that the model cannot see.
    """
    at = np.array(pixels, np.float64).reshape(-1, 2)
    directions = np.array(rays, np.float64).reshape(-1, 3)
    if len(at) != len(directions):
        raise InputError(f"there are {len(at)} pixels, but {len(directions)} rays")
    length = np.linalg.norm(directions, axis=1)
    good = np.isfinite(at).all(axis=1) & np.isfinite(length) & (length > 0)
    if np.count_nonzero(good) < _FEWEST:
        raise InputError(
            f"{np.count_nonzero(good)} of {len(at)} pixels have a ray; a fit needs {_FEWEST}"
        )
    if camera_traits(model).is_parallel:
        raise InputError(f"the rays of '{model}' are parallel: rays alone do not give its scale")
    at, directions = at[good], directions[good] / length[good, None]
    start = Camera("kannala_brandt", [*_guess_focal(at, directions), 0, 0, 0, 0], width, height)
    params = fit_lens(FitTarget(start, directions, at, 1.0, False), model)
    return Camera(model, params, width, height)


def _guess_focal(pixels: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Returns fx fy cx cy of the equidistant lens nearest to the rays about the axis."""
    angles = find_angles(rays)
    near = angles <= max(_NEAR_AXIS, float(np.sort(angles)[min(2 * _FEWEST, len(angles)) - 1]))
    across = np.hypot(rays[near, 0], rays[near, 1])
    scale = np.where(across > 0, angles[near] / np.maximum(across, 1e-12), 1.0)
    found = []
    for axis in (0, 1):
        rows = np.stack([scale * rays[near, axis], np.ones(np.count_nonzero(near))], axis=1)
        (focal, center), _, rank, _ = np.linalg.lstsq(rows, pixels[near, axis], rcond=None)
        if rank < 2 or not focal > 0:
            raise InputError("the rays do not spread over the image: x right, y down, z forward?")
        found.append((focal, center))
    return np.array([found[0][0], found[1][0], found[0][1], found[1][1]])
