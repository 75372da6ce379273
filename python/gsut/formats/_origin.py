"""Where a file's zero lies in the world: at the world's own, but for scenes too far from it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np

from gsut._core import InputError
from gsut.bounds import FARTHEST
from gsut.gaussians import Gaussians

# The comment that says where a PLY file's zero lies in the world; without it, at the world's zero.
_KEY = "gsut: dataset coordinates = these + "
_ORIGIN = re.compile(re.escape(_KEY) + r"(\S+) (\S+) (\S+)$")

# Files hold float32. Where it rounds world coordinates by more than this fraction of the scene's
# extent (a hundredth of a pixel), they are written about the Gaussians' origin.
ROUNDING = 1e-5


def prepare_for_file(gaussians: Gaussians) -> Gaussians:
    """Converts Gaussians to float32 about the zero that a file needs.

    Returns:
        In world coordinates (origin 0) where float32 rounds them by at most `ROUNDING` of the
        extent (median distance from the median), or where they have no origin; else as they are. A
        format keeps the `origin` of what it gets here, and its reader gives it back.
    """
    if not gaussians.origin.any() or len(gaussians) == 0:
        return gaussians.to_dtype(np.float32)
    middle = np.median(gaussians.means, axis=0)
    extent = np.median(np.linalg.norm(gaussians.means - middle, axis=1))
    rounding = np.spacing(np.float32(np.abs(gaussians.origin + middle).max())) / 2
    if rounding > ROUNDING * extent:
        return gaussians.to_dtype(np.float32)
    return gaussians.with_origin((0.0, 0.0, 0.0)).to_dtype(np.float32)


def name_origin(origin: np.ndarray) -> str:
    """Describes coordinates about `origin` in words."""
    values = ", ".join(f"{value:.10g}" for value in origin)
    return f"the dataset's coordinates less ({values}), as float32 cannot hold them there"


def format_origin(gaussians: Gaussians) -> list[str]:
    """Returns the comments that name the origin in a PLY file; none for the world's zero."""
    if not gaussians.origin.any():
        return []
    return [_KEY + " ".join(f"{value:.17g}" for value in gaussians.origin)]


def parse_origin(comments: Sequence[str], path: str | os.PathLike[str]) -> np.ndarray:
    """Parses the origin (3,) from a PLY file's comments; zero if none names it.

    Raises:
        InputError: the comment is damaged.
    """
    for comment in comments:
        if not comment.startswith(_KEY):
            continue
        found = _ORIGIN.match(comment)
        try:
            origin = np.array([float(word) for word in found.groups()] if found else [])
        except ValueError:
            origin = np.zeros(0)
        if len(origin) != 3 or not (np.abs(origin) <= FARTHEST).all():
            raise InputError(
                f'{os.fspath(path)}: the comment "{comment}" must end in three numbers: where the '
                "file's zero lies in the dataset's coordinates"
            )
        return origin
    return np.zeros(3)
