"""Files of Gaussian scenes in and out, one module a format.

A format is a module with a `FORMAT`; the files whose names begin with "_" are none.
`load_gaussians` and `save_gaussians` choose by the name's suffix and, reading, the first bytes.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import os
import pkgutil
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.files import open_binary
from gsut.formats._errors import measure_errors
from gsut.formats._format import (
    Format,
    SceneFile,
    WriteSettings,
    Written,
    check_room,
    find_drawable,
    keep_drawable,
    list_losses,
)
from gsut.formats._origin import name_origin, prepare_for_file
from gsut.formats._streamed import TABLE, read_levels, write_levels
from gsut.formats.ply import NO_BACKGROUND, load_ply, open_ply, save_ply, save_ply_parts
from gsut.gaussians import Gaussians

__all__ = [
    "NO_BACKGROUND",
    "TABLE",
    "WriteSettings",
    "check_room",
    "choose_format",
    "load_gaussians",
    "load_ply",
    "measure_errors",
    "name_origin",
    "open_ply",
    "prepare_for_file",
    "read_scene_file",
    "save_gaussians",
    "save_ply",
    "save_ply_parts",
    "write_levels",
]
_SNIFFED_BYTES = 4096
# Suffixes of other programs' checkpoints. No format: they hold code, or not how they are drawn.
_CHECKPOINTS = (".pt", ".pth", ".ckpt", ".ingp")


@functools.cache
def list_formats() -> tuple[Format, ...]:
    """Lists all formats by name."""
    names = [module.name for module in pkgutil.iter_modules(__path__)]
    modules = [
        importlib.import_module(f"{__name__}.{name}")
        for name in sorted(names)
        if not name.startswith("_")
    ]
    return tuple(module.FORMAT for module in modules)


def choose_format(path: str | os.PathLike[str]) -> Format:
    """Chooses the format in which a file of this name is written.

    Raises:
        InputError: no format has this suffix; the message lists those that there are.
    """
    return _match_formats(Path(path), "write")[0]


def _match_formats(path: Path, verb: str) -> list[Format]:
    """Finds the formats with a suffix of this name; the longest first, then the suffix's owner."""
    name = path.name.lower()
    fitting = [
        (-len(suffix), place, each)
        for each in list_formats()
        for place, suffix in enumerate(each.suffixes)
        if name.endswith(suffix)
    ]
    if not fitting and verb == "read" and name.endswith(_CHECKPOINTS):
        raise InputError(
            f"{path}: gsut reads no checkpoints of other programs; export a PLY file there. A "
            "model of 3DGRT or 3DGRUT can be drawn if particle_kernel_degree was 2; no primitive "
            f"here is a kernel of another degree (known: {', '.join(Gaussians.PRIMITIVES)})"
        )
    if not fitting:
        known = [suffix for each in list_formats() for suffix in each.suffixes[:1]]
        raise InputError(
            f"{path}: no format to {verb} has this suffix; known: {', '.join(sorted(known))}"
        )
    return [each for *_, each in sorted(fitting, key=lambda found: found[:2])]


@name_wrong_kinds
def load_gaussians(path: str | os.PathLike[str]) -> Gaussians:
    """Reads Gaussians from a file of any of the formats.

    Args:
        path: the file, .ply, .spz, .sog, .glb, .splat, .usd...; its suffix and its first bytes say
            the format. Of a folder of streamed SOG the finest level is read.

    Returns:
        float32 Gaussians in the file's coordinates. Those with values that are not finite, or with
        a rotation of norm 0, are left out, and a warning says how many.

    Raises:
        InputError: the file cannot be opened, is of no known format, is truncated or damaged, or
            holds no Gaussians that can be drawn.
    """
    return read_scene_file(path).gaussians


def read_scene_file(path: str | os.PathLike[str]) -> SceneFile:
    """Reads Gaussians as `load_gaussians` does, with the file's other statements."""
    path = Path(path)
    if path.is_dir() and (path / TABLE).is_file():
        path /= TABLE
    if path.name == TABLE:
        found = read_levels(path)
        return dataclasses.replace(found, gaussians=keep_drawable(path, found.gaussians))
    candidates = _match_formats(path, "read")
    with open_binary(path) as file:
        head = file.read(_SNIFFED_BYTES)
    readers = [each.read for each in candidates if each.read is not None and each.holds(head)]
    if not readers:
        names = " or ".join(each.name for each in candidates)
        why = "does not look like one" if any(f.read for f in candidates) else "gsut only writes it"
        raise InputError(f"{path}: by its name {names}, but {why if head else 'it is empty'}")
    found = readers[0](path)
    if not len(found.gaussians):
        raise InputError(f"{path}: none of its 0 Gaussians can be drawn")
    return dataclasses.replace(found, gaussians=keep_drawable(path, found.gaussians))


@name_wrong_kinds
def save_gaussians(
    path: str | os.PathLike[str],
    gaussians: Gaussians,
    settings: WriteSettings | None = None,
) -> Written:
    """Writes Gaussians in the format that the name's suffix says.

    Args:
        path: the file, written whole or not at all; what was there before is replaced.
        gaussians: written in world coordinates, in float32 (see `prepare_for_file`). Those that
            cannot be drawn (see `find_drawable`) are left out; only PLY keeps every row.
        settings: where a format leaves a choice.

    Returns:
        Which rows were written, in which order, and what the format could not hold.

    Raises:
        InputError: no format has this suffix, a library is missing, there is nothing to write, or
            the file cannot be written.
    """
    path = Path(path)
    chosen = choose_format(path)
    g = prepare_for_file(gaussians)
    good = find_drawable(g)
    if not good.any():
        raise InputError(f"{path}: there is no Gaussian to write")
    kept = np.flatnonzero(good)
    settings = settings or WriteSettings()
    held = g if chosen.keeps_primitive else g.to_primitive(Gaussians.PRIMITIVES[0])
    written = chosen.write(path, held if good.all() else held[good], settings)
    rows = kept if written.rows is None else kept[written.rows]
    left_out = written.left_out + list_losses(g, chosen)
    return Written(rows, {k: v for k, v in written.clipped.items() if v}, left_out)
