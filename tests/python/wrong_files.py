"""Kinds of wrong files, by the format of a whole one, and what is wrong with a reader's answer."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import re
import struct
import sys
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut import InputError

SECONDS = 4.0  # of a processor that a small file may take
MEMORY = 500 << 20  # bytes that it may take
TEXT = (".yaml", ".csv", ".txt", ".xml", ".cameramodel")  # endings of text other than JSON
DEEP = "[" * 100_000
DIGITS = "9" * 400
# In place of any value of JSON.
WRONG_VALUES = ("x", "", [], {}, None, True, -1, 0.5, 2**40, 1e308, float("nan"), float("inf"),
                "\u0000", ["x"], {"x": None}, [[]])  # fmt: skip
HUGE = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (SHAPE), }"


@contextlib.contextmanager
def limit_memory(most: int) -> Iterator[None]:
    """Lets this process take only so many bytes more, where the system can."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    status = Path("/proc/self/status").read_text("ascii")
    taken = 1024 * int(status.partition("VmData:")[2].split()[0])
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (taken + most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def find_fault(read: Callable[[], Any], named: str = "") -> str:
    """Says what is wrong with how a reader took its file; empty if nothing is."""
    started = time.process_time()
    try:
        with warnings.catch_warnings(), limit_memory(MEMORY):
            warnings.simplefilter("ignore")
            read()
    except InputError as error:
        if "\n" in str(error).strip():
            return f"more than one line: {error}"
        if named not in str(error):
            return f"without {named}: {error}"
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


def list_pieces(data: bytes) -> Iterator[bytes]:
    """Yields data that lacks something, has it twice, or is something else."""
    yield b"hello, this is something else\n" * 40
    yield bytes(len(data))
    yield data[::-1]
    for size in (4, 16, 96, len(data) // 3, len(data) - 7):
        yield data[:size]
    yield data[: len(data) // 3] + bytes(2 * len(data) // 3)
    yield from (data + more for more in (b"\n", bytes(1000), data))
    yield data.replace(b"\n", b"\r\n")
    yield data.replace(b'":', b'":-')
    yield data.replace(b"[", b"[[[[")


def list_numbers(data: bytes) -> Iterator[bytes]:
    """Yields data with a whole number of its head, a number of its text or floats replaced."""
    film = data.find(b"moov")
    starts = {0: 256} | ({film & ~3: len(data)} if film > 0 else {})
    wanted = {
        "<I": (0, 2**31 - 1, 2**32 - 1, 10**9), ">I": (0, 2**31 - 1, 2**32 - 1, 100_000),
        "<Q": (2**40, 2**63 - 1), "<B": (0, 255), ">H": (65500,),
    }  # fmt: skip
    for layout, values in wanted.items():
        size = struct.calcsize(layout)
        for start, end in starts.items():
            for at in range(start, min(end, len(data) - size + 1), max(1, size & ~3)):
                for value in values:
                    yield data[:at] + struct.pack(layout, value) + data[at + size :]
    words = (b"0", b"-1", b"1" + bytes(20 * [48]), b"1099511627776", b"nan", b"inf", b"1e308",
             b"9" * 400, b"[]", b"null", b"true", b" " * 100_000, b"\n" * 100_000,
             b"9" * 100_000)  # fmt: skip
    numbers = re.finditer(rb"-?\b\d[\d.e+-]*", data[:20_000])
    for found, word in itertools.product(itertools.islice(numbers, 40), words):
        yield data[: found.start()] + word + data[found.end() :]
    for value in (np.nan, np.inf, 3e38, -1e30, 1e-45):
        changed = bytearray(data)
        for at in range(len(data) // 2 & ~3, len(data) - 4, 36):
            changed[at : at + 4] = struct.pack("<f", value)
        yield bytes(changed)


def list_headers(data: bytes) -> Iterator[bytes]:
    """Yields what the header of a PLY file may say; nothing for other files."""
    head, end, rows = data.partition(b"end_header\n")
    if not end:
        return
    for more in (
        b"comment " + b"a" * 50_000_000,
        b"comment a\n" * 5_000_000,
        b"".join(b"property float q%d\n" % i for i in range(90_000)),
        b"".join(b"element q%d 0\n" % i for i in range(90_000)),
        b"comment" + b" " * 10_000_000 + b"\n",
    ):
        yield head + more + end + rows
    for order in (b"binary_big_endian", b"ascii", b"binary", b""):
        yield re.sub(rb"format \S+", b"format " + order, head) + end + rows
    for line in re.findall(rb"property[^\n]*\n", head)[:20]:
        for to in (
            b"", line * 2, line.replace(b"property ", b"property list uchar "),
            line.replace(b"property ", b"property list double "),
            re.sub(rb"property \w+", b"property quaternion", line),
        ):  # fmt: skip
            yield head.replace(line, to, 1) + end + rows
    for line in re.findall(rb"element[^\n]*\n", head):
        for count in b"-1 0 1e9 9999999999999999999 9223372036854775807 4000000000 4.5".split():
            yield head.replace(line, re.sub(rb"\S+\n$", count + b"\n", line), 1) + end + rows
        yield head.replace(line, line * 2, 1) + end + rows
    nothing = b"element nothing 9223372036854775807\n"
    yield head.replace(b"element", nothing + b"element", 1) + end + rows
    for kind, number in (("<b", -1), ("<d", 1e300), ("<d", -3), ("<d", np.nan)):
        lists = b"element face %d\nproperty list %s int of\n"
        lists %= (2**62, b"char") if kind == "<b" else (1, b"double")
        found = b"%g " % number if b"ascii" in head else struct.pack(kind, number)
        yield head.replace(b"element", lists + b"element", 1) + end + found + rows


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
    elif path.suffix not in TEXT:
        yield from list_numbers(content)
