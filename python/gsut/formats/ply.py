"""PLY files of Gaussians, in the layout of 3DGS."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.formats.origin import for_file
from gsut.gaussians import Gaussians

# The comment that says where a file's zero lies in the world; without it, at the world's zero.
ORIGIN_KEY = "gsut: dataset coordinates = these + "
_ORIGIN = re.compile(re.escape(ORIGIN_KEY) + r"(\S+) (\S+) (\S+)$")


def load_ply(path: str | os.PathLike[str]) -> Gaussians:
    """Reads Gaussians from a PLY file in the layout of 3DGS.

    Args:
        path: ascii or binary of either byte order; properties x y z, f_dc_0..2, f_rest_* (0, 9, 24
            or 45 of them, channel-major), opacity (logit), scale_0..2 (logarithm), rot_0..3 (w, x,
            y, z, any norm) in any order and numeric type. Others are ignored. A comment "gsut:
            dataset coordinates = these + X Y Z" is where the file's zero lies in the world.

    Returns:
        float32 Gaussians in world coordinates, with the comment's `origin`; the degree of the
        harmonics follows from the number of f_rest properties.
        Bits of float32 files are kept, but infinite opacity logits, which some writers use for
        opacities of exactly 0 and 1, become -20 and 20. Rows with other values that are not finite
        are left out, and a warning says how many.

    Raises:
        InputError: the file cannot be opened, is no PLY file, misses a property (the message names
            it and what is there), its comment on the origin is damaged, or it is truncated.
    """
    *arrays, not_finite, comments = _core.read_ply(os.fspath(path))
    gaussians = Gaussians(*arrays).translated(_origin_of(comments, path))
    if not_finite == 0:
        return gaussians
    warnings.warn(
        f"{os.fspath(path)}: {not_finite} of {len(gaussians)} Gaussians have values that are not "
        "finite and were left out",
        stacklevel=2,
    )
    finite = np.ones(len(gaussians), dtype=bool)
    for array in arrays:
        finite &= np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    return gaussians[finite]


def save_ply(
    path: str | os.PathLike[str], gaussians: Gaussians, comments: Sequence[str] = ()
) -> None:
    """Writes Gaussians as a PLY file in the layout of 3DGS (binary little endian, float32).

    Args:
        path: the file; written as PATH.partial first and then renamed, so it is never half a file.
        gaussians: written in world coordinates, in float32. Where that would round them by more
            than 1e-5 of the scene's extent (UTM coordinates), about their `origin`, which
            a comment names and `load_ply` reads back.
        comments: lines of text for the header, none with a line break.

    Raises:
        InputError: the file cannot be written, or a comment holds a line break.
    """
    stored = for_file(gaussians)
    if stored.origin.any():
        origin = " ".join(f"{value:.17g}" for value in stored.origin)
        comments = (*comments, ORIGIN_KEY + origin)
    _core.write_ply(os.fspath(path), stored, list(comments))


def _origin_of(comments: Sequence[str], path: str | os.PathLike[str]) -> np.ndarray:
    for comment in comments:
        if comment.startswith(ORIGIN_KEY):
            found = _ORIGIN.match(comment)
            try:
                origin = np.array([float(word) for word in found.groups()] if found else [])
            except ValueError:
                origin = np.zeros(0)
            if len(origin) != 3 or not np.isfinite(origin).all():
                raise InputError(
                    f'{os.fspath(path)}: the comment "{comment}" must end in three numbers: where '
                    "the file's zero lies in the dataset's coordinates"
                )
            return origin
    return np.zeros(3)
