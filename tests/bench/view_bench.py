"""`./run bench view`: frames a second of the viewer, encoded and over the wire."""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import time
from collections.abc import Iterator

import cv2
import numpy as np

from gsut._core import InputError, exp_pose
from gsut.metrics import psnr
from gsut.render import render, to_uint8
from gsut.view import Session, ViewServer
from gsut.view.server import LOOPBACK
from gsut.view.stage import Stage
from tests.bench.harness import WRONG, Benchmark, Column, Option, Row, Settings
from tests.bench.scenes import BenchScene, scene_from_arrays

# Twist of the eye from frame to frame: a slow walk in a room of 5 to 10 m.
_STEP = np.array([0.01, 0.0, 0.01, 0.0, 0.01, 0.0])
_QUALITY = 75  # of the JPEG, which the page requests while it moves
# Of the image's sides and of the Gaussians; the page requests less while frames come late.
_REQUESTS = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5))
_TIMEOUT_SECONDS = 600


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists scenes, whole and as the page requests them while frames come late."""
    for scene in settings.scenes:
        for scale, share in _REQUESTS:
            text = f"{scale:g} of the size, {100 * share:.0f} % of the Gaussians"
            yield {"scene": scene, "drawn": text, "_scale": scale, "_share": share}


def measure(case: Row, settings: Settings) -> Row:
    """Walks through a scene; the whole lossless frame must have the renderer's bits."""
    scene, frames = scene_from_arrays(case["scene"]), max(2, settings.frames)
    scale, share = case["_scale"], case["_share"]
    session = Session(Stage(case["scene"], "file", scene.gaussians))
    start = np.asarray(scene.camera_from_world)
    whole = to_uint8(render(scene.gaussians, scene.camera, start).image)
    lens = session.lenses.add(scene.camera)
    with (
        ViewServer(session.routes) as server,
        contextlib.closing(_Page(server, scene, lens)) as page,
    ):
        found = page.show_frame(start, scale, share)
        if scale == share == 1 and not np.array_equal(found, whole):
            return {WRONG: "the lossless frame is not the renderer's"}
        page.request_frame(start, _QUALITY, scale, share)
        pose, size, times = start, 0, [time.perf_counter()]
        cpu = time.process_time()
        for _ in range(frames):
            pose = exp_pose(_STEP) @ pose
            size += len(page.request_frame(pose, _QUALITY, scale, share))
            times.append(time.perf_counter())
        cpu = time.process_time() - cpu
    decibels = psnr(found / 255.0, whole / 255.0)
    return {
        "frames_per_second": frames / (times[-1] - times[0]),
        "slowest_ms": 1e3 * max(np.diff(times)),
        "cpu_ms": 1e3 * cpu / frames,
        "kilobytes": size / 1e3 / frames,
        "psnr": None if math.isinf(decibels) else decibels,
    }


class _Page:
    """Requests frames as the page does: one connection, one frame at a time."""

    def __init__(self, server: ViewServer, scene: BenchScene, lens: int) -> None:
        self._connection = http.client.HTTPConnection(
            LOOPBACK, server.port, timeout=_TIMEOUT_SECONDS
        )
        self._path = f"/{server.token}/frame"
        self._lens, self._size = lens, np.array([scene.camera.width, scene.camera.height])

    def close(self) -> None:
        self._connection.close()

    def request_frame(
        self, pose: np.ndarray, quality: int | None, scale: float, share: float
    ) -> bytes:
        width, height = (round(scale * side) for side in self._size)
        wanted = {
            "lens": self._lens, "width": width, "height": height, "pose": pose.ravel().tolist(),
            "quality": quality, "share": share,
        }  # fmt: skip
        self._connection.request("POST", self._path, json.dumps(wanted))
        reply = self._connection.getresponse()
        data = reply.read()
        if reply.status != 200:
            raise InputError(data.decode())
        return data

    def show_frame(self, pose: np.ndarray, scale: float, share: float) -> np.ndarray:
        """Enlarges a lossless frame to the shown size, as the page does."""
        data = np.frombuffer(self.request_frame(pose, None, scale, share), np.uint8)
        drawn = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        return cv2.resize(drawn, self._size.tolist(), interpolation=cv2.INTER_LINEAR)


BENCHMARK = Benchmark(
    help="frames a second of the viewer, encoded and over the wire",
    columns=(
        Column("scene"),
        Column("drawn"),
        Column("frames_per_second", "frames per second", form=".1f"),
        Column("slowest_ms", "slowest frame", "ms", ".0f"),
        Column("cpu_ms", "a frame", "CPU-ms", ".0f"),
        Column("kilobytes", "a frame", "kB", ".0f"),
        Column("psnr", "against the whole frame", "dB", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option(
            "scenes", ("synthetic_100k_640x480", "synthetic_1m_640x480"), "as of ./run bench render"
        ),
        Option("frames", 60, "of each walk"),
    ),
)
