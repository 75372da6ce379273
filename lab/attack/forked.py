"""Runs a case in a forked process: what it breaks, takes or leaves running ends with it."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import traceback
from collections.abc import Callable

from lab.attack.harness import PATIENCE

LONGEST = 2 * PATIENCE  # seconds by the clock; what is inside should have ended it before


def import_everything() -> None:
    """Imports what each command would import anew.

    Nothing of it starts a thread, which a forked process would not have.
    """
    import av  # noqa: F401
    import cv2  # noqa: F401
    import jinja2  # noqa: F401
    import tqdm  # noqa: F401
    import yaml  # noqa: F401

    import gsut.sfm
    import gsut.training
    import gsut.view  # noqa: F401
    from gsut.cli import build_parser

    build_parser()


def run_forked(work: Callable[[], str | None]) -> tuple[str | None, float]:
    """Runs work in a process of its own; returns its answer and processor seconds."""
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
    answer = (
        os.read(reader, 10_000) if select.select([reader], [], [], LONGEST)[0] else b"+it hangs"
    )
    os.close(reader)
    _end_group(process)
    _, status, took = os.wait4(process, 0)
    if not answer:
        answer = f"+ended by itself with {os.waitstatus_to_exitcode(status)}".encode()
    said = None if answer == b"-" else answer[1:].decode()
    return said, took.ru_utime + took.ru_stime


def _end_group(process: int) -> None:
    """Kills the group of the process after its leader has ended, or a second."""
    watched = os.pidfd_open(process)
    select.select([watched], [], [], 1.0)
    os.close(watched)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
