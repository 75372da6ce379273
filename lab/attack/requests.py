"""Sends wrong, huge and foreign requests to the viewer's server and judges its answers."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

POSE = [float(k % 5 == 0) for k in range(16)]
FRAME = {"pose": POSE, "lens": 0, "width": 8, "height": 6}
HUGE = 10**12
MANY = 10**6  # numbers, about 5 MB of JSON
CLIENTS = 100
SLOWEST = 20.0  # seconds of an answer
WRONG_VALUES = (  # of a field, as JSON
    "null", "true", "-1", "0.5", "NaN", "1e400", "1e300", "1" + 400 * "0", f'"{MANY * "x"}"', '""',
    "[]", "{}", "[[1, 2], [3]]", 100_000 * "[" + 100_000 * "]",
)  # fmt: skip
GOOD: dict[str, dict[str, Any]] = {  # of a row: a request, whose fields are replaced in turn
    "scene": {}, "frame": FRAME, "photo": {"view": 0, "side": 8}, "lens": {"model": "pinhole"},
    "pick": {"frame": FRAME, "pixel": [3, 3]}, "camera": FRAME | {"poses": [POSE]},
    "findings": {}, "edits": {"steps": [{"do": "clear"}]},
    "edits.json": {"steps": [{"do": "clear"}]},
}  # fmt: skip
WRONG: dict[str, tuple[str, Any]] = {  # of a row: route and values, refused with status 400
    "a lens of a million coefficients": ("lens", {"model": "ocam", "params": [1.0] * MANY}),
    "a million points": ("frame", FRAME | {"marks": [[0, 0, 0]] * (MANY // 5)}),
    "a path of a million poses": ("camera", FRAME | {"poses": [0] * MANY}),
    "a frame too large": ("frame", FRAME | {"width": HUGE}),
    "a camera too large": ("camera", FRAME | {"poses": [POSE], "width": HUGE}),
    "a lens too large": ("lens", {"model": "pinhole", "fit": [HUGE, 1]}),
    "no such lens": ("lens", {"id": -HUGE}),
    "no such photograph": ("photo", {"view": HUGE, "side": 8}),
}
FOREIGN: dict[str, dict[str, str]] = {  # of a row: headers, refused with status 403
    "another host": {"Host": "evil.example"},
    "another port": {"Host": "127.0.0.1:1"},
    "another origin": {"Origin": "http://evil.example"},
    "no origin": {"Origin": "null"},
}


def list_requests() -> Iterator[tuple[str, str]]:
    """Lists the kind and title of each row."""
    fields = (f"fields of {route}" for route in GOOD)
    for name in (*WRONG, *FOREIGN, *fields, "the wrong token, without its body", "100 clients"):
        yield "request", f"request: {name}"


def send_requests(title: str, world: Path) -> str | None:
    """Serves a scene of the world, sends the requests of a row and returns the fault, if any."""
    from gsut.view import Session, ViewServer, open_stage

    name = title.removeprefix("request: ")
    session = Session(open_stage(world / "scenes" / "a.ply"))
    with ViewServer(session.routes) as server:
        if session.routes.keys() != GOOD.keys():
            return "the routes are not those of GOOD"
        good = _send(server, "frame", FRAME)
        if good[0] != 200:
            return f"a good request is refused: {good}"
        if name in WRONG:
            found, wanted = [_send(server, *WRONG[name])], 400
        elif name in FOREIGN:
            found, wanted = [_send(server, "frame", FRAME, FOREIGN[name])], 403
        elif name.startswith("fields of "):
            route = name.removeprefix("fields of ")
            shape = getattr(session.routes[route], "shape", {})
            found, wanted = [], 200
            for values in _replace_fields(GOOD[route], shape):
                if fault := _find_fault(server, route, values):
                    return f"{values[:200]}: {fault}"
        elif name == "100 clients":
            with ThreadPoolExecutor(CLIENTS) as clients:
                found = list(clients.map(lambda _: _send(server, "frame", FRAME), range(CLIENTS)))
            wanted = 200
        else:
            found, wanted = [_send(server, "frame", {}, {"Content-Length": "99"}, "/wrong")], 403
        for status, content in found:
            if status != wanted:
                return f"status {status}, not {wanted}: {content[:100]!r}"
            if wanted != 200 and "\n" in json.loads(content)["error"]:
                return f"more than one sentence: {content!r}"
        again = _send(server, "frame", FRAME)
        return None if again == good else f"then a good request is answered otherwise: {again[0]}"


def _replace_fields(good: dict[str, Any], shape: dict[str, Any]) -> Iterator[str]:
    """Yields a request without each of its fields, and with each wrong value in its place."""
    texts = {key: json.dumps(value) for key, value in good.items()}
    for key in (name.rstrip("?") for name in shape):
        others = {name: text for name, text in texts.items() if name != key}
        for changed in (others, *(others | {key: wrong} for wrong in WRONG_VALUES)):
            yield "{" + ", ".join(f'"{name}": {text}' for name, text in changed.items()) + "}"


def _find_fault(server: Any, route: str, values: str) -> str | None:
    """Returns what is wrong with the answer to a request that may be wrong."""
    begin = time.monotonic()
    status, content = _send(server, route, values)
    if time.monotonic() - begin > SLOWEST:
        return f"answered after {time.monotonic() - begin:.0f} s"
    if status == 200:
        return None
    sentence = json.loads(content)["error"]
    is_clear = status == 400 and "\n" not in sentence and "cannot be understood" not in sentence
    return None if is_clear else f"status {status}: {sentence[:200]}"


def _send(
    server: Any, route: str, values: Any, headers: dict[str, str] | None = None, token: str = ""
) -> tuple[int, bytes]:
    """Sends one request and returns status and content."""
    connection = http.client.HTTPConnection(server.host, server.port, timeout=30)
    path = f"{token or '/' + server.token}/{route}"
    text = values if isinstance(values, str) else json.dumps(values)
    connection.request("POST", path, text, headers or {})
    reply = connection.getresponse()
    content = reply.read()
    connection.close()
    return reply.status, content
