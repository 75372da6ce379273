"""Finds how much memory is free, and rejects work that does not fit before it starts."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

from gsut._core import InputError
from gsut.files import read_text

_SMALL = 256 << 20  # bytes that are taken without a check
PROGRAM_BYTES = 160 << 20  # of Python with its libraries
# Where Linux lists all control groups, and those of this process.
_GROUPS = Path("/sys/fs/cgroup")
_OWN_GROUPS = Path("/proc/self/cgroup")


def check_fits(what: str, size: float, advice: str) -> None:
    """Rejects work that does not fit into the free memory, before it starts.

    Args:
        what: is to be done, for the message.
        size: bytes that it takes at least.
        advice: what to do about it.

    Raises:
        InputError: names both numbers.
    """
    if size <= _SMALL:
        return
    free = free_memory()
    if free is not None and size > free:
        raise InputError(
            f"{what} takes about {format_size(size)} of memory, and {format_size(free)} are free; "
            f"{advice}"
        )


def free_memory() -> int | None:
    """Returns the bytes that this process could still get; None if the system does not say.

    The least of what the machine (with its swap), control groups and the own limit leave."""
    told = [*_read_machine(), *_read_groups(), *_read_limit()]
    return max(0, min(told)) if told else None


@contextlib.contextmanager
def limit_memory(more: int) -> Iterator[None]:
    """Lets this process get at most `more` bytes within the block, where the system is Linux: a
    library then fails at what a damaged file claims, in place of taking it."""
    before = None
    with contextlib.suppress(ImportError, OSError, ValueError, IndexError):
        import resource

        pages = int(read_text("/proc/self/statm").split()[5])  # of data and stacks
        before = resource.getrlimit(resource.RLIMIT_DATA)
        most = pages * resource.getpagesize() + more
        limits = [each for each in (most, *before) if each != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_DATA, (min(limits), before[1]))
    try:
        yield
    finally:
        if before is not None:
            resource.setrlimit(resource.RLIMIT_DATA, before)


def release_memory() -> None:
    """Gives back to the system what this process has freed: where the C library is asked to."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def format_size(size: float) -> str:
    """Returns a number of bytes in words."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size:.0f} bytes"


def _read_machine() -> list[int]:
    try:
        lines = read_text("/proc/meminfo").splitlines()
        rows = {name: int(value.split()[0]) for name, _, value in (r.partition(":") for r in lines)}
        return [1024 * (rows["MemAvailable"] + rows.get("SwapFree", 0))]
    except (OSError, KeyError, ValueError, IndexError):
        pass
    try:
        return [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2]
    except (AttributeError, OSError, ValueError):
        return []


def _read_groups() -> list[int]:
    """Returns what each control group of this process has left; of its files in memory, those
    that can be dropped count as free."""
    try:
        lines = read_text(_OWN_GROUPS).splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        number, _, name = line.split(":", 2)
        if number != "0":  # of the first version
            continue
        inner = _GROUPS / name.lstrip("/")
        groups = [g for g in (inner, *inner.parents) if g == _GROUPS or _GROUPS in g.parents]
        found += [left for group in groups if (left := _read_left_in_group(group)) is not None]
    return found


def _read_left_in_group(group: Path) -> int | None:
    try:
        free = int(read_text(group / "memory.max")) - int(read_text(group / "memory.current"))
        rows = dict(row.split() for row in read_text(group / "memory.stat").splitlines())
        return free + int(rows.get("inactive_file", 0))
    except (OSError, ValueError):  # "max": no limit
        return None


def _read_limit() -> list[int]:
    """Returns what `ulimit -v` leaves."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = int(read_text("/proc/self/statm").split()[0])
    except (ImportError, OSError, ValueError, IndexError):
        return []
    return [] if limit == resource.RLIM_INFINITY else [limit - pages * resource.getpagesize()]
