"""`gsut view`: walk through a scene in the browser."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import threading
import webbrowser
from typing import Any, TextIO

from gsut._core import InputError
from gsut.cli._flags import add_json, add_moved_data, print_result
from gsut.terminal import say

HELP = "walk through a scene in the browser"
DESCRIPTION = (
    "Serves a page on this machine that walks through a run, a file of Gaussians or, before "
    "training, a dataset, drawn by gsut's renderer through any lens. Ctrl-C ends it."
)
_LAST_PORT = 65535


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="RUN|FILE.ply|DATA", help="what to look at")
    add_moved_data(parser)
    add_serve(parser)
    add_json(parser)


def add_serve(parser: argparse.ArgumentParser) -> None:
    """Adds the flag that says where the page is served."""
    parser.add_argument(
        "--serve",
        type=parse_address,
        metavar="HOST:PORT",
        help="serve the page there and open no browser: 127.0.0.1:0 for this machine and a free "
        "port, 0.0.0.0:8000 to let other machines look, whoever has the page's address with its "
        "token [default: this machine, a free port, opened in a browser]",
    )


def parse_address(text: str) -> tuple[str, int]:
    """Reads host and port of --serve, for `type=`."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > _LAST_PORT:
        raise argparse.ArgumentTypeError(
            f"must be like 127.0.0.1:8000, with a port from 0 to {_LAST_PORT}, found {text!r}"
        )
    return host.strip("[]"), int(port)


def open_server(routes: dict[str, Any], arguments: argparse.Namespace, file: TextIO) -> Any:
    """Serves a page, prints its address, and opens it unless the user has given one."""
    from gsut.view import ViewServer

    address = arguments.serve
    server = ViewServer(routes, *(address or ()))
    print(f"gsut view: {server.address} (Ctrl-C ends it)", file=file, flush=True)
    if address is None and not getattr(arguments, "no_open", False) and has_display():
        webbrowser.open(server.address)
    return server


def run(arguments: argparse.Namespace) -> int:
    from gsut.view import Session, open_stage

    stage = open_stage(arguments.scene, arguments.data)
    for note in () if stage.scene is None else stage.scene.notes:
        say(f"note: {note}")
    told = sys.stderr if arguments.json else sys.stdout
    with (
        contextlib.suppress(KeyboardInterrupt),
        open_server(Session(stage).routes, arguments, told) as server,
    ):
        print_result(arguments, {"address": server.address}, ())
        sys.stdout.flush()
        wait_for_end()
    return 0


def add_live_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags of `LivePage`, for commands that train."""
    parser.add_argument(
        "--view",
        action="store_true",
        help="serve a page that shows the scene while it trains; it can pause the training, or "
        "stop it and keep what there is; it stays until Ctrl-C",
    )
    add_serve(parser)


class LivePage:
    """The page of a command with `--view`; without it, does nothing.

    Args:
        arguments: of `add_live_flags`.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._live: Any = None
        self._arguments = arguments
        if arguments.serve is not None and not arguments.view:
            raise InputError("--serve says where the page of --view is served; add --view")
        self._stack = contextlib.ExitStack()

    def begin_training(self, scene: Any, options: Any) -> Any:
        """Starts to serve the page of a training; returns the `watch` of `gsut.train`."""
        if not self._arguments.view:
            return None
        from gsut.view import LiveTraining

        self._live = LiveTraining(scene, options)
        server = open_server(self._live.session.routes, self._arguments, sys.stderr)
        self._stack.enter_context(server)
        return self._live.watch

    def finish(self, result: Any) -> None:
        """Shows what `gsut.train` gave."""
        if self._live is not None:
            self._live.finish(result.gaussians)

    def stay(self) -> None:
        """Waits for Ctrl-C if there is a page."""
        if self._live is not None:
            sys.stdout.flush()
            wait_for_end()

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def wait_for_end() -> None:
    """Waits for Ctrl-C, which ends a page."""
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()


def has_display() -> bool:
    """Returns whether the machine can show a browser."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
