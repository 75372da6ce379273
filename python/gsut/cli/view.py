"""`gsut view`: walk through a scene in the browser."""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
import webbrowser

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
        contextlib.suppress(KeyboardInterrupt),  # how one ends it
    ):
        announce(server.address, arguments.no_open, arguments.json)
        threading.Event().wait()
    return 0


def announce(address: str, no_open: bool, json: bool = False) -> None:
    """Prints the page's address and opens it where somebody could see it."""
    from gsut.cli.demo import has_display

    if json:
        print_json({"address": address})
    else:
        print(f"gsut view: {address} (Ctrl-C ends it)")
    sys.stdout.flush()
    if not no_open and has_display():
        webbrowser.open(address)
