"""The server: who is answered, what is refused in a sentence, and its end."""

import concurrent.futures
import functools
import http.client
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import gsut
from gsut.view import Session, ViewServer, open_stage
from gsut.view.server import LOOPBACK, _is_own_name
from random_scenes import fisheye, gaussians_in_view, rng_of

END_SECONDS = 1.0  # after Ctrl-C


@pytest.fixture(scope="module")
def ply(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "small.ply"
    gsut.formats.save_ply(path, gaussians_in_view(rng_of("view"), fisheye(), np.eye(4), 200))
    return path


@pytest.fixture(scope="module")
def server(ply):
    with ViewServer(Session(open_stage(ply)).routes) as server:
        yield server


def ask(server, path, values=None, headers=None):
    connection = http.client.HTTPConnection(LOOPBACK, server.port, timeout=30)
    body = values if isinstance(values, str | None) else json.dumps(values)
    connection.request("GET" if values is None else "POST", path, body, headers or {})
    reply = connection.getresponse()
    data = reply.read()
    connection.close()
    return reply, data


def sentence(data):
    return json.loads(data)["error"]


def frame(**changes):
    return {"pose": np.eye(4).ravel().tolist(), "lens": 0, "width": 8, "height": 6, **changes}


def test_address_has_a_token_of_its_own_on_the_loopback(server, ply):
    assert server.address == f"http://{LOOPBACK}:{server.port}/{server.token}/"
    assert len(server.token) >= 20
    with ViewServer(Session(open_stage(ply)).routes) as other:
        assert other.token != server.token


@pytest.mark.parametrize("path", ["/", "/scene", "/wrong/", "/wrong/scene", "//scene"])
def test_wrong_token_is_refused_in_a_sentence(server, path):
    reply, data = ask(server, path)
    assert reply.status == 403
    assert sentence(data) == "wrong token: open the address that gsut view printed"


@pytest.mark.parametrize(
    ("length", "body", "status"),
    [("-5", None, 413), ("many", None, 413), ("9" * 30, None, 413), (None, "[" * 100_000, 400)],
)
def test_a_request_of_no_length_or_no_sense_is_answered(server, length, body, status):
    headers = {} if length is None else {"Content-Length": length}
    reply, data = ask(server, f"/{server.token}/frame", body or "{}", headers)
    assert reply.status == status and sentence(data)


def test_a_request_in_chunks_is_refused_in_a_sentence(server):
    headers = {"Transfer-Encoding": "chunked"}
    reply, data = ask(server, f"/{server.token}/frame", "2\r\n{}\r\n0\r\n\r\n", headers)
    assert reply.status == 411 and "Content-Length" in sentence(data)


def test_foreign_host_name_is_refused(server):
    reply, data = ask(server, f"/{server.token}/scene", headers={"Host": "evil.example"})
    assert reply.status == 403
    assert "loopback" in sentence(data)


@pytest.mark.parametrize(
    ("name", "kind"), [("", "html"), ("view.js", "javascript"), ("view.css", "css")]
)
def test_page_is_complete_and_asks_nobody_else(server, name, kind):
    reply, data = ask(server, f"/{server.token}/{name}")
    assert reply.status == 200
    assert kind in reply.headers["Content-Type"]
    assert b"http://" not in data and b"https://" not in data
    assert reply.headers["Content-Security-Policy"].startswith("default-src 'self'")


@pytest.mark.parametrize("name", ["nothing", "view.py", "..%2fserver.py", "stage.py"])
def test_other_files_are_not_served(server, name):
    reply, data = ask(server, f"/{server.token}/{name}")
    assert reply.status == 404
    assert "there is no" in sentence(data)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("frame", {}, "frame lacks 'lens'"),
        ("frame", frame(pose=[1.0] * 16), "the frame's pose"),
        ("frame", frame(lens=99), "no lens 99"),
        ("frame", frame(mode="x-ray"), "no mode 'x-ray'; known: color, distance"),
        ("frame", frame(width=0), "0 x 6 cannot be drawn"),
        ("frame", frame(width=10**6, height=10**6), "cannot be drawn"),
        ("frame", frame(view=0), "no such photograph"),
        ("frame", frame(mode="error"), "needs a photograph"),
        ("lens", {"model": "monocle"}, "no lens model 'monocle'; known: brown_conrady"),
        ("lens", {"model": "pinhole", "params": [-1, 1, 1, 1]}, "pinhole"),
        (
            "lens",
            {"model": "pinhole", "params": []} | {"field_of_view": 200},
            "cannot span 200",
        ),
        ("lens", {"path": "/no/lens.yaml"}, "no such lens file"),
        ("lens", {"name": "a.yaml", "base64": "bm90OiBhIGxlbnM="}, "a.yaml: "),
        ("lens", {"name": "a.yaml", "base64": "abc"}, "cannot be understood"),
        ("photo", {"view": 0, "side": 8}, "no photographs here"),
        ("pick", {}, "pick lacks 'frame'"),
        ("pick", {"frame": frame(), "pixel": [float("nan"), 1]}, "pick['pixel'] is [nan, 1]"),
        ("pick", {"frame": [], "pixel": [1, 1]}, "pick['frame'] is []"),
        ("frame", frame(width=float("inf")), "frame['width'] is inf, which the page"),
        ("frame", frame(width=1, height=33_000_000), "cannot be drawn"),
        ("frame", frame(marks=[[0, 0, 0]] * 1001), "at most 1000 points"),
        ("camera", {"poses": [], "lens": 0, "width": 10**9, "height": 1}, "cannot be drawn"),
        (
            "camera",
            {"poses": [[0] * 16] * 20_001, "lens": 0, "width": 1, "height": 1},
            "most 20000",
        ),
        ("lens", {"id": 99}, "no lens 99"),
        ("lens", {"model": "kannala_brandt", "params": [1.0] * 10**6}, "8 parameters, found"),
        ("lens", {"model": "pinhole", "fit": [10**12, 1]}, "cannot be drawn"),
        ("lens", {"model": "pinhole", "field_of_view": 1e999}, "field"),
    ],
)
def test_bad_request_is_refused_in_a_sentence(server, name, values, words):
    reply, data = ask(server, f"/{server.token}/{name}", values)
    assert reply.status == 400
    assert words in sentence(data)
    assert "\n" not in sentence(data)


