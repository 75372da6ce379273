"""PLY files of Gaussians, in the layout of 3DGS."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import FARTHEST, name_wrong_kinds
from gsut.files import create_file, open_binary, register_reader
from gsut.formats._format import (
    ELSEWHERE,
    Format,
    SceneFile,
    WriteSettings,
    Written,
    keep_drawable,
)
from gsut.formats._origin import format_origin, parse_origin, prepare_for_file
from gsut.gaussians import (
    Gaussians,
    StoredGaussians,
    count_bytes_per_gaussian,
    press_surfels,
)
from gsut.run import check_fits, free_memory

# How Brush and Postshot say that a filter of the screen belongs to a file.
_SURFELS = "SplatRenderMode: 2dgs"
_ANTIALIASED = ("SplatRenderMode: mip", "antialiased 1")
# How gsut says that nothing stands behind the scene: what is open shows what is around it.
NO_BACKGROUND = "gsut: no background"
# Comments that name the response, the order and the primitive by which the Gaussians are drawn;
# without them the maximum, the distance, and Gaussians.
_KNOWN_RULES = {
    "response": Gaussians.RESPONSES,
    "order": Gaussians.ORDERS,
    "primitive": Gaussians.PRIMITIVES,
}
_RULE_KEYS = {kind: f"gsut: {kind} " for kind in _KNOWN_RULES}
_NO_HEADER = -1  # in place of the number of Gaussians: rows alone
_TEXT_BYTES = 4  # of a text file for one in memory, at most
_OF_FREE = 0.8  # share of the free memory that Gaussians may take by default
_DEGREES = {0: 0, 9: 1, 24: 2, 45: 3}  # of harmonics by the number of properties f_rest_*
PACKED = b"packed_position"  # a property of SuperSplat's compressed files


# Gaussians from which it is no chance that all of them have such values.
_FEWEST_JUDGED = 20
_MOST_LOGIT = 30.0  # beyond it opacities differ from 1 by less than float32 holds
_SMALL_LOG = 0.5  # of sizes: half of all within that factor of the smallest is no scene


@register_reader("PLY of Gaussians", ".ply")
def load_ply(path: str | os.PathLike[str]) -> Gaussians:
    """Reads Gaussians from a PLY file in the layout of 3DGS.

    Args:
        path: ascii or binary of either byte order; properties x y z, f_dc_0..2, f_rest_* (0, 9, 24
            or 45 of them, channel-major), opacity (logit), scale_0..2 (logarithm), rot_0..3 (w, x,
            y, z, any norm) in any order and numeric type. Others are ignored. Without scale_2 they
            are surfels (2DGS): Gaussians a ten-thousandth as thick as they are wide. A comment
            "gsut: dataset coordinates = these + X Y Z" is where the file's zero lies in the
            world; "gsut: response NAME", "gsut: order NAME" and "gsut: primitive NAME" are what
            they are drawn by, see `Gaussians`.

    Returns:
        float32 Gaussians in world coordinates, with the comment's `origin`, or one near the first
        Gaussian where text or float64 holds coordinates beyond 4096; the degree of the harmonics
        follows from the number of f_rest properties.
        Bits of float32 files are kept, but infinite opacity logits, which some writers use for
        opacities of exactly 0 and 1, become -20 and 20. Rows with other values that are not finite,
        or a rotation of norm 0, are left out; a warning gives their number and the first.

    Raises:
        InputError: the file cannot be opened, is no PLY file, misses a property (the message names
            it and what is there), its comment on the origin is damaged, it is truncated, or none of
            its rows can be drawn.
    """
    _check_size(path)
    *arrays, not_finite, origin = _core.read_ply(os.fsencode(path))
    comments = read_comments(path)
    rule: dict[str, Any] = {kind: _parse_rule(kind, comments, path) for kind in _RULE_KEYS}
    gaussians = Gaussians(*arrays, **rule)
    zero = parse_origin(comments, path) + origin
    if not (np.abs(zero) <= FARTHEST).all():
        raise InputError(f"{os.fspath(path)}: its first Gaussian lies at {zero}; rescale the scene")
    gaussians = gaussians.translate(zero)
    if not_finite or not gaussians.quats.any(axis=1).all():
        return keep_drawable(path, gaussians)
    _warn_of_rounding(path, gaussians)
    _warn_of_activated(path, gaussians)
    return gaussians


@register_reader("large PLY of Gaussians", ".ply")
def open_ply(
    path: str | os.PathLike[str], memory: int | None = None
) -> Gaussians | StoredGaussians:
    """Opens the Gaussians of a PLY file; those that do not fit into memory stay in the file.

    Args:
        path: see `load_ply`; of files that gsut did not write all are read.
        memory: bytes that they may take while they are drawn; None: four fifths of what is free.

    Raises:
        InputError: see `load_ply`.
    """
    free = free_memory()
    limit = memory or (None if free is None else int(_OF_FREE * free))
    found = None if limit is None else _find_plain_rows(Path(path))
    if limit is None or found is None:
        return load_ply(path)
    rows, count, sh_degree = found
    if count * (count_bytes_per_gaussian(sh_degree) + StoredGaussians.DRAWN_BYTES) <= limit:
        return load_ply(path)
    stored = StoredGaussians.from_rows(rows, count, limit)
    return load_ply(path) if stored is None else stored


def _find_plain_rows(path: Path) -> tuple[Callable[[int, int], Gaussians], int, int] | None:
    """Returns a reader of rows of a file of only float32, their number and degree. None for other
    files."""
    order, elements, comments, offset = _core.read_ply_header(os.fsencode(path))
    if any(comment.startswith(tuple(_RULE_KEYS.values())) for comment in comments):
        return None  # the bounds of pieces are those of the maximum of Gaussians by the distance
    name, count, properties = elements[0] if elements else ("", 0, [])
    is_plain = order == "<" and name == "vertex"
    if not is_plain or any(kind != ["f4", ""] for _, *kind in properties):
        return None
    columns = {name: number for number, (name, *_) in enumerate(properties)}
    rest = sum(name.startswith("f_rest_") for name in columns)
    names = [
        [*"xyz"], [f"rot_{i}" for i in range(4)],
        [f"scale_{i}" for i in range(3 if "scale_2" in columns else 2)], ["opacity"],
        [f"f_dc_{i}" for i in range(3)], [f"f_rest_{i}" for i in range(rest)],
    ]  # fmt: skip
    if rest not in _DEGREES or any(name not in columns for group in names for name in group):
        return None  # `load_ply` says what is wrong
    means, quats, scales, opacity, base, others = ([columns[n] for n in group] for group in names)
    origin = parse_origin(comments, path)

    def read_rows(begin: int, end: int) -> Gaussians:
        with open_binary(path) as file:
            file.seek(offset + 4 * begin * len(columns))
            data = file.read(4 * (end - begin) * len(columns))
        table = np.frombuffer(data, "<f4").reshape(end - begin, len(columns))
        harmonics = table[:, others].reshape(len(table), 3, rest // 3).transpose(0, 2, 1)
        sh = np.concatenate([table[:, None, base], harmonics], axis=1)
        sizes = np.zeros((len(table), 3), np.float32)
        sizes[:, : len(scales)] = table[:, scales]
        if len(scales) == 2:
            press_surfels(sizes)
        return Gaussians(table[:, means], table[:, quats], sizes, table[:, opacity[0]], sh, origin)

    return read_rows, count, _DEGREES[rest]


def _check_size(path: str | os.PathLike[str]) -> None:
    """Raises InputError if the memory that is free cannot hold the file's numbers."""
    is_text = not _core.read_ply_header(os.fsencode(path))[0]
    size = os.path.getsize(path) // (_TEXT_BYTES if is_text else 1)
    check_fits(f"reading {os.fspath(path)}", size, ELSEWHERE)


