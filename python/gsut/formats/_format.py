"""What a format of scene files is: how it is recognised, read and written."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.formats._origin import name_origin
from gsut.gaussians import Gaussians, count_bytes_per_gaussian
from gsut.run import check_fits

# A file may claim this many Gaussians whatever its size; more only at a byte each or more. The
# densest real files hold one in eight bytes, so this stops only bombs.
_FREE_CLAIM = 65536
_LEAST_BYTES = 56  # of a Gaussian without harmonics, in memory
ELSEWHERE = "read it on a machine that has more, or make it smaller there (gsut compact)"


@dataclasses.dataclass(frozen=True)
class SceneFile:
    """What a scene file holds.

    Attributes:
        gaussians: float32, in the file's coordinates (the dataset's, if gsut wrote it).
        antialiased: the file says that a filter of the screen belongs to it (Mip-Splatting): views
            widen small Gaussians and lower their opacity in turn.
        no_background: it says that nothing stands behind the scene: what is open takes the colour
            of what is around.
    """

    gaussians: Gaussians
    antialiased: bool = False
    no_background: bool = False


@dataclasses.dataclass(frozen=True)
class WriteSettings:
    """How to write, where a format leaves a choice.

    Attributes:
        antialiased: see `SceneFile`; kept where the format has a place for it.
        spz_version: 3, which every reader of SPZ knows, or 4.
    """

    antialiased: bool = False
    spz_version: int = 3


@dataclasses.dataclass(frozen=True)
class Written:
    """What became of the Gaussians in a file.

    Attributes:
        rows: (M,) the rows of the Gaussians that were written, in the file's order; None: all, in
            theirs.
        clipped: name of a quantity -> how many of its values lay beyond what the format holds and
            were brought to its edge.
        left_out: sentences about what the format has no place for.
    """

    rows: np.ndarray | None = None
    clipped: dict[str, int] = dataclasses.field(default_factory=dict)
    left_out: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Format:
    """A format of scene files; a module of this folder has one as its `FORMAT`.

    Attributes:
        name: for people.
        suffixes: ends of file names, lower case; a longer one wins over a shorter one, and files
            are written by the format that has the suffix first in its own list.
        write: (path, float32 Gaussians that can be drawn, settings) -> Written; the path ends in
            one of the suffixes and becomes the file only once it is whole.
        read: path -> SceneFile; None: gsut only writes this format.
        holds: whether a file that begins with these bytes may be of this format; of formats with
            one suffix, the one that says yes reads.
        keeps_origin: the file says where its zero lies in the world, and `read` gives it back as
            `Gaussians.origin`; without it the zero of a scene far from the world's is lost.
        keeps_surfels: it has a layout of surfels.
        keeps_rule: the file says by which response and in which order it is drawn, see `Gaussians`.
        keeps_primitive: the file says which primitives it holds.
    """

    name: str
    suffixes: tuple[str, ...]
    write: Callable[[Path, Gaussians, WriteSettings], Written]
    read: Callable[[Path], SceneFile] | None
    holds: Callable[[bytes], bool]
    keeps_origin: bool = False
    keeps_surfels: bool = False
    keeps_rule: bool = False
    keeps_primitive: bool = False


def check_room(what: str, scenes: Sequence[Gaussians], times: float, more: int = 0) -> None:
    """Raises InputError if work on Gaussians does not fit into free memory, before it starts.

    Args:
        what: the work, for the message.
        scenes: which are in memory.
        times: what the work takes at most beside them, of their numbers; measured.
        more: bytes that it takes for each.
    """
    count, degree = sum(map(len, scenes)), max(g.sh_degree for g in scenes)
    size = (times * count_bytes_per_gaussian(degree) + more) * count
    check_fits(f"{what} {count:,} Gaussians of degree {degree}", size, ELSEWHERE)


def find_drawable(gaussians: Gaussians) -> np.ndarray:
    """Finds rows (N,) whose values are finite and whose rotation has a direction."""
    g = gaussians
    finite = np.isfinite(g.opacity_logits)
    for array in (g.means, g.quats, g.log_scales, g.sh):
        finite &= np.isfinite(array).reshape(len(g), array[:1].size).all(axis=1)
    return finite & (np.abs(g.quats).max(axis=1, initial=0.0) > 0)


def keep_drawable(path: str | os.PathLike[str], gaussians: Gaussians) -> Gaussians:
    """Leaves out Gaussians that cannot be drawn and warns with the file, their number and first
    row. Every reader applies this rule.

    Raises:
        InputError: there are Gaussians, and none of them can be drawn.
    """
    good = find_drawable(gaussians)
    if good.all():
        return gaussians
    first = int(np.argmin(good))
    row = gaussians[first : first + 1]
    turned = np.isfinite(row.quats).all() and not row.quats.any()
    why = "a rotation of norm 0" if turned else "values that are not finite"
    if not good.any():
        raise InputError(
            f"{os.fspath(path)}: none of its {len(good)} Gaussians can be drawn: row 0 has {why}"
        )
    warnings.warn(
        f"{os.fspath(path)}: {np.count_nonzero(~good)} of {len(good)} Gaussians have {why} and "
        f"were left out; the first is row {first}",
        stacklevel=3,
    )
    return gaussians[good]


def check_claim(path: Path, count: int, size: int) -> None:
    """Raises InputError if `count` Gaussians cannot be in `size` bytes or in free memory. This
    comes before any memory is allocated."""
    if not 0 <= count <= max(size, _FREE_CLAIM):
        raise InputError(
            f"{path}: claims {count:,} Gaussians in {size:,} bytes, which cannot be; the file is "
            "damaged"
        )
    check_fits(f"reading {count:,} Gaussians of {path}", _LEAST_BYTES * count, ELSEWHERE)


def list_losses(g: Gaussians, chosen: Format) -> tuple[str, ...]:
    """Lists in sentences what a format has no place for.

    Args:
        g: as they are prepared for the file.
        chosen: the format.
    """
    left_out: tuple[str, ...] = ()
    if g.are_surfels and not chosen.keeps_surfels:
        left_out += ("surfels: the file holds Gaussians a ten-thousandth as thick as wide",)
    if g.origin.any() and not chosen.keeps_origin:
        left_out += (f"where the scene lies: the file holds {name_origin(g.origin)}",)
    if g.response != Gaussians.RESPONSES[0] and not chosen.keeps_rule:
        left_out += (
            f"the response {g.response}: the file is drawn by the maximum, which is another "
            "picture (gsut convert --for viewers brings it closer)",
        )
    if g.order != Gaussians.ORDERS[0] and not chosen.keeps_rule:
        left_out += (
            f"the order {g.order}: gsut draws the file by the distance, other viewers by z (gsut "
            "convert --for viewers brings it closer)",
        )
    if g.primitive != Gaussians.PRIMITIVES[0] and not chosen.keeps_primitive:
        left_out += (
            f"the primitive {g.primitive}: the file holds Gaussians of the same width, which are "
            "another picture (gsut convert --for viewers brings it closer)",
        )
    return left_out
