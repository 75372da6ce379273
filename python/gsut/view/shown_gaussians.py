"""Chooses which of a stage's Gaussians a frame shows: inside the crop box, without floaters."""

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
        axes: (3, 3) rows: right, up, forward of the scene, along which the crop box stands.
        floaters: (N,) bool of `load_all()`; None before they are searched.
        edited: what edits by hand left of `load_all()`, by the key that frames give.
    """

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self._chosen: dict[Any, Any] = {}
        self._lock = threading.Lock()  # a small and a large frame are drawn at once
        self.floaters: np.ndarray | None = None
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

    def select_kept(
        self, whole: Gaussians, crop: np.ndarray | None, clean: bool, edits: str | None
    ) -> np.ndarray:
        """Returns (N,) bool: inside the crop box, kept by the edits of this key and, if `clean`,
        no floaters."""
        kept = np.ones(len(whole), bool) if edits is None else self.find_edited(edits).kept.copy()
        if crop is not None:
            at = self._move_to_axes(whole)
            kept &= np.all((at >= crop[0]) & (at <= crop[1]), axis=1)
        if clean and self.floaters is not None and len(self.floaters) == len(whole):
            kept &= ~self.floaters
        return kept

    def _move_to_axes(self, whole: Gaussians) -> np.ndarray:
        return (whole.means + (whole.origin - self.center)) @ self.axes.T / self.extent

    def choose(self, request: FrameRequest) -> Any:
        """Returns the most visible share of the Gaussians inside the crop box, those that are
        selected in a colour of their own."""
        g, crop, share, edits = self.stage.gaussians, request.crop, request.share, request.edits
        if isinstance(g, StoredGaussians):
            if crop is None:
                return g
            return g.with_change(lambda part: part[self.select_kept(part, crop, False, None)])
        clean = request.clean and self.floaters is not None
        some = share < 1 and self.stage.kind != "training"
        if g is None or not (some or clean or edits or crop is not None):
            return g
        key = share, clean, None if crop is None else crop.tobytes(), edits
        with self._lock:
            if self._chosen.get("of") is not g:
                self._chosen = {"of": g}
            if key not in self._chosen:
                boxes = (None, key[2])
                for old in [
                    o for o in self._chosen if o != "of" and (o[2] not in boxes or o[3] != edits)
                ]:
                    del self._chosen[old]  # of a box or edits as they were before
                whole = self.load_all()
                kept = self.select_kept(whole, crop, clean, edits)
                if edits is not None:
                    whole = _add_tint(whole, self.find_edited(edits).selected)
                if some:
                    kept &= _select_most_seen(whole, self._move_to_axes(whole), share)
                self._chosen[key] = whole[kept]
            return self._chosen[key]


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
