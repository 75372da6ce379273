"""Explains why there is nothing to reconstruct."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data import some_names
from gsut.sfm.features import Features
from gsut.sfm.matching import PairMatches


def require_overlap(
    names: Sequence[str], features: Sequence[Features], pairs: Sequence[PairMatches]
) -> None:
    """Refuses images that nothing can be made of.

    Args:
        names, features: of all images. pairs: verified matches.

    Raises:
        SolveError: no overlap, images all the same, or a camera that only turned; says which.
    """
    if not pairs:
        few = [n for n, f in zip(names, features, strict=True) if len(f) < 50]
        if len(few) * 2 > len(names):
            raise SolveError(
                f"{len(few)} of {len(names)} images have almost no features"
                f" ({some_names(few)}); photograph something with texture, in focus and well lit"
            )
        raise SolveError(
            f"no two of the {len(names)} images have matches that agree; photographs must "
            "overlap by more than half, and the lens must be that of the images"
        )
    parallax = np.array([pair.parallax for pair in pairs])
    turned = np.array([pair.rotation_matches > 0.9 * len(pair.matches) for pair in pairs])
    if not turned.all():
        return
    if np.degrees(np.median(parallax)) < 0.02 or all(_same(pair) for pair in pairs):
        raise SolveError(
            "all images are the same: matched features do not move; give photographs from "
            "different places"
        )
    raise SolveError(
        f"in all {len(pairs)} overlapping pairs the camera only turned, so there is no depth; walk "
        "between the photographs instead of turning on the spot"
    )


def _same(pair: PairMatches) -> bool:
    """Whether neither turn nor shift is seen."""
    turn = np.arccos(np.clip((np.trace(pair.second_from_first[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.degrees(turn) < 0.05)
