"""Frames whose drawing is held until a test lets it go on."""

import threading
from collections.abc import Callable

from gsut.view.frames import Frames


def hold_frames(
    monkeypatch, is_held: Callable[..., bool], seconds: float
) -> tuple[threading.Event, threading.Event]:
    """Holds the drawing of frames that `is_held(frames, request)` chooses.

    Returns:
        What is set once such a drawing has begun, and what lets it go on within `seconds`.
    """
    going, released = threading.Event(), threading.Event()
    draw = Frames.draw

    def draw_late(frames, request):
        if is_held(frames, request):
            going.set()
            assert released.wait(seconds)
        return draw(frames, request)

    monkeypatch.setattr(Frames, "draw", draw_late)
    return going, released
