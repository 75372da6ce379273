"""Primitives that a training may use, and what each cannot be combined with."""

from __future__ import annotations

from gsut import _core
from gsut._core import InputError

OTHER_PRIMITIVES = tuple(name for name in _core.list_primitives() if name != "gaussian")
FLAT_PRIMITIVES = (
    "surfel",
    *(name for name, (_, _, is_flat) in _core.list_primitives().items() if is_flat),
)


def check_primitive(primitive: str, surface: bool, compact_at: int | None) -> None:
    """Raises InputError for options that a primitive which is no Gaussian cannot follow."""
    if primitive not in OTHER_PRIMITIVES:
        return
    has_shape, *_ = _core.list_primitives()[primitive]
    for flag, given, why in (
        ("--surface", surface and has_shape, "normals have no gradient to its shapes"),
        ("compact_at", compact_at is not None, "it merges what must be Gaussians"),
    ):
        if given:
            raise InputError(
                f"{flag} cannot be combined with --primitive {primitive}: {why}; leave one of the "
                "two out"
            )
