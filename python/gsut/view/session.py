"""Answers the page's requests during one session, and decides who draws when."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene
from gsut.data.images import shrink_image, shrink_mask
from gsut.data.poses import check_rigid
from gsut.data.scene import count_lens_turns, find_upright_poses
from gsut.files import Number, format_json
from gsut.gaussians import Gaussians
from gsut.lens import camera_models
from gsut.lens.files import values_from_camera
from gsut.orientation import turn_camera, turn_picture, turn_size
from gsut.view.frame_request import FRAME, FULL_QUALITY, MODES, POSE, SIZE, TURNS, FrameRequest
from gsut.view.frames import Frames
from gsut.view.lenses import LENS, Lenses
from gsut.view.named_views import read_named_view
from gsut.view.page_file import write_page
from gsut.view.selections import STEPS, Selections
from gsut.view.server import Reply, Route, declare_values
from gsut.view.shown_gaussians import ShownGaussians
from gsut.view.stage import Stage

# Quality of a photograph as WebP, in a page of one file: as good to the eye, half the bytes.
_WEBP_QUALITY = 80
# Colour that tints what a mask leaves out.
_MASKED = (200, 40, 60)
# Photographs that are decoded at once: each takes several times its pixels of memory.
_MOST_DECODING = 2
# Most keyframes of a saved path: more than anybody sets.
_MOST_KEYS = 20_000
# Shape of a request for a photograph.
_PHOTOGRAPH = {
    "view": Number(whole=True), "side": Number(1, whole=True), "mask?": bool, "kind?": str,
}  # fmt: skip
_Result = TypeVar("_Result")


class Drawing(Protocol):
    """Decides when work on the Gaussians is done: at once, or between two steps of a training.

    Large work waits for other large work only, and small work for small work.
    """

    def __call__(self, work: Callable[[], _Result], large: bool = False) -> _Result: ...


class AtOnce:
    """Does work in the caller's thread, one small and one large piece at a time."""

    def __init__(self) -> None:
        self._small, self._large = threading.Lock(), threading.Lock()

    def __call__(self, work: Callable[[], _Result], large: bool = False) -> _Result:
        with self._large if large else self._small:
            return work()


