"""Forks commands that are to be killed from a process that has imported gsut, which takes long.

`python -m lab.attack.zygote` reads a line of JSON a command and answers with one.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from lab.attack.forked import import_everything

_OPERATIONS = frozenset(
    f"os.{name}" for name in ("rename", "mkdir", "rmdir", "remove", "link", "symlink", "truncate")
)
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Zygote:
    """The process, from outside."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lab.attack.zygote"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def run(
        self,
        words: tuple[str, ...],
        folder: Path,
        *,
        after: float | None = None,
        before: int | None = None,
    ) -> dict[str, Any]:
        """Runs a command in a folder.

        Args:
            words: after `gsut`.
            folder: its current one.
            after: seconds by the clock after which it is killed, with all that it has started.
            before: number of the change to a file before which it is killed (see `changes`).

        Returns:
            "status" (negative: of the signal), "errors", and where it ended by itself "changes":
            how many files Python opened to write, renamed, removed ..., below the folder.
        """
        asked = {"words": words, "folder": str(folder), "after": after, "before": before}
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(json.dumps(asked).encode() + b"\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        self._process.communicate()


def _count_changes(folder: str, before: int | None, to: str) -> None:
    count, own = 0, os.getpid()

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count
        if not (event in _OPERATIONS or (event == "open" and arguments[2] & _WRITES)):
            return
        place = arguments[0]
        if isinstance(place, int) or os.getpid() != own:
            return
        if not os.path.abspath(os.fsdecode(place)).startswith(folder):
            return
        count += 1
        if count == before:
            os.killpg(0, signal.SIGKILL)
        os.pwrite(log, b"%09d" % count, 0)

    log = os.open(to, os.O_WRONLY | os.O_CREAT)
    sys.addaudithook(hook)


def _child(asked: dict[str, Any], errors: str) -> int:
    from gsut.cli import main

    os.setsid()
    os.chdir(asked["folder"])
    nothing, log = os.open(os.devnull, os.O_RDWR), os.open(errors, os.O_WRONLY | os.O_CREAT)
    for target, source in enumerate((nothing, nothing, log)):
        os.dup2(source, target)
    _count_changes(asked["folder"], asked["before"], errors + ".count")
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main(asked["words"])


def _answer(process: int, asked: dict[str, Any], errors: str) -> dict[str, Any]:
    watched = os.pidfd_open(process)
    if not select.select([watched], [], [], asked["after"])[0]:
        os.killpg(process, signal.SIGKILL)
    os.close(watched)
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    said = Path(errors).read_text(errors="replace") if os.path.exists(errors) else ""
    count = Path(errors + ".count")
    changes = int(count.read_text() or 0) if count.exists() else 0
    for path in (Path(errors), count):
        path.unlink(missing_ok=True)
    return {"status": status, "errors": said[-900:], "changes": changes}


def _serve() -> None:
    import_everything()
    for line in sys.stdin:
        asked = json.loads(line)
        errors = asked["folder"] + ".log"
        process = os.fork()
        if not process:
            sys.exit(_child(asked, errors))
        print(json.dumps(_answer(process, asked, errors)), flush=True)


if __name__ == "__main__":
    _serve()