def test_failure_of_a_route_is_told_and_the_server_goes_on():
    def broken(values):
        raise RuntimeError("out of paper")

    with ViewServer({"broken": broken}) as server:
        for _ in range(2):
            reply, data = ask(server, f"/{server.token}/broken")
            assert reply.status == 500
            assert sentence(data) == "broken failed: RuntimeError('out of paper')"


def test_no_json_is_refused(server):
    reply, data = ask(server, f"/{server.token}/frame", "[1")
    assert (reply.status, sentence(data)) == (400, "the request is not a JSON object")


def test_port_in_use_is_refused_in_a_sentence(server, ply):
    with pytest.raises(
        gsut.InputError, match=r"cannot listen on 127\.0\.0\.1:\d+ \(.*give another"
    ):
        ViewServer({}, LOOPBACK, server.port)


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "no such file or folder"), (b"x", "PLY")],
)
def test_scene_that_cannot_be_read_is_refused(tmp_path, content, words):
    path = tmp_path / "a.ply"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(gsut.InputError, match=words):
        open_stage(path)


def test_control_c_ends_the_command_within_a_second(ply):
    command = [sys.executable, "-m", "gsut", "view", str(ply), "--serve", "127.0.0.1:0"]
    listening = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # nohup's do not
    seconds = []
    while len(seconds) < 4 and min(seconds, default=END_SECONDS) >= END_SECONDS:  # a busy machine
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=listening
        ) as one:
            line = one.stdout.readline()
            assert line.startswith(f"gsut view: http://{LOOPBACK}:")
            assert line.endswith("/ (Ctrl-C ends it)\n")
            began = time.monotonic()
            one.send_signal(signal.SIGINT)
            assert one.wait(60) == 0
            seconds.append(time.monotonic() - began)
            assert one.stderr.read() == ""
    assert min(seconds) < END_SECONDS


def test_hundred_clients_at_once_are_all_served(server):
    with concurrent.futures.ThreadPoolExecutor(100) as clients:
        paths = [f"/{server.token}/frame"] * 100
        found = list(clients.map(lambda path: ask(server, path, frame()), paths))
    assert [reply.status for reply, _ in found] == [200] * 100


def test_body_is_read_only_after_the_token(server):
    connection = http.client.HTTPConnection(LOOPBACK, server.port, timeout=5)
    connection.putrequest("POST", "/wrong/frame")
    connection.putheader("Content-Length", "1000")
    connection.endheaders()  # and no body
    assert connection.getresponse().status == 403
    connection.close()


@pytest.mark.parametrize(
    ("origin", "status"),
    [("http://evil.example", 403), ("null", 403), ("http://{host}", 200)],
)
def test_pages_of_other_origins_are_refused(server, origin, status):
    host = f"{LOOPBACK}:{server.port}"
    headers = {"Origin": origin.format(host=host)}
    assert ask(server, f"/{server.token}/frame", frame(), headers)[0].status == status


@pytest.mark.parametrize(
    ("listens", "name", "own"),
    [
        (LOOPBACK, "localhost:80", True),
        (LOOPBACK, "192.168.0.2:80", False),
        ("0.0.0.0", "192.168.0.2:80", True),
        ("0.0.0.0", "evil.example:80", False),
        ("0.0.0.0", "127.0.0.1:81", False),
        ("::", "[fe80::1]:80", True),
        ("desk.example", "Desk.example:80", True),
        ("desk.example", "", False),
    ],
)
def test_host_is_checked_for_every_address_listened_on(listens, name, own):
    assert _is_own_name(name, listens, 80) is own
