"""Shows a scene from its first moment on: pictures, cameras and points, the training."""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.data import Scene
from gsut.data.poses import invert_pose
from gsut.files import Number, read_picture
from gsut.run import TrainOptions
from gsut.sfm.solution import Solution
from gsut.view.live import LiveTraining
from gsut.view.server import Reply, Route, declare_values

# Least seconds between two looks at the poses while they are found: a look takes milliseconds.
_LOOK_SECONDS = 0.7
# Most points that the page draws itself, before there are Gaussians.
_MOST_POINTS = 12_000


class LiveScene:
    """Answers the page while a scene is made, and hands it on to what can be looked at by then.

    It is the `watcher` of `gsut.scene`. First the page draws cameras and points itself, then it
    shows the training, whose bits are those of a scene that nobody looks at.

    Args:
        name: of the scene, for people.

    Attributes:
        routes: for a `ViewServer`; they change as the scene is made.
    """

    def __init__(self, name: str) -> None:
        self.routes: dict[str, Route] = {
            "scene": self._describe_scene, "making": self._report, "picture": self._send_picture,
        }  # fmt: skip
        self._name = name
        self._row: dict[str, Any] = {"stage": "", "share": 0.0, "seconds_left": 0.0, "text": ""}
        self._pictures: dict[str, Path] = {}
        self._found: dict[str, Any] | None = None  # cameras and points, as the page takes them
        self._version = 0  # of `_found`
        self._shown = 0  # trainings that the page could show so far
        self._looked = -_LOOK_SECONDS
        self._live: LiveTraining | None = None
        self._lock = threading.Lock()

    def show_progress(self, row: dict[str, Any]) -> None:
        """Takes the state of the whole command; see `gsut.scene`."""
        self._row = row

    def show_pictures(self, pictures: Mapping[str, Path]) -> None:
        """Takes the files of the pictures that were chosen, by name."""
        self._pictures = dict(pictures)

    def show_capture(self, folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
        """Takes the rows of a capture's figures, with paths relative to its folder."""
        self.show_pictures({row["name"]: folder / row["path"] for row in rows})

    def show_poses(self, look: Callable[[], Solution]) -> None:
        """Takes a function that returns poses and points so far, and calls it if it is time."""
        if time.monotonic() - self._looked < _LOOK_SECONDS:
            return
        solution = look()
        self._looked = time.monotonic()
        with self._lock:
            self._found, self._version = _describe_solution(solution), self._version + 1

    def begin_training(self, scene: Scene, options: TrainOptions) -> Callable[..., bool]:
        """Shows a training; returns the `watch` of `gsut.train`."""
        self._live = LiveTraining(scene, options)
        self._show_training(self._live)
        return self._live.watch

    def finish(self, gaussians: Any) -> None:
        """Marks the training as finished; its Gaussians can still be looked at."""
        if self._live is not None:
            self._live.finish(gaussians)
        self._row = {**self._row, "stage": "finished", "share": 1.0, "seconds_left": 0.0}

    def _show_training(self, live: LiveTraining) -> None:
        """Makes the page show a training from now on."""
        session = live.session

        def describe(values: dict[str, Any]) -> Reply:
            content = session.describe_scene(values).content
            # Of `gsut train` the page shows nothing but the training.
            made = {"shown": number} if self._pictures else {}
            return Reply({**content, "name": self._name, **made})

        with self._lock:
            self._shown += 1
            number = self._shown
            self.routes.update({**session.routes, "scene": describe})

    def _describe_scene(self, _: dict[str, Any]) -> Reply:
        return Reply({"name": self._name, "kind": "making", "shown": 0})

    @declare_values({"version?": Number(whole=True)})
    def _report(self, values: dict[str, Any]) -> Reply:
        """Returns what is being done and, if they are newer than "version", cameras and points."""
        with self._lock:
            content = {
                **self._row, "pictures": list(self._pictures), "shown": self._shown,
                "version": self._version,
            }  # fmt: skip
            if self._found is not None and values.get("version", 0) < self._version:
                content["found"] = self._found
        return Reply(content)

    @declare_values({"name": str})
    def _send_picture(self, values: dict[str, Any]) -> Reply:
        """Returns a small JPEG of the picture with this "name"."""
        import cv2

        path = self._pictures.get(values["name"])
        small = None if path is None else read_picture(path, cv2.IMREAD_REDUCED_COLOR_8)
        if small is None:
            raise FileNotFoundError(values["name"])
        return Reply(cv2.imencode(".jpg", small)[1].tobytes(), "image/jpeg", keep=True)


def _describe_solution(solution: Solution) -> dict[str, Any]:
    """Describes cameras and points for the page, which draws them itself."""
    poses = solution.camera_from_world[solution.registered]
    world_from_camera = np.array([invert_pose(pose) for pose in poses]).reshape(-1, 4, 4)
    step = max(1, -(-len(solution.points) // _MOST_POINTS))
    points = solution.points[::step].astype("<f4")
    return {
        "cameras": world_from_camera[:, :3].reshape(len(poses), 12),
        "images": len(solution.names), "num_points": len(solution.points),
        "points": base64.b64encode(points.tobytes()).decode(),
        "colors": base64.b64encode(solution.colors[::step].tobytes()).decode(),
    }  # fmt: skip
