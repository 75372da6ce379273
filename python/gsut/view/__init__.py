"""A page in the browser that walks through a scene: frames from gsut's own renderer."""

from gsut.view.live import LiveTraining
from gsut.view.measure import point_in_photograph
from gsut.view.server import LOOPBACK, ViewServer
from gsut.view.session import Session
from gsut.view.stage import Stage, data_stage, stage_of

__all__ = [
    "LOOPBACK",
    "LiveTraining",
    "Session",
    "Stage",
    "ViewServer",
    "data_stage",
    "point_in_photograph",
    "stage_of",
]
