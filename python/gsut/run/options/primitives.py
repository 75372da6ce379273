"""Primitives and orders that a training may use, and what each cannot be combined with."""

from __future__ import annotations

from typing import Any

from gsut import _core
from gsut._core import InputError

OTHER_PRIMITIVES = tuple(name for name in _core.list_primitives() if name != "gaussian")
FLAT_PRIMITIVES = (
    "surfel",
    *(name for name, (_, _, is_flat) in _core.list_primitives().items() if is_flat),
)


def check_rule(options: Any) -> None:
    """Raises InputError for options that the order or a primitive that is no Gaussian rule out."""
    primitive = options.primitive
    if options.order == "ray" and options.refine_poses:
        raise InputError(
            "--refine-poses cannot be combined with --order ray, along which colours have no "
            "derivatives by the pose; refine first (gsut poses), or leave one of the two out"
        )
    if primitive not in OTHER_PRIMITIVES:
        return
    has_shape, *_ = _core.list_primitives()[primitive]
    if options.surface and has_shape:
        raise InputError(
            f"--surface cannot be combined with --primitive {primitive}: normals have no gradient "
            "to its shapes; leave one of the two out"
        )
