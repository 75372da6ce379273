"""Shows a scene from its first moment on: pictures, cameras and points, drafts, the training."""

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
from gsut.files import read_picture
from gsut.run import TrainOptions
from gsut.sfm.solution import Solution
from gsut.view.draft import Draft, can_draft
from gsut.view.live import LiveTraining
from gsut.view.server import Reply, Route

# Least seconds between two looks at the poses while they are found: a look takes milliseconds.
_LOOK_SECONDS = 0.7
# Most points that the page draws itself, before there are Gaussians.
_MOST_POINTS = 12_000
# Factor on the number of images with a pose from which a new draft replaces the last one.
_DRAFT_GROWTH = 1.8


class LiveScene:
    """Answers the page while a scene is made, and hands it on to what can be looked at by then.

    It is the `watcher` of `gsut.scene`. First the page draws cameras and points itself; then it
    shows drafts, trainings on the poses found so far, and finally the training itself, which starts
    from nothing: its bits are those of a scene that nobody looks at.

    Args:
        name: of the scene, for people.
        drafts: train drafts while poses are found. They take processor time from the poses.

    Attributes:
        routes: for a `ViewServer`; they change as the scene is made.
    """

    def __init__(self, name: str, drafts: bool = True) -> None:
        self.routes: dict[str, Route] = {
            "scene": self._describe_scene, "making": self._report, "picture": self._send_picture,
        }  # fmt: skip
        self._name, self._drafts = name, drafts
        self._row: dict[str, Any] = {"stage": "", "share": 0.0, "seconds_left": 0.0, "text": ""}
        self._pictures: dict[str, Path] = {}
        self._masks: dict[str, Path] = {}
        self._found: dict[str, Any] | None = None  # cameras and points, as the page takes them
        self._version = 0  # of `_found`
        self._shown = 0  # drafts and trainings that the page could show so far
        self._looked = -_LOOK_SECONDS
        self._draft: Draft | None = None
        self._drafted = 0  # images of the last draft
        self._live: LiveTraining | None = None
        self._lock = threading.Lock()

    def show_progress(self, row: dict[str, Any]) -> None:
        """Takes the state of the whole command; see `gsut.scene`."""
        self._row = row

    def show_pictures(
        self, pictures: Mapping[str, Path], masks: Mapping[str, Path] | None = None
    ) -> None:
        """Takes the files of the pictures that were chosen, and of their masks, by name."""
        self._pictures, self._masks = dict(pictures), dict(masks or {})

    def show_capture(self, folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
        """Takes the rows of a capture's figures, with paths relative to its folder."""
        masks = {row["name"]: folder / row["mask"] for row in rows if row.get("mask")}
        self.show_pictures({row["name"]: folder / row["path"] for row in rows}, masks)

    def show_poses(self, look: Callable[[], Solution]) -> None:
        """Takes a function that returns poses and points so far, and calls it if it is time."""
        if time.monotonic() - self._looked < _LOOK_SECONDS:
            return
        solution = look()
        self._looked = time.monotonic()
        with self._lock:
            self._found, self._version = _describe_solution(solution), self._version + 1
        count = solution.num_registered
        if self._drafts and can_draft(solution) and count >= _DRAFT_GROWTH * self._drafted:
            if self._draft is not None and self._draft.is_training():
                return
            self._drafted = count
            self._draft = Draft(solution, self._pictures, self._masks, self._show_live)

    def begin_training(self, scene: Scene, options: TrainOptions) -> Callable[..., bool]:
        """Shows a training; returns the `watch` of `gsut.train`."""
        self.stop_draft()
        self._drafts = False
        self._live = LiveTraining(scene, options)
        self._show_live(self._live, False)
        return self._live.watch

    def finish(self, gaussians: Any) -> None:
        """Marks the training as finished; its Gaussians can still be looked at."""
        if self._live is not None:
            self._live.finish(gaussians)
        self._row = {**self._row, "stage": "finished", "share": 1.0, "seconds_left": 0.0}

    def stop_draft(self) -> None:
        """Ends the training of the draft, if there is one, and waits for it."""
        if self._draft is not None:
            self._draft.stop()
            self._draft = None

    def _show_live(self, live: LiveTraining, is_draft: bool) -> None:
        """Makes the page show a training from now on."""
        session = live.session

        def describe(values: dict[str, Any]) -> Reply:
            content = session.describe_scene(values).content
            # Of `gsut train` the page shows nothing but the training.
            made = {"draft": is_draft, "shown": number} if self._pictures else {}
            return Reply({**content, "name": self._name, **made})

        with self._lock:
            self._shown += 1
            number = self._shown
            self.routes.update({**session.routes, "scene": describe})

    def _describe_scene(self, _: dict[str, Any]) -> Reply:
        return Reply({"name": self._name, "kind": "making", "shown": 0})

    def _report(self, values: dict[str, Any]) -> Reply:
        """Returns what is being done and, if they are newer than "version", cameras and points."""
        with self._lock:
            content = {
                **self._row, "pictures": list(self._pictures), "shown": self._shown,
                "version": self._version,
            }  # fmt: skip
            if self._found is not None and int(values.get("version", 0)) < self._version:
                content["found"] = self._found
        return Reply(content)

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
