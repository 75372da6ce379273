"""Finds numbers of a stated lens that no real camera has."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gsut import _core
from gsut._core import InputError

MOST_STRETCH = 4.0  # of a focal length, or a pixel, over the other; anamorphic lenses have 2
_FOCAL_RANGE = (1e-3, 1e4)  # focal length over the image's longer side
_NARROWEST = 1e-4  # radians between the farthest rays: a telescope's field is ten times that
_GRID = 9  # pixels along each side whose rays are compared
_MOST_TRIED = 64  # parameters that may be to blame; the tables of splines have thousands
_OF_ANY_LENS = ("fx", "fy", "cx", "cy")


def find_fault(camera: _core.Camera) -> str | None:
    """Finds what no real camera has: odd focal lengths, or pixels without rays that differ.

    Returns:
        A clause that begins with a parameter's name if one is to blame; None for a possible lens.
    """
    doubt = _judge_focal_lengths(camera)
    if doubt is not None:
        return doubt
    doubt = _judge_rays(camera)
    if doubt is None:
        return None
    for name, value, other in _without_one(camera):
        if _judge_rays(other) is None:
            return f"{name} is {value:g}; with it {doubt}"
    return f"{doubt}; its coefficients are not of this model, or in another order"


def name_params(model: str, count: int) -> list[str]:
    """Names each parameter of a lens: the core's name, or "parameter 9" where it has none."""
    names = _core.camera_param_names(model).replace("...", "").split()
    return [names[i] if i < len(names) else f"parameter {i}" for i in range(count)]


def _judge_focal_lengths(camera: _core.Camera) -> str | None:
    names = _core.camera_param_names(camera.model).split()
    if not {"fx", "fy"} <= set(names):
        return None
    fx, fy = (camera.params[names.index(name)] for name in ("fx", "fy"))
    stretch = max(fx / fy, fy / fx)
    if stretch > MOST_STRETCH:
        return (
            f"fx is {fx:g} and fy is {fy:g}; they differ by a factor of {stretch:.1f}, and real "
            "lenses have nearly equal ones"
        )
    size = max(camera.width, camera.height)
    if not (camera.is_parallel or _FOCAL_RANGE[0] <= fx / size <= _FOCAL_RANGE[1]):
        return (
            f"fx is {fx:g} pixels; it does not go with an image {camera.width} x {camera.height} "
            "(is it in millimetres, or a share of the width?)"
        )
    return None


def _judge_rays(camera: _core.Camera) -> str | None:
    sides = (np.linspace(0.5, side - 0.5, _GRID) for side in (camera.width, camera.height))
    x, y = np.meshgrid(*sides)
    rays, valid = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))[:2]
    alone = max(camera.width, camera.height) == 1
    if not valid.any() or (np.count_nonzero(valid) == 1 and not alone):  # that on the axis has one
        return "no pixel has a ray"
    if camera.is_parallel or alone:
        return None
    rays = rays[valid]
    if np.linalg.norm(rays - rays[0], axis=1).max() < _NARROWEST:
        return "all pixels look in one direction"
    return None


def _without_one(camera: _core.Camera) -> Iterator[tuple[str, float, _core.Camera]]:
    """Yields the lens without its limit, then with one of its parameters at 0, coefficients first.

    Each comes with the name and the value of what was left out.
    """
    size, limit = (camera.width, camera.height), camera.valid_field_angle
    params = camera.params.tolist()
    if limit is not None:
        yield "valid_field_angle", limit, _core.Camera(camera.model, params, *size)
    for index, name in sorted(
        enumerate(name_params(camera.model, len(params))[:_MOST_TRIED]),
        key=lambda each: each[1] in _OF_ANY_LENS,
    ):
        changed = [*params[:index], 0.0, *params[index + 1 :]]
        try:
            yield name, params[index], _core.Camera(camera.model, changed, *size)
        except InputError:  # it cannot be left out
            continue
