"""One session of the page: its routes, and who draws when."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene
from gsut.data.images import shrink_image, shrink_mask
from gsut.files import json_text
from gsut.lens import camera_models
from gsut.lens.files import values_from_camera
from gsut.view.edits import find_floaters, locate_ground, save_edited
from gsut.view.film import Film
from gsut.view.frames import MODES, FrameRequest, Frames
from gsut.view.lenses import Lenses
from gsut.view.server import Reply, Route
from gsut.view.stage import Stage

_THUMBNAIL = 160  # pixels, the longer side
_PHOTO_QUALITY = 90
_MASKED = (200, 40, 60)  # tint of what a mask leaves out
_Result = TypeVar("_Result")


class Drawing(Protocol):
    """Says when work on the Gaussians is done: at once, or between two steps of a training."""

    def __call__(self, work: Callable[[], _Result]) -> _Result: ...


class AtOnce:
    """Work is done by whoever asks, one at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def __call__(self, work: Callable[[], _Result]) -> _Result:
        with self._lock:
            return work()


class Session:
    """What the page can ask for.

    Args:
        stage: what is looked at.
        drawing: when it is drawn; None: at once.
        training: of a live training, the route that tells and steers it.
    """

    def __init__(
        self, stage: Stage, drawing: Drawing | None = None, training: Route | None = None
    ) -> None:
        self.stage = stage
        self.lenses = Lenses(stage.cameras)
        self.frames = Frames(stage, self.lenses)
        self._draw: Drawing = drawing or AtOnce()
        self._training = training
        self._film: Film | None = None
        self._notes = threading.Lock()
        self._asked = 0  # photographs, for floaters

    @property
    def routes(self) -> dict[str, Route]:
        """By name."""
        routes: dict[str, Route] = {
            "scene": self.scene, "frame": self.frame, "photo": self.photo, "lens": self.lens,
            "pick": self.pick, "camera": self.camera, "film": self.film,
            "film.file": self.film_file, "findings": self.findings, "ground": self.ground,
            "floaters": self.floaters, "save": self.save,
        }  # fmt: skip
        if self._training is not None:
            routes["training"] = self._training
        return routes

    def scene(self, _: dict[str, Any]) -> Reply:
        """All that the page needs to begin with."""
        stage, place = self.stage, self.stage.place()
        gaussians = stage.gaussians
        value = {
            "name": stage.name, "kind": stage.kind, "modes": MODES,
            "num_gaussians": 0 if gaussians is None else len(gaussians),
            "num_points": 0 if stage.scene is None else len(stage.scene.points),
            "up": self.frames.axes[1], "axes": self.frames.axes, "center": place["center"],
            "extent": place["extent"], "pose": place["pose"].ravel(),
            "lenses": [self.lenses.describe(row) for row in range(len(stage.cameras))],
            "models": {name: _core.camera_param_names(name) for name in camera_models()},
            "views": [] if stage.scene is None else _views(stage.scene),
            "figures": {key: stage.figures.get(key) for key in ("psnr", "ssim", "steps")},
            "live": self._training is not None,
            "folder": None if stage.folder is None else str(stage.folder),
        }  # fmt: skip
        return Reply(value)

    def frame(self, values: dict[str, Any]) -> Reply:
        """A frame as JPEG or PNG."""
        request = self._request(values)
        data, kind, span = self._draw(lambda: self.frames.encode(request))
        headers = {} if span is None else {"X-Span": f"{span[0]:.6g} {span[1]:.6g}"}
        return Reply(data, kind, headers)

    def photo(self, values: dict[str, Any]) -> Reply:
        """A photograph as JPEG: "view", "side" of at most so many pixels, "mask" to tint it."""
        import cv2

        scene = self._photographs()
        index = _index(values["view"], scene)
        side = int(values.get("side", _THUMBNAIL))
        pixels = scene.image(index)
        height, width = pixels.shape[:2]
        factor = min(1.0, side / max(width, height))
        size = max(1, round(width * factor)), max(1, round(height * factor))
        pixels = shrink_image(pixels, *size)
        if values.get("mask"):
            left_out = ~shrink_mask(scene.mask(index), *size)
            pixels = pixels.copy()
            pixels[left_out] = (pixels[left_out] * 0.4 + np.array(_MASKED) * 0.6).astype(np.uint8)
        bgr = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _PHOTO_QUALITY])
        return Reply(data.tobytes(), "image/jpeg", keep=True)

    def lens(self, values: dict[str, Any]) -> Reply:
        """A lens made or read; see `Lenses.make`."""
        return Reply(self.lenses.describe(self.lenses.make(values)))

    def pick(self, values: dict[str, Any]) -> Reply:
        """The point that a pixel of a frame sees, in the scene's and the dataset's coordinates."""
        request = self._request(values["frame"])
        x, y = (float(value) for value in values["pixel"])
        point = self._draw(lambda: self.frames.pick(request, (x, y)))
        if point is None:
            return Reply({"point": None})
        distance = np.linalg.norm(request.pose[:3, :3] @ point + request.pose[:3, 3])
        return Reply({"point": point, "in_dataset": point + self._offset(), "distance": distance})

    def camera(self, values: dict[str, Any]) -> Reply:
        """The camera of a frame, or keyframes, as a file that `gsut render --path` takes."""
        poses = [self._in_dataset(pose) for pose in values["poses"]]
        camera = self.lenses.at(int(values["lens"]), int(values["width"]), int(values["height"]))
        content = {"camera_from_world": poses, "lens": values_from_camera(camera)}
        return Reply(json_text(content).encode() + b"\n", "application/json")

    def film(self, values: dict[str, Any]) -> Reply:
        """Begins a film ("keys" and so on), stops it ("stop"), or tells how far it is."""
        if "keys" in values:
            if self._film is not None:
                self._film.stop()
            requests = [self._request({**values["frame"], "pose": key}) for key in values["keys"]]
            self._film = Film(self.frames, self._draw, requests, values)
        elif values.get("stop") and self._film is not None:
            self._film.stop()
            self._film = None
        return Reply(None if self._film is None else self._film.state())

    def film_file(self, _: dict[str, Any]) -> Reply:
        """The film that was made."""
        if self._film is None or not self._film.content:
            raise InputError("there is no film yet")
        name = "".join(c if c.isalnum() else "-" for c in self.stage.name).encode(
            "ascii", "replace"
        )
        saved = f'attachment; filename="{name.decode()}.{self._film.ending}"'
        return Reply(self._film.content, self._film.kind, {"Content-Disposition": saved})

    def findings(self, _: dict[str, Any]) -> Reply:
        """What the doctor says of a dataset; found when first asked for."""
        from gsut.check import diagnose

        with self._notes:
            if self.stage.kind == "data" and not self.stage.findings:
                assert self.stage.scene is not None
                self.stage.findings = diagnose(self.stage.scene.path, progress=False)
        keys = ("severity", "where", "what", "advice")
        return Reply([{key: getattr(row, key) for key in keys} for row in self.stage.findings])

    def ground(self, values: dict[str, Any]) -> Reply:
        """The plane that the scene stands on, near to "up"."""
        return Reply(locate_ground(self.frames, values["up"]))

    def floaters(self, values: dict[str, Any]) -> Reply:
        """Looks for floaters, which takes a second a photograph or less; with "far", how far."""
        if values.get("far"):
            return Reply({"done": self._asked})
        with self._notes:
            return Reply(find_floaters(self.frames, lambda done: setattr(self, "_asked", done)))

    def save(self, values: dict[str, Any]) -> Reply:
        """Writes the scene as it is seen to a new file."""
        return Reply(save_edited(self.frames, values))

    def _request(self, values: dict[str, Any]) -> FrameRequest:
        count = 0 if self.stage.scene is None else len(self.stage.scene)
        return FrameRequest.parse(values, count)

    def _photographs(self) -> Scene:
        if self.stage.scene is None:
            raise InputError("there are no photographs here; give --data")
        return self.stage.scene

    def _offset(self) -> np.ndarray:
        return np.zeros(3) if self.stage.scene is None else self.stage.scene.world_offset

    def _in_dataset(self, pose: Any) -> np.ndarray:
        matrix = np.array(pose, np.float64).reshape(4, 4)
        return matrix if self.stage.scene is None else self.stage.scene.to_dataset(matrix)


def _index(value: Any, scene: Scene) -> int:
    index = int(value)
    if not 0 <= index < len(scene):
        raise InputError(f"there is no photograph {index}; there are {len(scene)}")
    return index


def _views(scene: Scene) -> list[dict[str, Any]]:
    """What the page knows of each photograph."""
    held_out = set(scene.test_indices)
    rows = []
    for index, view in enumerate(scene.views):
        camera = scene.camera(index)
        rows.append({
            "name": view.name, "pose": view.camera_from_world.ravel(), "lens": view.camera_index,
            "width": camera.width, "height": camera.height, "held_out": index in held_out,
            "rolling": view.shutter is not None, "masked": view.mask_path is not None,
        })  # fmt: skip
    return rows
