"""Checkpoint files: nested dicts of arrays and plain values, exact to the bit, damage detected.

A checkpoint is a .npz file (a zip of .npy files, which any numpy reads). The member `layout`
holds the nesting as JSON, with each array replaced by the name of its member. A zip keeps its
list of members at the end and a CRC-32 of each, so a file that was cut off or altered is found out.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Collection
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import check_regular

_LAYOUT = "layout"
_ARRAY = "__array__"  # key of the dict that stands for an array in the layout
_SCALAR = "__scalar__"  # the same for a numpy scalar, kept as an array of no dimensions
# What reading a damaged file may raise, depending on where the damage is.
_DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    EOFError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
)


def write_checkpoint(path: str | os.PathLike[str], state: dict[str, Any]) -> None:
    """Writes a state to a file (not atomically: that is `RunFolder.write`'s job).

    Args:
        path: the file.
        state: a dict with string keys of numpy arrays, numpy scalars, str, int, float, bool, None,
            and dicts and lists of them. Tuples come back as lists.

    Raises:
        TypeError: a value of another kind, or a key that is not a string.
    """
    arrays: dict[str, np.ndarray] = {}
    layout = json.dumps(_take_arrays(state, "", arrays))
    members: dict[str, Any] = {_LAYOUT: np.frombuffer(layout.encode(), np.uint8), **arrays}
    with open(path, "wb") as file:
        np.savez(file, **members)


def read_checkpoint(
    path: str | os.PathLike[str], names: Collection[str] | None = None
) -> dict[str, Any]:
    """Reads the state from a file of `write_checkpoint`; arrays and numbers have the same bits.

    Args:
        path: the file.
        names: entries of the state to read, those that it has; nothing else of the file is read
            but its list. None: all.

    Raises:
        InputError: the file is no checkpoint, was cut off, or is damaged.
    """
    try:
        # Opened here: np.load leaves a damaged file open.
        with open(check_regular(path), "rb") as file, np.load(file, allow_pickle=False) as members:
            layout = json.loads(members[_LAYOUT].tobytes().decode())
            some = layout if names is None else {k: v for k, v in layout.items() if k in names}
            return _put_arrays(some, members)
    except _DAMAGE as error:
        raise InputError(
            f"{path}: not a complete checkpoint ({error}); remove this file and begin a new run"
        ) from None


def _take_arrays(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """Replaces every array in `value` by the name under which it is put into `arrays`."""
    if isinstance(value, (np.ndarray, np.generic)):
        if value.dtype.hasobject:
            raise TypeError(f"checkpoint entry {name} is an array of objects")
        member = f"{len(arrays):04d}.{name}"  # the number keeps "a.b" and b within a apart
        arrays[member] = np.asarray(value)
        return {_ARRAY if isinstance(value, np.ndarray) else _SCALAR: member}
    if isinstance(value, dict):
        if not all(isinstance(key, str) for key in value):
            raise TypeError(f"checkpoint entry {name or 'state'} has keys that are not strings")
        return {k: _take_arrays(v, f"{name}.{k}" if name else k, arrays) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_take_arrays(v, f"{name}.{i}", arrays) for i, v in enumerate(value)]
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise TypeError(f"checkpoint entry {name} is a {type(value).__name__}, which cannot be saved")


def _put_arrays(value: Any, members: Any) -> Any:
    """Reverses `_take_arrays`."""
    if isinstance(value, dict):
        if value.keys() == {_ARRAY}:
            return members[value[_ARRAY]]
        if value.keys() == {_SCALAR}:
            return members[value[_SCALAR]][()]
        return {key: _put_arrays(entry, members) for key, entry in value.items()}
    if isinstance(value, list):
        return [_put_arrays(entry, members) for entry in value]
    return value
