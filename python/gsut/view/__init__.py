"""Serves a page that shows a scene in the browser, drawn by gsut's own renderer."""

from gsut.view.live_scene import LiveScene
from gsut.view.measure import find_point_in_photograph
from gsut.view.server import ViewServer
from gsut.view.session import Session
from gsut.view.stage import open_stage

__all__ = [
    "LiveScene",
    "Session",
    "ViewServer",
    "find_point_in_photograph",
    "open_stage",
]
