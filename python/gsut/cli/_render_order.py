"""The flag of `gsut render` that says in which order Gaussians are blended."""

from __future__ import annotations

import argparse

from gsut._core import InputError


def add_order(parser: argparse.ArgumentParser) -> None:
    """Adds --order."""
    parser.add_argument(
        "--order",
        choices=("distance", "z", "ray"),
        help="in which Gaussians are blended: by their means' distance from the camera or z, or "
        "as each pixel's own ray passes them, so that none jumps before another from image to "
        "image, which takes about 2.5 times as long to blend [default: as the scene was trained, "
        "or distance]",
    )


def check_order(arguments: argparse.Namespace, order: str | None) -> None:
    """Rejects what is not drawn in the order of the ray.

    Args:
        arguments: of `gsut render`.
        order: given, or the scene's.
    """
    if order != "ray":
        return
    kind = arguments.depth_kind
    for flag, is_given, instead in (
        ("--confidence", arguments.confidence, ""),
        ("--lifted", arguments.lifted is not None, ""),
        ("--cloud", bool(arguments.cloud), ""),
        (
            f"--depth-kind {kind}",
            arguments.depth is not None and kind not in ("mean", "sum"),
            ", or take --depth-kind mean",
        ),
    ):
        if is_given and arguments.order is None:
            raise InputError(
                f"{flag} is not drawn in this scene's order along the ray: give --order distance"
                f"{instead}"
            )
        if is_given:
            raise InputError(f"{flag} is not drawn by --order ray: leave one of them out{instead}")
