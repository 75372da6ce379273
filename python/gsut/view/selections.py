"""Applies what people select, delete and keep by hand in the page."""

from __future__ import annotations

import hashlib
import threading
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import Number, format_json
from gsut.hand_edits import apply_edit, check_edit, start_edits
from gsut.lens.files import values_from_camera
from gsut.view.frame_request import FRAME, FrameRequest
from gsut.view.lenses import Lenses
from gsut.view.shown_gaussians import ShownGaussians

# States of edits that are kept, for undo and for several pages: two bytes a Gaussian each.
_KEPT_STATES = 32
# Most edits at once, more than a day of work by hand.
_MOST_EDITS = 10_000
# Shape of the page's edits; `check_edit` checks the rest of each.
STEPS = [{"do": str, "frame?": FRAME, "points?": Number(shape=(None, 2))}]


class Selections:
    """Applies the page's edits to the Gaussians of a stage.

    Args:
        shown: the Gaussians; keeps the states of edits.
        lenses: by number.
    """

    def __init__(self, shown: ShownGaussians, lenses: Lenses) -> None:
        self._shown, self._lenses = shown, lenses
        self._lock = threading.Lock()

    def describe(self, steps: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Describes the page's edits as a file of them holds them, see `read_edits`.

        Args:
            steps: of the shape STEPS; their points are pixels of a "frame", see `FrameRequest`.

        Raises:
            InputError: one is impossible.
        """
        if len(steps) > _MOST_EDITS:
            raise InputError(f"edits are a list of at most {_MOST_EDITS:,}")
        edits = [self._describe_edit(dict(step)) for step in steps]
        for edit in edits:
            check_edit(edit, "the page's edits")
        return edits

    def _describe_edit(self, step: dict[str, Any]) -> dict[str, Any]:
        if "frame" not in step:
            return step
        request = FrameRequest.parse(step.pop("frame"), 0)
        camera = self._lenses.resize(request.lens, request.width, request.height)
        scene = self._shown.stage.scene
        pose = request.pose if scene is None else scene.to_dataset(request.pose)
        points = [request.turn_back((x, y)).tolist() for x, y in step.get("points", [])]
        lens = values_from_camera(camera)
        return {**step, "camera_from_world": pose.tolist(), "lens": lens, "points": points}

    def apply(self, steps: list[dict[str, Any]]) -> dict[str, Any]:
        """Applies the page's edits.

        Returns:
            "key", by which frames name these edits; how many Gaussians are "selected" and "kept",
            "of" all.
        """
        edits, whole = self.describe(steps), self._shown.load_all()
        scene = self._shown.stage.scene
        placed = whole if scene is None else whole.translate(scene.world_offset)
        with self._lock:
            edited, key, states = start_edits(whole), "", dict(self._shown.edited)
            for edit in edits:
                key = hashlib.sha256((key + format_json(edit)).encode()).hexdigest()
                edited = states.pop(key) if key in states else apply_edit(placed, edited, edit)
                states[key] = edited  # the newest is last
            self._shown.edited = dict(list(states.items())[-_KEPT_STATES:])
        counts = {
            name: int(np.count_nonzero(getattr(edited, name))) for name in ("selected", "kept")
        }
        return {"key": key or None, **counts, "of": len(whole)}
