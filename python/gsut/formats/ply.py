"""PLY files of Gaussians, in the layout of 3DGS."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut import _core
from gsut.files import regular
from gsut.formats._format import ELSEWHERE, Format, SceneFile, WriteSettings, Written
from gsut.formats._origin import for_file, origin_comments, origin_in
from gsut.gaussians import Gaussians, are_surfels
from gsut.run import check_fits

# How Brush and Postshot say that a filter of the screen belongs to a file.
_ANTIALIASED = ("SplatRenderMode: mip", "antialiased 1")
# How gsut says that nothing stands behind the scene: what is open shows what is around it.
NO_BACKGROUND = "gsut: no background"
_HEADER_BYTES = 65536  # read for comments
_TEXT_BYTES = 4  # of a text file for one in memory, at most
PACKED = b"packed_position"  # a property of SuperSplat's compressed files


def load_ply(path: str | os.PathLike[str]) -> Gaussians:
    """Reads Gaussians from a PLY file in the layout of 3DGS.

    Args:
        path: ascii or binary of either byte order; properties x y z, f_dc_0..2, f_rest_* (0, 9, 24
            or 45 of them, channel-major), opacity (logit), scale_0..2 (logarithm), rot_0..3 (w, x,
            y, z, any norm) in any order and numeric type. Others are ignored. Without scale_2 they
            are surfels (2DGS): Gaussians a ten-thousandth as thick as they are wide. A comment
            "gsut: dataset coordinates = these + X Y Z" is where the file's zero lies in the
            world.

    Returns:
        float32 Gaussians in world coordinates, with the comment's `origin`, or one near the first
        Gaussian where text or float64 holds coordinates beyond 4096; the degree of the harmonics
        follows from the number of f_rest properties.
        Bits of float32 files are kept, but infinite opacity logits, which some writers use for
        opacities of exactly 0 and 1, become -20 and 20. Rows with other values that are not finite
        are left out, and a warning says how many.

    Raises:
        InputError: the file cannot be opened, is no PLY file, misses a property (the message names
            it and what is there), its comment on the origin is damaged, or it is truncated.
    """
    _check_size(path)
    *arrays, not_finite, origin = _core.read_ply(os.fsencode(path))
    gaussians = Gaussians(*arrays).translated(origin_in(comments_of(path), path)).translated(origin)
    if not_finite == 0:
        _warn_of_rounding(path, gaussians)
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


def _check_size(path: str | os.PathLike[str]) -> None:
    """Raises InputError if the memory that is free cannot hold the file's numbers."""
    try:
        with open(regular(path), "rb") as file:
            is_text = b"\nformat ascii" in file.read(_HEADER_BYTES)
    except OSError:
        return  # told by the reader
    size = os.path.getsize(path) // (_TEXT_BYTES if is_text else 1)
    check_fits(f"reading {os.fspath(path)}", size, ELSEWHERE)


def _warn_of_rounding(path: str | os.PathLike[str], gaussians: Gaussians) -> None:
    """Where the file's own float32 could not tell places apart that its Gaussians do."""
    if not len(gaussians):
        return
    step = np.spacing(np.median(np.abs(gaussians.means), axis=0).max())
    size = np.exp(np.median(gaussians.log_scales))
    if step > size:
        warnings.warn(
            f"{os.fspath(path)}: its float32 coordinates lie {step:g} apart, its Gaussians are "
            f"{size:.2g} large: the scene was rounded by whoever wrote it so far from zero",
            stacklevel=3,
        )


def save_ply(
    path: str | os.PathLike[str],
    gaussians: Gaussians,
    comments: Sequence[str] = (),
    *,
    surfels: bool | None = None,
) -> None:
    """Writes Gaussians as a PLY file in the layout of 3DGS (binary little endian, float32).

    Args:
        path: the file; written as PATH.partial first and then renamed, so it is never half a file.
        gaussians: written in world coordinates, in float32. Where that would round them by more
            than 1e-5 of the scene's extent (UTM coordinates), about their `origin`, which
            a comment names and `load_ply` reads back.
        comments: lines of text for the header, none with a line break.
        surfels: in the layout of 2DGS, without scale_2; None: where all are surfels.

    Raises:
        InputError: the file cannot be written, or a comment holds a line break.
    """
    stored = for_file(gaussians)
    flat = are_surfels(stored) if surfels is None else surfels
    _core.write_ply(os.fsencode(path), stored, [*comments, *origin_comments(stored)], flat)


def comments_of(path: str | os.PathLike[str]) -> list[str]:
    """The comments in a PLY file's header."""
    with open(path, "rb") as file:
        head = file.read(_HEADER_BYTES).split(b"end_header", 1)[0]
    lines = head.decode("utf-8", "replace").splitlines()
    return [line.removeprefix("comment").strip() for line in lines if line.startswith("comment ")]


def antialiased_comment(antialiased: bool) -> str:
    """What a header says about filters; plain "default" keeps programs from adding one."""
    return f"SplatRenderMode: {'mip' if antialiased else 'default'}"


def is_antialiased(path: Path) -> bool:
    """Whether a PLY file's comments say so."""
    return any(comment in _ANTIALIASED for comment in comments_of(path))


def _read(path: Path) -> SceneFile:
    return SceneFile(load_ply(path), is_antialiased(path), NO_BACKGROUND in comments_of(path))


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    comments = ["written by gsut", antialiased_comment(settings.antialiased)]
    save_ply(path, gaussians, comments, surfels=False if settings.three_scales else None)
    return Written()


FORMAT = Format(
    "PLY",
    (".ply",),
    _write,
    _read,
    lambda head: head.startswith(b"ply") and PACKED not in head,
    keeps_origin=True,
    keeps_surfels=True,
)
