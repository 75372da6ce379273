"""Reads and writes arrays of numbers: .npy, and .npz with several; never Python objects."""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from collections.abc import Collection, Mapping
from typing import IO, Any

import numpy as np

from gsut.files.archives import Archive, open_archive
from gsut.files.errors import Fails, FileError
from gsut.files.opening import PathLike, open_binary
from gsut.files.writing import create_file

_NPY = b"\x93NUMPY"
_ZIP = b"PK"
_PIECE = 1 << 24  # bytes read at a time
_KINDS = "biufU"  # of numpy's dtypes that files may hold: numbers and text
_WORDS = {"f": "numbers", "i": "whole numbers", "b": "true or false", "U": "text"}
_ACCEPTED = {"f": "biuf", "i": "biuf", "b": "b", "U": "U"}
_EXPORT = "copy or write it again"


@dataclasses.dataclass(frozen=True)
class Array:
    """What an array of a file must be.

    Attributes:
        kind: "f" finite numbers, "i" whole numbers, "b" true or false, "U" text.
        shape: length of each axis: a number, a letter that stands for the same number in all
            arrays of a file, or None for any; as a whole None: any.
        least, most: bounds of the numbers.
        finite: False: NaN and infinities may be among the numbers.
    """

    kind: str = "f"
    shape: tuple[int | str | None, ...] | None = None
    least: float = -math.inf
    most: float = math.inf
    finite: bool = True


def read_npy(path: PathLike, array: Array | None = None) -> np.ndarray:
    """Reads a .npy file.

    Args:
        path: the file.
        array: what it must be, where whole numbers come as int64; None: any numbers.

    Raises:
        FileError: not such a file, cut off, complex numbers or objects, or not what `array` says.
    """
    with open_binary(path) as file:
        size = os.fstat(file.fileno()).st_size
        found = _read_array(file, size, path)
        if array is not None:
            return _check_array(found, array, path, {})
        if found.dtype.kind == "U":
            raise FileError(path, "holds text, not numbers", _EXPORT)
        return found


def read_npz(
    path: PathLike,
    fields: Mapping[str, Array] | Collection[str] | None = None,
    *,
    fails: Fails = FileError,
) -> dict[str, np.ndarray]:
    """Reads arrays of a .npz file.

    Args:
        path: the file.
        fields: name -> what the array must be, where a name ending in "?" may be absent; or names
            alone, of which absent ones are left out; None: all arrays.
        fails: makes the error.

    Raises:
        FileError: see `open_archive` and `read_npy`.
    """
    with open_binary(path, fails=fails) as file:
        if file.read(len(_NPY)) == _NPY:
            raise FileError(path, "is one array (.npy), not several (.npz)", _EXPORT)
    with open_archive(path, fails=fails) as archive:
        held = {name.removesuffix(".npy"): name for name in archive.names}
        wanted = list(held) if fields is None else [name.rstrip("?") for name in fields]
        if isinstance(fields, Mapping):
            for name in fields:
                if name not in held and not name.endswith("?"):
                    names = ", ".join(list(held)[:8]) or "nothing"
                    raise FileError(path, f"lacks the array {name!r}; it holds {names}", _EXPORT)
        found = {
            name: _read_member(archive, held[name], f"{path}, {name}")
            for name in wanted
            if name in held
        }
        if isinstance(fields, Mapping):
            lengths: dict[str, int] = {}
            for name, array in fields.items():
                key = name.rstrip("?")
                if key in found:
                    found[key] = _check_array(found[key], array, f"{path}, {key}", lengths)
        return found


def _read_member(archive: Archive, name: str, where: object) -> np.ndarray:
    with archive.open(name) as file:
        found = _read_array(file, archive.find_size(name), where)
        file.read(1)  # at its end the checksum is compared
    return found


