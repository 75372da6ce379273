"""A row in a forked process of its own: what it breaks, takes or leaves running ends with it."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import traceback
from collections.abc import Callable

from attack.harness import PATIENCE

LONGEST = 2 * PATIENCE  # seconds by the clock, after which nothing inside has ended it


def import_all() -> None:
    """Imports here what commands would import each anew. Nothing of it starts a thread: a forked
    process would be without it."""
    import av  # noqa: F401
    import cv2  # noqa: F401
    import jinja2  # noqa: F401
    import matplotlib.figure  # noqa: F401
    import tqdm  # noqa: F401
    import yaml  # noqa: F401

    import gsut.sfm
    import gsut.training
    import gsut.view  # noqa: F401
    from gsut.cli import build_parser

    build_parser()


def apart(work: Callable[[], str | None]) -> tuple[str | None, float]:
    """What work returns, in a process of its own, and processor seconds with its children's."""
    reader, writer = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if not process:
        os.close(reader)
        os.setsid()
        try:
            said = work()
        except BaseException:
            said = traceback.format_exc()
        os.write(writer, b"-" if said is None else b"+" + said.encode(errors="replace")[-9000:])
        os._exit(0)
    os.close(writer)
    told = os.read(reader, 10_000) if select.select([reader], [], [], LONGEST)[0] else b"+it hangs"
    os.close(reader)
    _end(process)
    _, status, took = os.wait4(process, 0)
    if not told:
        told = f"+ended by itself with {os.waitstatus_to_exitcode(status)}".encode()
    said = None if told == b"-" else told[1:].decode()
    return said, took.ru_utime + took.ru_stime


def _end(process: int) -> None:
    """Ends the group of the process, and waits until its files are its own no longer."""
    watched = os.pidfd_open(process)
    select.select([watched], [], [], 1.0)
    os.close(watched)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