def _warn_of_rounding(path: str | os.PathLike[str], gaussians: Gaussians) -> None:
    """Warns if the file's float32 coordinates are coarser than its Gaussians are large."""
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


def _warn_of_activated(path: str | os.PathLike[str], gaussians: Gaussians) -> None:
    """Warns if a file seems to hold opacities or sizes where logits or logarithms belong.

    Logits of a trained scene have both signs. Logarithms have, too, unless all Gaussians are larger
    than a unit, and most then by far.
    """
    logits, scales = gaussians.opacity_logits, gaussians.log_scales
    if len(gaussians) < _FEWEST_JUDGED:
        return
    found = []
    most = logits.max()
    if 0 <= logits.min() < most and (most <= 1 or most > _MOST_LOGIT):
        found.append(f"all opacities lie in 0 to {1 if most <= 1 else 255}")
    if scales.min() > 0 and (found or np.median(scales) < _SMALL_LOG):
        found.append("all scales are above 0")
    if found:
        warnings.warn(
            f"{os.fspath(path)}: {' and '.join(found)}: does it hold opacities and sizes where a "
            "PLY of 3DGS has their logits and logarithms? Then export it again without activating "
            "them",
            stacklevel=3,
        )


@name_wrong_kinds
def save_ply(
    path: str | os.PathLike[str],
    gaussians: Gaussians,
    comments: Sequence[str] = (),
    *,
    surfels: bool | None = None,
) -> None:
    """Writes Gaussians as a PLY file in the layout of 3DGS (binary little endian, float32).

    Args:
        path: the file, written whole or not at all, see `gsut.files.whole_file`.
        gaussians: written in world coordinates, in float32. Where that would round them by more
            than 1e-5 of the scene's extent (UTM coordinates), about their `origin`, which
            a comment names and `load_ply` reads back.
        comments: lines of text for the header, none with a line break.
        surfels: in the layout of 2DGS, without scale_2; None: where all are surfels.

    Raises:
        InputError: the file cannot be written, or a comment holds a line break.
    """
    stored = prepare_for_file(gaussians)
    flat = stored.are_surfels if surfels is None else surfels
    named = [*comments, *format_origin(stored), *_format_rule(stored)]
    with create_file(path) as out:
        _core.write_ply(out.fileno(), stored, named, flat, len(stored))


