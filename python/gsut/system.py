"""What differs on Windows: quotes of a command, renaming, flushing, the process of a number."""

import contextlib
import os
import shlex
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path

_IS_WINDOWS = os.name == "nt"
_PAUSES = (0.05, 0.1, 0.2, 0.4)  # seconds between attempts to rename there


def format_command(words: Iterable[str]) -> str:
    """Joins words to a command line, with quotes where one holds spaces or signs of the shell."""
    words = list(words)
    return subprocess.list2cmdline(words) if _IS_WINDOWS else shlex.join(words)


def rename_over(source: Path, target: Path) -> None:
    """Renames a file or folder to `target`, in place of a file or an empty folder of that name.

    Windows renames nothing over a folder, and nothing while another program holds either open, as
    virus scanners do for a moment.
    """
    if _IS_WINDOWS:
        if target.is_dir():
            target.rmdir()
        for pause in _PAUSES:
            with contextlib.suppress(PermissionError):
                os.replace(source, target)
                return
            time.sleep(pause)
    os.replace(source, target)


def flush_folder(folder: Path) -> None:
    """Makes a rename last through a power cut, where the system can (not on Windows)."""
    if _IS_WINDOWS:
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_alive(process: int) -> bool:
    """Returns whether a process runs; True where the system gives no harmless answer."""
    if _IS_WINDOWS:
        return True  # asking would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