def _read_array(file: IO[bytes], size: int, where: object) -> np.ndarray:
    """Reads an array, once its header agrees with the bytes that there are.

    Args:
        file: at the array's start.
        size: bytes from there to the end.
        where: for errors.
    """
    start = file.read(len(_NPY))
    if start != _NPY:
        what = "is empty" if not start else "is not an array of numpy (.npy)"
        what = "holds several arrays (.npz), not one (.npy)" if start.startswith(_ZIP) else what
        raise FileError(where, what, _EXPORT)
    version = tuple(file.read(2))
    headers = {(1, 0): np.lib.format.read_array_header_1_0,
               (2, 0): np.lib.format.read_array_header_2_0}  # fmt: skip
    if version not in headers:
        raise FileError(where, f"is of version {version} of numpy's format", _EXPORT)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers that Python 2 wrote
        shape, in_columns, dtype = headers[version](file)
    if dtype.kind not in _KINDS or dtype.itemsize == 0:
        what = "Python objects, which are never loaded" if dtype.hasobject else f"{dtype}"
        raise FileError(where, f"holds {what}, not real numbers", _EXPORT)
    count, left = math.prod(shape), size - file.tell()
    if min(shape, default=0) < 0 or count * dtype.itemsize > left:
        raise FileError(
            where, f"claims an array of shape {shape}, {count * dtype.itemsize:,} bytes, and holds "
            f"{left:,}", _EXPORT,
        )  # fmt: skip
    found = np.empty(count, dtype)
    rest = memoryview(found.view(np.uint8).data) if count else memoryview(b"")
    while rest:
        number = file.readinto(rest[:_PIECE])  # type: ignore[attr-defined]  # of binary files
        if not number:
            raise FileError(where, "is cut off", _EXPORT)
        rest = rest[number:]
    found = found.reshape(shape[::-1]).T if in_columns else found.reshape(shape)
    return found.astype(dtype.newbyteorder("="), copy=False)


def _check_array(
    found: np.ndarray, array: Array, where: object, lengths: dict[str, int]
) -> np.ndarray:
    """Returns the array as its kind if it is what it must be.

    Args:
        found, array: the array, and what it must be.
        where: for errors.
        lengths: letter -> length, of the arrays before; the letters of this one are added.
    """
    if found.dtype.kind not in _ACCEPTED[array.kind]:
        raise FileError(where, f"holds {found.dtype}, not {_WORDS[array.kind]}", _EXPORT)
    if array.shape is not None:
        fits = len(array.shape) == found.ndim
        for axis, size in zip(array.shape, found.shape, strict=False):
            wanted = lengths.setdefault(axis, size) if isinstance(axis, str) else axis
            fits &= wanted in (None, size)
        if not fits:
            said = ", ".join(
                str(lengths.get(axis, axis) if isinstance(axis, str) else axis or "any")
                for axis in array.shape
            )
            raise FileError(where, f"has shape {found.shape}, expected ({said})", _EXPORT)
    if array.kind in ("b", "U") or found.size == 0:
        return found.astype(np.int64) if array.kind == "i" else found
    least, most = found.min(), found.max()  # NaN where one is
    if array.finite and not (np.isfinite(least) and np.isfinite(most)):
        raise FileError(where, "holds NaN or infinite numbers", _EXPORT)
    if least < array.least or most > array.most:
        bounds = f"{array.least:g} to {array.most:g}"
        raise FileError(where, f"holds numbers from {least} to {most}, not {bounds}", _EXPORT)
    if array.kind == "f":
        return found if found.dtype.kind == "f" else found.astype(np.float64)
    if found.dtype.kind == "f" and not (found == np.floor(found)).all():
        raise FileError(where, "holds numbers that are not whole", _EXPORT)
    if not -(2.0**63) <= least <= most < 2.0**63:
        raise FileError(where, f"holds numbers from {least} to {most}", _EXPORT)
    return found.astype(np.int64)


def write_npy(path: PathLike, array: np.ndarray) -> None:
    """Writes a .npy file, see `whole_file`."""
    with create_file(path) as file:
        np.save(file, array, allow_pickle=False)


def write_npz(path: PathLike, arrays: Mapping[str, Any], *, pack: bool = False) -> None:
    """Writes a .npz file of named arrays, see `whole_file`; packed to fewer bytes if `pack`."""
    with create_file(path) as file:
        (np.savez_compressed if pack else np.savez)(file, **arrays)
