"""Serves the page with the standard library, on the loopback, behind a random token."""

from __future__ import annotations

import contextlib
import dataclasses
import http.server
import io
import ipaddress
import secrets
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar
from urllib.parse import unquote_to_bytes

from gsut._core import CalibrationError, InputError, SolveError
from gsut.files import FileError, check_shape, format_json, parse_json, read_package_file

# Address that only this machine reaches.
LOOPBACK = "127.0.0.1"
# Most bytes that the page may send: a lens file with a table of control points.
_MOST_BYTES = 8 << 20
# Bytes of a request above which one is parsed at a time: parsed JSON takes up to 30 times its text.
_LARGE_BYTES = 64 << 10
# Bytes of a request's first line and headers, several times what browsers send.
_MOST_HEAD = 16 << 10
# Seconds for the head of a connection's first request, until whose token nobody is trusted.
_HEAD_SECONDS = 10.0
# Seconds between two requests of the page, for a request's body, and for its answer.
_PAGE_SECONDS = 60.0
# Connections at once, twice what a busy classroom opens: each has a thread.
_MOST_OPEN = 256
# Media type of each of the page's files.
_KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
# Names of the page's files, without their endings.
_PAGE_FILES = ("view", "select")
# Content security policy: the page may load from this server only.
_POLICY = "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'"


@dataclasses.dataclass
class Reply:
    """The answer of a route: bytes of a kind, or a value that becomes JSON.

    Attributes:
        content: the bytes, or a JSON value.
        kind: of the bytes; "" for JSON.
        headers: additional ones.
        keep: whether the browser may keep it.
    """

    content: Any
    kind: str = ""
    headers: dict[str, str] = dataclasses.field(default_factory=dict)
    keep: bool = False


# A route takes the request's values: the JSON object that a POST's body or the query of a GET is.
Route = Callable[[dict[str, Any]], Reply]
_Function = TypeVar("_Function", bound=Callable[..., Reply])


def declare_values(shape: dict[str, Any]) -> Callable[[_Function], _Function]:
    """Declares the values of a route's requests, see `check_shape`; it receives no others."""

    def declare(route: _Function) -> _Function:
        route.__dict__["shape"] = shape
        return route

    return declare


class ViewServer:
    """Serves the page and its routes until `close`.

    Args:
        routes: by name, which follows the token in the address.
        host: whose requests are answered, by default the loopback's.
        port: 0 for a free one.

    Attributes:
        address: to open in a browser.

    Raises:
        InputError: host and port cannot be listened on.
    """

    def __init__(self, routes: dict[str, Route], host: str = LOOPBACK, port: int = 0) -> None:
        self.token = secrets.token_urlsafe(16)

        class Handler(_Handler):
            pass

        Handler.routes, Handler.token = routes, self.token
        try:
            self._server = _Server((host, port), Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot listen on {host}:{port} ({reason}); give another --serve HOST:PORT"
            ) from None
        self.host, self.port = host, self._server.server_address[1]
        Handler.host, Handler.port = host, self.port
        name = socket.gethostname() if host in ("", "0.0.0.0", "::") else host
        self.address = f"http://{name}:{self.port}/{self.token}/"
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    def close(self) -> None:
        """Stops serving without waiting for open requests."""
        self._server.shutdown()
        self._server.server_close()

    def __enter__(self) -> ViewServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = _MOST_OPEN

    def __init__(self, *args: Any) -> None:
        self._places = threading.BoundedSemaphore(_MOST_OPEN)
        super().__init__(*args)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answers a connection in a thread of its own; closes it if all places are taken."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answers a connection, and gives its place back."""
        with contextlib.ExitStack() as stack:
            stack.callback(self._places.release)
            super().process_request_thread(request, client_address)

    def handle_error(self, *_: object) -> None:
        """Ignores a browser that leaves in the middle of a frame."""


class _TooLong(Exception):
    """A request sends more than it may."""