class Session:
    """Answers what the page can request.

    Args:
        stage: what is shown.
        drawing: decides when it is drawn; None: at once.
        training: of a live training, the route that controls it and returns its progress.
    """

    def __init__(
        self, stage: Stage, drawing: Drawing | None = None, training: Route | None = None
    ) -> None:
        self.stage = stage
        self.lenses = Lenses(stage.cameras)
        self.shown = ShownGaussians(stage)
        self.frames, self._large = (Frames(self.shown, self.lenses) for _ in range(2))
        self._selections = Selections(self.shown, self.lenses)
        self._draw: Drawing = drawing or AtOnce()
        self._training = training
        self._checking = threading.Lock()
        self._decoding = threading.BoundedSemaphore(_MOST_DECODING)

    @property
    def routes(self) -> dict[str, Route]:
        """The routes by name."""
        routes: dict[str, Route] = {
            "scene": self.describe_scene, "frame": self.draw_frame,
            "photo": self.send_photograph, "lens": self.make_lens, "pick": self.pick_point,
            "camera": self.save_cameras, "findings": self.list_findings,
            "edits": self.apply_edits, "edits.json": self.send_edits,
        }  # fmt: skip
        if self._training is not None:
            routes["training"] = self._training
        return routes

    def write_page(
        self, path: Path, photographs: int, title: str | None = None,
        views: Sequence[str] = (), address: str | None = None, credit: str | None = None,
    ) -> Any:  # fmt: skip
        """Writes the page with the scene in it as one file; views: "NAME=WHERE", else as
        `page_file.write_page`."""
        named = [read_named_view(text, self.stage) for text in views]
        return write_page(path, self, photographs, named, title, address, credit)

    def describe_scene(self, _: dict[str, Any]) -> Reply:
        """Returns everything that the page needs at its start."""
        stage, place = self.stage, self.stage.place()
        gaussians = stage.gaussians
        value = {
            "name": stage.name, "kind": stage.kind, "modes": MODES,
            "num_gaussians": 0 if gaussians is None else len(gaussians),
            "num_points": 0 if stage.scene is None else len(stage.scene.points),
            "up": self.shown.axes[1], "center": place["center"], "extent": place["extent"],
            "pose": place["pose"].ravel(),
            "lenses": [
                {**self.lenses.describe(row),
                 "turns": 0 if stage.scene is None else count_lens_turns(stage.scene, row)}
                for row in range(len(stage.cameras))
            ],
            "models": {name: _core.camera_param_names(name) for name in camera_models()},
            "views": [] if stage.scene is None else _describe_views(stage.scene),
            "figures": {key: stage.figures.get(key) for key in ("psnr", "ssim", "steps")},
            "live": self._training is not None,
            "selectable": stage.kind in ("run", "file") and isinstance(gaussians, Gaussians),
        }  # fmt: skip
        return Reply(value)

    @declare_values(FRAME)
    def draw_frame(self, values: dict[str, Any]) -> Reply:
        """Draws a frame as JPEG or PNG."""
        request = self._request(values)
        data, kind, span = self._draw_with(request, lambda frames: frames.encode(request))
        headers = {} if span is None else {"X-Span": f"{span[0]:.6g} {span[1]:.6g}"}
        return Reply(data, kind, headers)

    @declare_values(_PHOTOGRAPH)
    def send_photograph(self, values: dict[str, Any]) -> Reply:
        """Returns a photograph: "view", "side" for its longest side, "mask" to tint it, "kind"."""
        import cv2

        scene = self._require_scene()
        index, side = int(values["view"]), int(values["side"])
        if not 0 <= index < len(scene):
            raise InputError(f"there is no photograph {index}; there are {len(scene)}")
        with self._decoding:
            bgr = self._shrink_photograph(scene, index, side, values.get("mask", False))
        if values.get("kind") == "webp":
            _, data = cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])
            return Reply(data.tobytes(), "image/webp", keep=True)
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, FULL_QUALITY])
        return Reply(data.tobytes(), "image/jpeg", keep=True)

    def _shrink_photograph(self, scene: Scene, index: int, side: int, tinted: bool) -> np.ndarray:
        import cv2

        pixels = scene.image(index)
        height, width = pixels.shape[:2]
        factor = min(1.0, side / max(width, height))
        size = max(1, round(width * factor)), max(1, round(height * factor))
        pixels = shrink_image(pixels, *size)
        turns = scene.views[index].turns
        if tinted:
            left_out = ~shrink_mask(scene.mask(index), *size)
            pixels = pixels.copy()
            pixels[left_out] = (pixels[left_out] * 0.4 + np.array(_MASKED) * 0.6).astype(np.uint8)
        return cv2.cvtColor(turn_picture(pixels, turns), cv2.COLOR_RGB2BGR)

    @declare_values(LENS)
    def make_lens(self, values: dict[str, Any]) -> Reply:
        """Makes or reads a lens; see `Lenses.make`."""
        return Reply(self.lenses.describe(self.lenses.make(values)))

    @declare_values({"frame": FRAME, "pixel": Number(shape=(2,))})
    def pick_point(self, values: dict[str, Any]) -> Reply:
        """Finds the point that a pixel of a frame sees, in the scene's and the dataset's
        coordinates."""
        request = self._request(values["frame"])
        x, y = values["pixel"]
        point = self._draw_with(request, lambda frames: frames.find_point(request, (x, y)))
        if point is None:
            return Reply({"point": None})
        distance = np.linalg.norm(request.pose[:3, :3] @ point + request.pose[:3, 3])
        return Reply(
            {"point": point, "in_dataset": point + self._get_offset(), "distance": distance}
        )

    @declare_values(SIZE | {"poses": [POSE], "turns?": TURNS})
    def save_cameras(self, values: dict[str, Any]) -> Reply:
        """Returns the camera of a frame, or keyframes, as a file for `gsut render --path`."""
        _check_keys(values["poses"])
        turns = int(values.get("turns", 0))
        poses = [self._move_to_dataset(pose, turns) for pose in values["poses"]]
        size = turn_size(int(values["width"]), int(values["height"]), turns)
        camera = self.lenses.resize(int(values["lens"]), *size)
        content: dict[str, Any] = {"camera_from_world": poses, "lens": values_from_camera(camera)}
        if turns:
            content["turns"] = turns
        return Reply(format_json(content).encode() + b"\n", "application/json")

    def list_findings(self, _: dict[str, Any]) -> Reply:
        """Returns the doctor's findings on a dataset, which are made at the first request."""
        from gsut.check import diagnose

        with self._checking:
            if self.stage.kind == "data" and not self.stage.findings:
                assert self.stage.scene is not None
                self.stage.findings = diagnose(self.stage.scene.path, progress=False)
        keys = ("severity", "where", "what", "advice")
        return Reply([{key: getattr(row, key) for key in keys} for row in self.stage.findings])

    @declare_values({"steps": STEPS})
    def apply_edits(self, values: dict[str, Any]) -> Reply:
        """Applies the edits "steps", which frames then name by the reply's "key"."""
        return Reply(self._draw(lambda: self._selections.apply(values["steps"]), True))

    @declare_values({"steps": STEPS})
    def send_edits(self, values: dict[str, Any]) -> Reply:
        """Returns the edits "steps" as a file for `gsut edit --apply`."""
        content = {"edits": self._selections.describe(values["steps"])}
        return Reply(format_json(content).encode() + b"\n", "application/json")

    def _draw_with(self, request: FrameRequest, work: Callable[[Frames], _Result]) -> _Result:
        """Does work with the frames that draw a request of this size."""
        frames = self._large if request.is_large else self.frames
        return self._draw(lambda: work(frames), request.is_large)

    def _request(self, values: dict[str, Any]) -> FrameRequest:
        count = 0 if self.stage.scene is None else len(self.stage.scene)
        return FrameRequest.parse(values, count)

    def _require_scene(self) -> Scene:
        if self.stage.scene is None:
            raise InputError("there are no photographs here; give --data")
        return self.stage.scene

    def _get_offset(self) -> np.ndarray:
        return np.zeros(3) if self.stage.scene is None else self.stage.scene.world_offset

    def _move_to_dataset(self, pose: Any, turns: int) -> np.ndarray:
        matrix = np.array(pose, np.float64).reshape(4, 4)
        check_rigid(matrix, "a pose")
        matrix = turn_camera(matrix, -turns)
        return matrix if self.stage.scene is None else self.stage.scene.to_dataset(matrix)


def _check_keys(keys: Sequence[Any]) -> None:
    if len(keys) > _MOST_KEYS:
        raise InputError(f"a path has at most {_MOST_KEYS} poses")


def _describe_views(scene: Scene) -> list[dict[str, Any]]:
    """Describes each photograph for the page, as it is shown: upright."""
    held_out = set(scene.test_indices)
    rows = []
    for index, view in enumerate(scene.views):
        camera, pose = scene.camera(index), find_upright_poses(scene, [index])
        width, height = turn_size(camera.width, camera.height, view.turns)
        rows.append({
            "name": view.name, "pose": pose.ravel(), "lens": view.camera_index,
            "width": width, "height": height, "turns": view.turns, "held_out": index in held_out,
            "rolling": view.shutter is not None, "masked": view.mask_path is not None,
        })  # fmt: skip
    return rows
