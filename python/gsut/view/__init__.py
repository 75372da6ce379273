"""Serves a page that shows a scene in the browser, drawn by gsut's own renderer."""

from gsut.view.live import LiveTraining
from gsut.view.measure import find_point_in_photograph
from gsut.view.server import ViewServer
from gsut.view.session import Session
from gsut.view.stage import open_stage
