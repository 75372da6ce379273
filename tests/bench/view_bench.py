"""`./run bench view`: frames a second of the viewer, encoded and over the wire."""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import math
import time
from typing import Any

import cv2
import numpy as np

from gsut import _core
from gsut._core import InputError, exp_pose
from gsut.cli._flags import add_json, print_json
from gsut.gaussians import pack_harmonics
from gsut.render import psnr, render, to_uint8
from gsut.view import LOOPBACK, Session, Stage, ViewServer
from tests.bench.scenes import BenchScene, make_scene

HELP = "frames a second of the viewer, encoded and over the wire"
_SCENES = "synthetic_100k_640x480,synthetic_1m_640x480"
# Twist of the eye from frame to frame: a slow walk in a room of 5 to 10 m.
_STEP = np.array([0.01, 0.0, 0.01, 0.0, 0.01, 0.0])
_QUALITY = 75  # of the JPEG, as the page asks for while it moves
# Of the image's sides and of the Gaussians; the page asks for less while frames come late.
_STEPS = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5))


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenes", default=_SCENES, metavar="A,B", help=f"[default {_SCENES}]")
    parser.add_argument("--frames", type=int, default=60, metavar="N", help="[default 60]")
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="0 = all [default 0]")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    if arguments.frames < 2:
        raise InputError(f"--frames must be at least 2, found {arguments.frames}")
    _core.set_num_threads(arguments.threads)
    rows = [row for name in arguments.scenes.split(",") for row in measure(name, arguments.frames)]
    if arguments.json:
        print_json(rows)
        return 0
    for row in rows:
        print(
            f"{row['scene']}, at {row['scale']:g} of the size, {100 * row['share']:.0f} % of the "
            f"Gaussians: {row['frames_per_second']:.1f} frames/s, slowest "
            f"{row['slowest_ms']:.0f} ms, {row['cpu_ms']:.0f} ms of processor time and "
            f"{row['kilobytes']:.0f} kB a frame, {row['threads']} threads; "
            f"{_likeness(row['psnr'])}"
        )
    return 0


def _likeness(decibels: float) -> str:
    return (
        "the renderer's bits"
        if math.isinf(decibels)
        else f"{decibels:.1f} dB against the whole frame"
    )


class _Page:
    """Asks as the page does: one connection, one frame at a time."""

    def __init__(self, server: ViewServer, scene: BenchScene, lens: int) -> None:
        self._connection = http.client.HTTPConnection(LOOPBACK, server.port, timeout=600)
        self._path = f"/{server.token}/frame"
        self._lens, self._size = lens, np.array([scene.camera.width, scene.camera.height])

    def close(self) -> None:
        self._connection.close()

    def ask(self, pose: np.ndarray, quality: int | None, scale: float, share: float) -> bytes:
        width, height = (round(scale * side) for side in self._size)
        asked = {
            "lens": self._lens, "width": width, "height": height, "pose": pose.ravel().tolist(),
            "quality": quality, "share": share,
        }  # fmt: skip
        self._connection.request("POST", self._path, json.dumps(asked))
        reply = self._connection.getresponse()
        data = reply.read()
        if reply.status != 200:
            raise InputError(data.decode())
        return data

    def picture(self, pose: np.ndarray, scale: float, share: float) -> np.ndarray:
        """At the shown size, as the page enlarges it."""
        data = np.frombuffer(self.ask(pose, None, scale, share), np.uint8)
        drawn = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        return cv2.resize(drawn, self._size.tolist(), interpolation=cv2.INTER_LINEAR)


def measure(name: str, frames: int) -> list[dict[str, Any]]:
    """Walks through a scene, whole and as the page asks for it while frames come late.

    Raises:
        InputError: the lossless frame differs from the renderer's: a wrong frame has no speed.
    """
    scene = make_scene(name)
    session = Session(Stage(name, "file", pack_harmonics(scene.gaussians)))
    start = np.asarray(scene.camera_from_world)
    whole = to_uint8(render(scene.gaussians, scene.camera, start).image)
    rows = []
    lens = session.lenses.add(scene.camera)
    with (
        ViewServer(session.routes) as server,
        contextlib.closing(_Page(server, scene, lens)) as page,
    ):
        for scale, share in _STEPS:
            found = page.picture(start, scale, share)
            if scale == share == 1 and not np.array_equal(found, whole):
                raise InputError(f"{name}: the lossless frame is not the renderer's")
            page.ask(start, _QUALITY, scale, share)
            pose, size, times = start, 0, [time.perf_counter()]
            cpu = time.process_time()
            for _ in range(frames):
                pose = exp_pose(_STEP) @ pose
                size += len(page.ask(pose, _QUALITY, scale, share))
                times.append(time.perf_counter())
            cpu = time.process_time() - cpu
            rows.append({
                "scene": name, "scale": scale, "share": share, "threads": _core.num_threads(),
                "frames_per_second": frames / (times[-1] - times[0]),
                "slowest_ms": 1e3 * max(np.diff(times)), "cpu_ms": 1e3 * cpu / frames,
                "kilobytes": size / 1e3 / frames, "psnr": psnr(found / 255.0, whole / 255.0),
            })  # fmt: skip
    return rows