class _Inflow(io.RawIOBase):
    """What a connection sends, a part at a time, each bounded in bytes and in seconds."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._left, self._end = connection, 0, 0.0

    def allow(self, count: int, seconds: float) -> None:
        """Begins a part of at most `count` bytes that takes no more than `seconds`."""
        self._left, self._end = count, time.monotonic() + seconds

    def is_open_to_read(self) -> bool:
        """Returns True: it is read, never written."""
        return True

    def read_part(self, buffer: Any) -> int:
        """Reads into a buffer as much as there is of the part."""
        if not self._left:
            raise _TooLong
        left = self._end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self._connection.settimeout(left)
        count = self._connection.recv_into(memoryview(buffer)[: self._left])
        self._left -= count
        return count

    readable, readinto = is_open_to_read, read_part  # as `io` calls them


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # one connection for all frames
    disable_nagle_algorithm = True
    routes: dict[str, Route] = {}  # noqa: RUF012  # of the server's own subclass
    token, host, port = "", LOOPBACK, 0
    parsing = threading.Lock()
    admitted = False  # the connection has sent the token

    def handle(self) -> None:
        """Answers a connection's requests, of which the standard library reads bounded parts."""
        self.inflow = _Inflow(self.connection)
        self.rfile.close()
        self.rfile = io.BufferedReader(self.inflow)
        super().handle()

    def handle_one_request(self) -> None:
        """Reads and answers a request; a connection ends at one that is too long or too slow."""
        self.inflow.allow(_MOST_HEAD, _PAGE_SECONDS if self.admitted else _HEAD_SECONDS)
        try:
            super().handle_one_request()
        except _TooLong:
            self.requestline, self.request_version, self.command = "", self.protocol_version, ""
            self._refuse(431, f"a request has at most {_MOST_HEAD >> 10} KiB of headers")

    def do_GET(self) -> None:
        if self._is_admitted():
            self._answer(unquote_to_bytes(self.path.partition("?")[2]))

    def do_POST(self) -> None:
        if not self._is_admitted():
            return
        if self.headers.get("Transfer-Encoding"):
            return self._refuse(411, "send the request whole, with its Content-Length")
        length = self.headers.get("Content-Length") or "0"
        if not (length.isdecimal() and len(length) < 20 and int(length) <= _MOST_BYTES):
            return self._refuse(413, f"more than {_MOST_BYTES >> 20} MiB at once are not taken")
        self.inflow.allow(max(int(length), 1), _PAGE_SECONDS)
        self._answer(self.rfile.read(int(length)))

    def _answer(self, text: bytes) -> None:
        """Answers a request whose values are this JSON."""
        with self.parsing if len(text) > _LARGE_BYTES else contextlib.nullcontext():
            try:
                values = parse_json(text or b"{}", "request", dict)
            except FileError:
                return self._refuse(400, "the request is not a JSON object")
            answer = self._reply(values)
        self._send(*answer)

    def _is_admitted(self) -> bool:
        """Returns whether the request may be read; otherwise refuses it, before its body."""
        token = self._split_path()[0]
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            self._refuse(403, "wrong token: open the address that gsut view printed")
        elif not _is_own_name(host, self.host, self.port):
            where = "on the loopback only" if self.host == LOOPBACK else "by the machine's name"
            self._refuse(403, f"gsut view answers {where}, not as {host!r}; see --serve")
        elif origin is not None and origin != f"http://{host}":
            self._refuse(403, f"gsut view does not answer pages of {origin!r}")
        else:
            self.admitted = True
            return True
        return False

    def _split_path(self) -> list[str]:
        """Returns the token and the route that the address names, "" where it names none."""
        return [*self.path.partition("?")[0].split("/"), "", ""][1:3]

    def _reply(self, values: dict[str, Any]) -> tuple[int, Reply]:
        """Returns the status and the route's answer; every failure becomes a sentence."""
        name = self._split_path()[1]
        try:
            if name in self.routes:
                return 200, self.routes[name](_check_values(self.routes[name], values, name))
            return 200, _read_page_file(name or "view.html")
        except FileNotFoundError:
            return 404, _make_error(f"there is no {name!r} here")
        except (InputError, CalibrationError, SolveError) as error:
            return 400, _make_error(" ".join(str(error).split()))
        except (TypeError, ValueError, ArithmeticError) as error:
            return 400, _make_error(f"{name}: the request cannot be understood: {error!r}")
        except OSError as error:
            return 400, _make_error(f"{name}: {error.strerror or error}")
        except Exception as error:
            return 500, _make_error(f"{name} failed: {error!r}")

    def _refuse(self, status: int, sentence: str) -> None:
        """Sends an error and ends the connection, since the request's body may be unread."""
        self.close_connection = True
        self._send(status, _make_error(sentence))

    def _send(self, status: int, reply: Reply) -> None:
        content, kind = reply.content, reply.kind
        self.connection.settimeout(_PAGE_SECONDS)
        if not kind:
            content, kind = format_json(content).encode(), "application/json"
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "max-age=3600" if reply.keep else "no-store")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        for key, value in reply.headers.items():
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Logs nothing: frames do not deserve a line each."""


def _is_own_name(header: str, host: str, port: int) -> bool:
    """Returns whether a Host header names this server, not a foreign name that leads here.

    Args:
        header: of the request. host, port: that the server listens on.
    """
    name, _, number = header.lower().rpartition(":")
    if number != str(port):
        return False
    if name in (LOOPBACK, "localhost") or host == LOOPBACK:
        return name in (LOOPBACK, "localhost")
    machine = socket.gethostname().lower()
    if name in (host.lower(), machine, f"{machine}.local", socket.getfqdn().lower()):
        return True
    try:
        return bool(ipaddress.ip_address(name.strip("[]")))  # no foreign name resolves to itself
    except ValueError:
        return False


def _check_values(route: Route, values: dict[str, Any], name: str) -> dict[str, Any]:
    """Returns the values that a route declares, or raises InputError at one of a wrong kind."""
    shape = getattr(route, "shape", {})
    try:
        check_shape(values, shape, name)
    except TypeError as error:
        raise InputError(f"{error}, which the page never sends: reload it") from None
    return {key: values[key] for key in values if key in shape or f"{key}?" in shape}


def _make_error(sentence: str) -> Reply:
    return Reply({"error": sentence})


def _read_page_file(name: str) -> Reply:
    """Reads a file of the page, shipped beside this one."""
    stem, _, ending = name.partition(".")
    if stem not in _PAGE_FILES or ending not in _KINDS:
        raise FileNotFoundError(name)
    content = read_package_file("gsut.view", name)
    return Reply(content, f"{_KINDS[ending]}; charset=utf-8")
