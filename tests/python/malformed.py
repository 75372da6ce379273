"""Kinds of malformed files, and what readers of binary files make of them: a process a reader.

`python -m malformed READER FOLDER EVERY` prints a line "KIND<tab>OUTCOME" a kind: "read",
"refused", or what went wrong. It ends by itself at a kind that takes too long or too much memory.
"""

from __future__ import annotations

import gc
import itertools
import os
import re
import struct
import sys
import time
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
from reader_examples import EXAMPLES, Example

SECONDS = 2.0  # that a file may take
MEMORY = 500 << 20  # bytes that it may take
HUGE = 4_000_000_000
Kinds = Iterator[tuple[str, bytes]]


# Of EXAMPLES: readers of binary files.
READERS = (
    *("PLY of Gaussians", "text PLY of Gaussians", "big-endian PLY of Gaussians", "compressed PLY"),
    *("SPZ", "SPZ 4", "SOG", "glTF of Gaussians", "splat", "large PLY of Gaussians", "mesh"),
    *("mesh PLY", "PLY of points", "COLMAP cameras.bin", "COLMAP images.bin"),
    *("COLMAP points3D.bin", "lens.cameramodel", "film", "sensors of a film", "subtitles"),
    *(f"picture {suffix}" for suffix in (".png", ".jpg", ".webp", ".tif", ".bmp")),
)


def _list_parts(data: bytes) -> Kinds:
    """Pieces that lack, are there twice, or are something else."""
    yield "empty", b""
    yield "text", b"hello, this is something else\n" * 40
    yield "zeros", bytes(len(data))
    yield "backwards", data[::-1]
    for size in (1, 4, 16, 96, len(data) // 3, len(data) // 2, len(data) - 7, len(data) - 1):
        yield f"first {size} bytes", data[:size]
    yield "its head and zeros", data[: len(data) // 3] + bytes(2 * len(data) // 3)
    for name, more in {"a line": b"\n", "zeros": bytes(1000), "itself": data}.items():
        yield f"and {name}", data + more
    yield "line ends of Windows", data.replace(b"\n", b"\r\n")
    yield "minus signs", data.replace(b'":', b'":-')
    yield "brackets", data.replace(b"[", b"[[[[")


def _list_numbers(data: bytes) -> Kinds:
    """Each whole number of a binary head, each number of a text, and floats of data, replaced."""
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
                    changed = data[:at] + struct.pack(layout, value) + data[at + size :]
                    yield f"{layout} {value} at {at}", changed
    words = (b"0", b"-1", b"1" + bytes(20 * [48]), b"1099511627776", b"nan", b"inf", b"1e308",
             b"9" * 400, b"[]", b"null", b"true", b" " * 100_000, b"\n" * 100_000,
             b"9" * 100_000)  # fmt: skip
    numbers = re.finditer(rb"-?\b\d[\d.e+-]*", data[:20_000])
    for found, word in itertools.product(itertools.islice(numbers, 40), words):
        changed = data[: found.start()] + word + data[found.end() :]
        yield f"{word[:20]!r} for the number at {found.start()}", changed
    for value in (np.nan, np.inf, 3e38, -1e30, 1e-45):
        changed = bytearray(data)
        for at in range(len(data) // 2 & ~3, len(data) - 4, 36):
            changed[at : at + 4] = struct.pack("<f", value)
        yield f"floats of {value}", bytes(changed)


def _list_headers(data: bytes) -> Kinds:
    """What the header of a PLY file says."""
    head, end, rows = data.partition(b"end_header\n")
    if not end:
        return
    for name, more in {
        "a header without end": b"comment " + b"a" * 50_000_000,
        "endless comments": b"comment a\n" * 5_000_000,
        "endless properties": b"".join(b"property float q%d\n" % i for i in range(90_000)),
        "endless elements": b"".join(b"element q%d 0\n" % i for i in range(90_000)),
        "a line of blanks": b"comment" + b" " * 10_000_000 + b"\n",
    }.items():
        yield name, head + more + end + rows
    for order in (b"binary_big_endian", b"ascii", b"binary", b""):
        yield f"format {order!r}", re.sub(rb"format \S+", b"format " + order, head) + end + rows
    for line in re.findall(rb"property[^\n]*\n", head)[:20]:
        for name, to in {
            "no": b"", "twice": line * 2,
            "list": line.replace(b"property ", b"property list uchar "),
            "long list": line.replace(b"property ", b"property list double "),
            "type of": re.sub(rb"property \w+", b"property quaternion", line),
        }.items():  # fmt: skip
            yield f"{name} {line[:30]!r}", head.replace(line, to, 1) + end + rows
    for line in re.findall(rb"element[^\n]*\n", head):
        for count in (b"-1", b"0", b"1e9", b"9" * 20, b"9223372036854775807", b"%d" % HUGE, b"4.5"):
            to = re.sub(rb"\S+\n$", count + b"\n", line)
            yield f"count {count!r} in {line!r}", head.replace(line, to, 1) + end + rows
        yield f"twice {line!r}", head.replace(line, line * 2, 1) + end + rows
    nothing = b"element nothing 9223372036854775807\n"
    yield "rows of nothing", head.replace(b"element", nothing + b"element", 1) + end + rows
    with_list = b"element face %d\nproperty list %s int of\n"
    for kind, count, number in (
        ("<b", 2**62, -1),
        ("<d", 1, 1e300),
        ("<d", 1, -3),
        ("<d", 1, np.nan),
    ):
        lists = with_list % (count, b"char" if kind == "<b" else b"double")
        changed = head.replace(b"element", lists + b"element", 1) + end
        binary = struct.pack(kind, number)
        yield (
            f"a list of {number}",
            changed + (b"%g " % number if b"ascii" in head else binary) + rows,
        )


def list_kinds(data: bytes, every: int) -> Kinds:
    """Lists kinds of malformed files; of numbers replaced at each place every so-manieth alone."""
    yield from _list_parts(data)
    yield from _list_headers(data)
    yield from itertools.islice(_list_numbers(data), every // 2, None, every)


def try_kind(example: Example) -> str:
    """Reads a file; says what became of it."""
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            example.read()
            said = "read"
    except gsut.InputError as error:
        text = str(error).strip()
        said = (
            "refused"
            if str(example.file.parent) in text and "\n" not in text
            else f"refused by: {text[:200]}"
        )
    except Exception:
        said = traceback.format_exc(limit=-3)
    took = time.process_time() - started
    return said if took < SECONDS else f"took {took:.1f} s"


def main(name: str, folder: str, every: str) -> None:
    import resource
    import signal

    example = EXAMPLES[name](Path(folder))
    whole = example.file.read_bytes()
    print(f"whole\t{try_kind(example)}", flush=True)
    status = Path("/proc/self/status").read_text("ascii")
    taken = 1024 * int(status.partition("VmData:")[2].split()[0])
    resource.setrlimit(resource.RLIMIT_DATA, (taken + MEMORY, taken + MEMORY))
    for kind, content in list_kinds(whole, int(every)):
        example.file.write_bytes(content)
        print(kind, end="\t", flush=True)
        signal.setitimer(signal.ITIMER_PROF, 2 * SECONDS)  # ends the process
        print(repr(try_kind(example))[1:-1], flush=True)
        signal.setitimer(signal.ITIMER_PROF, 0)
        gc.collect()  # frames of films, which hold themselves and threads
    os._exit(0)  # not after threads that the memory was too small for


if __name__ == "__main__":
    main(*sys.argv[1:])