def save_ply_parts(
    path: str | os.PathLike[str],
    parts: Iterable[Gaussians],
    count: int,
    sample: Gaussians,
    comments: Sequence[str] = (),
    surfels: bool = False,
) -> np.ndarray:
    """Saves Gaussians that come in parts, one of which is in memory at a time.

    Args:
        path, comments, surfels: see `save_ply`.
        parts: of the same degree of harmonics.
        count: of all.
        sample: of all, by which the file's zero is chosen.

    Returns:
        (3,) the origin that a comment names.
    """
    place = prepare_for_file(sample)
    named = [*comments, *format_origin(place), *_format_rule(place)]
    with create_file(path) as out:
        announced = count
        for part in parts:
            rows = part.with_origin(place.origin).to_dtype(np.float32)
            _core.write_ply(out.fileno(), rows, named, surfels, announced)
            announced = _NO_HEADER
    return place.origin


def read_comments(path: str | os.PathLike[str]) -> list[str]:
    """Reads the comments in a PLY file's header."""
    return _core.read_ply_header(os.fsencode(path))[2]


def _format_rule(gaussians: Gaussians) -> list[str]:
    """Returns the comments that name the rule; none for what everyone draws."""
    named = {kind: getattr(gaussians, kind) for kind in _RULE_KEYS}
    return [
        _RULE_KEYS[kind] + name for kind, name in named.items() if name != _KNOWN_RULES[kind][0]
    ]


def _parse_rule(kind: str, comments: Sequence[str], path: str | os.PathLike[str]) -> str:
    """Parses the response, the order or the primitive from a PLY file's comments.

    Raises:
        InputError: it is unknown.
    """
    for comment in comments:
        if not comment.startswith(_RULE_KEYS[kind]):
            continue
        name = comment.removeprefix(_RULE_KEYS[kind])
        if name not in _KNOWN_RULES[kind]:
            raise InputError(
                f'{os.fspath(path)}: the comment "{comment}" names an unknown {kind}; known: '
                f"{', '.join(_KNOWN_RULES[kind])}; a newer gsut may have written it"
            )
        return name
    return _KNOWN_RULES[kind][0]


def format_antialiased(antialiased: bool) -> str:
    """Formats the comment about filters; plain "default" keeps programs from adding one."""
    return f"SplatRenderMode: {'mip' if antialiased else 'default'}"


def is_antialiased(path: Path) -> bool:
    """Returns whether a PLY file's comments declare a screen filter."""
    return any(comment in _ANTIALIASED for comment in read_comments(path))


def _read(path: Path) -> SceneFile:
    return SceneFile(load_ply(path), is_antialiased(path), NO_BACKGROUND in read_comments(path))


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    mode = format_antialiased(settings.antialiased)
    if gaussians.are_surfels:
        mode = _SURFELS
    comments = ["written by gsut", mode]
    save_ply(path, gaussians, comments)
    return Written()


FORMAT = Format(
    "PLY",
    (".ply",),
    _write,
    _read,
    lambda head: head.startswith(b"ply") and PACKED not in head,
    keeps_origin=True,
    keeps_rule=True,
    keeps_primitive=True,
    keeps_surfels=True,
)
