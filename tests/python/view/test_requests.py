"""Requests of every wrong kind: each is answered, in a sentence where it is wrong, and soon."""

import concurrent.futures
import contextlib
import json
import socket
import time

import numpy as np
import pytest
from test_server import ask, sentence

import gsut
import small_run
from gsut.view import LiveTraining, Session, ViewServer
from gsut.view import server as server_module
from gsut.view.server import LOOPBACK
from gsut.view.stage import Stage
from held_frames import hold_frames
from random_scenes import gaussians_in_view, rng_of

SECONDS = 20.0  # for any answer, on a busy machine
WRONG = (
    None, True, -1, 0, 7, 1e-300, 1e300, -1e300, 1e39, 10**400, float("nan"), float("inf"), "", "x",
    "\ud800", "../x", "\0", [], {}, [[]], [None], ["x"], [1e300] * 3, [0, 0, 0], [1e300] * 16,
    [float("nan")] * 16, {"x": 1}, [[1, 2], [3]], "9" * 5000,
)  # fmt: skip


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    scene = small_run.scene_from_arrays(tmp_path_factory.mktemp("requests"))
    pose = scene.views[0].camera_from_world
    gaussians = gaussians_in_view(rng_of("requests"), small_run.FISHEYE, pose, 100)
    return Stage("small", "run", gaussians, scene, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def server(stage):
    control = LiveTraining(stage.scene, gsut.TrainOptions(steps=1)).session.routes["training"]
    with ViewServer(Session(stage, training=control).routes) as server:
        yield server


def make_requests(pose):
    pose = np.ravel(pose).tolist()
    frame = {
        "pose": pose, "lens": 0, "width": 48, "height": 48, "mode": "color", "view": 0,
        "shutter": None, "layers": ["cameras", "points", "domain"],
        "marks": [[0, 0, 0], [1, 1, 1]], "quality": 90, "share": 0.5, "turns": 0,
    }  # fmt: skip
    at = {key: frame[key] for key in ("pose", "lens", "width", "height", "turns")}
    step = {"do": "select", "frame": at, "points": [[1, 1], [9, 1], [9, 9]], "front": True}
    return {
        "scene": {}, "frame": frame, "photo": {"view": 0, "side": 8, "mask": True},
        "lens": {"model": "pinhole", "id": 0, "params": [500.0, 500.0], "fit": [16, 12],
                 "field_of_view": 60.0},
        "pick": {"frame": frame, "pixel": [3, 3]},
        "camera": {"poses": [pose], "turns": 0, "width": 16, "height": 12, "lens": 0},
        "findings": {}, "edits": {"steps": [step]}, "edits.json": {"steps": [step]},
        "training": {"action": "pause"},
    }  # fmt: skip


def replace_each(values, wrong):
    """Yields the values with one of them, at any depth of objects, replaced or left out."""
    for key, value in values.items():
        yield {k: v for k, v in values.items() if k != key}
        yield from ({**values, key: other} for other in wrong)
        if isinstance(value, dict):
            yield from ({**values, key: inner} for inner in replace_each(value, wrong))
        if isinstance(value, list) and value:
            yield from ({**values, key: [other, *value[1:]]} for other in wrong)
            if isinstance(value[0], dict):
                yield from ({**values, key: [inner]} for inner in replace_each(value[0], wrong))


@pytest.mark.parametrize("name", list(make_requests(np.eye(4))))
def test_request_with_a_wrong_value_is_answered(server, stage, name):
    values = make_requests(stage.scene.views[0].camera_from_world)[name]
    first, data = ask(server, f"/{server.token}/{name}", values)
    assert first.status == 200 or name == "film.file", data
    count = 0
    for wrong in replace_each(values, WRONG):
        begin = time.monotonic()
        reply, data = ask(server, f"/{server.token}/{name}", wrong)
        if name == "film":
            ask(server, f"/{server.token}/film", {"stop": True})
        assert reply.status in (200, 400, 404), (wrong, data)
        assert reply.status == 200 or (sentence(data) and "\n" not in sentence(data))
        assert b"cannot be understood" not in data or "base64" in wrong, (wrong, data)
        assert time.monotonic() - begin < SECONDS
        count += 1
    assert count >= (len(WRONG) + 1) * len(values)


@contextlib.contextmanager
def connect(server):
    with socket.create_connection((LOOPBACK, server.port), timeout=30) as connection:
        yield connection


def receive(connection) -> bytes:
    """All that a connection sends until it ends."""
    parts = []
    with contextlib.suppress(ConnectionError):
        while part := connection.recv(1 << 16):
            parts.append(part)
    return b"".join(parts)


@pytest.fixture
def quick(monkeypatch):
    """A server that waits a quarter of a second for a head, and answers four at once."""
    monkeypatch.setattr(server_module, "_HEAD_SECONDS", 0.25)
    monkeypatch.setattr(server_module, "_MOST_OPEN", 4)
    large = b"x" * (32 << 20)
    with ViewServer({"large": lambda _: server_module.Reply(large, "text/plain")}) as server:
        yield server


@pytest.mark.parametrize("header", [b"a: " + b"x" * 65_000 + b"\r\n", b"a: b\r\n" * 10_000])
def test_long_headers_are_refused_before_they_are_read(server, header):
    with connect(server) as connection, contextlib.suppress(ConnectionError):
        connection.sendall(b"GET /wrong/ HTTP/1.1\r\n" + header)
        answer = receive(connection)
        assert not answer or b" 431 " in answer.splitlines()[0]
    assert ask(server, f"/{server.token}/scene")[0].status == 200


def test_thirty_connections_of_long_headers_take_no_memory(server):
    most, header = 0, b"a: " + b"x" * 65_000 + b"\r\n"
    with contextlib.ExitStack() as stack:
        before = read_peak()
        for _ in range(30):
            connection = stack.enter_context(connect(server))
            with contextlib.suppress(ConnectionError):
                connection.sendall(b"GET /wrong/ HTTP/1.1\r\n")
                for _ in range(90):
                    connection.sendall(header)
                    most += len(header)
        assert read_peak() - before < 64 << 20
    assert most >= 30 * len(header)


def read_peak() -> int:
    """The most memory that this process had, bytes."""
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) << 10 for line in file if line.startswith("VmHWM"))


