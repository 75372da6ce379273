"""Kinds of wrong files, by the format of a whole one, and what is wrong with a reader's answer."""

from __future__ import annotations

import io
import itertools
import json
import re
import struct
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut import InputError

SECONDS = 5.0  # of a processor that a small file may take
TEXT = (".yaml", ".csv", ".txt", ".xml", ".cameramodel")  # endings of text other than JSON
DEEP = "[" * 100_000
DIGITS = "9" * 400
# In place of any value of JSON.
WRONG_VALUES = ("x", "", [], {}, None, True, -1, 0.5, 2**40, 1e308, float("nan"), float("inf"),
                "\u0000", ["x"], {"x": None}, [[]])  # fmt: skip
HUGE = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (SHAPE), }"


def find_fault(read: Callable[[], Any]) -> str:
    """Says what is wrong with how a reader took its file; empty if nothing is."""
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read()
    except InputError as error:
        if "\n" in str(error).strip():
            return f"more than one line: {error}"
    except Exception:
        return traceback.format_exc(limit=-3)
    seconds = time.process_time() - started
    return f"took {seconds:.1f} s" if seconds > SECONDS else ""


def change_values(values: Any, wrong: tuple[Any, ...]) -> Iterator[Any]:
    """Yields JSON values with each one, at any depth, in turn replaced or left out."""
    if isinstance(values, dict):
        for key, value in values.items():
            yield {k: v for k, v in values.items() if k != key}
            yield from ({**values, key: each} for each in (*wrong, *change_values(value, wrong)))
    elif isinstance(values, list):
        for i, value in itertools.islice(enumerate(values), 4):
            yield values[:i] + values[i + 1 :]
            for each in (*wrong, *change_values(value, wrong)):
                yield [*values[:i], each, *values[i + 1 :]]


def list_texts(text: str) -> Iterator[bytes]:
    """Yields changed JSON: other types, digits, keys there twice, nesting, encodings."""
    values = json.loads(text)
    for each in (*WRONG_VALUES, *change_values(values, WRONG_VALUES)):
        yield json.dumps(each).encode()

    for changed in change_values(values, ("DIGITS",)):
        digits = json.dumps(changed)
        if "DIGITS" in digits:
            yield digits.replace('"DIGITS"', DIGITS).encode()
    yield text.replace("{", '{"x": 1, "x": 2, ', 1).encode()
    yield from (text.encode(code) for code in ("utf-16", "utf-8-sig", "utf-32"))
    yield text.encode().replace(b'"', b'"\xe4', 1)
    yield (DEEP + text).encode()
    yield text.replace("{", '{"deep": ' + DEEP + ",", 1).encode()


def list_lines(text: str) -> Iterator[bytes]:
    """Yields changed text: numbers, encodings, long runs of blanks."""
    numbers = list(re.finditer(r"(?<![\w.])-?\d[\d.]*(e[-+]?\d+)?", text))
    for found in numbers[:: max(1, len(numbers) // 30)]:
        for wrong in ("x", "", "nan", "inf", "-1", "0.5", "1e400", DIGITS, "[1]", "null", '"'):
            yield (text[: found.start()] + wrong + text[found.end() :]).encode()
    yield from (text.encode(code) for code in ("utf-16", "utf-8-sig", "utf-32"))
    yield text.encode().replace(b"\n", b"\xe4\n", 1)
    yield from (
        (text + each * 100_000 + text).encode() for each in (" ", "\n", "\t", "\0", "-", "1")
    )
    yield text.replace("\n", "\r\n").encode()
    yield (text + text).encode()


def pack(members: dict[str, bytes], **options: Any) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", **options) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def save(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def list_arrays(found: np.ndarray) -> Iterator[bytes]:
    """Yields changed .npy files."""
    yield save(found.astype(complex) if found.dtype.kind in "fiu" else found)
    yield save(np.array([{"x": 1}], object))
    yield save(np.array(["x", "y"]))
    yield save(np.zeros(3, [("x", float)]))
    yield save(np.zeros(3, "datetime64[s]"))
    for value in (np.nan, np.inf, -1.0, 0.5, 2.0**40, 1e308):
        yield save(np.full(found.shape, value))
    for shape in ((), (0,), (1,), (1, 1), (2, 3, 4), (0, 5), found.shape[1:], (*found.shape, 2)):
        yield save(np.ones(shape, found.dtype))
    for claim in (b"10**9", b"100000000000,", b"-1,", b"2, -3", b"4294967296, 4294967296"):
        yield HUGE.replace(b"SHAPE", claim).ljust(127) + b"\n"
    content = save(found)
    yield from (content[:end] for end in (0, 5, 10, 60, len(content) - 1))
    yield pack({"x.npy": content})


def list_archives(content: bytes) -> Iterator[bytes]:
    """Yields changed .npz files."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name in members:
        array = np.load(io.BytesIO(members[name]))
        for changed in list_arrays(array):
            yield pack({**members, name: changed})
        yield pack({k: v for k, v in members.items() if k != name})
    for name in ("../x.npy", "/x.npy", "a\nb.npy", "C:/x.npy", "x\\..\\y.npy"):
        yield pack({**members, name: b""})
    first = next(iter(members))
    yield pack({**members, first: bytes(300 << 20)}, compression=zipfile.ZIP_DEFLATED)  # a bomb
    yield members[first]  # .npy where .npz is meant
    for at in range(0, len(content), max(1, len(content) // 60)):
        yield content[:at]
        yield content[:at] + bytes([content[at] ^ 255]) + content[at + 1 :]
    flags = content.find(b"PK\x01\x02") + 8
    yield content[:flags] + struct.pack("<H", 1) + content[flags + 2 :]  # encrypted
    yield pack(members, compression=zipfile.ZIP_LZMA)


def list_contents(path: Path, content: bytes) -> Iterator[bytes]:
    """Yields changed contents of a file by its kind."""
    yield from (b"", b"\0", b"\xff\xfe", DEEP.encode(), DIGITS.encode(), b"null", b"PK\x03\x04")
    yield from (content[:end] for end in (1, len(content) // 2, len(content) - 1))
    if path.suffix in TEXT:
        yield from list_lines(content.decode())
    if path.suffix == ".json":
        yield from list_texts(content.decode())
    elif path.suffix == ".npy":
        yield from list_arrays(np.load(io.BytesIO(content)))
    elif path.suffix == ".npz":
        yield from list_archives(content)
