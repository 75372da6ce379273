"""`gsut view`: walk through a scene in the browser."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import threading
import webbrowser
from typing import Any, TextIO

from gsut.cli._flags import Number, add_json, add_memory, add_moved_data, print_json

HELP = "walk through a scene in the browser"
DESCRIPTION = (
    "Serves a page on this machine that walks through a run, a file of Gaussians or, before "
    "training, a dataset, drawn by gsut's renderer through any lens. Ctrl-C ends it."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="RUN|FILE.ply|DATA", help="what to look at")
    add_moved_data(parser)
    add_memory(parser)
    add_view_flags(parser)
    add_json(parser)


def add_view_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags that say where the page is served."""
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help="address to serve on; any but the loopback lets other machines look, whoever has the "
        "page's address with its token [default: the loopback]",
    )
    parser.add_argument(
        "--port",
        type=Number(0, 65535, whole=True),
        default=0,
        metavar="N",
        help="[default 0: a free one]",
    )
    parser.add_argument("--no-open", action="store_true", help="do not open the page in a browser")


def run(arguments: argparse.Namespace) -> int:
    from gsut.view import LOOPBACK, Session, ViewServer, open_stage

    stage = open_stage(arguments.scene, arguments.data, arguments.memory)
    for note in () if stage.scene is None else stage.scene.notes:
        print(f"gsut: note: {note}", file=sys.stderr)
    session = Session(stage)
    with (
        ViewServer(session.routes, arguments.host or LOOPBACK, arguments.port) as server,
        contextlib.suppress(KeyboardInterrupt),
    ):
        if arguments.json:
            print_json({"address": server.address})
            sys.stdout.flush()
        announce(server.address, arguments.no_open, sys.stderr if arguments.json else sys.stdout)
        wait_for_end()
    return 0


def add_live_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags of `LivePage`, for commands that train."""
    parser.add_argument(
        "--view",
        action="store_true",
        help="serve a page that shows at once what is being done, cameras and points as they are "
        "found, and the scene while it trains; it can pause the training, or stop it and keep what "
        "there is; it stays until Ctrl-C",
    )
    add_view_flags(parser)


class LivePage:
    """The page of a command with `--view`; without it, does nothing.

    Args:
        arguments: of `add_live_flags`.

    Attributes:
        live: what the page shows; None: there is no page.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.live: Any = None
        self._arguments = arguments
        self._stack = contextlib.ExitStack()

    def open(self, name: str) -> Any:
        """Starts to serve the page of a scene of this name; returns `live`."""
        if not self._arguments.view:
            return None
        from gsut.view import LOOPBACK, LiveScene, ViewServer

        self.live = LiveScene(name)
        host, port = self._arguments.host or LOOPBACK, self._arguments.port
        server = self._stack.enter_context(ViewServer(self.live.routes, host, port))
        announce(server.address, self._arguments.no_open, sys.stderr)
        return self.live

    def finish(self, result: Any) -> None:
        """Shows what `gsut.train` gave; None: it was finished before, and the page ends."""
        if self.live is None:
            return
        if result is None:
            self._stack.close()
            self.live = None
        else:
            self.live.finish(result.gaussians)

    def stay(self) -> None:
        """Waits for Ctrl-C if there is a page."""
        if self.live is not None:
            sys.stdout.flush()
            wait_for_end()

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: object) -> None:
        if self.live is not None:
            self.live.stop_draft()
        self._stack.close()


def announce(address: str, no_open: bool, file: TextIO) -> None:
    """Prints the page's address and opens it where somebody could see it."""
    print(f"gsut view: {address} (Ctrl-C ends it)", file=file, flush=True)
    if not no_open and has_display():
        webbrowser.open(address)


def wait_for_end() -> None:
    """Waits for Ctrl-C, which ends a page."""
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()


def has_display() -> bool:
    """Returns whether the machine can show a browser."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
