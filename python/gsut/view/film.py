"""Makes a film of keyframes in the background while the page stays usable."""

from __future__ import annotations

import dataclasses
import functools
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import check_number
from gsut.files import Number, read_bytes
from gsut.orientation import turn_camera
from gsut.render import smooth_path, write_video
from gsut.view.frame_request import FRAME, NONE, POINT, POSE

if TYPE_CHECKING:
    from gsut.view.frame_request import FrameRequest
    from gsut.view.frames import Frames

# Media type of each format.
_KINDS = {"mp4": "video/mp4", "webm": "video/webm", "gif": "image/gif"}
# Longest film in seconds: a longer one would keep the machine busy for hours.
_MOST_SECONDS = 600.0
# Most frames per second, the fastest common screens.
_MOST_RATE = 120.0
# Shape of a request: to make a film of keyframes, or to stop it.
FILM = {
    "keys?": [POSE], "frame?": FRAME, "seconds?": Number(), "rate?": Number(), "ending?": str,
    "up?": (NONE, POINT), "closed?": bool, "stop?": bool,
}  # fmt: skip


class _Stopped(Exception):
    """The user has stopped the film."""


class Film:
    """Makes one film; starts at once.

    Args:
        frames: draws the frames.
        drawing: decides when.
        keys: the keyframes, equal but for their poses.
        settings: "seconds", "rate" in frames a second, "ending" mp4, webm or gif, "up" (3,) in
            place of the scene's, and "closed" to return to the first keyframe.

    Attributes:
        content: of the file, once it is complete.
        ending, kind: of the file.

    Raises:
        InputError: fewer than two keyframes, or a setting out of range.
    """

    def __init__(
        self,
        frames: Frames,
        drawing: Callable[[Callable[[], Any]], Any],
        keys: Sequence[FrameRequest],
        settings: dict[str, Any],
    ) -> None:
        if len(keys) < 2:
            raise InputError("a film needs two keyframes or more")
        seconds, rate = settings.get("seconds", 8), settings.get("rate", 30)
        seconds = check_number(seconds, "seconds", 0, _MOST_SECONDS, above=True)
        rate = check_number(rate, "rate", 0, _MOST_RATE, above=True)
        self.ending = settings.get("ending", "mp4")
        if self.ending not in _KINDS:
            raise InputError(f"a film is {', '.join(_KINDS)}, not {self.ending!r}")
        self.kind = _KINDS[self.ending]
        self.content = b""
        self._frames, self._drawing, self._key, self._rate = frames, drawing, keys[0], rate
        turns = keys[0].turns
        shown = turn_camera(np.stack([key.pose for key in keys]), turns)
        count = max(2, round(seconds * rate))
        path = smooth_path(
            shown,
            count,
            closed=settings.get("closed", False),
            up=settings.get("up") or frames.shown.axes[1],
        )
        self._poses = turn_camera(path, -turns)
        self._done, self._failure, self._stop = 0, "", threading.Event()
        threading.Thread(target=self._make, daemon=True).start()

    def describe(self) -> dict[str, Any]:
        """Returns the progress of the film."""
        return {
            "done": self._done, "of": len(self._poses), "ready": bool(self.content),
            "failure": self._failure,
        }  # fmt: skip

    def stop(self) -> None:
        """Stops after the current frame."""
        self._stop.set()

    def _make(self) -> None:
        try:
            with tempfile.TemporaryDirectory(prefix="gsut-film-") as folder:
                path = Path(folder) / f"film.{self.ending}"
                write_video(path, self._draw_images(), self._rate)
                self.content = read_bytes(path)
        except _Stopped:
            self._failure = "stopped"
        except InputError as error:
            self._failure = str(error)

    def _draw_images(self) -> Iterator[np.ndarray]:
        for pose in self._poses:
            if self._stop.is_set():
                raise _Stopped
            request = dataclasses.replace(
                self._key, pose=pose, view=None, shutter=None, layers=frozenset(), marks=None
            )
            yield self._drawing(functools.partial(self._frames.draw, request)).image
            self._done += 1
