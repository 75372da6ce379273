"""Primitives and orders that a training may use, and what each cannot be combined with."""

from __future__ import annotations

from typing import Any

from gsut import _core
from gsut._core import InputError

OTHER_PRIMITIVES = tuple(name for name in _core.list_primitives() if name != "gaussian")
FLAT_PRIMITIVES = (
    "surfel",
    *(name for name, (_, is_flat) in _core.list_primitives().items() if is_flat),
)


def check_rule(options: Any) -> None:
    """Raises InputError for options that the order or a primitive that is no Gaussian rule out."""
    primitive = options.primitive
    for flag, given in (
        ("--order ray", options.order == "ray"),
        ("--response extinction", options.response == "extinction"),
        (f"--primitive {primitive}", primitive in OTHER_PRIMITIVES),
    ):
        if given and options.refine_poses:
            raise InputError(
                f"--refine-poses cannot be combined with {flag}, whose colours have no derivatives "
                "by the pose; refine first (gsut poses), or leave one of the two out"
            )
    if primitive not in OTHER_PRIMITIVES:
        return
    if options.surface:
        raise InputError(
            f"--surface cannot be combined with --primitive {primitive}, whose normals have no "
            "gradient; leave one of the two out"
        )
