"""Chooses which of a stage's Gaussians a frame shows: those seen most, those that edits keep."""

from __future__ import annotations

import dataclasses
import threading
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.gaussians import SH_C0, Gaussians, StoredGaussians
from gsut.hand_edits import Edited
from gsut.view.frame_request import FrameRequest
from gsut.view.stage import Stage

# Colour of selected Gaussians.
_SELECTED_COLOR = np.array([1.0, 0.6, 0.0])
# Share of this colour in theirs.
_SELECTED_SHARE = 0.7


class ShownGaussians:
    """The Gaussians of a stage, and the parts of them that frames have shown.

    Args:
        stage: what is shown; its Gaussians may change from frame to frame.

    Attributes:
        center, extent: middle (3,) and size of the scene.
        axes: (3, 3) rows: right, up, forward of the scene.
        edited: what edits by hand left of `load_all()`, by the key that frames give.
    """

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self._chosen: dict[float, Gaussians] = {}  # by share
        self._chosen_of: Any = None  # Gaussians and key of edits that these are of
        self._chosen_edits: str | None = None
        self._lock = threading.Lock()  # a small and a large frame are drawn at once
        self.edited: dict[str, Edited] = {}
        place = stage.place()
        self.center, self.extent = place["center"], place["extent"]
        up = place["up"] / np.linalg.norm(place["up"])
        forward = place["pose"][2, :3] - up * (up @ place["pose"][2, :3])
        if np.linalg.norm(forward) < 1e-6:
            forward = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        forward = forward / np.linalg.norm(forward)
        self.axes = np.stack([np.cross(forward, up), up, forward])

    def load_all(self) -> Gaussians:
        """Returns all Gaussians of the stage.

        Raises:
            InputError: there are none.
        """
        g = self.stage.gaussians
        if g is None:
            raise InputError("there are no Gaussians here")
        return g if isinstance(g, Gaussians) else g.to_gaussians()

    def find_edited(self, key: str) -> Edited:
        """Finds what edits left.

        Raises:
            InputError: the edits are not known any more.
        """
        edited = self.edited.get(key)
        if edited is None:
            raise InputError("these edits are not known any more: undo and redo the last one")
        return edited

    def choose(self, request: FrameRequest) -> Any:
        """Returns the most visible share of the Gaussians that edits keep, those that are selected
        in a colour of their own."""
        g, share, edits = self.stage.gaussians, request.share, request.edits
        some = share < 1 and self.stage.kind != "training"
        if g is None or isinstance(g, StoredGaussians) or not (some or edits):
            return g
        with self._lock:
            if self._chosen_of is not g or self._chosen_edits != edits:
                self._chosen, self._chosen_of, self._chosen_edits = {}, g, edits
            if share not in self._chosen:
                whole, kept = self.load_all(), np.ones(len(g), bool)
                if edits is not None:
                    edited = self.find_edited(edits)
                    whole, kept = _add_tint(whole, edited.selected), edited.kept.copy()
                if some:
                    at = (whole.means + (whole.origin - self.center)) / self.extent
                    kept &= _select_most_seen(whole, at, share)
                self._chosen[share] = whole[kept]
            return self._chosen[share]


def _select_most_seen(gaussians: Gaussians, at: np.ndarray, share: float) -> np.ndarray:
    """Selects (N,) bool a share of the Gaussians, those that look largest from a point.

    Args:
        gaussians: N Gaussians.
        at: (N, 3) centres from that point, in units of the scene's extent.
        share: 0 to 1.
    """
    scales = np.sort(gaussians.log_scales, axis=1)[:, 1:].sum(axis=1)
    opacity = -np.logaddexp(0, -gaussians.opacity_logits)
    seen = opacity + scales - np.log1p(np.sum(at**2, axis=1))
    return seen >= np.quantile(seen, 1 - share)


def _add_tint(gaussians: Gaussians, selected: np.ndarray) -> Gaussians:
    """Returns Gaussians of which the selected ones, (N,) bool, are tinted."""
    if not selected.any():
        return gaussians
    sh = gaussians.sh.copy()
    tint = _SELECTED_SHARE * (_SELECTED_COLOR - 0.5) / SH_C0
    sh[selected, 0] = (1 - _SELECTED_SHARE) * sh[selected, 0] + tint
    return dataclasses.replace(gaussians, sh=sh)
