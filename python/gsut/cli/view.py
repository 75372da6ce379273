"""`gsut view`: walk through a scene in the browser."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import threading
import webbrowser
from typing import TextIO

from gsut.cli._flags import add_json, add_moved_data, print_json

HELP = "walk through a scene in the browser"
DESCRIPTION = (
    "Serves a page on this machine that walks through a run, a file of Gaussians or, before "
    "training, a dataset, drawn by gsut's renderer through any lens. Ctrl-C ends it."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="RUN|FILE.ply|DATA", help="what to look at")
    add_moved_data(parser)
    add_view_flags(parser)
    add_json(parser)


def add_view_flags(parser: argparse.ArgumentParser) -> None:
    """Where the page is served, in every command that serves it."""
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help="address to serve on; any but the loopback lets other machines look, whoever has the "
        "page's address with its token [default: the loopback]",
    )
    parser.add_argument("--port", type=int, default=0, metavar="N", help="[default 0: a free one]")
    parser.add_argument("--no-open", action="store_true", help="do not open the page in a browser")


def run(arguments: argparse.Namespace) -> int:
    from gsut.view import LOOPBACK, Session, ViewServer, stage_of

    stage = stage_of(arguments.scene, arguments.data)
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


def announce(address: str, no_open: bool, file: TextIO) -> None:
    """Prints the page's address and opens it where somebody could see it."""
    print(f"gsut view: {address} (Ctrl-C ends it)", file=file, flush=True)
    if not no_open and has_display():
        webbrowser.open(address)


def wait_for_end() -> None:
    """Until Ctrl-C, which is how one ends a page."""
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()


def has_display() -> bool:
    """Whether a browser could be seen."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