@pytest.mark.parametrize("drip", [b"", b"x"])
def test_silent_and_slow_connections_end(quick, drip):
    begin = time.monotonic()
    with connect(quick) as connection, contextlib.suppress(ConnectionError):
        for _ in range(200 if drip else 0):
            connection.sendall(drip)
            time.sleep(0.02)
        receive(connection)
    assert time.monotonic() - begin < SECONDS


def test_more_connections_than_places_end_and_leave_the_places_free(quick):
    with contextlib.ExitStack() as stack:
        held = [stack.enter_context(connect(quick)) for _ in range(12)]
        ends = [receive(connection) for connection in held]  # of those without a place at once
        assert ends == [b""] * 12
    assert ask(quick, f"/{quick.token}/")[0].status == 200


def test_client_that_does_not_read_its_answer_holds_nobody(quick):
    body = json.dumps({"x": "y" * 100_000}).encode()
    head = f"POST /{quick.token}/large HTTP/1.1\r\nHost: {LOOPBACK}:{quick.port}\r\n"
    with connect(quick) as connection:
        connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        time.sleep(0.2)  # its answer fills the buffers on the way
        begin = time.monotonic()
        reply, data = ask(quick, f"/{quick.token}/large", {"x": "y" * 100_000})
        assert reply.status == 200 and len(data) == 32 << 20
        assert time.monotonic() - begin < SECONDS


def test_large_frame_holds_no_small_request(server, stage, monkeypatch):
    going, drawn = hold_frames(monkeypatch, lambda _, request: request.is_large, SECONDS)
    values = make_requests(stage.scene.views[0].camera_from_world)
    large = values["frame"] | {"width": 2200, "height": 2200, "layers": []}
    with concurrent.futures.ThreadPoolExecutor(1) as other:
        drawing = other.submit(ask, server, f"/{server.token}/frame", large)
        assert going.wait(SECONDS)
        for name in ("frame", "pick"):
            assert ask(server, f"/{server.token}/{name}", values[name])[0].status == 200
        assert not drawing.done()
        drawn.set()
        assert drawing.result()[0].status == 200


def test_lens_file_that_takes_long_is_given_up(server, monkeypatch):
    monkeypatch.setattr("gsut.view.lenses._READ_SECONDS", 0.01)
    reply, data = ask(server, f"/{server.token}/lens", {"name": "a.yaml", "base64": "YTogYg=="})
    assert reply.status == 400 and "a.yaml: reading it takes more than" in sentence(data)
