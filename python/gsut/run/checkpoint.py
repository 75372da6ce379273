"""Checkpoint files: nested dicts of arrays and plain values, exact to the bit, damage detected.

A checkpoint is a .npz file (a zip of .npy files, which any numpy reads). The member `layout`
holds the nesting as JSON, with each array replaced by the name of its member. A zip keeps its
list of members at the end and a CRC-32 of each, so a file that was cut off or altered is found out.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import Array, parse_json, read_npz, reading, register_reader, write_npz

_LAYOUT = "layout"
_ARRAY = "__array__"  # key of the dict that stands for an array in the layout
_SCALAR = "__scalar__"  # the same for a numpy scalar, kept as an array of no dimensions


def write_checkpoint(path: str | os.PathLike[str], state: dict[str, Any]) -> None:
    """Writes a state to a file, see `whole_file`.

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
    write_npz(path, members)


@register_reader("checkpoint", ".npz")
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
    layout = read_npz(path, {_LAYOUT: Array("i", (None,), 0, 255)}, fails=_make_error)[_LAYOUT]
    with reading(path, "", _make_error):
        whole = parse_json(layout.astype(np.uint8).tobytes(), path, dict)
        some = whole if names is None else {k: v for k, v in whole.items() if k in names}
        return _put_arrays(some, read_npz(path, _list_members(some)))


def _make_error(where: object, what: str, _: str) -> InputError:
    return InputError(
        f"{where}: not a complete checkpoint ({what}); remove this file and begin a new run"
    )


def _list_members(value: Any) -> list[str]:
    """Lists the names of the arrays of a layout."""
    if isinstance(value, dict) and len(value) == 1 and value.keys() <= {_ARRAY, _SCALAR}:
        return list(value.values())
    entries = (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    )
    return [name for entry in entries for name in _list_members(entry)]


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
